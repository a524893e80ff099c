"""A beam held at both ends, near the shape in which it was seen: no search among equilibria, the picture tells which.

Newton's method from that shape; where it strays, the shape is taken as free of stress and led over to the true rest and
loads, its end in place.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.clamped_ends.end_pose import (
    end_jacobian,
    let_down,
    newton,
    restore,
    stands,
    with_end_wrench,
)
from onebend.beam.clamped_ends.homotopy import let_strain, release, rigid
from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.statics.equilibrium import Equilibrium, gradient
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

_TRUST = 0.7  # rad, the largest turn from the known shape that is still the same equilibrium
_MAX_ITERATIONS = 25


def hold_near(problem: Problem, start: Array, end: Array, *, fall: bool) -> tuple[Equilibrium, Array]:
    """Equilibria near shapes `start` (T, Q) with the end s = 1 at `end` (T, 3) m, m, rad, and the wrench there (T, 3).

    The equilibria are those of the problem under that wrench as a dead load (`under`), so that their derivatives are
    those of any others. With `fall` a start may be far off balance; without it such a frame has not converged.
    """
    wrench = balancing_wrench(rigid(problem), start)
    q, w, near = newton(problem, start, wrench, end, trust=_TRUST, max_iterations=_MAX_ITERATIONS)
    near[near] &= stands(problem.take(near), q[near], w[near])
    lost = np.flatnonzero(~near)
    q[lost], w[lost] = start[lost], wrench[lost]
    if fall and lost.size:
        q[lost], w[lost], near[lost] = _let_go(problem.take(lost), start[lost], end[lost])
    none = np.full(len(q), np.nan)
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(
        with_end_wrench(problem, w), q, near, near.copy(), factor, none, np.zeros(len(q), dtype=bool), 0
    ), w


def _let_go(problem: Problem, start: Array, end: Array) -> tuple[Array, Array, BoolArray]:
    """From shapes (T, Q) as if free of stress to the true rest and loads, or down the energy; strains last."""
    plain = rigid(problem)
    begin, there = restore(plain, start, end)
    q, w, share = release(plain, begin, end)
    well = there & (share == 1.0)
    for i in np.flatnonzero(there & ~well).tolist():
        down = let_down(plain.take(np.array([i])), q[i : i + 1], end[i : i + 1])
        if down is not None:
            q[i], w[i], well[i] = down[0][0], down[1][0], True
    q, w, strained = let_strain(problem, q, w, end)
    return q, w, np.asarray(well & strained)


def balancing_wrench(problem: Problem, q: Array) -> Array:
    """(T, 3) the wrench at the end that brings shapes (T, Q) nearest to balance, in the norm of the bending energy."""
    scale = 1.0 / np.sqrt(np.broadcast_to(problem.weights * problem.k, q.shape))
    c = end_jacobian(problem, q) * scale[:, None, :]
    return solve_each(c @ transposed(c), apply(c, gradient(problem, q) * scale)[..., None])[..., 0]
