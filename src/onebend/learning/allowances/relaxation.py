"""The material relaxes: a generalised Maxwell solid at every place.

`M = k_i (q - sum a_j v_j)` with `tau_j v_j' = q - v_j`. k_i is the instantaneous stiffness; step and hold, and the
force falls as `1 - sum a_j (1 - exp(-t / tau_j))`. The times tau_j are fixed and each has its own share a_j: shares
enter almost linearly, where a time that is free bends the valley of what the data leave open, and a material whose time
lies between two of these is met by shares of both. A static model that is learned from a push finds the secant modulus
`k = k_i (1 - c)`: c is the mean part of the curvature that `v = sum a_j v_j` has reached, weighted by its square. The
fit's k(s) is that: it says how the beam answers a push like this one.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse
from onebend.records import Array

TIMES = np.array([1.0, 3.0, 9.0])  # s, tau_j
SHARE_SD = 0.05  # of each a_j: shares of the stiffness that relax
LARGEST = 0.9  # of c: beyond, nothing would be left of the stiffness


def relaxation(run: PushCourse) -> Allowance:
    """The shares that relax with each of the times."""
    labels = tuple(f"share that relaxes within {t:g} s" for t in TIMES)
    return Allowance("relaxation", "relaxation", "1", labels, np.full(len(TIMES), SHARE_SD), run.time, shared=True)


def lags(time: Array) -> Array:
    """(n, T, T): each turns values that are straight in `time` (T,) [s] between frames, from rest at the first frame,
    into those that lag behind them with one of the times; made once for each `time`, and read only."""
    return _lags(np.asarray(time, dtype=float).tobytes())


@lru_cache(maxsize=4)
def _lags(instants: bytes) -> Array:
    time = np.frombuffer(instants)
    kept, before, now = lag_weights(np.diff(time))
    out = np.zeros((len(TIMES), len(time), len(time)))
    for i in range(len(time) - 1):
        out[:, i + 1] = kept[:, i, None] * out[:, i]
        out[:, i + 1, i] += before[:, i]
        out[:, i + 1, i + 1] += now[:, i]
    out.flags.writeable = False
    return out


def lag_weights(seconds: Array) -> tuple[Array, Array, Array]:
    """(n, N) each, of steps of `seconds` (N,): at the end of a step v_j is made of v_j before it, of q before it, and
    of q at its end."""
    step = np.maximum(seconds / TIMES[:, None], np.finfo(float).tiny)  # frames of one instant are one
    decay = np.exp(-step)
    mean = -np.expm1(-step) / step
    return decay, mean - decay, 1.0 - mean


def memory(shares: Array, time: Array) -> Array:
    """(T, T): v of curvatures q (T, Q) is `memory @ q`."""
    return np.tensordot(shares, lags(time), 1)


def rest_shift(remembering: Array, q: Array, weights: Array) -> Array:
    """(F, Q) rad by which relaxation shifts the curvature at rest, the stiffness being the secant one.

    `remembering` (T, T) is the `memory` of the first T frames; `q` (F, Q) the curvature over the one at rest, F - T
    frames at rest behind. From `k_i (q - v) = k (q - (v - c q) / (1 - c))`.
    """
    count, out = len(remembering), np.zeros_like(q)
    v = remembering @ q[:count]
    reached = reached_part(v, q[:count], weights)
    out[:count] = (v - reached * q[:count]) / (1.0 - min(reached, LARGEST))
    return out


def reached_part(v: Array, q: Array, weights: Array) -> float:
    """c: the part of the curvature q (T, Q) that v (T, Q) has reached, over all of the push."""
    square = float(np.sum(weights * q**2))
    return float(np.sum(weights * q * v)) / square if square > 0.0 else 0.0


def secant_share(remembering: Array, q: Array, weights: Array) -> float:
    """`1 - c`: the secant stiffness over the instantaneous one."""
    count = len(remembering)
    return 1.0 - reached_part(remembering @ q[:count], q[:count], weights)


def remembered(remembering: Array, q: Array, weights: Array, change: Array) -> Array:
    """(F, Q, P) by which the curvature at rest shifts with changes (F, Q, P) of the curvature, to first order."""
    count, p = len(remembering), change.shape[-1]
    bent, moved = q[:count], change[:count].reshape(count, -1)
    v, square = remembering @ bent, float(np.sum(weights * bent**2))
    reached = reached_part(v, bent, weights)
    left = 1.0 - min(reached, LARGEST)
    by_shape = weights * (v - 2.0 * reached * bent) + remembering.T @ (weights * bent)
    reached_moved = by_shape.ravel() @ moved.reshape(-1, p) / max(square, np.finfo(float).tiny)  # (P,)
    by_reached = (v - reached * bent) / left**2 - bent / left
    out = ((remembering - reached * np.eye(count)) / left @ moved).reshape(*bent.shape, p)
    out += by_reached[..., None] * reached_moved
    return np.concatenate([out, np.zeros((len(q) - count, *out.shape[1:]))]) if len(q) > count else out


def shift_derivatives(shares: Array, time: Array, q: Array, weights: Array) -> Array:
    """(F, Q, n) of `rest_shift` with the shares, q staying as it is."""
    every = lags(time) @ q[: len(time)]  # (n, T, Q)
    bent, out = q[: len(time)], np.zeros((*q.shape, len(shares)))
    reached = np.array([reached_part(one, bent, weights) for one in every])
    _, out[: len(time)] = shift_of_lags(shares, np.moveaxis(every, 0, -1), bent, reached)
    return out


def shift_of_lags(shares: Array, every: Array, q: Array, reached: Array) -> tuple[Array, Array]:
    """(F, Q) and (F, Q, n): what `rest_shift` returns, and its derivatives with the shares (n,).

    `every` (F, Q, n) the curvatures v_j that lag behind q (F, Q), `reached` (n,) the part of q that each has reached.
    """
    all_reached = min(float(shares @ reached), LARGEST)
    away = every @ shares - all_reached * q
    direct = (every - q[..., None] * reached) / (1.0 - all_reached)
    by_shares = direct + away[..., None] * (reached / (1.0 - all_reached) ** 2)
    return away / (1.0 - all_reached), by_shares
