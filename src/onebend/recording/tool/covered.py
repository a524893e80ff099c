"""What lies beside the beam, in places along and across it: where something other than the background is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import map_coordinates, uniform_filter

from onebend.recording.camera.lens import project
from onebend.records import Array, BoolArray, Markers, View

Pictures = NDArray[np.float32]  # (P, h, w)

BEAM_PIXELS = 230.0  # no longer is the beam in the shrunk pictures: noise averages out, a tool stays some pixels wide
STEPS = 180  # of the grid, in a beam's length
S_RANGE = (0.2, 1.4)  # nearer to the clamp the beam hardly moves; beyond the tip a tool's other half may be
ACROSS = 0.24  # of the length, to each side
DIFFERS = 5.0  # sds of the background's noise: a pixel that is farther off shows something else
QUIETEST = 0.1  # of 255: no camera's noise is less, a film without any is a drawing
THIN = 4  # of rows and columns, for a picture's brightness


@dataclass(frozen=True)
class SideGrid:
    """Places beside the beam: along its axis, and across it (left is above zero)."""

    s: Array  # (S,)
    across: Array  # (D,) m
    length: float  # m

    @property
    def step(self) -> float:
        """m, both ways."""
        return self.length / STEPS


def grid_of(length: float) -> SideGrid:
    """The places that are looked at beside a beam of this length [m]."""
    half = round(ACROSS * STEPS)
    count = round((S_RANGE[1] - S_RANGE[0]) * STEPS) + 1
    return SideGrid(S_RANGE[0] + np.arange(count) / STEPS, np.arange(-half, half + 1) * length / STEPS, length)


def shrink_factor(view: View, length: float) -> int:
    """How many pixels of the film, each way, make one of the shrunk pictures."""
    ends = project(view, np.array([[0.0, 0.0], [length, 0.0]]))
    return max(1, math.ceil(float(np.linalg.norm(ends[1] - ends[0])) / BEAM_PIXELS))


def shrunk(picture: NDArray[np.uint8], factor: int) -> NDArray[np.float32]:
    """(h, w), the mean of every `factor` x `factor` pixels; rows and columns that are left over are cut off."""
    h, w = (side // factor for side in picture.shape)
    total = np.zeros((h, w), dtype=np.uint32)
    for row in range(factor):
        for column in range(factor):
            total += picture[row : h * factor : factor, column : w * factor : factor]
    return np.asarray(total.astype(np.float32) / np.float32(factor**2))


def deviations(pictures: Pictures, by: BoolArray | None = None) -> Pictures:
    """How far every pixel of `pictures` (P, h, w) is from its background, in sds of its noise.

    The background is the median over the pictures, after each is brought to the same brightness; of those `by` (P,)
    alone where given. Noise is the median deviation of the pixel from it there, which a camera that shakes makes large
    at edges; it is nowhere taken to be smaller than the pictures' typical one.
    """
    by = np.ones(len(pictures), dtype=bool) if by is None else by
    background = middle(pictures[by])
    thin = (slice(None), slice(None, None, THIN), slice(None, None, THIN))
    ratio = pictures[thin] / np.maximum(background[thin[1:]], 1.0)
    brightness = np.maximum(np.median(ratio, axis=(1, 2)), 1e-3)[:, None, None].astype(np.float32)
    even = pictures / brightness
    away = np.abs(even - middle(even[by]))
    noise = 1.4826 * middle(away[by])
    floor = max(float(np.median(noise)), QUIETEST)
    return np.asarray(away / np.maximum(uniform_filter(noise, 3), floor))


def middle(pictures: Pictures) -> NDArray[np.float32]:
    """(h, w) the median of `pictures` (P, h, w), as `numpy.median` makes it in six times the time."""
    ordered, half = np.sort(pictures, axis=0), len(pictures) // 2
    return np.asarray(ordered[half] if len(pictures) % 2 else (ordered[half - 1] + ordered[half]) * np.float32(0.5))


def axes_of(markers: Markers, rows: Sequence[int], grid: SideGrid) -> tuple[Array, Array]:
    """The beam's axis (P, S, 2) [m] and the unit normals to its left (P, S, 2) in frames `rows`, in the markers' frame.

    A cubic through clamp and tags that has their directions; straight on beyond the last.
    """
    centre = np.full((len(rows), len(grid.s), 2), np.nan)
    tangent = np.full_like(centre, np.nan)
    for at, row in enumerate(rows):
        seen = np.isfinite(markers.xy[row]).all(axis=-1) & np.isfinite(markers.angle[row])
        s = np.concatenate([[0.0], markers.s[seen]])
        xy = np.concatenate([np.zeros((1, 2)), markers.xy[row, seen]])
        angle = np.concatenate([[0.0], markers.angle[row, seen]])
        s, first = np.unique(s, return_index=True)
        slopes = grid.length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        axis = CubicHermiteSpline(s, xy[first], slopes[first])
        inside = np.clip(grid.s, s[0], s[-1])
        along = axis(inside, 1)
        tangent[at] = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
        centre[at] = axis(inside) + (grid.s - inside)[:, None] * grid.length * tangent[at]
    return centre, np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)


def beside_beam(
    different: Pictures, factor: int, view: View, centre: Array, normal: Array, grid: SideGrid
) -> NDArray[np.float32]:
    """(P, S, D) the shrunk pictures `different` beside the beam, whose axis is at `centre` (P, S, 2) [m] with normals
    `normal` (P, S, 2); NaN outside the picture."""
    out = np.empty((len(different), len(grid.s), len(grid.across)), dtype=np.float32)
    for at, picture in enumerate(different):
        points = centre[at][:, None] + grid.across[:, None] * normal[at][:, None]
        px = (project(view, points) + 0.5) / factor - 0.5
        out[at] = map_coordinates(picture, [px[..., 1], px[..., 0]], order=1, mode="constant", cval=np.nan)
    return out
