"""Where along the beam the pictures show the tool that pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from onebend.recording.tool.covered import DIFFERS, Pictures, SideGrid, axes_of, beside_beam, deviations, grid_of
from onebend.recording.tool.strips import LEAST, Meeting, meetings
from onebend.records import Array, BoolArray, Markers

FEWEST_LOADED, FEWEST_AT_REST = 8, 3
PAPER = 0.625 * sqrt(2.0)  # of a tag's side: half the diagonal of its paper, white margin included
CORE = 0.02  # of the length: so near to its axis is certainly the beam
TOGETHER = 0.05  # of s: so near to each other are meetings of one tool, which may slide a little
LEAST_SHOWN = 0.25  # of the loaded frames: in so many something must be seen to lie against the beam
AGREEING = 0.75  # of the loaded frames that show something so: in so many it is at one place
AWAY = 0.15  # of the frames at rest: in so many the tool must be off the beam, or it may be fixed to it


@dataclass(frozen=True)
class ToolPlace:
    """The place at which a tool touches the beam, by the pictures alone."""

    s: float  # NaN where it is not seen
    sd: float  # of s: from the tool's width, within which it may touch anywhere, and how well it is followed
    width: float  # m, of the tool along the beam, shadow included
    left: bool  # of the beam
    shown: float  # share of the loaded frames in which it is there
    why: str  # why it is not seen; "" where it is

    @property
    def seen(self) -> bool:
        """Whether a place is told."""
        return self.why == ""

    @property
    def words(self) -> str:
        """The place and its tolerance."""
        return f"{self.s:.2f}, give or take {self.sd:.2f} (sd)"


def not_seen(why: str) -> ToolPlace:
    """That no place is told, and why."""
    return ToolPlace(nan, nan, nan, False, nan, why)


def tool_place(
    pictures: Pictures, factor: int, markers: Markers, loaded: BoolArray, *, length: float, tag_size: float
) -> ToolPlace:
    """Where the tool is that pushes a beam of `length` [m], by `pictures` (P, h, w) shrunk by `factor`.

    A tool is what lies against the beam's flank at one place in most of the loaded pictures, reaches farther out than
    tags do, is off the beam in some of the pictures at rest, and has no like elsewhere. What is not clear is not seen:
    no guess is made. `markers` and `loaded` have one row a picture.

    Args:
        tag_size: m, side of the tags on the beam, whose paper may stand out beside it.
    """
    good = enough_tags(markers)
    if markers.view is None or not np.any(good):
        return not_seen("no frame shows the beam's tags")
    if np.ptp(markers.base_angle) > 0.0:
        return not_seen("the base turns")
    pushed = loaded[good]
    if pushed.sum() < FEWEST_LOADED or (~pushed).sum() < FEWEST_AT_REST:
        return not_seen("too few frames show the push, or the beam at rest")
    grid = grid_of(length)
    centre, normal = axes_of(markers, np.flatnonzero(good).tolist(), grid)
    different = deviations(pictures[good])
    far = far_ones(markers.xy[good, _outermost(markers)], pushed)
    some = far | ~pushed
    different[~pushed] = deviations(pictures[good][some], far[some])[~pushed[some]]
    beside = beside_beam(different, factor, markers.view, centre, normal, grid)
    reach = PAPER * tag_size + LEAST * length
    covered = np.asarray(beside > DIFFERS)
    found = place_of([meetings(one, grid, reach) for one in covered], pushed)
    if found.seen and _shows_beam(covered[~pushed], found.s, grid).sum() < FEWEST_AT_REST:
        return not_seen("the beam at rest is taken for the background")
    return found


def _shows_beam(covered: BoolArray, s: float, grid: SideGrid) -> BoolArray:
    """(P,) the pictures (P, S, D) in which the beam itself stands out near s: if it does not at rest, nor would what is
    fixed to it."""
    here = covered[:, np.abs(grid.s - min(s, 1.0 - TOGETHER)) <= TOGETHER]
    return np.asarray(here[..., np.abs(grid.across) <= CORE * grid.length].mean(axis=(1, 2)) >= 0.5)


def enough_tags(markers: Markers) -> BoolArray:
    """(P,) the pictures that show all tags, or all but one that is not the outermost; a tag that none shows is none."""
    seen = np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle)
    wanted = np.asarray(seen.any(axis=0))
    if not wanted.any():
        return np.zeros(len(seen), dtype=bool)
    return np.asarray((seen.sum(axis=1) >= max(1, wanted.sum() - 1)) & seen[:, _outermost(markers)])


def _outermost(markers: Markers) -> int:
    """Of the tags that are ever seen, the one nearest to the tip."""
    ever = (np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle)).any(axis=0)
    return int(np.argmax(np.where(ever, markers.s, -np.inf)))


def far_ones(xy: Array, pushed: BoolArray) -> BoolArray:
    """(P,) the half of the loaded pictures in which a tag, at `xy` (P, 2) [m], is farthest from where it rests: these
    show what the beam at rest, and what is fixed to it, lies upon."""
    away = np.linalg.norm(xy - np.median(xy[~pushed], axis=0), axis=-1)
    return np.asarray(pushed & (away >= np.median(away[pushed])))


def place_of(found: Sequence[Sequence[Meeting]], pushed: BoolArray) -> ToolPlace:
    """The one place at which most of the loaded pictures show a thing against the beam.

    `found` are the meetings in each picture, `pushed` (P,) whether the beam is loaded in it.
    """
    loaded = [one for one, now in zip(found, pushed, strict=True) if now]
    every = [(meeting.left, meeting.s) for one in loaded for meeting in one]
    if not every:
        return not_seen("nothing lies against the beam")
    counts = [len(_at(loaded, left, s)) for left, s in every]
    left, s = every[int(np.argmax(counts))]
    s = float(np.median([one.s for one in _at(loaded, left, s)]))
    own, telling = _at(loaded, left, s), sum(len(one) > 0 for one in loaded)
    shown = len(own) / len(loaded)
    if shown < LEAST_SHOWN or len(own) < FEWEST_LOADED:
        return not_seen(f"too few frames show what lies against the beam ({shown:.0%} of those under load)")
    alone = len(own) - sum(_elsewhere(one, left, s) for one in loaded if _at([one], left, s))
    if alone < AGREEING * telling:
        return not_seen(f"things lie against the beam at several places (at s = {s:.2g} alone in {alone} of {telling})")
    resting = [one for one, now in zip(found, pushed, strict=True) if not now]
    if len(_at(resting, left, s)) > (1.0 - AWAY) * len(resting):
        return not_seen(f"what lies against the beam at s = {s:.2g} is there at rest too")
    return _weighed(own, shown)


def _at(found: Sequence[Sequence[Meeting]], left: bool, s: float) -> list[Meeting]:
    """The nearest meeting to a place in each picture that has one there."""
    out = []
    for one in found:
        near = [meeting for meeting in one if meeting.left == left and abs(meeting.s - s) <= TOGETHER]
        if near:
            out.append(min(near, key=lambda meeting: abs(meeting.s - s)))
    return out


def _elsewhere(one: Sequence[Meeting], left: bool, s: float) -> bool:
    """Whether a picture shows a meeting far from a place."""
    return any(meeting.left != left or abs(meeting.s - s) > 2.0 * TOGETHER for meeting in one)


def _weighed(own: Sequence[Meeting], shown: float) -> ToolPlace:
    """The mean. Where on the tool's end it touches is the same in all pictures and does not average out."""
    s: Array = np.array([one.s for one in own])
    weight = np.array([one.sd for one in own]) ** -2.0
    mean = float(np.sum(weight * s) / weight.sum())
    scatter = float(np.sum(weight * (s - mean) ** 2) / weight.sum())
    return ToolPlace(
        s=min(mean, 1.0),
        sd=sqrt(1.0 / float(weight.mean()) + scatter),
        width=float(np.median([one.width for one in own])),
        left=own[0].left,
        shown=shown,
        why="",
    )
