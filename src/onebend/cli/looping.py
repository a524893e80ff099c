"""The command that rehearses the closed loop."""

from __future__ import annotations

from typing import Annotated

import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, or_unlimited, print_summary, put_in_place, screen, workplace
from onebend.cli.models import gravity_on, read_trusted
from onebend.cli.options import LEAST, Goal, Gravity, Json, Model, Output, Overwrite, Point, PushAt
from onebend.control.loop.controller import ControllerSettings, controller
from onebend.control.loop.margins import Timing
from onebend.control.loop.robustness import simulate_range
from onebend.control.loop.simulation import LoopCamera
from onebend.control.loop.tuning import RequiredMargins
from onebend.report.figures.pictures import draw
from onebend.results.looping import LOOP_FORMAT, loop_summary, loop_writer
from onebend.results.model import model_file
from onebend.results.provenance import inputs_of
from onebend.terminal.looping import show_loop

KError = Annotated[
    float,
    typer.Option(
        "--k-error", min=0.0, max=0.95, metavar="SHARE", help="Rehearse on beams this share softer and stiffer."
    ),
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
LoopMaxForce = Annotated[float | None, typer.Option("--max-force-N", min=LEAST, metavar="N", help="No larger force.")]


def loop(
    model: Model,
    *,
    goal: Goal,
    push_at: PushAt = 1.0,
    point: Point = 1.0,
    k_error: KError = 0.3,
    delay_ms: Delay = 50.0,
    fps: Rate = 30.0,
    max_force: LoopMaxForce = None,
    gravity: Gravity = (0.0, 0.0),
    duration: Duration = 8.0,
    output: Output = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Rehearse a closed loop: force for a goal, corrected by a camera, on beams that are not the model."""
    with clean_errors():
        beam = read_trusted(model).beam
        delay = 1e-3 * delay_ms
        settings = ControllerSettings(
            timing=Timing(fps=fps, delay=delay),
            longest_delay=max(0.1, delay),
            wanted=RequiredMargins(k_error=k_error),
            most_force=or_unlimited(max_force),
        )
        control = controller(
            beam, goal, push_s=push_at, point_s=point, gravity=gravity_on(beam, gravity), settings=settings
        )
        trials = simulate_range(control, k_error=k_error, eye=LoopCamera(fps=fps, delay=delay), duration=duration)
        known = control.margins()
        summary = loop_summary(str(model), control, known, trials, written_by=BY)
        if output is not None:
            from onebend.report.figures.looping import looping  # here: Matplotlib is for pictures alone

            with workplace(output, LOOP_FORMAT, overwrite) as place:
                pictures = draw({"loop": lambda: looping(control, trials)})
                inputs = inputs_of([model_file(model)])
                put_in_place(place, loop_writer(trials, pictures, summary), pictures, inputs=inputs)
    if as_json:
        print_summary(summary, output)
    else:
        show_loop(screen(), control, known, trials, output)
