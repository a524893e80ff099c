"""Falling from where a beam cannot stay: slowly, downhill, until it stands.

The fall is that of a beam whose internal damping, in proportion to its stiffness, is so strong that nothing swings:
`w k q' = -g(q)`. Under dead loads it goes down the potential by the steepest way, measured by bending energy. Its steps
are implicit,

    (T + sigma w k) dq = -g,    sigma as small as keeps the matrix positive,

so that near a stable equilibrium they become Newton's; each is bounded in turn and must do work. Work is integrated
along the step, `-int g . dq`, which needs no potential (follower forces have none) and is exact where the potential
changes by less than its rounding error (next to a bifurcation).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.statics.equilibrium import balance, gradient, is_stable, scaled
from onebend.beam.statics.newton import correct, solve_batch
from onebend.beam.statics.nodal_forces import node_angles
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

Side = Literal["left", "right"]

_MAX_TURN = 0.3  # rad, the largest turn of a step
_MIN_TURN = 1e-9  # rad, of a step that still does no work: the frame is given up
_NUDGE = 1e-4  # rad, the turn that takes a beam out of an exact equilibrium
_RESIDUAL_DECIDES = 1e-9  # share of the stiffness: an out-of-balance above it says by itself which way to fall
_NEWTON_TURN = 1e-2  # rad, of a step: below it Newton's method is tried
_MAX_STEPS = 400  # steps
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def let_fall(problem: Problem, start: Array, side: Side = "left") -> tuple[Array, BoolArray]:
    """From shapes `start` (T, Q) down to stable equilibria (T, Q); True where one was reached.

    A shape in unstable equilibrium leaves it along its least stable mode: `side` says whether the beam sets out to its
    left or to its right. From any other shape the loads decide. A stable shape stays where it is.
    """
    q = _nudged(problem, start, side)
    landed, given_up = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    reach = np.full(len(q), _MAX_TURN)
    for _ in range(_MAX_STEPS):
        todo = np.flatnonzero(~(landed | given_up))
        if todo.size == 0:
            break
        part = problem.take(todo)
        step, convex = _downhill(part, q[todo])
        turn = np.max(np.abs(apply(part.to_nodes, step)), axis=-1)
        share = np.minimum(1.0, reach[todo] / np.maximum(turn, 1e-300))
        step, turn = share[:, None] * step, share * turn
        falls = _work(part, q[todo], step) > 0.0
        q[todo[falls]] += step[falls]
        reach[todo] = np.where(falls, np.minimum(2.0 * reach[todo], _MAX_TURN), 0.25 * turn)
        given_up[todo] = ~falls & ~(turn > _MIN_TURN)
        close = todo[(turn < _NEWTON_TURN) & (convex | (problem.follower.shape[1] > 0))]
        landed[close], q[close] = _land(problem.take(close), q[close])
    return q, landed


def to_the_left(problem: Problem, q: Array, modes: Array) -> Array:
    """(T, P) 1 or -1: the sign with which changes of curvature (T, Q, P) move the beam to its left, on average."""
    alpha = node_angles(problem, q)[..., None]
    turned = problem.to_nodes @ modes
    x, y = -problem.to_nodes @ (np.sin(alpha) * turned), problem.to_nodes @ (np.cos(alpha) * turned)
    moved = np.sum(problem.weights[..., None] * (np.cos(alpha) * y - np.sin(alpha) * x), axis=-2)
    undecided = np.abs(moved) < 1e-9 * np.max(np.abs(turned), axis=-2)
    instead = turned[:, -1] + turned[:, turned.shape[1] // 4]
    return np.where(np.where(undecided, instead, moved) < 0.0, -1.0, 1.0)


def _nudged(problem: Problem, start: Array, side: Side) -> Array:
    """A little off along the least stable mode: where the out-of-balance says, else to the side asked for."""
    slope, matrices = balance(problem, start)
    scale = 1.0 / np.sqrt(problem.weights * problem.k)
    second = scaled(problem, matrices)
    _, vectors = np.linalg.eigh(0.5 * (second + transposed(second)))
    mode = scale * vectors[..., 0]
    pull = -np.sum(slope * mode, axis=-1)  # along a mode of unit energy: in the root of N m
    stiffness = np.sqrt(np.sum(problem.weights * problem.k, axis=-1))
    asked = to_the_left(problem, start, mode[..., None])[:, 0] * (1.0 if side == "left" else -1.0)
    sign = np.where(np.abs(pull) > _RESIDUAL_DECIDES * stiffness, np.sign(pull), asked)
    turn = np.max(np.abs(apply(problem.to_nodes, mode)), axis=-1)
    amplitude = np.where(is_stable(problem, start), 0.0, sign * _NUDGE / turn)
    return np.asarray(start + amplitude[:, None] * mode)


def _downhill(problem: Problem, q: Array) -> tuple[Array, BoolArray]:
    """(T, Q) the implicit step, and whether it is Newton's."""
    slope, matrices = balance(problem, q)
    second = scaled(problem, matrices)
    lowest = np.linalg.eigvalsh(0.5 * (second + transposed(second)))[:, 0]
    scale = 1.0 / np.sqrt(problem.weights * problem.k)
    sigma = np.where(lowest > 0.0, 0.0, 1.2 * np.abs(lowest) + 1e-12)
    shifted = second + sigma[:, None, None] * np.eye(second.shape[-1])
    return -scale * solve_batch(shifted, scale * slope), np.asarray(lowest > 0.0)


def _work(problem: Problem, q: Array, step: Array) -> Array:
    """(T,) N m that loads and bending do on the way from q to q + step."""
    out = np.zeros(len(q))
    for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
        here = gradient(problem, q + 0.5 * (point + 1.0) * step)
        out -= 0.5 * weight * np.sum(here * step, axis=-1)
    return out


def _land(problem: Problem, q: Array) -> tuple[BoolArray, Array]:
    """Newton's method from close by; True where it came to a stable equilibrium, shapes as they were elsewhere."""
    full = np.ones(len(q))
    corrected, near, _ = correct(
        problem, q, full, trust=10.0 * _NEWTON_TURN * full, remaining=1e-13 * full, max_iterations=12
    )
    near[near] &= is_stable(problem.take(near), corrected[near])
    return near, np.where(near[:, None], corrected, q)
