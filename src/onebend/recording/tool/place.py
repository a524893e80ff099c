"""Where along the beam the pictures show the tool that pushes."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, sqrt

import numpy as np
from numpy.typing import NDArray

from onebend.recording.tool.covered import (
    DIFFERS,
    Grid,
    Pictures,
    axes_of,
    beside_beam,
    deviations,
    grid_of,
    share_covered,
)
from onebend.recording.tool.strips import MOSTLY, Strip, presence, strips_in
from onebend.records import Array, BoolArray, Markers

FEWEST_LOADED, FEWEST_AT_REST = 8, 3
PAPER = 0.625 * sqrt(2.0)  # of a tag's side: half the diagonal of its paper, white margin included
LEAST = 0.04  # of the length: a strip that reaches less far out beyond the tags' paper is no tool
WIDEST = 0.2  # of the length: a wider strip does not say where it touches
AWAY = 0.25  # of a strip's cells: a frame with fewer covered shows no tool
AWAY_SHARE = 1.0 / 6.0  # of the frames at rest: in so many the tool must be away, or it may be fixed to the beam
AGREE = 3.0  # sds, within which two strips are of one place


@dataclass(frozen=True)
class ToolPlace:
    """The place at which a tool touches the beam, by the pictures alone."""

    s: float  # NaN where it is not seen
    sd: float  # of s: from the tool's width, within which it may touch anywhere, and how well it is followed
    width: float  # m, of the tool along the beam, shadow included
    left: bool  # of the beam
    shown: float  # share of the loaded frames in which it is there
    why: str  # why it is not seen; "" where it is
    outline: Array  # (2, 2) s and m across: the strip's middle line, from outside to the flank

    @property
    def seen(self) -> bool:
        return self.why == ""


def not_seen(why: str) -> ToolPlace:
    """That no place is told, and why."""
    return ToolPlace(nan, nan, nan, False, nan, why, np.full((2, 2), nan))


def tool_place(
    pictures: Pictures, factor: int, markers: Markers, loaded: BoolArray, *, length: float, tag_size: float
) -> ToolPlace:
    """Where the tool is that pushes a beam of `length` [m], by `pictures` shrunk by `factor`.

    A tool is what lies beside the beam in most of the loaded pictures, reaches the beam's flank, keeps its place along
    it, is away in some of the pictures at rest, and has no like on the other side. `markers` and `loaded` have one row
    a picture; those without most of their tags are left out. What is not clear is not seen: no guess is made.

    Args:
        tag_size: m, side of the tags on the beam, whose paper may stand out beside it.
    """
    good = enough_tags(markers)
    if markers.view is None or not np.any(good):
        return not_seen("no frame shows the beam's tags")
    if np.ptp(markers.base_angle) > 0.0:
        return not_seen("the base turns")
    rows, pushed = np.flatnonzero(good), loaded[good]
    if pushed.sum() < FEWEST_LOADED or (~pushed).sum() < FEWEST_AT_REST:
        return not_seen("too few frames show the push and the beam at rest")
    grid = grid_of(length)
    different = deviations(pictures)[good]
    centre, normal = axes_of(markers, rows.tolist(), grid)

    with_beam = beside_beam(different, factor, markers.view, centre, normal, grid, (np.inf, np.inf))
    flank = flanks(share_covered(with_beam, pushed), grid)
    in_room = beside_beam(different, factor, markers.view, centre, normal, grid, flank)
    found = [
        (strip, beside)
        for beside in (with_beam, in_room)
        for strip in clear_strips(beside, pushed, grid, PAPER * tag_size)
    ]
    if not found:
        return not_seen("nothing beside the beam looks like a tool that touches it")
    return _agreed([_told(strip, beside, pushed, grid) for strip, beside in found])


def enough_tags(markers: Markers) -> BoolArray:
    """(P,) the pictures that show all tags, or all but one that is not the outermost."""
    seen = np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle)
    outermost = int(np.argmax(markers.s))
    return np.asarray((seen.sum(axis=1) >= max(1, seen.shape[1] - 1)) & seen[:, outermost])


def flanks(share: Array, grid: Grid) -> tuple[float, float]:
    """m, how far the beam reaches to the right and to the left: what most of its length covers in most frames."""
    on_beam = (grid.s > 0.4) & (grid.s < 0.95)
    covered = np.median(share[on_beam], axis=0) > MOSTLY
    middle = len(grid.across) // 2
    right, left = (np.flatnonzero(~side) for side in (covered[middle::-1], covered[middle:]))
    return tuple(float(side[0]) * grid.step if len(side) else np.inf for side in (right, left))  # type: ignore[return-value]


def clear_strips(beside: NDArray[np.float32], pushed: BoolArray, grid: Grid, paper: float) -> list[Strip]:
    """The strips that can only be a tool. `paper` [m]: how far tags may stand out."""
    share, covered = share_covered(beside, pushed), np.asarray(beside > DIFFERS)
    strips = [strip for left in (False, True) for strip in strips_in(share, left=left)]
    return [strip for strip in strips if _is_tool(strip, covered, pushed, grid, paper)]


def _is_tool(strip: Strip, covered: BoolArray, pushed: BoolArray, grid: Grid, paper: float) -> bool:
    near = strip.near(grid)
    out = float(np.max(np.abs(grid.across[strip.rows])))
    if len(near.rows) < 3 or len(strip.rows) * grid.step < LEAST * grid.length or out < paper + LEAST * grid.length:
        return False
    if near.width(grid) > WIDEST * grid.length:
        return False
    cells = near.cells(covered.shape[1:])
    at_rest = presence(covered[~pushed], cells)
    other_side = presence(covered[pushed], cells[:, ::-1])
    return bool(np.mean(at_rest < AWAY) >= AWAY_SHARE and np.mean(other_side < AWAY) > 1.0 - AWAY_SHARE)


def _told(strip: Strip, beside: NDArray[np.float32], pushed: BoolArray, grid: Grid) -> ToolPlace:
    """What a strip says of the place."""
    near = strip.near(grid)
    s, sd = near.meets(grid)
    width = near.width(grid)
    shown = float(np.mean(presence(np.asarray(beside[pushed] > DIFFERS), near.cells(beside.shape[1:])) > MOSTLY))
    ends = near.rows[[0, -1]]
    outline = np.array([[0.5 * (grid.s[near.first[i]] + grid.s[near.last[i] - 1]), grid.across[near.rows[i]]] for i in (0, -1)])
    return ToolPlace(
        s=min(s, 1.0),
        sd=float(np.hypot(sd, max(width, grid.step) / grid.length / sqrt(12.0))),
        width=width,
        left=bool(grid.across[ends[-1]] > 0.0),
        shown=shown,
        why="",
        outline=outline,
    )


def _agreed(told: list[ToolPlace]) -> ToolPlace:
    """The narrowest, where all are of one place."""
    best = min(told, key=lambda one: one.sd)
    for one in told:
        if abs(one.s - best.s) > AGREE * np.hypot(one.sd, best.sd):
            return not_seen(f"two things look like a tool, at s = {best.s:.2g} and {one.s:.2g}")
    return best
