"""A beam held at both ends, near the shape in which it was seen: no search among equilibria, the picture tells which.

Newton's method from that shape; where it strays, the beam is let down the energy from there, its end in place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.ends import end_jacobian, let_down, newton, stands
from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.problem import Problem
from onebend.beam.statics import Equilibrium, gradient
from onebend.records import Array

_TRUST = 0.7  # rad, the largest turn from the known shape that is still the same equilibrium
_STEPS = 25


def hold_near(problem: Problem, start: Array, end: Array, *, fall: bool) -> tuple[Equilibrium, Array]:
    """Equilibria near shapes `start` (T, Q) with the end s = 1 at `end` (T, 3) m, m, rad, and the wrench there (T, 3).

    The equilibria are those of the problem under that wrench as a dead load (`under`), so that their derivatives are
    those of any others. With `fall` a start may be far off balance; without it such a frame has not converged.
    """
    wrench = balancing(problem, start)
    q, w, near = newton(problem, start, wrench, end, trust=_TRUST, most=_STEPS)
    near[near] &= stands(problem.take(near), q[near], w[near])
    for i in np.flatnonzero(~near).tolist():
        q[i], w[i] = start[i], wrench[i]
        down = let_down(problem.take(np.array([i])), start[i : i + 1], end[i : i + 1]) if fall else None
        if down is not None:
            q[i], w[i], near[i] = down[0][0], down[1][0], True
    none = np.full(len(q), np.nan)
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(under(problem, w), q, near, near.copy(), factor, none, np.zeros(len(q), dtype=bool), 0), w


def under(problem: Problem, wrench: Array) -> Problem:
    """With a force and a moment (T, 3) N, N, N m more at the end."""
    return replace(
        problem,
        dead_force=problem.dead_force + wrench[:, None, :2],
        moment=problem.moment + wrench[:, 2:],
    )


def balancing(problem: Problem, q: Array) -> Array:
    """(T, 3) the wrench at the end that brings shapes (T, Q) nearest to balance, in the norm of the bending energy."""
    scale = 1.0 / np.sqrt(np.broadcast_to(problem.weights * problem.k, q.shape))
    c = end_jacobian(problem, q) * scale[:, None, :]
    return solve_each(c @ transposed(c), apply(c, gradient(problem, q) * scale)[..., None])[..., 0]
