"""What a film tells of the force without a model of the beam: features of the markers in time, for the clock search."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly

from onebend.recording.force_noise import LoadChange, load_changes
from onebend.recording.signals import LONG_GAP, MAD_TO_SD, bandwidth, bridged, from_clamp, runs, step
from onebend.records import Array, BoolArray, Markers, left_of, unit

# Features on which the clock search regresses the force:
# - Levers: the moment of the force about the middle of a span is proportional to the span's turn. So F = sum_i k_i f_i
#   with f_i = (A^T A + ridge)^-1 A^T e_i turn_i, A the levers (moment = A F) and k_i one stiffness per span. The ridge
#   bounds the force along a straight beam.
# - Polynomials of the leading principal components: any smooth function of the shape. They correct the levers, or stand
#   alone where the place of the push is not known or the beam swings.
# - Moments: the turn of a span is `F . integral of w(s) a(s) ds` with w = 1 / k and a the lever of a unit force about
#   s, exact for a beam that moves slowly. Of w, the mean over the span and the slope are used.

CORRECTIONS = (0.01, 0.001)  # prior sds, tried in turn, of what corrects the levers
MOST_FRAMES = 4000  # of the film; of more every so manyth is taken: some sixteen a row are left
STEPS = 0.3  # of the largest force: sd of a log's error that changes where the load begins, reverses, ends
HOLD = 2.0  # s before (after) the film for which a beam at rest in its first (last) frames stays so
FREE = 10.0  # prior sd of the log's bias and of a stiffness, per largest force: free
RIDGE = 0.01  # of the longest lever squared
SHORTEST_SPAN = 0.05  # of the beam: a shorter span between a tag and the push does not count
TERMS = (2.0, 0.5, 0.25)  # prior sd of a polynomial's coefficient by degree, per largest force
TOUCHED = 0.02  # of the largest displacement: a smaller one counts as rest
PARTS = 5  # into which a change of the load is divided; the log's error may change in each
SLACK = 0.2  # s, by which the log's error may change before or after the load does
FEWEST_SPANS = 2  # that end at or before the push
STILL = 10  # first and last frames in which the beam may be at rest
FEWEST = 10  # frames, and rows of the log
LOAD_DOUBT = 0.05  # s, sd of the offset from not knowing when the log's error changes with the load


@dataclass(frozen=True)
class Track:
    """Features in time, to be averaged over any span."""

    integral: PPoly  # antiderivative of the features, (...)
    covered: BoolArray  # (T,) frames whose features are known
    time: Array  # (T,) s, video clock
    before: float  # s before the film for which its first frames are taken to hold
    after: float  # s after the film for which its last frames are taken to hold
    # Of features (c,) for the regression so many tell the force along either axis by a coefficient of its own; behind
    # them stand what the others tell of it along x, and then along y, by one coefficient for both.
    own: int = 0
    doubt: float = 0.0  # s, sd of an offset found by it, beside what its evidence says

    @property
    def duration(self) -> float:
        """s, of the film."""
        return float(self.time[-1] - self.time[0])

    def mean(self, centre: Array, width: float) -> Array:
        """(N, ...) features averaged over `width` [s] around every `centre`; NaN where the film does not cover it."""
        first_centre, last_centre = self.time[0] + width / 2, self.time[-1] - width / 2
        outside = (centre < first_centre - self.before) | (centre > last_centre + self.after)
        centre_held = np.where(outside, centre, np.clip(centre, first_centre, last_centre))
        low, high = centre_held - width / 2, centre_held + width / 2
        average = np.asarray((self.integral(high) - self.integral(low)) / width)
        holes = np.concatenate([[0], np.cumsum(~self.covered)])
        first, last = np.searchsorted(self.time, low), np.searchsorted(self.time, high)
        inside = (low >= self.time[0] - 1e-9) & (high <= self.time[-1] + 1e-9)
        full = holes[np.minimum(last + 1, len(self.time))] == holes[np.maximum(first - 1, 0)]
        average[~(inside & full)] = np.nan
        return average


@dataclass(frozen=True)
class Moments:
    """Turns and levers of k spans in time, to be averaged over any span of time."""

    track: Track  # features (k, 5): turn, mean of the lever, its first Legendre moment
    tangent: Track  # (2,), change of all levers with the place of the push
    steps: Track  # (n,) ramps over the changes of the load
    noise: Array  # (k,) rad, one sd of a turn in one frame
    largest: Array  # (k,) rad


@dataclass(frozen=True)
class FilmFeatures:
    """All features of a film."""

    time: Array  # (T,) s, of the frames that are used
    rate: float  # Hz, bandwidth of the motion; NaN where nothing moves
    tracks: tuple[Track, ...]  # sets for the regression, the largest first
    moments: Moments | None


def film_features(markers: Markers, push_s: float | None) -> FilmFeatures:
    """The features of the markers; without levers and moments where the place of the push `push_s` is not known."""
    rate, every = motion_rate(markers), -(-len(markers.time) // MOST_FRAMES)
    markers = replace(markers, **{name: getattr(markers, name)[::every] for name in ("time", "xy", "angle")})
    seen = gapless(markers)
    if seen is None or seen.covered.sum() < FEWEST:
        return FilmFeatures(markers.time, rate, (), None)
    polynomials, bias = monomials(seen.xy, seen.angle), np.full((len(seen.time), 1), FREE)
    with_load = seen.track(np.hstack([bias, polynomials, load_errors(seen)]))
    tracks = [seen.track(np.hstack([bias, polynomials])), replace(with_load, doubt=LOAD_DOUBT)]
    tracks = [replace(one, own=one.integral.c.shape[-1]) for one in tracks]
    spans = None if push_s is None else turning_spans(seen, push_s)
    if spans is not None and spans.turn.shape[1]:
        pairs = FREE * levers(spans).reshape(len(seen.time), -1)
        both = [seen.track(np.hstack([bias, scale * polynomials, pairs])) for scale in CORRECTIONS]
        tracks = [*(replace(one, own=1 + polynomials.shape[1]) for one in both), *tracks]
    return FilmFeatures(markers.time, rate, tuple(tracks), None if spans is None else make_moments(seen, spans))


def motion_rate(markers: Markers) -> float:
    """Hz, bandwidth of the markers' motion; NaN where nothing moves."""
    flat = markers.xy.reshape(len(markers.time), -1)
    flat = flat[:, np.isfinite(flat).any(axis=0)]
    return bandwidth(markers.time, flat - np.nanmedian(flat, axis=0)) if flat.size else float("nan")


@dataclass(frozen=True)
class GaplessMarkers:
    """The clamp and the markers that are missing least, in order, without gaps."""

    time: Array  # (T,) s
    s: Array  # (m,)
    xy: Array  # (T, m, 2) m
    angle: Array  # (T, m) rad
    covered: BoolArray  # (T,) frames outside long gaps
    before: float  # s before the film for which its first frames are taken to hold
    after: float  # s after the film

    def track(self, values: Array) -> Track:
        """`values` (T, ...) as features."""
        spline = CubicSpline(self.time, values, axis=0)
        return Track(spline.antiderivative(), self.covered, self.time, self.before, self.after)


def gapless(markers: Markers) -> GaplessMarkers | None:
    """The markers; None where none is seen. A beam at rest at an end of the film stays so for `HOLD`."""
    used, covered = lasting(markers)
    if not used.any():
        return None
    markers, count = without_jumps(markers), len(markers.time)
    flat = bridged(markers.time, markers.xy[:, used].reshape(count, -1))
    angle = bridged(markers.time, markers.angle[:, used])
    places = from_clamp(markers.s[used], flat.reshape(count, -1, 2), angle)
    ends = (slice(0, STILL), slice(-STILL, None))
    before, after = (HOLD if is_still(flat, rows) else 0.0 for rows in ends)
    return GaplessMarkers(markers.time, *places, covered, before, after)


SPARED = 0.1  # of all frames


def lasting(markers: Markers) -> tuple[BoolArray, BoolArray]:
    """(m,) the markers with few frames in long gaps, at most `SPARED` more than the fewest, and (T,) the frames where
    none of these has a long gap: a hand that passes over the beam costs some frames, and no marker."""
    missing = ~(np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle))
    long = np.zeros_like(missing)
    for i, column in enumerate(missing.T):
        for start, stop in runs(column):
            edge = start == 0 or stop == len(column)
            if edge or markers.time[stop] - markers.time[start - 1] > LONG_GAP:
                long[start:stop, i] = True
    frames_missing = long.sum(axis=0)
    used = (frames_missing <= frames_missing.min() + SPARED * len(long)) & (frames_missing < len(long))
    return np.asarray(used), np.asarray(~long[:, used].any(axis=1))


def without_jumps(markers: Markers) -> Markers:
    """Markers without single frames that are far from the cubic through the two frames before and the two after."""
    state = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1)
    if len(state) < 9:
        return markers
    off = np.zeros_like(state)
    off[2:-2] = state[2:-2] - (4 * (state[1:-3] + state[3:-1]) - state[:-4] - state[4:]) / 6
    size = np.abs(off) / np.maximum(MAD_TO_SD * np.nanmedian(np.abs(off), axis=0), np.finfo(float).tiny)
    size = np.nan_to_num(size).max(axis=-1)
    peak = np.maximum(np.roll(size, 1, axis=0), np.roll(size, -1, axis=0)) <= size
    state[(size > 8.0) & peak] = np.nan  # robust sd, of a pose that is read wrongly
    return replace(markers, xy=state[..., :2], angle=state[..., 2])


def is_still(moved: Array, rows: slice) -> bool:
    """Whether nothing moves in `rows` of (T, c) displacements: less than 0.2 % of the whole motion, or noise."""
    window = moved[rows]
    half = len(window) // 2
    change = np.abs(window[half:].mean(axis=0) - window[:half].mean(axis=0))
    noise = np.std(np.diff(moved, n=2, axis=0)[rows], axis=0)
    return bool(np.all(change < np.maximum(2e-3 * np.ptp(moved, axis=0).max(), 2 * noise)))


def load_errors(seen: GaplessMarkers) -> Array:
    """(T, p) features of an error of the log that changes with the load."""
    ramps = [
        np.clip(PARTS * change.fraction(seen.time) - i, 0.0, 1.0)
        for change in changes_of_load(seen)
        for i in range(PARTS)
    ]
    ramp = np.reshape(ramps, (len(ramps), len(seen.time))).T
    return np.asarray(STEPS / np.sqrt(PARTS) * ramp)


def changes_of_load(seen: GaplessMarkers) -> list[LoadChange]:
    """The changes of the load, by markers that rest in the first frames."""
    moving = seen.xy[:, 1:]
    size = np.sqrt(np.mean((moving - np.median(moving[:STILL], axis=0)) ** 2, axis=(1, 2)))
    return load_changes(seen.time, size, size > TOUCHED * size.max())


def monomials(xy: Array, angle: Array) -> Array:
    """(T, p) products of the leading principal components of the displacements, each scaled to 1 at most."""
    reach = float(np.abs(xy).max())
    flat = np.concatenate([xy.reshape(len(xy), -1), 0.1 * reach * angle], axis=1)
    flat = flat - flat[: max(5, len(flat) // 50)].mean(axis=0)
    components, size, _ = np.linalg.svd(flat, full_matrices=False)
    count = int(min(3, np.sum(size > 1e-9 * max(size[0], np.finfo(float).tiny))))  # principal components
    if not count:
        return np.empty((len(xy), 0))
    scores = components[:, :count] / np.abs(components[:, :count]).max(axis=0)
    terms = [
        scale * np.prod(scores[:, list(which)], axis=1)
        for degree, scale in enumerate(TERMS, start=1)
        for which in combinations_with_replacement(range(count), degree)
    ]
    return np.stack(terms, axis=1)


@dataclass(frozen=True)
class Spans:
    """The k spans between tags up to the push that turn, of those between which the beam has a length."""

    turn: Array  # (T, k) rad, since the first frames
    mean: Array  # (T, k, 2) m, of the lever over each: moment = lever . force
    slope: Array  # (T, k, 2) m, its first Legendre moment
    tangent: Array  # (T, 2) change of all levers with the place of the push
    whole: int  # so many of them end at or before the push


def turning_spans(seen: GaplessMarkers, push_s: float) -> Spans:
    """The spans up to the push at `push_s`."""
    s, xy, angle = seen.s, seen.xy, seen.angle
    spans = np.flatnonzero((s[:-1] < push_s - SHORTEST_SPAN) & (np.diff(s) > 0.0))
    bend = angle - np.median(angle[:STILL], axis=0)
    turn = bend[:, spans + 1] - bend[:, spans]
    largest = np.abs(turn).max(axis=0, initial=0.0)
    # Of the largest turn: a span that turns by less is not used.
    good = largest > 0.02 * largest.max(initial=0.0)
    spans, turn = spans[good], turn[:, good]
    push = along(xy, angle, s, push_s)
    beside = np.clip((push_s - s[:-1]) / np.maximum(np.diff(s), 1e-9), 0.0, 1.0)
    x, weight = np.polynomial.legendre.leggauss(5)  # Gauss, on a span
    ends = np.minimum(s[spans + 1], push_s)
    lever = np.zeros((2, *turn.shape, 2))
    for node, share in zip(x, 0.5 * weight, strict=True):
        for i, place in enumerate(s[spans] + 0.5 * (node + 1.0) * (ends - s[spans])):
            lever[:, :, i] += share * np.array([1.0, node])[:, None, None] * left_of(push - along(xy, angle, s, place))
    whole = int(np.sum(s[spans + 1] <= push_s + SHORTEST_SPAN))
    return Spans(turn, lever[0], lever[1], left_of(unit(angle[:, 0] + np.diff(angle, axis=1) @ beside)), whole)


def levers(spans: Spans) -> Array:
    """(T, 2, p) force that gives each span its turn at unit stiffness; the largest scaled to 1.

    Further features are the changes of the forces with each lever a quarter of the span before or behind the middle."""
    base = unit_forces(spans.mean, spans.turn)
    size, quarter = np.abs(base).max(axis=(0, 1)), 1.5 * spans.slope
    shifts = [
        unit_forces(spans.mean + quarter * one[:, None], spans.turn)
        - unit_forces(spans.mean - quarter * one[:, None], spans.turn)
        for one in np.eye(len(size))
    ]
    # Prior sd of the change with a span's lever, per largest force.
    return np.concatenate([base / size, *(1.0 / FREE * shift / size for shift in shifts)], axis=2)


def unit_forces(lever: Array, turn: Array) -> Array:
    """(T, 2, k) the force of least ridge-weighted misfit whose moment by the `lever` (T, k, 2) is each of `turn`."""
    ridge = RIDGE * float((lever**2).sum(axis=-1).max())
    inner = np.einsum("tia,tib->tab", lever, lever) + ridge * np.eye(2)
    return np.asarray(np.linalg.solve(inner, lever.transpose(0, 2, 1)) * turn[:, None, :])


def along(xy: Array, angle: Array, s: Array, place: float) -> Array:
    """(T, 2) the place `place` on the beam: on the cubic through the two neighbouring tags with their directions.

    The tangents have the length of the arc over the chord, so that the cubic of a circle is exact to 0.1 %.
    """
    i = int(np.clip(np.searchsorted(s, place) - 1, 0, len(s) - 2))
    u = min((place - s[i]) / max(s[i + 1] - s[i], 1e-9), 1.0)
    chord = xy[:, i + 1] - xy[:, i]
    # sinc(x) = sin(pi x) / (pi x): arc over chord of a circle that turns by the two tags' difference.
    arc = np.linalg.norm(chord, axis=1) / np.sinc(np.clip(angle[:, i + 1] - angle[:, i], -np.pi, np.pi) / (2 * np.pi))
    two = slice(i, i + 2)
    return np.asarray(CubicHermiteSpline((0.0, 1.0), xy[:, two], arc[:, None, None] * unit(angle[:, two]), axis=1)(u))


def make_moments(seen: GaplessMarkers, spans: Spans) -> Moments | None:
    """Moments of the spans; None where fewer than `FEWEST_SPANS` whole spans before the push turn: most of the
    information is then in the places of the tags beyond."""
    if spans.whole < FEWEST_SPANS:
        return None
    noise = MAD_TO_SD * np.median(np.abs(np.diff(spans.turn, n=2, axis=0)), axis=0) / np.sqrt(6.0)
    largest = np.abs(spans.turn).max(axis=0)
    return Moments(
        seen.track(np.concatenate([spans.turn[..., None], spans.mean, spans.slope], axis=-1)),
        seen.track(spans.tangent),
        seen.track(load_change_ramps(seen)),
        np.maximum(noise, 0.001 * largest),  # of a span's largest turn: least noise of the turn
        largest,
    )


def load_change_ramps(seen: GaplessMarkers) -> Array:
    """(T, n) ramps from 0 to 1 over each change of the load, in which the log's error may change."""
    changes = changes_of_load(seen)
    wide = [replace(change, begin=change.begin - SLACK, end=change.end + SLACK) for change in changes]
    return np.reshape([change.fraction(seen.time) for change in wide], (len(wide), len(seen.time))).T


FORGOTTEN = 0.05  # of a filter's memory: it lasts three time constants


def lagging(track: Track, tau: float) -> Track:
    """The features behind a first-order filter of time constant `tau` [s], at rest before the film; those seconds are
    written out for which the beam, at rest in its last frames, stays so. They are known where less than `FORGOTTEN` of
    what the filter remembers lies in frames that are not."""
    apart = step(track.time)
    more = np.arange(1, int(track.after / apart) + 1)
    time = np.append(track.time, track.time[-1] + apart * more)
    value = track.integral.derivative()(np.minimum(time, track.time[-1]))
    covered = np.append(track.covered, np.ones(len(more), dtype=bool))
    if tau > 0.0:
        value = filtered(time, value, tau)
        covered &= filtered(time, (~covered).astype(float), tau) < FORGOTTEN
    return replace(track, integral=CubicSpline(time, value).antiderivative(), covered=covered, time=time, after=0.0)


def filtered(time: Array, value: Array, tau: float) -> Array:
    """(T, ...) the output of a first-order filter that rested at the first of these values (T, ...), straight lines
    between their times (T,)."""
    out = np.empty_like(value)
    out[0] = value[0]
    for i, apart in enumerate(np.diff(time)):
        slope = (value[i + 1] - value[i]) / apart
        steady = value[i] - tau * slope  # the filter's output on this line, had it always run so
        out[i + 1] = steady + apart * slope + np.exp(-apart / tau) * (out[i] - steady)
    return out
