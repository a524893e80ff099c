"""The reachable set of a point of a beam: its positions under all forces at one place, up to a bound.

Forces are sampled by direction and size; each shape is the equilibrium on the branch that grows from rest while the
force grows in proportion, and counts only where it is stable. The nearest point to a goal is then found exactly, from
the nearest samples on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.problem import Resolution, make_problem
from onebend.blas import one_blas_thread
from onebend.control.goals.targets import numbers
from onebend.control.reach.continuation import trace
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam, prepared
from onebend.errors import ControlError
from onebend.records import Array, BoolArray

_START_SAMPLES = 4  # samples from which the nearest point is sought
_MOST_STEPS = 60  # steps of the search
_LEAST_PROGRESS = 1e-9  # of L: a step that brings the point no nearer than this ends the search
_SHORTEST_STEP, _SHORTEST_FOLLOW = 1e-4, 1e-3  # of a step of the search, and of those by which the shape follows it


@dataclass(frozen=True)
class NearestPoint:
    """The reachable point nearest to a goal."""

    point: Array  # (2,) m
    force: Array  # (2,) N that holds it there
    distance: float  # m, to the goal
    states: tuple[LoadedState, ...]  # equilibria that lead there from rest, one after the other

    @property
    def size(self) -> float:
        """N."""
        return float(np.hypot(*self.force))


@dataclass(frozen=True)
class ReachableSet:
    """Places of a point under forces at one place: D directions, R sizes, the largest last."""

    pushed: PushedBeam
    max_force: float  # N
    max_curvature: float | None  # 1/m, beyond that at rest
    force: Array  # (D, R, 2) N
    points: Array  # (D, R, 2) m; NaN where the beam has no stable shape on the branch, or is bent too much
    q: Array  # (D, R, n) rad, the shapes

    @property
    def reached(self) -> BoolArray:
        """(D, R) whether the force holds the point anywhere."""
        return np.isfinite(self.points[..., 0])

    @one_blas_thread
    def nearest(self, goal: ArrayLike) -> NearestPoint:
        """The reachable point nearest to `goal` (2,) m, sought from the nearest samples and from rest.

        It is exact within the bound on the force; where stability or the bound on curvature is the limit, a nearer
        point may exist.
        """
        wanted = np.asarray(goal, dtype=float)
        if wanted.shape != (2,) or not np.all(np.isfinite(wanted)):
            raise ControlError(f"a goal has two finite coordinates [m], got {numbers(wanted)}")
        trails = [trace(self.pushed, sample.load) for sample in self.samples_near(wanted, _START_SAMPLES)]
        ways = [(self.pushed.start,), *(trail.states for trail in trails if trail.arrived)]
        return min((self._refine(way, wanted) for way in ways), key=lambda point: point.distance)

    def samples_near(self, goal: Array, count: int) -> list[LoadedState]:
        """Up to `count` sampled equilibria, those with the point nearest to `goal` first."""
        away = np.linalg.norm(self.points - goal, axis=-1).ravel()
        order = [int(i) for i in np.argsort(away)[:count] if np.isfinite(away[i])]
        q, force = self.q.reshape(-1, self.q.shape[-1]), self.force.reshape(-1, 2)
        return [LoadedState(q[i], np.append(force[i], 0.0)) for i in order]

    def _refine(self, way: tuple[LoadedState, ...], goal: Array) -> NearestPoint:
        """Gauss-Newton in the disc of allowed forces; every step is followed as an equilibrium."""
        pushed, length, state = self.pushed, float(self.pushed.problem.length), way[-1]
        point = pushed.pose(state.q)[:2]
        along = self._only_direction()
        for _ in range(_MOST_STEPS):
            away, share, better = float(np.linalg.norm(goal - point)), 1.0, False
            s = pushed.response(state)[:2, :2] @ along
            if away < _LEAST_PROGRESS * length or not np.all(np.isfinite(s)):
                break
            now = along.T @ state.load[:2]
            aim = best_in_ball(s, s @ now + goal - point, self.max_force, one_sided=along.shape[1] == 1)
            while share > _SHORTEST_STEP and not better:
                load = np.append(along @ (now + share * (aim - now)), 0.0)
                trail = trace(pushed, load, start=state, shortest=_SHORTEST_FOLLOW)
                there = float(np.linalg.norm(goal - pushed.pose(trail.states[-1].q)[:2]))
                better = trail.arrived and self._allowed(trail.states[-1]) and there < away - _LEAST_PROGRESS * length
                share *= 0.5
            if not better:
                break
            way, state = (*way, *trail.states[1:]), trail.states[-1]
            point = pushed.pose(state.q)[:2]
        return NearestPoint(point, state.load[:2], float(np.linalg.norm(goal - point)), way)

    def _only_direction(self) -> Array:
        """(2, P) the forces that may be given: both components, or one direction."""
        if len(self.force) > 1:
            return np.eye(2)
        return np.asarray(self.force[0, -1] / self.max_force)[:, None]

    def _allowed(self, state: LoadedState) -> bool:
        return self.max_curvature is None or self.pushed.bend(state.q) <= self.max_curvature


@one_blas_thread
def reachable(
    beam: Beam,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    max_force: float,
    max_curvature: float | None = None,
    direction: float | None = None,
    directions: int = 72,
    sizes: int = 12,
    gravity: ArrayLike = (0.0, 0.0),
) -> ReachableSet:
    """Where forces up to `max_force` [N] at `push_s` can hold the point at `point_s`.

    Args:
        max_curvature: 1/m beyond the curvature at rest that the beam may take anywhere.
        direction: rad; only forces in this direction.
        directions, sizes: of the sampled forces; sizes grow evenly.
        gravity: (2,) m/s^2 in the beam's frame.

    Raises:
        ControlError: a place or bound without meaning.
    """
    if not (max_force > 0.0 and np.isfinite(max_force)):
        raise ControlError(f"the largest force must be positive, got {max_force:g} N")
    if max_curvature is not None and not max_curvature > 0.0:
        raise ControlError(f"the largest curvature must be positive, got {max_curvature:g} 1/m")
    if directions < 3 or sizes < 1:
        raise ControlError(f"at least 3 directions and 1 size are sampled, got {directions} and {sizes}")
    x, y = np.asarray(gravity, dtype=float).tolist()
    pushed = prepared(beam, push_s, point_s, (x, y), Resolution())
    turns = np.arange(directions) * (2.0 * np.pi / directions) if direction is None else np.array([direction])
    grow = max_force * np.arange(1, sizes + 1) / sizes
    force = grow[None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)[:, None]
    loads = push(force.reshape(-1, 2), push_s) + weight(gravity)
    solved = follow(make_problem(beam, loads, Resolution()))
    point = solved.xy(np.array([point_s]))[:, 0]
    q = solved.q[:, : pushed.count] if solved.q.shape[1] >= pushed.count else solved.q
    good = solved.converged & solved.stable
    if max_curvature is not None:
        good &= np.array([pushed.bend(shape) <= max_curvature for shape in q])
    point[~good] = np.nan
    shape = force.shape[:2]
    return ReachableSet(pushed, max_force, max_curvature, force, point.reshape(*shape, 2), q.reshape(*shape, -1))


def best_in_ball(s: Array, wanted: Array, radius: float, *, one_sided: bool) -> Array:
    """(P,) x that minimises |S x - wanted| with |x| <= radius; one number: with 0 <= x <= radius."""
    if one_sided:
        return np.array([np.clip(float(s[:, 0] @ wanted) / max(float(s[:, 0] @ s[:, 0]), 1e-300), 0.0, radius)])
    u, d, vt = np.linalg.svd(s)
    c = d * (u.T @ wanted)

    def size(damping: float) -> float:
        return float(np.linalg.norm(c / np.maximum(d**2 + damping, 1e-300)))

    if size(0.0) <= radius:
        return np.asarray(vt.T @ (c / np.maximum(d**2, 1e-300)))
    most = float(np.linalg.norm(c)) / radius + 1e-300
    damping = brentq(lambda x: size(x) - radius, 0.0, most, xtol=1e-14 * most)
    return np.asarray(vt.T @ (c / (d**2 + damping)))
