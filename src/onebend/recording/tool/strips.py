"""Strips that come from outside and end on the beam's flank: what a tool looks like beside the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from onebend.recording.signals import runs
from onebend.recording.tool.covered import Grid
from onebend.records import Array, BoolArray, IntArray

MOSTLY = 0.5  # share of the frames: what pushes is there in most of them
CLOSES = 3  # cells: holes as small as this are filled
WIDER = 1.6  # times its usual width: a strip that becomes so wide has run into the beam
ROOM = 3  # cells of width more, for the same
NEAR = 0.08  # of the length: the strip's last part, which tells where it meets the beam


@dataclass(frozen=True)
class Strip:
    """A strip, row by row from outside to the flank."""

    rows: IntArray  # (R,) of the grid's `across`
    first: IntArray  # (R,) of the grid's `s`
    last: IntArray  # (R,) likewise, the first one beyond
    flank: int  # the row in which it has run into the beam

    def near(self, grid: Grid) -> Strip:
        """Its part by the beam."""
        count = min(len(self.rows), max(2, round(NEAR * grid.length / grid.step)))
        return Strip(self.rows[-count:], self.first[-count:], self.last[-count:], self.flank)

    def meets(self, grid: Grid) -> tuple[float, float]:
        """s at which its middle line, drawn on straight, meets the flank, and the sd of that."""
        middle = 0.5 * (grid.s[self.first] + grid.s[self.last - 1])
        out = grid.across[self.rows] - grid.across[self.flank]
        slope, place = np.polyfit(out, middle, 1)
        scatter = middle - (place + slope * out)
        lever = 1.0 / len(out) + out.mean() ** 2 / max(float(np.sum((out - out.mean()) ** 2)), 1e-300)
        # rows next to each other show the same pixels: about as many of them are independent as the strip is wide
        together = max(1.0, float(np.median(self.last - self.first)))
        return float(place), float(np.sqrt(np.mean(scatter**2) * lever * together))

    def width(self, grid: Grid) -> float:
        """m, along the beam."""
        return float(np.median(self.last - self.first)) * grid.step

    def cells(self, shape: tuple[int, int]) -> BoolArray:
        """(S, D) where it is."""
        mask = np.zeros(shape, dtype=bool)
        for row, first, last in zip(self.rows, self.first, self.last, strict=True):
            mask[first:last, row] = True
        return mask


def strips_in(share: Array, *, left: bool) -> list[Strip]:
    """The strips on one side of the beam that end on it, in what is covered in most frames: `share` (S, D)."""
    mask = binary_closing(np.pad(share > MOSTLY, CLOSES), np.ones((CLOSES, CLOSES)))[CLOSES:-CLOSES, CLOSES:-CLOSES]
    middle = share.shape[1] // 2
    rows = range(share.shape[1] - 1, middle, -1) if left else range(middle)
    live: list[list[tuple[int, int, int]]] = []
    ended: list[Strip] = []
    for row in rows:
        here, taken, going = runs(mask[:, row]), set[int](), []
        for strip in live:
            _, first, last = strip[-1]
            under = [i for i, (begin, end) in enumerate(here.tolist()) if begin < last and end > first]
            if not under:
                continue
            begin, end = int(here[under[0], 0]), int(here[under[-1], 1])
            if end - begin > WIDER * np.median([b - a for _, a, b in strip[-CLOSES * CLOSES :]]) + ROOM:
                ended.append(_strip(strip, row))
            else:
                going.append([*strip, (row, begin, end)])
            taken.update(under)
        begun = [[(row, int(a), int(b))] for i, (a, b) in enumerate(here.tolist()) if i not in taken]
        live = [*going, *begun]
    return ended


def _strip(cells: list[tuple[int, int, int]], flank: int) -> Strip:
    row, first, last = np.array(cells, dtype=np.int64).T
    return Strip(row, first, last, flank)


def presence(beside: NDArray[np.bool_], cells: BoolArray) -> Array:
    """(P,) the share of the `cells` (S, D) that is covered in each picture of `beside` (P, S, D)."""
    return np.asarray(beside[:, cells].mean(axis=1))
