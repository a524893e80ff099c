"""Many shapes along a path at once: Newton's method on the conditions of the optimum, from shapes close by.

With the multipliers l of equilibrium the conditions of the closest shape are `r_q^T r + T l = 0`, `A l = 0` and
`g = 0`; Newton's matrix holds the exact second derivatives, and is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.clamped_ends.end_pose import stands
from onebend.beam.grid import transposed
from onebend.beam.statics.equilibrium import balance, is_stable, scaled
from onebend.beam.statics.newton import solve_batch
from onebend.beam.statics.nodal_forces import nodal_forces
from onebend.control.goals.targets import Targets, target_residuals_along
from onebend.control.shape.actuators import Actuators, actions
from onebend.control.shape.newton_step import control_coupling
from onebend.records import Array, BoolArray

_LAST_STEP = 1e-10  # rad, of the last step
_MOST_ITERATIONS = 6  # Newton iterations
_LARGEST_TURN = 0.05  # rad, from the shape to start from
_BATCH = 128  # frames solved together: what stays in the cache


@dataclass(frozen=True)
class PathSamples:
    """T equilibria under the same actuators, and their multipliers."""

    q: Array  # (T, Q) rad
    u: Array  # (T, m) N, N m
    multipliers: Array  # (T, Q)

    def take(self, chosen: slice | BoolArray) -> PathSamples:
        """Some of them."""
        return PathSamples(self.q[chosen], self.u[chosen], self.multipliers[chosen])


def settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    """The closest stable shapes to targets xy (T, N, 2), angle (T, N), from ones `near`; True where found there.

    Bounds on forces are not looked at.
    """
    out = PathSamples(near.q.copy(), near.u.copy(), near.multipliers.copy())
    converged = np.zeros(len(near.q), dtype=bool)
    for i in range(0, len(converged), _BATCH):
        part = slice(i, i + _BATCH)
        here, ok = _settle(actuators, near.take(part), targets, xy[part], angle[part], arm)
        out.q[part], out.u[part], out.multipliers[part], converged[part] = here.q, here.u, here.multipliers, ok
    return out, converged


def _settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    q, u, prices = near.q.copy(), near.u.copy(), near.multipliers.copy()
    settled, b = np.zeros(len(q), dtype=bool), actuators.problem.to_nodes
    for _ in range(_MOST_ITERATIONS):
        todo = np.flatnonzero(~settled)
        if todo.size == 0:
            break
        dq, du, new = _step(actuators, PathSamples(q[todo], u[todo], prices[todo]), targets, xy[todo], angle[todo], arm)
        q[todo], u[todo], prices[todo] = q[todo] + dq, u[todo] + du, new
        settled[todo] = np.max(np.abs(dq @ b.T), axis=1) < _LAST_STEP
    settled &= np.max(np.abs((q - near.q) @ b.T), axis=1) < _LARGEST_TURN
    settled[settled] &= stable(actuators, q[settled], u[settled])
    return PathSamples(q, u, prices), settled


def stable(actuators: Actuators, q: Array, u: Array) -> BoolArray:
    """(T,) whether the shapes stand: pushes are dead loads, a gripped end stays where it is."""
    if len(q) == 0:
        return np.zeros(0, dtype=bool)
    if actuators.grip is None:
        return is_stable(actuators.loaded(u), q)
    bare = u.copy()
    bare[:, -3:] = 0.0
    return stands(actuators.loaded(bare), q, u[:, -3:])


def _step(
    actuators: Actuators, samples: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[Array, Array, Array]:
    """Newton's step of q and u, and the new multipliers; curvature and controls in units that make numbers about 1."""
    solved, b = actuators.solved(samples.q, samples.u), actuators.problem.to_nodes
    problem, count, controls = solved.problem, samples.q.shape[1], actuators.count
    residuals = target_residuals_along(solved, targets, xy, angle, arm)
    out, matrix = balance(problem, samples.q)
    stiff, root = scaled(problem, matrix), np.sqrt(actuators.mean_stiffness)
    unbend, unit = 1.0 / np.sqrt(problem.weights * problem.k), actuators.scale / root
    turned = samples.multipliers @ b.T
    bent = residuals.curvature_term + nodal_forces(problem, samples.q).across * turned
    rows = residuals.jacobian * unbend
    second = transposed(rows) @ rows + scaled(problem, transposed(b) @ (bent[..., None] * b))
    coupled = unit[:, None] * (control_coupling(actuators, solved.alpha, turned) @ b) * unbend
    acting = unit[:, None] * actions(actuators, solved) * unbend
    a, z = count + controls, np.s_[:]
    system = np.zeros((len(samples.q), a + count, a + count))
    system[z, :count, :count], system[z, :count, count:a], system[z, count:a, :count] = (
        second,
        transposed(coupled),
        coupled,
    )
    system[z, :count, a:], system[z, a:, :count] = stiff, stiff
    system[z, count:a, a:], system[z, a:, count:a] = -acting, -transposed(acting)
    right = np.zeros((len(samples.q), a + count))
    right[:, :count] = -np.einsum("trq,tr->tq", rows, residuals.value) / root
    right[:, a:] = -out * unbend / root
    answer = solve_batch(system, right)
    return root * unbend * answer[:, :count], actuators.scale * answer[:, count:a], root * unbend * answer[:, a:]
