"""Commands that bend a learned beam."""

from __future__ import annotations

import math

import numpy as np
from rich.console import Console

from onebend.cli.common import BY, clean_errors, gravity_on, print_summary, read_trusted, workplace
from onebend.control.reach.reach import Reach, ReachSettings
from onebend.control.reach.reach import reach as solve_reach
from onebend.control.reach.reachable import ReachableSet, reachable
from onebend.control.reach.uncertainty import predicted_error
from onebend.errors import ControlError
from onebend.report.figures.reaching import reaching
from onebend.report.figures.style import png_of
from onebend.results.folder import publish
from onebend.results.reaching import REACH_FORMAT, reach_summary, reach_writer
from onebend.terminal.options import Json, Model, Output, Overwrite
from onebend.terminal.reaching import (
    Direction,
    Goal,
    GoalAngle,
    Gravity,
    MaxCurvature,
    Moment,
    Point,
    PushAt,
    ReachMaxForce,
    ReachMethod,
    show_reach,
)


def reach(
    model: Model,
    *,
    goal: Goal,
    push_at: PushAt = 1.0,
    point: Point = 1.0,
    goal_angle: GoalAngle = None,
    method: ReachMethod = "newton",
    max_force: ReachMaxForce = None,
    max_curvature: MaxCurvature = None,
    direction: Direction = None,
    moment: Moment = False,
    gravity: Gravity = (0.0, 0.0),
    output: Output = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the force that puts a point of a learned beam on a goal (Algorithm 1, Fig. 8)."""
    with clean_errors():
        stored = read_trusted(model)
        way = None if direction is None else math.radians(direction)
        weight = gravity_on(stored.beam, gravity)
        settings = ReachSettings(method, max_force, max_curvature, direction=way, moment=moment, gravity=weight)
        wanted = np.array([*goal, *([] if goal_angle is None else [math.radians(goal_angle)])])
        found = solve_reach(stored.beam, wanted, push_s=push_at, point_s=point, settings=settings)
        if not found.converged:
            raise ControlError(found.reason)
        error = None if stored.uncertain is None else predicted_error(stored.beam, stored.uncertain, found)
        summary = reach_summary(str(model), found, error, written_by=BY)
        if output is not None:
            with workplace(output, REACH_FORMAT, overwrite) as place:
                picture = png_of(reaching(found, error, _within(found)))
                publish(place, reach_writer(found, picture, summary))
    if as_json:
        print_summary(summary, output)
    else:
        show_reach(Console(), found, error, output)


def _within(found: Reach) -> ReachableSet | None:
    """All that forces of the asked size can do; None where the force has no bound."""
    settings = found.settings
    if settings.max_force is None:
        return None
    return reachable(
        found.beam,
        push_s=found.push_s,
        point_s=found.point_s,
        max_force=settings.max_force,
        max_curvature=settings.max_curvature,
        gravity=settings.gravity,
    )
