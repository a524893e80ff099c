"""Derivatives of an equilibrium by the implicit function theorem: `dq/dp = -T^-1 dg/dp`, T the tangent.

Perturbations add with `+` and share one factorisation, for the parameters or, if fewer, for the quantities asked for
(adjoint method).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.problem import Problem
from onebend.beam.statics import Equilibrium, tangent
from onebend.records import Array, IntArray


class _Joined:
    """Sets of parameters, one after the other."""

    parts: tuple[Perturbation, ...]

    def __add__(self, other: Perturbation | Perturbations) -> Perturbations:
        return Perturbations(self.parts + other.parts)

    @cached_property
    def columns(self) -> list[tuple[slice, Perturbation]]:
        """Parts with their slices of all parameters."""
        ends = [0, *accumulate(len(part.clamp) for part in self.parts)]
        return [(slice(a, b), part) for a, b, part in zip(ends[:-1], ends[1:], self.parts, strict=True)]


@dataclass(frozen=True)
class Perturbation(_Joined):
    """P parameters: derivatives of what enters the balance, at the nodes of T frames (or 1 for all). None:
    unchanged."""

    force: Array | None  # (T, Q, 2, P) N per unit: dead force beyond each node
    moment: Array | None  # (T, Q, P) N m per unit: moment beyond each node
    elastic: tuple[Array, Array] | None  # k (q - q0) at fixed q: (T, Q) times functions (Q, P) or (T, Q, P), N m
    clamp: Array  # (P,) rad per unit
    # 1/EA and 1/kGA: (Q,) or (T, Q) each, times functions (Q, P) or (T, Q, P), 1/N
    compliance: tuple[tuple[Array, Array], Array] | None = None

    @property
    def parts(self) -> tuple[Perturbation, ...]:  # type: ignore[override]
        return (self,)

    def take(self, chosen: IntArray) -> Perturbation:

        def pick(x: Array, plain: int) -> Array:
            return x[chosen] if x.ndim > plain and len(x) > 1 else x

        elastic, compliance = self.elastic, self.compliance
        if elastic is not None:
            elastic = pick(elastic[0], 1), pick(elastic[1], 2)
        if compliance is not None:
            (stretch, shear), functions = compliance
            compliance = (pick(stretch, 1), pick(shear, 1)), pick(functions, 2)
        return Perturbation(
            None if self.force is None else pick(self.force, 3),
            None if self.moment is None else pick(self.moment, 2),
            elastic,
            self.clamp,
            compliance,
        )


@dataclass(frozen=True)
class Perturbations(_Joined):
    parts: tuple[Perturbation, ...]

    @property
    def clamp(self) -> Array:
        return np.concatenate([part.clamp for part in self.parts])

    def take(self, chosen: IntArray) -> Perturbations:
        return Perturbations(tuple(part.take(chosen) for part in self.parts))


def minus_gradient(solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Array:
    """(T, Q, P): minus the gradient's derivative by the parameters at fixed q."""
    out, by_angle = np.zeros((*solved.q.shape, len(perturbation.clamp))), transposed(solved.problem.to_nodes)
    for columns, part in perturbation.columns:
        for turns, size, functions in _work(solved, part):
            change = size[..., None] * functions
            out[..., columns] += by_angle @ change if turns else change
        if np.any(part.clamp != 0.0):
            out[..., columns] -= _by_turn(solved) * part.clamp
    return out


def _work(solved: Equilibrium, part: Perturbation) -> Iterator[tuple[bool, Array, Array]]:
    """What the parameters change in `w dW/dalpha` (True) or directly in the balance of each node (False), at fixed
    shapes and clamp: (Q,) or (T, Q) times functions (Q, P) or (T, Q, P), N m per unit."""
    problem = solved.problem
    if part.force is not None:
        yield True, problem.length * problem.weights, _dot(solved.forces.lever, part.force)
    if part.compliance is not None:  # L w Q (1 + (1/EA - 1/kGA) N)
        ((stretch, shear), functions), (normal, transverse) = part.compliance, solved.normal_and_shear
        yield True, problem.length * problem.weights * (stretch - shear) * normal * transverse, functions
    if part.moment is not None:
        yield False, problem.weights, part.moment
    if part.elastic is not None:
        yield False, -problem.weights * part.elastic[0], part.elastic[1]


def adjoint_times(rows: Array, solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Array:
    """(T, S, P): rows (T, S, Q) times `minus_gradient`, without expanding functions that frames share."""
    out, turned = np.zeros((*rows.shape[:-1], len(perturbation.clamp))), rows @ transposed(solved.problem.to_nodes)
    for columns, part in perturbation.columns:
        for turns, size, functions in _work(solved, part):
            out[..., columns] += _times((turned if turns else rows) * size[..., None, :], functions)
        if np.any(part.clamp != 0.0):
            out[..., columns] -= (rows @ _by_turn(solved)) * part.clamp
    return out


def _times(rows: Array, functions: Array) -> Array:
    """(T, S, P): rows (T, S, Q) times functions (Q, P) or (T, Q, P)."""
    if functions.ndim == 3:
        return np.asarray(rows @ functions)
    return np.asarray((rows.reshape(-1, rows.shape[-1]) @ functions).reshape(*rows.shape[:-1], functions.shape[-1]))


def _moved_by_strain(solved: Equilibrium, rows: Array, part: Perturbation) -> Array | None:
    """(T, S, 2, P) m per unit: motion by strain at fixed angles; `rows` (S, Q) or (T, S, Q) m integrate r'. None
    without."""
    problem, out = solved.problem, None
    if part.force is not None and problem.compliance is not None:
        by_force, force = solved.strain_by_force, part.force
        strained = by_force[..., :1] * force[..., :1, :] + by_force[..., 1:] * force[..., 1:, :]  # (T, Q, 2, P)
        flat = rows @ strained.reshape(*strained.shape[:2], -1)
        out = flat.reshape(*flat.shape[:2], *strained.shape[2:])
    if part.compliance is not None:
        size, functions = part.compliance
        way = solved.strained if size is problem.compliance else solved.strained_by(size)
        by_node = rows[..., None, :] * transposed(way)[:, None]
        more = by_node @ (functions if functions.ndim == 2 else functions[:, None])
        out = more if out is None else out + more
    return out


def _by_turn(solved: Equilibrium) -> Array:
    """(T, Q, 1): gradient by a common turn."""
    return apply(transposed(solved.problem.to_nodes), solved.forces.along)[..., None]


def _dot(way: Array, force: Array) -> Array:
    return force[..., 1, :] * way[..., 1, None] + force[..., 0, :] * way[..., 0, None]


@dataclass(frozen=True)
class Response:
    """Derivatives of equilibria by P parameters."""

    solved: Equilibrium
    perturbation: Perturbation | Perturbations

    @cached_property
    def q(self) -> Array:
        """(T, Q, P) rad per unit."""
        right = minus_gradient(self.solved, self.perturbation)
        return solve_each(tangent(self.solved.problem, self.solved.q), right)

    def poses(self, s: Array) -> Array:
        """(T, S, 3, P) m, m, rad per unit, at `s` (S,) or (T, S)."""
        integral = self.solved.problem.grid.integral_to(s)
        moved, turned = self._ways(integral)
        angle = np.broadcast_to(integral, (len(self.solved.q), *integral.shape[-2:]))[:, :, None]
        ones = np.ones((*moved.shape[:2], 1))
        out = self._derivative_of(np.concatenate([moved, angle], axis=2), np.concatenate([turned, ones], axis=-1))
        self._add_strain(out[:, :, :2], integral)
        return out

    def xy(self, s: Array) -> Array:
        """(T, S, 2, P) m per unit."""
        integral = self.solved.problem.grid.integral_to(s)
        out = self._derivative_of(*self._ways(integral))
        self._add_strain(out, integral)
        return out

    def _ways(self, integral: Array) -> tuple[Array, Array]:
        """(T, S, 2, Q) m: positions by the curvature; (T, S, 2) m: by a common turn. `integral` (S, Q) or (T, S, Q)
        integrates from 0 to the places."""
        problem = self.solved.problem
        rows = problem.length[..., None] * integral
        ways = self.solved.forces.lever
        turning = np.stack([ways[:, None, :, 0] * rows, ways[:, None, :, 1] * rows], axis=-2)
        b = problem.to_nodes
        return turning @ (b if b.ndim == 2 else b[:, None]), np.sum(turning, axis=-1)

    def _derivative_of(self, rows: Array, turned: Array) -> Array:
        """(T, ..., P) of quantities with derivatives `rows` (T, ..., Q) by curvature and `turned` (T, ...) by the
        clamp.

        If these are fewer than the parameters, T is solved for them: `rows T^-1 right = (T^-T rows^T)^T right`.
        """
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        clamp = self.perturbation.clamp
        if flat.shape[1] >= len(clamp):
            out = flat @ self.q
        else:
            matrices = tangent(self.solved.problem, self.solved.q, forces=self.solved.forces)
            adjoint = transposed(solve_each(transposed(matrices), transposed(flat)))
            out = adjoint_times(adjoint, self.solved, self.perturbation)
        out = out.reshape(*rows.shape[:-1], len(clamp))
        return out + turned[..., None] * clamp if np.any(clamp != 0.0) else out

    def _add_strain(self, out: Array, integral: Array) -> None:
        """Adds the motion (T, S, 2, P) by strain."""
        rows = self.solved.problem.length[..., None] * integral
        for columns, part in self.perturbation.columns:
            moved = _moved_by_strain(self.solved, rows, part)
            if moved is not None:
                out[..., columns] += moved


def respond(solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Response:
    """Derivatives by all parameters of `perturbation`, computed on demand; NaN at a limit point (singular tangent)."""
    return Response(solved, perturbation)


def of_force(problem: Problem, at_s: Array) -> Perturbation:
    """Two parameters: components [N] of a dead force at `at_s`, a number or (T,)."""
    beyond = _beyond(problem, at_s)
    force = beyond[..., None, None] * np.eye(2)
    return Perturbation(force, None, None, np.zeros(2))


def of_moment(problem: Problem, at_s: Array) -> Perturbation:
    """A moment [N m] at `at_s`, a number or (T,)."""
    return Perturbation(None, _beyond(problem, at_s)[..., None], None, np.zeros(1))


def of_stiffness(solved: Equilibrium, functions: Array) -> Perturbation:
    """Coefficients of functions (Q, P) or (T, Q, P) added to k(s) [N m]; a `section`'s 1/EA and 1/kGA follow."""
    problem, section, compliance = solved.problem, solved.problem.section, None
    if section is not None and problem.compliance is not None:
        compliance = problem.compliance, section.log_by_stiffness(problem.k, problem.weights, functions)
    return Perturbation(None, None, (solved.q - problem.q0, functions), np.zeros(functions.shape[-1]), compliance)


def of_rest_curvature(problem: Problem, functions: Array) -> Perturbation:
    """Coefficients of functions (Q, P) added to q0(s) [rad]."""
    return Perturbation(None, None, (-np.atleast_2d(problem.k), functions), np.zeros(functions.shape[-1]))


def of_clamp_angle(problem: Problem) -> Perturbation:  # noqa: ARG001 - it takes what its sisters take
    """The clamp's angle [rad] under fixed loads."""
    return Perturbation(None, None, None, np.ones(1))


def of_mass(problem: Problem, functions: Array, gravity: Array) -> Perturbation:
    """Coefficients of functions (Q, P) added to mu(s) [kg/m] under gravity (T, 2) or (1, 2)."""
    line = problem.length[..., None] * functions  # (Q, P) or (T, Q, P)
    total = np.sum(problem.weights[..., None] * line, axis=-2, keepdims=True)
    beyond = total - problem.to_nodes @ line
    beyond = beyond if beyond.ndim == 3 else beyond[None]
    return Perturbation(beyond[..., None, :] * gravity[:, None, :, None], None, None, np.zeros(functions.shape[-1]))


def _beyond(problem: Problem, at_s: Array) -> Array:
    """(T or 1, Q): 1 where `at_s` lies beyond the node. Exact with a grid edge at `at_s`."""
    places = np.atleast_1d(np.asarray(at_s, dtype=float))[:, None]
    return np.asarray(problem.grid.nodes < places, dtype=float)
