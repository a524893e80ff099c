"""The error of a force log: one record of its sizes (`records.ForceNoise`), and its covariance in time.

The clock search, the fit, the live learner and the check of a sensor all use it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from onebend.recording.signals import MAD_TO_SD, bridged, runs
from onebend.records import Array, BoolArray, ForceNoise

# The error of a force estimated from joint torques changes when the load begins, reverses or ends, with the friction in
# the joints. These times are read from the tags, as the log itself contains the error.

TURN = 0.05  # of the largest displacement: a beam that comes back by less has not reversed
CLEAR = 0.1  # of the largest displacement: by then a load has begun, or has turned
BEFORE = 0.03  # of the same: within this of a turning point the load may be reversing
EARLY = 0.1  # s, by which contact may begin before the tags show it


LOAD = 0.03  # of the largest force: expected sd of what comes with the load
ANEW, RELEASED = 2.0, 0.2  # by how much its own time runs on where the load begins or reverses, and where it ends


@dataclass(frozen=True)
class LoadChange:
    """A span of time in which the load begins, reverses or ends."""

    begin: float  # s
    end: float  # s
    release: bool  # it ends

    @property
    def amount(self) -> float:
        """By how much the load's own time runs on."""
        return RELEASED if self.release else ANEW

    def fraction(self, time: Array) -> Array:
        """(N,) 0 before it, 1 after it, evenly between."""
        return np.clip((time - self.begin) / max(self.end - self.begin, 1e-9), 0.0, 1.0)


def load_changes(time: Array, size: Array, loaded: BoolArray, largest: float = 0.0) -> list[LoadChange]:
    """Changes of the load in order, from the tags' displacement (T,) at `time` (T,) [s] and contact (T,); `largest`: it
    is at least so large."""
    largest = float(np.max(size, initial=largest))
    changes: list[LoadChange] = []
    for first, last in runs(loaded) if largest > 0.0 else ():
        part, when = size[first:last], time[first:last]
        moved = np.flatnonzero(part > CLEAR * largest)
        if not len(moved) and last < len(time):
            continue
        turns = turning_points(part, TURN * largest)
        changes.append(LoadChange(float(when[0]) - EARLY, float(when[np.append(moved, -1)[0]]), release=False))
        ends = [0, *turns, len(part) - 1]
        for before, turn, after in zip(ends, ends[1:], ends[2:], strict=False):
            from_turn = np.abs(part - part[turn])
            earlier = from_turn[before : turn + 1][::-1] > BEFORE * largest
            later = from_turn[turn : after + 1] > CLEAR * largest
            low = turn - int(np.argmax(earlier))
            high = turn + int(np.argmax(later)) if later.any() else after
            changes.append(LoadChange(float(when[low]), float(when[high]), release=False))
        if last < len(time):
            changes.append(LoadChange(float(when[moved[-1]]), float(when[-1]) + EARLY, release=True))
    return changes


def own_time(changes: Iterable[LoadChange], time: Array) -> Array:
    """(N,) the load's own time at `time` (N,) [s]."""
    return sum((one.amount * one.fraction(time) for one in changes), start=np.zeros(len(time)))


def turning_points(size: Array, margin: float) -> list[int]:
    """Indices at which `size` (T,) stops growing or falling, and then goes back by more than `margin`."""
    turns: list[int] = []
    values, rising, extreme = size.tolist(), True, 0
    for i, now in enumerate(values):
        if (now >= values[extreme]) if rising else (now <= values[extreme]):
            extreme = i
        elif abs(now - values[extreme]) > margin:
            turns.append(extreme)
            rising, extreme = not rising, i
    return turns


def displacement(time: Array, xy: Array, rest: Array) -> Array:
    """(T,) m, root mean square way of tags (T, m, 2) from their rest (m, 2), or from the first frame."""
    filled = bridged(time, xy.reshape(len(time), -1))
    start = np.where(np.isfinite(rest).ravel(), rest.ravel(), filled[0])
    return np.asarray(np.sqrt(np.mean((filled - start) ** 2, axis=1)))


# The covariance of the error between spans of time that do not overlap: of rows, frames, or means of neighbouring
# frames. The part that comes with the load has a time of its own, which advances only while the load changes.

LEAST = 1e-12  # of the largest variance, for rounding
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class TimeSpans:
    """K time spans, in order, that do not overlap."""

    begin: Array  # (K,) s, first frame
    end: Array  # (K,) s, last frame
    frames: Array  # (K,) how many
    slow: Array  # (K,) 1 where only the slow parts (level, walk, load) count, at `end`; else 0
    own: Array  # (K,) the load's own time

    @staticmethod
    def at(time: Array) -> TimeSpans:
        """Instants `time` (K,) [s] without a change of the load."""
        nothing = np.zeros(len(time))
        return TimeSpans(time, time, np.ones(len(time)), nothing, nothing)

    def after(self, time: float, own: float) -> TimeSpans:
        """These spans after one of which only the slow parts count."""
        first = (time, time, 1.0, 1.0, own)
        every = zip(first, (self.begin, self.end, self.frames, self.slow, self.own), strict=True)
        return TimeSpans(*(np.concatenate([[value], values]) for value, values in every))

    @cached_property
    def centre(self) -> Array:
        """(K,) s since the first."""
        return np.asarray(0.5 * (self.begin + self.end) - self.begin[0])

    @cached_property
    def width(self) -> Array:
        """(K,) s."""
        return np.asarray(self.end - self.begin)

    @cached_property
    def fast(self) -> Array:
        """(K,) 1 where the fast parts (coloured, white) count."""
        return np.asarray(1.0 - self.slow)

    @cached_property
    def walked(self) -> Array:
        """(K, K) s: covariance of a walk of size one."""
        out = np.minimum(self.centre[:, None], self.centre)
        out.ravel()[:: len(out) + 1] -= self.width / 6.0
        return out

    @cached_property
    def gap(self) -> Array:
        """(K, K) s between the spans; infinite to those of which only the slow parts count."""
        out = np.maximum(self.begin[:, None], self.begin) - np.minimum(self.end[:, None], self.end)
        np.maximum(out, 0.0, out=out)
        if np.any(self.slow):
            apart = self.slow > 0.0
            out[apart], out[:, apart] = np.inf, np.inf
        return out

    @cached_property
    def stages(self) -> Array:
        """(K, K) covariance of what comes with the load, of size one."""
        return np.asarray(1.0 + np.exp(-np.abs(self.own[:, None] - self.own)))


def covariance(noise: ForceNoise, spans: TimeSpans) -> Array:
    """(K, K) N^2 of the mean errors over the spans, for one axis; the walk is zero at the first."""
    share, own = _averaging(spans.width / noise.tau)
    out = np.exp(spans.gap * (-1.0 / noise.tau))
    out *= (noise.coloured * share)[:, None] * (noise.coloured * share)
    diagonal = out.ravel()[:: len(out) + 1]
    diagonal[:] = spans.fast * (noise.coloured**2 * own + noise.white**2 / spans.frames)
    out += noise.walk**2 * spans.walked
    if noise.load or noise.level:
        out += noise.load**2 * spans.stages + noise.level**2
    diagonal += LEAST * diagonal.max(initial=0.0) + TINY
    return np.asarray(out)


def with_one_more(noise: ForceNoise, spans: TimeSpans, time: float, own: float) -> tuple[Array, float]:
    """N^2, covariance (K,) of a single frame at `time`, after all spans, with them, and its variance."""
    begin = float(spans.begin[0]) if len(spans.begin) else time
    slow = noise.level**2 + noise.load**2
    alone = slow + noise.load**2 + noise.walk**2 * (time - begin) + noise.coloured**2 + noise.white**2
    share, _ = _averaging(spans.width / noise.tau)
    fast = noise.coloured**2 * spans.fast * share
    out = noise.walk**2 * spans.centre if len(spans.begin) else np.zeros(0)
    out = out + fast * np.exp((spans.end - time) / noise.tau)
    return out + slow + noise.load**2 * np.exp(-np.abs(own - spans.own)), float(alone)


def fast_variance(noise: ForceNoise, width: float, frames: float) -> float:
    """N^2: variance of the fast parts' mean over one span."""
    _, own = _averaging(np.array([width / noise.tau]))
    return float(noise.coloured**2 * own[0] + noise.white**2 / frames)


def slow_variance(noise: ForceNoise, seconds: float, own: float) -> float:
    """N^2: variance of the slow parts' change after `seconds` and after `own` of the load's own time."""
    return float(noise.walk**2 * max(seconds, 0.0) - 2.0 * noise.load**2 * np.expm1(-abs(own)))


def _averaging(u: Array) -> tuple[Array, Array]:
    """Averages over u correlation times: factors of the covariance with other times, and of the variance."""
    wide = np.maximum(u, 1e-4)
    share = -np.expm1(-wide) / wide
    return np.where(u < 1e-4, 1.0, share), np.where(u < 1e-4, 1.0, 2.0 * (1.0 - share) / wide)


def first_guess(values: Array, spacing: float) -> ForceNoise:
    """A noise of plausible size for `values` (N, a) sampled every `spacing` [s]."""
    jumps = np.diff(values, n=2, axis=0)
    white = float(np.median(np.abs(jumps))) * MAD_TO_SD / np.sqrt(6) if len(jumps) else 0.0
    size = max(white, 1e-3 * float(np.ptp(values, axis=0).max(initial=0.0)), np.finfo(float).tiny ** 0.25)
    return ForceNoise(white=size, coloured=size, tau=max(0.2, spacing), walk=0.5 * size, spacing=spacing)


_FARTHEST = 3.0  # sd of the prior: a log without noise would lead on until rounding is all that is left


def likeliest_noise(start: ForceNoise, misfit: Callable[[ForceNoise, float], float], most: int) -> ForceNoise:
    """The noise of least `misfit`, a negative log posterior, in at most so many evaluations.

    A weak prior bounds the sizes: one sd is a factor of five about `start`, of the correlation time a factor of 2.5.
    `misfit` takes the noise and the square of its distance from `start` in sd.
    """
    spread = np.log(np.array([5.0, 5.0, 2.5, 5.0]))
    centre = np.log(np.array([start.white, start.coloured, start.tau, start.walk]))

    def sized(z: Array) -> ForceNoise:
        white, coloured, tau, walk = np.exp(centre + spread * np.clip(z, -_FARTHEST, _FARTHEST)).tolist()
        return replace(start, white=white, coloured=coloured, tau=tau, walk=walk)

    simplex = np.vstack([np.zeros(4), 0.4 * np.eye(4)])
    options = {"maxfev": most, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    optimum = minimize(lambda z: misfit(sized(z), z @ z), np.zeros(4), method="Nelder-Mead", options=options)
    return sized(optimum.x)
