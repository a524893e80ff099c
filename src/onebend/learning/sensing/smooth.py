"""The force as a process over the frames of a contact: what neighbouring frames say of it counts too.

Each component is a Matern process of order 5/2 (twice differentiable), mean zero, with the sd of the force's prior; how
fast it changes is chosen by the evidence, and it begins anew with each contact. Kalman filter and the backward
recursion of Bryson and Frazier; the state is the force and its derivatives, each over a power of the rate.

A frame weighs as much as its whole region says, so that many frames which are all wrong alike do not make sure what
none of them knows. What is left unknown of all that they share goes through the smoother as it is, and is added: no
number of frames averages it down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from onebend.learning.sensing.estimate import Estimates
from onebend.learning.sensing.frame_forces import FrameForces, estimated
from onebend.records import Array

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


@dataclass(frozen=True)
class _Filtered:
    """And of all T frames."""

    frames: list[_Frame]
    evidence: Array  # (G,) log but for a constant, all that the frames share being known


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
        mean, spread = _backward(_filtered(one, prior_sd, np.array([memory])))
        force[a : b + 1][known], covariance[a : b + 1][known] = mean[known], spread[known]
    return Smoothed(force, covariance, memory, widened)


def _memory(readings: list[FrameForces], prior_sd: float) -> float:
    """s, the correlation time of greatest evidence."""
    every = [one.time for one in readings]
    shortest = float(np.median(np.concatenate([np.diff(time) for time in every])))
    times = np.geomspace(_SHORTEST * shortest, _LONGEST * max(float(t[-1] - t[0]) for t in every), _TIMES)
    evidence = np.sum([_filtered(one, prior_sd, times).evidence for one in readings], axis=0)
    return float(times[np.argmax(evidence)])


def _filtered(readings: FrameForces, prior_sd: float, times: Array) -> _Filtered:
    """For processes of correlation times `times` (G,) [s]."""
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
    return _Filtered(kept, evidence)


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
