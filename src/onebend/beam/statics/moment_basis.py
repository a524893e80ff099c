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

from onebend.beam.grid import apply, transposed
from onebend.beam.statics.equilibrium import Equilibrium, gradient, tangent
from onebend.beam.statics.newton import solve_batch
from onebend.beam.statics.nodal_beam import MomentBasis
from onebend.beam.statics.nodal_forces import nodal_forces
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

_REMAINING = 1e-12  # rad: turn that the iteration may leave
_NEARBY = 1e-2  # rad, the farthest turn from where it begins
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


def on_grid(solved: Equilibrium, problem: Problem, basis: MomentBasis) -> Array:
    """(T, n) coefficients in the basis, of shapes of the same beam on another grid."""
    q = solved.q if solved.problem.modes is None else solved.q @ solved.problem.modes.T
    rows = transposed(solved.problem.grid.value_at(problem.grid.nodes))
    return np.asarray(q @ (rows @ (problem.stiff[:, None] * basis.modes)))


def settle(problem: Problem, basis: MomentBasis, coefficients: Array) -> tuple[Array, BoolArray]:
    """(T, Q) equilibria near those found in the basis, coefficients (T, n); True where one was reached nearby."""
    begin = coefficients @ basis.modes.T
    q = begin.copy()
    forces, before = nodal_forces(problem, q), np.zeros(len(q))
    off, matrices = gradient(problem, q, 1.0, forces), tangent(in_basis(problem, basis), coefficients, 1.0, forces)
    near = np.zeros(len(q), dtype=bool)
    todo, part, here = np.arange(len(q)), problem, q
    for _ in range(_MOST):
        within = off @ basis.modes
        update = off / problem.stiff + (solve_batch(matrices, within) - within) @ basis.modes.T
        here = here - update
        size = np.max(np.abs(apply(part.to_nodes, update)), axis=-1)
        share = np.divide(size, before, out=np.ones_like(size), where=before > 0.0)  # of the update before
        done = size * np.minimum(share, 1.0) < _REMAINING
        q[todo], near[todo] = here, done
        going = np.flatnonzero(~done & ((before == 0.0) | (share < 0.5)))
        if going.size == 0:
            break
        before = size
        if going.size < todo.size:
            todo, part = todo[going], part.take(going)
            here, matrices, before = here[going], matrices[going], before[going]
        off = gradient(part, here)
    return q, near & (np.max(np.abs(apply(problem.to_nodes, q - begin)), axis=-1) < _NEARBY)
