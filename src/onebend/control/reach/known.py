"""Equilibria that are known beforehand, and the load for a goal near one of them.

Forces in all directions and sizes are laid on a beam once; each equilibrium is followed from rest while its force
grows, and counts where it is stable. A goal near the place of one is a step away: its load and shape are predicted by
the derivatives there and corrected by Newton's method. As in `continuation.py` the step counts only where the
corrector moves the shape little beside the prediction and every tangent is positive: then it is on the same branch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import solve_each, transposed
from onebend.beam.loads import push, weight
from onebend.beam.statics.continuation import ContinuationSettings, follow
from onebend.beam.statics.equilibrium import tangent
from onebend.beam.statics.problem import make_problem
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.newton import NewtonResult, solve_goal
from onebend.records import Array

_DIRECTIONS = 20
_SIZES = 0.5 * 2.0 ** np.arange(6)  # times k / (L s_a^2): up to 16
_WAY = ContinuationSettings(tolerance=1e-8, min_step=0.05, max_steps=7)  # what takes more steps is left out
_TURN_WEIGHT = 0.03  # of L: the distance that a radian of turn weighs, so that of two ways the less bent is taken
_LARGEST_STEP_TURN, _TRUST, _TRUST_GROWTH, _LEAST_TRUST = 0.7, 0.25, 0.5, 1e-3  # as in `continuation.py`
_LEAST_DETERMINANT = 1e-9  # of the compliance, over its size squared: below it the goal does not say the force


@dataclass(frozen=True)
class KnownEquilibria:
    """C stable equilibria of a `PushedBeam`, rest among them, and how they go with the force."""

    q: Array  # (C, n) rad
    force: Array  # (C, 2) N
    places: Array  # (C, 2) m
    bent: Array  # (C,) m^2: square of what its turn weighs
    shape_by_force: Array  # (C, n, 2) rad/N: Y
    force_by_place: Array  # (C, 2, 2) N/m: inverse of S


def known_equilibria(pushed: PushedBeam) -> KnownEquilibria:
    """Made once and remembered by the beam."""
    key = (KnownEquilibria, pushed.push_s, pushed.point_s, pushed.gravity, pushed.resolution)
    return pushed.beam.memory.once(key, lambda: _sampled(pushed))


def step_to(pushed: PushedBeam, goal: Array) -> tuple[LoadedState, NewtonResult] | None:
    """The known equilibrium nearest to a goal (2,), and where one step from it ends; None where that is no step."""
    known = known_equilibria(pushed)
    away = goal - known.places
    i = int(np.argmin(away[:, 0] ** 2 + away[:, 1] ** 2 + known.bent))
    change = known.force_by_place[i] @ away[i]
    curve = known.shape_by_force[i] @ change
    turn = float(np.abs(pushed.b @ curve).max())
    if not turn < _LARGEST_STEP_TURN:
        return None
    x, y = known.force[i] + change
    ahead = LoadedState(known.q[i] + curve, np.array([x, y, 0.0]))
    result = solve_goal(pushed, ahead, goal, most=8, trust=min(_TRUST, _LEAST_TRUST + _TRUST_GROWTH * turn))
    if not (result.converged and result.positive):
        return None
    return LoadedState(known.q[i], np.array([*known.force[i], 0.0])), result


def _sampled(pushed: PushedBeam) -> KnownEquilibria:
    turn = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
    size = pushed.force_scale * np.concatenate([np.zeros(1), np.repeat(_SIZES, _DIRECTIONS)])
    turn = np.concatenate([np.zeros(1), np.tile(turn, len(_SIZES))])
    force = size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    loads = push(force, pushed.push_s) + weight(pushed.gravity)
    solved = follow(make_problem(pushed.beam, loads, pushed.resolution), settings=_WAY)
    good = solved.converged & solved.stable
    q, force = solved.q[good, : pushed.count], force[good]
    alpha = q @ pushed.b.T + pushed.angles(np.zeros(pushed.count))
    cos, sin = np.cos(alpha), np.sin(alpha)
    pulls = np.stack([-pushed.pull * sin[:, : pushed.count], pushed.pull * cos[:, : pushed.count]], axis=1)
    matrices = tangent(solved.problem, solved.q)[good][:, : pushed.count, : pushed.count]
    by_force = solve_each(matrices, transposed(pulls @ pushed.square))
    moves = np.stack([-pushed.row * sin, pushed.row * cos], axis=1)
    compliance = (moves @ pushed.b) @ by_force
    places = np.stack([cos @ pushed.row, sin @ pushed.row], axis=-1)
    turned = np.max(np.abs((q - pushed.start.q) @ pushed.b.T), axis=1)
    weighs = (_TURN_WEIGHT * float(pushed.problem.length) * turned) ** 2
    size = np.abs(np.linalg.det(compliance)) / np.maximum(np.sum(compliance**2, axis=(1, 2)), 1e-300)
    told = size > _LEAST_DETERMINANT
    inverse = np.linalg.inv(compliance[told])
    return KnownEquilibria(q[told], force[told], places[told], weighs[told], by_force[told], inverse)
