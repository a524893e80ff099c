"""Frames of the scene: moving things are drawn at several moments of the exposure, and the frame is their mean."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

from onebend.lab.filming.in_space import pixels, rolled
from onebend.lab.filming.raster import Image, PixelBox, box_around, coverage
from onebend.lab.filming.scene import Colour, Picture, Scene, backdrop, blend, lamp, light_at, yuv
from onebend.recording.camera.lens import project
from onebend.records import Array, View

Bytes = NDArray[np.uint8]
BLURRED = 4  # px: how far beyond what moves the lens blurs
BLACK, RANGE = 16.0, 219.0  # luma of a video
GREY, COLOUR_RANGE = 128.0, 224.0  # of its colour differences
COLOUR_NOISE = 0.5  # of the brightness's
GRAIN = 96  # px: the field of noise is so much larger than a picture


@dataclass(frozen=True)
class ColourLayer:
    """Polygons of one colour, neighbours on the table: their boxes together are hardly larger than they are."""

    loops: Array  # (..., corners, 2) m, or (..., corners, 3)
    colour: Colour
    late: Array | None = None  # the same as the last row is exposed; None: all rows are at once


@dataclass(frozen=True)
class Shadow:
    """What polygons (..., corners, 2) [m] keep from the light."""

    loops: Array
    density: float = 0.35
    soft: float = 5.0  # px, sd of its edge
    late: Array | None = None


@dataclass(frozen=True)
class Drawing:
    """What is drawn of one moment, the nearest to the camera last."""

    shadows: list[Shadow]
    layers: list[ColourLayer]
    shift: Array = field(default_factory=lambda: np.zeros((2, 2)))  # px, of the picture at its first and last row
    rows: int = 1  # of the picture


@dataclass(frozen=True)
class YuvFrame:
    """A frame as a video holds it: luma (H, W) and the two chroma planes at half the size."""

    y: Bytes
    u: Bytes
    v: Bytes


@dataclass(frozen=True)
class StaticScene:
    """What does not change over a film."""

    scene: Scene
    view: View
    table: Picture
    light: Image  # (H, W)
    half_light: Image
    scope: PixelBox  # holds whatever moves
    grain: Image  # (H + GRAIN, W + GRAIN) of unit sd


def stage(scene: Scene, view: View, size: tuple[int, int], still: Drawing, moving: Array, seed: int) -> StaticScene:
    """The table with what stands `still`, seen in `size` (width, height); all that moves is within `moving` (N, 2) m.

    Two stages of one seed look alike.
    """
    width, height = size
    table = backdrop(scene, view, (height, width), np.random.default_rng([seed, 10]))
    full = PixelBox(0, 0, width, height)
    darken(table, still, view, full)
    draw(table, still, view, full)
    light = lamp(scene, (height, width))
    scope = box_around(project(view, moving), width, height, margin=4.0 * BLURRED)
    rng = np.random.default_rng([seed, 11])
    grain = rng.standard_normal((height + GRAIN, width + GRAIN), dtype=np.float32)
    return StaticScene(scene, view, table, light, light[::2, ::2], scope, grain)


def seen_at(view: View, thing: ColourLayer | Shadow, drawing: Drawing) -> Array:
    """Pixels (..., corners, 2) of a thing in a drawing."""
    first = pixels(view, thing.loops)
    if thing.late is None and not np.any(drawing.shift):
        return first
    last = first if thing.late is None else pixels(view, thing.late)
    return rolled(first + drawing.shift[0], last + drawing.shift[1], drawing.rows)


def draw(picture: Picture, drawing: Drawing, view: View, scope: PixelBox) -> None:
    """Draw layers over `picture`, which shows the box `scope` of the whole, in place."""
    for layer in drawing.layers:
        px = seen_at(view, layer, drawing)
        box = clipped(box_around(px, scope.right, scope.bottom), scope)
        if 0 not in box.shape:
            blend(picture, coverage(px, box), yuv(layer.colour), box.within(scope), box.halved.within(scope.halved))


def darken(picture: Picture, drawing: Drawing, view: View, scope: PixelBox) -> None:
    """Lay shadows over `picture` in place. They are soft: half the resolution is enough."""
    for shadow in drawing.shadows:
        px = seen_at(view, shadow, drawing)
        box = clipped(box_around(px, scope.right, scope.bottom, margin=3.0 * shadow.soft), scope)
        if 0 in box.shape:
            continue
        cover = gaussian_filter(coverage(0.5 * px - 0.25, box.halved), 0.5 * shadow.soft, truncate=2.5)
        left = np.float32(1.0) - np.float32(shadow.density) * cover
        full, half = box.within(scope), box.halved.within(scope.halved)
        picture.y[full] *= np.repeat(np.repeat(left, 2, axis=0), 2, axis=1)
        picture.u[half] *= left
        picture.v[half] *= left


def clipped(box: PixelBox, scope: PixelBox) -> PixelBox:
    """The part of a box that is inside another; without area where none is."""
    left, top = max(box.left, scope.left), max(box.top, scope.top)
    return PixelBox(left, top, max(min(box.right, scope.right), left), max(min(box.bottom, scope.bottom), top))


def frame_of(staged: StaticScene, moments: list[Drawing], time: float, rng: np.random.Generator) -> YuvFrame:
    """The frame around `time` [s] as 8 bit planes: the mean over `moments` of its exposure, light, blur and noise.

    Shadows are those of the middle moment.
    """
    scope = staged.scope
    full, half = scope.slices, scope.halved.slices
    middle = moments[len(moments) // 2]
    seen = shifted(staged.table, middle.shift.mean(axis=0))
    under = Picture(seen.y[full], seen.u[half], seen.v[half])
    darken(under, middle, staged.view, scope)
    mean = Picture(np.zeros_like(under.y), np.zeros_like(under.u), np.zeros_like(under.v))
    for moment in moments:
        now = Picture(under.y.copy(), under.u.copy(), under.v.copy())
        draw(now, moment, staged.view, scope)
        mean.y[:] += now.y
        mean.u[:] += now.u
        mean.v[:] += now.v
    share = np.float32(1.0 / len(moments))
    rows, columns = (slice(BLURRED, side - BLURRED) for side in scope.shape)
    under.y[rows, columns] = gaussian_filter(mean.y * share, staged.scene.blur, truncate=3.5)[rows, columns]
    under.u[:], under.v[:] = mean.u * share, mean.v * share
    return exposed(staged, seen, np.float32(light_at(staged.scene, time)), rng)


def shifted(table: Picture, by: Array) -> Picture:
    """A copy of a picture, moved by (2,) px to the right and down."""
    if not np.any(by):
        return Picture(table.y.copy(), table.u.copy(), table.v.copy())
    y, u, v = (
        shift(plane, share * by[::-1], order=1, mode="nearest", prefilter=False)
        for plane, share in ((table.y, 1.0), (table.u, 0.5), (table.v, 0.5))
    )
    return Picture(y, u, v)


def exposed(staged: StaticScene, seen: Picture, strength: np.float32, rng: np.random.Generator) -> YuvFrame:
    """Light, noise and rounding: planes of 8 bit; `seen` is used up. The noise is a part of one large field."""
    scene = staged.scene
    size = np.float32(scene.noise / 255.0)
    out = []
    for plane, light, low, span, share in (
        (seen.y, staged.light, BLACK, RANGE, 1.0),
        (seen.u, staged.half_light, GREY, COLOUR_RANGE, COLOUR_NOISE),
        (seen.v, staged.half_light, GREY, COLOUR_RANGE, COLOUR_NOISE),
    ):
        level = np.multiply(plane, light, out=plane)  # in place: fresh memory costs more than the sums
        level *= strength
        noise = np.multiply(grain_of(staged.grain, level.shape, rng), size * np.float32(share))
        if share == 1.0:
            spread = np.abs(level)
            spread *= np.float32(1.2)
            spread += np.float32(0.4)
            noise *= np.sqrt(spread, out=spread)
        level += noise
        level *= np.float32(span)
        level += np.float32(low + 0.5)
        out.append(np.clip(level, 0.0, 255.0, out=level).astype(np.uint8))
    return YuvFrame(out[0], out[1], out[2])


def grain_of(field: Image, shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """A part (rows, columns) of a field of noise from a random place, mirrored at random."""
    down, across = rng.integers(0, GRAIN, 2).tolist()
    part = field[down : down + shape[0], across : across + shape[1]]
    turn = int(rng.integers(0, 4))
    part = part[::-1] if turn & 1 else part
    part = part[:, ::-1] if turn & 2 else part
    return -part if rng.random() < 0.5 else part
