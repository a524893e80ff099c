"""A point of a beam that is dragged: the force for each place of the pointer, at once and always on the branch.

A goal inside the map (`reach_map.py`) is a Newton's method away from where the beam stands or from the map; a goal
outside is answered by the map's nearest edge, from where the point slides nearer as long as the force allows it. There
is no search: an answer costs some milliseconds at most, a refusal too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigvalsh

from onebend.blas import one_blas_thread
from onebend.control.reach.continuation import trace
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.newton import solve_goal
from onebend.control.reach.reach_map import Edge, ReachMap
from onebend.control.reach.reachable import best_in_ball
from onebend.control.reach.settings import ReachSettings, checked_goal
from onebend.errors import ControlError
from onebend.records import Array

_TRUST = 0.4  # rad: a step that turns the beam by more anywhere may have left the branch
_SHORTEST_STEP = 1e-3  # of the way to a force of the map's edge
_SHARES = (1.0, 0.5, 0.25, 0.125, 0.03)  # of the way of a hand that cannot go all of it
_ON_GOAL = 1e-6  # m
_SLIDES = 8  # steps towards a goal that Newton's method does not find, or that is out of reach
_LEAST_PROGRESS = 1e-7  # m, of such a step
_AT_BOUND = 0.999  # of the largest force
_OVER = 1.0 + 1e-9  # times a bound


@dataclass(frozen=True)
class DragAnswer:
    """Where the beam stands after a drag."""

    goal: Array  # (2,) m, or (3,) m, m, rad
    pose: Array  # (3,) m, m, rad: the dragged point and the tangent's angle there
    state: LoadedState
    margin: float  # smallest eigenvalue of the scaled tangent: 1 without loads, 0 where the beam loses its stability
    limit: Edge | None  # why the point is not on its goal; None where it is

    @property
    def away(self) -> float:
        """m, of the point from its goal."""
        return float(np.hypot(*(self.pose - self.goal[:3] if len(self.goal) > 3 else self.pose[:2] - self.goal[:2])))


class DraggedPoint:
    """A point that a force at one place leads; it remembers where the beam stands. Not for two threads at once."""

    def __init__(self, pushed: PushedBeam, max_force: float) -> None:
        self.pushed, self.max_force = pushed, max_force
        self.map: ReachMap | None = None  # until it is there only Newton's method answers
        self.state = pushed.start

    @one_blas_thread
    def to(self, goal: ArrayLike) -> DragAnswer:
        """The beam with its point on `goal` (2,) m, or as near as the force may bring it.

        Raises `ControlError` for a goal without meaning.
        """
        wanted = checked_goal(goal, ReachSettings())
        limit: Edge | None = None
        if self.map is None:
            if not (self._solved(self.state, wanted) or self._approach(wanted)):
                limit = "force" if _size(self.state.load) > _AT_BOUND * self.max_force else "stability"
        else:
            place = self.map.locate(wanted, self.state)
            starts = (self.state, place.state, place.near)
            if not (place.inside and any(self._solved(start, wanted) for start in starts)):
                way = trace(self.pushed, place.state.load, start=place.near, shortest=_SHORTEST_STEP)
                self.state, limit = way.states[-1], place.edge
                if limit != "stability":
                    limit = None if self._approach(wanted) else "force"
        return self.answer(wanted, limit)

    @one_blas_thread
    def under(self, force: ArrayLike) -> DragAnswer:
        """The beam under a force (2,) N, reached from rest as it grows; at the last stable shape where there is none.

        Raises `ControlError` for a force without meaning.
        """
        load = np.append(np.asarray(force, dtype=float), 0.0)
        if load.shape != (3,) or not np.isfinite(load).all():
            raise ControlError("a force has two finite components [N]")
        size = _size(load)
        way = trace(self.pushed, load * min(1.0, self.max_force / max(size, 1e-300)), shortest=_SHORTEST_STEP)
        self.state = way.states[-1]
        limit: Edge | None = None if way.arrived and size <= _OVER * self.max_force else "stability"
        return self.answer(self.pushed.pose(self.state.q)[:2], limit)

    def answer(self, goal: Array, limit: Edge | None = None) -> DragAnswer:
        """How the beam stands now."""
        pose = self.pushed.pose(self.state.q)
        return DragAnswer(goal, pose, self.state, stability_margin(self.pushed, self.state), limit)

    def _approach(self, goal: Array) -> bool:
        """Nearer to a goal by forces within the bound, each step followed as an equilibrium; whether it got there."""
        for _ in range(_SLIDES):
            s = self.pushed.response(self.state)[:2, :2]
            away = goal - self.pushed.pose(self.state.q)[:2]
            if not np.isfinite(s).all():
                return False
            now, left = self.state.load[:2], float(np.hypot(*away))
            change = best_in_ball(s, s @ now + away, self.max_force, one_sided=False) - now
            for share in (1.0, 0.3, 0.1):
                way = trace(self.pushed, np.append(now + share * change, 0.0), start=self.state, shortest=0.05)
                there = float(np.hypot(*(goal - self.pushed.pose(way.states[-1].q)[:2])))
                if way.arrived and there < left - _LEAST_PROGRESS:
                    self.state = way.states[-1]
                    break
            else:
                return False
            if self._solved(self.state, goal):
                return True
        return False

    def _solved(self, start: LoadedState, goal: Array) -> bool:
        found = solve_goal(self.pushed, start, goal, most=8, trust=_TRUST)
        if not (found.converged and found.positive) or _size(found.state.load) > _OVER * self.max_force:
            return False
        if not self.pushed.stable(found.state):
            return False
        self.state = found.state
        return True


class HeldEnd:
    """A hand that holds the end s = 1 at a place and an angle. Not for two threads at once."""

    def __init__(self, pushed: PushedBeam, start: LoadedState, max_force: float) -> None:
        """`start`: an equilibrium under a force at the end, which the hand takes over.

        Raises `ControlError` where the beam is not pushed at its end.
        """
        if (pushed.push_s, pushed.point_s) != (1.0, 1.0):
            raise ControlError("a hand holds the end of the beam: s = 1")
        self.pushed, self.state, self.max_force = pushed, start, max_force

    @one_blas_thread
    def to(self, goal: ArrayLike) -> DragAnswer:
        """The beam with its end at `goal` (3,) m, m, rad, or as far on the straight way there as it is stable."""
        wanted = checked_goal(goal, ReachSettings(moment=True))
        if len(wanted) != 3:
            raise ControlError("a hand holds a place and an angle: a goal is (x, y, angle)")
        limit: Edge | None = None
        for _ in range(4):
            before = self.state
            limit = self._step(wanted)
            if float(np.max(np.abs(self.pushed.pose(self.state.q) - wanted))) < _ON_GOAL:
                return self.answer(wanted, None)
            if self.state is before:
                break
        return self.answer(wanted, limit or "stability")

    def answer(self, goal: Array, limit: Edge | None = None) -> DragAnswer:
        """How the beam stands now."""
        pose = self.pushed.pose(self.state.q)
        return DragAnswer(goal, pose, self.state, stability_margin(self.pushed, self.state, held=True), limit)

    def _step(self, wanted: Array) -> Edge | None:
        """One step towards the pose, as long as it may be; what forbids to go on, or None."""
        limit: Edge | None = None
        here = self.pushed.pose(self.state.q)
        for share in _SHARES:
            limit = self._whole_step(here + share * (wanted - here))
            if limit is None:
                return None
        return self._slide(wanted) or limit

    def _slide(self, wanted: Array) -> Edge | None:
        """Along the bound on the force, where the angle is as wanted; "force" where that leads nearer."""
        here = self.pushed.pose(self.state.q)
        s = self.pushed.response(self.state)
        if abs(wanted[2] - here[2]) > 1e-3 or not np.isfinite(s).all() or not s[2, 2] > 0.0:
            return None
        away, now = wanted[:2] - here[:2], self.state.load[:2]
        plane = s[:2, :2] - np.outer(s[:2, 2], s[2, :2]) / s[2, 2]  # the moment keeps the angle
        aim = plane @ (best_in_ball(plane, plane @ now + away, 0.998 * self.max_force, one_sided=False) - now)
        for share in (1.0, 0.3, 0.1):
            goal = np.append(here[:2] + share * aim, here[2])
            nearer = float(np.hypot(*(wanted - goal)[:2])) < float(np.hypot(*away)) - _ON_GOAL
            if nearer and self._whole_step(goal) is None:
                return "force"
        return None

    @one_blas_thread
    def edge(self, directions: int = 36, step: float = 0.04) -> list[tuple[Array, Edge]]:
        """How far the hand gets from here if it goes straight and does not turn: (2,) m, and what ends the way.

        Args:
            directions: in which it goes.
            step: of L, by which it goes; the last is halved three times.
        """
        here, begin, length = self.pushed.pose(self.state.q), self.state, float(self.pushed.problem.length)
        ends: list[tuple[Array, Edge]] = []
        for turn in np.arange(directions) * (2.0 * np.pi / directions):
            way = np.array([math.cos(turn), math.sin(turn), 0.0])
            self.state, gone, stride, limit = begin, 0.0, step * length, "stability"
            while stride > 0.1 * step * length and gone < 2.0 * length:
                before = self.state
                said = self._whole_step(here + (gone + stride) * way)
                if said is None:
                    gone += stride
                else:
                    self.state, limit, stride = before, said, 0.5 * stride
            ends.append((here[:2] + gone * way[:2], "force" if limit == "force" else "stability"))
        self.state = begin
        return ends

    def _whole_step(self, pose: Array) -> Edge | None:
        found = solve_goal(self.pushed, self.state, pose, 3, most=8, trust=_TRUST)
        if not found.converged or stability_margin(self.pushed, found.state, held=True) <= 0.0:
            return "stability"
        if _size(found.state.load) > _OVER * self.max_force:
            return "force"
        self.state = found.state
        return None


def stability_margin(pushed: PushedBeam, state: LoadedState, *, held: bool = False) -> float:
    """The smallest eigenvalue of the scaled tangent; `held`: on changes that leave the end's pose as it is.

    Without loads it is 1 whatever k(s); at 0 the beam buckles or falls.
    """
    _, tangent, cos, sin = pushed.balance(state.q, state.load)
    scale = 1.0 / np.sqrt(pushed.stiff)
    matrix = scale[:, None] * np.tril(tangent) * scale
    matrix = matrix + np.tril(matrix, -1).T
    if held:
        _, sizes, rows = np.linalg.svd(pushed.of_shape(cos, sin) * scale)
        free = rows[int(np.sum(sizes > 1e-9 * sizes[0])) :]
        matrix = free @ matrix @ free.T
    return float(eigvalsh(matrix, subset_by_index=[0, 0])[0])


def _size(load: Array) -> float:
    return math.hypot(float(load[0]), float(load[1]))
