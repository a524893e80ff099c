"""Goals of one point under a single force, joined by a path on which the force exists everywhere.

One force can hold a point only within a thin region, where the beam is stable; a straight path from goal to goal may
leave it. So the force is interpolated from goal to goal, and the point follows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from onebend.beam.model import Beam
from onebend.blas import one_blas_thread
from onebend.control.goals.moving_goals import Goals
from onebend.control.reach.reach import reach
from onebend.control.reach.settings import ReachSettings
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array

_GOALS_PER_STEP = 24  # goals from goal to goal
_SAME_PLACE = 1e-5  # of L


@one_blas_thread
def by_force(
    beam: Beam,
    goals: Goals,
    *,
    push_s: float = 1.0,
    max_force: float | None = None,
    gravity: tuple[float, float] = (0.0, 0.0),
) -> Goals:
    """The same goals at the same times, and more between them, all within reach of a force at `push_s`.

    Raises:
        ControlError: goals of more than one point or of an angle, a goal out of reach (with its time), or a force that
            goes from goal to goal through a place where the beam would jump.
    """
    if len(goals.targets.s) != 1 or not bool(goals.targets.placed[0]) or bool(goals.targets.turned[0]):
        raise ControlError("a single force leads one point, without an angle; lead more with a grip or more forces")
    point_s = float(goals.targets.s[0])
    settings = ReachSettings(max_force=max_force, gravity=gravity)
    forces = np.array([_force(beam, goals, k, push_s, point_s, settings) for k in range(len(goals.time))])
    time = np.unique(
        np.concatenate(
            [np.linspace(*ends, _GOALS_PER_STEP + 1) for ends in zip(goals.time, goals.time[1:], strict=False)]
        )
    )
    try:
        forces = PchipInterpolator(goals.time, forces)(time)
        shape = beam.equilibrium(forces, push_s, gravity=gravity if any(gravity) else None)
    except MechanicsError as error:
        raise ControlError(f"on the way from goal to goal {error}") from error
    xy = shape.xy(np.array([point_s]))
    met = np.linalg.norm(xy[np.searchsorted(time, goals.time), 0] - goals.xy[:, 0], axis=1)
    if np.max(met) > _SAME_PLACE * beam.length:
        at = goals.time[int(np.argmax(met))]
        raise ControlError(f"the goal at {at:.4g} s lies on another branch of shapes: the beam would jump on its way")
    return replace(goals, time=time, xy=xy, angle=np.full((len(time), 1), np.nan))


def _force(beam: Beam, goals: Goals, k: int, push_s: float, point_s: float, settings: ReachSettings) -> Array:
    result = reach(beam, goals.xy[k, 0], push_s=push_s, point_s=point_s, settings=settings)
    if not result.converged:
        raise ControlError(f"the goal at {goals.time[k]:.4g} s: {result.reason}")
    return np.asarray(result.force)
