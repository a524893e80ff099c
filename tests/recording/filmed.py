"""Pictures of printed tags from known poses: what the tests of tags and camera know to be true."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from pyapriltags import Detector
from scipy.spatial.transform import Rotation

from onebend.recording.entries import BeamEntry, CameraEntry, Recording, TagEntry, TagsEntry, VideoEntry
from onebend.recording.plane import FACING, project, square, to_plane
from onebend.recording.video import FilmFrame
from onebend.records import Array, Detections, View

WIDTH, HEIGHT = 640, 360
SIZE, LENGTH = 0.012, 0.15
PAPER, INK, GROUND = 215.0, 35.0, 120.0
BLUR = 3  # samples a pixel's side


@cache
def printed(tag_id: int, family: str = "tag36h11") -> Array:
    """Cells of a printed tag with its white margin, 1 where white; row 0 is the upper edge."""
    detector = Detector(families=family)  # owns the memory that is read below
    made = detector.tag_families[family].contents
    cells = np.zeros((made.total_width, made.total_width))
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 1, 1, 1, 1
    margin = (made.total_width - made.width_at_border) // 2
    for bit in range(made.nbits):
        if int(made.codes[tag_id]) >> (made.nbits - 1 - bit) & 1:
            cells[made.bit_y[bit] + margin, made.bit_x[bit] + margin] = 1
    return cells


def view(*, tilt: tuple[float, float] = (0.1, -0.15), dist: Sequence[float] = (-0.08, 0.02, 5e-4, -3e-4, 0.0)) -> View:
    """A camera 0.26 m in front of the tags, looking at the middle of the beam, tilted."""
    focal = 0.95 * WIDTH
    return View(
        matrix=np.array([[focal, 0, 322.0], [0, 1.001 * focal, 177.0], [0, 0, 1.0]]),
        dist=np.array(dist),
        rotation=Rotation.from_rotvec([*tilt, 0.03]).as_matrix() @ FACING,
        translation=np.array([-0.075, 0.03, 0.25]),
        calibrated=True,
        corner_sd=0.0,
    )


def poses(count: int) -> Array:
    """(T, 4, 3) x, y, angle of a base tag and three tags on a beam that bends up to 1.2 rad and back."""
    bend = 1.2 * np.sin(np.pi * np.linspace(0, 1, count)) ** 2
    s = np.array([0.0, 1 / 3, 2 / 3, 1.0])
    fine = np.linspace(0, 1, 61)
    angle = bend[:, None] * fine
    step = LENGTH * (fine[1] - fine[0])
    x = np.concatenate(
        [np.zeros((count, 1)), np.cumsum(step * np.cos(angle[:, 1:] - angle[:, 1:2] / 2), axis=1)], axis=1
    )
    y = np.concatenate(
        [np.zeros((count, 1)), np.cumsum(step * np.sin(angle[:, 1:] - angle[:, 1:2] / 2), axis=1)], axis=1
    )
    at = (s * 60).astype(int)
    return np.stack([x[:, at], y[:, at], angle[:, at]], axis=-1)


def corners_of(true: Array, seen: View, size: float = SIZE) -> Array:
    """(..., 4, 2) px corners of tags at poses (..., 3)."""
    return project(seen, square(true[..., :2], true[..., 2], size))


def picture(
    true: Array,
    tag_id: Sequence[int],
    seen: View,
    *,
    family: str = "tag36h11",
    shape: tuple[int, int] = (HEIGHT, WIDTH),
) -> np.ndarray:
    """A frame (H, W) that shows tags at poses (m, 3), each pixel the mean of `BLUR`^2 samples."""
    height, width = shape
    frame = np.full(shape, GROUND)
    for pose, tag in zip(true, tag_id, strict=True):
        cells = printed(tag, family)
        whole = SIZE * len(cells) / (len(cells) - 2)  # one cell of white margin on each side
        outline = project(seen, square(pose[:2], pose[2], whole))
        left, top = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 1, 0)
        right, bottom = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 2, (width, height))
        fine = (np.arange(BLUR) + 0.5) / BLUR - 0.5
        x = (np.arange(left, right)[:, None] + fine).ravel()
        y = (np.arange(top, bottom)[:, None] + fine).ravel()
        flat = to_plane(seen, np.stack(np.meshgrid(x, y), axis=-1)) - pose[:2]
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        across = np.floor((cos * flat[..., 0] + sin * flat[..., 1]) / whole * len(cells) + len(cells) / 2).astype(int)
        down = np.floor(len(cells) / 2 - (cos * flat[..., 1] - sin * flat[..., 0]) / whole * len(cells)).astype(int)
        inside = (across >= 0) & (across < len(cells)) & (down >= 0) & (down < len(cells))
        level = INK + (PAPER - INK) * cells[np.clip(down, 0, len(cells) - 1), np.clip(across, 0, len(cells) - 1)]
        block = frame[top:bottom, left:right]
        under = np.repeat(np.repeat(block, BLUR, axis=0), BLUR, axis=1)
        mixed = np.where(inside, level, under).reshape(bottom - top, BLUR, right - left, BLUR)
        frame[top:bottom, left:right] = mixed.mean(axis=(1, 3))
    return frame


def film(true: Array, tag_id: Sequence[int], seen: View, *, noise: float = 1.5, seed: int = 0) -> list[FilmFrame]:
    """Frames at 30 a second of tags at poses (T, m, 3); NaN hides a tag."""
    random = np.random.default_rng(seed)
    frames = []
    for t, row in enumerate(true):
        shown = np.isfinite(row).all(axis=1)
        clean = picture(row[shown], [tag for tag, is_in in zip(tag_id, shown, strict=True) if is_in], seen)
        noisy = np.clip(np.rint(clean + noise * random.standard_normal(clean.shape)), 0, 255)
        frames.append(FilmFrame(t, t / 30, noisy.astype(np.uint8)))
    return frames


def recording(*, calibrated: View | None = None, size: float = SIZE, turns: Sequence[float] = (0.0,) * 4) -> Recording:
    """What recording.toml would say of these films."""
    camera = None
    if calibrated:
        matrix = calibrated.matrix
        camera = CameraEntry(
            WIDTH, HEIGHT, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], tuple(calibrated.dist)
        )
    s = (0.0, 1 / 3, 2 / 3, 1.0)
    tags = [TagEntry(i, s[i], turns[i]) for i in range(4)]
    return Recording(
        folder=Path("folder"),
        name="made up",
        beam=BeamEntry(length=LENGTH),
        tags=TagsEntry(size=size, on_base=tuple(tags[:1]), on_beam=tuple(tags[1:])),
        camera=camera,
        video=VideoEntry(Path("video.mp4")),
        force=None,
        push=None,
        gravity=None,
    )


def detections(corners: Array, *, sd: float = 0.0, seed: int = 0) -> Detections:
    """Corners (T, 4, 4, 2) as if detected, with white noise of `sd` px."""
    noisy = corners + sd * np.random.default_rng(seed).standard_normal(corners.shape)
    return Detections(
        time=np.arange(len(corners)) / 30, tag_id=np.arange(corners.shape[1]), corners=noisy, width=WIDTH, height=HEIGHT
    )
