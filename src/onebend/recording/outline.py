"""The outline of the body in a film, as points of its centreline.

In the first picture the body is followed from the clamp to its tip (`recording.flanks`). Each later picture is searched
near where the ones before predict it; beside tags, where these say that the body runs. Its width is the same in all
pictures, so what contradicts it (a tool, a shadow, a thing of the same colour, a wall of the body) is left out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from onebend.errors import ObservationError
from onebend.progress import Progress, Silent, track
from onebend.recording import body_end, camera, entries, flanks, plane, video
from onebend.recording.signals import MAD_TO_SD, bridged, correlation_time, jumps, nan_mean, nan_median, running_median
from onebend.recording.tags import in_order
from onebend.records import END_ID, Array, BoolArray, IntArray, Markers, OutlineTrack, Remark, View, left_of, unit

# The film: each picture is searched near where the two before predict the body.

STATION, STATIONS = 4.0, 240  # px: distance of the normals; at most so many
POINTS = 30  # of the curve that are kept, evenly along the body
PLACES = (np.arange(POINTS) + 0.5) / POINTS  # (n,) their s
FAR = 0.4  # of `REACH`: a curve that is farther from its prediction is searched again
WIDE = 4.0  # px: so far off may the width at one station be, as where the body moves and is blurred
LOST = 0.75  # of the share of stations that usually show the body: with fewer it is elsewhere
USUAL = 60  # pictures, of which the usual share is taken
ROUNDS = 10  # at most, in which a curve comes to the flanks, each by up to `REACH`
STEADY = 0.3  # of a change from picture to picture is taken for motion, where it is not that of the ones before


@dataclass(frozen=True)
class OutlineSearch:
    """What was found in T pictures."""

    state: Array  # (T, 1 + K) of the curves that were predicted
    away: Array  # (T, 2, M) m, from these curves to the flanks; NaN where not seen


def body_place(rec: entries.Recording, view: View) -> flanks.BodyPlace:
    """Where the body of a recording is looked for."""
    length = rec.beam.length
    count = math.ceil(length * plane.scale_of(view, length) / STATION)
    stations = flanks.Stations(length, min(max(2 * POINTS, count), STATIONS))
    base, paper = rec.tags.on_base[0].s, flanks.PAPER * rec.tags.size / length
    hidden = np.min([np.abs(stations.s - s) for s in (base, *(tag.s for tag in rec.tags.on_beam))], axis=0) < paper
    width = math.nan if rec.outline is None else rec.outline.width
    return flanks.BodyPlace(rec.name, view, stations, hidden | (stations.s < base), width)


class FlankFollower:
    """Follows the flanks through consecutive pictures. Each is searched near where the two before predict the body,
    near where it was last and first, and from the clamp on. A picture in which the body is lost shows no flanks."""

    def __init__(self, place: flanks.BodyPlace) -> None:
        self.place = place
        self.body: flanks.OutlinedBody | None = None  # in the first picture
        self._seen: deque[float] = deque(maxlen=USUAL)
        self._last: tuple[Array, Array, Array] | None = None  # the curve's numbers, their last and their usual change

    def step(self, sight: flanks.Sight) -> tuple[Array, Array]:
        """(1 + K,) numbers of the curve along which the flanks were looked for, and (2, M) m from it to them.

        Raises:
            ObservationError: the first picture shows no body beside the clamp.
        """
        body = self.body = self.body or flanks.grown(sight, self.place)
        still = np.zeros_like(body.state)
        last, newest, usual = (body.state, still, still) if self._last is None else self._last
        least = LOST * (float(np.median(self._seen)) if self._seen else 0.0)
        best: tuple[float, Array, Array, Array] | None = None
        moving = [last + usual, last + newest] if np.any(newest) else []
        for start in (*moving, last, body.state):
            tried = _near(sight, self.place, body, start)
            best = tried if best is None or tried[0] > best[0] else best
            if best[0] > least:
                break
        else:
            tried = _near(sight, self.place, body, flanks.grown(sight, self.place, body).state)
            best = tried if best is None or tried[0] > best[0] else best
        assert best is not None
        share, state, away, new = best
        if not share > least:
            self._last = last, still, still
            return state, np.full_like(away, np.nan)
        self._last = new, new - last, usual + STEADY * (new - last - usual)
        self._seen.append(share)
        return state, away


def follow(sights: Iterable[flanks.Sight], place: flanks.BodyPlace) -> tuple[OutlineSearch, Array]:
    """The flanks in consecutive pictures, and half the width (M,) m in the first of them."""
    follower = FlankFollower(place)
    state, away = zip(*(follower.step(sight) for sight in sights), strict=True)
    assert follower.body is not None
    return OutlineSearch(np.stack(state), np.stack(away)), follower.body.half


def each_alone(sights: Iterable[flanks.Sight], place: flanks.BodyPlace) -> tuple[OutlineSearch, Array]:
    """As `follow`, of pictures that have nothing to do with each other."""
    tried = [_alone(one, place) for one in sights]
    half = np.median([body.half for body, _ in tried], axis=0)
    return OutlineSearch(np.stack([body.state for body, _ in tried]), np.stack([away for _, away in tried])), half


def _alone(sight: flanks.Sight, place: flanks.BodyPlace) -> tuple[flanks.OutlinedBody, Array]:
    body = flanks.grown(sight, place)
    away = flanks.find_flanks(sight, place.stations.curve(body.state), body.half, body.look)
    return body, np.where(place.hidden, np.nan, away)


def _near(
    sight: flanks.Sight, place: flanks.BodyPlace, body: flanks.OutlinedBody, state: Array
) -> tuple[float, Array, Array, Array]:
    """Near the curve of `state`: the share of the stations that show both flanks as wide apart as the body is, the
    curve (1 + K,) that the flanks were looked for along, they (2, M) m from it, and the curve between them."""
    stations, hidden = place.stations, place.hidden
    sd = flanks.MEASURED / float(np.median(sight.outward(stations.curve(state))[1]))
    for _ in range(ROUNDS):
        curve = stations.curve(state)
        away = np.where(hidden, np.nan, flanks.find_flanks(sight, curve, body.half, body.look))
        new = stations.fitted(state, nan_mean(away - flanks.SIDES[:, None] * body.half), sd)
        if np.max(np.abs(stations.across(curve) @ (new - state))) < FAR * flanks.REACH * sd / flanks.MEASURED:
            break
        state = new
    wide = np.abs(away[0] - away[1] - 2.0 * body.half) < WIDE * sd / flanks.MEASURED
    return float(np.mean(wide[~hidden])), state, away, new


# Beside tags: what moves with the tags is the body. Their places and directions say where its middle runs in each
# picture. Along normals of that curve the body's edges stay, while what lies behind it passes by.

TAG_PLACE, TAG_TURN, CLAMP_TURN = 3e-4, 0.03, 0.02  # m, rad, rad: one sd of a tag, and of the clamp's direction
STEPS = 3  # of Gauss and Newton's method from the curve of the picture before
FINEST = 300  # samples of a profile, at most
LOOKED_AT = 40  # pictures, spread evenly, in which an edge must stay
NOISY = 8  # likewise, of which the noise of a colour is taken
STEEP = 8  # samples by which a lasting edge may step from station to station
BEND_COST = 0.04  # of a clear edge: what a step by one sample, or to the next of `UNEQUAL`, costs
UNEQUAL: Array = np.arange(-4, 5) / 10.0  # of half the width, by which the middle between the edges may be off the tags
UNEQUAL_COST = 2.0  # of a clear edge, over its square
PAIRED = 3  # samples, by which both edges may be off such a place
BARRED = 1e3  # of clear edges: what no line takes
STAYS = 0.4  # of its usual size, at least, that a lasting edge has in one picture
_NO_EDGES = "no two edges of a body move with the tags"


@dataclass(frozen=True)
class Straightened:
    """T pictures of the body, straightened along curves: J colours outward from each of M stations, to both sides."""

    state: Array  # (T, 1 + K) of the curves; NaN where a picture shows none
    colour: NDArray[np.uint8]  # (T, 2, M, J, 3)
    sample: Array  # (T, M) m from one colour to the next


def through_tags(stations: flanks.Stations, tags: Markers) -> Array:
    """(T, 1 + K) numbers of smooth curves from the clamp through the tags, along their directions; NaN without tags."""
    state, out = np.zeros(1 + flanks.STATES), np.full((len(tags.xy), 1 + flanks.STATES), np.nan)
    at = np.array([int(np.argmin(np.abs(stations.s - s))) for s in tags.s])
    turns = np.column_stack([np.zeros(stations.count), stations.functions])
    for t, seen in enumerate(np.isfinite(tags.xy).all(axis=2) & np.isfinite(tags.angle)):
        here = at[seen]
        for _ in range(STEPS if seen.any() else 0):
            curve = stations.curve(state)
            away = np.sum((tags.xy[t, seen] - curve.xy[here]) * curve.normal[here], axis=1)
            whole = np.concatenate(
                [
                    stations.across(curve)[here] / TAG_PLACE,
                    turns[here] / TAG_TURN,
                    turns[:1] / CLAMP_TURN,
                    np.diag(1.0 / stations.prior),
                ]
            )
            right = np.concatenate(
                [
                    away / TAG_PLACE,
                    (tags.angle[t, seen] - curve.angle[here]) / TAG_TURN,
                    -curve.angle[:1] / CLAMP_TURN,
                    -state / stations.prior,
                ]
            )
            state = state + np.linalg.lstsq(whole, right, rcond=None)[0]
            out[t] = state
    return out


def straightened(sights: Iterable[flanks.Sight], stations: flanks.Stations, state: Array) -> Straightened:
    """The pictures along the curves of these numbers (T, 1 + K)."""
    out: Array = np.zeros(0)

    def one(seen: tuple[flanks.Sight, Array]) -> tuple[NDArray[np.uint8], Array]:
        nonlocal out
        sight, curve = seen[0], stations.curve(np.nan_to_num(seen[1]))
        normal, scale = sight.outward(curve)
        if not len(out):
            widest = flanks.WIDEST * stations.length * float(np.max(scale))  # px
            out = np.arange(0.0, widest, max(flanks.STEP, widest / FINEST))
        places = sight.pixels(curve.xy)[:, None] + flanks.SIDES[:, None, None, None] * out[:, None] * normal[:, None]
        return (np.nan_to_num(sight.planes.at(places), copy=False) + 0.5).astype(np.uint8), out[1] / scale

    with ThreadPoolExecutor(1) as beside:  # while the next picture is read
        colour, sample = zip(*in_order(beside, one, zip(sights, state, strict=True), ahead=2), strict=True)
    return Straightened(state, np.stack(colour), np.stack(sample))


def lasting_edges(seen: Straightened, hidden: BoolArray, pixel_sd: Array) -> tuple[IntArray, Array]:
    """(2, M) the sample at which each side's edge stays in all pictures: the two lines along the body whose steps of
    colour are the largest together; and their size, in sds of a colour. Raises `ObservationError` where nothing of the
    body is seen."""
    known = np.flatnonzero(np.isfinite(seen.state[:, 0]))
    if hidden.all() or not len(known) or seen.colour.shape[3] <= 4 * flanks.SAMPLES_ASIDE:
        raise ObservationError(_NO_EDGES, about="outline")
    chosen = known[np.unique(np.linspace(0, len(known) - 1, LOOKED_AT).astype(int))]
    at = np.arange(flanks.SAMPLES_ASIDE, seen.colour.shape[-2] - flanks.SAMPLES_ASIDE)
    size = np.median([flanks.step_size(seen.colour[one].astype(np.float32), at, pixel_sd) for one in chosen], axis=0)
    shown = np.where(hidden[:, None], 0.0, size)
    usual = np.median(shown[:, ~hidden].max(axis=2), axis=1)[:, None, None]
    worth = np.minimum(shown / np.maximum(usual, 1.0), 1.0)
    likely = np.where(about_as_far(worth, at), worth, -BARRED)
    place = np.stack([best_line(one[:, None])[:, 1] for one in likely])
    return at[place], np.take_along_axis(size, place[..., None], axis=2)[..., 0]


def about_as_far(worth: Array, at: IntArray) -> BoolArray:
    """(2, M, J) whether both edges of one body may be there: near the two lines, about equally far from its middle,
    whose `worth` (2, M, J) at the samples `at` (J,) is largest together. A thing beside the body has but one edge."""
    near = maximum_filter1d(worth, 2 * PAIRED + 1, axis=2)
    sides = [np.rint(at * (1.0 + side * UNEQUAL[:, None])).astype(np.int64) - at[0] for side in flanks.SIDES]
    inside = np.all([(one >= 0) & (one < len(at)) for one in sides], axis=0)  # (R, J)
    both = sum(one[:, place.clip(0, len(at) - 1)] for one, place in zip(near, sides, strict=True))
    line = best_line(np.where(inside, both - UNEQUAL_COST * UNEQUAL[:, None] ** 2, -BARRED))
    chosen = np.stack([place[line[:, 0], line[:, 1]] for place in sides])
    return np.asarray(np.abs(np.arange(len(at)) - chosen[..., None]) <= 2 * PAIRED)


def best_line(worth: Array) -> IntArray:
    """(M, 2) the places in the planes of `worth` (M, R, J) with the largest sum; steps from one to the next are paid
    for (Viterbi)."""
    best, came = worth[0], np.zeros((*worth.shape, 2), dtype=np.int8)
    shifts = np.arange(-STEEP, STEEP + 1)
    for row in range(1, len(worth)):
        padded = np.pad(best, ((0, 0), (STEEP, STEEP)), constant_values=-np.inf)
        along = np.lib.stride_tricks.sliding_window_view(padded, len(shifts), axis=1) - BEND_COST * np.abs(shifts)
        step, best = np.argmax(along, axis=2), along.max(axis=2)
        padded = np.pad(best, ((1, 1), (0, 0)), constant_values=-np.inf)
        beside = np.stack([padded[:-2] - BEND_COST, padded[1:-1], padded[2:] - BEND_COST])
        turn = np.argmax(beside, axis=0)
        best = worth[row] + beside.max(axis=0)
        before = np.clip(np.arange(len(best))[:, None] + turn - 1, 0, len(best) - 1)
        came[row, ..., 0], came[row, ..., 1] = turn - 1, shifts[np.take_along_axis(step, before, axis=0)]
    line = [np.array(np.unravel_index(int(np.argmax(best)), best.shape))]
    for row in range(len(worth) - 1, 0, -1):
        line.append(line[-1] + came[row, line[-1][0], line[-1][1]])
    return np.array(line[::-1])


def with_tags(
    sights: Iterable[flanks.Sight], stations: flanks.Stations, hidden: BoolArray, tags: Markers
) -> tuple[OutlineSearch, Array]:
    """The flanks in pictures whose `tags` are known, and half the body's width (M,) m."""
    seen = straightened(sights, stations, through_tags(stations, tags))
    some = seen.colour[:: max(1, len(seen.colour) // NOISY)].astype(np.float32)
    pixel_sd = np.maximum(flanks.pixel_noise(some, axis=3), 1.0)
    place, size = lasting_edges(seen, hidden, pixel_sd)
    least = np.maximum(STAYS * size, flanks.LEAST)
    found = []
    for state, colour, sample in zip(seen.state, seen.colour, seen.sample, strict=True):
        if np.isnan(state[0]):
            found.append(np.full(place.shape, np.nan))
            continue
        sd = flanks.MEASURED * float(np.median(sample)) / flanks.STEP
        coarse = np.where(hidden, np.nan, flanks.edges_near(colour, place.astype(float), least, pixel_sd, fine=False))
        smooth = stations.fitted(state, flanks.SIDES[:, None] * (coarse - place) * sample, sd)
        expected = place + flanks.SIDES[:, None] * (stations.across(stations.curve(state)) @ (smooth - state)) / sample
        away = np.where(hidden, np.nan, flanks.edges_near(colour, expected, least, pixel_sd))
        away = np.where(np.abs(away - expected) * flanks.STEP < flanks.NEAR, away, np.nan)
        found.append(flanks.SIDES[:, None] * away * sample)
    away, half = np.stack(found), 0.5 * place.sum(axis=0) * np.median(seen.sample, axis=0)
    if np.isfinite(away[:, :, ~hidden]).mean() < LEAST_SEEN:
        raise ObservationError(_NO_EDGES, about="outline")
    return OutlineSearch(bridged(np.arange(len(away), dtype=float), seen.state), away), half


# The centreline: the width is the same in all pictures; flanks that contradict it, or their neighbours, are left out.

OUTLIER = 4.0  # sds
BORDER = 3  # stations: so near to one where it is hidden, the body's width is not read; a tag's paper has edges too
LEAST_SHARE = 0.4  # of the stations that a point stands for, and of the frames in which it is seen
LEAST_SEEN = 0.5  # of all places in all frames: with fewer the curve is not that of a body
MOST_OFF = 0.1  # of its width, by which one body may seem to change it


def body_width(away: Array, half: Array) -> tuple[Array, float]:
    """(M,) m, the body's width by its flanks (T, 2, M) in all pictures, and one sd [m] of it in a single one; `half`
    (M,) is what the first picture shows of it."""
    width = away[:, 0] - away[:, 1]
    often = np.isfinite(width).sum(axis=0) > 0.1 * len(width)
    usual = np.where(often, nan_median(width), 2.0 * half)
    if len(width) == 1:  # a picture alone: by its neighbours along the body
        usual = np.where(often, running_median(usual, flanks.NEIGHBOURS), usual)
    return usual, MAD_TO_SD * float(np.nanmedian(np.abs(width - usual)))


def middles(each: Array, smooth: Array, spread: float) -> Array:
    """(T, M) m, the middles of both flanks by each of them (T, 2, M); where they contradict each other that of the one
    nearer to the `smooth` (T, M) curve. `spread` m: one sd of their difference."""
    apart = np.abs(each[:, 0] - each[:, 1]) > OUTLIER * spread
    off = np.abs(each - smooth[:, None])
    farther = np.stack([off[:, 0] > off[:, 1], off[:, 1] >= off[:, 0]], axis=1)
    kept = np.where(apart[:, None] & farther, np.nan, each)
    return nan_mean(np.moveaxis(kept, 1, 0))


@dataclass(frozen=True)
class Middle:
    """The centreline through M stations in T pictures."""

    state: Array  # (T, 1 + K) of smooth curves
    away: Array  # (T, M) m from them; NaN where not seen
    apart: Array  # (T, M) m, by how much the flanks are farther apart than the body is wide; NaN where one is not seen
    sd: float  # m, white, of one station
    alike: float  # correlation of neighbouring stations
    width: Array  # (M,) m


def centreline(found: OutlineSearch, stations: flanks.Stations, half: Array, sd: float) -> Middle:
    """The middle between the flanks; `sd` m is that of the fits of smooth curves."""
    width, spread = body_width(found.away, half)
    each = found.away - 0.5 * flanks.SIDES[:, None] * width
    states = np.stack([stations.fitted(*one, sd) for one in zip(found.state, each, strict=True)])
    smooth = np.stack([stations.across(stations.curve(a)) @ (b - a) for a, b in zip(found.state, states, strict=True)])
    away = middles(each, smooth, spread) - smooth
    apart = each[:, 0] - each[:, 1]
    apart = np.where(np.abs(apart) <= OUTLIER * spread, apart, np.nan)
    local = away - running_median(away.T, flanks.NEIGHBOURS).T
    white = MAD_TO_SD * float(np.nanmedian(np.abs(local)))
    away = np.where(np.abs(local) <= OUTLIER * white, away, np.nan)
    local = np.clip(local / max(white, 1e-12), -OUTLIER, OUTLIER)
    alike = float(np.nanmean(local[:, 1:] * local[:, :-1]) / max(float(np.nanmean(local**2)), 1e-12))
    return Middle(states, away, apart, white, min(max(alike, 0.0), 0.9), width)


def outline_track(
    rec: entries.Recording,
    view: View,
    corners: Array,
    pictures: Iterable[flanks.Planes],
    *,
    tags: Markers | None = None,
    apart: bool = False,
) -> OutlineTrack:
    """The body's centreline in T pictures, in which the base tags' corners (T, b, 4, 2) [px] are known; `view` is that
    of the base tag's plane and frame. Pictures that are far `apart` are searched each by itself, from the clamp on.

    Raises:
        ObservationError: no body is seen beside the clamp, or it is lost.
    """
    place = body_place(rec, view)
    shift = corners.mean(axis=2) - nan_median(corners.mean(axis=2))
    shift = nan_mean(np.moveaxis(shift, 1, 0))
    shift = bridged(np.arange(len(shift), dtype=float), shift)
    looked = np.unique(np.linspace(0, len(shift) - 1, body_end.PICTURES).astype(int))
    at_end: dict[int, flanks.Sight] = {}

    def sights() -> Iterator[flanks.Sight]:
        for row, picture in enumerate(pictures):
            sight = flanks.Sight(picture, view, shift[row])
            if row in looked and not place.hidden[-1]:
                at_end[row] = sight
            yield sight

    if tags is not None:
        found, half = with_tags(sights(), place.stations, place.hidden, tags)
    else:
        found, half = (each_alone if apart else follow)(sights(), place)
    return track_of(place, found, half, shift, at_end)


def track_of(
    place: flanks.BodyPlace,
    found: OutlineSearch,
    half: Array,
    shift: Array,
    at_end: Mapping[int, flanks.Sight] = MappingProxyType({}),
) -> OutlineTrack:
    """The centreline of the body whose flanks were found in T pictures that lie `shift` (T, 2) px off the view's;
    `half` (M,) m of its width in the first of them. The body's end is looked for in the pictures `at_end`, by their
    numbers among the T.

    Raises:
        ObservationError: what was followed is no body of one width from clamp to tip.
    """
    middle = centreline(found, place.stations, half, flanks.MEASURED / place.scale)
    refuse_lost(middle, found, ~place.hidden, place.name)
    points = points_of(middle, found, place.stations, place.view, shift, place.scale)
    strays = np.stack([jumps(points.px[:, i], STRAY) for i in range(POINTS)], axis=1)
    points = often_seen(replace(points, sd=np.where(strays, np.nan, points.sd)))
    points = with_end(points, middle, place, shift, at_end)
    both = (np.isfinite(found.away).all(axis=1).mean(axis=0) > LEAST_SHARE) & (middle.width > 0.0)
    both = np.convolve(both, np.ones(2 * BORDER + 1), "same") > 2 * BORDER
    width = np.column_stack([place.stations.s, middle.width])[both]
    return replace(points, width=width, remarks=(*points.remarks, *width_remarks(place, half), *lost_remarks(found)))


def with_end(
    points: OutlineTrack, middle: Middle, place: flanks.BodyPlace, shift: Array, at_end: Mapping[int, flanks.Sight]
) -> OutlineTrack:
    """The points and, where it is seen `at_end`, the body's end, as one more at s = 1: it is the same place of the body
    in all T pictures, whatever lies over it in some."""
    stations, shown = place.stations, np.asarray(np.isfinite(middle.away).any(axis=1))
    ends = [body_end.last_point(stations.curve(state)) for state in middle.state]
    looked = [row for row in at_end if shown[row]]
    if not looked:
        return points
    width = float(middle.width[-1])
    beyond = body_end.body_end([at_end[i] for i in looked], [ends[i] for i in looked], stations.length, width)
    seen, off = np.isfinite(beyond), float(nan_median(beyond))
    if not seen.any():
        return points
    if off > body_end.NEAR * stations.length + body_end.APART:
        text = (
            f"The body ends {1e3 * off:.0f} mm beyond the place that length_m = {stations.length:.4g} says: correct "
            "length_m, or size_m of the tags."
        )
        return replace(points, remarks=(Remark("warning", text, doubt=True, about="length"),))
    tip, along = np.concatenate([end.xy for end in ends]), unit(np.concatenate([end.angle for end in ends]))
    tip = tip + np.interp(np.arange(len(tip)), np.array(looked)[seen], beyond[seen])[:, None] * along
    ahead = tip + 0.5 / POINTS * stations.length * along
    px, ahead = (plane.project(place.view, at)[:, None] + shift[:, None] for at in (tip, ahead))
    sd = np.where(shown, END_SD * place.scale * np.sqrt(shown.sum()), np.nan)  # alike in all pictures
    return replace(
        points,
        s=np.append(points.s, 1.0),
        px=np.concatenate([points.px, px], axis=1),
        ahead=np.concatenate([points.ahead, ahead], axis=1),
        sd=np.column_stack([points.sd, sd]),
    )


# Beside tags the outline is used only where it agrees with them. A tag may sit beside the middle of the body, by its
# placement, or seem to, where the rim of a round body lies below it; as the body bends, it stays there.

MOST_READ = 160  # pictures at most are read beside tags: the errors of an outline last, and more pictures tell no more
BESIDE = 3e-4  # m: one sd of where a tag's middle seems to lie, besides its placement
MOVED = 5e-3  # of the length: a line that moves more against a tag is not the body's
TURNED = 0.03  # rad, likewise by its direction there
APART = 1.5  # times its own sds: tags curl and lie at heights of their own, so that both agree less


def with_outline(
    tags: camera.MeasuredTags,
    markers: Markers,
    number: IntArray,
    *,
    apart: bool = False,
    kept: video.KeptFrames | None = None,
    progress: Progress = Silent(),
) -> Markers:
    """The `markers` of these tags, in frames of this `number`, with points of the body's outline; a note where there
    are tags that the outline does not agree with, and it is left out. `kept` takes notice of all frames of the film, so
    that others need not read it again.

    Raises:
        RecordingError: the film cannot be read.
        ObservationError: as `outline_track`, without tags on the body.
    """
    rec = tags.description
    each = math.ceil(len(number) / MOST_READ) if rec.tags.on_beam and not apart else 1
    read = np.arange(0, len(number), each)

    def pictures() -> Iterator[flanks.Planes]:
        assert rec.video is not None
        wanted = frozenset(number[read].tolist())
        for index, _, raw in track(progress, "Following the outline", video.timed(rec.video), len(wanted)):
            if kept is not None and not rec.video.topic:
                kept.keep(rec.video, index, raw)
            if index in wanted:
                yield flanks.planes_of(rec, index, raw)

    return outlined(tags, markers, read, pictures(), apart=apart)


def outlined(
    tags: camera.MeasuredTags,
    markers: Markers,
    read: IntArray,
    pictures: Iterable[flanks.Planes],
    *,
    apart: bool = False,
) -> Markers:
    """As `with_outline`, by `pictures` of the frames `read` (R,) among those of the markers."""
    rec, corners = tags.description, tags.detections.corners
    base = corners[read, : len(rec.tags.on_base)]
    of_read = replace(markers, xy=markers.xy[read], angle=markers.angle[read]) if rec.tags.on_beam else None

    def found() -> OutlineTrack:
        assert markers.view is not None
        few = outline_track(rec, markers.view, base, pictures, tags=of_read, apart=apart)
        outline = spread_over(few, read, len(corners))
        hung: BoolArray = ~np.asarray(np.isfinite(corners).any(axis=(1, 2, 3)))
        return replace(outline, sd=np.where(hung[:, None], np.nan, outline.sd))

    return joined(tags, markers, found)


def joined(tags: camera.MeasuredTags, markers: Markers, found: Callable[[], OutlineTrack]) -> Markers:
    """The `markers` of these tags with the points of the outline that is `found` in the same frames; raises, and leaves
    it out, as `with_outline`."""
    rec = tags.description
    if rec.tags.on_beam and np.max(np.abs(markers.base_angle)) > TURNED:
        return replace(markers, remarks=(*markers.remarks, left_out("the clamp turns in the picture")))
    try:
        outline = found()
        sd = (APART if rec.tags.on_beam else 1.0) * outline.sd
        both = tags.markers(replace(outline, sd=sd))
        doubt = contradicted(both, rec)
    except ObservationError as wrong:
        if not rec.tags.on_beam:
            raise
        doubt = str(wrong).split(". ")[0].removeprefix(f"{rec.name}: ")
    return replace(markers, remarks=(*markers.remarks, left_out(doubt))) if doubt else both


def spread_over(outline: OutlineTrack, kept: IntArray, count: int) -> OutlineTrack:
    """The outline of the frames `kept` among `count`: not seen in the others, where its curve runs between those."""
    every = np.arange(count)
    after = np.clip(np.searchsorted(kept, every), 1, len(kept) - 1) if len(kept) > 1 else np.zeros(count, dtype=int)
    before = np.maximum(after - 1, 0)
    share = np.clip((every - kept[before]) / np.maximum(kept[after] - kept[before], 1), 0.0, 1.0)[:, None, None]
    px, ahead = ((1.0 - share) * one[before] + share * one[after] for one in (outline.px, outline.ahead))
    sd = np.full((count, outline.sd.shape[1]), np.nan)
    sd[kept] = outline.sd
    return replace(outline, px=px, ahead=ahead, sd=sd)


def left_out(why: str) -> Remark:
    """That the tags alone are used."""
    return Remark("note", f"The body's outline is not used beside the tags: {why}.")


def contradicted(both: Markers, rec: entries.Recording) -> str:
    """Where the outline contradicts the tags, in words; "" where it does not, or there are none between its points."""
    assert both.traced is not None
    points = np.flatnonzero(both.traced & (both.tag_id != END_ID))
    for tag in np.flatnonzero(~both.traced).tolist():
        before, after = points[both.s[points] < both.s[tag]], points[both.s[points] > both.s[tag]]
        if not len(before) or not len(after):
            continue
        away, direction = _from_line(both, tag, before[-1], after[0], rec.beam.length)
        turn = np.angle(np.exp(1j * (direction - both.angle[:, tag])))
        seen = np.isfinite(away) & np.isfinite(turn)
        if not seen.any():
            continue
        beside, aside = float(np.median(away[seen])), float(np.median(turn[seen]))
        moved, turned = float(np.max(np.abs(away[seen] - beside))), float(np.max(np.abs(turn[seen] - aside)))
        lean = 0.0 if both.view is None else plane.lean_of(both.view, both.xy[seen, tag])
        name, most = f"tag {both.tag_id[tag]}", 3.0 * math.hypot(rec.tags.placement_sd, BESIDE, lean * plane.HEIGHT_SD)
        if abs(beside) > most:
            return f"it passes {1e3 * abs(beside):.2g} mm beside the middle of {name}"
        if moved > MOVED * rec.beam.length:
            return f"it moves by up to {1e3 * moved:.2g} mm against {name}"
        if turned > TURNED:
            return f"it turns by up to {math.degrees(turned):.2g} degrees against {name}"
    return ""


def _from_line(both: Markers, tag: int, before: int, after: int, length: float) -> tuple[Array, Array]:
    """(T,) m of a tag to the left of the curve through two points of the outline with their directions (Hermite), and
    (T,) rad, this curve's direction beside the tag (as of a parabola, which the noise of these directions turns
    least)."""
    span = float(both.s[after] - both.s[before])
    u = float(both.s[tag] - both.s[before]) / span
    ends = [both.xy[:, before], both.xy[:, after]]
    slopes = [span * length * unit(both.angle[:, i]) for i in (before, after)]
    rise = u * u * (3.0 - 2.0 * u)
    line = (1.0 - rise) * ends[0] + rise * ends[1] + u * (1.0 - u) * ((1.0 - u) * slopes[0] - u * slopes[1])
    chord = ends[1] - ends[0]
    left = left_of(chord) / np.linalg.norm(chord, axis=1)[:, None]
    direction = np.arctan2(chord[:, 1], chord[:, 0]) + (u - 0.5) * (both.angle[:, after] - both.angle[:, before])
    return np.asarray(np.sum((both.xy[:, tag] - line) * left, axis=1)), np.asarray(direction)


def refuse_lost(middle: Middle, found: OutlineSearch, shown: BoolArray, name: str) -> None:
    """Raises `ObservationError` where what was followed is no body of one width from clamp to tip; `shown` (M,)
    stations do not lie under tags."""
    seen = np.isfinite(middle.away[:, shown])
    share = seen.mean()
    hint = (
        "Look at the curve that `onebend check` draws. Light the body so that it stands out from its background, clear "
        "away what lies beside it, state its width near the clamp (width_m in [outline]), or put tags on it."
    )
    if share < LEAST_SEEN:
        raise ObservationError(
            f"{name}: the body's outline is lost: both edges of one body are seen at {100 * share:.0f} % of its places "
            f"only. {hint}",
            about="outline",
        )
    width = (found.away[:, 0] - found.away[:, 1])[:, shown]
    off = MAD_TO_SD * float(np.nanmedian(np.abs(width - middle.width[shown]))) / float(np.median(middle.width[shown]))
    if off > MOST_OFF:
        raise ObservationError(
            f"{name}: the curve that was followed leaves the body: its width changes by {100 * off:.0f} % from picture "
            f"to picture. {hint}",
            about="outline",
        )
    tip = seen[:, -max(1, len(shown) // 20) :].mean()
    if tip < LEAST_SHARE:
        raise ObservationError(
            f"{name}: the body's edges end before its tip (seen there in {100 * tip:.0f} % of the frames). Is length_m "
            f"too long, or the tip out of the picture? {hint}",
            about="outline",
        )


def width_remarks(place: flanks.BodyPlace, half: Array) -> tuple[Remark, ...]:
    """A warning where the body that was followed is not as wide near the clamp as is stated; `half` (M,) m."""
    seen = 2.0 * float(half[np.argmin(place.hidden)])
    text = (
        f"The edges that are followed are {1e3 * seen:.3g} mm apart near the clamp, not {1e3 * place.width:.3g} mm as "
        "width_m in [outline] says. Look at the curve that `onebend check` draws, and correct width_m."
    )
    far = abs(seen - place.width) > flanks.WIDTH_OFF * place.width
    return (Remark("warning", text, about="outline"),) if far else ()


def lost_remarks(found: OutlineSearch) -> tuple[Remark, ...]:
    """A note where some frames do not show the body."""
    lost = int(np.sum(~np.isfinite(found.away).any(axis=(1, 2))))
    text = f"The body's outline was lost in {lost} of {len(found.away)} frames; they are left out of it."
    return (Remark("note", text),) if lost else ()


STRAY = 3.0  # px: a point so far from where it is in the pictures beside is another thing's
END_SD = 2e-4  # m, of the end that is seen from that which `length_m` means: a cut is not square, a rim is round
SHARED = 2.0  # sds of what both flanks show: light, walls and blur shift both alike, which their distance hides


def lasting_sd(apart: Array) -> Array:
    """(n,) m, one sd of points in the middle of two flanks, as if their errors were new in each picture and alike
    nowhere; `apart` (T, n) m: by how much the flanks are farther apart than the body is wide, both errors being
    independent. NaN where both are never seen: then the body's width is not known."""
    alike = np.nan_to_num(apart)
    times = correlation_time(alike) * correlation_time(alike.T, longest=2)
    return np.asarray(0.5 * SHARED * np.sqrt(times) * np.sqrt(nan_mean(apart**2)))


def points_of(
    middle: Middle, found: OutlineSearch, stations: flanks.Stations, view: View, shift: Array, scale: float
) -> OutlineTrack:
    """Points of the centreline, each the mean of the stations about it, in pictures that lie `shift` (T, 2) px off the
    view's; `scale` px/m."""
    s = PLACES
    group = np.minimum((stations.s * POINTS).astype(int), POINTS - 1)
    means = np.eye(POINTS)[group]  # (M, n)
    seen = np.isfinite(middle.away)
    count = seen @ means
    shown = count >= LEAST_SHARE * means.sum(axis=0)
    away = np.divide(np.where(seen, middle.away, 0.0) @ means, count, out=np.zeros(count.shape), where=count > 0)
    few = count * (1.0 - middle.alike) / (1.0 + middle.alike)
    apart = np.stack([nan_mean(middle.apart[:, group == i].T) for i in range(POINTS)], axis=1)
    sd = np.where(shown, scale * np.maximum(middle.sd / np.sqrt(np.maximum(few, 1.0)), lasting_sd(apart)), np.nan)
    px, ahead = np.empty((*away.shape, 2)), np.empty((*away.shape, 2))
    for t in range(len(away)):
        predicted, smooth = stations.curve(found.state[t]), stations.curve(middle.state[t])
        off = stations.across(predicted) @ (middle.state[t] - found.state[t])
        xy = predicted.xy + off[:, None] * predicted.normal
        at = [np.interp(s, stations.s, values) for values in (*xy.T, smooth.angle)]
        tangent = unit(at[2])
        there = np.stack(at[:2], axis=1) + away[t][:, None] * left_of(tangent)
        px[t] = plane.project(view, there) + shift[t]
        ahead[t] = plane.project(view, there + 0.5 / POINTS * stations.length * tangent) + shift[t]
    return OutlineTrack(s, px, ahead, sd)


def often_seen(outline: OutlineTrack) -> OutlineTrack:
    """Without the points that most frames do not show."""
    kept = np.isfinite(outline.sd).mean(axis=0) >= LEAST_SHARE
    px, ahead, sd = (one[:, kept] for one in (outline.px, outline.ahead, outline.sd))
    return replace(outline, s=outline.s[kept], px=px, ahead=ahead, sd=sd)
