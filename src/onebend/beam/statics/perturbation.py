"""How parameters enter the balance of moments and, past it, the places of a beam that stretches and shears."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.nodal_forces import turned_followers
from onebend.records import Array, IntArray


@dataclass(frozen=True)
class Perturbation:
    """P parameters: derivatives of what enters the balance, at the nodes of T frames. Ones may stand for T.

    None where nothing of the kind changes.
    """

    force: Array | None  # (T, Q, 2, P) N per unit: of the dead force beyond each node
    moment: Array | None  # (T, Q, P) N m per unit: of the moment beyond each node
    elastic: tuple[Array, Array] | None  # of k (q - q0) at fixed q: (T, Q) times functions (Q, P) or (T, Q, P), N m
    clamp: Array  # (P,) rad per unit
    # of 1/EA and 1/kGA: (Q,) or (T, Q) each, times functions (Q, P) or (T, Q, P), 1/N
    compliance: tuple[tuple[Array, Array], Array] | None = None

    @property
    def parts(self) -> tuple[Perturbation, ...]:
        """Itself, as `Perturbations` has it."""
        return (self,)

    @property
    def columns(self) -> list[tuple[slice, Perturbation]]:
        """Itself with its place, as `Perturbations` has it."""
        return [(slice(0, len(self.clamp)), self)]

    def __add__(self, other: Perturbation | Perturbations) -> Perturbations:
        """Both sets of parameters, one after the other."""
        return Perturbations(self.parts + other.parts)

    def take(self, chosen: IntArray) -> Perturbation:
        """At some of the frames."""

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

    def take(self, chosen: IntArray) -> Perturbations:
        """At some of the frames."""
        return Perturbations(tuple(part.take(chosen) for part in self.parts))

    @cached_property
    def columns(self) -> list[tuple[slice, Perturbation]]:
        """The parts with their places among all parameters."""
        ends = [0, *accumulate(len(part.clamp) for part in self.parts)]
        return [(slice(a, b), part) for a, b, part in zip(ends[:-1], ends[1:], self.parts, strict=True)]


def minus_gradient(solved: Equilibrium, perturbation: Perturbation | Perturbations) -> Array:
    """(T, Q, P): minus the derivative of the balance's gradient with the parameters at fixed q."""
    problem = solved.problem
    out = np.zeros((*solved.q.shape, len(perturbation.clamp)))
    for columns, part in perturbation.columns:
        turning = work_by_angle(solved, part)
        if turning is not None:
            out[..., columns] += transposed(problem.to_nodes) @ turning
        if part.moment is not None:
            out[..., columns] += problem.weights[..., None] * part.moment
        if part.elastic is not None:
            size, functions = part.elastic
            out[..., columns] -= (problem.weights * size)[..., None] * functions
        if np.any(part.clamp != 0.0):
            out[..., columns] -= _by_turn(solved) * part.clamp
    return out


def work_by_angle(solved: Equilibrium, part: Perturbation) -> Array | None:
    """(T, Q, P) N m per unit: of `w dW/dalpha` at the nodes, at fixed angles; None where force and strain stay."""
    problem, out = solved.problem, None
    if part.force is not None:
        lw = (problem.length * problem.weights)[..., None]
        out = lw * _dot(solved.forces.lever, part.force)
    if part.compliance is not None:
        size, functions = _twisted(solved, part.compliance)
        strained = size[..., None] * functions
        out = strained if out is None else out + strained
    return out


def adjoint_times(rows: Array, solved: Equilibrium, part: Perturbation) -> Array:
    """(T, S, P): rows (T, S, Q) times `minus_gradient`; functions that frames share are not written out for each."""
    out, elastic, compliance = np.zeros((*rows.shape[:-1], len(part.clamp))), part.elastic, part.compliance
    if elastic is not None and elastic[1].ndim == 2:
        out += _times(rows * -(solved.problem.weights * elastic[0])[..., None, :], elastic[1])
        elastic = None
    if compliance is not None and compliance[1].ndim == 2:
        size, functions = _twisted(solved, compliance)
        out += _times((rows @ transposed(solved.problem.to_nodes)) * size[..., None, :], functions)
        compliance = None
    rest = Perturbation(part.force, part.moment, elastic, part.clamp, compliance)
    entries = (rest.force, rest.moment, elastic, compliance)
    if any(entry is not None for entry in entries) or np.any(rest.clamp != 0.0):
        out += rows @ minus_gradient(solved, rest)
    return out


def _times(rows: Array, functions: Array) -> Array:
    """(T, S, P): rows (T, S, Q) times functions (Q, P), in one product."""
    return np.asarray((rows.reshape(-1, rows.shape[-1]) @ functions).reshape(*rows.shape[:-1], functions.shape[-1]))


def moved_by_strain(solved: Equilibrium, rows: Array, part: Perturbation) -> Array | None:
    """(T, S, 2, P) m per unit: how places move by strain alone, all angles kept; `rows` (S, Q) or (T, S, Q) m
    integrate r'. None where they stay."""
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


def followers_turned(solved: Equilibrium) -> Array:
    """(T, c, Q, 2) N per rad: of the internal force with the angle where each follower acts."""
    _, turning = turned_followers(solved.problem, solved.q)
    return np.asarray(turning[:, :, None] * solved.problem.follower_beyond[..., None])


def _twisted(solved: Equilibrium, compliance: tuple[tuple[Array, Array], Array]) -> tuple[Array, Array]:
    """(T, Q) and functions: of `w dW/dalpha = L w Q (1 + (1/EA - 1/kGA) N)` with the compliance."""
    (stretch, shear), functions = compliance
    problem = solved.problem
    normal, transverse = solved.normal_and_shear
    return problem.length * problem.weights * (stretch - shear) * normal * transverse, functions


def _by_turn(solved: Equilibrium) -> Array:
    """(T, Q, 1): of the gradient with a common turn: T summed over a uniform turn, less elasticity."""
    problem = solved.problem
    along = solved.forces.along
    if problem.follower.shape[1]:  # they turn alike
        force = np.sum(followers_turned(solved), axis=1)[..., None]
        along = along - (problem.length * problem.weights) * _dot(solved.forces.lever, force)[..., 0]
    return apply(transposed(problem.to_nodes), along)[..., None]


def _dot(way: Array, force: Array) -> Array:
    """(T, Q, P) of ways (T, Q, 2) and forces (T, Q, 2, P)."""
    return force[..., 1, :] * way[..., 1, None] + force[..., 0, :] * way[..., 0, None]
