"""Commands that bend a learned beam, or rehearse to."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, or_unlimited, print_summary, put_in_place, screen, workplace
from onebend.cli.models import gravity_on, read_trusted
from onebend.cli.options import LEAST, MOST, Goal, Gravity, Json, Model, Output, Overwrite, Point, PushAt
from onebend.control.loop.controller import controller
from onebend.control.loop.robustness import MOST_DRAWN, drawn_beams, simulate_trials, trial_settings, wrong_beams
from onebend.control.loop.simulation import LoopCamera
from onebend.control.reach.reach import Reach, ReachSettings
from onebend.control.reach.reach import reach as solve_reach
from onebend.control.reach.reachable import ReachableSet, reachable
from onebend.control.reach.uncertainty import predicted_error
from onebend.errors import ControlError
from onebend.report.figures.pictures import draw
from onebend.results.looping import LOOP_FORMAT, loop_summary, loop_writer
from onebend.results.model import model_file
from onebend.results.provenance import inputs_of
from onebend.results.reaching import REACH_FORMAT, reach_summary, reach_writer
from onebend.terminal.looping import show_loop
from onebend.terminal.reaching import show_reach

GoalAngle = Annotated[
    float | None,
    typer.Option("--goal-angle-deg", metavar="DEG", help="The tangent's angle at the point; needs --moment."),
]
ReachMethod = Annotated[
    Literal["newton", "paper"],
    typer.Option(help="newton: exact. paper: Algorithm 1 to the letter, its force put on the exact beam."),
]
ReachMaxForce = Annotated[
    float | None,
    typer.Option("--max-force-N", min=LEAST, max=MOST, metavar="N", help="No larger force; default: no bound."),
]
MaxCurvature = Annotated[
    float | None,
    typer.Option(
        "--max-curvature-per-m", min=LEAST, max=MOST, metavar="1/M", help="The beam bends no more than this from rest."
    ),
]
Direction = Annotated[
    float | None,
    typer.Option("--direction-deg", metavar="DEG", help="The force can only push this way (0: along x)."),
]
KError = Annotated[
    float,
    typer.Option(
        "--k-error",
        min=0.0,
        max=0.95,
        metavar="SHARE",
        help="Rehearse on beams this share softer and stiffer, for which the gains are chosen too.",
    ),
]
Draws = Annotated[
    int | None,
    typer.Option(
        "--draws", min=1, max=MOST_DRAWN, metavar="N", help="Rehearse on N beams drawn from the band of k(s) instead."
    ),
]
Noise = Annotated[
    float,
    typer.Option("--noise-mm", min=0.0, max=1e3, metavar="MM", help="Of each coordinate the camera sees, one sd."),
]
Delay = Annotated[
    float,
    typer.Option("--delay-ms", min=0.0, max=10_000.0, metavar="MS", help="From a frame's exposure to its answer."),
]
Rate = Annotated[
    float, typer.Option("--fps", min=0.1, max=100_000.0, metavar="HZ", help="Frames of the camera a second.")
]
Duration = Annotated[
    float, typer.Option("--duration-s", min=2.0, max=600.0, metavar="S", help="Of each rehearsal; at least two.")
]
LoopMaxForce = Annotated[
    float | None, typer.Option("--max-force-N", min=LEAST, max=MOST, metavar="N", help="No larger force.")
]
Feeling = Annotated[
    Literal["nothing", "log", "shape"],
    typer.Option(
        "--felt",
        help="What tells the loop the force on the beam. log: a sensor. shape: the tags, as `onebend sense` does.",
    ),
]
ForceOff = Annotated[
    float,
    typer.Option(
        "--force-off-N",
        min=0.0,
        max=1000.0,
        metavar="N",
        help="By so much the robot's force is off, across it, and the log of --felt log, along it.",
    ),
]
Hidden = Annotated[bool, typer.Option("--hidden", help="The camera never sees the point, nor a tag on it.")]
Moment = Annotated[bool, typer.Option("--moment", help="The gripper gives a moment too.")]


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
            from onebend.report.figures.reaching import reaching  # here: Matplotlib is for pictures alone

            with workplace(output, REACH_FORMAT, overwrite) as place:
                pictures = draw({"reach": lambda: reaching(found, error, _within(found))})
                inputs = inputs_of([model_file(model)])
                put_in_place(place, reach_writer(found, pictures, summary), pictures, inputs=inputs)
    if as_json:
        print_summary(summary, output)
    else:
        show_reach(screen(), found, error, output)


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


def loop(
    model: Model,
    *,
    goal: Goal,
    push_at: PushAt = 1.0,
    point: Point = 1.0,
    k_error: KError = 0.3,
    draws: Draws = None,
    delay_ms: Delay = 50.0,
    fps: Rate = 30.0,
    noise_mm: Noise = 0.05,
    max_force: LoopMaxForce = None,
    gravity: Gravity = (0.0, 0.0),
    felt: Feeling = "nothing",
    force_off: ForceOff = 0.0,
    hidden: Hidden = False,
    duration: Duration = 8.0,
    output: Output = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Rehearse a closed loop: force for a goal, corrected by a camera, on beams that are not the model."""
    from onebend.forecast.sensed_force import felt_by  # here: learning and lab, which `reach` does without

    with clean_errors():
        stored = read_trusted(model)
        beam, delay = stored.beam, 1e-3 * delay_ms
        beams = wrong_beams(beam, k_error) if draws is None else drawn_beams(beam, stored.uncertain, draws)
        settings = trial_settings(fps, delay, k_error, or_unlimited(max_force))
        control = controller(
            beam, goal, push_s=push_at, point_s=point, gravity=gravity_on(beam, gravity), settings=settings
        )
        feel = felt_by(
            felt,
            control,
            stiffness=stored.uncertain,
            instruments=stored.bench,
            force_off=force_off,
            hidden=hidden,
        )
        eye = LoopCamera(fps=fps, delay=delay, noise=1e-3 * noise_mm, hidden=((0.0, math.inf),) if hidden else ())
        trials = tuple(simulate_trials(control, beams, eye=eye, duration=duration, force_off=force_off, feel=feel))
        known = control.margins()
        rehearsed: dict[str, object] = {"felt": felt, "force_off_N": force_off, "hidden": hidden}
        summary = loop_summary(str(model), control, known, trials, rehearsed, written_by=BY)
        if output is not None:
            from onebend.report.figures.looping import looping  # here: Matplotlib is for pictures alone

            with workplace(output, LOOP_FORMAT, overwrite) as place:
                pictures = draw({"loop": lambda: looping(control, trials)})
                inputs = inputs_of([model_file(model)])
                put_in_place(place, loop_writer(trials, pictures, summary), pictures, inputs=inputs)
    if as_json:
        print_summary(summary, output)
    else:
        show_loop(screen(), control, known, trials, output, rehearsed)
