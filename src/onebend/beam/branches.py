"""All stable equilibria of a beam with a free end under dead loads, by shooting from that end.

The forces and the moment m(s) beyond s do not depend on the shape. An equilibrium solves

    alpha' = q = q0 + (m + I) / k,    -I' = dW/dalpha,    I(1) = 0,    alpha(0) = alpha0,

so it is determined by the angle a of the free end, a root of `A(a) = alpha(0; a)`. A is marched from the free end to
the clamp by Gauss's method, consistent with `statics`. An equilibrium is stable if `y(s) = d alpha(s; a) / da` is
positive along the beam (Jacobi). Where A is level, a stable and an unstable one meet (fold).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onebend.beam.continuation import let_fall
from onebend.beam.grid import Grid, solve_each
from onebend.beam.problem import Problem
from onebend.beam.statics import correct, is_stable, node_angles
from onebend.records import Array, BoolArray, IntArray

_SAMPLES = 24  # initial samples of a full turn of the free end
_STEEP = 0.7  # rad, change of the angle at the clamp between samples that asks for another one,
_BENT = 0.15  # rad, as does this deviation from linearity
_CLOSEST = 1e-14  # rad, least distance of samples
_WIDE = 0.03  # rad, intervals to halve even without a stable equilibrium nearby
_MOST = 500  # intervals of a frame halved at once
_ITERATIONS = 8  # of Newton's method on a panel's stages
_SETTLED = 1e-11  # rad, last update
_HALVINGS = 24  # halvings of an interval with a turning point of A; level there, so half the digits suffice
_ROOT_STEPS = 80
_AT_ROOT = 1e-4  # rad at the clamp; Newton's method on the grid does the rest
_FARTHEST_FROM_MARCH = 0.5  # rad, from the march to the equilibrium on the grid
_SAME = 1e-6  # rad, distance below which equilibria are one


@dataclass(frozen=True)
class _Panels:
    """Values at the n stages of the P panels."""

    width: Array  # (T, P)
    k: Array  # (T, P, n) N m
    free: Array  # (T, P, n) rad: q0 + m / k
    pull: Array  # (T, P, n, 2) N m: L times the force beyond
    lever: Array  # (T, P, n) 1/(N m): (1/EA - 1/kGA) / L
    to_end: Array  # (n, n) integrals from stages to the panel's end, unit width
    whole: Array  # (n,) integral over the panel


@dataclass(frozen=True)
class _March:
    """State at the clamp per sample."""

    base: Array  # (S,) rad
    slope: Array  # (S,) dA/da
    conjugate: IntArray  # (S,) number of conjugate points
    q: Array  # (S, Q) rad, curvature at the nodes


@dataclass(frozen=True)
class _Intervals:
    """Between neighbouring angles of the free end."""

    frame: IntArray  # (S,)
    a: Array  # (S, 2) rad, at the free end
    base: Array  # (S, 2) rad, at the clamp
    slope: Array  # (S, 2)
    conjugate: IntArray  # (S, 2)

    def take(self, chosen: BoolArray) -> _Intervals:
        return _Intervals(*(part[chosen] for part in astuple(self)))

    def split(self, at: Array, march: _March) -> _Intervals:
        """Each in two, at angles (S,)."""

        ends = (self.a, self.base, self.slope, self.conjugate)
        middles = (at, march.base, march.slope, march.conjugate)
        halves = (
            np.concatenate([np.stack([two[:, 0], one], 1), np.stack([one, two[:, 1]], 1)])
            for two, one in zip(ends, middles, strict=True)
        )
        return _Intervals(np.concatenate([self.frame, self.frame]), *halves)


def stable_equilibria(problem: Problem) -> tuple[Array, IntArray]:
    """Curvatures (E, Q) [rad] of all stable equilibria under dead loads, and their frames (E,), ordered by the angle of
    the free end.

    For rope-like beams (`int sqrt(L N / k) ds` above 30) double precision may miss some.
    """
    if problem.size == 0:
        return np.zeros((0, problem.to_nodes.shape[-1])), np.zeros(0, dtype=np.int64)
    panels = _panels(problem)
    goal = np.ravel(problem.alpha0) + np.zeros(problem.size)
    frame, q = _roots(panels, _with_turning_points(panels, _sampled(panels), goal), goal)
    part, full = problem.take(frame), np.ones(len(frame))
    q, near, _ = correct(part, q, full, trust=_FARTHEST_FROM_MARCH * full, remaining=1e-13 * full, max_iterations=12)
    near[near] &= is_stable(part.take(near), q[near])
    return _distinct(problem, q[near], frame[near])


def _distinct(problem: Problem, q: Array, frame: IntArray) -> tuple[Array, IntArray]:
    if not len(frame):
        return q, frame
    alpha = node_angles(problem.take(frame), q)
    order = np.lexsort((alpha[:, -1], frame))
    q, frame, alpha = q[order], frame[order], alpha[order]
    new = np.ones(len(frame), dtype=bool)
    new[1:] = (np.diff(frame) > 0) | (np.max(np.abs(np.diff(alpha, axis=0)), axis=-1) > _SAME)
    return q[new], frame[new]


def _panels(problem: Problem) -> _Panels:
    count, n, nodes = problem.size, problem.grid.order, problem.to_nodes.shape[-1]

    def staged(values: Array) -> Array:
        return np.broadcast_to(values, (count, nodes)).reshape(count, -1, n)

    k, length, one = staged(problem.k), np.broadcast_to(problem.length, (count, 1)), Grid(np.array([0.0, 1.0]), n)
    stretch, shear = problem.compliance or (np.zeros(1), np.zeros(1))
    return _Panels(
        width=np.broadcast_to(np.diff(problem.grid.edges), (count, nodes // n)),
        k=k,
        free=staged(problem.q0) + staged(problem.moment) / k,
        pull=np.stack([staged(length * problem.dead_force[..., i]) for i in (0, 1)], axis=-1),
        lever=staged((stretch - shear) / length),
        to_end=one.weights - one.integral_to_nodes,
        whole=one.weights,
    )


def _march(panels: _Panels, frame: IntArray, a: Array) -> _March:
    """From angles a (S,) at the free end, under the loads of frames (S,)."""
    count, (steps, n), c = len(a), panels.k.shape[1:], panels.to_end
    q = np.empty((count, steps, n))
    alpha, inner = a[:, None], np.zeros((count, 1))  # angle and I at the panel's end
    by_alpha, by_inner = np.ones((count, 1)), np.zeros((count, 1))  # derivatives by a
    turns = np.empty((count, steps, n))  # y
    bent = panels.free[frame, -1, -1:]
    for p in range(steps - 1, -1, -1):
        h, k, free = panels.width[frame, p, None], panels.k[frame, p], panels.free[frame, p]
        coupling = (h**2)[..., None] * ((c / k[:, None, :]) @ c)
        stage = alpha - h * bent * np.sum(c, axis=1)
        for _ in range(_ITERATIONS):
            work, stiff = _work(panels, frame, p, stage)
            q[:, p] = free + (inner + h * (work @ c.T)) / k
            matrix = np.eye(n) + coupling * stiff[:, None, :]
            update = solve_each(matrix, (stage - alpha + h * (q[:, p] @ c.T))[..., None])[..., 0]
            stage = stage - update
            if not np.max(np.abs(update), initial=0.0) > _SETTLED:
                break
        turns[:, p] = solve_each(matrix, (by_alpha - h * ((by_inner / k) @ c.T))[..., None])[..., 0]
        by_work = stiff * turns[:, p]
        by_q = (by_inner + h * (by_work @ c.T)) / k
        alpha, by_alpha = (x - h * (rate @ panels.whole)[:, None] for x, rate in ((alpha, q[:, p]), (by_alpha, by_q)))
        inner, by_inner = (x + h * (rate @ panels.whole)[:, None] for x, rate in ((inner, work), (by_inner, by_work)))
        bent = q[:, p, :1]
    positive = np.concatenate([by_alpha, turns.reshape(count, steps * n)], axis=1) > 0.0
    conjugate = np.sum(positive[:, 1:] != positive[:, :-1], axis=1)
    return _March(alpha[:, 0], by_alpha[:, 0], conjugate, q.reshape(count, steps * n))


def _work(panels: _Panels, frame: IntArray, p: int, alpha: Array) -> tuple[Array, Array]:
    """(S, n) N m each: dW/dalpha and its derivative at the stages of panel p."""
    cos, sin = np.cos(alpha), np.sin(alpha)
    x, y, lever = panels.pull[frame, p, :, 0], panels.pull[frame, p, :, 1], panels.lever[frame, p]
    along, across = x * cos + y * sin, y * cos - x * sin
    return across * (1.0 + lever * along), -along - lever * (along**2 - across**2)


def _sampled(panels: _Panels) -> _Intervals:
    """A full turn of the free end of every frame about the pull there, refined where A changes fast.

    The free end of a rope nearly lies along that pull in all stable equilibria. Intervals with two or more conjugate
    points at both ends contain none.
    """
    frames, pull = np.arange(len(panels.k)), panels.pull[:, -1, -1]
    places = np.arctan2(pull[:, 1], pull[:, 0])[:, None] + np.linspace(-np.pi, np.pi, _SAMPLES + 1)
    march = _march(panels, np.repeat(frames, places.shape[1]), np.ravel(places))

    def ends(values: NDArray[Any]) -> NDArray[Any]:
        rows = values.reshape(len(frames), -1)
        return np.stack([rows[:, :-1], rows[:, 1:]], axis=-1).reshape(-1, 2)

    todo = _Intervals(
        np.repeat(frames, _SAMPLES), ends(places), ends(march.base), ends(march.slope), ends(march.conjugate)
    )
    done: list[_Intervals] = []
    while len(todo.frame):
        wide = np.diff(todo.a, axis=1)[:, 0]
        change = np.diff(todo.base, axis=1)[:, 0]
        off = np.max(np.abs(change[:, None] - wide[:, None] * todo.slope), axis=1)
        several = np.bincount(todo.frame, minlength=len(frames))[todo.frame] < _MOST
        hopeful = (np.min(todo.conjugate, axis=1) < 2) | (wide > _WIDE)
        coarse = ((np.abs(change) > _STEEP) | ~(off < _BENT)) & (wide > _CLOSEST) & several & hopeful
        done.append(todo.take(~coarse))
        todo = todo.take(coarse)
        middle = np.mean(todo.a, axis=1)
        todo = todo.split(middle, _march(panels, todo.frame, middle))
    return _joined(done)


def _joined(parts: list[_Intervals]) -> _Intervals:
    return _Intervals(*(np.concatenate(one) for one in zip(*map(astuple, parts), strict=True)))


def _level(base: Array, goal: Array) -> Array:
    """The goals, full turns apart, up to an angle."""
    return np.floor((base - goal) / (2.0 * np.pi))


def _with_turning_points(panels: _Panels, intervals: _Intervals, goal: Array) -> _Intervals:
    """Splits intervals in which A turns near a goal."""
    (left, right), to = intervals.slope.T, goal[intervals.frame]
    levels = _level(intervals.base, to[:, None])
    near = np.max(np.abs(_level(intervals.base + _BENT, to[:, None]) - _level(intervals.base - _BENT, to[:, None])), 1)
    turns = (left * right < 0.0) & (levels[:, 0] == levels[:, 1]) & (near > 0)
    found = intervals.take(turns)
    low, high = found.a.T.copy()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        there = _march(panels, found.frame, middle).slope
        below = there * found.slope[:, 0] > 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    middle = 0.5 * (low + high)
    return _joined([intervals.take(~turns), found.split(middle, _march(panels, found.frame, middle))])


def _roots(panels: _Panels, intervals: _Intervals, goal: Array) -> tuple[IntArray, Array]:
    """Frames (E,) and curvatures (E, Q) where A rises through a goal without conjugate points, by Newton's method."""
    levels = _level(intervals.base, goal[intervals.frame, None])
    found = intervals.take((levels[:, 1] > levels[:, 0]) & (np.min(intervals.conjugate, axis=1) == 0))
    frame, (low, high) = found.frame, found.a.T.copy()
    to = goal[frame] + 2.0 * np.pi * _level(found.base[:, 1], goal[frame])
    share = (to - found.base[:, 0]) / np.maximum(np.diff(found.base, axis=1)[:, 0], 1e-300)
    a, todo = low + np.clip(share, 0.0, 1.0) * (high - low), np.arange(len(frame))
    q = np.zeros((len(frame), panels.k[0].size))
    for _ in range(_ROOT_STEPS):
        if not len(todo):
            break
        march = _march(panels, frame[todo], a[todo])
        q[todo], left = march.q, march.base - to[todo]
        low[todo], high[todo] = np.where(left < 0.0, a[todo], low[todo]), np.where(left < 0.0, high[todo], a[todo])
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = a[todo] - left / march.slope
        inside = (ahead > low[todo]) & (ahead < high[todo])
        a[todo] = np.where(inside, ahead, 0.5 * (low[todo] + high[todo]))
        todo = todo[~(np.abs(left) < _AT_ROOT)]
    return frame, q


# A beam with a free end under slowly changing loads, as when its base is turned. It stays on its branch while that is
# stable. At a fold it falls, slightly beyond, and continues from there; so the way back can lead elsewhere.

Way = Callable[[IntArray, Array], Problem]  # frames, share of the way (F,) -> their problem there

_LARGEST_TURN = 0.3  # rad, largest turn of a step
_FIRST = 0.1  # first step, as a share of the way
_SHORTEST = 1e-7  # shortest step; without stability there the beam falls
_BEYOND = 1e-4  # share of the way past a fold at which the beam falls
_MOST_FALLS = 50


def lead(way: Way, start: Array) -> tuple[Array, BoolArray, IntArray]:
    """From stable shapes `start` (T, Q) [rad] to the end of the way: shapes, (T,) whether they are stable equilibria,
    and the number of falls."""
    q, done, step = start.copy(), np.zeros(len(start)), np.full(len(start), _FIRST)
    falls, lost = np.zeros(len(start), dtype=np.int64), np.zeros(len(start), dtype=bool)
    while True:
        todo = np.flatnonzero((done < 1.0) & ~lost)
        if todo.size == 0:
            return q, ~lost, falls
        target = np.minimum(done[todo] + step[todo], 1.0)
        problem, full = way(todo, target), np.ones(todo.size)
        shape, near, _ = correct(problem, q[todo], full, trust=_LARGEST_TURN * full, remaining=1e-11 * full)
        near[near] &= is_stable(problem.take(near), shape[near])
        q[todo[near]], done[todo[near]] = shape[near], target[near]
        step[todo] = np.where(near, 2.0, 0.25) * step[todo]
        ended = todo[~near & (step[todo] < _SHORTEST)]
        if ended.size:
            beyond = np.minimum(done[ended] + _BEYOND, 1.0)
            shape, landed = let_fall(way(ended, beyond), q[ended])
            q[ended], done[ended], step[ended] = shape, beyond, _BEYOND
            falls[ended] += 1
            lost[ended] = ~landed | (falls[ended] > _MOST_FALLS)


def turned_loads(problem: Problem, angle: Array) -> Problem:
    """With dead forces turned by `angle` (T,) [rad], as weights on a base turned the other way."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = problem.dead_force[..., 0], problem.dead_force[..., 1]
    return replace(problem, dead_force=np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1))


def turn_into(problem: Problem, start: Array, turned: Array) -> tuple[Array, BoolArray, IntArray]:
    """As `lead`, while the base turns by `turned` (T,) [rad] into the setting of `problem`, loads fixed in the room;
    `start` (T, Q) is stable under `turned_loads(problem, turned)`."""

    def way(frames: IntArray, share: Array) -> Problem:
        return turned_loads(problem.take(frames), (1.0 - share) * turned[frames])

    return lead(way, start)
