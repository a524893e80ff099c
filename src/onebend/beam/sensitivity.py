"""Derivatives of an equilibrium by the implicit function theorem: `dq/dp = -T^-1 dg/dp`, T the tangent.

A `Change` says how parameters enter the out-of-balance: by the internal force and moment they add, by the elastic term,
by the clamp's angle. Changes are joined with `+` and answered together: the tangent is factorised once for all of them.
Never by differentiating through the iterations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.problem import Problem
from onebend.beam.statics import Equilibrium, internal_force, tangent
from onebend.records import Array


@dataclass(frozen=True)
class Change:
    """P parameters: derivatives of what enters the balance, at the nodes of T frames. Ones may stand for T."""

    force: Array  # (T, Q, 2, P) N per unit: of the dead force beyond each node
    moment: Array  # (T, Q, P) N m per unit: of the moment beyond each node
    elastic: Array  # (T, Q, P) N m per unit: of k (q - q0) at fixed q
    clamp: Array  # (P,) rad per unit

    def __add__(self, other: Change) -> Change:
        """Both sets of parameters, one after the other."""
        size = max(len(x) for c in (self, other) for x in (c.force, c.moment, c.elastic))

        def join(a: Array, b: Array) -> Array:
            spread = [np.broadcast_to(x, (size, *x.shape[1:])) for x in (a, b)]
            return np.concatenate(spread, axis=-1)

        return Change(
            join(self.force, other.force),
            join(self.moment, other.moment),
            join(self.elastic, other.elastic),
            np.concatenate([self.clamp, other.clamp]),
        )


@dataclass(frozen=True)
class Response:
    """How equilibria move with P parameters."""

    solved: Equilibrium
    change: Change
    q: Array  # (T, Q, P) rad per unit, at the nodes

    @property
    def alpha(self) -> Array:
        """(T, Q, P) of the angle at the nodes."""
        return self.solved.problem.to_nodes @ self.q + self.change.clamp

    def angle(self, s: Array) -> Array:
        """(T, S, P) rad per unit, of the angle at places `s` (S,) or (T, S)."""
        return self.solved.problem.grid.integral_to(s) @ self.q + self.change.clamp

    def xy(self, s: Array) -> Array:
        """(T, S, 2, P) m per unit, of the position at places `s`."""
        problem, alpha, turned = self.solved.problem, self.solved.alpha, self.alpha
        rows = problem.length[..., None] * problem.grid.integral_to(s)
        x = rows @ (-np.sin(alpha)[..., None] * turned)
        y = rows @ (np.cos(alpha)[..., None] * turned)
        return np.stack([x, y], axis=-2)

    def clamp_wrench(self) -> Array:
        """(T, 3, P) N, N, N m per unit: of force and moment that the clamp puts on the beam (dead loads)."""
        problem, alpha, turned = self.solved.problem, self.solved.alpha, self.alpha
        n, dn = internal_force(problem, self.solved.q), self.change.force
        cos, sin = np.cos(alpha), np.sin(alpha)
        along = n[..., 0] * cos + n[..., 1] * sin
        across = dn[..., 1, :] * cos[..., None] - dn[..., 0, :] * sin[..., None] - along[..., None] * turned
        lever = np.sum((problem.length * problem.weights)[..., None] * across, axis=1)
        base = _at_base(problem)
        force, moment = np.einsum("q,tqcp->tcp", base, dn), np.einsum("q,tqp->tp", base, self.change.moment)
        moment = np.broadcast_to(moment, lever.shape)
        return -np.concatenate([np.broadcast_to(force, (len(lever), *force.shape[1:])), (lever + moment)[:, None]], 1)


def respond(solved: Equilibrium, change: Change) -> Response:
    """Derivatives of the equilibria with respect to all parameters of `change`.

    NaN in frames whose tangent is singular: at a limit point the response is infinite.
    """
    right = right_side(solved, change)
    matrices = tangent(solved.problem, solved.q)
    try:
        q = np.linalg.solve(matrices, right)
    except np.linalg.LinAlgError:
        q = np.full_like(right, np.nan)
        for i, matrix in enumerate(matrices):
            if np.linalg.cond(matrix) < 1.0 / np.finfo(float).eps:
                q[i] = np.linalg.solve(matrix, right[i])
    return Response(solved, change, np.asarray(q))


def right_side(solved: Equilibrium, change: Change) -> Array:
    """(T, Q, P): minus the derivative of the out-of-balance at fixed q."""
    problem, alpha = solved.problem, solved.alpha
    cos, sin = np.cos(alpha)[..., None], np.sin(alpha)[..., None]
    lw = (problem.length * problem.weights)[..., None]
    across = change.force[..., 1, :] * cos - change.force[..., 0, :] * sin
    out = transposed(problem.to_nodes) @ (lw * across)
    out = out + problem.weights[..., None] * (change.moment - change.elastic)
    if np.any(change.clamp != 0.0):
        # Turning the clamp turns every angle alike, followers included: T summed over a uniform turn, less elasticity.
        n = internal_force(problem, solved.q)
        along = n[..., 0, None] * cos + n[..., 1, None] * sin
        if problem.follower.shape[1]:
            along = along - _turned_followers(problem, solved.q, cos, sin)
        out = out - (transposed(problem.to_nodes) @ (lw * along)) * change.clamp
    return np.asarray(out)


def of_force(problem: Problem, at_s: Array) -> Change:
    """Two parameters: the components [N] of a dead force at `at_s`, a number or (T,)."""
    beyond = _beyond(problem, at_s)
    force = beyond[..., None, None] * np.eye(2)
    return _change(problem, 2, force=force)


def of_moment(problem: Problem, at_s: Array) -> Change:
    """One parameter: a moment [N m] at `at_s`, a number or (T,)."""
    return _change(problem, 1, moment=_beyond(problem, at_s)[..., None])


def of_stiffness(solved: Equilibrium, functions: Array) -> Change:
    """P parameters: coefficients of functions (Q, P) or (T, Q, P) added to k(s) [N m]."""
    problem = solved.problem
    return _change(problem, functions.shape[-1], elastic=(solved.q - problem.q0)[..., None] * functions)


def of_rest_curvature(problem: Problem, functions: Array) -> Change:
    """P parameters: coefficients of functions (Q, P) added to q0(s) [rad]."""
    elastic = -np.asarray(problem.k)[..., None] * functions
    return _change(problem, functions.shape[-1], elastic=elastic if elastic.ndim == 3 else elastic[None])


def of_clamp_angle(problem: Problem) -> Change:
    """One parameter: the clamp's angle [rad], the loads keeping their directions."""
    return _change(problem, 1, clamp=np.ones(1))


def of_mass(problem: Problem, functions: Array, gravity: Array) -> Change:
    """P parameters: coefficients of functions (Q, P) added to mu(s) [kg/m] under gravity (T, 2) or (1, 2)."""
    line = problem.length[..., None] * functions  # (Q, P) or (T, Q, P)
    total = np.sum(problem.weights[..., None] * line, axis=-2, keepdims=True)
    beyond = total - problem.to_nodes @ line
    beyond = beyond if beyond.ndim == 3 else beyond[None]
    return _change(problem, functions.shape[-1], force=beyond[..., None, :] * gravity[:, None, :, None])


def clamp_wrench(solved: Equilibrium) -> Array:
    """(T, 3) N, N, N m: force and moment that the clamp puts on the beam."""
    problem, alpha = solved.problem, solved.alpha
    n = internal_force(problem, solved.q)
    across = n[..., 1] * np.cos(alpha) - n[..., 0] * np.sin(alpha)
    lever = np.sum(problem.length * problem.weights * across, axis=-1)
    base = _at_base(problem)
    moment = lever + problem.moment @ base
    return -np.concatenate([np.einsum("q,tqc->tc", base, n), moment[:, None]], axis=1)


def _change(
    problem: Problem,
    count: int,
    *,
    force: Array | None = None,
    moment: Array | None = None,
    elastic: Array | None = None,
    clamp: Array | None = None,
) -> Change:
    """A change with zeros where nothing is given."""
    nodes = problem.to_nodes.shape[-1]
    return Change(
        force=np.zeros((1, nodes, 2, count)) if force is None else force,
        moment=np.zeros((1, nodes, count)) if moment is None else moment,
        elastic=np.zeros((1, nodes, count)) if elastic is None else elastic,
        clamp=np.zeros(count) if clamp is None else clamp,
    )


def _beyond(problem: Problem, at_s: Array) -> Array:
    """(T or 1, Q): 1 where `at_s` lies beyond the node. The grid must have an edge at `at_s` to be exact."""
    places = np.atleast_1d(np.asarray(at_s, dtype=float))[:, None]
    return np.asarray(problem.grid.nodes < places, dtype=float)


def _at_base(problem: Problem) -> Array:
    """(Q,) row that evaluates a smooth quantity of the first panel at s = 0 by extrapolation of its polynomial."""
    order = problem.grid.order
    x, w = np.polynomial.legendre.leggauss(order)
    degree = np.arange(order)
    values = (degree + 0.5) * (-1.0) ** degree
    row = np.zeros(problem.to_nodes.shape[-1])
    row[:order] = (values @ np.polynomial.legendre.legvander(x, order - 1).T) * w
    return row


def _turned_followers(problem: Problem, q: Array, cos: Array, sin: Array) -> Array:
    """(T, Q, 1) across component of the followers' derivative with a common turn."""
    angle = problem.alpha0 + apply(problem.follower_rows, q)
    c, s = np.cos(angle), np.sin(angle)
    f = problem.follower
    turning = np.stack([-s * f[..., 0] - c * f[..., 1], c * f[..., 0] - s * f[..., 1]], axis=-1)
    per_turn = np.einsum("tcd,tcq->tqd", turning, problem.follower_beyond)
    return np.asarray(per_turn[..., 1, None] * cos - per_turn[..., 0, None] * sin)
