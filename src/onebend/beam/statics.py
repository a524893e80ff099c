"""Equilibrium of a clamped beam, exact: nodal Gauss collocation (5)-(11).

The potential of dead loads is `V(q) = int k/2 (q - q0)^2 - L int N . (cos alpha, sin alpha) - int m q`, where `N(s)` is
the sum of all forces beyond s and `m(s)` the sum of all point moments beyond s. With the integrals done by Gauss's rule
on panels that end at every load and at every jump of k, the gradient and the tangent are

    g = w (k (q - q0) - m) - B^T (w L N . u'),        T = diag(w k) + B^T diag(w L N . u) B,

B the integration matrix, u = (cos alpha, sin alpha), u' = (-sin alpha, cos alpha). The stiffness enters at the nodes:
no mode shapes, no quadrature of k against them. A follower force turns with the tangent where it acts; it has no
potential, and its part of T is not symmetric.

`continuation.py` finds the branch of g = 0 that grows from the rest shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.beam.loads import Loads
from onebend.beam.stiffness import Profile
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray

_TABULATED = 48  # nodes up to which B^T diag(d) B is done by a table
RESOLVED = 1e-10  # share of the last Legendre coefficients of a curvature that the grid carries


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
    """Arrays of one batch of equilibria: T frames, Q nodes. What differs from beam to beam leads with T."""

    grid: Grid
    weights: Array  # (Q,) or (T, Q)
    to_nodes: Array  # (Q, Q) or (T, Q, Q): B
    length: Array  # () or (T, 1) m
    k: Array  # (Q,) or (T, Q) N m
    q0: Array  # (Q,) or (T, Q) rad
    alpha0: Array  # () or (T, 1) rad
    dead_force: Array  # (T, Q, 2) N: all dead forces beyond the node
    moment: Array  # (T, Q) N m: all point moments beyond the node
    follower: Array  # (T, c, 2) N, in the tangent's frame
    follower_beyond: Array  # (T, c, Q): 1 where the follower acts beyond the node
    follower_rows: Array  # (T, c, Q): angle at the follower's place

    @property
    def size(self) -> int:
        """T."""
        return int(self.dead_force.shape[0])

    def take(self, chosen: IntArray | BoolArray) -> Problem:
        """Some frames of the batch."""

        def pick(x: Array, plain: int) -> Array:
            return x[chosen] if x.ndim > plain else x

        return Problem(
            grid=self.grid if self.grid.edges.ndim == 1 else Grid(self.grid.edges[chosen], self.grid.order),
            weights=pick(self.weights, 1),
            to_nodes=pick(self.to_nodes, 2),
            length=pick(self.length, 0),
            k=pick(self.k, 1),
            q0=pick(self.q0, 1),
            alpha0=pick(self.alpha0, 0),
            dead_force=self.dead_force[chosen],
            moment=self.moment[chosen],
            follower=self.follower[chosen],
            follower_beyond=self.follower_beyond[chosen],
            follower_rows=self.follower_rows[chosen],
        )


@dataclass(frozen=True)
class Equilibrium:
    """Solved shapes of a `Problem`, one a frame."""

    problem: Problem
    q: Array  # (T, Q) rad, curvature at the nodes
    converged: BoolArray  # (T,) equilibrium reached on the branch that grows from rest
    stable: BoolArray  # (T,) the second variation of the potential is positive there
    load_factor: Array  # (T,) share of the load reached: below 1 the branch ends there (snap-through)
    buckled_at: Array  # (T,) share of the load at which the branch lost stability; NaN where it never did
    iterations: int  # Newton iterations, the most that a frame took

    @property
    def resolved(self) -> BoolArray:
        """(T,) whether the grid carries the curvature: its last Legendre coefficients are below 1e-10 of the first."""
        return np.asarray(self.problem.grid.legendre_tail(self.q) < RESOLVED)

    @property
    def alpha(self) -> Array:
        """(T, Q) tangent's angle at the nodes."""
        return node_angles(self.problem, self.q)

    def angle(self, s: Array) -> Array:
        """(T, S) tangent's angle at places `s` (S,) or (T, S). Equation (3)."""
        return self.problem.alpha0 + apply(self.problem.grid.integral_to(s), self.q)

    def xy(self, s: Array) -> Array:
        """(T, S, 2) m, position at places `s` (S,) or (T, S). Equation (4)."""
        alpha = self.alpha
        rows = self.problem.grid.integral_to(s)
        unit = np.stack([apply(rows, np.cos(alpha)), apply(rows, np.sin(alpha))], axis=-1)
        return np.asarray(self.problem.length[..., None] * unit)

    def moment(self) -> Array:
        """(T, Q) N m, internal bending moment k (q - q0) at the nodes."""
        return self.problem.k * (self.q - self.problem.q0)


def pose(beam: Rod, loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of a beam under loads. Raises `MechanicsError` where k(s) is not positive at every node."""
    return pose_many([beam], loads, resolution)


def pose_many(beams: Sequence[Rod], loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of several beams, one a frame (or one for all frames), on one grid.

    Raises:
        MechanicsError: k(s) is not positive at a node; as many beams as frames are needed, or one.
    """
    size = max(loads.size, len(beams))
    if len(beams) not in (1, size):
        raise MechanicsError(f"{len(beams)} beams do not fit loads for {size} frames")
    loads = loads.spread(size)
    jumps = tuple(j for b in beams for p in (b.stiffness, b.rest_curvature, b.mass_per_length) for j in p.jumps)
    grid = _grid_for(loads.places, tuple(sorted(set(jumps))), resolution)
    nodes, weights, to_nodes = grid.nodes, grid.weights, grid.integral_to_nodes
    one = len(beams) == 1
    k = _stack([np.asarray(b.stiffness(nodes), dtype=float) for b in beams])
    _check_positive(k, nodes)
    length = np.asarray(beams[0].length) if one else np.array([[b.length] for b in beams])
    alpha0 = np.asarray(beams[0].clamp_angle) if one else np.array([[b.clamp_angle] for b in beams])
    dead = np.einsum("tac,taq->tqc", loads.force, _beyond(nodes, loads.force_s))
    if np.any(loads.gravity != 0.0):
        line = length * _stack([np.asarray(b.mass_per_length(nodes)) for b in beams])
        mass_beyond = np.sum(weights * line, axis=-1)[..., None] - apply(to_nodes, line)
        dead = dead + mass_beyond[..., None] * loads.gravity[:, None, :]
    rows = grid.integral_to(loads.follower_s if loads.follower_s.size else np.zeros((size, 0)))
    return Problem(
        grid=grid,
        weights=weights,
        to_nodes=to_nodes,
        length=length,
        k=k,
        q0=_stack([np.asarray(b.rest_curvature(nodes), dtype=float) for b in beams]),
        alpha0=alpha0,
        dead_force=dead,
        moment=np.einsum("tb,tbq->tq", loads.moment, _beyond(nodes, loads.moment_s)),
        follower=loads.follower,
        follower_beyond=_beyond(nodes, loads.follower_s),
        follower_rows=rows,
    )


def node_angles(problem: Problem, q: Array) -> Array:
    """(T, Q) `alpha = alpha0 + B q` (3)."""
    return problem.alpha0 + apply(problem.to_nodes, q)


def internal_force(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, 2) N: the sum of all forces beyond each node, followers turned to where they point now."""
    factor = np.asarray(load_factor, dtype=float)[..., None, None]
    if problem.follower.shape[1] == 0:
        return np.asarray(factor * problem.dead_force)
    turned, _ = _followers(problem, q)
    return np.asarray(factor * (problem.dead_force + np.einsum("tcd,tcq->tqd", turned, problem.follower_beyond)))


def potential(problem: Problem, q: Array) -> Array:
    """(T,) J: bending energy less the work of the dead loads, whose gradient `gradient` is. Followers have none."""
    alpha = node_angles(problem, q)
    elastic = 0.5 * problem.k * (q - problem.q0) ** 2 - problem.moment * q
    work = problem.length * (problem.dead_force[..., 0] * np.cos(alpha) + problem.dead_force[..., 1] * np.sin(alpha))
    return np.asarray(np.sum(problem.weights * (elastic - work), axis=-1))


def gradient(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q) out-of-balance; zero at equilibrium. `load_factor` (T,) scales all loads."""
    factor = np.asarray(load_factor, dtype=float)[..., None]
    alpha = node_angles(problem, q)
    n = internal_force(problem, q, load_factor)
    across = n[..., 1] * np.cos(alpha) - n[..., 0] * np.sin(alpha)
    elastic = problem.weights * (problem.k * (q - problem.q0) - factor * problem.moment)
    return elastic - apply(transposed(problem.to_nodes), problem.length * problem.weights * across)


def tangent(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, Q) derivative of the gradient; symmetric unless a follower force acts."""
    alpha = node_angles(problem, q)
    cos, sin = np.cos(alpha), np.sin(alpha)
    n = internal_force(problem, q, load_factor)
    b, lw = problem.to_nodes, problem.length * problem.weights
    out = _congruence(b, lw * (n[..., 0] * cos + n[..., 1] * sin))
    diagonal = np.arange(out.shape[-1])
    out[..., diagonal, diagonal] += problem.weights * problem.k
    if problem.follower.shape[1]:
        _, turning = _followers(problem, q)
        factor = np.asarray(load_factor, dtype=float)[..., None, None]
        per_turn = turning[..., 1, None] * cos[:, None] - turning[..., 0, None] * sin[:, None]  # (T, c, Q)
        moved = factor * lw[..., None, :] * per_turn * problem.follower_beyond @ b
        out -= np.einsum("tcq,tcp->tqp", moved, problem.follower_rows)
    return np.asarray(out)


def is_stable(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> BoolArray:
    """(T,) whether the equilibrium stands: the second variation is positive (a Cholesky factor of T exists).

    With follower forces there is no potential: then "stable" means that no real eigenvalue of T is negative or zero
    (no divergence). Flutter is a matter of dynamics and not seen here.
    """
    matrices = tangent(problem, q, load_factor)
    scale = np.sqrt(problem.weights * problem.k)
    scaled = matrices / (scale[..., :, None] * scale[..., None, :])
    if problem.follower.shape[1]:
        values = np.linalg.eigvals(scaled)
        real = np.abs(values.imag) < 1e-9 * np.abs(values)
        return np.asarray(np.all(~real | (values.real > 0.0), axis=-1))
    return positive_definite(scaled)


def _congruence(b: Array, diagonal: Array) -> Array:
    """(T, Q, Q) `B^T diag(d) B`: for a small shared B one product with a table of its rows' squares."""
    nodes = b.shape[-1]
    if b.ndim == 2 and nodes <= _TABULATED:
        return np.asarray((diagonal @ _squares(b.tobytes(), nodes)).reshape(*diagonal.shape[:-1], nodes, nodes))
    return np.asarray(transposed(b) @ (diagonal[..., None] * b))


@lru_cache(maxsize=16)
def _squares(matrix: bytes, nodes: int) -> Array:
    """(Q, Q * Q): row q holds `B[q, i] B[q, j]`."""
    b = np.frombuffer(matrix).reshape(nodes, nodes)
    return np.asarray((b[:, :, None] * b[:, None, :]).reshape(nodes, -1))


def positive_definite(matrices: Array) -> BoolArray:
    """(T,) of symmetric (T, n, n)."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.eigvalsh(matrices)[..., 0] > 0.0)
    return np.ones(len(matrices), dtype=bool)


def apply(rows: Array, values: Array) -> Array:
    """rows (S, Q) or (T, S, Q) on values (Q,) or (T, Q): one matrix product where the rows are shared."""
    if rows.ndim == 2:
        return np.asarray(values @ rows.T)
    return np.asarray(np.einsum("tsq,q->ts" if values.ndim == 1 else "tsq,tq->ts", rows, values))


def transposed(matrix: Array) -> Array:
    """The last two axes swapped."""
    return np.swapaxes(matrix, -1, -2)


def _followers(problem: Problem, q: Array) -> tuple[Array, Array]:
    """(T, c, 2) the followers in the beam's frame, and their derivative with the angle there."""
    angle = problem.alpha0 + np.einsum("tcq,tq->tc", problem.follower_rows, q)
    cos, sin = np.cos(angle), np.sin(angle)
    f = problem.follower
    turned = np.stack([cos * f[..., 0] - sin * f[..., 1], sin * f[..., 0] + cos * f[..., 1]], axis=-1)
    return turned, np.stack([-turned[..., 1], turned[..., 0]], axis=-1)


def _beyond(nodes: Array, places: Array) -> Array:
    """(T, a, Q) 1 where a place lies beyond a node."""
    return np.asarray(nodes[..., None, :] < places[..., :, None], dtype=float)


def _stack(values: list[Array]) -> Array:
    """One beam's values as they are, several with a leading axis."""
    return values[0] if len(values) == 1 else np.stack(values)


def _check_positive(k: Array, nodes: Array) -> None:
    if not np.all(k > 0.0):
        bad = np.flatnonzero(~(k > 0.0))[0]
        where = np.broadcast_to(nodes, k.shape).flat[bad]
        raise MechanicsError(
            f"k(s) is not positive: {k.flat[bad]:.3g} N m at s = {where:.3f}; such a beam has no stable equilibrium"
        )


def _grid_for(places: Array, jumps: tuple[float, ...], resolution: Resolution) -> Grid:
    """One grid for the batch where all frames have their loads at the same places, else one a frame."""
    if places.shape[1] == 0 or np.all(places == places[:1]):
        fixed = tuple(float(p) for p in places[0])
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
