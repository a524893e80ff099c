"""When contacts begin and end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from onebend.beam.dynamics import body
from onebend.beam.grid import Modes
from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.beam.vibration import settle, vibration_of
from onebend.learning.paper import solve_states
from onebend.learning.sensing.forces import FrameForces
from onebend.records import Array, BoolArray, IntArray, Observations

RUN = 3  # frames in a row that show a force, before it is a contact; fewer without one do not end it


@dataclass(frozen=True)
class Edge:
    """When a contact begins or ends: mean and sd [s]; NaN and infinity where the frames do not show it."""

    time: float
    sd: float


@dataclass(frozen=True)
class ContactFrames:
    """Frames of a contact."""

    first: int
    last: int
    moves: int  # last frame in which the beam is not at rest again
    end: Edge | None = None  # None: no swing tells it


_LIKELY = 12.0  # of the log evidence below the best: farther down it is not


def scanned(
    evidence: Callable[[Array], Array], low: float, high: float, counts: tuple[int, ...]
) -> tuple[float, float, float]:
    """Mean, sd and log evidence of a number with a flat prior between `low` and `high`, on grids of `counts` places,
    each where the one before is likely."""
    wide = high - low
    for count in counts:
        at = np.linspace(low, high, count)
        of = evidence(at)
        likely, step = at[of > np.max(of) - _LIKELY], at[1] - at[0]
        low, high = max(low, float(likely[0] - step)), min(high, float(likely[-1] + step))
    weight = np.exp(of - np.max(of))
    whole = float(np.max(of) + np.log(np.sum(weight) * step / wide))
    weight /= np.sum(weight)
    mean = float(weight @ at)
    return mean, float(np.sqrt(weight @ (at - mean) ** 2 + step**2 / 12.0)), whole


# Bending along the slowest mode of small vibrations about rest. Modes are orthogonal in stiffness.


@dataclass(frozen=True)
class ModeBending:
    """Along the slowest mode, in T frames: as much as turns the tip by 1 rad is 1; NaN in frames without tags."""

    time: Array  # (T,) s
    value: Array  # (T,)
    sd: Array  # (T,) of the tags' noise

    def take(self, rows: IntArray | slice) -> ModeBending:
        """Of some frames."""
        return ModeBending(*(values[rows] for values in vars(self).values()))


def bending(beam: Beam, o: Observations) -> ModeBending:
    """Of every frame of a recording of a beam that swings freely, its far end not held."""
    states = solve_states(o, min(4, 2 * len(o.marker_s)))
    mass = np.asarray(beam.mass_per_length(np.linspace(0.0, 1.0, 11)))
    on = body(beam if np.all(mass > 0.0) else replace(beam, mass_per_length=Uniform(1.0)), Modes(6))
    shape = vibration_of(on, settle(on), count=1).shapes[:, 0]
    shape = shape / float((on.to_places(np.array([1.0])) @ shape)[0])
    bends = on.curvature @ shape
    weight = on.grid.weights * np.asarray(beam.stiffness(on.grid.nodes)) * bends
    to_mode = weight @ states.modes.curvature(on.grid.nodes) / float(weight @ bends)
    value = (states.theta - states.theta0) @ to_mode
    variance = np.einsum("i,tij,j->t", to_mode, states.covariance, to_mode)
    return ModeBending(o.time, np.where(states.converged, value, np.nan), np.sqrt(variance))


# Half swings after a contact: alike in time, and none larger than the one before.

CLEAR = 5.0  # sds of the noise above which a half swing is one
_UNEVEN = (0.6, 1.6)  # of the first: how long the next ones last
_GROWS = 1.1  # times the one before, at most
_FORCED = 2  # half swings that may be before the end of the contact
_ALONE = 10.0  # times as large as need be: a half swing that is followed by none


@dataclass(frozen=True)
class HalfSwings:
    """Half swings after a push."""

    passage: float  # s, where the first begins
    half: float  # s, how long one lasts
    last: int  # frame up to which they are clear


class _Lobe(NamedTuple):
    sign: int
    first: int
    last: int
    size: float
    peak: int


def find_swing(time: Array, value: Array, noise: float, first: int, last: int) -> HalfSwings | None:
    """The half swings after the largest push between frames `first` and `last`; None if nothing swings. `value` (T,) is
    zero at rest, with sd `noise`."""
    least = CLEAR * noise
    lobes = _lobes(value, least)
    inside = [i for i, lobe in enumerate(lobes) if lobe.last >= first and lobe.first <= last]
    if not inside:
        return None
    lobes = lobes[max(inside, key=lambda i: lobes[i].size) :]
    passages = [_passage(time, value, a, b) for a, b in pairwise(lobes)]
    lasts = np.diff(passages)
    for i in range(min(_FORCED + 1, len(passages) - 1)):
        count = _alike(lobes[i + 1 :], lasts[i:], least)
        if lobes[i + 1].size > _GROWS * lobes[0].size + least:
            return None
        if count > 1:
            last = lobes[i + count].last
            if i + count + 2 == len(lobes):  # how long the very last one lasts is not seen
                more = _alike(lobes[i + count :], np.full(2, lasts[i]), least) > 1
                last = lobes[-1].last if more and time[lobes[-1].last] - passages[-1] < _UNEVEN[1] * lasts[i] else last
            return _checked(time, lobes[i], lobes[i + 1], HalfSwings(passages[i], float(lasts[i]), last))
    if len(lobes) != 2 or lobes[1].size < _ALONE * least:
        return None
    half = 2.0 * max(float(time[lobes[1].peak]) - passages[0], 0.5 * float(np.median(np.diff(time))))
    return _checked(time, lobes[0], lobes[1], HalfSwings(passages[0], half, lobes[1].last))


def _checked(time: Array, before: _Lobe, after: _Lobe, found: HalfSwings) -> HalfSwings | None:
    return found if time[after.first] - time[before.last] <= found.half else None


def _alike(lobes: list[_Lobe], lasts: Array, least: float) -> int:
    """How many half swings there are in a row, from the first of `lobes` on."""
    count = 1
    while count < min(len(lasts), len(lobes)):
        uneven = not _UNEVEN[0] < lasts[count] / lasts[0] < _UNEVEN[1]
        if uneven or lobes[count].size > _GROWS * lobes[count - 1].size + least:
            break
        count += 1
    return count


def _lobes(value: Array, least: float) -> list[_Lobe]:
    """Stretches on one side, from the first frame beyond `least` to the last one."""
    signs = np.where(value > least, 1, np.where(value < -least, -1, 0))
    spans: list[tuple[int, int, int]] = []
    for i in np.flatnonzero(signs):
        if spans and spans[-1][0] == signs[i]:
            spans[-1] = spans[-1][0], spans[-1][1], int(i)
        else:
            spans.append((int(signs[i]), int(i), int(i)))
    out = []
    for sign, a, b in spans:
        size = np.abs(value[a : b + 1])
        out.append(_Lobe(sign, a, b, float(np.max(size)), a + int(np.argmax(size))))
    return out


def _passage(time: Array, value: Array, before: _Lobe, after: _Lobe) -> float:
    i, j = before.last, after.first
    return float(time[i] + (time[j] - time[i]) * value[i] / (value[i] - value[j]))


# End with a swing. A beam that is let go is at its largest bending then, and goes through rest a quarter of a swing
# later. A hand that opens slowly lets go up to as much later again. What follows must be a damped sinusoid, or a hand
# moved the beam.

_FREE_SWINGS = 6.0  # half swings after the first passage through rest that are compared with one
_HELD = 0.98  # of the largest bending in the half swing before: as long as that is left, the hand holds the beam
_LEFT = 0.15  # of their size, RMS: with more left it is no free swing
_AWAY = 0.53  # of the log frequency from that of the half swings, at most
_DAMPED = (-7.0, 0.8)  # of the damping's log odds: 0.001 to 0.7, beyond which nothing swings


def release(time: Array, value: Array, noise: float, swing: HalfSwings) -> Edge | None:
    """End of a contact that a swing follows; None if what follows is no free swing. `value` (T,) is zero at rest, with
    sd `noise`."""
    free = (time >= swing.passage) & (time <= swing.passage + _FREE_SWINGS * swing.half)
    since, seen = time[free] - swing.passage, value[free]
    if len(since) < RUN:
        return None

    def left(x: Array) -> Array:
        ratio = 1.0 / (1.0 + np.exp(-x[1]))
        phase, decay = np.exp(x[0]) * np.sqrt(1.0 - ratio**2) * since, np.exp(-ratio * np.exp(x[0]) * since)
        basis = np.stack([decay * np.cos(phase), decay * np.sin(phase)], axis=-1)
        return np.asarray(basis @ np.linalg.lstsq(basis, seen, rcond=None)[0] - seen)

    usual = float(np.log(np.pi / swing.half))
    bounds = ([usual - _AWAY, _DAMPED[0]], [usual + _AWAY, _DAMPED[1]])
    found = least_squares(left, [usual, -2.5], bounds=bounds, x_scale=[0.1, 0.5])
    size = np.sqrt(np.mean(seen**2))
    if np.sqrt(np.mean(found.fun**2)) > _LEFT * size + noise:
        return None
    before = np.flatnonzero((time >= swing.passage - swing.half) & (time <= swing.passage))
    bent = np.abs(value[before])
    held = before[np.flatnonzero(bent >= _HELD * np.max(bent))[-1]]
    earliest, latest = float(time[max(held - 1, 0)]), swing.passage + 0.5 * swing.half
    return Edge(0.5 * (earliest + latest), (latest - earliest) / float(np.sqrt(12.0)))


# Contacts with their ends by the bending. Motion after a release is no contact.

_REST_FRAMES = 8  # frames before the first contact that tell how the beam is at rest
_SLIGHT_SWING = 2.0  # times what a swing is clear from: so little is left of it
_SOON = 2.0  # half swings after the last clear one in which what is left is of it


def ended(seen: ModeBending, runs: list[tuple[int, int]]) -> list[ContactFrames]:
    """The contacts of `runs` (first and last frame) without swings, with the ends that a swing tells. `seen`: of all
    frames."""
    if not runs:
        return []
    value, noise = _from_rest(seen, runs[0][0])
    out: list[ContactFrames] = []
    for first, last in runs:
        if out and first <= out[-1].moves:
            continue
        out.append(_contact(seen.time, value, noise, (first, last), runs))
    return out


def _from_rest(seen: ModeBending, first: int) -> tuple[Array, float]:
    """The bending (T,) less that before frame `first`, and the sd of its noise."""
    before = seen.value[:first][np.isfinite(seen.value[:first])]
    noise = float(np.nanmedian(seen.sd))
    if len(before) < _REST_FRAMES:
        return seen.value, noise
    return seen.value - float(np.mean(before)), max(noise, float(np.std(before, ddof=1)))


def _contact(
    time: Array, value: Array, noise: float, run: tuple[int, int], runs: list[tuple[int, int]]
) -> ContactFrames:
    """Where a swing tells the end of `run`, by that; else as it is."""
    first, last = run
    usual = ContactFrames(first, last, last)
    known = np.flatnonzero(np.isfinite(value))
    times, values = time[known], value[known]
    begin, end = int(np.searchsorted(known, first)), int(np.searchsorted(known, last))
    swing = find_swing(times, values, noise, begin, end)
    if swing is None or end - begin < RUN:
        return usual
    moves = _until(time, value, noise, int(known[swing.last]), swing, runs)
    if moves < last:
        return usual
    told = release(times, values, noise, swing)
    let = -1 if told is None else int(np.searchsorted(time, told.time)) - 1
    return usual if let < first else ContactFrames(first, let, moves, told)


def _until(time: Array, value: Array, noise: float, last: int, swing: HalfSwings, runs: list[tuple[int, int]]) -> int:
    """Last frame of the runs that are what is left of the swing after its last clear frame."""
    for first, end in runs:
        soon = first <= last or time[first] - time[last] < _SOON * swing.half
        rest = np.nan_to_num(value[max(last + 1, first) : end + 1])
        if end > last and soon and np.max(np.abs(rest)) < _SLIGHT_SWING * CLEAR * noise:
            last = end
    return last


# The force is zero until `t0`, and then `j + v t + a t^2 / 2 + c t^3 / 3 + w(t)`, with w white noise integrated twice.
# For given sizes of the five the evidence of each `t0` has a closed form; it is summed over sizes. An end is a
# beginning with time reversed, where no swing shows it (`endings`).

_BEFORE, _AFTER = 48, 24  # frames that tell when it begins
_LATER = 5  # frames that show a force, and still may be from before
_PLACES = (48, 48)  # times that are tried, and again where it is likely
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the end
# Of a jump, of what begins with the first, second and third power of time, and of w. A robot's hand that begins as
# smoothly as it can (least jerk) begins with the third.
_SIZES = (*product((0.0, 1.0), (0.0, 1.0), (2.0,), (0.0,), _LAST), *product((0.0,), (0.0,), (0.0,), (3.0,), _LAST))


def runs_of(touched: BoolArray) -> list[tuple[int, int]]:
    """First and last frame of each contact."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touched, [False]]).astype(int)))
    runs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    joined: list[tuple[int, int]] = []
    for first, last in runs:
        if joined and first - joined[-1][1] <= RUN:
            joined[-1] = joined[-1][0], last
        else:
            joined.append((first, last))
    return [(a, b) for a, b in joined if np.sum(touched[a : b + 1]) >= RUN]


def within(runs: list[tuple[int, int]], count: int) -> BoolArray:
    """(count,) whether a frame is of a contact."""
    inside: BoolArray = np.zeros(count, dtype=np.bool_)
    for first, last in runs:
        inside[first : last + 1] = True
    return inside


def frames_at_edges(runs: list[tuple[int, int]], count: int) -> IntArray:
    """Those of `count` frames that tell when contacts begin and end."""
    some: list[int] = []
    for first, last in runs:
        some += range(max(first - _BEFORE, 0), min(first + _AFTER, count))
        some += range(max(last - _AFTER + 1, 0), min(last + _BEFORE + 1, count))
    return np.unique(np.array(some, dtype=np.int64))


def edges_of(
    readings: FrameForces, frames: IntArray, contacts: list[ContactFrames], count: int, prior_sd: float
) -> list[tuple[Edge, Edge]]:
    """Beginning and end of each contact; `readings` are of `frames` out of `count`."""
    out = []
    for i, one in enumerate(contacts):
        first, last = one.first, one.last
        before = contacts[i - 1].moves if i else -1
        after = contacts[i + 1].first if i + 1 < len(contacts) else count
        middle = (first + last + 1) // 2
        early, late = max(before + 1, first - _BEFORE), min(max(middle, first + RUN), first + _AFTER)
        begin = _begin(readings.take(np.flatnonzero((frames >= early) & (frames < late))), first - early, prior_sd)
        if one.end is not None:
            out.append((begin, one.end))
            continue
        early, late = max(middle, last - _AFTER + 1), min(after, last + _BEFORE + 1)
        back = readings.take(np.flatnonzero((frames >= min(early, last - RUN + 1)) & (frames < late))[::-1])
        end = _begin(replace(back, time=-back.time), late - 1 - last, prior_sd)
        # Frames in which the beam is nearly straight tell the force along it least: an end by them is a frame off.
        out.append((begin, Edge(-end.time, float(np.hypot(end.sd, np.median(np.diff(readings.time)))))))
    return out


def _begin(readings: FrameForces, first: int, prior_sd: float) -> Edge:
    """When the force begins that the frames from `first` on show."""
    time = readings.time
    if first == 0 or len(time) < RUN + 1:
        return Edge(float("nan"), float("inf"))
    low, high = float(time[0]), float(time[min(first + _LATER, len(time) - 1)])
    mean, sd, _ = scanned(lambda at: _evidence_of_edges(readings, at, first, prior_sd), low, high, _PLACES)
    return Edge(mean, sd)


def _evidence_of_edges(readings: FrameForces, at: Array, first: int, prior_sd: float) -> Array:
    """(n,) log, of beginnings `at` (n,) [s], but for a constant."""
    tells = np.any(readings.weigh != 0.0, axis=-1)  # (W, 2)
    weigh, told, common = readings.weigh[tells], readings.told[tells], readings.common[tells]
    noise = np.eye(len(told)) + common @ common.T
    since = np.maximum(np.repeat(readings.time[:, None], 2, axis=1)[tells] - at[:, None], 0.0)  # (n, R)
    long = max(float(readings.time[-1] - readings.time[first]), 1e-9)
    size = _size(readings, first, prior_sd)
    on = (since > 0.0).astype(float)
    less = np.minimum(since[:, :, None], since[:, None]) / long
    more = np.maximum(since[:, :, None], since[:, None]) / long
    kinds = [on[:, :, None] * on[:, None]]
    kinds += [(since[:, :, None] * since[:, None] / long**2) ** n / n**2 for n in (1, 2, 3)]
    kinds.append(1.5 * less**2 * (more - less / 3.0))  # of variance one at the end
    alike = size**2 * (weigh @ weigh.T)
    rows = []
    for sizes in _SIZES:
        whole = noise + alike * sum(one**2 * kind for one, kind in zip(sizes, kinds, strict=True) if one > 0.0)
        root = np.linalg.cholesky(whole)
        left = np.linalg.solve(root, np.broadcast_to(told[:, None], (len(at), len(told), 1)))[..., 0]
        rows.append(-0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nrr->nr", root)), axis=1))
    every = np.stack(rows)
    best = np.max(every)
    return np.asarray(best + np.log(np.maximum(np.mean(np.exp(every - best), axis=0), 1e-300)))


def _size(readings: FrameForces, first: int, prior_sd: float) -> float:
    """N, of the forces that the frames from `first` on show."""
    normal = np.swapaxes(readings.weigh, 1, 2) @ readings.weigh + np.eye(2) / prior_sd**2
    right = np.einsum("fdc,fd->fc", readings.weigh, readings.told)
    force = np.linalg.solve(normal, right[..., None])[..., 0]
    return max(float(np.max(np.hypot(*force[first:].T))), 1e-9 * prior_sd)
