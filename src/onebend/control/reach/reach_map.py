"""A map of the reachable set, made once: whether a goal can be reached is then a look at it, and costs no search.

Forces are laid out by direction and size, as in `reachable.py`, and joined to triangles; each goes with a triangle of
places of the point. Where neighbouring directions lead to shapes far apart (the beam falls to its other side), the
directions between are halved until the gap is narrow, and no triangle goes across. Either side of such a gap the force
is turned on, as a hand would turn it, until the beam is no longer stable: there is the edge of stability.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from onebend.beam.loads import push, weight
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.problem import make_problem
from onebend.blas import one_blas_thread
from onebend.control.reach.continuation import trace
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.errors import ControlError
from onebend.records import Array, BoolArray, IntArray

_DIRECTIONS = 72
_SIZES: Array = np.linspace(0.0, 1.0, 13)[1:] ** 1.5  # of the largest force: the first of it bends the beam most
_MOST_SIZES = 40
_TOO_COARSE = 0.2  # rad: between directions with shapes that differ by more are others: triangles have straight sides
_SAME_BRANCH = 0.6  # rad: what then still differs by more lies apart
_ROUNDS = 8  # of halving
_TURN = np.deg2rad(5.0)  # of a force beyond a gap, at a time; the last time halved thrice
_MOST_TURNS = 36
_INSIDE = -1e-9  # barycentric coordinate
_AT_BOUND = 1.0 - 1e-6  # of the largest force

Edge = Literal["force", "stability"]


@dataclass(frozen=True)
class MapPlace:
    """Where a goal lies on a `ReachMap`."""

    inside: bool
    point: Array  # (2,) m: the goal, or the nearest point of the map's edge
    state: LoadedState  # an equilibrium to first order, near the point
    near: LoadedState  # an equilibrium of the map beside it
    edge: Edge | None  # what limits the beam there; None inside


@dataclass(frozen=True)
class ReachMap:
    """V sampled equilibria, the first at rest, joined to triangles."""

    max_force: float  # N
    force: Array  # (V, 2) N
    q: Array  # (V, n) rad
    points: Array  # (V, 2) m
    triangles: IntArray  # (T, 3)

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        """(T, 2) m the first corner, (T, 2, 2) from places to barycentric coordinates of the others."""
        a, b, c = (self.points[self.triangles[:, i]] for i in range(3))
        sides = np.stack([b - a, c - a], axis=-1)
        flat = np.abs(np.linalg.det(sides)) < 1e-16
        sides[flat] = np.eye(2) * 1e-300  # no place lies in it
        return a, np.asarray(np.linalg.inv(sides))

    @cached_property
    def edges(self) -> IntArray:
        """(E, 2) sides that belong to one triangle alone, in the order of the triangle."""
        t = self.triangles
        sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
        return np.asarray(sides[first[count == 1]])

    @cached_property
    def edge_is_force(self) -> BoolArray:
        """(E,) the largest force ends the map there; elsewhere the beam is not stable beyond."""
        size = np.linalg.norm(self.force, axis=1)
        return np.asarray(np.all(size[self.edges] >= _AT_BOUND * self.max_force, axis=1))

    def outline(self) -> list[tuple[Array, Edge]]:
        """Lines (P, 2) m along the edge, each with what limits the beam there."""
        lines: list[tuple[Array, Edge]] = []
        kinds: tuple[tuple[Edge, BoolArray], ...] = (
            ("force", self.edge_is_force),
            ("stability", ~self.edge_is_force),
        )
        for kind, chosen in kinds:
            lines += [(self.points[chain], kind) for chain in _chains(self.edges[chosen])]
        return lines

    def locate(self, goal: Array, now: LoadedState | None = None) -> MapPlace:
        """Where the goal (2,) m lies; of several forces for it that nearest to the one `now` is taken."""
        a, inverse = self._corners
        others = np.einsum("tij,tj->ti", inverse, goal - a)
        weights = np.column_stack([1.0 - others.sum(axis=1), others])
        inside = np.flatnonzero(np.all(weights >= _INSIDE, axis=1))
        if len(inside):
            loads = np.einsum("ti,tij->tj", weights[inside], self.force[self.triangles[inside]])
            aim = np.zeros(2) if now is None else now.load[:2]
            best = inside[int(np.argmin(np.sum((loads - aim) ** 2, axis=1)))]
            corners = self.triangles[best]
            return MapPlace(True, goal, self._between(corners, weights[best]), self._at(corners, weights[best]), None)
        begin, way = self.points[self.edges[:, 0]], np.diff(self.points[self.edges], axis=1)[:, 0]
        along = np.sum((goal - begin) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-300)
        along = np.clip(along, 0.0, 1.0)
        nearest = begin + along[:, None] * way
        best = int(np.argmin(np.sum((nearest - goal) ** 2, axis=1)))
        share = np.array([1.0 - along[best], along[best]])
        corners = self.edges[best]
        edge: Edge = "force" if self.edge_is_force[best] else "stability"
        return MapPlace(False, nearest[best], self._between(corners, share), self._at(corners, share), edge)

    def _between(self, corners: IntArray, weights: Array) -> LoadedState:
        return LoadedState(weights @ self.q[corners], np.append(weights @ self.force[corners], 0.0))

    def _at(self, corners: IntArray, weights: Array) -> LoadedState:
        chosen = int(corners[int(np.argmax(weights))])
        return LoadedState(self.q[chosen], np.append(self.force[chosen], 0.0))


@dataclass(frozen=True)
class _Sheet:
    """Equilibria under forces of D directions and R sizes; NaN in `points` where there is none."""

    force: Array  # (D, R, 2) N
    q: Array  # (D, R, n) rad
    points: Array  # (D, R, 2) m


@one_blas_thread
def reach_map(pushed: PushedBeam, max_force: float) -> ReachMap:
    """The map of all forces up to `max_force` [N] at the push. Raises `ControlError` for a bound without meaning."""
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
            joined[: len(chosen)] = 1 + side * sizes + chosen  # where it begins are the vertices of that direction
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


def _grown(pushed: PushedBeam, max_force: float) -> _Sheet:
    """Forces that grow from rest in all directions, close enough together for triangles with straight sides."""
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
    """Both, rising, and the order that they are then in."""
    every = np.concatenate([values, more])
    order = np.argsort(every, kind="stable")
    return every[order], order


def _turned_on(pushed: PushedBeam, sheet: _Sheet, side: int, sizes: IntArray, way: float) -> _Sheet:
    """From direction `side` on, the forces of these sizes turned further (`way` 1: counter-clockwise) while stable."""
    columns = [_column(pushed, sheet, side, int(r), way) for r in sizes]
    shape = (max(map(len, columns)), len(columns))
    force, points = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
    q = np.zeros((*shape, sheet.q.shape[-1]))
    for r, column in enumerate(columns):
        for d, state in enumerate(column):
            force[d, r], q[d, r], points[d, r] = state.load[:2], state.q, pushed.pose(state.q)[:2]
    return _Sheet(np.nan_to_num(force), q, points)


def _near(pushed: PushedBeam, sheet: _Sheet, triangles: IntArray) -> IntArray:
    """Those triangles whose three shapes are of one branch."""
    shapes = sheet.q.reshape(-1, sheet.q.shape[-1])[triangles] @ pushed.b.T
    return np.asarray(triangles[np.max(np.ptp(shapes, axis=1), axis=-1) < 2.0 * _SAME_BRANCH])


def _column(pushed: PushedBeam, sheet: _Sheet, side: int, r: int, way: float) -> list[LoadedState]:
    """One force turned until the beam would fall; the end is found to an eighth of a step."""
    state = LoadedState(sheet.q[side, r], np.append(sheet.force[side, r], 0.0))
    begin, size = float(np.arctan2(*sheet.force[side, r][::-1])), float(np.hypot(*sheet.force[side, r]))
    found, turned, step = [state], 0.0, _TURN
    while len(found) <= _MOST_TURNS and step > 0.1 * _TURN:
        angle = begin + way * (turned + step)
        trail = trace(pushed, size * np.array([np.cos(angle), np.sin(angle), 0.0]), start=found[-1], shortest=0.3)
        bent = float(np.max(np.abs(pushed.b @ (trail.states[-1].q - found[-1].q))))
        if trail.arrived and bent < _SAME_BRANCH:
            turned += step
            found.append(trail.states[-1])
        else:
            step *= 0.5
    return found


def _forces(turns: Array, sizes: Array) -> Array:
    """(D, R, 2) N."""
    return np.asarray(sizes[None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)[:, None])


def _sampled(pushed: PushedBeam, turns: Array, sizes: Array) -> tuple[Array, Array]:
    """(D, R, n) rad the shapes, (D, R, 2) m the point; NaN where no stable shape grows from rest."""
    force = _forces(turns, sizes).reshape(-1, 2)
    loads = push(force, pushed.push_s) + weight(pushed.gravity)
    solved = follow(make_problem(pushed.beam, loads, pushed.resolution))
    points = solved.xy(np.array([pushed.point_s]))[:, 0]
    points[~(solved.converged & solved.stable)] = np.nan
    shape = (len(turns), len(sizes))
    return solved.q[:, : pushed.count].reshape(*shape, -1), points.reshape(*shape, 2)


def _apart(pushed: PushedBeam, q: Array, points: Array, most: float) -> BoolArray:
    """(D, R) the shapes of a direction and the next, one of the two unknown or both more than `most` rad apart."""
    turned = np.max(np.abs((np.roll(q, -1, axis=0) - q) @ pushed.b.T), axis=-1)
    known = np.isfinite(points[..., 0])
    both, neither = known & np.roll(known, -1, axis=0), ~known & ~np.roll(known, -1, axis=0)
    return np.asarray(~neither & ~(both & (turned < most)))


def _fan(sheet: _Sheet, apart: BoolArray) -> IntArray:
    """(T, 3) triangles between rest, vertex 0, and the smallest forces."""
    known = np.isfinite(sheet.points[:, 0, 0])
    count, sizes = sheet.points.shape[:2]
    here = 1 + np.arange(count) * sizes
    there = np.roll(here, -1)
    return np.stack([0 * here, here, there], axis=-1)[known & np.roll(known, -1) & ~apart[:, 0]]


def _quads(known: BoolArray, apart: BoolArray | None, *, cyclic: bool) -> IntArray:
    """(T, 3) triangles between directions that follow one another and sizes that do, from vertex 0 on."""
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


def _chains(edges: IntArray) -> list[list[int]]:
    """Edges (E, 2) that follow one another, as lines of vertices."""
    after: dict[int, list[int]] = {}
    for i, (begin, _) in enumerate(edges.tolist()):
        after.setdefault(begin, []).append(i)
    starts = set(edges[:, 0].tolist()) - set(edges[:, 1].tolist())
    left = set(range(len(edges)))
    lines = []
    for at in [*(after[one][0] for one in sorted(starts)), *range(len(edges))]:
        if at not in left:
            continue
        line, following = [int(edges[at, 0])], [at]
        while following:
            left.discard(following[0])
            line.append(int(edges[following[0], 1]))
            following = [i for i in after.get(line[-1], ()) if i in left]
        lines.append(line)
    return lines
