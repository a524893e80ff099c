"""The material relaxes: a standard linear solid at every place, `M = k_i (q - a q_v)`, `tau q_v' = q - q_v`.

k_i is the instantaneous stiffness; step and hold, and the force falls as `1 - a (1 - exp(-t / tau))`. A static model
that is learned from a push finds the secant modulus `k = k_i (1 - a c)`, where c is the mean share of the curvature
that q_v has reached, weighted by its square. The fit's k(s) is that: it says how the beam answers a push like this
one.
"""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse
from onebend.records import Array

SHARE_SD = 0.06  # a, share of the stiffness that relaxes
USUAL_TIME, TIME_SD = 3.0, 1.0  # s, tau, and one sd of its log
_STEP = 1e-3  # of log tau, for its derivative
_FARTHEST = 10.0  # of log tau over the usual: beyond, all or nothing has relaxed
_LARGEST = 0.9  # of a c: beyond, nothing would be left of the stiffness


def relaxation(run: PushCourse) -> Allowance:
    """The share a that relaxes, and the log of its time over the usual one."""
    labels, sd = ("relaxing share", "log of relaxation time"), np.array([SHARE_SD, TIME_SD])
    return Allowance("relaxation", "relaxation", "1", labels, sd, run.time, shared=True)


def lagged(time: Array, q: Array, tau: float) -> Array:
    """(T, Q) q_v of curvatures q (T, Q) that are straight in `time` (T,) [s] between frames, from rest at the first."""
    kept, before, now = lag_weights(np.diff(time), tau)[0]
    out = np.zeros_like(q)
    for i in range(len(kept)):
        out[i + 1] = kept[i] * out[i] + before[i] * q[i] + now[i] * q[i + 1]
    return out


def lag_weights(seconds: Array, tau: float) -> tuple[Array, Array]:
    """(3, N) weights of one step of `seconds` (N,), and their derivatives with log tau: q_v at its end is made of q_v
    before it, of q before it and of q at its end."""
    step = np.maximum(seconds / tau, np.finfo(float).tiny)  # frames of one instant are one
    decay = np.exp(-step)
    mean = -np.expm1(-step) / step
    by_decay, by_mean = step * decay, mean - decay
    return np.stack([decay, mean - decay, 1.0 - mean]), np.stack([by_decay, by_mean - by_decay, -by_mean])


def relaxation_time_of(values: Array) -> float:
    """tau [s]."""
    return USUAL_TIME * float(np.exp(np.clip(values[1], -_FARTHEST, _FARTHEST)))


def rest_shift(values: Array, time: Array, q: Array, weights: Array) -> Array:
    """(F, Q) rad by which relaxation shifts the curvature at rest, the stiffness being the secant one.

    `values` (2,) the allowance's; `q` (F, Q) the curvature over the one at rest, F - T frames at rest after those of
    `time` (T,). From `k_i (q - a q_v) = k (q - a (q_v - c q) / (1 - a c))`.
    """
    share, tau = float(values[0]), relaxation_time_of(values)
    count, out = len(time), np.zeros_like(q)
    lag = lagged(time, q[:count], tau)
    reached = reached_share(lag, q[:count], weights)
    out[:count] = (lag - reached * q[:count]) * shift_factor(share, reached)
    return out


def shift_factor(share: float, reached: float) -> float:
    """`a / (1 - a c)`: of the shift over `q_v - c q`."""
    return share / (1.0 - min(share * reached, _LARGEST))


def reached_share(lag: Array, q: Array, weights: Array) -> float:
    """c: the share of the curvature q (T, Q) that q_v (T, Q) has reached, over all of the push."""
    square = float(np.sum(weights * q**2))
    return float(np.sum(weights * q * lag)) / square if square > 0.0 else 0.0


def secant_share(values: Array, time: Array, q: Array, weights: Array) -> float:
    """`1 - a c`: the secant stiffness over the instantaneous one."""
    lag = lagged(time, q[: len(time)], relaxation_time_of(values))
    return 1.0 - float(values[0]) * reached_share(lag, q[: len(time)], weights)


def remembered(values: Array, time: Array, q: Array, weights: Array, change: Array) -> Array:
    """(F, Q, P) by which the curvature at rest shifts with changes (F, Q, P) of the curvature, to first order."""
    share, tau = float(values[0]), relaxation_time_of(values)
    count, p = len(time), change.shape[-1]
    lag = lagged(time, q[:count], tau)
    moved = change[:count]
    lag_moved = lagged(time, moved.reshape(count, -1), tau).reshape(moved.shape)
    reached, square = reached_share(lag, q[:count], weights), float(np.sum(weights * q[:count] ** 2))
    weighted = np.broadcast_to(weights, lag.shape)[..., None] * np.stack(
        [lag - 2.0 * reached * q[:count], q[:count]], -1
    )
    by_shape = np.einsum("tq,tqp->p", weighted[..., 0], moved) + np.einsum("tq,tqp->p", weighted[..., 1], lag_moved)
    reached_moved = by_shape / max(square, np.finfo(float).tiny)  # (P,)
    rest = 1.0 - min(share * reached, _LARGEST)
    out = np.zeros((len(q), q.shape[1], p))
    direct = lag_moved - reached * moved - q[:count, :, None] * reached_moved
    out[:count] = direct * (share / rest)
    out[:count] += (lag - reached * q[:count])[..., None] * (reached_moved * (share / rest) ** 2)
    return out


def shift_derivatives(values: Array, time: Array, q: Array, weights: Array) -> Array:
    """(F, Q, 2) of `rest_shift` with the allowance's parameters, q staying as it is."""
    steps = _STEP * np.eye(2)
    pairs = [(rest_shift(values + h, time, q, weights), rest_shift(values - h, time, q, weights)) for h in steps]
    return np.stack([(up - down) / (2.0 * _STEP) for up, down in pairs], axis=-1)
