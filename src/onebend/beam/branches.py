"""Stable equilibria of a beam with a free end under dead loads: all of them, and those to which a way leads.

A soft beam under a load has one or two of them as a rule: it may hang to the left or to the right. They are found by
letting evenly bent shapes fall, to both sides and more than half around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onebend.beam.continuation import let_fall
from onebend.beam.problem import Problem
from onebend.beam.statics import correct, is_stable, node_angles
from onebend.records import Array, BoolArray, IntArray

_STARTS = np.array([-6.0, -3.0, -1.0, 1.0, 3.0, 6.0])  # rad, turn of the free end of the shapes that fall
_SAME = 1e-6  # rad, distance below which equilibria are one


def stable_equilibria(problem: Problem) -> tuple[Array, IntArray]:
    """Curvatures (E, Q) [rad] of the stable equilibria under dead loads, and their frames (E,), ordered by the angle of
    the free end."""
    every = np.repeat(np.arange(problem.size), len(_STARTS))
    bent = np.tile(_STARTS, problem.size)[:, None] + np.broadcast_to(problem.q0, problem.dead_force.shape[:2])[every]
    q, landed = let_fall(problem.take(every), bent)
    q, frame = q[landed], every[landed]
    alpha = node_angles(problem.take(frame), q)
    order = np.lexsort((alpha[:, -1], frame))
    q, frame, alpha = q[order], frame[order], alpha[order]
    same = (np.diff(frame) == 0) & (np.max(np.abs(np.diff(alpha, axis=0)), axis=-1, initial=0.0) < _SAME)
    new = np.append(np.ones(min(len(frame), 1), dtype=bool), ~same)
    return q[new], frame[new]


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
