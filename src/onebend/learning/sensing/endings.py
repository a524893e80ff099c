"""When contacts end: by the swing of a beam that was let go, or as its bending goes to zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from onebend.beam.dynamics import body
from onebend.beam.grid import Modes
from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.beam.vibration import settle, vibration_of
from onebend.learning.paper import solve_states
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
    end: Edge | None = None  # None: the bending does not tell it


# Evidence with linear normal unknowns, and mean and sd of the one unknown that is not linear.

_LIKELY = 12.0  # of the log evidence below the best: farther down it is not


def evidence_of(basis: Array, value: Array, noise: Array, sizes: list[tuple[float, Array]]) -> Array:
    """(n,) log evidence, up to a constant, that `value` (F,) with white `noise` (F,) is a sum of `basis` (n, F, d).
    `sizes`: log prior and sds (d,) of the coefficients of each way."""
    basis = basis / noise[:, None]
    normal = np.swapaxes(basis, 1, 2) @ basis
    right = np.swapaxes(basis, 1, 2) @ (value / noise)
    every = np.stack([before + _at_sizes(normal, right, sds) for before, sds in sizes])
    best = np.max(every, axis=0)
    return np.asarray(best + np.log(np.sum(np.exp(every - best), axis=0)))


def _at_sizes(normal: Array, right: Array, sds: Array) -> Array:
    """(n,) from normal equations (n, d, d) and (n, d)."""
    on = np.flatnonzero(sds)
    scale = sds[on]
    whole = np.eye(len(on)) + scale[:, None] * normal[:, on][:, :, on] * scale
    root = np.linalg.cholesky(whole)
    left = np.linalg.solve(root, (scale * right[:, on])[..., None])[..., 0]
    return np.asarray(0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nii->ni", root)), axis=1))


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


# One mode under a force that vanishes at the end: `y + 2 z y' / w + y'' / w^2 = f`. y is the free swing after the end,
# continued to earlier times, plus the effect of f backwards in time. With u the time left, the effect of `u^n / n!` is
#
# p(u) - p(0) free(1, 0) + p'(0) free(0, 1),   p = sum over m of the m-th derivative of u^n / n! times d_m,
# d = 1, a, a^2 - b, a^3 - 2 a b,   a = 2 z / w, b = 1 / w^2.
#
# f is a sum of powers of u, a random walk, and a fall to zero in a given time: a straight line with a bridge on it.

POWERS = 3  # u, u^2 / 2, u^3 / 6
STEPS = 24  # of the walk
FALLS = tuple(5e-3 * 2.0 ** (i / 2.0) for i in range(11))  # s, 5 to 160 ms
PIECES = 8  # of a fall: the straight line, and 7 of the bridge
SWING = 4  # two amplitudes, frequency, damping
_BRIDGE = 0.25  # of the fall: sd of the bridge's first wave; the next ones less
_SLIGHT_DAMPING = 1e-4


@dataclass(frozen=True)
class Mode:
    """A damped mode, and its free swing about a given time."""

    rate: float  # rad/s, w
    damping: float  # z, below 1
    origin: float  # s
    start: float  # y at the origin
    speed: float  # y' there over w

    def free(self, since: Array) -> tuple[Array, Array]:
        """y `since` (...) s after y = 1, y' = 0, and after y = 0, y' = w."""
        w, z = self.rate, self.damping
        root = np.sqrt(1.0 - z**2)
        decay = np.exp(-z * w * since)
        sine = decay * np.sin(root * w * since) / root
        return np.asarray(decay * np.cos(root * w * since) + z * sine), np.asarray(sine)

    def swing(self, time: Array) -> Array:
        """(F, 4): free swings of the two amplitudes, and what a change of log frequency and of damping does."""
        since = time - self.origin
        one, two = self.free(since)
        away = []
        for rate, damping in (
            (self.rate * (1.0 + _SLIGHT_DAMPING), self.damping),
            (self.rate, self.damping + _SLIGHT_DAMPING),
        ):
            a, b = Mode(rate, damping, 0.0, 0.0, 0.0).free(since)
            away.append((self.start * (a - one) + self.speed * (b - two)) / _SLIGHT_DAMPING)
        return np.stack([one, two, *away], axis=-1)

    def of_powers(self, left: Array, most: int) -> Array:
        """(..., most + 1): what u^n / n! does, n = 0 ... most, `left` (...) s before the end; 0 after it."""
        a, b = 2.0 * self.damping / self.rate, self.rate**-2
        by = (1.0, a, a**2 - b, a**3 - 2.0 * a * b)
        u = np.maximum(left, 0.0)
        one, two = self.free(-u)
        out = []
        for n in range(most + 1):
            p = sum(by[m] * u ** (n - m) / factorial(n - m) for m in range(n + 1))
            out.append(np.where(left > 0.0, p - by[n] * one + (by[n - 1] / self.rate if n else 0.0) * two, 0.0))
        return np.stack(out, axis=-1)


def columns(mode: Mode, time: Array, ends: Array, long: float) -> Array:
    """(n, F, 4 + 3 + 24 + 8 falls): what each part does at `time` (F,) for ends (n,); u in `long` s, falls to one."""
    left = ends[:, None] - time
    swing = np.broadcast_to(mode.swing(time), (*left.shape, SWING))
    powers = (mode.of_powers(left, POWERS) / long ** np.arange(POWERS + 1))[..., 1:]
    step = max(0.5 * float(np.median(np.diff(time))), 0.02 * long)
    edges = np.concatenate([[0.0], np.geomspace(step, 1.5 * max(long, step), STEPS)])
    reach = mode.of_powers(left[..., None] - edges, 2)[..., 2] / long**2
    walk = (reach[..., :-1] - reach[..., 1:]) / np.sqrt(np.diff(edges) / long) * np.sqrt(3.0)
    return np.concatenate([swing, powers, walk, *(_fall(mode, left, lasts) for lasts in FALLS)], axis=-1)


def _fall(mode: Mode, left: Array, lasts: float) -> Array:
    """(n, F, 8): of a fall to zero within `lasts` s: the straight line, and the bridge's waves with an sd of one."""
    at = np.arange(PIECES + 1) / PIECES
    wave = np.arange(1, PIECES)
    values = np.column_stack([at, np.sin(np.pi * np.outer(at, wave)) * _BRIDGE / wave**1.5])
    slopes = np.diff(values, axis=0) * PIECES / lasts
    kinks = np.diff(np.vstack([np.zeros(PIECES), slopes, np.zeros(PIECES)]), axis=0)
    return np.asarray(mode.of_powers(left[..., None] - lasts * at, 1)[..., 1] @ kinks)


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


# End without a swing: the bending goes to zero as `j + v u + a u^2 / 2 + w(u)`, w white noise integrated twice over the
# time left u, or as `c u^3 / 3 + w(u)`, integrated four times (a hand with the least jerk).

_FRAMES_BEFORE, _FRAMES_AFTER = 24, 48  # frames before the last one of the contact, and after it
_LATER = 5  # frames that show a force, and still may be from after the end
_CLEAR = 10.0  # sds of the noise: a smaller bending tells no end
_REST_SDS = 3.0  # sds of the noise: of what rest differs by before the contact and after it
_FINEST = 1e-3  # of the largest bending: what the steps of w leave out
_STEPS = 24  # of w
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the first frame
_ROUGH, _SMOOTH = 2, 4  # times that it is integrated
# Sizes of jump, first, second and third power, and of both w.
_SIZES = (
    *((jump, kink, 2.0, 0.0, last, 0.0) for jump, kink, last in product((0.0, 1.0), (0.0, 1.0), _LAST)),
    *((0.0, 0.0, 0.0, 3.0, 0.0, last) for last in _LAST[:-1]),
)


def straight(time: Array, value: Array, noise: float, first: int, last: int) -> Edge | None:
    """End of the contact of frames `first` to `last`; None if the bending shows none. `value` (T,) is zero at rest,
    with sd `noise`."""
    early, late = max((first + last + 1) // 2, last - _FRAMES_BEFORE + 1), min(len(time), last + _FRAMES_AFTER + 1)
    early = min(early, last - RUN + 1)
    if late <= last + 1 or early < 0 or float(np.max(np.abs(value[early:late]))) < _CLEAR * noise:
        return None
    long, size = float(time[last] - time[early]), float(np.max(np.abs(value[early:late])))
    time, value, noise = time[early:late], value[early:late], max(noise, _FINEST * size)
    sds = [(0.0, _bending_sds(size, _REST_SDS * noise, *one)) for one in _SIZES]

    def evidence(ends: Array) -> Array:
        left = np.maximum(ends[:, None] - time, 0.0) / long
        return evidence_of(_columns(left), value, np.full(len(time), noise), sds)

    low = float(time[max(last - early - _LATER, 0)])
    mean, sd, _ = scanned(evidence, low, float(time[-1]), (48, 48, 48))
    return Edge(mean, sd)


def _columns(left: Array) -> Array:
    """(n, F, 4 + 2 x 24 + 1): powers, both w, and the value at rest."""
    powers = np.stack([(left > 0.0).astype(float), left, left**2 / 2.0, left**3 / 3.0], axis=-1)
    edges = np.concatenate([[0.0], np.geomspace(0.02, 1.5, _STEPS)])
    walks = []
    for times in (_ROUGH, _SMOOTH):
        reach = np.maximum(left[..., None] - edges, 0.0) ** times / factorial(times)
        one = factorial(times - 1) * np.sqrt(2.0 * times - 1.0)  # of variance one at u = 1
        walks.append((reach[..., :-1] - reach[..., 1:]) / np.sqrt(np.diff(edges)) * one)
    return np.concatenate([powers, *walks, np.ones((*left.shape, 1))], axis=-1)


def _bending_sds(
    size: float, rest: float, jump: float, kink: float, square: float, cube: float, rough: float, smooth: float
) -> Array:
    walks = np.repeat([rough, smooth], _STEPS)
    return np.concatenate([size * np.array([jump, kink, square, cube]), size * walks, [rest]])


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


# End with a swing: the force on the slowest mode vanishes. For a given end the motion is linear in all else, and its
# evidence has a closed form. It is compared with that of a lasting force.

_SWINGS_BEFORE, _SWINGS_AFTER = 3.0, 6.0  # half swings that are looked at, about the first passage through rest
_END = 1.5  # half swings from there, in which the end is sought
_FEWEST = 8  # frames before the passage, at least
_FREE = 5  # frames that are free, at least
_SHARE = 0.006  # of the motion nearby: what one mode leaves out, higher ones and the frequency's change with the size
_ROUNDS = 3  # swing and end in turn
_CHANGES = 0.3  # sd of log frequency and of damping about those of the swing
_AMPLITUDES = 3.0  # sd of the swing's amplitudes, of the motion nearby
_RATES, _DAMPINGS = (0.75, 0.85, 1.0, 1.15, 1.35), (0.03, 0.15, 0.4)  # where the fit of the swing begins
_AWAY = 0.53  # of the log frequency from that of the half swings, at most
_DAMPED = (-7.0, 0.8)  # of the damping's log odds: 0.001 to 0.7, beyond which nothing swings
_NO_FALL = -1
# Sizes of the three powers and the walk: slow ends, and each fall with the change of force before it.
_SLOW = tuple(
    (_NO_FALL, *powers, walk)
    for powers in ((0.3, 0.6, 0.0), (3.0, 6.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0), (0.1, 1.0, 6.0))
    for walk in (0.03, 0.3, 3.0)
)
_QUICK = tuple((i, 0.0, 0.0, 0.0, walk) for i in range(len(FALLS)) for walk in (0.03, 0.3, 1.0))


@dataclass(frozen=True)
class _Part:
    time: Array  # (F,) s
    value: Array  # (F,)
    noise: Array  # (F,) sd
    zero: float  # sd of the value at rest
    size: float  # of the motion
    long: float  # s, from the first frame to the first passage


def release(time: Array, value: Array, noise: float, swing: HalfSwings, first: int) -> Edge | None:
    """End of a contact from frame `first` on that a swing follows; None if the evidence is for a lasting force. `value`
    (T,) is zero at rest, with sd `noise`."""
    part = _part(time, value, noise, swing, first)
    low = max(float(time[first]), float(part.time[1]), swing.passage - _END * swing.half)
    high = max(min(swing.passage + _END * swing.half, float(part.time[-1]) - 0.5 * swing.half), low + 0.2 * swing.half)
    try:
        return _told(part, swing, low, high)
    except np.linalg.LinAlgError:  # so strongly damped that going back in time it grows beyond all numbers: no swing
        return None


def _told(part: _Part, swing: HalfSwings, low: float, high: float) -> Edge | None:
    """Between `low` and `high`: swing and end in turn."""
    free_from = swing.passage
    for _ in range(_ROUNDS):
        mode = _fitted(part, free_from, swing)
        mean, sd, released = scanned(partial(_evidence, part, mode), low, high, (72, 36, 36))
        free_from = mean + sd
    goes_on = _evidence(part, mode, part.time[-1:])[0]
    return Edge(mean, sd) if released > goes_on else None


def _part(time: Array, value: Array, noise: float, swing: HalfSwings, first: int) -> _Part:
    near = int(np.searchsorted(time, swing.passage))
    begin = int(np.searchsorted(time, max(float(time[first]), swing.passage - _SWINGS_BEFORE * swing.half)))
    begin = min(begin, max(near - _FEWEST, 0))
    last = min(swing.passage + _SWINGS_AFTER * swing.half, float(time[swing.last]) + swing.half)
    end = max(int(np.searchsorted(time, last)), near + _FEWEST // 2)
    time, value = time[begin:end], value[begin:end]
    nearby = max(int(0.5 * swing.half / float(np.median(np.diff(time)))), 1)
    sizes = np.abs(value)
    around = np.array([np.max(sizes[max(i - nearby, 0) : i + nearby + 1]) for i in range(len(sizes))])
    long = max(swing.passage - float(time[0]), swing.half)
    return _Part(time, value, np.hypot(noise, _SHARE * around), noise, float(np.max(sizes)), long)


def _fitted(part: _Part, free_from: float, swing: HalfSwings) -> Mode:
    free: BoolArray = part.time >= free_from
    free[-_FREE:] = True
    since, seen = part.time[free] - swing.passage, part.value[free]

    def fit(x: Array) -> tuple[Array, Array]:
        basis = np.stack(Mode(float(np.exp(x[0])), _damping(x[1]), 0.0, 0.0, 0.0).free(since), axis=-1)
        amplitudes = np.linalg.lstsq(basis, seen, rcond=None)[0]
        return np.asarray(amplitudes), np.asarray(basis @ amplitudes - seen)

    usual = float(np.log(np.pi / swing.half))
    starts = [np.array([usual + np.log(r), np.log(z / (1.0 - z))]) for r in _RATES for z in _DAMPINGS]
    best = min(starts, key=lambda x: float(np.sum(fit(x)[1] ** 2)))
    bounds = ([usual - _AWAY, _DAMPED[0]], [usual + _AWAY, _DAMPED[1]])
    x = least_squares(lambda x: fit(x)[1], best, bounds=bounds, x_scale=[0.1, 0.5]).x
    start, speed = fit(x)[0]
    return Mode(float(np.exp(x[0])), _damping(x[1]), swing.passage, float(start), float(speed))


def _damping(x: float) -> float:
    return float(1.0 / (1.0 + np.exp(-x)))


def _evidence(part: _Part, mode: Mode, ends: Array) -> Array:
    """(n,) log, of ends (n,) [s], but for a constant."""
    basis = columns(mode, part.time, ends, part.long)
    basis = np.concatenate([basis, np.ones((*basis.shape[:2], 1))], axis=-1)
    sizes = [(-float(np.log(2.0 * len(some))), _swing_sds(part, *one)) for some in (_SLOW, _QUICK) for one in some]
    return evidence_of(basis, part.value, part.noise, sizes)


def _swing_sds(part: _Part, fall: int, kink: float, square: float, cube: float, walk: float) -> Array:
    falls = np.zeros((len(FALLS), PIECES))
    if fall != _NO_FALL:
        falls[fall] = part.size
    swing = np.array([_AMPLITUDES * part.size, _AMPLITUDES * part.size, _CHANGES, _CHANGES])
    steps = np.full(STEPS, part.size * walk)
    assert len(swing) == SWING
    powers = part.size * np.array([kink, square, cube])
    assert len(powers) == POWERS
    return np.concatenate([swing, powers, steps, falls.ravel(), [part.zero]])


# Contacts with their ends by the bending. Motion after a release is no contact.

_REST_FRAMES = 8  # frames before the first contact that tell how the beam is at rest
_SLIGHT_SWING = 2.0  # times what a swing is clear from: so little is left of it
_SOON = 2.0  # half swings after the last clear one in which what is left is of it


def ended(seen: ModeBending, runs: list[tuple[int, int]], widened: float) -> list[ContactFrames]:
    """The contacts of `runs` (first and last frame) without swings, with their ends. `seen`: of all frames; `widened`:
    factor on the variance of lasting noise."""
    if not runs:
        return []
    value, noise = _from_rest(seen, runs[0][0])
    out: list[ContactFrames] = []
    for first, last in runs:
        if out and first <= out[-1].moves:
            continue
        out.append(_contact(seen.time, value, noise, (first, last), runs))
    after = [*(one.first for one in out[1:]), len(value)]
    lasting = float(np.sqrt(widened)) * noise
    return [_straight(seen.time, value, lasting, one, last) for one, last in zip(out, after, strict=True)]


def _straight(time: Array, value: Array, noise: float, one: ContactFrames, after: int) -> ContactFrames:
    """With the end where the bending goes to zero before frame `after`, where no swing tells it."""
    if one.end is not None:
        return one
    known = np.flatnonzero(np.isfinite(value[:after]))
    first, last = (int(np.searchsorted(known, i)) for i in (one.first, one.last))
    return replace(one, end=straight(time[known], value[known], noise, first, last))


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
    told = release(times, values, noise, swing, begin)
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
