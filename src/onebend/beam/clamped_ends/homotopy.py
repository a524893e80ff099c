"""A held beam followed while its loads, rest shape, pose or strains go over from one setting to another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onebend.beam.clamped_ends.end_pose import newton, stands
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray, IntArray

_TRUST = 0.4  # rad, the largest turn that one step may take
_SHORTEST = 1e-5  # share of the way: where no step above this keeps the beam stable, it snaps

Homotopy = Callable[[IntArray, Array], tuple[Problem, Array]]  # frames, share of the way -> problem and pose there


def rigid(problem: Problem) -> Problem:
    """The same beam without stretch and shear."""
    return problem if problem.compliance is None else replace(problem, section=None, stretch=None, shear=None)


def let_strain(problem: Problem, q: Array, wrench: Array, goal: Array) -> tuple[Array, Array, BoolArray]:
    """Shapes and wrenches (T, 3) of `rigid` beams as stretch and shear grow from nothing; True where they got there."""
    if problem.compliance is None:
        return q, wrench, np.ones(len(q), dtype=bool)

    def partly(frames: IntArray, share: Array) -> tuple[Problem, Array]:
        return problem.take(frames).strained(share), goal[frames]

    q, wrench, share = follow_homotopy(partly, q, wrench)
    return q, wrench, np.asarray(share == 1.0)


def release(problem: Problem, begin: Array, goal: Array) -> tuple[Array, Array, Array]:
    """From `begin` as a stress-free shape over to the true rest curvature and loads, the end held at `goal`."""

    def partly(frames: IntArray, share: Array) -> tuple[Problem, Array]:
        part, f = problem.take(frames), share[:, None]
        blended = replace(
            part,
            q0=(1.0 - f) * begin[frames] + f * part.q0,
            dead_force=f[..., None] * part.dead_force,
            moment=f * part.moment,
        )
        return blended, goal[frames]

    return follow_homotopy(partly, begin, np.zeros((len(begin), 3)))


def follow_homotopy(homotopy: Homotopy, start: Array, wrench: Array) -> tuple[Array, Array, Array]:
    """Stable equilibria (T, Q) and their wrench (T, 3) while a setting goes over to its end; the share (T,) reached.

    A step counts if Newton's method settled within `_TRUST` and the second variation stayed positive on the way.
    """
    q, w = start.copy(), wrench.copy()
    done, step = np.zeros(len(q)), np.full(len(q), 0.25)
    while True:
        todo = np.flatnonzero((done < 1.0) & (step > _SHORTEST))
        if todo.size == 0:
            return q, w, done
        target = np.minimum(done[todo] + step[todo], 1.0)
        problem, goal = homotopy(todo, target)
        shape, end_wrench, near = newton(problem, q[todo], w[todo], goal, trust=_TRUST)
        near[near] &= stands(problem.take(near), shape[near], end_wrench[near])
        q[todo[near]], w[todo[near]], done[todo[near]] = shape[near], end_wrench[near], target[near]
        step[todo] = np.where(near, 2.0, 0.25) * step[todo]
