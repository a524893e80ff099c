"""Newton's method on shape and load together: the load at one place that puts a point on a goal, (23) made exact.

Unknown are the curvature q at the nodes and the load p at s_a: the balance `g(q, p) = 0` of
`beam/statics/equilibrium.py` and the goal `r(s_p; q) = goal`. With `X = T^-1 g` and `Y = T^-1 R` (T the tangent, R =
-dg/dp) one step is

    dq = Y dp - X,      S dp = goal - r(s_p) + J X,      S = J Y,

J = dr(s_p)/dq. S is the Jacobian J_F of (25) with the exact tangent in place of K.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgesv

from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.records import Array

TOLERANCE = 3e-7  # rad, of the last update: convergence is quadratic, the error its square
_REMAINING = 1e-8  # rad, of the error that may remain
_FINAL_UPDATE = 1e-2  # rad: the remaining error is predicted from last updates up to this one
_MINUS_ONE = np.array([-1.0])
_LARGEST_TURN = 0.7  # rad, the largest turn of a step


@dataclass(frozen=True, slots=True)
class NewtonResult:
    """Where Newton's method ended, with the derivatives before its last step."""

    state: LoadedState
    iterations: int
    converged: bool
    positive: bool = False  # the tangent was positive definite
    curvature_per_load: Array | None = None  # (n, P) rad a unit load: Y
    compliance: Array | None = None  # (2 or 3, P): S


def solve_goal(
    pushed: PushedBeam, start: LoadedState, goal: Array, loads: int = 2, *, most: int = 20, trust: float = math.inf
) -> NewtonResult:
    """Newton from `start` to the goal (2,) or (3,) with the first 2 or all 3 `loads`.

    It stops unconverged where the beam turns by more than `trust` rad. After successive updates u and v the remaining
    error is `v (v / u)^2`. With more loads than the goal has numbers, the smallest load (in units of
    `PushedBeam.scale`) is found.
    """
    q, load, size = start.q, start.load.copy(), len(goal)
    alpha = pushed.angles(q)
    begin, before = alpha, 0.0
    for iteration in range(1, most + 1):
        cos, sin = np.cos(alpha), np.sin(alpha)
        solved, positive = pushed.linear(q, load, cos, sin, loads)
        turned = pushed.b @ solved
        moved = pushed.point_motion(cos, sin, turned, solved, size)  # (m, 1 + P): J X, J Y
        away = goal - pushed.place(cos, sin, q, size)
        change = _change(moved[:, 1:], away + moved[:, 0], load, pushed.scale)
        by = np.concatenate([_MINUS_ONE, change])
        turn = turned @ by
        largest = max(float(turn.max()), -float(turn.min()))
        if not math.isfinite(largest):
            return NewtonResult(LoadedState(q, load), iteration, False)
        if largest > _LARGEST_TURN:
            shorter = _LARGEST_TURN / largest
            by, turn, change = by * shorter, turn * shorter, change * shorter
        q, alpha = q + solved @ by, alpha + turn
        load[:loads] += change
        if trust < math.inf and not float(np.abs(alpha - begin).max()) < trust:
            return NewtonResult(LoadedState(q, load), iteration, False)
        if largest < TOLERANCE or (iteration > 1 and largest**3 < _REMAINING * before**2 and largest < _FINAL_UPDATE):
            return NewtonResult(LoadedState(q, load), iteration, True, positive, solved[:, 1:], moved[:, 1:])
        before = min(largest, _LARGEST_TURN)
    return NewtonResult(LoadedState(q, load), most, False)


def _change(s: Array, wanted: Array, load: Array, scale: Array) -> Array:
    """(P,) the change of the loads: S dp = wanted, and of many the one that makes the load smallest; NaN for none."""
    if s.shape == (2, 2):
        (a, b), (c, d) = s.tolist()
        x, y = wanted.tolist()
        det = a * d - b * c
        return np.array([(d * x - b * y) / det, (a * y - c * x) / det]) if det != 0.0 else np.full(2, np.nan)
    if s.shape == (3, 3):
        _, _, out, info = dgesv(s, wanted)
        return np.asarray(out) if info == 0 else np.full(3, np.nan)
    if not np.all(np.isfinite(s)):
        return np.full(3, np.nan)
    now = load / scale
    return np.asarray(scale * (np.linalg.pinv(s * scale) @ (wanted + s @ load) - now))
