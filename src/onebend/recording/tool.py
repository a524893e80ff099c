"""Where the pictures show the tool that pushes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from math import isfinite, isnan, nan, sqrt
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, map_coordinates, uniform_filter

from onebend.recording.entries import Recording
from onebend.recording.flanks import Planes
from onebend.recording.plane import camera_place, project, scale_of
from onebend.recording.signals import MAD_TO_SD, along_tags, runs
from onebend.recording.tool_edges import ToolStrip, contacts
from onebend.recording.video import KeptFrames, Picture, pictures_at
from onebend.records import (
    Array,
    BoolArray,
    IntArray,
    Markers,
    Observations,
    Remark,
    ToolTrack,
    View,
    of_markers,
    read_before_fit,
)

Pictures = NDArray[np.float32]  # (P, h, w)

BEAM_PIXELS = 230.0  # no longer is the beam in the shrunk pictures: noise averages out, a tool stays some pixels wide
STEPS = 180  # of the grid, in a beam's length
S_RANGE = (0.2, 1.4)  # nearer to the clamp the beam hardly moves; beyond the tip a tool's other half may be
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
    half = round(0.24 * STEPS)  # of the length, to each side
    count = round((S_RANGE[1] - S_RANGE[0]) * STEPS) + 1
    return SideGrid(S_RANGE[0] + np.arange(count) / STEPS, np.arange(-half, half + 1) * length / STEPS, length)


def shrink_factor(view: View, length: float) -> int:
    """How many pixels of the film, each way, make one of the shrunk pictures."""
    return max(1, math.ceil(length * scale_of(view, length) / BEAM_PIXELS))


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

    The background is the median over the pictures (those `by` (P,) where given) at equal brightness. Noise is the
    median deviation from it, which is large at edges where a camera shakes, but at least the pictures' typical one."""
    by = np.ones(len(pictures), dtype=bool) if by is None else by
    background = middle(pictures[by])
    thin = (slice(None), slice(None, None, THIN), slice(None, None, THIN))
    ratio = pictures[thin] / np.maximum(background[thin[1:]], 1.0)
    brightness = np.maximum(np.median(ratio, axis=(1, 2)), 1e-3)[:, None, None].astype(np.float32)
    even = pictures / brightness
    away = np.abs(even - middle(even[by]))
    noise = MAD_TO_SD * middle(away[by])
    floor = max(float(np.median(noise)), 0.1)  # of 255: no camera's noise is less, a film without any is a drawing
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
        axis = along_tags(markers.s[seen], markers.xy[row, seen], markers.angle[row, seen], grid.length)
        inside = np.clip(grid.s, axis.x[0], axis.x[-1])
        along = axis(inside, 1)
        tangent[at] = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
        centre[at] = axis(inside) + (grid.s - inside)[:, None] * grid.length * tangent[at]
    return centre, np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)


def beside_beam(
    different: Pictures, factor: int, view: View, centre: Array, normal: Array, grid: SideGrid
) -> NDArray[np.float32]:
    """(P, S, D) pictures beside the beam with axis `centre` (P, S, 2) [m] and `normal`; NaN outside the picture."""
    out = np.empty((len(different), len(grid.s), len(grid.across)), dtype=np.float32)
    for at, picture in enumerate(different):
        points = centre[at][:, None] + grid.across[:, None] * normal[at][:, None]
        px = (project(view, points) + 0.5) / factor - 0.5
        out[at] = map_coordinates(picture, [px[..., 1], px[..., 0]], order=1, mode="constant", cval=np.nan)
    return out


CLOSES = 3  # cells: holes smaller than this are filled
LEAST = 0.04  # of the length: a strip that is shorter is no tool


@dataclass(frozen=True)
class Strip:
    """A strip in one picture, row by row from outside to the flank."""

    rows: IntArray  # (R,) of the grid's `across`
    first: IntArray  # (R,) of the grid's `s`
    last: IntArray  # (R,) likewise, the first one beyond
    flank: int  # the row in which it has run into the beam


@dataclass(frozen=True)
class Meeting:
    """Where a strip meets the beam."""

    s: float
    left: bool  # of the beam
    width: float  # m, along the beam
    flank: float  # m, from the beam's axis
    slope: float  # of its middle line: along the beam over outward


def meetings(covered: BoolArray, grid: SideGrid, reach: float) -> list[Meeting]:
    """Where things lie against the beam that reach at least `reach` [m] from its axis, in one picture `covered` (S,
    D)."""
    holes = np.ones((CLOSES, CLOSES), dtype=bool)
    closed = binary_closing(np.pad(covered, CLOSES), holes)[CLOSES:-CLOSES, CLOSES:-CLOSES]
    out = []
    for left in (False, True):
        for strip in strips_in(closed, left=left):
            far = float(np.max(np.abs(grid.across[strip.rows])))
            if far < reach or len(strip.rows) * grid.step < LEAST * grid.length:
                continue
            found = _meeting(strip, grid)
            # Of the length: a wider strip does not say where it touches.
            # A strip that lies along the beam does not say where it touches, either.
            steep = abs(found.slope) > 1.0
            if found.width <= 0.25 * grid.length and not steep and _on_beam(closed, found.s, strip, grid):
                out.append(found)
    return out


def _on_beam(covered: BoolArray, s: float, strip: Strip, grid: SideGrid) -> bool:
    """Whether there is a beam between the strip's end and the axis."""
    # s: beyond, it may run past the beam.
    at, middle = int(np.argmin(np.abs(grid.s - min(s, 0.98)))), len(grid.across) // 2
    inside = covered[at, min(strip.flank, middle) : max(strip.flank, middle) + 1]
    # Of the places between flank and axis: with fewer covered it is not the beam that a strip runs into.
    return bool(np.mean(inside) >= 0.5)


def strips_in(covered: BoolArray, *, left: bool) -> list[Strip]:
    """The strips on one side of the beam that end on it."""
    middle, beyond = covered.shape[1] // 2, len(covered)
    rows = range(covered.shape[1] - 1, middle, -1) if left else range(middle)
    live: list[list[tuple[int, int, int]]] = []
    ended: list[Strip] = []
    for row in rows:
        here = runs(covered[:, row]).tolist()
        taken, going = set[int](), []
        for strip in live:
            _, first, last = strip[-1]
            under = [i for i, (begin, end) in enumerate(here) if begin < last and end > first]
            taken.update(under)
            if not under:
                continue
            begin, end = here[under[0]][0], here[under[-1]][1]
            usual = median([b - a for _, a, b in strip[-9:]])  # rows before, of which the usual width is taken
            # Times its usual width: a strip that becomes so wide has run into the beam.
            # Cells of width more, for the same.
            if end - begin > 1.6 * usual + 3:
                rows_of, first_of, last_of = np.array(strip, dtype=np.int64).T
                ended.append(Strip(rows_of, first_of, last_of, row))
            else:
                going.append([*strip, (row, begin, end)])
        # what the edge cuts off has no middle
        begun = [[(row, a, b)] for i, (a, b) in enumerate(here) if i not in taken and a > 0 and b < beyond]
        live = [*going, *begun]
    return ended


def _meeting(strip: Strip, grid: SideGrid) -> Meeting:
    """Where its middle line, drawn on straight, meets the flank."""
    # Of the length: the strip's last part, which tells where it meets the beam.
    count = max(2, round(0.08 * grid.length / grid.step))
    first, last = strip.first[-count:], strip.last[-count:]
    middle = 0.5 * (grid.s[first] + grid.s[last - 1])
    flank = abs(float(grid.across[strip.flank]))
    out = np.abs(grid.across[strip.rows[-count:]]) - flank
    slope, place = (0.0, float(middle[-1])) if len(out) < 2 else np.polyfit(out, middle, 1)
    width = float(np.median(last - first)) * grid.step
    left = strip.flank > len(grid.across) // 2
    return Meeting(float(place), left, width, flank, float(slope) * grid.length)


FEWEST_LOADED, FEWEST_AT_REST = 8, 3  # pictures
TOGETHER = 0.05  # of s: so near to each other are meetings of one tool, which may slide a little


@dataclass(frozen=True)
class ToolPlace:
    """The place at which a tool touches the beam, by the pictures alone."""

    s: float  # NaN where it is not seen
    sd: float  # of s, of the mean over the frames
    width: float  # m, of the tool
    left: bool  # of the beam
    shown: float  # share of the loaded frames in which it is there
    why: str  # why it is not seen; "" where it is
    track: ToolTrack | None = None  # frame by frame
    ends: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (P, 2) m, from the beam's axis to its end; likewise

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
    pictures: Sequence[Picture], markers: Markers, loaded: BoolArray, *, length: float, tag_size: float
) -> ToolPlace:
    """Where the tool is that pushes a beam of `length` [m], by P pictures.

    A tool lies against the beam's flank at one place in most of the loaded pictures, reaches farther out than tags (of
    side `tag_size` [m]) and their paper, is off the beam in some pictures at rest, and is alone. If not, it is not
    seen. `markers` and `loaded` have one row a picture."""
    good, view = enough_tags(markers), markers.view
    if view is None or not np.any(good):
        return not_seen("no frame shows the beam's tags")
    if np.ptp(markers.base_angle) > 0.0:
        return not_seen("the base turns")
    pushed = loaded[good]
    if pushed.sum() < FEWEST_LOADED or (~pushed).sum() < FEWEST_AT_REST:
        return not_seen("too few frames show the push, or the beam at rest")
    grid = grid_of(length)
    centre, normal = axes_of(markers, np.flatnonzero(good).tolist(), grid)
    whole, factor = np.stack([*pictures])[good], shrink_factor(view, length)
    small = np.stack([shrunk(picture, factor) for picture in whole])
    different = deviations(small)
    far = far_ones(markers.xy[good, _outermost(markers)], pushed)
    some = far | ~pushed
    different[~pushed] = deviations(small[some], far[some])[~pushed[some]]
    beside = beside_beam(different, factor, view, centre, normal, grid)
    # Of a tag's side: half the diagonal of its paper, white margin included.
    reach = 0.625 * sqrt(2.0) * tag_size + LEAST * length
    # sds of the background's noise: a pixel that is farther off shows something else.
    covered = np.asarray(beside > 5.0)
    each = [meetings(one, grid, reach) for one in covered]
    found = place_of(each, pushed, length)
    if not found.seen:
        return found
    if _shows_beam(covered[~pushed], found.s, grid).sum() < FEWEST_AT_REST:
        return not_seen("the beam at rest is taken for the background")
    own = {row: _at([one], found.left, found.s) for row, one in enumerate(each) if pushed[row]}
    rows = [row for row, one in own.items() if one]
    if len(rows) < FEWEST_LOADED:
        return found
    strips = [_strip(whole[i], view, own[i][0], (centre[i], normal[i]), grid) for i in rows]
    background = np.sort(whole, axis=0)[len(whole) // 2].astype(np.float32)
    s = np.array([own[row][0].s for row in rows])
    return _followed(found, s, markers.time[good][rows], strips, background, grid)


def _shows_beam(covered: BoolArray, s: float, grid: SideGrid) -> BoolArray:
    """(P,) the pictures (P, S, D) in which the beam itself stands out near s."""
    here = covered[:, np.abs(grid.s - min(s, 1.0 - TOGETHER)) <= TOGETHER]
    # Of the length: so near to its axis is certainly the beam.
    return np.asarray(here[..., np.abs(grid.across) <= 0.02 * grid.length].mean(axis=(1, 2)) >= 0.5)


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
    """(P,) the half of the loaded pictures in which a tag, at `xy` (P, 2) [m], is farthest from where it rests."""
    away = np.linalg.norm(xy - np.median(xy[~pushed], axis=0), axis=-1)
    return np.asarray(pushed & (away >= np.median(away[pushed])))


def place_of(found: Sequence[Sequence[Meeting]], pushed: BoolArray, length: float) -> ToolPlace:
    """The one place at which most of the loaded pictures show a thing against the beam of this `length` [m].

    `found` are the meetings in each picture, `pushed` (P,) whether the beam is loaded in it. The tool touches anywhere
    on the width that is seen, and the same in all pictures.
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
    # Of the loaded frames: in so many something must be seen to lie against the beam.
    if shown < 0.25 or len(own) < FEWEST_LOADED:
        return not_seen(f"too few frames show what lies against the beam ({shown:.0%} of those under load)")
    here = [one for one in loaded if _at([one], left, s)]
    alone = sum(all(other.left == left and abs(other.s - s) <= 2.0 * TOGETHER for other in one) for one in here)
    if alone < 0.75 * telling:  # of the loaded frames that show something so: in so many it is at one place
        return not_seen(f"things lie against the beam at several places (at s = {s:.2g} alone in {alone} of {telling})")
    resting = [one for one, now in zip(found, pushed, strict=True) if not now]
    # In 15 % of the frames at rest the tool must be off the beam, or it may be fixed to it.
    if len(_at(resting, left, s)) > 0.85 * len(resting):
        return not_seen(f"what lies against the beam at s = {s:.2g} is there at rest too")
    width = float(np.median([one.width for one in own]))
    sd = float(np.hypot(width / length / sqrt(12.0), MAD_TO_SD * np.median([abs(one.s - s) for one in own])))
    return ToolPlace(min(s, 1.0), sd, width, left, shown, "")


def _at(found: Sequence[Sequence[Meeting]], left: bool, s: float) -> list[Meeting]:
    """The nearest meeting to a place in each picture that has one there."""
    near = ([other for other in one if other.left == left and abs(other.s - s) <= TOGETHER] for one in found)
    return [min(one, key=lambda other: abs(other.s - s)) for one in near if one]


FREEDOM = 4.0  # degrees of freedom of Student's t
TOUCH = 1.0 / 6.0  # of the width: one sd of the place at which it touches about the middle of its end
ROLLS = TOUCH  # of the width, per rad that the beam turns: by so much that place may move
# Of the width: what is seen of a tool is its upper edge. It lies below the tags' plane, or the tool would reach over
# the body; so far below it as a rule, and as far off that (one sd).
LOWER = 0.5
# A force that leans, through the tool's end on the flank, meets the axis elsewhere. The beam is said to be pushed
# there, or beside the tool's end; a place anywhere between is off by this share (RMS).
LEANS = 1.0 / sqrt(3.0)
_STEEPEST = 2.0  # of the force along the beam over that across: of more the way to the axis tells nothing


def _strip(picture: Picture, view: View, at: Meeting, axis: tuple[Array, Array], grid: SideGrid) -> ToolStrip:
    """A tool in one picture; `axis`: points (S, 2) m and left normals (S, 2), as `axes_of`."""
    centre, left = (np.array([np.interp(at.s, grid.s, each[:, c]) for c in range(2)]) for each in axis)
    angle = np.unwrap(np.arctan2(-axis[1][:, 0], axis[1][:, 1]))
    side = 1.0 if at.left else -1.0
    bend = side * float(np.interp(at.s, grid.s, np.gradient(angle, grid.s * grid.length)))
    tangent = np.array([left[1], -left[0]])
    return ToolStrip(picture.astype(np.float32), view, centre, tangent, side * left, at.flank, at.slope, bend)


def _followed(
    found: ToolPlace, s: Array, time: Array, strips: Sequence[ToolStrip], background: Pictures, grid: SideGrid
) -> ToolPlace:
    """The place by the tool's edges in the pictures of these `strips`, near `s` (P,); as found, where too few show
    them. Where on its end the tool touches, and how high over the tags' plane it is seen, does not average out."""
    touch = contacts(strips, background, grid.length, found.width)
    foot, distance = camera_place(strips[0].view)
    tangent = np.array([strip.tangent for strip in strips])
    away = np.sum((np.array([strip.origin for strip in strips]) - foot) * tangent, axis=1)
    lower = LOWER * touch.width / grid.length * away / distance  # so much nearer to the camera's foot is it seen
    s = s + touch.along / grid.length + lower
    middle = float(np.median(s[touch.clear])) if touch.clear.any() else nan
    clear = touch.clear & (np.abs(s - middle) <= TOGETHER)
    if clear.sum() < FEWEST_LOADED:
        return found
    turn = np.unwrap(np.arctan2(tangent[clear, 1], tangent[clear, 0]))
    turn -= turn.mean()
    touches = touch.width / grid.length * np.stack([np.full(len(turn), TOUCH), ROLLS * turn], axis=1)
    s, effects = s[clear], np.column_stack([touches, lower[clear]])
    scatter = MAD_TO_SD * float(np.median(np.abs(s - np.polyval(np.polyfit(turn, s, 1), turn))))
    sd = max(scatter, 0.5 * grid.step / grid.length)
    whole = float(np.hypot(sd / sqrt(len(s)), np.linalg.norm(effects.mean(axis=0))))
    track = ToolTrack(time[clear], s, np.full(len(s), sd), effects)
    ends = np.array([strip.flank * strip.outward for strip in strips])[clear]
    return replace(found, s=min(middle, 1.0), sd=whole, width=touch.width, track=track, ends=ends)


LOADED, AT_REST = 24, 8  # frames of each that are looked at; half of them are enough where these are kept

FindTool = Callable[[Markers, BoolArray, IntArray], ToolPlace]  # by tags, whether loaded, and number of each frame


def tool_checked(rec: Recording, seen: Observations, base_angle: Array, find: FindTool) -> Observations:
    """With what the pictures show of the tool, by `find`: a warning where it is elsewhere than `at_s` says.
    `base_angle` (T,) [rad] is of the same frames."""
    if rec.push is None or not isfinite(rec.push.at):
        return seen
    markers = Markers(
        seen.time, seen.tag_id, seen.marker_s, seen.xy, seen.angle, seen.covariance, base_angle,
        seen.source.view, traced=seen.traced,
    )  # fmt: skip
    tool = _leaning(find(of_markers(markers, read_before_fit(seen)), seen.loaded, seen.frame), seen)
    remarks, where_stated = tool_remarks(tool, rec), tool.seen and not _tool_elsewhere(tool, rec)
    source = replace(seen.source, remarks=(*seen.source.remarks, *remarks), place_seen=where_stated)
    track = _doubted(tool, rec) if where_stated else None
    return replace(seen, source=source, tool=track)


def _leaning(tool: ToolPlace, seen: Observations) -> ToolPlace:
    """With the error of a place at which the force leans against the beam (see `LEANS`)."""
    if tool.track is None:
        return tool
    force, height = seen.force[np.searchsorted(seen.time, tool.track.time)], np.linalg.norm(tool.ends, axis=1)
    out = tool.ends / np.maximum(height, 1e-12)[:, None]
    inwards = np.maximum(np.abs(np.sum(force * out, axis=1)), 1e-12)  # N
    steep = np.clip((force[:, 1] * out[:, 0] - force[:, 0] * out[:, 1]) / inwards, -_STEEPEST, _STEEPEST)
    noise = np.fmin(np.linalg.norm(seen.force_sd) * np.hypot(1.0, steep) / inwards, _STEEPEST)  # NaN: not known
    way = LEANS * float(np.median(height)) / seen.length  # of one place: a single frame may show it far off
    effects = np.column_stack([tool.track.effects, way * steep])
    track = replace(tool.track, sd=np.hypot(tool.track.sd, way * noise), effects=effects)
    return replace(tool, sd=float(np.hypot(tool.sd, way * steep.mean())), track=track)


def _doubted(tool: ToolPlace, rec: Recording) -> ToolTrack | None:
    """What is seen frame by frame, less certain the farther it is from `at_s` (Student's t)."""
    if tool.track is None or rec.push is None:
        return None
    away = (tool.s - rec.push.at) / np.hypot(tool.sd, _stated_sd(rec))
    wider = sqrt((FREEDOM + max(away**2, 1.0)) / (FREEDOM + 1.0))
    return replace(tool.track, sd=wider * tool.track.sd, effects=wider * tool.track.effects)


def _stated_sd(rec: Recording) -> float:
    """Of `at_s`, over the length; the tags tell where s is."""
    return float(np.hypot(rec.place_sd, rec.tags.placement_sd)) / rec.beam.length


def tool_in_film(
    rec: Recording,
    markers: Markers,
    loaded: BoolArray,
    frame: IntArray,
    *,
    every: int = 1,
    kept: KeptFrames | None = None,
) -> ToolPlace:
    """Where the film of `rec` shows the tool; `markers`, `loaded` and `frame`, the index in the film, have a row a
    frame.

    `every` is the spacing of frames that may be `kept` (`spacing_of`); others are looked at only where these are few.
    """
    if rec.video is None or markers.view is None:
        return not_seen("there is no film")
    rows = rows_to_look_at(markers.xy, loaded, frame % every == 0 if every else None)
    seek = pictures_at if kept is None else kept.pictures
    found = dict(seek(rec.video, frame[rows].tolist()))
    rows = np.array([row for row in rows.tolist() if int(frame[row]) in found], dtype=np.int64)
    return tool_in([found[int(frame[row])] for row in rows], rec, of_rows(markers, rows), loaded[rows])


def tool_in(pictures: Sequence[Picture], rec: Recording, markers: Markers, loaded: BoolArray) -> ToolPlace:
    """Where these pictures show the tool; `markers` and `loaded` have one row per picture."""
    if not len(pictures):
        return not_seen("there is no picture")
    return tool_place(pictures, markers, loaded, length=rec.beam.length, tag_size=rec.tags.size)


def tool_in_stream(
    pictures: Mapping[float, Planes], rec: Recording, markers: Markers, loaded: BoolArray, time: Array
) -> ToolPlace:
    """Where the pictures that were kept of a stream, by their time [s], show the tool; `markers`, `loaded` and `time`
    [s] have one row per frame."""
    rows = np.flatnonzero(np.isin(time, list(pictures)))
    rows = rows[rows_to_look_at(markers.xy[rows], loaded[rows])]
    return tool_in([pictures[t].luma for t in time[rows].tolist()], rec, of_rows(markers, rows), loaded[rows])


def rows_to_look_at(xy: Array, loaded: BoolArray, rather: BoolArray | None = None) -> IntArray:
    """Some loaded and resting rows of `xy` (T, m, 2), evenly over time and way; only the `rather` (T,) if enough."""
    steps = np.nan_to_num(np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=-1)).sum(axis=1)
    chosen = []
    for mask, most in ((loaded, LOADED), (~loaded, AT_REST)):
        rows = np.flatnonzero(mask if rather is None or np.sum(mask & rather) < most // 2 else mask & rather)
        if len(rows):
            gone = np.cumsum(np.where(mask, steps, 0.0))
            way = gone[rows] / max(float(gone[-1]), 1e-12) + np.linspace(0.0, 1.0, len(rows))
            chosen.append(rows[np.searchsorted(way, np.linspace(way[0], way[-1], min(most, len(rows))))])
    return np.unique(np.concatenate(chosen)).astype(np.int64) if chosen else np.zeros(0, dtype=np.int64)


def of_rows(markers: Markers, rows: IntArray) -> Markers:
    """The markers of some frames."""
    by_frame = {name: vars(markers)[name][rows] for name in ("time", "xy", "angle", "covariance", "base_angle")}
    return replace(markers, **by_frame, by_camera=None, remarks=())


def tool_remarks(tool: ToolPlace, rec: Recording) -> tuple[Remark, ...]:
    """A warning where most loaded frames show the tool farther from `at_s` than both tolerances allow."""
    # Of the loaded frames: what fewer show at another place is no reason to doubt the stated one.
    if rec.push is None or not _tool_elsewhere(tool, rec) or tool.shown < 0.5:
        return ()
    text = (
        f"The film shows the tool at s = {tool.words}; recording.toml says at_s = {rec.push.at:.3g}. k(s) follows the "
        f"place: measure it, and correct at_s in [push] (to {tool.s:.2f} if the film is right)."
    )
    return (Remark("warning", text, doubt=True, about="tool place"),)


def _tool_elsewhere(tool: ToolPlace, rec: Recording) -> bool:
    """Whether the tool is seen farther from `at_s` than both tolerances allow."""
    if not tool.seen or rec.push is None or isnan(rec.push.at):
        return False
    # sds, of what is seen and what is stated together: farther apart they disagree.
    return bool(abs(tool.s - rec.push.at) > 3.0 * np.hypot(tool.sd, _stated_sd(rec)))


# Pictures of a stream. Which frames are of the push is known only when it is over. So some frames are kept that
# show the tags where they were first, and more of all others, evenly over time and way.

MOST = 4 * (LOADED + AT_REST)  # pictures: at least half as many are left where every other one has gone
MOST_PIXELS = 100_000_000  # of all that are kept; a pixel takes 1.5 bytes as a rule
MOVED = 0.05  # of a tag's side: farther from where it was first, it may be pushed
SECONDS, WAY = 0.1, 0.1  # s, and sides of a tag: so far apart are the pictures to begin with


@dataclass
class _Spread:
    """Pictures evenly over time and way; where there are too many, every other one goes, and so on."""

    share: float  # of all that are kept
    spacing: float = 1.0
    # Of each its time [s], and where its tags are, (m, 2) px.
    kept: list[tuple[float, Array, Planes]] = field(default_factory=list)

    def wants(self, time: float, middle: Array, side: float) -> bool:
        """Whether a picture is far enough from the last one."""
        if not self.kept:
            return True
        last, there, _ = self.kept[-1]
        return (time - last) / SECONDS + _farthest(middle - there) / (WAY * side) >= self.spacing

    def add(self, one: tuple[float, Array, Planes], most: int) -> None:
        """One more, of at most `most` in both stores."""
        self.kept.append(one)
        if len(self.kept) > max(1, int(self.share * most)):
            self.kept, self.spacing = self.kept[::2], 2.0 * self.spacing


class KeptPictures:
    """The pictures that are kept of a stream."""

    def __init__(self, most: int = MOST) -> None:
        """Nothing is kept yet, and never more than so many pictures."""
        self._most, self._side = min(most, MOST), math.nan
        self._first: Array | None = None  # (m, 2) px, where each tag was seen first
        self._rest, self._away = (_Spread(part / (AT_REST + LOADED)) for part in (AT_REST, LOADED))

    def __contains__(self, time: object) -> bool:
        """Whether the picture of a time [s] is kept."""
        return time in self.by_time()

    def add(self, time: float, corners: Array, picture: Callable[[], Planes]) -> None:
        """Take notice of the newest picture, which shows the tags' corners (m, 4, 2) [px]; NaN where it does not."""
        seen = np.isfinite(corners).all(axis=(1, 2))
        if not seen.any():
            return
        middle = corners.mean(axis=1)
        if self._first is None:
            self._first = middle
            self._side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)[seen].mean())
            self._most = min(self._most, MOST_PIXELS // picture().luma.size)
        self._first = np.where(np.isfinite(self._first), self._first, middle)
        moved = _farthest(middle - self._first) > MOVED * self._side
        spread = self._away if moved else self._rest
        if self._most and spread.wants(time, middle, self._side):
            spread.add((time, middle, deepcopy(picture())), self._most)  # its owner may write the next one into it

    def by_time(self) -> dict[float, Planes]:
        """Those that are kept, by their time [s]."""
        return {time: picture for time, _, picture in (*self._rest.kept, *self._away.kept)}


def _farthest(way: Array) -> float:
    """Of ways (m, 2), the longest one that is known; 0 where none is."""
    known = way[np.isfinite(way).all(axis=1)]
    return float(np.linalg.norm(known, axis=1).max()) if len(known) else 0.0
