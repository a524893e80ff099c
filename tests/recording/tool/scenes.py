"""Small pictures of a beam that is pushed over a grained table, with a tool that touches it at a known place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from onebend.recording.photos import smaller_view
from onebend.recording.plane import camera_place, to_plane
from onebend.recording.tool import ToolPlace, tool_place
from onebend.records import Array, BoolArray, Markers
from tests.recording.filmed import HEIGHT, LENGTH, SIZE, WIDTH, poses, view

FACTOR = 2  # of the film's pixels to those of the pictures
FRAMES, REST = 36, 4  # in all, and at rest before and after the push
HALF = 0.006  # m, of the beam's width
TABLE, BEAM, STEEL = 120.0, 190.0, 60.0
Bar = Callable[[int, Array, float], tuple[Array, Array] | None]  # frame, end [m], angle: where it ends, its direction


@dataclass(frozen=True)
class Filmed:
    """Shrunk pictures with the tags in them."""

    pictures: np.ndarray  # (P, h, w)
    markers: Markers
    loaded: BoolArray

    def place(self) -> ToolPlace:
        pictures = [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in self.pictures]
        return tool_place(pictures, self.markers, self.loaded, length=LENGTH, tag_size=SIZE)


@cache
def plane() -> Array:
    """(h, w, 2) m, where the pictures' pixels look at the table."""
    rows, columns = np.mgrid[: HEIGHT // FACTOR, : WIDTH // FACTOR]
    return to_plane(view(), np.stack([columns, rows], axis=-1) * FACTOR + 0.5 * (FACTOR - 1.0))


def bends() -> Array:
    """(P, 4, 3) tags while the beam is at rest, pushed and at rest again."""
    pushed = poses(FRAMES - 2 * REST + 2)[1:-1]
    return np.concatenate([np.repeat(poses(2)[:1], REST, axis=0), pushed, np.repeat(poses(2)[:1], REST, axis=0)])


def axis_of(tags: Array, s: Array) -> tuple[Array, Array]:
    """Points (S, 2) m and angles (S,) of the beam, an arc of the tip's turn: as `poses` draws it."""
    turn = max(float(tags[-1, 2]), 1e-6)
    angle = turn * s
    return LENGTH / turn * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1), angle


def filmed(*bars: tuple[float, Bar], seed: int = 0, shake: float = 0.0) -> Filmed:
    """The push, with bars that end at places s of the beam's right flank."""
    rng = np.random.default_rng(seed)
    table = TABLE + 250.0 * gaussian_filter(rng.standard_normal(plane().shape[:2]), 3.0)
    s, tags, pictures = np.linspace(0.0, 1.0, 151), bends(), []
    for frame, row in enumerate(tags):
        picture, (points, angles) = table.copy(), axis_of(row, s)
        for at, bar in bars:
            i = int(np.argmin(np.abs(s - at)))
            end = points[i] + HALF * np.array([np.sin(angles[i]), -np.cos(angles[i])])
            drawn = bar(frame, end, float(angles[i]))
            if drawn is not None:
                picture[covered_by(*drawn)] = STEEL
        distance, _ = cKDTree(points).query(plane().reshape(-1, 2), distance_upper_bound=HALF)
        picture[np.isfinite(distance).reshape(picture.shape)] = BEAM
        moved = np.roll(picture, np.rint(shake * rng.standard_normal(2)).astype(int), axis=(0, 1))
        pictures.append(moved + 1.5 * rng.standard_normal(picture.shape))
    loaded = (np.arange(FRAMES) >= REST) & (np.arange(FRAMES) < FRAMES - REST)
    return Filmed(np.array(pictures, dtype=np.float32), markers_of(tags), loaded)


def covered_by(end: Array, direction: Array, width: float = 0.006, length: float = 0.12) -> BoolArray:
    """(h, w) the pixels of a bar that goes from its end [m] on in a direction, half its width below the tags."""
    foot, distance = camera_place(view())
    away = foot + (1.0 + 0.5 * width / distance) * (plane() - foot) - end
    along = away @ direction
    aside = np.abs(away @ np.array([-direction[1], direction[0]]))
    return np.asarray((along >= 0.0) & (along < length) & (aside < 0.5 * width))


def in_contact(frame: int) -> bool:
    return REST - 1 <= frame < FRAMES - REST + 1


def in_room(slant: float, *, gap: float = 0.0, always: bool = False) -> Bar:
    """A bar that keeps its direction, by `slant` [rad] from straight below; it comes and goes, and keeps a `gap`."""

    def bar(frame: int, end: Array, _: float) -> tuple[Array, Array] | None:
        direction = np.array([np.sin(slant), -np.cos(slant)])
        return (end + gap * direction, direction) if always or in_contact(frame) else None

    return bar


def with_beam(slant: float, *, always: bool = False) -> Bar:
    """A bar that turns with the beam."""

    def bar(frame: int, end: Array, angle: float) -> tuple[Array, Array] | None:
        return in_room(slant + angle, always=always)(frame, end, angle)

    return bar


def sometimes(bar: Bar, every: int) -> Bar:
    """A bar that is there in one of so many frames."""
    return lambda frame, end, angle: bar(frame, end, angle) if frame % every == 0 else None


def markers_of(tags: Array) -> Markers:
    """The tags (P, 4, 3) as read without error."""
    count = len(tags)
    return Markers(
        time=np.arange(count) / 30.0,
        tag_id=np.arange(1, 4),
        s=np.array([1 / 3, 2 / 3, 1.0]),
        xy=tags[:, 1:, :2],
        angle=tags[:, 1:, 2],
        covariance=np.broadcast_to(1e-10 * np.eye(3), (count, 3, 3, 3)),
        base_angle=np.zeros(count),
        view=smaller_view(view(), FACTOR),
    )


def mirrored(film: Filmed) -> Filmed:
    """The same, pushed to the other side: rows of the pictures in reverse, with a camera to match."""
    seen = film.markers.view
    assert seen is not None
    flip = np.diag([1.0, -1.0, 1.0])
    matrix, dist = seen.matrix.copy(), seen.dist.copy()
    matrix[1, 2] = HEIGHT // FACTOR - 1 - matrix[1, 2]
    dist[2] = -dist[2]  # the lens's part that is not even in y
    turned = np.array([1.0, -1.0])
    return replace(
        film,
        pictures=film.pictures[:, ::-1],
        markers=replace(
            film.markers,
            xy=film.markers.xy * turned,
            angle=-film.markers.angle,
            view=replace(
                seen, matrix=matrix, dist=dist, rotation=flip @ seen.rotation @ np.diag([1.0, -1.0, -1.0]) @ np.eye(3),
                translation=flip @ seen.translation,
            ),
        ),
    )  # fmt: skip
