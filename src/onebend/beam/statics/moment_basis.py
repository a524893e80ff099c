"""Many nodes and few unknowns: bending moments that are polynomials between the loads.

A k(s) with many knots or jumps needs many nodes. The moment under it does not: `M' = -L n . u'` depends on k through
the angle alone. So equilibrium is sought first in the curvatures `q0 + M / k` with M a polynomial between loads, on all
nodes (Ritz): n unknowns instead of Q. What that leaves is taken away on all nodes by the two-grid iteration

    dq = R T_n^-1 R^T g + (1 - R R^T S) S^-1 g,        S = diag(w k),

R the basis, orthonormal in S, and T_n = R^T T R its tangent: T - S is compact and acts on smooth parts of g alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import gradient, tangent
from onebend.beam.statics.newton import solve_batch
from onebend.beam.statics.nodal_beam import MomentBasis
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

_REMAINING = 1e-12  # rad: turn that the iteration may leave
_MOST = 12  # iterations


def in_basis(problem: Problem, basis: MomentBasis) -> Problem:
    """The same beam and loads, the unknowns the coefficients of the basis."""
    return replace(
        problem,
        to_nodes=basis.turned,
        q0=basis.rest,
        modes=basis.modes,
        follower_rows=problem.follower_rows @ basis.modes,
    )


def settle(problem: Problem, basis: MomentBasis, coefficients: Array) -> tuple[Array, BoolArray]:
    """(T, Q) equilibria near those found in the basis, coefficients (T, n); True where one was reached."""
    q = coefficients @ basis.modes.T
    stiff, before = problem.stiff, np.zeros(len(q))
    matrices = tangent(in_basis(problem, basis), coefficients)
    near = np.zeros(len(q), dtype=bool)
    todo, part = np.arange(len(q)), problem
    for _ in range(_MOST):
        off = gradient(part, q[todo], 1.0)
        within = off @ basis.modes
        update = off / stiff + (solve_batch(matrices[todo], within) - within) @ basis.modes.T
        q[todo] -= update
        size = np.max(np.abs(apply(part.to_nodes, update)), axis=-1)
        first = before[todo] == 0.0
        share = np.where(first, 1.0, size / np.where(first, 1.0, before[todo]))  # of the update before
        near[todo] = size * np.minimum(share, 1.0) < _REMAINING
        going = todo[~near[todo] & (first | (share < 0.5))]
        before[todo] = size
        if going.size == 0:
            break
        todo, part = going, part if going.size == todo.size else problem.take(going)
    return q, near
