"""Rendering: a frame is the mean of several moments of its exposure."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite, nan
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift, zoom
from scipy.spatial.transform import Rotation

from onebend.errors import RecordingError
from onebend.recording.entries import CameraEntry
from onebend.recording.plane import FACING, project
from onebend.records import Array, View, paired, rotated, unit

# Coverage of pixels by polygons: exact along rows, sampled finely across them. Every edge adds, in the lines it
# crosses, the area to its right; the sum along a row is the coverage. Polygons of one orientation that share an edge
# show no seam.

Image = NDArray[np.float32]
Plane = NDArray[Any]  # float32 or uint8
LINES = 8  # per row of pixels


@dataclass(frozen=True)
class PixelBox:
    """Pixels from (left, top) to (right, bottom), exclusive."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return max(self.bottom - self.top, 0), max(self.right - self.left, 0)

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def halved(self) -> PixelBox:
        """In a picture of half the size; edges are even."""
        return PixelBox(self.left // 2, self.top // 2, self.right // 2, self.bottom // 2)

    def within(self, outer: PixelBox) -> tuple[slice, slice]:
        """Rows and columns in `outer`."""
        down, across = self.top - outer.top, self.left - outer.left
        return slice(down, down + self.shape[0]), slice(across, across + self.shape[1])


def box_around(points: Array, width: int, height: int, margin: float = 2.0) -> PixelBox:
    """The box with even edges around pixels (..., 2), clipped to the picture."""
    flat = points.reshape(-1, 2)
    low, high = flat.min(axis=0) - margin, flat.max(axis=0) + margin
    left, top = np.clip(2 * np.floor(low / 2), 0, (width, height)).astype(int).tolist()
    right, bottom = np.clip(2 * np.ceil(high / 2), 0, (width, height)).astype(int).tolist()
    return PixelBox(left, top, max(right, left), max(bottom, top))


def edges_of(loops: Array) -> Array:
    """Edges (E, 4) x0, y0, x1, y1 of closed polygons (..., corners, 2)."""
    nodes = loops.reshape(-1, *loops.shape[-2:])
    return np.concatenate([nodes, np.roll(nodes, -1, axis=1)], axis=-1).reshape(-1, 4)


def coverage(loops: Array, box: PixelBox) -> Image:
    """Covered share of each pixel of `box` (rows, columns), for polygons (..., corners, 2) [px] of one orientation."""
    rows, columns = box.shape
    if rows == 0 or columns == 0:
        return np.zeros((rows, columns), dtype=np.float32)
    x0, y0, x1, y1 = (edges_of(loops) + 0.5 - np.array([box.left, box.top] * 2)).T  # pixel edges at whole numbers
    low, high = np.minimum(y0, y1) * LINES, np.maximum(y0, y1) * LINES
    first = np.clip(np.ceil(low - 0.5), 0, rows * LINES).astype(np.int64)
    count = np.clip(np.ceil(high - 0.5), 0, rows * LINES).astype(np.int64) - first
    edge = np.repeat(np.arange(len(count)), count)
    line = first[edge] + np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    slope = (x1 - x0)[edge] / (y1 - y0)[edge]
    x = np.clip(x0[edge] + ((line + 0.5) / LINES - y0[edge]) * slope, 0.0, columns)
    sign = np.where(y1 > y0, 1.0, -1.0)[edge] / LINES
    pixel = np.floor(x).astype(np.int64)
    part = x - pixel
    at = (line // LINES) * (columns + 2) + pixel
    size = rows * (columns + 2)
    steps = np.bincount(np.concatenate([at, at + 1]), np.concatenate([sign * (1.0 - part), sign * part]), size)
    sums = np.cumsum(steps.astype(np.float32).reshape(rows, -1), axis=1)[:, :columns]
    return np.asarray(np.minimum(np.abs(sums), np.float32(1.0)))


Colour = tuple[float, float, float]  # 0 to 1
Backdrop = Literal["wood", "mat", "cloth", "plain"]
BACKDROPS: dict[Backdrop, tuple[tuple[int, int], Colour, float]] = {  # grain [px], colour, variation
    "wood": ((3, 60), (0.55, 0.36, 0.19), 0.5),
    "mat": ((14, 14), (0.22, 0.40, 0.30), 0.35),
    "cloth": ((10, 10), (0.56, 0.57, 0.60), 0.35),
    "plain": ((60, 60), (0.70, 0.70, 0.68), 0.03),
}
TO_YUV = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])  # BT.601


def check_name(name: str, names: object, what: str) -> str:
    """The name. Raises `RecordingError`: it is not one of `names`."""
    known = get_args(names)
    if name not in known:
        raise RecordingError(f"there is no {what} {name!r}. Take one of {', '.join(known)}.")
    return name


@dataclass(frozen=True)
class Scene:
    """Appearance; times are those of the film."""

    backdrop: Backdrop = "wood"
    beam: Colour = (0.80, 0.77, 0.74)
    clamp: Colour = (0.28, 0.29, 0.30)
    tool: Colour = (0.28, 0.30, 0.31)
    hand: Colour = (0.36, 0.24, 0.21)
    paper: float = 0.90  # brightness of the paper
    ink: float = 0.12
    print_dpi: float = 2400.0  # of the tags' printer; 0: exact edges
    brightness: float = 1.0
    falloff: float = 0.2  # of the light, from brightest place to farthest corner
    brightest: tuple[float, float] = (0.6, 0.4)  # as shares of width and height
    flicker: float = 0.03  # largest relative change of the light
    flicker_time: float = 3.0  # s, period
    step: float = 0.0  # jump of the light at `step_at`
    step_at: float = inf  # s
    exposure: float = 0.01  # s
    blur: float = 0.7  # px, sd of the lens's point spread
    noise: float = 1.5  # of 255, sd per pixel at middle brightness
    overlap: float = 0.0  # m the tool reaches over the beam's edge and its tags
    tool_width: float = 0.007  # m
    slant: float = 0.3  # rad, tool against push
    hand_at: float = inf  # s, when a hand passes over the beam
    crf: int = 20  # H.264 quality: 0 lossless, 51 worst

    def __post_init__(self) -> None:
        check_name(self.backdrop, Backdrop, "backdrop")
        if (
            min(self.exposure, self.blur, self.noise, self.tool_width, self.print_dpi) < 0.0
            or not 0.0 <= self.falloff < 1.0
        ):
            raise RecordingError("exposure, blur, noise and dots per inch cannot be negative; falloff is in [0, 1)")
        if not 0 <= self.crf <= 51:
            raise RecordingError(f"H.264 knows qualities from 0 to 51, got {self.crf}")


@dataclass(frozen=True)
class Picture:
    """Brightness (H, W), and two colour differences at half the size; levels from 0 to 1, or bytes of a film."""

    y: Plane
    u: Plane
    v: Plane

    @property
    def planes(self) -> tuple[Plane, Plane, Plane]:
        return self.y, self.u, self.v

    def copy(self) -> Picture:
        return Picture(*(plane.copy() for plane in self.planes))


def yuv(colour: Colour) -> tuple[float, float, float]:
    """Brightness 0 to 1 and two colour differences -0.5 to 0.5."""
    y, u, v = (TO_YUV @ np.array(colour)).tolist()
    return y, u, v


def backdrop(scene: Scene, view: View, shape: tuple[int, int], rng: np.random.Generator) -> Picture:
    """The table (H, W), blurred by the lens."""
    height, width = shape
    grain, base, swing = BACKDROPS[scene.backdrop]
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
    """A random field, about -1 to 1, with structures from `grain` (rows, columns) px up."""
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
    """Coverage (H, W) by the lines of a cutting mat."""
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
    turn = np.linspace(0.0, 2.0 * np.pi, 33)[:-1]
    loop = centre + radius * unit(turn)
    height, width = picture.y.shape
    box = box_around(loop, width, height)
    blend(picture, coverage(loop[None], box), yuv(colour), box.slices, box.halved.slices)


def blend(
    picture: Picture,
    cover: Image,
    colour: tuple[float, float, float],
    full: tuple[slice, slice],
    half: tuple[slice, slice],
) -> None:
    """Lay a colour over `picture` in place, weighted by `cover`."""
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
    """(H, W) relative light, 1 at the brightest."""
    height, width = shape
    x = (np.arange(width) / width - scene.brightest[0]) * width / height
    y = np.arange(height) / height - scene.brightest[1]
    square = x[None, :] ** 2 + y[:, None] ** 2
    return np.asarray(scene.brightness * (1.0 - scene.falloff * square / square.max()), dtype=np.float32)


def light_at(scene: Scene, time: float) -> float:
    """The lamp's relative strength."""
    wave = scene.flicker * np.sin(2.0 * np.pi * time / scene.flicker_time)
    return float(1.0 + wave + (scene.step if time >= scene.step_at else 0.0))


MARGIN = 0.06  # of the shorter side: margin around what has to be seen
CLOSER, TRIES = 1.03, 200  # search for a distance
NEAREST = 0.05  # m


@dataclass(frozen=True)
class Camera:
    """A fixed pinhole camera with a lens, tilted. Without a `distance` it stands as near as the view allows."""

    width: int = 1280  # px
    height: int = 720  # px
    focal: float = 1200.0  # px
    centre: tuple[float, float] = (0.0, 0.0)  # px, principal point from the picture's middle
    dist: tuple[float, float, float, float, float] = (-0.06, 0.02, 0.0004, -0.0003, 0.0)  # k1 k2 p1 p2 k3
    tilt: tuple[float, float] = (0.03, 0.0)  # rad, about the picture's x and y axes
    roll: float = 0.0  # rad, counter-clockwise turn of the table in the picture
    distance: float = nan  # m

    def __post_init__(self) -> None:
        if self.width < 64 or self.height < 64 or self.width % 2 or self.height % 2:
            raise RecordingError(f"a film needs even sides of 64 px or more, got {self.width} x {self.height}")
        if not (self.focal > 0.0 and isfinite(self.focal)):
            raise RecordingError(f"a camera needs a focal length above zero, got {self.focal} px")
        if isfinite(self.distance) and not self.distance >= NEAREST:
            raise RecordingError(f"a camera stands at least {NEAREST} m away, got {self.distance} m")
        if max(abs(v) for v in self.tilt) > 1.0:
            raise RecordingError("a camera is tilted by less than a radian (57 degrees)")

    @property
    def matrix(self) -> Array:
        """(3, 3) px."""
        cx, cy = (self.width - 1) / 2 + self.centre[0], (self.height - 1) / 2 + self.centre[1]
        return np.array([[self.focal, 0.0, cx], [0.0, self.focal, cy], [0.0, 0.0, 1.0]])


def view_from(camera: Camera, points: Array) -> View:
    """The view towards the middle of `points` (N, 2) [m]. Raises `RecordingError`: some are outside the picture."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    distance = camera.distance
    if isfinite(distance):
        view = looking(camera, middle, distance)
        if not all_seen(camera, view, points, 0.0):
            raise RecordingError(
                f"from {distance:.3g} m the camera does not see the whole push. Give it a larger distance, or none."
            )
        return view
    distance = NEAREST
    for _ in range(TRIES):
        view = looking(camera, middle, distance)
        if all_seen(camera, view, points, MARGIN * min(camera.width, camera.height)):
            return view
        distance *= CLOSER
    raise RecordingError("no distance shows the whole push through this lens. Give a lens with less distortion.")


def looking(camera: Camera, middle: Array, distance: float) -> View:
    """The view whose principal ray meets the table at `middle` (2,), at `distance` [m]."""
    tilt = Rotation.from_euler("xy", camera.tilt).as_matrix()
    turn = Rotation.from_euler("z", camera.roll).as_matrix()
    rotation = tilt @ FACING @ turn
    return View(
        matrix=camera.matrix,
        dist=np.array(camera.dist),
        rotation=rotation,
        translation=np.array([0.0, 0.0, distance]) - rotation[:, :2] @ middle,
        calibrated=True,
        corner_sd=0.0,
    )


def all_seen(camera: Camera, view: View, points: Array, margin: float) -> bool:
    """Whether all points are in front of the camera and `margin` [px] inside the picture."""
    depth = points @ view.rotation[2, :2] + view.translation[2]
    if np.any(depth < 0.2 * view.translation[2]) or np.any(depth <= 0.0):
        return False
    px = project(view, points)
    return bool(np.all(px > margin) and np.all(px < np.array([camera.width, camera.height]) - 1 - margin))


def calibration(camera: Camera) -> CameraEntry:
    """The exact calibration, rounded as written."""
    matrix = camera.matrix
    return CameraEntry(
        width=camera.width,
        height=camera.height,
        fx=round(camera.focal, 3),
        fy=round(camera.focal, 3),
        cx=round(float(matrix[0, 2]), 3),
        cy=round(float(matrix[1, 2]), 3),
        dist=tuple(round(v, 6) for v in camera.dist),
    )


ROW_ITERATIONS = 4  # things move by far less than a picture during readout


def placed_in_space(loops: Array, pose: Array) -> Array:
    """Polygons (..., corners, 2) [m] at the pose (6,): x, y, angle, z, tilts [rad] about its x axis, then upwards along
    it.

    Returns (..., corners, 3), or (..., corners, 2) in the plane.
    """
    turn, height, roll, slope = pose[2:].tolist()
    if height == 0.0 and roll == 0.0 and slope == 0.0:
        return rotated(loops, turn) + pose[:2]
    u, v = loops[..., 0], loops[..., 1]
    up = v * np.sin(roll)
    flat = paired(u * np.cos(slope) - up * np.sin(slope), v * np.cos(roll))
    z = height + u * np.sin(slope) + up * np.cos(slope)
    return np.concatenate([rotated(flat, turn) + pose[:2], z[..., None]], axis=-1)


def lifted(xy: Array, z: Array) -> Array:
    """(..., 3) m from (..., 2) and heights (...,); unchanged if all lie in the plane."""
    return np.concatenate([xy, z[..., None]], axis=-1) if np.any(z) else xy


def rolled(at: Array, rows: int) -> Array:
    """Pixels (..., 2) of things seen at `at` (3, ..., 2) as the first, middle and last row is exposed.

    Things move along a parabola; each is seen when its own row is: v = v(share), share = v / rows.
    """
    seen = at[0]
    for _ in range(ROW_ITERATIONS):
        u = np.clip(seen[..., 1:] / rows, 0.0, 1.0)
        seen = (1.0 - u) * (1.0 - 2.0 * u) * at[0] + 4.0 * u * (1.0 - u) * at[1] + u * (2.0 * u - 1.0) * at[2]
    return np.asarray(seen)


BLURRED = 4  # px of blur beyond what moves
BLACK, RANGE = 16.0, 219.0  # luma of a video
GREY, COLOUR_RANGE = 128.0, 224.0  # of its colour differences
COLOUR_NOISE = 0.5  # relative to the brightness's
GRAIN = 96  # px by which the noise field exceeds the picture


@dataclass(frozen=True)
class ColourLayer:
    """Neighbouring polygons of one colour."""

    loops: Array  # (..., corners, 2) m, or (..., corners, 3)
    colour: Colour
    late: tuple[Array, ...] = ()  # the same at the middle and last row; (): all rows at once


@dataclass(frozen=True)
class Shadow:
    """The shadow of polygons (..., corners, 2) [m]."""

    loops: Array
    density: float = 0.35
    soft: float = 5.0  # px, sd of its edge
    late: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Drawing:
    """Shadows and layers of one moment, nearest the camera last."""

    shadows: list[Shadow]
    layers: list[ColourLayer]
    shift: Array = field(default_factory=lambda: np.zeros((3, 2)))  # px, at the first, middle and last row
    rows: int = 1  # of the picture


@dataclass(frozen=True)
class StaticScene:
    scene: Scene
    view: View
    table: Picture
    light: Image  # (H, W)
    scope: PixelBox  # around all that moves
    grain: Image  # (H + GRAIN, W + GRAIN) of unit sd


def stage(scene: Scene, view: View, size: tuple[int, int], still: Drawing, moving: Array, seed: int) -> StaticScene:
    """The table with what stands `still`, `size` (width, height); all motion is within `moving` (N, 2) m.

    Equal seeds look alike.
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
    return StaticScene(scene, view, table, light, scope, grain)


def seen_at(view: View, thing: ColourLayer | Shadow, drawing: Drawing) -> Array:
    """Pixels (..., corners, 2)."""
    first = project(view, thing.loops)
    if not thing.late and not np.any(drawing.shift):
        return first
    later = [project(view, loops) for loops in thing.late] or [first, first]
    shift = drawing.shift.reshape(3, *[1] * (first.ndim - 1), 2)
    return rolled(np.stack([first, *later]) + shift, drawing.rows)


def draw(picture: Picture, drawing: Drawing, view: View, scope: PixelBox) -> None:
    """Draw layers in place; `picture` shows the box `scope`."""
    for layer in drawing.layers:
        px = seen_at(view, layer, drawing)
        box = clipped(box_around(px, scope.right, scope.bottom), scope)
        if 0 not in box.shape:
            blend(picture, coverage(px, box), yuv(layer.colour), box.within(scope), box.halved.within(scope.halved))


def darken(picture: Picture, drawing: Drawing, view: View, scope: PixelBox) -> None:
    """Lay soft shadows in place, at half the resolution."""
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
    """The intersection, without area if there is none."""
    left, top = max(box.left, scope.left), max(box.top, scope.top)
    return PixelBox(left, top, max(min(box.right, scope.right), left), max(min(box.bottom, scope.bottom), top))


def frame_of(staged: StaticScene, moments: list[Drawing], time: float, rng: np.random.Generator) -> Picture:
    """The frame around `time` [s] as 8 bit planes: mean over `moments` of its exposure, light, blur and noise.

    Shadows are those of the middle moment.
    """
    scope = staged.scope
    full, half = scope.slices, scope.halved.slices
    middle = moments[len(moments) // 2]
    seen = shifted(staged.table, middle.shift[1])
    under = Picture(seen.y[full], seen.u[half], seen.v[half])
    darken(under, middle, staged.view, scope)
    mean = Picture(*map(np.zeros_like, under.planes))
    for moment in moments:
        now = under.copy()
        draw(now, moment, staged.view, scope)
        for total, plane in zip(mean.planes, now.planes, strict=True):
            total += plane
    share = np.float32(1.0 / len(moments))
    rows, columns = (slice(BLURRED, side - BLURRED) for side in scope.shape)
    under.y[rows, columns] = gaussian_filter(mean.y * share, staged.scene.blur, truncate=3.5)[rows, columns]
    under.u[:], under.v[:] = mean.u * share, mean.v * share
    return exposed(staged, seen, np.float32(light_at(staged.scene, time)), rng)


def shifted(table: Picture, by: Array) -> Picture:
    """A copy moved by (2,) px right and down."""
    if not np.any(by):
        return table.copy()
    moved = (
        shift(plane, share * by[::-1], order=1, mode="nearest", prefilter=False)
        for plane, share in zip(table.planes, (1.0, 0.5, 0.5), strict=True)
    )
    return Picture(*moved)


def exposed(staged: StaticScene, seen: Picture, strength: np.float32, rng: np.random.Generator) -> Picture:
    """8 bit planes with light, noise and rounding; overwrites `seen`. The noise is cut from one large field."""
    scene = staged.scene
    size = np.float32(scene.noise / 255.0)
    out = []
    for plane, light, low, span, share in (
        (seen.y, staged.light, BLACK, RANGE, 1.0),
        (seen.u, staged.light[::2, ::2], GREY, COLOUR_RANGE, COLOUR_NOISE),
        (seen.v, staged.light[::2, ::2], GREY, COLOUR_RANGE, COLOUR_NOISE),
    ):
        level = np.multiply(plane, light, out=plane)  # in place: fresh memory costs more than the arithmetic
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
    return Picture(out[0], out[1], out[2])


def grain_of(field: Image, shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """A random part (rows, columns) of a noise field, randomly mirrored."""
    down, across = rng.integers(0, GRAIN, 2).tolist()
    part = field[down : down + shape[0], across : across + shape[1]]
    turn = int(rng.integers(0, 4))
    part = part[::-1] if turn & 1 else part
    part = part[:, ::-1] if turn & 2 else part
    return -part if rng.random() < 0.5 else part
