"""The force as a process over the frames: what neighbouring frames say of it counts too.

Each component is a Matern process of order 5/2 (twice differentiable), mean zero, with the sd of the force's prior; how
fast it changes, and whether it begins anew where a contact begins or ends, is chosen by the evidence. Kalman filter and
the backward recursion of Bryson and Frazier; the state is the force and its derivatives, each over a power of the rate.
What is left unknown of all that the frames share is carried along as it is: no number of frames averages it down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from onebend.learning.sensing.bench import Bench
from onebend.learning.sensing.estimate import Estimates
from onebend.learning.sensing.readings import Readings, read
from onebend.records import Array, BoolArray, IntArray

_ORDER = 3  # numbers of the state of a component
_TIMES = 24  # correlation times that are tried
_SHORTEST, _LONGEST = 0.5, 100.0  # of them: of the time between frames, and of all frames
_ROUNDS = 6  # of the frames' readings about the force as it is known by then
_REACH, _FEW = 0.06, 3  # of neighbours: of the time of contact, and frames at least
_SETTLED = 0.05  # sds of a frame's force: a round that changes it by less is the last


@dataclass(frozen=True)
class Smoothed:
    """The force of T frames with what their neighbours say."""

    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    memory: float  # s, the process's correlation time
    widened: float  # of the variance of the frames' own noise, for its memory
    anew: bool  # whether the process begins anew where a contact begins or ends

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


@dataclass(frozen=True)
class _Filtered:
    """And of all T frames."""

    frames: list[_Frame]
    squares: Array  # (G, 1 + r, 1 + r) of the innovations in units of their noise, summed
    size: Array  # (G,) log of the determinants of their covariances, summed


def smoothed(
    bench: Bench, frames: IntArray, found: Estimates, inside: BoolArray, prior_sd: float, *, seek_place: bool
) -> Smoothed:
    """Of `frames` (F,), rising, from what each shows by itself; `inside` (F,): those of a contact.

    Frames outside contacts are read about no force: about one that is little known along the beam, each would take
    another direction for the one in which it knows the force well, and many such frames would make both sure.
    """
    begins = tuple((np.flatnonzero(np.diff(inside)) + 1).tolist())
    known: BoolArray = np.asarray(np.isfinite(found.force).all(axis=1))
    place = np.where(known, found.place, np.nan)
    force, last = averaged(found, bench.observations.time[frames], inside & known), None
    for _ in range(_ROUNDS):
        about = np.where(known[:, None], np.where(inside[:, None], force, 0.0), np.nan)
        readings = read(bench, frames, about, place, prior_sd, seek_place=seek_place)
        out = _process(readings, prior_sd, begins, None if last is None else (last.memory, last.anew))
        if last is not None and _moved(last, out) < _SETTLED:
            break
        force, last = out.force, out
    return out


def averaged(found: Estimates, time: Array, inside: BoolArray) -> Array:
    """(F, 2) N: each frame's force, moved in the direction in which the frame knows it least to the mean of its
    neighbours; `inside` (F,): the frames of which that is wanted.

    About forces that differ so much as the frames by themselves have them, the frames would be read as if each knew
    well another direction of one force.
    """
    rows, out = np.flatnonzero(inside), found.force.copy()
    if rows.size < _FEW:
        return out
    values, ways = np.linalg.eigh(found.covariance[rows, :2, :2])
    reach = max(_REACH * float(time[rows[-1]] - time[rows[0]]), _FEW * float(np.median(np.diff(time[rows]))))
    near = np.exp(-0.5 * ((time[rows, None] - time[rows]) / reach) ** 2) / values[:, 1]
    mean = near @ found.force[rows] / np.sum(near, axis=1)[:, None]
    way = ways[..., 1]
    out[rows] += way * np.sum(way * (mean - found.force[rows]), axis=1)[:, None]
    return out


def _moved(last: Smoothed, out: Smoothed) -> float:
    """Sds, of the frame that moved farthest."""
    away = out.force - last.force
    return float(np.sqrt(np.max(np.einsum("tc,tc->t", away, np.linalg.solve(out.covariance, away[..., None])[..., 0]))))


def _process(
    readings: Readings, prior_sd: float, begins: tuple[int, ...], chosen: tuple[float, bool] | None
) -> Smoothed:
    """`chosen`: correlation time [s] and whether the process begins anew, None: by the evidence."""
    splits = [readings], _parts(readings, begins)
    memory, anew = _chosen(splits, prior_sd) if chosen is None else chosen
    found = [_backward(_filtered(one, prior_sd, np.array([memory]))) for one in splits[anew]]
    force, covariance = (np.concatenate(each) for each in zip(*found, strict=True))
    return Smoothed(force, covariance, memory, readings.widened, anew)


def _chosen(splits: tuple[list[Readings], ...], prior_sd: float) -> tuple[float, bool]:
    """Correlation time [s], and whether the process begins anew."""
    time = splits[0][0].time
    shortest = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    longest = max(float(time[-1] - time[0]), shortest)
    times = np.geomspace(_SHORTEST * shortest, _LONGEST * longest, _TIMES)
    evidence = [_evidence([_filtered(one, prior_sd, times) for one in split]) for split in splits]
    anew = bool(np.max(evidence[1]) > np.max(evidence[0]))
    return float(times[np.argmax(evidence[anew])]), anew


def _parts(readings: Readings, begins: tuple[int, ...]) -> list[Readings]:
    ends = [0, *begins, len(readings.time)]
    return [readings.take(slice(a, b)) for a, b in pairwise(ends) if b > a]


def _evidence(runs: list[_Filtered]) -> Array:
    """(G,) log, but for a constant, `e` integrated out."""
    squares, size = np.sum([one.squares for one in runs], axis=0), np.sum([one.size for one in runs], axis=0)
    told = np.eye(squares.shape[-1] - 1) + squares[:, 1:, 1:]
    aside = squares[:, 1:, 0]
    by_shared = np.einsum("gr,gr->g", aside, np.linalg.solve(told, aside[..., None])[..., 0])
    return np.asarray(0.5 * (by_shared - np.linalg.slogdet(told)[1] - squares[:, 0, 0] - size))


def _filtered(readings: Readings, prior_sd: float, times: Array) -> _Filtered:
    """For processes of correlation times `times` (G,) [s]."""
    rate, powers, still = np.sqrt(2.0 * _ORDER - 1.0) / times, *_matern(_ORDER)
    still = np.tile(prior_sd**2 * still, (len(times), 1, 1))
    columns = np.concatenate([readings.told[..., None], -readings.common], axis=-1)
    count = columns.shape[-1]
    mean, spread = np.zeros((len(times), 2 * _ORDER, count)), still
    kept: list[_Frame] = []
    squares, size, last = np.zeros((len(times), count, count)), np.zeros(len(times)), readings.time[0]
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
        squares = squares + np.swapaxes(away, 1, 2) @ surprise
        size = size + np.linalg.slogdet(whole)[1]
        kept.append(_Frame(mean, spread, h, surprise, np.asarray(inner), gain, step))
        mean = mean + across @ surprise
        left = np.eye(2 * _ORDER) - gain @ h  # of Joseph: it stays symmetric and positive
        spread = left @ spread @ np.swapaxes(left, 1, 2) + gain @ np.swapaxes(gain, 1, 2)
        last = time
    return _Filtered(kept, squares, size)


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


def _backward(filtered: _Filtered) -> tuple[Array, Array]:
    """(T, 2) N and (T, 2, 2) N^2, of the first process."""
    count, size = len(filtered.frames), 2 * _ORDER
    force, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    pull, told = np.zeros_like(filtered.frames[0].mean[0]), np.zeros((size, size))
    for t in range(count - 1, -1, -1):
        one = filtered.frames[t]
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
