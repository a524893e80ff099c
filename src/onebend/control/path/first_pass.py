"""A path's first pass: shapes at knots along it, each found from the one before."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.statics.rod import Rod
from onebend.control.goals.moving_goals import Goals
from onebend.control.shape.actuators import BeamState, Grip, Pusher, resting_state
from onebend.control.shape.descent import DescentResult, descend
from onebend.control.shape.shape import ShapeSettings, shape
from onebend.errors import ControlError
from onebend.records import Array

_KNOT_SPACING = 0.02  # of L: the way of a target from knot to knot
_FEWEST_KNOTS = 12  # knots


def knots_of(goals: Goals, length: float) -> Array:
    """(K,) s: close enough for the shape at one to lead to that at the next."""
    time = np.union1d(np.linspace(goals.time[0], goals.time[-1], 200), goals.time)
    xy, angle = goals.along(time)
    way = np.nan_to_num(np.linalg.norm(np.diff(xy, axis=0), axis=2) / length).max(axis=1)
    turn = np.nan_to_num(np.abs(np.diff(angle, axis=0))).max(axis=1)
    done = np.append(0.0, np.cumsum(np.maximum(way, turn)))
    # Where the goals rest there is no way to go: a little of plain time keeps knots there as well.
    done = done / max(done[-1], 1e-12) + 0.25 * (time - time[0]) / (time[-1] - time[0])
    count = max(_FEWEST_KNOTS, int(np.ceil(np.sum(np.maximum(way, turn)) / _KNOT_SPACING)) + 1)
    return np.asarray(np.interp(np.linspace(0.0, done[-1], count), done, time))


def first_pass(
    beam: Rod,
    goals: Goals,
    knots: Array,
    arm: float,
    pushes: tuple[Pusher, ...],
    grip: Grip | None,
    gravity: ArrayLike | None,
    settings: ShapeSettings,
) -> list[DescentResult]:
    """The shapes at the knots: the first from rest, each other one from that before."""
    first = shape(beam, goals.at(knots[0]), pushes=pushes, grip=grip, gravity=gravity, settings=settings)
    if first.open_freedoms:
        raise ControlError(
            f"the goals leave {first.open_freedoms} of {first.state.actuators.count} freedoms of the forces and the "
            "gripper open, so that there is no one path; want more of the beam (angle_rad, more points), or leave out "
            "a force or the gripper"
        )
    resting = resting_state(beam, pushes, grip, gravity, settings.resolution)
    grid = first.state.actuators.problem.grid
    state = BeamState(
        resting.actuators, grid.value_at(resting.actuators.problem.grid.nodes) @ first.state.q, first.state.u
    )
    results = [descend(state, goals.at(knots[0]), arm, settings.descent)]
    warm = replace(settings.descent, damping=0.0)
    for before, time in pairwise(knots):
        _check(results[-1], float(before))
        results.append(descend(results[-1].state, goals.at(float(time)), arm, warm))
    _check(results[-1], float(knots[-1]))
    return results


def _check(result: DescentResult, time: float) -> None:
    if result.near_buckling:
        raise ControlError(
            f"at {time:.4g} s the beam is about to buckle (margin {result.state.margin:.3g}) on its way to the goal; "
            "lead it another way, or give it a grip"
        )
    if not result.converged:
        raise ControlError(f"at {time:.4g} s no stable shape closest to the goal was found; give more goals before it")
