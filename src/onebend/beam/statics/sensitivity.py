"""Derivatives of an equilibrium by the implicit function theorem: `dq/dp = -T^-1 dg/dp`, T the tangent.

A `Perturbation` gives the derivatives of the balance's residual g with parameters: through the internal force and
moment, the elastic term, the clamp's angle. Perturbations are joined with `+` and solved together: the tangent is
factorised once, for the parameters or, where those are fewer, for the quantities asked for (the adjoint method).
Nothing is differentiated through the iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.statics.equilibrium import Equilibrium, internal_force, pulls, tangent
from onebend.beam.statics.problem import Problem
from onebend.records import Array


@dataclass(frozen=True)
class Perturbation:
    """P parameters: derivatives of what enters the balance, at the nodes of T frames. Ones may stand for T.

    None where nothing of the kind changes.
    """

    force: Array | None  # (T, Q, 2, P) N per unit: of the dead force beyond each node
    moment: Array | None  # (T, Q, P) N m per unit: of the moment beyond each node
    elastic: tuple[Array, Array] | None  # of k (q - q0) at fixed q: (T, Q) times functions (Q, P) or (T, Q, P), N m
    clamp: Array  # (P,) rad per unit

    @property
    def parts(self) -> tuple[Perturbation, ...]:
        """Itself, as `Perturbations` has it."""
        return (self,)

    def __add__(self, other: Perturbation | Perturbations) -> Perturbations:
        """Both sets of parameters, one after the other."""
        return Perturbations(self.parts + other.parts)


@dataclass(frozen=True)
class Perturbations:
    """Several sets of parameters, one after the other: P in all."""

    parts: tuple[Perturbation, ...]

    @property
    def clamp(self) -> Array:
        """(P,) rad per unit."""
        return np.concatenate([part.clamp for part in self.parts])

    def __add__(self, other: Perturbation | Perturbations) -> Perturbations:
        """Those of `other` after these."""
        return Perturbations(self.parts + other.parts)


@dataclass(frozen=True)
class Response:
    """How equilibria move with P parameters."""

    solved: Equilibrium
    perturbation: Perturbation | Perturbations

    @cached_property
    def q(self) -> Array:
        """(T, Q, P) rad per unit, of the curvature at the nodes."""
        return solve_each(tangent(self.solved.problem, self.solved.q), self._right)

    @property
    def alpha(self) -> Array:
        """(T, Q, P) of the angle at the nodes."""
        return self.solved.problem.to_nodes @ self.q + self.perturbation.clamp

    def poses(self, s: Array) -> Array:
        """(T, S, 3, P) m, m, rad per unit: of position and angle at places `s` (S,) or (T, S)."""
        turning, rows = self._turning(s), self.solved.problem.grid.integral_to(s)
        angle = np.broadcast_to(rows, (len(self.solved.q), *rows.shape[-2:]))[:, :, None]
        ones = np.ones((*turning.shape[:2], 1))
        turned = np.concatenate([np.sum(turning, axis=-1), ones], axis=-1)
        return self._derivative_of(np.concatenate([turning @ self._to_nodes, angle], axis=2), turned)

    def angle(self, s: Array) -> Array:
        """(T, S, P) rad per unit, of the angle at places `s` (S,) or (T, S)."""
        integral = self.solved.problem.grid.integral_to(s)
        rows = np.broadcast_to(integral, (len(self.solved.q), *integral.shape[-2:]))
        return self._derivative_of(rows, np.ones(rows.shape[:-1]))

    def xy(self, s: Array) -> Array:
        """(T, S, 2, P) m per unit, of the position at places `s` (S,) or (T, S)."""
        turning = self._turning(s)
        return self._derivative_of(turning @ self._to_nodes, np.sum(turning, axis=-1))

    def clamp_wrench(self) -> Array:
        """(T, 3, P) N, N, N m per unit: of force and moment that the clamp puts on the beam (dead loads)."""
        problem, base = self.solved.problem, _at_base(self.solved.problem)
        along, _ = pulls(problem, self.solved.q)
        out = np.zeros((len(along), 3, len(self.perturbation.clamp)))
        lw = (problem.length * problem.weights)[..., None]
        out[:, 2] = np.sum(along[..., None] * self.alpha, axis=1)
        for columns, part in _columns(self.perturbation):
            if part.force is not None:
                out[:, :2, columns] -= np.einsum("q,tqcp->tcp", base, part.force)
                out[:, 2, columns] -= np.sum(lw * _across(self.solved.alpha, part.force), axis=1)
            if part.moment is not None:
                out[:, 2, columns] -= np.einsum("q,tqp->tp", base, part.moment)
        return out

    @cached_property
    def _right(self) -> Array:
        return right_side(self.solved, self.perturbation)

    @property
    def _to_nodes(self) -> Array:
        """B, to be multiplied with a stack (T, S, 2, Q) from the right."""
        b = self.solved.problem.to_nodes
        return b if b.ndim == 2 else b[:, None]

    def _turning(self, s: Array) -> Array:
        """(T, S, 2, Q) m: how positions at `s` go with the angles at the nodes."""
        problem, alpha = self.solved.problem, self.solved.alpha
        rows = problem.length[..., None] * problem.grid.integral_to(s)
        return np.stack([-np.sin(alpha)[:, None] * rows, np.cos(alpha)[:, None] * rows], axis=-2)

    def _derivative_of(self, rows: Array, turned: Array) -> Array:
        """(T, ..., P) of quantities that go with curvature by `rows` (T, ..., Q), with the clamp by `turned` (T, ...).

        Where they are fewer than the parameters, T is solved for them: `rows T^-1 right = (T^-T rows^T)^T right`.
        """
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        clamp = self.perturbation.clamp
        if "q" in self.__dict__ or flat.shape[1] >= len(clamp):
            out = flat @ self.q
        else:
            matrices = tangent(self.solved.problem, self.solved.q)
            adjoint = transposed(solve_each(transposed(matrices), transposed(flat)))
            out = np.concatenate([_by_adjoint(adjoint, self.solved, part) for part in self.perturbation.parts], axis=-1)
        out = out.reshape(*rows.shape[:-1], len(clamp))
        return out + turned[..., None] * clamp if np.any(clamp != 0.0) else out


def respond(solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Response:
    """Derivatives of the equilibria with respect to all parameters of `perturbation`.

    They are worked out when asked for. NaN in frames whose tangent is singular: at a limit point the response is
    infinite.
    """
    return Response(solved, perturbation)


def right_side(solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Array:
    """(T, Q, P): minus the derivative of the out-of-balance at fixed q."""
    problem, alpha = solved.problem, solved.alpha
    lw = (problem.length * problem.weights)[..., None]
    weights = problem.weights[..., None]
    out = np.zeros((*alpha.shape, len(perturbation.clamp)))
    for columns, part in _columns(perturbation):
        if part.force is not None:
            out[..., columns] += transposed(problem.to_nodes) @ (lw * _across(alpha, part.force))
        if part.moment is not None:
            out[..., columns] += weights * part.moment
        if part.elastic is not None:
            size, functions = part.elastic
            out[..., columns] -= (problem.weights * size)[..., None] * functions
        if np.any(part.clamp != 0.0):
            out[..., columns] -= _of_turn(solved) * part.clamp
    return out


def _by_adjoint(rows: Array, solved: Equilibrium, part: Perturbation) -> Array:
    """(T, S, P): rows (T, S, Q) times the right side; functions that all frames share are not written out for each."""
    if part.elastic is None or part.elastic[1].ndim > 2:
        return np.asarray(rows @ right_side(solved, part))
    size, functions = part.elastic
    out = np.tensordot(rows * -(solved.problem.weights * size)[..., None, :], functions, 1)
    if part.force is not None or part.moment is not None or np.any(part.clamp != 0.0):
        out += rows @ right_side(solved, replace(part, elastic=None))
    return np.asarray(out)


def _of_turn(solved: Equilibrium) -> Array:
    """(T, Q, 1): of the out-of-balance with a common turn: T summed over a uniform turn, less elasticity."""
    problem = solved.problem
    along, _ = pulls(problem, solved.q)
    if problem.follower.shape[1]:  # they turn alike
        cos, sin = np.cos(solved.alpha)[..., None], np.sin(solved.alpha)[..., None]
        along = along - (problem.length * problem.weights) * _turned_followers(problem, solved.q, cos, sin)[..., 0]
    return apply(transposed(problem.to_nodes), along)[..., None]


def _columns(perturbation: Perturbation | Perturbations) -> list[tuple[slice, Perturbation]]:
    """The parts with their places among all parameters."""
    ends = np.cumsum([0, *(len(part.clamp) for part in perturbation.parts)]).tolist()
    return [(slice(a, b), part) for a, b, part in zip(ends[:-1], ends[1:], perturbation.parts, strict=True)]


def _across(alpha: Array, force: Array) -> Array:
    """(T, Q, P) across the tangent, to its left, of (T, Q, 2, P)."""
    return force[..., 1, :] * np.cos(alpha)[..., None] - force[..., 0, :] * np.sin(alpha)[..., None]


def of_force(problem: Problem, at_s: Array) -> Perturbation:
    """Two parameters: the components [N] of a dead force at `at_s`, a number or (T,)."""
    beyond = _beyond(problem, at_s)
    force = beyond[..., None, None] * np.eye(2)
    return Perturbation(force, None, None, np.zeros(2))


def of_moment(problem: Problem, at_s: Array) -> Perturbation:
    """One parameter: a moment [N m] at `at_s`, a number or (T,)."""
    return Perturbation(None, _beyond(problem, at_s)[..., None], None, np.zeros(1))


def of_stiffness(solved: Equilibrium, functions: Array) -> Perturbation:
    """P parameters: coefficients of functions (Q, P) or (T, Q, P) added to k(s) [N m]."""
    problem = solved.problem
    return Perturbation(None, None, (solved.q - problem.q0, functions), np.zeros(functions.shape[-1]))


def of_rest_curvature(problem: Problem, functions: Array) -> Perturbation:
    """P parameters: coefficients of functions (Q, P) added to q0(s) [rad]."""
    return Perturbation(None, None, (-np.atleast_2d(problem.k), functions), np.zeros(functions.shape[-1]))


def of_clamp_angle(problem: Problem) -> Perturbation:  # noqa: ARG001 - it takes what its sisters take
    """One parameter: the clamp's angle [rad], the loads keeping their directions."""
    return Perturbation(None, None, None, np.ones(1))


def of_mass(problem: Problem, functions: Array, gravity: Array) -> Perturbation:
    """P parameters: coefficients of functions (Q, P) added to mu(s) [kg/m] under gravity (T, 2) or (1, 2)."""
    line = problem.length[..., None] * functions  # (Q, P) or (T, Q, P)
    total = np.sum(problem.weights[..., None] * line, axis=-2, keepdims=True)
    beyond = total - problem.to_nodes @ line
    beyond = beyond if beyond.ndim == 3 else beyond[None]
    return Perturbation(beyond[..., None, :] * gravity[:, None, :, None], None, None, np.zeros(functions.shape[-1]))


def clamp_wrench(solved: Equilibrium) -> Array:
    """(T, 3) N, N, N m: force and moment that the clamp puts on the beam."""
    problem, alpha = solved.problem, solved.alpha
    n = internal_force(problem, solved.q)
    across = n[..., 1] * np.cos(alpha) - n[..., 0] * np.sin(alpha)
    lever = np.sum(problem.length * problem.weights * across, axis=-1)
    base = _at_base(problem)
    moment = lever + problem.moment @ base
    return -np.concatenate([np.einsum("q,tqc->tc", base, n), moment[:, None]], axis=1)


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
