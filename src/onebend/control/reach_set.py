"""Reachable positions of a point under forces at one place.

Forces are sampled by direction and size; each shape must be stable on the branch from rest under a proportional force.
The nearest point to a goal is then refined exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from onebend.beam import continuation, model, problem
from onebend.beam.loads import push, weight
from onebend.control import goals, loaded_beam
from onebend.errors import ControlError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray

_START_SAMPLES = 4
_MOST_STEPS = 60
_LEAST_SHARE_OF_LENGTH = 1e-9  # of L
_HALVES = tuple(0.5**i for i in range(14))
_SHORTEST_FOLLOW = 1e-3


@dataclass(frozen=True)
class NearestPoint:
    """The reachable point nearest to a goal."""

    point: Array  # (2,) m
    force: Array  # (2,) N
    distance: float  # m, to the goal
    states: tuple[loaded_beam.LoadedState, ...]  # equilibria from rest to it


@dataclass(frozen=True)
class ReachableSet:
    """D directions, R sizes, the largest last."""

    pushed: loaded_beam.PushedBeam
    max_force: float  # N
    max_curvature: float | None  # 1/m, beyond rest
    force: Array  # (D, R, 2) N
    points: Array  # (D, R, 2) m; NaN if not stable or bent too much
    q: Array  # (D, R, n) rad, the shapes

    @one_blas_thread
    def nearest(self, goal: ArrayLike) -> NearestPoint:
        """The reachable point nearest to `goal` (2,) m: exact at the bound on the force; at other bounds a nearer one
        may exist."""
        wanted = np.asarray(goal, dtype=float)
        if wanted.shape != (2,) or not np.all(np.isfinite(wanted)):
            raise ControlError(f"a goal has two finite coordinates [m], got {goals.numbers(wanted)}")
        trails = [loaded_beam.trace(self.pushed, sample.load) for sample in self.samples_near(wanted, _START_SAMPLES)]
        ways = [(self.pushed.start,), *(trail.states for trail in trails if trail.arrived)]
        return min((self._refine(way, wanted) for way in ways), key=lambda point: point.distance)

    def samples_near(self, goal: Array, count: int) -> list[loaded_beam.LoadedState]:
        """Up to `count` equilibria, nearest point first."""
        away = np.linalg.norm(self.points - goal, axis=-1).ravel()
        order = [int(i) for i in np.argsort(away)[:count] if np.isfinite(away[i])]
        q, force = self.q.reshape(-1, self.q.shape[-1]), self.force.reshape(-1, 2)
        return [loaded_beam.LoadedState(q[i], np.append(force[i], 0.0)) for i in order]

    def _refine(self, way: tuple[loaded_beam.LoadedState, ...], goal: Array) -> NearestPoint:
        """Gauss-Newton in the disc of forces, followed as equilibria."""
        pushed, least = self.pushed, _LEAST_SHARE_OF_LENGTH * float(self.pushed.problem.length)
        for _ in range(_MOST_STEPS):
            if float(np.linalg.norm(goal - pushed.pose(way[-1].q)[:2])) < least:
                break
            ahead = _nearer(pushed, way[-1], goal, self.max_force, _HALVES, _SHORTEST_FOLLOW, least, self._allowed)
            if ahead is None:
                break
            way = (*way, *ahead.states[1:])
        point = pushed.pose(way[-1].q)[:2]
        return NearestPoint(point, way[-1].load[:2], float(np.linalg.norm(goal - point)), way)

    def _allowed(self, state: loaded_beam.LoadedState) -> bool:
        return self.max_curvature is None or self.pushed.bend(state.q) <= self.max_curvature


@one_blas_thread
def reachable(
    beam: model.Beam,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    max_force: float,
    max_curvature: float | None = None,
    directions: int = 72,
    sizes: int = 12,
    gravity: ArrayLike = (0.0, 0.0),
) -> ReachableSet:
    """Where forces up to `max_force` [N] at `push_s` can hold the point at `point_s`.

    Args:
        max_curvature: 1/m beyond that at rest.
        directions, sizes: numbers of sampled forces.
        gravity: (2,) m/s^2 in the beam's frame.

    Raises `ControlError`: an invalid place or bound.
    """
    if not (max_force > 0.0 and np.isfinite(max_force)):
        raise ControlError(f"the largest force must be positive, got {max_force:g} N")
    loaded_beam.ReachSettings(max_curvature=max_curvature)  # checked
    if directions < 3 or sizes < 1:
        raise ControlError(f"at least 3 directions and 1 size are sampled, got {directions} and {sizes}")
    x, y = np.asarray(gravity, dtype=float).tolist()
    pushed = loaded_beam.prepared(beam, push_s, point_s, (x, y), problem.Resolution())
    turns = np.linspace(0.0, 2.0 * np.pi, directions, endpoint=False)
    grow: Array = max_force * np.arange(1, sizes + 1) / sizes
    q, points = _sampled(pushed, turns, grow)
    if max_curvature is not None:
        points[np.array([[pushed.bend(shape) > max_curvature for shape in row] for row in q])] = np.nan
    return ReachableSet(pushed, max_force, max_curvature, _forces(turns, grow), points, q)


def _nearer(
    pushed: loaded_beam.PushedBeam,
    state: loaded_beam.LoadedState,
    goal: Array,
    most: float,
    shares: tuple[float, ...],
    shortest: float,
    least: float,
    allowed: Callable[[loaded_beam.LoadedState], bool] = lambda _: True,
) -> loaded_beam.EquilibriumPath | None:
    """A Gauss-Newton step towards a goal by forces up to `most` N, followed as an equilibrium; the first of
    `shares` that approaches by `least` m, or None."""
    s = pushed.response(state)[:2, :2]
    if not np.all(np.isfinite(s)):
        return None
    away, now = goal - pushed.pose(state.q)[:2], state.load[:2]
    aim = best_in_ball(s, s @ now + away, most)
    for share in shares:
        way = loaded_beam.trace(pushed, np.append(now + share * (aim - now), 0.0), start=state, shortest=shortest)
        there = float(np.linalg.norm(goal - pushed.pose(way.states[-1].q)[:2]))
        if way.arrived and allowed(way.states[-1]) and there < float(np.linalg.norm(away)) - least:
            return way
    return None


def best_in_ball(s: Array, wanted: Array, radius: float) -> Array:
    """(P,) x with |x| <= radius that minimises |S x - wanted|."""
    u, d, vt = np.linalg.svd(s)
    c = d * (u.T @ wanted)

    def size(damping: float) -> float:
        return float(np.linalg.norm(c / np.maximum(d**2 + damping, 1e-300)))

    if size(0.0) <= radius:
        return np.asarray(vt.T @ (c / np.maximum(d**2, 1e-300)))
    most = float(np.linalg.norm(c)) / radius + 1e-300
    damping = brentq(lambda x: size(x) - radius, 0.0, most, xtol=1e-14 * most)
    return np.asarray(vt.T @ (c / (d**2 + damping)))


# A map of the reachable set. Forces by direction and size are joined to triangles, each with a triangle of places.
# Where neighbouring directions lead to distant shapes (the beam falls to its other side), directions are halved until
# the gap is narrow, and no triangle spans it. On either side the force is turned until stability is lost: the edge of
# stability.

_DIRECTIONS = 72
_SIZES: Array = np.linspace(0.0, 1.0, 13)[1:] ** 1.5  # small forces bend most
_MOST_SIZES = 40
_TOO_COARSE = 0.2  # rad, between shapes of neighbouring directions
_SAME_BRANCH = 0.6  # rad, beyond which shapes are on different branches
_ROUNDS = 8
_TURN = np.deg2rad(5.0)  # of a force beyond a gap, per step
_MOST_TURNS = 36
_INSIDE = -1e-9  # barycentric coordinate
_MAP_AT_BOUND = 1.0 - 1e-6  # of the largest force

Edge = Literal["force", "stability"]


@dataclass(frozen=True)
class MapPlace:
    inside: bool
    state: loaded_beam.LoadedState  # to first order
    near: loaded_beam.LoadedState  # an equilibrium of the map
    edge: Edge | None  # limit; None inside


@dataclass(frozen=True)
class ReachMap:
    """V equilibria, the first at rest, joined to triangles."""

    max_force: float  # N
    force: Array  # (V, 2) N
    q: Array  # (V, n) rad
    points: Array  # (V, 2) m
    triangles: IntArray  # (T, 3)

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        """(T, 2) m first corners, (T, 2, 2) from places to the other barycentric coordinates."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        sides = np.stack([b - a, c - a], axis=-1)
        flat = np.abs(np.linalg.det(sides)) < 1e-16
        sides[flat] = np.eye(2) * 1e-300  # degenerate: contains no place
        return a, np.asarray(np.linalg.inv(sides))

    @cached_property
    def edges(self) -> IntArray:
        """(E, 2) sides of one triangle only."""
        t = self.triangles
        sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
        return np.asarray(sides[first[count == 1]])

    @cached_property
    def edge_is_force(self) -> BoolArray:
        """(E,) whether the edge is the bound on the force; else stability."""
        size = np.linalg.norm(self.force, axis=1)
        return np.asarray(np.all(size[self.edges] >= _MAP_AT_BOUND * self.max_force, axis=1))

    def locate(self, goal: Array, now: loaded_beam.LoadedState | None = None) -> MapPlace:
        """Where the goal (2,) m lies; of several forces the one nearest to `now`."""
        a, inverse = self._corners
        others = np.einsum("tij,tj->ti", inverse, goal - a)
        weights = np.column_stack([1.0 - others.sum(axis=1), others])
        inside = np.flatnonzero(np.all(weights >= _INSIDE, axis=1))
        if len(inside):
            loads = np.einsum("ti,tij->tj", weights[inside], self.force[self.triangles[inside]])
            aim = np.zeros(2) if now is None else now.load[:2]
            best = inside[int(np.argmin(np.sum((loads - aim) ** 2, axis=1)))]
            corners = self.triangles[best]
            return MapPlace(True, self._between(corners, weights[best]), self._at(corners, weights[best]), None)
        begin, way = self.points[self.edges[:, 0]], np.diff(self.points[self.edges], axis=1)[:, 0]
        along = np.sum((goal - begin) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-300)
        along = np.clip(along, 0.0, 1.0)
        nearest = begin + along[:, None] * way
        best = int(np.argmin(np.sum((nearest - goal) ** 2, axis=1)))
        share = np.array([1.0 - along[best], along[best]])
        corners = self.edges[best]
        edge: Edge = "force" if self.edge_is_force[best] else "stability"
        return MapPlace(False, self._between(corners, share), self._at(corners, share), edge)

    def _between(self, corners: IntArray, weights: Array) -> loaded_beam.LoadedState:
        return loaded_beam.LoadedState(weights @ self.q[corners], np.append(weights @ self.force[corners], 0.0))

    def _at(self, corners: IntArray, weights: Array) -> loaded_beam.LoadedState:
        chosen = int(corners[int(np.argmax(weights))])
        return loaded_beam.LoadedState(self.q[chosen], np.append(self.force[chosen], 0.0))


@dataclass(frozen=True)
class _Sheet:
    force: Array  # (D, R, 2) N
    q: Array  # (D, R, n) rad
    points: Array  # (D, R, 2) m


@one_blas_thread
def reach_map(pushed: loaded_beam.PushedBeam, max_force: float) -> ReachMap:
    """For forces up to `max_force` [N]. Raises `ControlError` for an invalid bound."""
    if not (max_force > 0.0 and np.isfinite(max_force)):
        raise ControlError(f"the largest force must be positive, got {max_force:g} N")
    sheet = _grown(pushed, max_force)
    apart = _apart(pushed, sheet.q, sheet.points, _SAME_BRANCH)
    known = np.isfinite(sheet.points[..., 0])
    vertices, triangles = [sheet], [_fan(sheet, apart), 1 + _quads(known, apart, cyclic=True)]
    count, (directions, sizes) = 1 + known.size, known.shape
    for gap in np.flatnonzero(apart.any(axis=1)):
        for side, way in ((gap, 1.0), ((gap + 1) % directions, -1.0)):
            chosen = np.flatnonzero(apart[gap] & known[side])
            if not len(chosen):
                continue
            more = _turned_on(pushed, sheet, int(side), chosen, way)
            joined = np.arange(count, count + more.points[..., 0].size)
            joined[: len(chosen)] = 1 + side * sizes + chosen  # vertices of the direction where it begins
            vertices.append(more)
            triangles.append(joined[_near(pushed, more, _quads(np.isfinite(more.points[..., 0]), None, cyclic=False))])
            count += len(joined)
    rest = pushed.start
    return ReachMap(
        max_force=max_force,
        force=np.concatenate([np.zeros((1, 2)), *(one.force.reshape(-1, 2) for one in vertices)]),
        q=np.concatenate([rest.q[None], *(one.q.reshape(-1, one.q.shape[-1]) for one in vertices)]),
        points=np.concatenate([pushed.pose(rest.q)[None, :2], *(one.points.reshape(-1, 2) for one in vertices)]),
        triangles=np.concatenate(triangles),
    )


def _grown(pushed: loaded_beam.PushedBeam, max_force: float) -> _Sheet:
    """Forces from rest in all directions, dense enough for straight triangle sides."""
    turns, sizes = np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False), max_force * _SIZES
    q, points = _sampled(pushed, turns, sizes)
    for _ in range(2):
        bent = np.concatenate([np.broadcast_to(pushed.start.q, q[:, :1].shape), q], axis=1)
        turned = np.max(np.abs(np.diff(bent, axis=1) @ pushed.b.T), axis=-1)
        steps = np.flatnonzero(np.max(np.where(np.isfinite(points[..., 0]), turned, 0.0), axis=0) > _TOO_COARSE)
        if not len(steps) or len(sizes) + len(steps) > _MOST_SIZES:
            break
        middle = 0.5 * (np.append(0.0, sizes)[steps] + sizes[steps])
        more_q, more_points = _sampled(pushed, turns, middle)
        sizes, order = _merged(sizes, middle)
        q, points = np.concatenate([q, more_q], 1)[:, order], np.concatenate([points, more_points], 1)[:, order]
    for _ in range(_ROUNDS):
        gaps = np.flatnonzero(_apart(pushed, q, points, _TOO_COARSE).any(axis=1))
        if not len(gaps) or len(turns) > 3 * _DIRECTIONS:
            break
        after = np.append(turns[1:], turns[0] + 2.0 * np.pi)
        middle = 0.5 * (turns[gaps] + after[gaps])
        more_q, more_points = _sampled(pushed, middle, sizes)
        turns, order = _merged(turns, middle)
        q, points = np.concatenate([q, more_q])[order], np.concatenate([points, more_points])[order]
    return _Sheet(_forces(turns, sizes), q, points)


def _merged(values: Array, more: Array) -> tuple[Array, IntArray]:
    every = np.concatenate([values, more])
    order = np.argsort(every, kind="stable")
    return every[order], order


def _turned_on(pushed: loaded_beam.PushedBeam, sheet: _Sheet, side: int, sizes: IntArray, way: float) -> _Sheet:
    """Turns forces beyond direction `side` while stable."""
    columns = [_column(pushed, sheet, side, int(r), way) for r in sizes]
    shape = (max(map(len, columns)), len(columns))
    force, points = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
    q = np.zeros((*shape, sheet.q.shape[-1]))
    for r, column in enumerate(columns):
        for d, state in enumerate(column):
            force[d, r], q[d, r], points[d, r] = state.load[:2], state.q, pushed.pose(state.q)[:2]
    return _Sheet(np.nan_to_num(force), q, points)


def _near(pushed: loaded_beam.PushedBeam, sheet: _Sheet, triangles: IntArray) -> IntArray:
    shapes = sheet.q.reshape(-1, sheet.q.shape[-1])[triangles] @ pushed.b.T
    return np.asarray(triangles[np.max(np.ptp(shapes, axis=1), axis=-1) < 2.0 * _SAME_BRANCH])


def _column(
    pushed: loaded_beam.PushedBeam, sheet: _Sheet, side: int, r: int, way: float
) -> list[loaded_beam.LoadedState]:
    """One force turned until the beam would fall, to an eighth of a step."""
    state = loaded_beam.LoadedState(sheet.q[side, r], np.append(sheet.force[side, r], 0.0))
    begin, size = float(np.arctan2(*sheet.force[side, r][::-1])), float(np.hypot(*sheet.force[side, r]))
    found, turned, step = [state], 0.0, _TURN
    while len(found) <= _MOST_TURNS and step > 0.1 * _TURN:
        angle = begin + way * (turned + step)
        trail = loaded_beam.trace(
            pushed, size * np.array([np.cos(angle), np.sin(angle), 0.0]), start=found[-1], shortest=0.3
        )
        bent = float(np.max(np.abs(pushed.b @ (trail.states[-1].q - found[-1].q))))
        if trail.arrived and bent < _SAME_BRANCH:
            turned += step
            found.append(trail.states[-1])
        else:
            step *= 0.5
    return found


def _forces(turns: Array, sizes: Array) -> Array:
    return np.asarray(sizes[None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)[:, None])


def _sampled(pushed: loaded_beam.PushedBeam, turns: Array, sizes: Array) -> tuple[Array, Array]:
    """(D, R, n) rad shapes, (D, R, 2) m the point; NaN if not stable."""
    force = _forces(turns, sizes).reshape(-1, 2)
    loads = push(force, pushed.push_s) + weight(pushed.gravity)
    solved = continuation.follow(problem.make_problem(pushed.beam, loads, pushed.resolution))
    points = solved.xy(np.array([pushed.point_s]))[:, 0]
    points[~(solved.converged & solved.stable)] = np.nan
    shape = (len(turns), len(sizes))
    return solved.q[:, : pushed.count].reshape(*shape, -1), points.reshape(*shape, 2)


def _apart(pushed: loaded_beam.PushedBeam, q: Array, points: Array, most: float) -> BoolArray:
    """(D, R) whether the next direction's shape is unknown or differs by more than `most` rad."""
    turned = np.max(np.abs((np.roll(q, -1, axis=0) - q) @ pushed.b.T), axis=-1)
    known = np.isfinite(points[..., 0])
    both, neither = known & np.roll(known, -1, axis=0), ~known & ~np.roll(known, -1, axis=0)
    return np.asarray(~neither & ~(both & (turned < most)))


def _fan(sheet: _Sheet, apart: BoolArray) -> IntArray:
    """(T, 3) triangles of rest (vertex 0) and the smallest forces."""
    known = np.isfinite(sheet.points[:, 0, 0])
    count, sizes = sheet.points.shape[:2]
    here = 1 + np.arange(count) * sizes
    there = np.roll(here, -1)
    return np.stack([0 * here, here, there], axis=-1)[known & np.roll(known, -1) & ~apart[:, 0]]


def _quads(known: BoolArray, apart: BoolArray | None, *, cyclic: bool) -> IntArray:
    """(T, 3) triangles between neighbouring directions and sizes."""
    count, sizes = known.shape
    d, r = np.meshgrid(np.arange(count if cyclic else count - 1), np.arange(sizes - 1), indexing="ij")
    here, there = d * sizes + r, (d + 1) % count * sizes + r
    flat = known.ravel()
    whole = flat[here] & flat[here + 1] & flat[there] & flat[there + 1]
    if apart is not None:
        whole &= ~apart[:, :-1] & ~apart[:, 1:]
    quads = np.stack([here, here + 1, there + 1, there], axis=-1)[whole]
    single = np.stack([here, here + 1, there], axis=-1)[~whole & flat[here] & flat[here + 1] & flat[there]]
    other = np.stack([here, here + 1, there + 1], axis=-1)[~whole & flat[here] & flat[here + 1] & flat[there + 1]]
    more = [] if apart is not None else [single, other[~np.isin(other[:, 0], single[:, 0])]]
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], *more])


# A dragged point. A goal inside the map is solved by Newton's method from the present shape or the map; for a goal
# outside, the point slides along the map's edge.

_TRUST = 0.4  # rad: a larger turn may leave the branch
_SHORTEST_EDGE_STEP = 1e-3  # of the way to a force of the edge
_ON_GOAL = 1e-6  # m
_SLIDES = 8
_LEAST_DRAG = 1e-7  # m, of such a step
_DRAG_AT_BOUND = 0.999
_OVER = 1.0 + 1e-9


@dataclass(frozen=True)
class DragAnswer:
    goal: Array  # (2,) m, or (3,) m, m, rad
    pose: Array  # (3,) m, m, rad
    state: loaded_beam.LoadedState
    margin: float  # smallest eigenvalue of the scaled tangent: 1 without loads, 0 at loss of stability
    limit: Edge | None  # why the point is off its goal


class _Hand:
    """Stateful, for one thread."""

    holds = False  # also holds the end's angle

    def __init__(self, pushed: loaded_beam.PushedBeam, start: loaded_beam.LoadedState, max_force: float) -> None:
        self.pushed, self.state, self.max_force = pushed, start, max_force

    def answer(self, goal: Array, limit: Edge | None = None) -> DragAnswer:
        margin = stability_margin(self.pushed, self.state, held=self.holds)
        return DragAnswer(goal, self.pushed.pose(self.state.q), self.state, margin, limit)


class DraggedPoint(_Hand):
    def __init__(self, pushed: loaded_beam.PushedBeam, max_force: float) -> None:
        super().__init__(pushed, pushed.start, max_force)
        self.map: ReachMap | None = None  # until then Newton's method only

    @one_blas_thread
    def to(self, goal: ArrayLike) -> DragAnswer:
        """The beam with its point on `goal` (2,) m, or as near as possible. Raises `ControlError` for an invalid
        goal."""
        wanted = loaded_beam.checked_goal(goal, loaded_beam.ReachSettings())
        limit: Edge | None = None
        if self.map is None:
            if not (self._solved(self.state, wanted) or self._approach(wanted)):
                limit = "force" if _size(self.state.load) > _DRAG_AT_BOUND * self.max_force else "stability"
        else:
            place = self.map.locate(wanted, self.state)
            starts = (self.state, place.state, place.near)
            if not (place.inside and any(self._solved(start, wanted) for start in starts)):
                way = loaded_beam.trace(self.pushed, place.state.load, start=place.near, shortest=_SHORTEST_EDGE_STEP)
                self.state, limit = way.states[-1], place.edge
                if limit != "stability":
                    limit = None if self._approach(wanted) else "force"
        return self.answer(wanted, limit)

    @one_blas_thread
    def under(self, force: ArrayLike) -> DragAnswer:
        """The beam under a force (2,) N grown from rest, or at its last stable shape. Raises `ControlError` for an
        invalid force."""
        load = np.append(np.asarray(force, dtype=float), 0.0)
        if load.shape != (3,) or not np.isfinite(load).all():
            raise ControlError("a force has two finite components [N]")
        size = _size(load)
        way = loaded_beam.trace(
            self.pushed, load * min(1.0, self.max_force / max(size, 1e-300)), shortest=_SHORTEST_EDGE_STEP
        )
        self.state = way.states[-1]
        limit: Edge | None = None if way.arrived and size <= _OVER * self.max_force else "stability"
        return self.answer(self.pushed.pose(self.state.q)[:2], limit)

    def _approach(self, goal: Array) -> bool:
        """Approaches a goal within the bound, step by step; whether it arrived."""
        for _ in range(_SLIDES):
            way = _nearer(self.pushed, self.state, goal, self.max_force, (1.0, 0.3, 0.1), 0.05, _LEAST_DRAG)
            if way is None:
                return False
            self.state = way.states[-1]
            if self._solved(self.state, goal):
                return True
        return False

    def _solved(self, start: loaded_beam.LoadedState, goal: Array) -> bool:
        found = loaded_beam.solve_goal(self.pushed, start, goal, most=8, trust=_TRUST)
        if not (found.converged and found.positive) or _size(found.state.load) > _OVER * self.max_force:
            return False
        if not self.pushed.stable(found.state):
            return False
        self.state = found.state
        return True


class HeldEnd(_Hand):
    holds = True

    def __init__(self, pushed: loaded_beam.PushedBeam, start: loaded_beam.LoadedState, max_force: float) -> None:
        """`start`: an equilibrium under a force at the end. Raises `ControlError` if the beam is not pushed at its
        end."""
        if (pushed.push_s, pushed.point_s) != (1.0, 1.0):
            raise ControlError("a hand holds the end of the beam: s = 1")
        super().__init__(pushed, start, max_force)

    @one_blas_thread
    def to(self, goal: ArrayLike) -> DragAnswer:
        """The beam with its end at `goal` (3,) m, m, rad, or as far on the straight way as it is stable."""
        wanted = loaded_beam.checked_goal(goal, loaded_beam.ReachSettings(moment=True))
        if len(wanted) != 3:
            raise ControlError("a hand holds a place and an angle: a goal is (x, y, angle)")
        limit = self._led(wanted)
        for _ in range(3):
            if limit != "force" or not self._slide(wanted):
                break
        return self.answer(wanted, limit)

    def _slide(self, wanted: Array) -> bool:
        """Along the bound on the force at the wanted angle; whether that leads nearer."""
        here = self.pushed.pose(self.state.q)
        s = self.pushed.response(self.state)
        if abs(wanted[2] - here[2]) > 1e-3 or not np.isfinite(s).all() or not s[2, 2] > 0.0:
            return False
        away, now = wanted[:2] - here[:2], self.state.load[:2]
        plane = s[:2, :2] - np.outer(s[:2, 2], s[2, :2]) / s[2, 2]  # the moment keeps the angle
        aim = plane @ (best_in_ball(plane, plane @ now + away, 0.998 * self.max_force) - now)
        for share in (1.0, 0.3, 0.1):
            goal = np.append(here[:2] + share * aim, here[2])
            nearer = float(np.hypot(*(wanted - goal)[:2])) < float(np.hypot(*away)) - _ON_GOAL
            if nearer and self._led(goal) is None:
                return True
        return False

    @one_blas_thread
    def edge(self, directions: int = 36) -> list[tuple[Array, Edge]]:
        """How far the hand can go straight without turning, in so many directions: (2,) m, and the limit."""
        here, begin, length = self.pushed.pose(self.state.q), self.state, float(self.pushed.problem.length)
        ends: list[tuple[Array, Edge]] = []
        for turn in np.arange(directions) * (2.0 * np.pi / directions):
            self.state = begin
            limit = self._led(here + 2.0 * length * np.array([math.cos(turn), math.sin(turn), 0.0]))
            ends.append((self.pushed.pose(self.state.q)[:2], limit or "stability"))
        self.state = begin
        return ends

    def _led(self, pose: Array) -> Edge | None:
        """Leads the end straight towards a pose; the limit that it meets, or None."""
        self._limit: Edge = "stability"
        way = loaded_beam.lead(self.pushed, self.state, pose, 3, self._allowed)
        self.state = way.states[-1]
        return None if way.arrived else self._limit

    def _allowed(self, state: loaded_beam.LoadedState) -> bool:
        strong = _size(state.load) > _OVER * self.max_force
        self._limit = "force" if strong else "stability"
        return not strong and stability_margin(self.pushed, state, held=True) > 0.0


def stability_margin(pushed: loaded_beam.PushedBeam, state: loaded_beam.LoadedState, *, held: bool = False) -> float:
    """Smallest eigenvalue of the scaled tangent, with `held` on changes that keep the end's pose: 1 without loads, 0 at
    buckling."""
    _, tangent, cos, sin = pushed.balance(state.q, state.load)
    scale = 1.0 / np.sqrt(pushed.stiff)
    matrix = scale[:, None] * np.tril(tangent) * scale
    return loaded_beam.least_eigenvalue(
        matrix + np.tril(matrix, -1).T, pushed.of_shape(cos, sin) * scale if held else None
    )


def _size(load: Array) -> float:
    return math.hypot(float(load[0]), float(load[1]))
