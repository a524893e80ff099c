"""Actuators on a beam, and the equilibria they can hold: a smooth surface with as many dimensions as controls.

A pusher applies a dead force with two components at one place. A grip holds the end s = 1 at a pose; its load is a
wrench with three components. In both cases equilibrium is

    g(q, u) = g0(q) - A(q)^T u = 0,

u: forces and wrench; A: derivative of the places where they act. With forces alone, the surface (q, u) is a graph over
u as long as the beam is stable. A gripped beam can be stable where a beam under the same dead wrench has buckled. Its
surface is not everywhere a graph over wrench or pose (a straight beam at rest does not yield to an axial pull). So
steps are taken in the surface's tangent plane and then corrected at right angles to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.clamped_ends.end_pose import end_jacobian, end_pose
from onebend.beam.loads import Loads, push, weight
from onebend.beam.statics.continuation import equilibrium
from onebend.beam.statics.equilibrium import Equilibrium, balance, scaled, tangent
from onebend.beam.statics.problem import Problem, Resolution, make_problem
from onebend.beam.statics.rod import Rod, refuse_section
from onebend.errors import ControlError
from onebend.records import Array

_LAST_UPDATE = 1e-11  # rad, of a correction's last update
_MOST_ITERATIONS = 12  # Newton iterations of a correction
_RANK_TOLERANCE = 1e-9  # share of the largest singular value below which one is nothing


@dataclass(frozen=True)
class Pusher:
    """An actuator that pushes at `at_s` with a force no larger than `max_force` [N]."""

    at_s: float = 1.0
    max_force: float = np.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.at_s <= 1.0:
            raise ControlError(f"a push acts at s in (0, 1], got {self.at_s:g}")
        if not self.max_force > 0.0:
            raise ControlError(f"the largest force must be positive, got {self.max_force:g} N")


@dataclass(frozen=True)
class Grip:
    """An actuator that holds the end s = 1 at a position and an angle; its force and moment may be bounded."""

    max_force: float = np.inf  # N
    max_moment: float = np.inf  # N m

    def __post_init__(self) -> None:
        if not (self.max_force > 0.0 and self.max_moment > 0.0):
            raise ControlError(f"a grip's limits must be positive, got {self.max_force:g} N, {self.max_moment:g} N m")


@dataclass(frozen=True)
class LoadBound:
    """`|u[columns]| <= most`."""

    columns: slice
    most: float
    name: str


@dataclass(frozen=True)
class Actuators:
    """All actuators on one beam. Controls u: the pushers' forces in turn, then the grip's force and moment."""

    problem: Problem  # one frame, under the weight alone; an edge at every push
    pushes: tuple[Pusher, ...]
    grip: Grip | None

    @property
    def count(self) -> int:
        """m, the number of controls."""
        return 2 * len(self.pushes) + (0 if self.grip is None else 3)

    @property
    def scale(self) -> Array:
        """(m,) N, N m: the controls' natural units, mean k over L and mean k."""
        stiff = self.mean_stiffness
        forces = np.full(2 * len(self.pushes) + (0 if self.grip is None else 2), stiff / float(self.problem.length))
        return forces if self.grip is None else np.append(forces, stiff)

    @cached_property
    def mean_stiffness(self) -> float:
        """N m."""
        return float(np.sum(self.problem.weights * self.problem.k))

    @cached_property
    def beyond(self) -> Array:
        """(m, Q) 1 where a control acts beyond the node."""
        rows = [np.repeat((self.problem.grid.nodes < pusher.at_s)[None], 2, axis=0) for pusher in self.pushes]
        return np.concatenate([*rows, *([] if self.grip is None else [np.ones((3, len(self.problem.weights)))])])

    @property
    def bounds(self) -> tuple[LoadBound, ...]:
        """The limits that are finite."""
        every = [
            LoadBound(slice(2 * i, 2 * i + 2), pusher.max_force, f"force at s = {pusher.at_s:g}")
            for i, pusher in enumerate(self.pushes)
        ]
        if self.grip is not None:
            a = 2 * len(self.pushes)
            every.append(LoadBound(slice(a, a + 2), self.grip.max_force, "the gripper's force"))
            every.append(LoadBound(slice(a + 2, a + 3), self.grip.max_moment, "the gripper's moment"))
        return tuple(bound for bound in every if np.isfinite(bound.most))

    def loaded(self, u: Array) -> Problem:
        """The problem with the controls u (T, m) as dead loads."""
        p, last = self.problem, self.count if self.grip is None else self.count - 1
        force = np.stack([u[:, i:last:2] @ self.beyond[i:last:2] for i in (0, 1)], axis=-1)
        moment = p.moment + (0.0 if self.grip is None else u[:, -1:])
        return replace(p, dead_force=p.dead_force + force, moment=np.broadcast_to(moment, force.shape[:2]))

    def solved(self, q: Array, u: Array) -> Equilibrium:
        """Known equilibria q (T, Q) under the controls u (T, m), as the mechanics has them."""
        yes, ones = np.ones(len(q), dtype=bool), np.ones(len(q))
        return Equilibrium(self.loaded(u), q, yes, yes, ones, np.nan * ones, ~yes, 0)


@dataclass(frozen=True)
class BeamState:
    """One equilibrium of the beam under its actuators."""

    actuators: Actuators
    q: Array  # (Q,)
    u: Array  # (m,)

    @cached_property
    def solved(self) -> Equilibrium:
        """The equilibrium with the controls as dead loads. For stability see `margin`."""
        return self.actuators.solved(self.q[None], self.u[None])

    @cached_property
    def tangent(self) -> Array:
        """(Q, Q), scaled: `D T D`, D = 1 / sqrt(w k)."""
        return np.asarray(scaled(self.solved.problem, tangent(self.solved.problem, self.q[None]))[0])

    @cached_property
    def actions(self) -> Array:
        """(m, Q), scaled: `A D`, rows over the controls' units so that they are numbers about 1."""
        return np.asarray(actions(self.actuators, self.solved)[0] * self.unbend)

    @property
    def unbend(self) -> Array:
        """(Q,) D: scaled curvature to curvature."""
        problem = self.actuators.problem
        return np.asarray(1.0 / np.sqrt(problem.weights * problem.k))

    @cached_property
    def plane(self) -> tuple[Array, Array]:
        """(Q, m) and (m, m): how curvature [rad] and controls [N, N m] change along the tangent plane.

        Orthonormal in curvature over `sqrt(mean k)` with weights `w k`, and in controls over their units.
        """
        unit = self.actuators.scale / np.sqrt(self.actuators.mean_stiffness)
        rows = np.concatenate([self.tangent, -(self.actions.T * unit)], axis=1)
        basis = np.linalg.qr(rows.T, mode="complete")[0][:, len(self.q) :]
        root = np.sqrt(self.actuators.mean_stiffness)
        return root * self.unbend[:, None] * basis[: len(self.q)], self.actuators.scale[:, None] * basis[len(self.q) :]

    @cached_property
    def margin(self) -> float:
        """The smallest eigenvalue of the scaled tangent, on changes that leave a gripped end where it is.

        1 without loads whatever k(s); 0 where the beam buckles. Were all loads to grow with the shape as it is, it
        would buckle at `1 / (1 - margin)` times them.
        """
        matrix = self.tangent
        if self.actuators.grip is not None:
            _, sizes, rows = np.linalg.svd(self.actions[-3:])  # of a straight beam, nothing moves the end along it
            free = rows[int(np.sum(sizes > _RANK_TOLERANCE * sizes[0])) :]
            matrix = free @ matrix @ free.T
        return float(np.linalg.eigvalsh(matrix)[0])

    @property
    def end(self) -> Array:
        """(3,) x, y [m] and angle of the end s = 1."""
        return np.asarray(end_pose(self.actuators.problem, self.q[None])[0])


def actions(actuators: Actuators, solved: Equilibrium) -> Array:
    """(T, m, Q) A: derivative of the pushed places' positions and the gripped end's pose with the curvature."""
    problem, alpha = solved.problem, solved.alpha
    count = 2 * len(actuators.pushes)
    turning = np.empty((len(alpha), count, alpha.shape[1]))
    lw = problem.length * problem.weights * actuators.beyond[:count:2]
    turning[:, 0::2], turning[:, 1::2] = -lw * np.sin(alpha)[:, None], lw * np.cos(alpha)[:, None]
    rows = turning @ problem.to_nodes
    if actuators.grip is None:
        return np.asarray(rows)
    return np.asarray(np.concatenate([rows, end_jacobian(problem, solved.q)], axis=1))


def resting_state(
    beam: Rod, pushes: tuple[Pusher, ...], grip: Grip | None, gravity: ArrayLike | None, resolution: Resolution
) -> BeamState:
    """The beam under its weight, with actuators that do nothing.

    Raises:
        ControlError: no actuator, or a beam that buckles under its own weight.
        MechanicsError: the beam has a thickness: stretch and shear are not known here.
    """
    if not pushes and grip is None:
        raise ControlError("no actuator on the beam: give a push or a grip")
    loads = sum((push((0.0, 0.0), pusher.at_s) for pusher in pushes), Loads())
    if gravity is not None:
        loads = loads + weight(gravity)
    refuse_section(beam, "the search for a shape")
    actuators = Actuators(make_problem(beam, loads, resolution), pushes, grip)
    solved = equilibrium(beam, loads, resolution=resolution)
    if not solved.stable[0]:
        raise ControlError("the beam buckles under its own weight; there is no stable shape at rest to start from")
    return BeamState(actuators, solved.q[0], np.zeros(actuators.count))


def next_state(state: BeamState, z: Array, trust: float) -> BeamState | None:
    """The equilibrium after a step z (m,) in the tangent plane; None if none was found within `trust` rad.

    With forces alone the controls are the step's end, exactly; with a grip the way back is square to the plane.
    """
    actuators, (dq, du) = state.actuators, state.plane
    q, u, count = state.q + dq @ z, state.u + du @ z, len(state.q)
    problem, unit, root = actuators.problem, actuators.scale, np.sqrt(actuators.mean_stiffness)
    begin = q
    sides = np.zeros((actuators.count, count + actuators.count))
    if actuators.grip is None:
        sides[:, count:] = np.eye(actuators.count)
    else:
        sides[:, :count], sides[:, count:] = (dq / (root * state.unbend[:, None])).T, (du / unit[:, None]).T
    for _ in range(_MOST_ITERATIONS):
        here = BeamState(actuators, q, u)
        out, matrix = balance(here.solved.problem, q[None])
        scale = here.unbend
        top = np.concatenate([scaled(here.solved.problem, matrix)[0], -here.actions.T * (unit / root)], axis=1)
        right = np.append(-out[0] * scale / root, np.zeros(actuators.count))
        try:
            step = np.linalg.solve(np.concatenate([top, sides]), right)
        except np.linalg.LinAlgError:
            return None
        change = root * scale * step[:count]
        q, u = q + change, u + unit * step[count:]
        if not np.max(np.abs(problem.to_nodes @ (q - begin))) < trust:
            return None
        if np.max(np.abs(problem.to_nodes @ change)) < _LAST_UPDATE:
            return BeamState(actuators, q, u)
    return None


def state_on_grid(state: BeamState, beam: Rod, gravity: ArrayLike | None, resolution: Resolution) -> BeamState | None:
    """The same equilibrium on another grid; None where it is not close by."""
    finer = resting_state(beam, state.actuators.pushes, state.actuators.grip, gravity, resolution)
    grid = state.actuators.problem.grid
    start = BeamState(finer.actuators, grid.value_at(finer.actuators.problem.grid.nodes) @ state.q, state.u)
    return next_state(start, np.zeros(start.actuators.count), 0.05)
