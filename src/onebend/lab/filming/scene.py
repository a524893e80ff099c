"""What is in the picture apart from beam and tags: table, light, tool, hand; and the camera's noise."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal, get_args

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from onebend.errors import RecordingError
from onebend.lab.filming.raster import Image, box_around, coverage
from onebend.recording.camera.lens import project
from onebend.records import Array, View

Colour = tuple[float, float, float]  # 0 to 1
Backdrop = Literal["wood", "mat", "cloth", "plain"]
TO_YUV = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])  # BT.601


@dataclass(frozen=True)
class Scene:
    """How the scene looks. Times are those of the film."""

    backdrop: Backdrop = "wood"
    beam: Colour = (0.80, 0.77, 0.74)
    clamp: Colour = (0.28, 0.29, 0.30)
    tool: Colour = (0.28, 0.30, 0.31)
    hand: Colour = (0.36, 0.24, 0.21)
    paper: float = 0.90  # brightness of the tags' paper
    ink: float = 0.12
    print_dpi: float = 2400.0  # dots per inch of the printer that made the tags; 0: edges without error
    brightness: float = 1.0
    falloff: float = 0.2  # of the light, from the brightest place to the farthest corner
    brightest: tuple[float, float] = (0.6, 0.4)  # place in the picture, as parts of its width and height
    flicker: float = 0.03  # of the light, largest change
    flicker_time: float = 3.0  # s, its period
    step: float = 0.0  # of the light: a cloud or a lamp, at `step_at`
    step_at: float = inf  # s
    exposure: float = 0.01  # s
    blur: float = 0.7  # px, sd of the lens's point image
    noise: float = 1.5  # of 255, sd of the sensor's noise in a pixel of middle brightness
    overlap: float = 0.0  # m, how far the tool reaches over the beam's edge, and over tags there
    tool_width: float = 0.007  # m
    slant: float = 0.3  # rad, of the tool against the push
    hand_at: float = inf  # s, when a hand passes before the beam's middle
    crf: int = 20  # of H.264: 0 is lossless, 51 the worst

    def __post_init__(self) -> None:
        if self.backdrop not in get_args(Backdrop):
            raise RecordingError(
                f"there is no backdrop {self.backdrop!r}. Take one of {', '.join(get_args(Backdrop))}."
            )
        if (
            min(self.exposure, self.blur, self.noise, self.tool_width, self.print_dpi) < 0.0
            or not 0.0 <= self.falloff < 1.0
        ):
            raise RecordingError("exposure, blur, noise and dots per inch cannot be negative; falloff is in [0, 1)")
        if not 0 <= self.crf <= 51:
            raise RecordingError(f"H.264 knows qualities from 0 to 51, got {self.crf}")


@dataclass(frozen=True)
class Picture:
    """What the table reflects: brightness (H, W), and the two colour differences at half the size."""

    y: Image
    u: Image
    v: Image


def yuv(colour: Colour) -> tuple[float, float, float]:
    """Brightness 0 to 1 and the two colour differences -0.5 to 0.5."""
    y, u, v = (TO_YUV @ np.array(colour)).tolist()
    return y, u, v


def backdrop(scene: Scene, view: View, shape: tuple[int, int], rng: np.random.Generator) -> Picture:
    """The table (H, W), as sharp as the lens shows it."""
    height, width = shape
    grain = {"wood": (3, 60), "mat": (14, 14), "cloth": (10, 10), "plain": (60, 60)}[scene.backdrop]
    base, swing = {
        "wood": ((0.55, 0.36, 0.19), 0.5),
        "mat": ((0.22, 0.40, 0.30), 0.35),
        "cloth": ((0.56, 0.57, 0.60), 0.35),
        "plain": ((0.70, 0.70, 0.68), 0.03),
    }[scene.backdrop]
    field = octaves(shape, grain, rng)
    y, u, v = yuv(base)
    bright = (y * (1.0 + swing * field)).astype(np.float32)
    if scene.backdrop == "mat":
        bright += 0.12 * mat_lines(view, shape)
    picture = Picture(
        gaussian_filter(np.clip(bright, 0.02, 1.0), scene.blur),
        (u * (1.0 + swing * field[::2, ::2])).astype(np.float32),
        (v * (1.0 + swing * field[::2, ::2])).astype(np.float32),
    )
    for _ in range(int(rng.integers(0, 6))):
        spot(picture, rng.uniform((0, 0), (width, height)), rng.uniform(4.0, 10.0), tuple(rng.uniform(0.1, 0.6, 3)))
    return picture


def octaves(shape: tuple[int, int], grain: tuple[int, int], rng: np.random.Generator) -> Image:
    """A random field, about -1 to 1, with structures of `grain` (rows, columns) px and larger."""
    total = np.zeros(shape, dtype=np.float32)
    for octave in range(5):
        sides = zip(shape, grain, strict=True)
        rows, columns = (max(2, round(side / (cell * 2.0**octave)) + 2) for side, cell in sides)
        coarse = rng.standard_normal((rows, columns)).astype(np.float32)
        factors = (shape[0] / (rows - 1) + 1e-3, shape[1] / (columns - 1) + 1e-3)
        fine = zoom(coarse, factors, order=1)[: shape[0], : shape[1]]
        total[: fine.shape[0], : fine.shape[1]] += 1.5**octave * fine
    return total / np.float32(2.5 * total.std())


def mat_lines(view: View, shape: tuple[int, int], spacing: float = 0.02, thick: float = 0.0004) -> Image:
    """Coverage (H, W) of the printed lines of a cutting mat."""
    reach = np.arange(-15, 20) * spacing
    along = np.linspace(-0.3, 0.4, 60)
    loops = []
    for at in reach:
        edge = np.concatenate([along, along[::-1]])
        side = np.concatenate([np.full(60, at - thick / 2), np.full(60, at + thick / 2)])
        loops += [np.stack([edge, side], axis=-1), np.stack([side, edge], axis=-1)[::-1]]
    px = project(view, np.stack(loops))
    kept = np.isfinite(px).all(axis=(1, 2)) & (np.abs(px) < 1e5).all(axis=(1, 2))
    return coverage(px[kept], box_around(np.array([[0, 0], [shape[1], shape[0]]]), shape[1], shape[0], 0.0))


def spot(picture: Picture, centre: Array, radius: float, colour: Colour) -> None:
    """Draw a disc, in place."""
    turn = np.linspace(0.0, 2.0 * np.pi, 33)[:-1]
    loop = centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    height, width = picture.y.shape
    paint(picture, loop[None], colour, width, height)


def paint(picture: Picture, loops: Array, colour: Colour, width: int, height: int) -> None:
    """Draw polygons (..., corners, 2) [px] over a whole picture, in place."""
    box = box_around(loops, width, height)
    blend(picture, coverage(loops, box), yuv(colour), box.slices, box.halved.slices)


def blend(
    picture: Picture,
    cover: Image,
    colour: tuple[float, float, float],
    full: tuple[slice, slice],
    half: tuple[slice, slice],
) -> None:
    """Lay a colour over a part of `picture`, as densely as `cover` says, in place."""
    if cover.size == 0:
        return
    coarse = np.float32(0.25) * (cover[::2, ::2] + cover[1::2, ::2] + cover[::2, 1::2] + cover[1::2, 1::2])
    for plane, level, dense, part in (
        (picture.y, colour[0], cover, full),
        (picture.u, colour[1], coarse, half),
        (picture.v, colour[2], coarse, half),
    ):
        plane[part] += dense * (np.float32(level) - plane[part])


def lamp(scene: Scene, shape: tuple[int, int]) -> Image:
    """(H, W) the light that falls on each place, 1 at the brightest."""
    height, width = shape
    x = (np.arange(width) / width - scene.brightest[0]) * width / height
    y = np.arange(height) / height - scene.brightest[1]
    square = x[None, :] ** 2 + y[:, None] ** 2
    return np.asarray(scene.brightness * (1.0 - scene.falloff * square / square.max()), dtype=np.float32)


def light_at(scene: Scene, time: float) -> float:
    """The lamp's strength over its usual one."""
    wave = scene.flicker * np.sin(2.0 * np.pi * time / scene.flicker_time)
    return float(1.0 + wave + (scene.step if time >= scene.step_at else 0.0))
