"""Equilibrium of a clamped beam: balance, Newton's method and derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf

from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.problem import Problem
from onebend.records import Array, BoolArray, IntArray, paired

# Planar rod of Simo and Reissner. Directors d1 = (cos alpha, sin alpha), d2 = (-sin alpha, cos alpha); n(s) is the sum
# of all forces beyond s, N = n . d1, Q = n . d2:
#
#     r' = L [(1 + N/EA) d1 + (Q/kGA) d2]
#
# Stretch and shear follow from n, so the curvature is the only unknown. The loads' work per s,
# `W(alpha) = L (N + N^2 / 2 EA + Q^2 / 2 kGA)`, has with delta = 1/EA - 1/kGA the derivatives
#
#     dW/dalpha = L Q (1 + delta N) = -M' - m',    -d2W/dalpha2 = L (N + delta (N^2 - Q^2)).


@dataclass(frozen=True)
class NodalForces:
    """Directions at the nodes, and derivatives of the loads' work `w W` by the angle."""

    cos: Array  # (T, Q)
    sin: Array  # (T, Q)
    along: Array  # (T, Q) N m: minus the second derivative; L w N without stretch and shear
    across: Array  # (T, Q) N m: the first derivative; L w Q without stretch and shear
    turned: tuple[Array, Array] | None  # (T, Q) each: `d(r'/L)/dalpha = turned[0] d1 + turned[1] d2`; None: d2

    @cached_property
    def lever(self) -> Array:
        """(T, Q, 2): d(r'/L)/dalpha at fixed n, `(1 + delta N) d2 + delta Q d1`.

        Also d(dW/dalpha)/dn over L, by Betti's reciprocity.
        """
        return paired(-self.sin, self.cos) if self.turned is None else self.in_plane(*self.turned)

    def in_plane(self, along: Array, across: Array) -> Array:
        """(T, Q, 2): vectors of components (T, Q) along d1 and d2."""
        return paired(along * self.cos - across * self.sin, along * self.sin + across * self.cos)


def node_angles(problem: Problem, q: Array) -> Array:
    """(T, Q) `alpha = alpha0 + B q` (3)."""
    return problem.alpha0 + apply(problem.to_nodes, q)


def nodal_forces(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> NodalForces:
    alpha = node_angles(problem, q)
    cos, sin = np.cos(alpha), np.sin(alpha)
    factor = np.asarray(load_factor, dtype=float)[..., None]
    x, y = problem.dead_pull
    along, across = factor * (x * cos + y * sin), factor * (y * cos - x * sin)
    delta = problem.strain_lever
    if delta is None:
        return NodalForces(cos, sin, along, across, None)
    tilted, stretched = delta * across, 1.0 + delta * along
    return NodalForces(cos, sin, along * stretched - tilted * across, across * stretched, (tilted, stretched))


def normal_and_shear(problem: Problem, forces: NodalForces) -> tuple[Array, Array]:
    """(T, Q) N each: N and Q under all loads."""
    x, y = problem.dead_force[..., 0], problem.dead_force[..., 1]
    return x * forces.cos + y * forces.sin, y * forces.cos - x * forces.sin


def centreline_slope(problem: Problem, forces: NodalForces, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, 2): r'/L, `(1 + N/EA) d1 + (Q/kGA) d2`; N and Q are those of all loads times `load_factor`."""
    if problem.compliance is None:
        return paired(forces.cos, forces.sin)
    factor, (stretch, shear) = np.asarray(load_factor, dtype=float)[..., None], problem.compliance
    normal, transverse = normal_and_shear(problem, forces)
    return forces.in_plane(1.0 + factor * stretch * normal, factor * shear * transverse)


def strain_by_force(problem: Problem, forces: NodalForces) -> Array:
    """(T, Q, 2, 2) 1/N: d(r'/L)/dn at fixed angle, `d1 d1^T / EA + d2 d2^T / kGA`; compliant beams only."""
    assert problem.compliance is not None
    stretch, shear = problem.compliance
    cos, sin = forces.cos, forces.sin
    out = np.empty((*cos.shape, 2, 2))
    out[..., 0, 0] = stretch * cos**2 + shear * sin**2
    out[..., 1, 1] = stretch * sin**2 + shear * cos**2
    out[..., 0, 1] = out[..., 1, 0] = (stretch - shear) * cos * sin
    return out


# Equilibrium by nodal Gauss collocation (5)-(11). The potential of dead loads is
# `V(q) = int k/2 (q - q0)^2 - L int N . (cos alpha, sin alpha) - int m q`, with the sums N(s), m(s) of all forces and
# moments beyond s. On panels that end at every load and every jump of k, with the integration matrix B:
#
#     g = w (k (q - q0) - m) - B^T (w L N . u'),        T = diag(w k) + B^T diag(w L N . u) B,
#
# u = (cos alpha, sin alpha), u' = (-sin alpha, cos alpha). Stretch and shear change `L N . u'` and `L N . u` (see
# above).

_TABULATED = 300_000
RESOLVED = 1e-10  # largest share of the last Legendre coefficients


@dataclass(frozen=True)
class Equilibrium:
    """Solved shapes of a `Problem`, one per frame."""

    problem: Problem
    q: Array  # (T, Q) rad, curvature at the nodes
    converged: BoolArray  # (T,) reached on the branch that grows from rest, or by falling from it
    stable: BoolArray  # (T,) the second variation of the potential is positive
    load_factor: Array  # (T,) share of the load reached; below 1 the branch ends there (snap-through)
    buckled_at: Array  # (T,) share of the load at which the branch lost stability, else NaN
    fell: BoolArray  # (T,) the beam fell from the branch
    iterations: int  # largest number of Newton iterations of a frame

    @property
    def resolved(self) -> BoolArray:
        """(T,) whether the last Legendre coefficients of the curvature are below 1e-10."""
        return np.asarray(self.problem.grid.legendre_tail(self.q) < RESOLVED)

    def take(self, chosen: IntArray) -> Equilibrium:
        parts = {name: getattr(self, name)[chosen] for name in _OF_FRAMES}
        return replace(self, problem=self.problem.take(chosen), **parts)

    def put(self, frames: IntArray, by: Equilibrium) -> Equilibrium:
        parts = {name: getattr(self, name).copy() for name in _OF_FRAMES}
        for name, values in parts.items():
            values[frames] = getattr(by, name)
        return replace(self, iterations=max(self.iterations, by.iterations), **parts)

    @cached_property
    def alpha(self) -> Array:
        """(T, Q) rad, the director's angle; the tangent's without shear."""
        return node_angles(self.problem, self.q)

    @cached_property
    def forces(self) -> NodalForces:
        return nodal_forces(self.problem, self.q)

    @cached_property
    def normal_and_shear(self) -> tuple[Array, Array]:
        """(T, Q) N each."""
        return normal_and_shear(self.problem, self.forces)

    @cached_property
    def strain_by_force(self) -> Array:
        """(T, Q, 2, 2) 1/N, d(r'/L)/dn; compliant beams only."""
        return strain_by_force(self.problem, self.forces)

    @cached_property
    def strained(self) -> Array:
        """(T, Q, 2): part of r'/L due to strain; compliant beams only."""
        assert self.problem.compliance is not None
        return self.strained_by(self.problem.compliance)

    def strained_by(self, compliance: tuple[Array, Array]) -> Array:
        """The same, for 1/EA and 1/kGA (Q,) or (T, Q) [1/N]."""
        normal, transverse = self.normal_and_shear
        return self.forces.in_plane(compliance[0] * normal, compliance[1] * transverse)

    def angle(self, s: Array) -> Array:
        """(T, S) rad, tangent's angle at `s` (S,) or (T, S). Equation (3)."""
        return self.problem.alpha0 + apply(self.problem.grid.integral_to(s), self.q)

    def xy(self, s: Array) -> Array:
        """(T, S, 2) m, position at `s` (S,) or (T, S). Equation (4)."""
        return _times(self.problem.grid.integral_to(s), self.slope)

    def poses(self, s: Array) -> Array:
        """(T, S, 3) m, m, rad: position and angle."""
        return np.concatenate([self.xy(s), self.angle(s)[..., None]], axis=-1)

    def xy_by_s(self, s: Array) -> Array:
        """(T, S, 2) m, d r / d s at `s` (S,), with stretch and shear."""
        return _times(self.problem.grid.value_at(s), self.slope)

    def moment(self) -> Array:
        """(T, Q) N m, k (q - q0)."""
        return self.problem.k * (self.q - self.problem.q0)

    @cached_property
    def slope(self) -> Array:
        """(T, Q, 2) m: r' under the loads that act on the shapes."""
        factor = np.where(np.isfinite(self.load_factor), self.load_factor, 1.0)
        return np.asarray(self.problem.length[..., None] * centreline_slope(self.problem, self.forces, factor))


def _times(rows: Array, vectors: Array) -> Array:
    """(T, S, 2): rows (S, Q) or (T, S, Q) times vectors (T, Q, 2)."""
    return paired(apply(rows, vectors[..., 0]), apply(rows, vectors[..., 1]))


_OF_FRAMES = ("q", "converged", "stable", "load_factor", "buckled_at", "fell")


def found_near(problem: Problem, q: Array, found: BoolArray, iterations: int = 0) -> Equilibrium:
    """Stable equilibria where `found`."""
    none = np.full(len(q), np.nan)
    factor = np.where(found, 1.0, np.nan)
    return Equilibrium(problem, q, found, found.copy(), factor, none, np.zeros(len(q), dtype=bool), iterations)


def potential(problem: Problem, q: Array) -> Array:
    """(T,) J: bending energy less the work of the dead loads."""
    elastic = 0.5 * problem.k * (q - problem.q0) ** 2 - problem.moment * q
    slope = centreline_slope(problem, nodal_forces(problem, q), 0.5)  # loads work on all strain, half of it is stored
    work = problem.length * np.sum(problem.dead_force * slope, axis=-1)
    return np.asarray(np.sum(problem.weights * (elastic - work), axis=-1))


def gradient(problem: Problem, q: Array, load_factor: Array | float = 1.0, forces: NodalForces | None = None) -> Array:
    """(T, Q) out-of-balance, zero at equilibrium; `forces` if known."""
    forces = forces or nodal_forces(problem, q, load_factor)
    factor = np.asarray(load_factor, dtype=float)[..., None]
    elastic = problem.stiff * (q - problem.q0) - factor * problem.couple
    return elastic - apply(transposed(problem.to_nodes), forces.across)


def tangent(problem: Problem, q: Array, load_factor: Array | float = 1.0, forces: NodalForces | None = None) -> Array:
    """(T, Q, Q) derivative of `gradient`, symmetric."""
    forces = forces or nodal_forces(problem, q, load_factor)
    return second_variation(problem, forces.along, problem.stiff)


def balance(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> tuple[Array, Array]:
    forces = nodal_forces(problem, q, load_factor)
    return gradient(problem, q, load_factor, forces), tangent(problem, q, load_factor, forces)


def is_stable(
    problem: Problem, q: Array, load_factor: Array | float = 1.0, forces: NodalForces | None = None
) -> BoolArray:
    """(T,) whether the second variation is positive (T has a Cholesky factor); `forces` if known."""
    forces = forces or nodal_forces(problem, q, load_factor)
    stable = _surely_stable(problem, forces.along)
    doubtful = np.flatnonzero(~stable)
    if doubtful.size:
        part = problem if doubtful.size == len(q) else problem.take(doubtful)
        stable[doubtful] = positive_definite(second_variation(part, forces.along[doubtful], part.stiff))
    return stable


def is_convex(problem: Problem) -> BoolArray:
    """(T,) True where a bound proves the potential of dead loads convex, so that there is one equilibrium.

    The bound of `_surely_stable` with all forces as compression, for beams without stretch and shear.
    """
    if problem.compliance is not None:
        return np.zeros(problem.size, dtype=bool)
    return _surely_stable(problem, -problem.length * problem.weights * np.linalg.norm(problem.dead_force, axis=-1))


def scaled(problem: Problem, matrices: Array) -> Array:
    """(T, Q, Q) in units of curvature in which the bending energy is half the sum of squares."""
    scale = 1.0 / np.sqrt(problem.stiff)
    return np.asarray(matrices * (scale[..., :, None] * scale[..., None, :]))


def second_variation(problem: Problem, along: Array, diagonal: Array) -> Array:
    """(T, Q, Q) `diag(diagonal) + B^T diag(along) B`."""
    out = _congruence(problem.to_nodes, along)
    nodes = out.shape[-1]
    out.reshape(-1, nodes * nodes)[:, :: nodes + 1] += diagonal
    return out


def _surely_stable(problem: Problem, along: Array) -> BoolArray:
    """(T,) True where a bound without factorisation proves the second variation positive.

    A change of shape of bending energy E turns node i by at most `2 E sum_j B_ij^2 / (w k)_j` squared (Cauchy). If
    compression gains less than E from such turns, the shape is stable. For a uniform column this holds up to 2 EI / L^2
    (Euler: 2.47).
    """
    gained = apply(problem.to_nodes**2, 1.0 / problem.stiff)
    return np.asarray(np.sum(np.minimum(along, 0.0) * gained, axis=-1) > -(1.0 - 1e-9))


def _congruence(b: Array, diagonal: Array) -> Array:
    """(T, Q, Q) `B^T diag(d) B`; for a small shared B by a table of its rows' squares."""
    nodes = b.shape[-1]
    if b.ndim == 2 and b.size * nodes <= _TABULATED:
        return np.asarray((diagonal @ _squares(b.tobytes(), nodes)).reshape(*diagonal.shape[:-1], nodes, nodes))
    return np.asarray(transposed(b) @ (diagonal[..., None] * b))


@lru_cache(maxsize=16)
def _squares(matrix: bytes, nodes: int) -> Array:
    """(Q, n * n): row q holds `B[q, i] B[q, j]`."""
    b = np.frombuffer(matrix).reshape(-1, nodes)
    return np.asarray((b[:, :, None] * b[:, None, :]).reshape(len(b), -1))


def positive_definite(matrices: Array) -> BoolArray:
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return np.array([dpotrf(matrix, lower=1)[1] == 0 for matrix in matrices], dtype=bool)
    return np.ones(len(matrices), dtype=bool)


TOLERANCE = 3e-7  # rad, of the last update; the remaining error is its square


def correct(
    problem: Problem,
    start: Array,
    factor: Array,
    *,
    trust: Array,
    remaining: Array,
    max_iterations: int = 8,
    last: float = TOLERANCE,
) -> tuple[Array, BoolArray, int]:
    """Newton from `start` (T, Q) with all loads times `factor` (T,).

    Returns the shapes, (T,) success, and the number of iterations. A frame succeeds if at most about `remaining` (T,)
    rad is left to turn and no update moved it further than `trust` (T,) rad from the start. After updates u and v,
    `v (v / u)^2` is left; near a singular tangent an update below `last` [rad] suffices.
    """
    q = start.copy()
    near = np.zeros(len(q), dtype=bool)
    todo, part = np.arange(len(q)), problem
    q_now, moved, count = q, np.zeros((len(q), problem.to_nodes.shape[-2])), 0
    before = np.zeros(len(q))  # rad
    while todo.size and count < max_iterations:
        count += 1
        residual, matrices = balance(part, q_now, factor)
        update = solve_batch(matrices, residual)
        q_now = q_now - update
        turn = apply(part.to_nodes, update)
        size = np.max(np.abs(turn), axis=-1)
        moved = moved + turn
        strayed = ~(np.max(np.abs(moved), axis=-1) < trust)
        settled = size < last
        if count > 1:
            settled |= size**3 < remaining * before**2
        q[todo] = q_now
        near[todo] = settled & ~strayed
        going = np.flatnonzero(~(settled | strayed))
        if going.size == 0:
            break
        if going.size < todo.size:
            todo, part = todo[going], part.take(going)
            q_now, moved, size = q_now[going], moved[going], size[going]
            factor, trust, remaining = factor[going], trust[going], remaining[going]
        before = size
    return q, near, count


def solve_batch(matrices: Array, right_side: Array) -> Array:
    """(T, n) solutions of (T, n, n) systems; NaN if singular."""
    return solve_each(matrices, right_side[..., None])[..., 0]
