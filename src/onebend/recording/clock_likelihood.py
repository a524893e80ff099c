"""The likelihood of a force log given the markers: a model of its mean, and of its noise.

The force that the tags' turns imply at a row is normal, with a large covariance along a straight beam. To it come the
sensor's noise and an error that changes with the load. The unknown parameters (compliances, place of the push, axes)
are held by two conditions: one force explains all turns of a frame, and the log follows that force."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import CubicSpline, PPoly
from scipy.linalg import solve_triangular
from scipy.ndimage import uniform_filter1d
from scipy.optimize import nnls

from onebend.recording.force_noise import (
    LoadChange,
    TimeSpans,
    covariance,
    displacement,
    first_guess,
    likeliest_noise,
    load_changes,
)
from onebend.recording.signals import MAD_TO_SD, bridged, from_clamp, outliers, runs, step
from onebend.records import DIRECTION_SD, PLACE_SD, Array, BoolArray, ForceLog, ForceNoise, IntArray, Markers


@dataclass(frozen=True)
class BinnedLog:
    """The log averaged over bins of equal width, without outliers."""

    time: Array  # (N,) s, mean time of each bin's rows, log's clock
    force: Array  # (N, 2) N
    width: float  # s
    largest: float  # N, largest deviation from the median

    def walk_variance(self, noise: ForceNoise) -> Array:
        """(N,) N^2: the variance so far of a random walk that moves only where the force changes, and by as much."""
        gaps = np.diff(self.time)
        own = 2 * noise.white**2 + 2 * noise.coloured**2 * (1 - np.exp(-gaps / noise.tau)) + noise.walk**2 * gaps
        power = np.mean(np.diff(self.force, axis=0) ** 2, axis=1)
        size = max(3, round(1.0 / self.width))  # s, window around a row over which the power of its changes is averaged
        local = uniform_filter1d(power, size, mode="nearest")
        # Times the power of the noise's own changes: above it the force itself changes.
        return np.concatenate([[0.0], np.cumsum(np.where(local > 2.0 * own, local, 0.0))])


def binned(log: ForceLog, rate: float, span: tuple[float, float], highest_rate: float) -> BinnedLog:
    """The log within `span` [s] at `rate` rows per second, at most `highest_rate`, and no more than the log has."""
    inside = (log.time >= span[0]) & (log.time <= span[1]) & ~outliers(log.force, spacing=step(log.time))
    time, force = log.time[inside], log.force[inside]
    if len(time) < 10:
        return BinnedLog(np.empty(0), np.empty((0, 2)), 1.0, 0.0)
    width = 1 / min(rate, highest_rate, 1 / step(time))
    index = np.floor((time - time[0]) / width + 1e-6).astype(np.int64)
    count = np.bincount(index)
    total = np.stack([np.bincount(index, column) for column in force.T], axis=1)
    # A bin that lost most of its rows to a dropout does not stand for its whole span.
    good = count > 0.5 * np.median(count[count > 0])
    mean = total[good] / count[good, None]
    largest = float(np.abs(mean - np.median(mean, axis=0)).max())
    # The time of a bin is the mean of its samples' times, not its middle.
    return BinnedLog(np.bincount(index, time)[good] / count[good], mean, width, largest)


def thinned(rows: BinnedLog, rate: float) -> BinnedLog:
    """Rows averaged further, to at most `rate` per second."""
    size = int(np.ceil(1.0 / (rate * rows.width) - 1e-9))
    count = len(rows.time) // max(size, 1)
    if size <= 1 or count < 10:
        return rows
    time = rows.time[: count * size].reshape(count, size).mean(axis=1)
    force = rows.force[: count * size].reshape(count, size, 2).mean(axis=1)
    return BinnedLog(time, force, size * rows.width, rows.largest)


# Features of the markers on which the clock search regresses the force, without a model of the beam:
# - Levers: the moment of the force about the middle of a span is proportional to the span's turn. So F = sum_i k_i f_i
#   with f_i = (A^T A + ridge)^-1 A^T e_i turn_i, A the levers (moment = A F) and k_i one stiffness per span. The ridge
#   bounds the force along a straight beam.
# - Polynomials of the leading principal components: any smooth function of the shape. They correct the levers, or stand
#   alone where the place of the push is not known or the beam swings.

FREE = 10.0  # prior sd of the log's bias and of a stiffness, per largest force: free
RIDGE = 0.01  # of the longest lever squared
SHORTEST_SPAN = 0.05  # of the beam: a shorter span between a tag and the push does not count
TERMS = (2.0, 0.5, 0.25)  # prior sd of a polynomial's coefficient by degree, per largest force
TOUCHED = 0.02  # of the largest displacement: a smaller one counts as rest
PARTS = 5  # into which a change of the load is divided; the log's error may change in each


@dataclass(frozen=True)
class Track:
    """Features in time, to be averaged over any span."""

    integral: PPoly  # antiderivative of the features, (2 axes, p)
    covered: BoolArray  # (T,) frames whose features are known
    time: Array  # (T,) s, video clock
    before: float  # s before the film for which its first frames are taken to hold
    after: float  # s after the film for which its last frames are taken to hold

    @property
    def duration(self) -> float:
        """s, of the film."""
        return float(self.time[-1] - self.time[0])

    def mean(self, centre: Array, width: float) -> Array:
        """(N, 2, p) features averaged over `width` [s] around every `centre`; NaN where the film does not cover it."""
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


def make_track(
    markers: Markers, *, push_s: float | None, polynomials: float, longest_gap: float, hold: float, steps: float = 0.0
) -> Track | None:
    """Features of the markers that are missing least; None where there is no such marker, or no lever.

    `push_s`: place of the push for levers, None for polynomials alone; `polynomials` scales their prior. Gaps up to
    `longest_gap` [s] are interpolated; a beam at rest at an end of the film stays so for `hold` [s]. `steps`: prior sd,
    per largest force, of an error of the log that changes with the load."""
    used, covered = lasting(markers, longest_gap)
    if not used.any():
        return None
    xy = bridged(markers.time, markers.xy[:, used].reshape(len(markers.time), -1)).reshape(-1, int(used.sum()), 2)
    angle = bridged(markers.time, markers.angle[:, used])
    per_axis = np.concatenate([np.full((len(xy), 1), FREE), polynomials * monomials(xy, angle)], axis=1)
    columns = [np.stack([per_axis, 0 * per_axis], axis=1), np.stack([0 * per_axis, per_axis], axis=1)]
    if push_s is not None:
        turns = levers(xy, angle, markers.s[used], push_s)
        if not turns.shape[-1]:
            return None
        columns.append(FREE * turns)
    if steps > 0.0:
        changes = moved_load_changes(markers.time, xy)
        ramps = [
            np.clip(PARTS * change.fraction(markers.time) - i, 0.0, 1.0) for change in changes for i in range(PARTS)
        ]
        columns += [steps * (ramp / np.sqrt(PARTS))[:, None, None] * np.eye(2) for ramp in ramps]
    features = np.concatenate(columns, axis=2)
    flat = xy.reshape(len(xy), -1)
    before, after = (hold if is_still(flat, rows) else 0.0 for rows in (slice(0, 10), slice(-10, None)))
    spline = CubicSpline(markers.time, features, axis=0)
    return Track(spline.antiderivative(), covered, markers.time, before, after)


def moved_load_changes(time: Array, xy: Array) -> list[LoadChange]:
    """The changes of the load, by tags (T, m, 2) that rest in the first frames."""
    size = displacement(time, xy, np.median(xy[:STILL], axis=0))
    return load_changes(time, size, size > TOUCHED * size.max())


def lasting(markers: Markers, longest_gap: float) -> tuple[BoolArray, BoolArray]:
    """(m,) the markers with the fewest frames in long gaps, and (T,) frames where none of these has a long gap."""
    missing = ~(np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle))
    long = np.zeros_like(missing)
    for i, column in enumerate(missing.T):
        for start, stop in runs(column):
            edge = start == 0 or stop == len(column)
            if edge or markers.time[stop] - markers.time[start - 1] > longest_gap:
                long[start:stop, i] = True
    frames_missing = long.sum(axis=0)
    used = (frames_missing <= frames_missing.min()) & (frames_missing < len(long))
    return np.asarray(used), np.asarray(~long[:, used].any(axis=1))


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


def levers(xy: Array, angle: Array, s: Array, push_s: float) -> Array:
    """(T, 2, p) force that gives each span up to the push its turn at unit stiffness; the largest scaled to 1.

    Further features are the changes of the forces with each lever a quarter of the span before or behind the middle."""
    count = len(xy)
    s, xy, angle = from_clamp(s, xy, angle)
    spans = np.flatnonzero(s[:-1] < push_s - SHORTEST_SPAN)
    bend = angle - np.median(angle[:10], axis=0)
    turns = bend[:, spans + 1] - bend[:, spans]
    push = along(xy, angle, s, push_s)

    def forces(part: Array) -> Array:
        ends = np.minimum(s[spans + 1], push_s)
        places = s[spans] + part * (ends - s[spans])
        arms = push[:, None] - np.stack([along(xy, angle, s, place) for place in places], axis=1)
        return unit_forces(arms, turns)

    middle = np.full(len(spans), 0.5)
    moved = np.abs(turns).max(axis=0, initial=0.0) > 0.02 * np.abs(turns).max(initial=0.0)
    if not moved.any():
        return np.empty((count, 2, 0))
    base = forces(middle)[..., moved]
    size = np.abs(base).max(axis=(0, 1))
    shifts = [forces(middle + 0.25 * unit) - forces(middle - 0.25 * unit) for unit in np.eye(len(spans))]
    # Prior sd of the change with a span's lever, per largest force.
    changes = [1.0 / FREE * shift[..., moved] / size for shift in shifts]
    return np.concatenate([base / size, *changes], axis=2)


def unit_forces(arms: Array, turns: Array) -> Array:
    """(T, 2, k) the force of least ridge-weighted misfit whose moment over the `arms` (T, k, 2) is each of `turns`."""
    rows = np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
    ridge = RIDGE * float((arms**2).sum(axis=-1).max())
    inner = np.einsum("tia,tib->tab", rows, rows) + ridge * np.eye(2)
    return np.asarray(np.linalg.solve(inner, rows.transpose(0, 2, 1)) * turns[:, None, :])


def along(xy: Array, angle: Array, s: Array, place: float) -> Array:
    """(T, 2) the place `place` on the beam: on the cubic through the two neighbouring tags with their directions.

    The tangents have the length of the arc over the chord, so that the cubic of a circle is exact to 0.1 %.
    """
    i = int(np.clip(np.searchsorted(s, place) - 1, 0, len(s) - 2))
    u = min((place - s[i]) / max(s[i + 1] - s[i], 1e-9), 1.0)
    chord = xy[:, i + 1] - xy[:, i]
    # sinc(x) = sin(pi x) / (pi x): arc over chord of a circle that turns by the two tags' difference.
    arc = np.linalg.norm(chord, axis=1) / np.sinc(np.clip(angle[:, i + 1] - angle[:, i], -np.pi, np.pi) / (2 * np.pi))
    ends = [arc[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1) for a in (angle[:, i], angle[:, i + 1])]
    return np.asarray(
        (2 * u**3 - 3 * u**2 + 1) * xy[:, i]
        + (3 * u**2 - 2 * u**3) * xy[:, i + 1]
        + (u**3 - 2 * u**2 + u) * ends[0]
        + (u**3 - u**2) * ends[1]
    )


def is_still(moved: Array, rows: slice) -> bool:
    """Whether nothing moves in `rows` of (T, c) displacements: less than 0.2 % of the whole motion, or noise."""
    window = moved[rows]
    half = len(window) // 2
    change = np.abs(window[half:].mean(axis=0) - window[:half].mean(axis=0))
    noise = np.std(np.diff(moved, n=2, axis=0)[rows], axis=0)
    return bool(np.all(change < np.maximum(2e-3 * np.ptp(moved, axis=0).max(), 2 * noise)))


# The turn of a span is `F . integral of w(s) a(s) ds` with w = 1 / k and a the lever of a unit force about s: exact for
# a beam that moves slowly. Of w, the mean over the span and the slope are used.

SLACK = 0.2  # s, by which the log's error may change before or after the load does
FEWEST_SPANS = 2  # that end at or before the push
STILL = 10  # first frames, whose angles are the ones at rest


@dataclass(frozen=True)
class Moments:
    """Turns and levers of k spans in time, to be averaged over any span of time."""

    track: Track  # features (k, 5): turn, mean of the lever, its first Legendre moment
    tangent: Track  # (2,), change of all levers with the place of the push
    steps: Track  # (n,), ramps over the changes of the load
    noise: Array  # (k,) rad, one sd of a turn in one frame
    largest: Array  # (k,) rad


@dataclass(frozen=True)
class MomentsAtRows:
    """Moments at N rows; steps rise from 0 to 1 over each change of the load."""

    turn: Array  # (N, k)
    lever: Array  # (N, 2 moments, k, 2)
    tangent: Array  # (N, 2)
    steps: Array  # (N, n)

    @property
    def known(self) -> BoolArray:
        """(N,) rows that the film covers."""
        return np.asarray(np.isfinite(self.turn).all(axis=1))

    def select(self, rows: BoolArray) -> MomentsAtRows:
        """Some of the rows."""
        return MomentsAtRows(self.turn[rows], self.lever[rows], self.tangent[rows], self.steps[rows])


def make_moments(markers: Markers, *, push_s: float, longest_gap: float, hold: float) -> Moments | None:
    """Moments of the markers that are missing least, as for `make_track`; None where fewer than `FEWEST_SPANS` whole
    spans before the push turn: most of the information is then in the places of the tags beyond."""
    used, covered = lasting(markers, longest_gap)
    if not used.any() or len(markers.time) < STILL:
        return None
    markers = without_jumps(markers)
    time, count = markers.time, len(markers.time)
    moved = bridged(time, markers.xy[:, used].reshape(count, -1))
    angle = bridged(time, markers.angle[:, used])
    s, xy, angle = from_clamp(markers.s[used], moved.reshape(count, -1, 2), angle)
    spans = np.flatnonzero((s[:-1] < push_s - SHORTEST_SPAN) & (np.diff(s) > 0.0))
    bend = angle - np.median(angle[:STILL], axis=0)
    turns = bend[:, spans + 1] - bend[:, spans]
    largest = np.abs(turns).max(axis=0, initial=0.0)
    # Of the largest turn: a span that turns by less is not used.
    good = (largest > 0.02 * largest.max(initial=0.0)) & (largest > 0.0)
    if np.sum(good & (s[spans + 1] <= push_s + SHORTEST_SPAN)) < FEWEST_SPANS:
        return None
    spans, turns, largest = spans[good], turns[:, good], largest[good]
    mean, slope, tangent = span_levers(xy, angle, s, spans, push_s)
    ends = (slice(0, STILL), slice(-STILL, None))
    before, after = (hold if is_still(moved, rows) else 0.0 for rows in ends)

    def track(values: Array) -> Track:
        return Track(CubicSpline(time, values, axis=0).antiderivative(), covered, time, before, after)

    noise = MAD_TO_SD * np.median(np.abs(np.diff(turns, n=2, axis=0)), axis=0) / np.sqrt(6.0)
    return Moments(
        track(np.concatenate([turns[..., None], mean, slope], axis=-1)),
        track(np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)),
        track(load_change_ramps(time, moved.reshape(count, -1, 2))),
        np.maximum(noise, 0.001 * largest),  # of a span's largest turn: least noise of the turn
        largest,
    )


def span_levers(xy: Array, angle: Array, s: Array, spans: IntArray, push_s: float) -> tuple[Array, Array, Array]:
    """(T, k, 2) m mean lever over each span, its first Legendre moment; and the beam's direction (T, 2) at the push."""
    push = along(xy, angle, s, push_s)
    beside = np.clip((push_s - s[:-1]) / np.maximum(np.diff(s), 1e-9), 0.0, 1.0)
    direction = angle[:, 0] + np.diff(angle, axis=1) @ beside
    x, weight = np.polynomial.legendre.leggauss(5)  # Gauss, on a span
    ends = np.minimum(s[spans + 1], push_s)
    lever = np.zeros((2, len(xy), len(spans), 2))
    for node, share in zip(x, 0.5 * weight, strict=True):
        places = s[spans] + 0.5 * (node + 1.0) * (ends - s[spans])
        arm = push[:, None] - np.stack([along(xy, angle, s, place) for place in places], axis=1)
        lever += share * np.array([1.0, node])[:, None, None, None] * np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    return lever[0], lever[1], np.stack([np.cos(direction), np.sin(direction)], axis=1)


def load_change_share(rows: MomentsAtRows) -> Array:
    """(N,) share of the changes of the load that lies between each row and the one before it."""
    return np.concatenate([[0.0], np.maximum(np.diff(rows.steps, axis=0), 0.0).sum(axis=1)])


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


def load_change_ramps(time: Array, xy: Array) -> Array:
    """(T, n) ramps from 0 to 1 over each change of the load, in which the log's error may change."""
    changes = moved_load_changes(time, xy)
    wide = [replace(change, begin=change.begin - SLACK, end=change.end + SLACK) for change in changes]
    return np.asarray(np.stack([np.zeros(len(time)), *(change.fraction(time) for change in wide)], axis=1)[:, 1:])


def moments_at(moments: Moments, centre: Array, width: float) -> MomentsAtRows:
    """Moments averaged over `width` [s] around every `centre` (N,) [s, video clock]."""
    f = moments.track.mean(centre, width)
    return MomentsAtRows(
        f[..., 0],
        np.stack([f[..., 1:3], f[..., 3:5]], axis=1),
        moments.tangent.mean(centre, width),
        np.clip(moments.steps.mean(centre, width), 0.0, 1.0),
    )


FREE_BIAS = 10.0  # of the largest force: prior sd of the log's bias
DEGREES_OF_FREEDOM = 4.0  # of Student's t: some tags are read wrongly
PARAMETER_BOUND = 6.0  # prior sd: the search keeps parameters within it
DIFFERENCE = 1e-4  # step of the parameters for derivatives

# Of the parameters (p,): a negative log likelihood, minus its gradient (p,), and its curvature (p, p)
FilmMisfit = Callable[[Array], tuple[float, Array, Array]]


def rough_compliance(rows: MomentsAtRows, force: Array) -> tuple[Array, float, Array]:
    """(k,) rad / (N m) mean compliance of every span, the log's sign, and its bias (2,) N with that sign.

    Least squares with stiffnesses that are not negative; convex, so that it has one minimum.
    """
    count, spans = rows.turn.shape
    lever = rows.lever[:, 0]
    ridge = RIDGE * float((lever**2).sum(axis=-1).max())
    inner = np.einsum("nka,nkb->nab", lever, lever) + ridge * np.eye(2)
    part = np.linalg.solve(inner, lever.transpose(0, 2, 1)) * rows.turn[:, None, :]
    axes = np.tile(np.eye(2), (count, 1))
    design = np.hstack([part.reshape(2 * count, spans), axes, -axes])
    size = np.linalg.norm(design, axis=0)
    fits = {sign: nnls(design / size, sign * force.ravel()) for sign in (1.0, -1.0)}
    sign = min(fits, key=lambda candidate: float(fits[candidate][1]))
    stiffness = fits[sign][0] / size
    bias = stiffness[spans : spans + 2] - stiffness[spans + 2 :]
    # The stiffness at which the largest force makes the largest turns: a first regression may find none.
    needed = np.abs(force - np.median(force, axis=0)).max() * np.sqrt((lever**2).sum(axis=-1).max(axis=0))
    needed /= np.abs(rows.turn).max(axis=0)
    # Of the stiffness that the largest force implies: the least that the first regression may give.
    stiffness = np.maximum(stiffness[:spans], 0.1 * needed)
    return 1.0 / stiffness, sign, bias


@dataclass(frozen=True)
class ForceLogModel:
    """Mean of the log at N rows as a function of 3 k + 4 parameters z, standard normal before the data.

    z holds the logs of the spans' compliances (k), their slopes over half a span, relative to the mean (k), the push's
    place, the log's direction, its bias (2), and the spans' turns at rest (k). Leading axes of z are kept."""

    moments: Moments
    compliance: Array  # (k,) rad / (N m), at z = 0
    force: float  # N, largest

    def start(self, bias: Array) -> Array:
        """(3 k + 4,) parameters to begin with: zero, but for a bias (2,) [N] of the log."""
        k = len(self.compliance)
        z = np.zeros(3 * k + 4)
        z[2 * k + 2 : 2 * k + 4] = bias / (FREE_BIAS * self.force)
        return z

    def turns_per_force(self, rows: MomentsAtRows, z: Array) -> Array:
        """(2, N, k) rad / N: turns of the spans per unit force along x and y."""
        k = len(self.compliance)
        w = self.compliance * np.exp(z[..., None, :k])
        place, slope = PLACE_SD * z[..., 2 * k, None, None], z[..., None, k : 2 * k]
        lever = rows.lever
        return np.stack(
            [(lever[:, 0, :, c] + place * rows.tangent[:, c, None] + slope * lever[:, 1, :, c]) * w for c in (0, 1)]
        )

    def force_on_beam(self, rows: MomentsAtRows, z: Array) -> tuple[Array, Array]:
        """(N, 2) N and (N, 2, 2) N^2: mean and covariance of the force on the beam."""
        k = len(self.compliance)
        a = self.turns_per_force(rows, z)
        weighed = a / self.moments.noise**2
        rest = self.moments.noise / np.sqrt(STILL)
        size = np.sqrt(np.mean((rows.turn / self.moments.noise) ** 2, axis=1) + 1.0)
        size *= self.force / np.sqrt(np.mean((self.moments.largest / self.moments.noise) ** 2))
        xx, xy, yy = (np.einsum("...k,...k->...", weighed[i], a[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        xx, yy = xx + size**-2, yy + size**-2
        turn = rows.turn - rest * z[..., None, 2 * k + 4 :]
        x, y = np.einsum("c...k,...k->c...", weighed, turn)
        volume = xx * yy - xy**2
        force = np.stack([yy * x - xy * y, xx * y - xy * x], axis=-1)
        spread = np.stack([yy, -xy, -xy, xx], axis=-1)
        return force / volume[..., None], (spread / volume[..., None]).reshape(*volume.shape, 2, 2)

    def turn_residuals(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, k) residuals of the turns from those of one force per row, in sd of the turns' noise."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        rest = self.moments.noise / np.sqrt(STILL) * z[..., None, 2 * k + 4 :]
        explained = np.einsum("c...k,...c->...k", self.turns_per_force(rows, z), force)
        return np.asarray((rows.turn - rest - explained) / self.moments.noise)

    def mean(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, 2) N, the mean of the log."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        turned = DIRECTION_SD * z[..., 2 * k + 1, None, None] * np.stack([-force[..., 1], force[..., 0]], axis=-1)
        return np.asarray(force + turned + FREE_BIAS * self.force * z[..., None, 2 * k + 2 : 2 * k + 4])


def jacobian(function: Callable[[Array], Array], z: Array, base: Array) -> Array:
    """(n, p) forward differences of `function` at z, where its n values are `base`; one call takes all steps of z."""
    moved = function(z + DIFFERENCE * np.eye(len(z)))
    return np.asarray(((moved - base) / DIFFERENCE).reshape(len(z), -1).T)


def log_covariance(noise: ForceNoise, rows: TimeSpans, spread: Array, jumps: Array) -> Array:
    """(2N, 2N) N^2 of the log about its mean; each row gives its two axes one after the other."""
    n = len(spread)
    walked = np.cumsum(jumps)
    per_axis = covariance(noise, rows) + np.minimum(walked[:, None], walked)
    blocks = np.zeros((n, 2, n, 2))
    blocks[:, 0, :, 0] = blocks[:, 1, :, 1] = per_axis
    index = np.arange(n)
    blocks[index, :, index, :] += spread
    return np.asarray(blocks.reshape(2 * n, 2 * n))


def film_misfit(model: ForceLogModel, film: MomentsAtRows, z: Array) -> tuple[float, Array, Array]:
    """The film's negative log likelihood of the parameters (Student's t per row), minus its gradient, its curvature."""
    base = model.turn_residuals(film, z)
    j = jacobian(lambda x: model.turn_residuals(film, x), z, base).reshape(*base.shape, len(z))
    free = base.shape[1]
    size = np.sum(base**2, axis=1) / DEGREES_OF_FREEDOM
    weight = (1.0 + free / DEGREES_OF_FREEDOM) / (1.0 + size)
    cost = 0.5 * (DEGREES_OF_FREEDOM + free) * float(np.sum(np.log1p(size)))
    return cost, -np.einsum("nip,ni,n->p", j, base, weight), np.einsum("nip,niq,n->pq", j, j, weight)


def quadratic_film_misfit(model: ForceLogModel, film: MomentsAtRows, z: Array) -> FilmMisfit:
    """The parabola that stands for `film_misfit` near z."""
    cost, slope, inner = film_misfit(model, film, z)

    def parabola(x: Array) -> tuple[float, Array, Array]:
        move = x - z
        bent = inner @ move
        return cost + float(move @ (0.5 * bent - slope)), slope - bent, inner

    return parabola


def laplace_evidence(
    model: ForceLogModel,
    rows: MomentsAtRows,
    misfit_at: FilmMisfit,
    force: Array,
    root: Array,
    z: Array,
    rounds: int,
) -> tuple[float, Array]:
    """Laplace's log evidence of `force` (N, 2) under noise of covariance root root', and the likeliest parameters."""

    def step(z: Array) -> tuple[float, Array, Array]:
        base = model.mean(rows, z)
        columns = np.column_stack([jacobian(lambda x: model.mean(rows, x), z, base), (force - base).ravel()])
        white = solve_triangular(root, columns, lower=True, check_finite=False)
        j, r = white[:, :-1], white[:, -1]
        cost, slope, inner = misfit_at(z)
        return cost + 0.5 * float(r @ r + z @ z), inner + np.eye(len(z)) + j.T @ j, slope + j.T @ r - z

    value, inner, slope = step(z)
    damping = 0.0
    for _ in range(rounds):
        move = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), slope)
        if move @ slope < 0.01:
            break
        new = np.clip(z + np.clip(move, -1.0, 1.0), -PARAMETER_BOUND, PARAMETER_BOUND)
        cost = step(new)
        if cost[0] < value:
            z, (value, inner, slope), damping = new, cost, 0.1 * damping if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 0.1)
    return -value - 0.5 * float(np.linalg.slogdet(inner)[1]) - float(np.sum(np.log(np.diag(root)))), z


def residual_and_design(
    model: ForceLogModel, rows: MomentsAtRows, film: MomentsAtRows, force: Array, z: Array
) -> tuple[Array, Array]:
    """The log less its mean (2N,), and a root (2N, p) of the mean's covariance, by film and prior."""
    base = model.mean(rows, z)
    j = jacobian(lambda x: model.mean(rows, x), z, base)
    _, slope, inner = film_misfit(model, film, z)
    root = np.linalg.cholesky(inner + np.eye(len(z)))
    half = solve_triangular(root, j.T, lower=True).T
    return (force - base).ravel() - half @ solve_triangular(root, slope - z, lower=True), half


def fit_jumps(residual: Array, design: Array, others: Array, jumps: Array, typical: Array) -> Array:
    """(N,) N^2: variances of the jumps of the log's error before each row, by expectation and maximisation.

    Jumps are Cauchy distributed with variances of about `typical` (N,) N^2, first guess `jumps`, alike on both axes;
    `others` (2N, 2N) N^2 is the covariance of all else."""
    n = len(jumps)
    rows = np.kron(np.tril(np.ones((n, n))), np.eye(2))
    for _ in range(12):
        size = np.repeat(jumps, 2)
        root = np.linalg.cholesky(others + design @ design.T + (rows * size) @ rows.T)
        white = solve_triangular(root, np.column_stack([rows, residual]), lower=True, check_finite=False)
        mean = size * (white[:, :-1].T @ white[:, -1])
        spread = size - size**2 * np.sum(white[:, :-1] ** 2, axis=0)
        jumps = (typical + (mean**2 + spread).reshape(n, 2).sum(axis=1)) / 3.0 * (typical > 0.0)
    return np.asarray(jumps)


def fit_residual_noise(
    residual: Array, design: Array, rows: TimeSpans, spread: Array, start: ForceNoise, jumps: Array
) -> ForceNoise:
    """The likeliest noise of the log's `residual` (2N,) N, of which `design` (2N, p) N is the parameters' part."""

    def misfit(noise: ForceNoise, square: float) -> float:
        root = np.linalg.cholesky(log_covariance(noise, rows, spread, jumps))
        white = solve_triangular(root, np.column_stack([design, residual]), lower=True, check_finite=False)
        a, b = white[:, :-1], white[:, -1]
        inner = np.linalg.cholesky(np.eye(design.shape[1]) + a.T @ a)
        explained = solve_triangular(inner, a.T @ b, lower=True)
        fit = 0.5 * float(square + b @ b - explained @ explained)
        return fit + float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))))

    return likeliest_noise(start, misfit, 80)


TYPICAL, LARGE = 0.01, 0.1  # of the largest force: jumps of the log's error when the load changes, usual and largest
STEP, MOST_OFFSETS = 0.02, 31  # of the first grid: s between offsets at least, and their largest number
REACH = 4.0  # sd: half-width of a refinement
TURNS = 2  # rounds of parameters, noise and jumps at one offset
FEWEST = 10  # rows
STEP_DOUBT = 0.05  # s, sd of the offset from not knowing when the log's error changes with the load
FIRST, FAST = 10, 3  # rounds of the parameters at one offset, and from there at another one


Prior = Callable[[Array], Array]  # log of the prior over offsets, less a constant


@dataclass(frozen=True)
class CommonRows:
    """The rows that all offsets of a search cover, and their model."""

    moments: Moments
    time: Array  # (N,) s, log's clock
    width: float  # s
    force: Array  # (N, 2) N, with the sign of the force on the beam
    film: MomentsAtRows  # the whole film
    model: ForceLogModel

    @cached_property
    def rows(self) -> TimeSpans:
        return TimeSpans.at(self.time)

    def rows_at(self, offset: float) -> MomentsAtRows:
        return moments_at(self.moments, self.time - offset, self.width)


@dataclass(frozen=True)
class LogError:
    """The log's error (noise and jumps) and the likeliest parameters, at one offset."""

    noise: ForceNoise
    jumps: Array  # (N,) N^2
    z: Array
    log_prior: float  # of the jumps, relative to the likeliest ones
    jump_sd: float  # N, one sd of the sum of the jumps, beyond usual ones
    probability: float = 1.0  # of this error, among the likely ones


@dataclass(frozen=True)
class _Found:
    """Where the search from one estimate ended."""

    mean: float  # s
    sd: float  # s
    log_evidence: float
    noise: ForceNoise


def offset_from_moments(
    moments: Moments, rows: BinnedLog, span: tuple[float, float], first: Sequence[float], prior: Prior
) -> tuple[float, float, ForceNoise] | None:
    """Mean [s] and sd [s] of the offset within `span` [s], and the noise; None where film and log share too little.

    From each estimate `first` [s] the noise is fitted there, then at the mean, until that settles. An error of the log
    at one offset is force at another one, so a search stays near where it began. Its evidence weights its end."""
    wide = span[1] - span[0]
    offsets = np.arange(span[0], span[1] + 1e-9, max(min(STEP, wide / FEWEST), wide / (MOST_OFFSETS - 1)))
    every = np.append(offsets, first)
    found = [one for begin in first if (one := _found_from(moments, rows, offsets, every, begin, prior)) is not None]
    if not found:
        return None
    evidence = np.array([one.log_evidence for one in found])
    mean, sd = mixed(evidence, np.array([one.mean for one in found]), np.array([one.sd for one in found]))
    return mean, sd, found[int(np.argmax(evidence))].noise


def mixed(log_evidence: Array, mean: Array, sd: Array) -> tuple[float, float]:
    """Mean and sd of normal densities with these means and sds, weighted by their evidence."""
    share = np.exp(log_evidence - np.logaddexp.reduce(log_evidence))
    middle = float(share @ mean)
    return middle, float(np.sqrt(share @ (sd**2 + (mean - middle) ** 2)))


def _found_from(
    moments: Moments, rows: BinnedLog, offsets: Array, every: Array, first: float, prior: Prior
) -> _Found | None:
    """The search on the grid `offsets`, from one of them all."""
    shared, z = common_rows(moments, rows, every, first)
    if shared is None:
        return None
    best = first
    for _ in range(4):
        errors = likely_errors(shared, best, z)
        mean, sd, log_evidence = scan_closer(shared, offsets, errors, prior)
        previous, best, z = best, mean, errors[0].z
        if abs(best - previous) < max(0.002, sd):  # s, a change of the offset that ends them
            break
    # A jump at a wrong time shifts the offset, and a larger jump shifts it more.
    size = sum(error.probability * min(error.jump_sd / (LARGE * shared.model.force), 1.0) ** 2 for error in errors)
    # s, least sd that is claimed.
    return _Found(mean, float(np.hypot(max(sd, 0.001), np.sqrt(size) * STEP_DOUBT)), log_evidence, errors[0].noise)


def scan_closer(
    shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior
) -> tuple[float, float, float]:
    """Mean and sd of the offset, on the grid `offsets` refined around its mean, and the log evidence."""
    span = float(offsets[0]), float(offsets[-1])
    log_density = log_posterior(shared, offsets, errors, prior)
    for _ in range(3):
        mean, sd = moments_of(offsets, log_density)
        spacing = np.diff(offsets)[np.abs(offsets[1:] - mean) <= REACH * sd]
        # sd: a grid as fine as that around the mean needs no refinement.
        if len(spacing) >= REACH and spacing.max() < 0.6 * sd:
            break
        # s, distance from the mean within which its spacing is read.
        reach = max(REACH * sd, 0.75 * float(np.max(np.diff(offsets)[np.abs(offsets[1:] - mean) <= 0.3])))
        # Offsets that each refinement of the grid adds.
        new = np.setdiff1d(np.linspace(max(mean - reach, span[0]), min(mean + reach, span[1]), 15), offsets)
        order = np.argsort(np.append(offsets, new))
        log_density = np.append(log_density, log_posterior(shared, new, errors, prior))[order]
        offsets = np.append(offsets, new)[order]
    most = float(log_density.max())
    weight = np.exp(log_density - most) @ np.gradient(offsets)
    return *moments_of(offsets, log_density), most + float(np.log(weight))


def likely_errors(shared: CommonRows, offset: float, z: Array) -> list[LogError]:
    """The log's error without and with jumps where the load changes: the likelier first, without an unlikely one."""
    both = [fit_log_error(shared, offset, z, large) for large in (0.0, LARGE)]
    flat: Prior = np.zeros_like
    size = np.array([log_posterior(shared, np.array([offset]), [error], flat)[0] for error in both])
    share = np.exp(size - np.logaddexp.reduce(size))
    # Log probability below the best: a share of 3e-4.
    return [replace(both[i], probability=float(share[i])) for i in np.argsort(-size) if size[i] > size.max() - 8.0]


def moments_of(offset: Array, log_density: Array) -> tuple[float, float]:
    """Mean and sd of a density given by its log at rising points."""
    weight = np.exp(log_density - log_density.max()) * np.gradient(offset)
    weight /= weight.sum()
    mean = float(weight @ offset)
    return mean, float(np.sqrt(weight @ (offset - mean) ** 2))


def common_rows(moments: Moments, rows: BinnedLog, offsets: Array, first: float) -> tuple[CommonRows | None, Array]:
    """The rows that all `offsets` cover, None where too few; and parameters to begin with."""
    use = np.all([moments_at(moments, rows.time - offset, rows.width).known for offset in offsets], axis=0)
    time, half = moments.track.time, 0.5 * rows.width
    film = moments_at(moments, np.arange(time[0] + half, time[-1] - half, rows.width), rows.width)
    if use.sum() < FEWEST or film.known.sum() < FEWEST:
        return None, np.zeros(0)
    time_used, force = rows.time[use], rows.force[use]
    compliance, sign, bias = rough_compliance(moments_at(moments, time_used - first, rows.width), force)
    model = ForceLogModel(moments, compliance, rows.largest)
    shared = CommonRows(moments, time_used, rows.width, sign * force, film.select(film.known), model)
    return shared, model.start(bias)


def fit_log_error(shared: CommonRows, offset: float, z: Array, large: float) -> LogError:
    """Parameters, noise and jumps at one offset, each fitted in turn from a guess. `large` = 0: without jumps."""
    moments, model = shared.rows_at(offset), shared.model
    share, start = load_change_share(moments), first_guess(shared.force, shared.width)
    noise, jumps, typical = start, (large * model.force) ** 2 * share, (TYPICAL * model.force) ** 2 * share
    for _ in range(TURNS):
        spread = model.force_on_beam(moments, z)[1]
        root = np.linalg.cholesky(log_covariance(noise, shared.rows, spread, jumps))
        _, z = laplace_evidence(
            model, moments, lambda x: film_misfit(model, shared.film, x), shared.force, np.asarray(root), z, FIRST
        )
    spread = model.force_on_beam(moments, z)[1]
    residual, design = residual_and_design(model, moments, shared.film, shared.force, z)
    for _ in range(TURNS if large else 0):
        noise = fit_residual_noise(residual, design, shared.rows, spread, start, jumps)
        others = log_covariance(noise, shared.rows, spread, np.zeros_like(jumps))
        jumps = fit_jumps(residual, design, others, jumps, typical)
    known = (typical > 0.0) & (jumps > 0.0)
    size = jumps[known] / typical[known]
    log_prior = -0.5 * float(np.sum(np.log(size) + 1.0 / size - 1.0))  # of variances of Cauchy distributed jumps
    jump_sd = float(np.sqrt(np.maximum(jumps - typical, 0.0).sum()))
    noise = fit_residual_noise(residual, design, shared.rows, spread, start, jumps)
    return LogError(noise, jumps, z, log_prior, jump_sd)


def log_posterior(shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior) -> Array:
    """Log posterior at `offsets` up to a constant, summed over the likely `errors` of the log."""
    log_density = np.full(len(offsets), -np.inf)
    for error in errors:
        misfit_at = quadratic_film_misfit(shared.model, shared.film, error.z)
        for i, offset in enumerate(offsets):
            moments = shared.rows_at(float(offset))
            spread = shared.model.force_on_beam(moments, error.z)[1]
            root = np.linalg.cholesky(log_covariance(error.noise, shared.rows, spread, error.jumps))
            value, _ = laplace_evidence(shared.model, moments, misfit_at, shared.force, np.asarray(root), error.z, FAST)
            log_density[i] = np.logaddexp(log_density[i], value + error.log_prior)
    return np.asarray(log_density + prior(offsets))
