"""The command that rehearses the closed loop."""

from __future__ import annotations

from rich.console import Console

from onebend.cli.common import BY, clean_errors, gravity_on, or_unlimited, print_summary, read_trusted, workplace
from onebend.control.loop.controller import ControllerSettings, controller
from onebend.control.loop.margins import Timing
from onebend.control.loop.robustness import simulate_range
from onebend.control.loop.simulation import LoopCamera
from onebend.control.loop.tuning import RequiredMargins
from onebend.report.figures.looping import looping
from onebend.report.figures.style import png_of
from onebend.results.folder import publish
from onebend.results.looping import LOOP_FORMAT, loop_summary, loop_writer
from onebend.terminal.looping import Delay, Duration, KError, LoopMaxForce, Rate, show_loop
from onebend.terminal.options import Json, Model, Output, Overwrite
from onebend.terminal.reaching import Goal, Gravity, Point, PushAt


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
            with workplace(output, LOOP_FORMAT, overwrite) as place:
                publish(place, loop_writer(trials, png_of(looping(control, trials)), summary))
    if as_json:
        print_summary(summary, output)
    else:
        show_loop(Console(), control, known, trials, output)
