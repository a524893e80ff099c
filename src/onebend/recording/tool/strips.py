"""Strips that come from outside and end on the beam's flank: what a tool looks like beside the beam."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from statistics import median

import numpy as np
from scipy.ndimage import binary_closing

from onebend.recording.tool.covered import SideGrid
from onebend.records import BoolArray, IntArray

CLOSES = 3  # cells: holes smaller than this are filled
WIDER = 1.6  # times its usual width: a strip that becomes so wide has run into the beam
MORE = 3  # cells of width more, for the same
USUAL = 9  # rows before, of which the usual width is taken
NEAR = 0.08  # of the length: the strip's last part, which tells where it meets the beam
LEAST = 0.04  # of the length: a strip that is shorter is no tool
WIDEST = 0.25  # of the length: a wider strip does not say where it touches
STEEPEST = 1.0  # along over across: a strip that lies nearer along the beam does not say where it touches
FLANK_SD = 0.02  # of the length: the beam's shadow may hide its flank by so much
SOLID = 0.5  # of the places between flank and axis: with fewer covered it is not the beam that a strip runs into
TIP = 0.98  # s: beyond, it may run past the beam


@dataclass(frozen=True)
class Strip:
    """A strip in one picture, row by row from outside to the flank."""

    rows: IntArray  # (R,) of the grid's `across`
    first: IntArray  # (R,) of the grid's `s`
    last: IntArray  # (R,) likewise, the first one beyond
    flank: int  # the row in which it has run into the beam

    @property
    def width(self) -> float:
        """Cells along the beam, by the beam."""
        return float(np.median(self.last - self.first))


@dataclass(frozen=True)
class Meeting:
    """Where a strip meets the beam."""

    s: float
    sd: float  # of s: the place at which the tool touches may be anywhere on the strip's end
    left: bool  # of the beam
    width: float  # m, along the beam


def meetings(covered: BoolArray, grid: SideGrid, reach: float) -> list[Meeting]:
    """Where things lie against the beam that reach at least `reach` [m] out from its axis, in one picture of what is
    `covered` (S, D)."""
    holes = np.ones((CLOSES, CLOSES), dtype=bool)
    closed = binary_closing(np.pad(covered, CLOSES), holes)[CLOSES:-CLOSES, CLOSES:-CLOSES]
    out = []
    for left in (False, True):
        for strip in strips_in(closed, left=left):
            far = float(np.max(np.abs(grid.across[strip.rows])))
            if far < reach or len(strip.rows) * grid.step < LEAST * grid.length:
                continue
            found, slope = _meeting(strip, grid)
            if found.width <= WIDEST * grid.length and slope <= STEEPEST and _on_beam(closed, found.s, strip, grid):
                out.append(found)
    return out


def _on_beam(covered: BoolArray, s: float, strip: Strip, grid: SideGrid) -> bool:
    """Whether there is a beam between the strip's end and the axis."""
    at, middle = int(np.argmin(np.abs(grid.s - min(s, TIP)))), len(grid.across) // 2
    inside = covered[at, min(strip.flank, middle) : max(strip.flank, middle) + 1]
    return bool(np.mean(inside) >= SOLID)


def strips_in(covered: BoolArray, *, left: bool) -> list[Strip]:
    """The strips on one side of the beam that end on it."""
    middle, beyond = covered.shape[1] // 2, len(covered)
    rows = range(covered.shape[1] - 1, middle, -1) if left else range(middle)
    live: list[list[tuple[int, int, int]]] = []
    ended: list[Strip] = []
    for row, here in zip(rows, runs_in_rows(covered[:, rows].T), strict=True):
        taken, going = set[int](), []
        for strip in live:
            _, first, last = strip[-1]
            under = [i for i, (begin, end) in enumerate(here) if begin < last and end > first]
            taken.update(under)
            if not under:
                continue
            begin, end = here[under[0]][0], here[under[-1]][1]
            usual = median([b - a for _, a, b in strip[-USUAL:]])
            if end - begin > WIDER * usual + MORE:
                ended.append(_strip(strip, row))
            else:
                going.append([*strip, (row, begin, end)])
        # what the edge cuts off has no middle
        begun = [[(row, a, b)] for i, (a, b) in enumerate(here) if i not in taken and a > 0 and b < beyond]
        live = [*going, *begun]
    return ended


def runs_in_rows(mask: BoolArray) -> list[list[tuple[int, int]]]:
    """First and one-past-last index of every run of True in each row of `mask` (R, N)."""
    edges = np.diff(np.pad(mask.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (row, first), (_, last) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    out: list[list[tuple[int, int]]] = [[] for _ in mask]
    for at, a, b in zip(row.tolist(), first.tolist(), last.tolist(), strict=True):
        out[at].append((a, b))
    return out


def _strip(cells: list[tuple[int, int, int]], flank: int) -> Strip:
    row, first, last = np.array(cells, dtype=np.int64).T
    return Strip(row, first, last, flank)


def _meeting(strip: Strip, grid: SideGrid) -> tuple[Meeting, float]:
    """Its middle line, drawn on straight to the flank, and how steep that is (along over across)."""
    count = max(2, round(NEAR * grid.length / grid.step))
    near = Strip(strip.rows[-count:], strip.first[-count:], strip.last[-count:], strip.flank)
    middle = 0.5 * (grid.s[near.first] + grid.s[near.last - 1])
    out = grid.across[near.rows] - grid.across[near.flank]
    slope, place = (0.0, float(middle[-1])) if len(out) < 2 else np.polyfit(out, middle, 1)
    scatter = float(np.std(middle - (place + slope * out)))
    width = near.width * grid.step
    steep = abs(float(slope)) * grid.length
    touch = width / grid.length / sqrt(12.0)
    meeting = Meeting(
        s=float(place),
        sd=float(np.linalg.norm([scatter, touch, steep * FLANK_SD])),
        left=strip.flank > len(grid.across) // 2,
        width=width,
    )
    return meeting, steep
