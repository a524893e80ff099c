"""The force as a process in time, and when contacts begin and end."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from onebend.learning.endings import RUN, ContactFrames, Edge, scanned
from onebend.learning.sensing.forces import Estimates, FrameForces, estimated
from onebend.records import Array, BoolArray, IntArray

# Each component of the force is a Matern process of order 5/2 with the sd of the force's prior. The evidence chooses
# its correlation time; it begins anew with each contact. Kalman filter, and the backward recursion of Bryson and
# Frazier. Errors that all frames share pass through the smoother and are added: frames do not average them down.

_ORDER = 3  # numbers of the state of a component
_TIMES = 24  # correlation times that are tried
_SHORTEST, _LONGEST = 0.5, 100.0  # of them: of the time between frames, and of all frames


@dataclass(frozen=True)
class Smoothed:
    """The force of T frames with what their neighbours say."""

    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    memory: float  # s, the process's correlation time
    widened: float  # of the variance of the frames' own noise, for its memory

    def turned(self, axes: Array) -> Smoothed:
        """In other axes, (2, 2)."""
        return replace(self, force=self.force @ axes.T, covariance=axes @ self.covariance @ axes.T)


class _Frame(NamedTuple):
    """What a Kalman filter leaves of a frame, for G processes of n numbers: the state before it, and the innovation,
    each at `e` zero (first column) and its change with each number of `e`."""

    mean: Array  # (G, n, 1 + r)
    spread: Array  # (G, n, n)
    weigh: Array  # (2, n)
    surprise: Array  # (G, 2, 1 + r), over its covariance
    inner: Array  # (G, 2, 2) inverse of that
    gain: Array  # (G, n, 2)
    step: Array  # (G, n, n) to the frame from the one before


def smoothed(time: Array, found: Estimates, runs: list[tuple[int, int]], prior_sd: float, widened: float) -> Smoothed:
    """Of frames at `time` (F,) [s], from what each shows by itself; `runs`: first and last of each contact, outside
    which the force is that of each frame; `widened`: how much wider the variance of the frames' own noise counts."""
    readings = [estimated(time, found, widened, prior_sd).take(slice(a, b + 1)) for a, b in runs]
    force, covariance = found.force[:, :2].copy(), found.covariance[:, :2, :2].copy()
    if not runs:
        return Smoothed(force, covariance, float("nan"), widened)
    memory = _memory(readings, prior_sd)
    for (a, b), one in zip(runs, readings, strict=True):
        known = np.isfinite(found.force[a : b + 1]).all(axis=1)
        mean, spread = _backward(_filtered(one, prior_sd, np.array([memory]))[0])
        force[a : b + 1][known], covariance[a : b + 1][known] = mean[known], spread[known]
    return Smoothed(force, covariance, memory, widened)


def _memory(readings: list[FrameForces], prior_sd: float) -> float:
    every = [one.time for one in readings]
    shortest = float(np.median(np.concatenate([np.diff(time) for time in every])))
    times = np.geomspace(_SHORTEST * shortest, _LONGEST * max(float(t[-1] - t[0]) for t in every), _TIMES)
    evidence = np.sum([_filtered(one, prior_sd, times)[1] for one in readings], axis=0)
    return float(times[np.argmax(evidence)])


def _filtered(readings: FrameForces, prior_sd: float, times: Array) -> tuple[list[_Frame], Array]:
    """Frames and log evidence (G,), but for a constant, of processes of correlation times `times` (G,) [s]."""
    rate, powers, still = np.sqrt(2.0 * _ORDER - 1.0) / times, *_matern(_ORDER)
    still = np.tile(prior_sd**2 * still, (len(times), 1, 1))
    columns = np.concatenate([readings.told[..., None], -readings.common], axis=-1)
    count = columns.shape[-1]
    mean, spread = np.zeros((len(times), 2 * _ORDER, count)), still
    kept: list[_Frame] = []
    evidence, last = np.zeros(len(times)), readings.time[0]
    for time, weigh, told in zip(readings.time, readings.weigh, columns, strict=True):
        step = _step(rate * (time - last), powers)
        mean = step @ mean
        spread = still + step @ (spread - still) @ np.swapaxes(step, 1, 2)
        h = np.zeros((2, 2 * _ORDER))
        h[:, ::_ORDER] = weigh
        across = spread @ h.T
        whole = np.eye(2) + h @ across
        inner = np.linalg.inv(whole)
        away = told - h @ mean
        surprise, gain = inner @ away, across @ inner
        evidence -= 0.5 * (np.einsum("gd,gd->g", away[..., 0], surprise[..., 0]) + np.linalg.slogdet(whole)[1])
        kept.append(_Frame(mean, spread, h, surprise, np.asarray(inner), gain, step))
        mean = mean + across @ surprise
        left = np.eye(2 * _ORDER) - gain @ h  # of Joseph: it stays symmetric and positive
        spread = left @ spread @ np.swapaxes(left, 1, 2) + gain @ np.swapaxes(gain, 1, 2)
        last = time
    return kept, evidence


def _matern(order: int) -> tuple[Array, Array]:
    """(order, n, n) powers of `A + 1`, `dx/dt = A x + noise` at rate one, and (n, n) the covariance of the state; n is
    twice `order`: of the one component, and of the other."""
    one = np.diag(np.ones(order - 1), 1)
    one[-1] = [-math.comb(order, j) for j in range(order)]
    noise = np.zeros((order, order))
    noise[-1, -1] = -1.0
    still = solve_continuous_lyapunov(one, noise)
    powers = [np.linalg.matrix_power(one + np.eye(order), k) for k in range(order)]
    return np.stack([np.kron(np.eye(2), each) for each in powers]), np.kron(np.eye(2), still / still[0, 0])


def _step(turns: Array, powers: Array) -> Array:
    """(G, n, n): the state after times `turns` (G,) over the rates: `exp(A t) = exp(-t) exp((A + 1) t)`, a
    polynomial."""
    series = [turns**k / math.factorial(k) for k in range(len(powers))]
    return np.asarray(np.exp(-turns)[:, None, None] * np.einsum("kg,kij->gij", np.stack(series), powers))


def _backward(frames: list[_Frame]) -> tuple[Array, Array]:
    """(T, 2) N and (T, 2, 2) N^2, of the first process."""
    count, size = len(frames), 2 * _ORDER
    force, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    pull, told = np.zeros_like(frames[0].mean[0]), np.zeros((size, size))
    for t in range(count - 1, -1, -1):
        one = frames[t]
        h, spread, step = one.weigh, one.spread[0], one.step[0]
        left = np.eye(size) - one.gain[0] @ h
        pull = left.T @ pull + h.T @ one.surprise[0]
        told = left.T @ told @ left + h.T @ one.inner[0] @ h
        mean = (one.mean[0] + spread @ pull)[::_ORDER]
        own = (spread - spread @ told @ spread)[::_ORDER, ::_ORDER]
        force[t] = mean[:, 0]
        covariance[t] = own + mean[:, 1:] @ mean[:, 1:].T
        pull, told = step.T @ pull, step.T @ told @ step
    return force, 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


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
        out.append((begin, Edge(-end.time, end.sd)))
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
