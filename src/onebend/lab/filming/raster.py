"""How much of each pixel polygons cover: exact along the rows of the picture, sampled finely across them.

Every edge adds, in the lines that it crosses, what lies to its right; the sum along a row is the coverage. Polygons
that share an edge and have one orientation leave no seam between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onebend.records import Array

Image = NDArray[np.float32]
LINES = 8  # a row of pixels


@dataclass(frozen=True)
class PixelBox:
    """Pixels from (left, top) up to but not including (right, bottom)."""

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
        """Rows and columns of the whole picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def halved(self) -> PixelBox:
        """The same box in a picture of half the size; the edges are even."""
        return PixelBox(self.left // 2, self.top // 2, self.right // 2, self.bottom // 2)

    def within(self, outer: PixelBox) -> tuple[slice, slice]:
        """Rows and columns of `outer`, which holds this box."""
        down, across = self.top - outer.top, self.left - outer.left
        return slice(down, down + self.shape[0]), slice(across, across + self.shape[1])


def box_around(points: Array, width: int, height: int, margin: float = 2.0) -> PixelBox:
    """The box with even edges around pixels (..., 2), within a picture with even sides."""
    flat = points.reshape(-1, 2)
    low, high = flat.min(axis=0) - margin, flat.max(axis=0) + margin
    left, top = (int(np.clip(2 * np.floor(v / 2), 0, side)) for v, side in zip(low, (width, height), strict=True))
    right, bottom = (int(np.clip(2 * np.ceil(v / 2), 0, side)) for v, side in zip(high, (width, height), strict=True))
    return PixelBox(left, top, max(right, left), max(bottom, top))


def edges_of(loops: Array) -> Array:
    """Edges (E, 4) x0, y0, x1, y1 of closed polygons (..., corners, 2)."""
    nodes = loops.reshape(-1, *loops.shape[-2:])
    return np.concatenate([nodes, np.roll(nodes, -1, axis=1)], axis=-1).reshape(-1, 4)


def coverage(loops: Array, box: PixelBox) -> Image:
    """Share of each pixel of `box` (rows, columns) that polygons (..., corners, 2) [px] of one orientation cover."""
    rows, columns = box.shape
    if rows == 0 or columns == 0:
        return np.zeros((rows, columns), dtype=np.float32)
    x0, y0, x1, y1 = (edges_of(loops) + 0.5 - np.array([box.left, box.top] * 2)).T  # a pixel's edges at whole numbers
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
