"""Commands that hold a learned beam in a shape, and lead it along a path."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from onebend.beam.model import Beam
from onebend.cli import BY
from onebend.cli.common import clean_errors, or_unlimited, print_summary, put_in_place, screen, workplace
from onebend.cli.models import gravity_on, read_trusted
from onebend.cli.options import LEAST, MOST, Gravity, Json, Model, Output, Overwrite
from onebend.control.goals.moving_goals import Between, Goals
from onebend.control.goals.target_files import read_goals, read_targets
from onebend.control.path.follow import PathSettings, follow_goals
from onebend.control.path.force_interpolation import by_force
from onebend.control.path.path_spread import path_spread
from onebend.control.path.timing import RateLimits
from onebend.control.path.trajectory_files import FRAME
from onebend.control.shape.actuators import Grip, Pusher
from onebend.control.shape.shape import ShapeSettings
from onebend.control.shape.shape import shape as solve_shape
from onebend.errors import ControlError
from onebend.extras import installed
from onebend.report.figures.pictures import draw
from onebend.results.model import model_file
from onebend.results.provenance import inputs_of
from onebend.results.shaping import PATH_FORMAT, SHAPE_FORMAT, path_summary, path_writer, shape_summary, shape_writer
from onebend.terminal.shaping import show_path, show_shape

TargetsFile = Annotated[
    Path, typer.Option("--targets", metavar="CSV", help="Columns s, x_m, y_m, angle_rad, weight; one row a place.")
]
GoalsFile = Annotated[
    Path, typer.Option("--goals", metavar="CSV", help="Columns time_s, x_m, y_m; with s, angle_rad, weight: shapes.")
]
Gripped = Annotated[bool, typer.Option("--grip", help="A gripper holds the end s = 1 at a position and an angle.")]
PushPlaces = Annotated[
    list[float] | None,
    typer.Option(
        "--push-at",
        min=LEAST,
        max=1.0,
        metavar="S",
        help="A force acts here: s in (0, 1]; may be repeated. Default: the tip.",
    ),
]
GoalPoint = Annotated[
    float, typer.Option("--point", min=LEAST, max=1.0, metavar="S", help="The point led along goals without column s.")
]
HandMaxForce = Annotated[
    float | None,
    typer.Option(
        "--max-force-N", min=LEAST, max=MOST, metavar="N", help="Of every push and of the gripper; default: no bound."
    ),
]
HandMaxMoment = Annotated[
    float | None,
    typer.Option("--max-moment-N-m", min=LEAST, max=MOST, metavar="N_M", help="Of the gripper; default: no bound."),
]
Arm = Annotated[
    float | None,
    typer.Option(
        "--arm-m", min=0.0, max=MOST, metavar="M", help="An error of 1 rad counts as one of so many metres; default: L."
    ),
]
SampleRate = Annotated[float, typer.Option("--rate-Hz", min=LEAST, max=1e6, metavar="HZ", help="Samples of the path.")]
MaxForceRate = Annotated[
    float | None, typer.Option("--max-force-rate-N-per-s", min=LEAST, max=MOST, metavar="N/S", help="Of every push.")
]
MaxSpeed = Annotated[
    float | None, typer.Option("--max-speed-m-per-s", min=LEAST, max=MOST, metavar="M/S", help="Of the gripper.")
]
MaxTurnRate = Annotated[
    float | None,
    typer.Option("--max-turn-rate-deg-per-s", min=LEAST, max=MOST, metavar="DEG/S", help="Of the gripper."),
]
TooFast = Annotated[
    Literal["stretch", "refuse"],
    typer.Option("--too-fast", help="Where a limit on a rate is broken: take more time there, or say when and stop."),
]
BetweenGoals = Annotated[
    Literal["force", "smooth", "monotone", "linear"] | None,
    typer.Option(
        "--between",
        help="From goal to goal: the force goes evenly (default for one push and one point); or the point does: a "
        "cubic spline (default otherwise), one that does not swing beyond, straight.",
    ),
]
FrameName = Annotated[str, typer.Option("--frame", metavar="NAME", help="The beam's frame in the ROS messages.")]

FAR = 0.5  # of the length, rms from the targets: no shape to be of use


def shape(
    model: Model,
    *,
    targets: TargetsFile,
    grip: Gripped = False,
    push_at: PushPlaces = None,
    max_force: HandMaxForce = None,
    max_moment: HandMaxMoment = None,
    arm: Arm = None,
    gravity: Gravity = (0.0, 0.0),
    output: Output = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find the forces, or the gripper's pose, that bring a learned beam closest to a wanted shape."""
    with clean_errors():
        stored = read_trusted(model)
        pushes, holding = _actuators(grip, push_at, max_force, max_moment)
        wanted = read_targets(targets, stored.beam.length)
        found = solve_shape(
            stored.beam,
            wanted,
            pushes=pushes,
            grip=holding,
            gravity=gravity_on(stored.beam, gravity),
            uncertain=stored.uncertain,
            settings=ShapeSettings(arm=arm),
        )
        if found.rms > FAR * stored.beam.length:
            raise ControlError(
                f"nothing near the targets can be reached: the closest shape is {1e3 * found.rms:.4g} mm rms away from "
                f"them, the beam {1e3 * stored.beam.length:.4g} mm long. Give targets that the beam can reach"
            )
        summary = shape_summary(str(model), found, written_by=BY)
        if output is not None:
            from onebend.report.figures.shaping import shaping  # here: Matplotlib is for pictures alone

            with workplace(output, SHAPE_FORMAT, overwrite) as place:
                pictures = draw({"shape": lambda: shaping(stored.beam, found)})
                inputs = inputs_of([model_file(model), targets])
                put_in_place(place, shape_writer(found, pictures, summary), pictures, inputs=inputs)
    if as_json:
        print_summary(summary, output)
    else:
        show_shape(screen(), found, output)


def path(
    model: Model,
    *,
    goals: GoalsFile,
    point: GoalPoint = 1.0,
    grip: Gripped = False,
    push_at: PushPlaces = None,
    max_force: HandMaxForce = None,
    max_moment: HandMaxMoment = None,
    rate: SampleRate = 1000.0,
    max_force_rate: MaxForceRate = None,
    max_speed: MaxSpeed = None,
    max_turn_rate: MaxTurnRate = None,
    too_fast: TooFast = "stretch",
    between: BetweenGoals = None,
    arm: Arm = None,
    gravity: Gravity = (0.0, 0.0),
    frame: FrameName = FRAME,
    output: Output = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Turn goals in time into forces, or gripper poses, in time: CSV, ROS 2 messages, a ROS 2 bag."""
    with clean_errors():
        stored = read_trusted(model)
        if not frame or not frame.isprintable():
            raise ControlError(f"--frame {frame!r} is no name of a frame: leave out what cannot be printed")
        _no_idle_limit(grip, {"--max-speed-m-per-s": max_speed, "--max-turn-rate-deg-per-s": max_turn_rate})
        pushes, holding = _actuators(grip, push_at, max_force, max_moment)
        if not pushes and max_force_rate is not None:
            raise ControlError(
                "--max-force-rate-N-per-s limits a push, and there is none: add --push-at, or leave it out"
            )
        turning = math.radians(or_unlimited(max_turn_rate))
        limits = RateLimits(force=or_unlimited(max_force_rate), speed=or_unlimited(max_speed), turning=turning)
        settings = PathSettings(rate=rate, limits=limits, too_fast=too_fast, shape=ShapeSettings(arm=arm))
        weight = gravity_on(stored.beam, gravity)
        by_points: Between = "smooth" if between is None or between == "force" else between
        wanted = read_goals(goals, point_s=point, between=by_points)
        if between == "force" or (between is None and _alone(wanted, pushes, holding)):
            wanted = _led(stored.beam, wanted, pushes, holding, weight)
        way = follow_goals(stored.beam, wanted, pushes=pushes, grip=holding, gravity=weight, settings=settings)
        sure = None if stored.uncertain is None else path_spread(way, stored.uncertain)
        summary = path_summary(str(model), way, sure, written_by=BY)
        bag = installed("rosbags")
        if output is not None:
            from onebend.report.figures.shaping import path_figure  # here: Matplotlib is for pictures alone

            with workplace(output, PATH_FORMAT, overwrite) as place:
                pictures = draw({"path": lambda: path_figure(way)})
                inputs = inputs_of([model_file(model), goals])
                put_in_place(place, path_writer(way, pictures, summary, frame=frame, bag=bag), pictures, inputs=inputs)
    if as_json:
        print_summary(summary, output)
    else:
        show_path(screen(), way, sure, output, bag=bag)


def _alone(goals: Goals, pushes: tuple[Pusher, ...], grip: Grip | None) -> bool:
    """Whether one push leads one point."""
    return grip is None and len(pushes) == 1 and len(goals.targets.s) == 1 and not goals.targets.turned.any()


def _led(beam: Beam, goals: Goals, pushes: tuple[Pusher, ...], grip: Grip | None, weight: tuple[float, float]) -> Goals:
    if grip is not None or len(pushes) != 1:
        raise ControlError("--between force is for one push; with a grip or more pushes take smooth")
    [one] = pushes
    limit = one.max_force if math.isfinite(one.max_force) else None
    return by_force(beam, goals, push_s=one.at_s, max_force=limit, gravity=weight)


def _no_idle_limit(grip: bool, limits: dict[str, float | None]) -> None:
    """A limit of a gripper that is not there would be kept by nobody."""
    for name, limit in limits.items():
        if limit is not None and not grip:
            raise ControlError(f"{name} limits a gripper, and there is none: add --grip, or leave it out")


def _actuators(
    grip: bool, push_at: list[float] | None, max_force: float | None, max_moment: float | None
) -> tuple[tuple[Pusher, ...], Grip | None]:
    """Without a word a push at the tip; with a grip only the pushes that are named."""
    _no_idle_limit(grip, {"--max-moment-N-m": max_moment})
    places = push_at if push_at is not None else ([] if grip else [1.0])
    pushes = tuple(Pusher(place, or_unlimited(max_force)) for place in places)
    return pushes, Grip(or_unlimited(max_force), or_unlimited(max_moment)) if grip else None
