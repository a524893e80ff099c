"""What `onebend shape` and `onebend path` take and say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape

from onebend.control.path.follow import FollowedPath
from onebend.control.path.path_spread import PathSpread
from onebend.control.shape.shape import ShapeResult
from onebend.report.wording import length_words, significant
from onebend.terminal.options import LEAST
from onebend.terminal.parts import NO_BAND, facts_table, force_words, say_written

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
    typer.Option("--max-force-N", min=LEAST, metavar="N", help="Of every push and of the gripper; default: no bound."),
]
HandMaxMoment = Annotated[
    float | None, typer.Option("--max-moment-N-m", min=LEAST, metavar="N_M", help="Of the gripper; default: no bound.")
]
Arm = Annotated[
    float | None,
    typer.Option(
        "--arm-m", min=0.0, metavar="M", help="An error of 1 rad counts as one of so many metres; default: L."
    ),
]
SampleRate = Annotated[float, typer.Option("--rate-Hz", min=LEAST, max=1e6, metavar="HZ", help="Samples of the path.")]
MaxForceRate = Annotated[
    float | None, typer.Option("--max-force-rate-N-per-s", min=LEAST, metavar="N/S", help="Of every push.")
]
MaxSpeed = Annotated[
    float | None, typer.Option("--max-speed-m-per-s", min=LEAST, metavar="M/S", help="Of the gripper.")
]
MaxTurnRate = Annotated[
    float | None, typer.Option("--max-turn-rate-deg-per-s", min=LEAST, metavar="DEG/S", help="Of the gripper.")
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


def show_shape(console: Console, result: ShapeResult, output: Path | None) -> None:
    """The hands, how close the shape is, how far from buckling, how sure."""
    table = facts_table()
    for pusher, force in zip(result.state.actuators.pushes, result.forces, strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", force_words(force))
    if result.wrench is not None:
        x, y, angle = result.pose
        table.add_row("gripper", f"[bold]({1e3 * x:.3f}, {1e3 * y:.3f}) mm at {math.degrees(angle):.2f} deg[/]")
        table.add_row(
            "it puts on the beam", f"({result.wrench[0]:.4g}, {result.wrench[1]:.4g}) N and {result.wrench[2]:.4g} N m"
        )
    table.add_row("from the targets", f"{length_words(result.rms, 3)} rms: {_why(result)}")
    table.add_row("from buckling", f"margin {result.margin:.3f} (1 without loads, 0 where it buckles)")
    table.add_row("sure to within", _sureness(result))
    console.print(table, highlight=False)
    for warning in result.warnings:
        console.print(f"[yellow]![/] {escape(warning)}", highlight=False)
    say_written(console, output, "shape.csv, targets.csv, shape.png, summary.json")


def _why(result: ShapeResult) -> str:
    if result.limits:
        return f"held back by {escape(', '.join(result.limits))}"
    return "the closest that was found" if result.rms > 1e-9 else "they are met"


def _sureness(result: ShapeResult) -> str:
    if result.spread is None:
        return NO_BAND
    return f"{length_words(2.0 * result.spread.rms)} (2 sd over the targets' places, from the band on k(s))"


def show_path(console: Console, way: FollowedPath, sure: PathSpread | None, output: Path | None) -> None:
    """Length, stretch, forces, misses, margin."""
    table = facts_table()
    stretch = f", {way.stretch:.2f} times the goals'" if way.stretch > 1.0 + 1e-6 else ""
    table.add_row("samples", f"{len(way.time)} over {way.time[-1]:.3f} s{stretch}")
    for pusher, force in zip(way.actuators.pushes, np.moveaxis(way.forces, 1, 0), strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", f"up to {significant(float(np.max(np.hypot(*force.T))))} N")
    if way.wrench is not None:
        table.add_row("gripper's force", f"up to {significant(float(np.max(np.hypot(*way.wrench[:, :2].T))))} N")
    table.add_row("from the goals", f"at worst {length_words(float(np.max(way.miss)))} rms in the model")
    table.add_row("sure to within", _path_sureness(sure))
    table.add_row(
        "from buckling", f"margin at least {float(np.min(way.margin)):.3f} (1 without loads, 0 where it buckles)"
    )
    console.print(table, highlight=False)
    for warning in way.warnings:
        console.print(f"[yellow]![/] {escape(warning)}", highlight=False)
    say_written(console, output, "path.csv, ROS 2 messages (YAML and bag), path.png, summary.json")


def _path_sureness(sure: PathSpread | None) -> str:
    if sure is None:
        return NO_BAND
    worst = int(np.argmax(sure.rms))
    most = length_words(2.0 * float(sure.rms[worst]))
    return f"{most} at worst, at {sure.time[worst]:.3g} s (2 sd, from the band on k(s))"
