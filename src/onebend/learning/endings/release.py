"""When a contact ended that a swing follows: the force on the beam's slowest mode vanishes then, and not its motion.

Frequency and damping are those of the swing. For a given end the motion is linear in all else (`forced`), normal at
given sizes: the evidence is known in closed form. It is summed over sizes, over how long the fall lasts, and gives mean
and sd of the end. A force that goes on as long as the frames is weighed against it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from onebend.learning.endings.edge import Edge
from onebend.learning.endings.evidence import evidence_of, scanned
from onebend.learning.endings.forced import FALLS, PIECES, POWERS, STEPS, SWING, Mode, columns
from onebend.learning.endings.swing import HalfSwings
from onebend.records import Array, BoolArray

_BEFORE, _AFTER = 3.0, 6.0  # half swings that are looked at, before and after the first passage through rest
_END = 1.5  # half swings from there, in which the end is sought
_FEWEST = 8  # frames before the passage, at least
_FREE = 5  # frames that are free, at least
_SHARE = 0.006  # of the motion nearby: what one mode leaves out, higher ones and the frequency's change with the size
_PLACES = (72, 36, 36)  # times that are tried, and again where it is likely
_ROUNDS = 3  # swing and end in turn
_CHANGES = 0.3  # sd of log frequency and of damping about those of the swing
_AMPLITUDES = 3.0  # sd of the swing's amplitudes, of the motion nearby
_RATES, _DAMPINGS = (0.75, 0.85, 1.0, 1.15, 1.35), (0.03, 0.15, 0.4)  # where the fit of the swing begins
_AWAY = 0.53  # of the log frequency from that of the half swings, at most
_DAMPED = (-7.0, 0.8)  # of the damping's log odds: 0.001 to 0.7, beyond which nothing swings
_NO_FALL = -1
# Sizes of the three powers and the walk: a force that ends slowly, of a kink, smoother, and of a hand that leads the
# beam back; then each fall, and how the force before it changes.
_SLOW = tuple(
    (_NO_FALL, *powers, walk)
    for powers in ((0.3, 0.6, 0.0), (3.0, 6.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0), (0.1, 1.0, 6.0))
    for walk in (0.03, 0.3, 3.0)
)
_QUICK = tuple((i, 0.0, 0.0, 0.0, walk) for i in range(len(FALLS)) for walk in (0.03, 0.3, 1.0))


@dataclass(frozen=True)
class _Part:
    """The frames about an end."""

    time: Array  # (F,) s
    value: Array  # (F,)
    noise: Array  # (F,) sd
    zero: float  # sd of the value at rest
    size: float  # of the motion
    long: float  # s, from the first frame to the first passage


def release(time: Array, value: Array, noise: float, swing: HalfSwings, first: int) -> Edge | None:
    """End of the contact that begins at frame `first` of (T,) and after which the beam swings; None where the evidence
    is for a force that goes on. `value` is zero at rest, with an sd of `noise` in a frame."""
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
        mean, sd, released = scanned(partial(_evidence, part, mode), low, high, _PLACES)
        free_from = mean + sd
    goes_on = _evidence(part, mode, part.time[-1:])[0]
    return Edge(mean, sd) if released > goes_on else None


def _part(time: Array, value: Array, noise: float, swing: HalfSwings, first: int) -> _Part:
    near = int(np.searchsorted(time, swing.passage))
    begin = int(np.searchsorted(time, max(float(time[first]), swing.passage - _BEFORE * swing.half)))
    begin = min(begin, max(near - _FEWEST, 0))
    last = min(swing.passage + _AFTER * swing.half, float(time[swing.last]) + swing.half)
    end = max(int(np.searchsorted(time, last)), near + _FEWEST // 2)
    time, value = time[begin:end], value[begin:end]
    nearby = max(int(0.5 * swing.half / float(np.median(np.diff(time)))), 1)
    sizes = np.abs(value)
    around = np.array([np.max(sizes[max(i - nearby, 0) : i + nearby + 1]) for i in range(len(sizes))])
    long = max(swing.passage - float(time[0]), swing.half)
    return _Part(time, value, np.hypot(noise, _SHARE * around), noise, float(np.max(sizes)), long)


def _fitted(part: _Part, free_from: float, swing: HalfSwings) -> Mode:
    """The free swing that fits the frames from then on best."""
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
    sizes = [(-float(np.log(2.0 * len(some))), _sds(part, *one)) for some in (_SLOW, _QUICK) for one in some]
    return evidence_of(basis, part.value, part.noise, sizes)


def _sds(part: _Part, fall: int, kink: float, square: float, cube: float, walk: float) -> Array:
    """Of the columns and of the value at rest."""
    falls = np.zeros((len(FALLS), PIECES))
    if fall != _NO_FALL:
        falls[fall] = part.size
    swing = np.array([_AMPLITUDES * part.size, _AMPLITUDES * part.size, _CHANGES, _CHANGES])
    steps = np.full(STEPS, part.size * walk)
    assert len(swing) == SWING
    powers = part.size * np.array([kink, square, cube])
    assert len(powers) == POWERS
    return np.concatenate([swing, powers, steps, falls.ravel(), [part.zero]])
