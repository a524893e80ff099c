"""A beam with a free end, led slowly from one setting of its loads to another: while its base is turned, say.

The beam stays on its branch of equilibria as long as that is stable. Where it ends (a fold) the beam falls, the setting
a little beyond, to where it stands (`snap_through.py`), and is led on from there: so the way back can lead elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onebend.beam.statics.equilibrium import is_stable
from onebend.beam.statics.newton import correct
from onebend.beam.statics.problem import Problem
from onebend.beam.statics.snap_through import let_fall
from onebend.records import Array, BoolArray, IntArray

Way = Callable[[IntArray, Array], Problem]  # frames, share of the way (F,) -> their problem there

_TRUST = 0.3  # rad, the largest turn that one step may take
_FIRST = 0.1  # share of the way
_SHORTEST = 1e-7  # share of the way: where no step above this keeps the beam stable, it falls
_BEYOND = 1e-4  # share of the way by which the setting goes past a fold while the beam falls
_MOST_FALLS = 50


def lead(way: Way, start: Array) -> tuple[Array, BoolArray, IntArray]:
    """From stable shapes `start` (T, Q) [rad] at the beginning of the way to its end.

    Returns the shapes there, True where they stand in stable equilibrium, and how often each frame fell on the way.
    """
    q, done, step = start.copy(), np.zeros(len(start)), np.full(len(start), _FIRST)
    falls, lost = np.zeros(len(start), dtype=np.int64), np.zeros(len(start), dtype=bool)
    while True:
        todo = np.flatnonzero((done < 1.0) & ~lost)
        if todo.size == 0:
            return q, ~lost, falls
        target = np.minimum(done[todo] + step[todo], 1.0)
        problem, full = way(todo, target), np.ones(todo.size)
        shape, near, _ = correct(problem, q[todo], full, trust=_TRUST * full, remaining=1e-11 * full)
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
    """With all dead forces turned by `angle` (T,) [rad]: what a base that is turned the other way makes of weights."""
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y = problem.dead_force[..., 0], problem.dead_force[..., 1]
    return replace(problem, dead_force=np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1))


def turn_into(problem: Problem, start: Array, turned: Array) -> tuple[Array, BoolArray, IntArray]:
    """As `lead`, while the base turns by `turned` (T,) [rad] into the setting of `problem`, its loads kept in the room.

    `start` (T, Q): stable shapes before the turn, `turned_loads(problem, turned)`.
    """

    def way(frames: IntArray, share: Array) -> Problem:
        return turned_loads(problem.take(frames), (1.0 - share) * turned[frames])

    return lead(way, start)
