"""Films of a board before a known camera, rendered ray by ray."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np

from onebend.recording.calibration import Board
from onebend.records import Array

WIDTH, HEIGHT = 640, 480
MATRIX = np.array([[620.0, 0.0, 327.0], [0.0, 618.0, 233.0], [0.0, 0.0, 1.0]])
DIST = np.array([-0.12, 0.05, 0.0008, -0.0006])
FINE = 2  # rays a pixel, each way

CHESS = Board("chessboard", 8, 5, 0.02)
CHARUCO = Board("charuco", 8, 6, 0.02)


@cache
def rays() -> Array:
    """(FINE H, FINE W, 2) slopes of the rays through the parts of every pixel, the lens taken off."""
    y, x = np.mgrid[: FINE * HEIGHT, : FINE * WIDTH]
    pixel = (np.stack([x, y], axis=-1) + 0.5) / FINE - 0.5
    wanted = (pixel - MATRIX[:2, 2]) / np.diag(MATRIX)[:2]
    found = wanted.copy()
    k1, k2, p1, p2 = DIST
    for _ in range(10):
        u, v = found[..., 0], found[..., 1]
        r2 = u * u + v * v
        shift = np.stack([2 * p1 * u * v + p2 * (r2 + 2 * u * u), p1 * (r2 + 2 * v * v) + 2 * p2 * u * v], axis=-1)
        found = (wanted - shift) / (1 + k1 * r2 + k2 * r2 * r2)[..., None]
    return np.asarray(found)


@cache
def texture(board: Board) -> tuple[Array, float, Array]:
    """Grey levels, pixels a metre, and where the board's corner (0, 0) is in them."""
    if board.kind == "charuco":
        words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker_side, words)
        picture = made.generateImage((64 * board.columns, 64 * board.rows), marginSize=0)
    else:
        y, x = np.mgrid[: 64 * (board.rows + 1), : 64 * (board.columns + 1)] // 64
        picture = np.where((x + y) % 2 == 0, 0, 255).astype(np.uint8)
    white = np.pad(picture, 64, constant_values=255).astype(float)
    return white, 64 / board.square, np.full(2, 64.0 if board.kind == "charuco" else 128.0)


def view(board: Board, turn: Array, place: Array) -> Array:
    """(H, W) the board's middle at `place` [m] before the camera, turned by the rotation vector `turn`."""
    rotation = np.asarray(cv2.Rodrigues(np.asarray(turn, dtype=float))[0])
    corner = np.asarray(place) - rotation[:, :2] @ board.corners.mean(axis=0)
    grey, scale, origin = texture(board)
    slope = rays()
    ray = np.concatenate([slope, np.ones((*slope.shape[:2], 1))], axis=-1)
    far = (rotation[:, 2] @ corner) / (ray @ rotation[:, 2])
    on = (ray * far[..., None] - corner) @ rotation[:, :2]
    at = np.floor(on * scale + origin).astype(int)
    inside = (at >= 0).all(axis=-1) & (at[..., 0] < grey.shape[1]) & (at[..., 1] < grey.shape[0])
    fine = np.where(inside, grey[np.clip(at[..., 1], 0, len(grey) - 1), np.clip(at[..., 0], 0, grey.shape[1] - 1)], 110)
    return np.asarray(fine.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3)))


def poses(count: int, seed: int, tilt: float = 0.7) -> list[tuple[Array, Array]]:
    """Turns and places all over the picture."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(count):
        z = rng.uniform(0.24, 0.36)
        x, y = (rng.uniform(-0.5, 0.5) * z * n / f / 1.6 for n, f in ((WIDTH, 620), (HEIGHT, 618)))
        lean = tilt * np.array([np.cos(2.4 * i), np.sin(2.4 * i)])
        out.append((np.array([*lean, rng.uniform(-0.3, 0.3)]), np.array([x, y, z])))
    return out


def film(path: Path, pictures: Sequence[Array], rate: int = 2) -> Path:
    """Grey pictures as H.264, so many a second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": "10"})
        stream.width, stream.height, stream.pix_fmt = pictures[0].shape[1], pictures[0].shape[0], "yuv420p"
        for picture in pictures:
            grey = np.clip(picture, 0, 255).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(np.repeat(grey[..., None], 3, axis=-1), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
