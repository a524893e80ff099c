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

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.problem import Problem
from onebend.records import Array, BoolArray

_TABULATED = 48  # nodes up to which B^T diag(d) B is done by a table
RESOLVED = 1e-10  # share of the last Legendre coefficients of a curvature that the grid carries


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


def _followers(problem: Problem, q: Array) -> tuple[Array, Array]:
    """(T, c, 2) the followers in the beam's frame, and their derivative with the angle there."""
    angle = problem.alpha0 + np.einsum("tcq,tq->tc", problem.follower_rows, q)
    cos, sin = np.cos(angle), np.sin(angle)
    f = problem.follower
    turned = np.stack([cos * f[..., 0] - sin * f[..., 1], sin * f[..., 0] + cos * f[..., 1]], axis=-1)
    return turned, np.stack([-turned[..., 1], turned[..., 0]], axis=-1)
