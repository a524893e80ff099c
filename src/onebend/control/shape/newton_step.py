"""One Newton step on the surface of equilibria, within the bounds on forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.statics.nodal_forces import nodal_forces
from onebend.control.goals.targets import TargetResiduals
from onebend.control.shape.actuators import Actuators, BeamState, LoadBound
from onebend.records import Array

_MOST_DUAL_ITERATIONS = 60  # iterations for the multipliers
_BOUND_TOLERANCE = 1e-12  # share of a bound to which it is kept
_FLAT_CURVATURE = 1e-11  # share of the largest curvature of the cost below which it counts as flat


@dataclass(frozen=True)
class QuadraticModel:
    """The cost near an equilibrium, in coordinates z of its tangent plane: `slope . z + z H z / 2`."""

    slope: Array  # (m,)
    hessian: Array  # (m, m), exact: with the curvature of the surface itself


def model_of(state: BeamState, residuals: TargetResiduals) -> QuadraticModel:
    """The cost half the sum of squares, to second order along the surface.

    With the multipliers l of equilibrium, `T l = -r_q^T r` (and with a grip `A l = 0`, both as nearly as can be), the
    Hessian of `|r|^2 / 2 + l . g` is taken on the tangent plane.
    """
    dq, du = state.plane
    b, solved = state.actuators.problem.to_nodes, state.solved
    turned = b @ multipliers(state, residuals)
    across = nodal_forces(solved.problem, solved.q).across
    flow, seen = b @ dq, residuals.jacobian[0] @ dq  # (Q, m) turn of the nodes
    bent = flow.T @ ((residuals.curvature_term[0] + across[0] * turned)[:, None] * flow)
    coupled = du.T @ control_coupling(state.actuators, solved.alpha, turned[None])[0] @ flow
    return QuadraticModel(seen.T @ residuals.value[0], seen.T @ seen + bent + coupled + coupled.T)


def multipliers(state: BeamState, residuals: TargetResiduals) -> Array:
    """(Q,) l of `model_of`, 1/(N m)."""
    rows, right = state.tangent, -(residuals.value[0] @ residuals.jacobian[0]) * state.unbend
    if state.actuators.grip is not None:
        unit = state.actuators.scale / np.sqrt(state.actuators.mean_stiffness)
        rows = np.concatenate([rows, -state.actions * unit[:, None]])
        right = np.append(right, np.zeros(state.actuators.count))
    return np.asarray(state.unbend * np.linalg.lstsq(rows, right, rcond=None)[0])


def control_coupling(actuators: Actuators, alpha: Array, turned: Array) -> Array:
    """(T, m, Q) derivative of `-u . A l` with the controls and the nodes' angles; `turned` (T, Q) is B l."""
    problem, forces = actuators.problem, actuators.count - (0 if actuators.grip is None else 1)
    out = problem.length * problem.weights * actuators.beyond * turned[:, None]
    out[:, 0:forces:2] *= np.cos(alpha)[:, None]
    out[:, 1:forces:2] *= np.sin(alpha)[:, None]
    out[:, forces:] = 0.0
    return np.asarray(out)


def convex(hessian: Array, damping: float) -> Array:
    """The Hessian with its negative curvatures turned positive, and `damping` added: steps lead away from saddles."""
    values, vectors = np.linalg.eigh(hessian)
    size = np.maximum(np.abs(values), _FLAT_CURVATURE * np.max(np.abs(values)) + 1e-300) + damping
    return np.asarray((vectors * size) @ vectors.T)


def bounded_step(
    slope: Array, hessian: Array, u: Array, du: Array, bounds: tuple[LoadBound, ...]
) -> tuple[Array, Array]:
    """(m,) minimum of `slope . z + z H z / 2` with every bounded part of `u + du z` within its bound; (n,) multipliers.

    Newton's method on the multipliers of the bounds that bind, in the form in which it hardly overshoots: the
    reciprocal size of a bounded part is nearly linear in its multiplier.
    """
    prices = np.zeros(len(bounds))
    parts = [(u[bound.columns], du[bound.columns], bound.most) for bound in bounds]
    for _ in range(_MOST_DUAL_ITERATIONS):
        h, g = hessian.copy(), slope.copy()
        for value, (at, along, _) in zip(prices, parts, strict=True):
            h += value * along.T @ along
            g += value * along.T @ at
        z = np.asarray(-np.linalg.solve(h, g), dtype=float)
        ends = [at + along @ z for at, along, _ in parts]
        sizes = np.maximum([float(np.linalg.norm(y)) for y in ends], 1e-300)
        room = np.array([bound.most for bound in bounds]) / sizes - 1.0
        binding = (room < 0.0) | (prices > 0.0)
        if np.all(np.abs(room[binding]) < _BOUND_TOLERANCE):
            break
        pulls_back = np.array([along.T @ y for y, (_, along, _) in zip(ends, parts, strict=True)])[binding]
        steep = ((1.0 + room) / sizes**2)[binding]
        jacobian = steep[:, None] * (pulls_back @ np.linalg.solve(h, pulls_back.T))
        change = np.linalg.lstsq(jacobian, -room[binding], rcond=1e-14)[0]
        prices[binding] = np.maximum(prices[binding] + change, 0.0)
    return np.asarray(z * _share(z, parts)), prices


def _share(z: Array, parts: list[tuple[Array, Array, float]]) -> float:
    """The share of a step that stays within all bounds to rounding, where the multipliers did not settle."""
    share = 1.0
    for _ in range(60):
        if all(
            np.linalg.norm(at + share * along @ z) <= (1.0 + 2.0 * _BOUND_TOLERANCE) * most for at, along, most in parts
        ):
            break
        share *= 0.9
    return share
