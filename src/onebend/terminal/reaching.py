"""What `onebend reach` takes and says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from onebend.control.reach.reach import Reach
from onebend.control.reach.uncertainty import SURE, PredictedError
from onebend.report.wording import length_words
from onebend.terminal.options import LEAST
from onebend.terminal.parts import NO_BAND, facts_table, force_words, say_written

PushAt = Annotated[
    float,
    typer.Option("--push-at", min=LEAST, max=1.0, metavar="S", help="Where the force acts: s in (0, 1], 1 the tip."),
]
Point = Annotated[
    float,
    typer.Option("--point", min=LEAST, max=1.0, metavar="S", help="The point that is led to the goal: s in (0, 1]."),
]
Goal = Annotated[tuple[float, float], typer.Option("--goal", metavar="X Y", help="m, in the beam's frame.")]
GoalAngle = Annotated[
    float | None,
    typer.Option("--goal-angle-deg", metavar="DEG", help="The tangent's angle at the point; needs --moment."),
]
ReachMethod = Annotated[
    Literal["newton", "paper"],
    typer.Option(help="newton: exact. paper: Algorithm 1 to the letter, its force put on the exact beam."),
]
ReachMaxForce = Annotated[
    float | None, typer.Option("--max-force-N", min=LEAST, metavar="N", help="No larger force; default: no bound.")
]
MaxCurvature = Annotated[
    float | None,
    typer.Option("--max-curvature-per-m", min=LEAST, metavar="1/M", help="The beam bends no more than this from rest."),
]
Direction = Annotated[
    float | None,
    typer.Option("--direction-deg", metavar="DEG", help="The force can only push this way (0: along x)."),
]
Gravity = Annotated[
    tuple[float, float],
    typer.Option(
        "--gravity-m-s2",
        metavar="GX GY",
        help="In the beam's frame; needs a model with a mass. Default: none in plane.",
    ),
]
Moment = Annotated[bool, typer.Option("--moment", help="The gripper gives a moment too.")]


def show_reach(console: Console, result: Reach, error: PredictedError | None, output: Path | None) -> None:
    """The force, the point and how sure it is."""
    table = facts_table()
    table.add_row(f"force at s = {result.push_s:.3g}", force_words(result.force))
    if result.settings.moment:
        table.add_row("moment there", f"[bold]{result.moment:.4g} N m[/]")
    x, y = 1e3 * result.reached[:2]
    angle = math.degrees(result.reached[2])
    table.add_row(f"point s = {result.point_s:.3g}", f"at ({x:.3f}, {y:.3f}) mm, tangent at {angle:.1f} deg")
    table.add_row("from the goal", f"{length_words(result.error)} in the model, after {result.iterations} iterations")
    table.add_row("sure to within", _sureness(error))
    table.add_row("way there", f"{len(result.path) - 1} steps from rest, each a stable equilibrium on one branch")
    console.print(table, highlight=False)
    say_written(console, output, "path.csv, reach.png, summary.json")


def _sureness(error: PredictedError | None) -> str:
    if error is None:
        return NO_BAND
    long, short = error.ellipse(SURE).semi_axes
    ellipse = f"± {length_words(long)} along and ± {length_words(short)} across"
    return f"{ellipse} its {100 * SURE:.0f} % ellipse, from the band on k(s)"
