"""Equilibrium of a clamped beam under dead loads, exact: nodal Gauss collocation and guarded Newton (5)-(11).

The potential is `V(q) = int k/2 (q - q0)^2 - L int N . (cos alpha, sin alpha) - int m q`, where `N(s)` is the sum of
all forces beyond s (dead loads: known beforehand) and `m(s)` the sum of all point moments beyond s. With the integrals
done by Gauss's rule on panels that end at every load and at every jump of k, the gradient and the tangent are

    g = w (k (q - q0) - m) - B^T (w L N . u'),        T = diag(w k) + B^T diag(w L N . u) B,

B the integration matrix, u = (cos alpha, sin alpha), u' = (-sin alpha, cos alpha). The stiffness enters at the nodes:
no mode shapes, no quadrature of k against them.

`continuation.py` finds the branch of g = 0 that grows from the rest shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.beam.loads import Loads
from onebend.beam.stiffness import Profile
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray


class Rod(Protocol):
    """What mechanics needs to know of a beam; `model.Beam` is one."""

    @property
    def length(self) -> float: ...
    @property
    def stiffness(self) -> Profile: ...
    @property
    def rest_curvature(self) -> Profile: ...
    @property
    def clamp_angle(self) -> float: ...
    @property
    def mass_per_length(self) -> Profile: ...


@dataclass(frozen=True)
class Resolution:
    """How finely a beam is resolved: `order` Gauss nodes a panel, no panel wider than `widest`."""

    order: int = 16
    widest: float = 1.0

    def finer(self) -> Resolution:
        """Panels half as wide."""
        return replace(self, widest=0.5 * self.widest)


@dataclass(frozen=True)
class Problem:
    """Arrays of one batch of equilibria: T frames, Q nodes."""

    length: float
    grid: Grid
    weights: Array  # (Q,) or (T, Q)
    to_nodes: Array  # (Q, Q) or (T, Q, Q): B
    k: Array  # (Q,) or (T, Q) N m
    q0: Array  # (Q,) or (T, Q) rad
    alpha0: Array  # () or (T, 1) rad
    internal_force: Array  # (T, Q, 2) N: all dead forces beyond the node
    internal_moment: Array  # (T, Q) N m: all point moments beyond the node

    @property
    def size(self) -> int:
        return int(self.internal_force.shape[0])

    def take(self, chosen: IntArray | BoolArray) -> Problem:
        """Some frames of the batch."""

        def pick(x: Array, plain: int) -> Array:
            return x[chosen] if x.ndim > plain else x

        return replace(
            self,
            grid=self.grid if self.grid.edges.ndim == 1 else Grid(self.grid.edges[chosen], self.grid.order),
            weights=pick(self.weights, 1),
            to_nodes=pick(self.to_nodes, 2),
            k=pick(self.k, 1),
            q0=pick(self.q0, 1),
            alpha0=pick(self.alpha0, 0),
            internal_force=self.internal_force[chosen],
            internal_moment=self.internal_moment[chosen],
        )


@dataclass(frozen=True)
class Equilibrium:
    """Solved shapes of a `Problem`, one a frame."""

    problem: Problem
    q: Array  # (T, Q) rad, curvature at the nodes
    converged: BoolArray  # (T,) equilibrium reached on the branch that grows from rest
    stable: BoolArray  # (T,) the tangent is positive definite there
    load_factor: Array  # (T,) share of the load reached: below 1 the branch ends there (snap-through)
    buckled_at: Array  # (T,) share of the load at which the branch lost stability; NaN where it never did
    iterations: int  # Newton iterations in all

    @property
    def alpha(self) -> Array:
        """(T, Q) tangent's angle at the nodes."""
        return node_angles(self.problem, self.q)

    def angle(self, s: Array) -> Array:
        """(T, S) tangent's angle at places `s` (S,) or (T, S). Equation (3)."""
        return self.problem.alpha0 + _apply(self.problem.grid.integral_to(s), self.q)

    def xy(self, s: Array) -> Array:
        """(T, S, 2) m, position at places `s` (S,) or (T, S). Equation (4)."""
        alpha = self.alpha
        rows = self.problem.grid.integral_to(s)
        return self.problem.length * np.stack([_apply(rows, np.cos(alpha)), _apply(rows, np.sin(alpha))], axis=-1)

    def moment(self) -> Array:
        """(T, Q) N m, internal bending moment k (q - q0) at the nodes."""
        return self.problem.k * (self.q - self.problem.q0)


def pose(beam: Rod, loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of a beam under loads. Raises `MechanicsError` where k(s) is not positive at every node."""
    size = loads.size
    loads = loads.spread(size)
    places = np.concatenate([loads.force_s, loads.moment_s], axis=1)
    jumps = beam.stiffness.jumps + beam.rest_curvature.jumps + beam.mass_per_length.jumps
    grid = _grid_for(places, jumps, resolution)
    nodes = grid.nodes
    k = np.asarray(beam.stiffness(nodes))
    if not np.all(k > 0.0):
        bad = np.flatnonzero(~(k > 0.0))[0]
        raise MechanicsError(
            f"k(s) is not positive: {k.flat[bad]:.3g} N m at s = {nodes.flat[bad]:.3f}; "
            "such a beam has no stable equilibrium"
        )
    beyond = nodes[..., None, :] < places[..., :, None]  # (T, a + b, Q)
    forces = loads.force.shape[1]
    internal_force = np.einsum("tac,taq->tqc", loads.force, beyond[:, :forces])
    internal_moment = np.einsum("tb,tbq->tq", loads.moment, beyond[:, forces:])
    if np.any(loads.gravity != 0.0):
        line = beam.length * np.asarray(beam.mass_per_length(nodes))
        mass_beyond = np.sum(grid.weights * line, axis=-1)[..., None] - _apply(grid.integral_to_nodes, line)
        internal_force = internal_force + mass_beyond[..., None] * loads.gravity[:, None, :]
    return Problem(
        length=beam.length,
        grid=grid,
        weights=grid.weights,
        to_nodes=grid.integral_to_nodes,
        k=k,
        q0=np.asarray(beam.rest_curvature(nodes)),
        alpha0=np.asarray(beam.clamp_angle),
        internal_force=internal_force,
        internal_moment=internal_moment,
    )


def node_angles(problem: Problem, q: Array) -> Array:
    """(T, Q) `alpha = alpha0 + B q` (3)."""
    return problem.alpha0 + _apply(problem.to_nodes, q)


def gradient(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q) derivative of the potential; zero at equilibrium. `load_factor` (T,) scales all loads."""
    factor = np.asarray(load_factor, dtype=float)[..., None]
    alpha = node_angles(problem, q)
    n = problem.internal_force
    across = n[..., 1] * np.cos(alpha) - n[..., 0] * np.sin(alpha)
    elastic = problem.weights * (problem.k * (q - problem.q0) - factor * problem.internal_moment)
    turning = factor * problem.length * problem.weights * across
    return elastic - _apply(np.swapaxes(problem.to_nodes, -1, -2), turning)


def tangent(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, Q) second derivative of the potential, symmetric."""
    factor = np.asarray(load_factor, dtype=float)[..., None]
    alpha = node_angles(problem, q)
    n = problem.internal_force
    along = n[..., 0] * np.cos(alpha) + n[..., 1] * np.sin(alpha)
    b = problem.to_nodes
    out = np.swapaxes(b, -1, -2) @ ((factor * problem.length * problem.weights * along)[..., None] * b)
    diagonal = np.arange(out.shape[-1])
    out[..., diagonal, diagonal] += problem.weights * problem.k
    return np.asarray(out)


def is_stable(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> BoolArray:
    """(T,) whether the tangent is positive definite (a Cholesky factor exists)."""
    matrices = tangent(problem, q, load_factor)
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        scale = np.sqrt(problem.weights * problem.k)  # similar matrices, well scaled
        scaled = matrices / (scale[..., :, None] * scale[..., None, :])
        return np.asarray(np.linalg.eigvalsh(scaled)[..., 0] > 0.0)
    return np.ones(problem.size, dtype=bool)


def force_response(solved: Equilibrium, s: Array, at_s: Array) -> Array:
    """(T, S, 2, 2) m/N: how positions at `s` (S,) move with the force at `at_s` (T,). Implicit function theorem.

    NaN for frames whose tangent is singular (at a limit point the response is infinite).
    """
    problem, alpha = solved.problem, solved.alpha
    beyond = problem.grid.nodes < np.asarray(at_s, dtype=float)[:, None]
    across = np.stack([-np.sin(alpha), np.cos(alpha)], axis=-1)  # u'
    turning = (problem.length * problem.weights * beyond)[..., None] * across
    right = np.swapaxes(problem.to_nodes, -1, -2) @ turning
    try:
        dq = np.linalg.solve(tangent(problem, solved.q), right)
    except np.linalg.LinAlgError:
        return np.full((problem.size, len(s), 2, 2), np.nan)
    dalpha = problem.to_nodes @ dq  # (T, Q, 2)
    moved = across[..., :, None] * dalpha[..., None, :]  # (T, Q, 2, 2)
    rows = problem.length * problem.grid.integral_to(s)
    if rows.ndim == 2:
        return np.asarray(np.einsum("sq,tqcd->tscd", rows, moved, optimize=True))
    return np.asarray(np.einsum("tsq,tqcd->tscd", rows, moved, optimize=True))


def _apply(rows: Array, values: Array) -> Array:
    """rows (S, Q) or (T, S, Q) on values (Q,) or (T, Q): one matrix product where the rows are shared."""
    if rows.ndim == 2:
        return np.asarray(values @ rows.T)
    return np.asarray(np.einsum("tsq,...q->ts" if values.ndim == 1 else "tsq,tq->ts", rows, values))


def _grid_for(places: Array, jumps: tuple[float, ...], resolution: Resolution) -> Grid:
    """One grid for the batch where all frames have their loads at the same places, else one a frame."""
    if places.shape[1] == 0 or np.all(places == places[:1]):
        fixed = tuple(float(p) for p in places[0]) if places.shape[0] else ()
        return make_grid((*fixed, *jumps), order=resolution.order, widest=resolution.widest)
    common = make_grid(jumps, order=resolution.order, widest=resolution.widest).edges
    inside = np.clip(places, 1e-6, 1.0 - 1e-6)
    edges = np.sort(np.concatenate([np.broadcast_to(common, (places.shape[0], len(common))), inside], axis=1), axis=1)
    # Equal edges are pulled apart by an invisible amount so that every frame has the same number of panels.
    step = 1e-7 * np.arange(edges.shape[1])
    edges = np.maximum.accumulate(edges - step, axis=1) + step
    edges = (edges - edges[:, :1]) / (edges[:, -1:] - edges[:, :1])
    edges[:, -1] = 1.0
    return Grid(edges, resolution.order)
