"""What `onebend loop` says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

from onebend.control.loop.controller import Controller
from onebend.control.loop.margins import Margins
from onebend.control.loop.robustness import SETTLED, LoopTrial
from onebend.report.wording import significant
from onebend.terminal.parts import facts_table, say_written


def show_loop(
    console: Console,
    control: Controller,
    known: Margins,
    trials: tuple[LoopTrial, ...],
    output: Path | None,
    rehearsed: Mapping[str, object],
) -> None:
    """Force, gains, margins, and how the rehearsals went; `rehearsed` as in the summary."""
    table = facts_table()
    x, y = control.reference.ends
    table.add_row("feedforward", f"[bold]{significant(math.hypot(x, y))} N[/]: ({x:.4g}, {y:.4g}) N, reached in "
                  f"{control.reference.rise:.2f} s")  # fmt: skip
    table.add_row("gains", f"rate {control.gains.rate:.3g} 1/s, filters at {control.gains.corner:.3g} rad/s")
    later = "no limit found" if math.isinf(known.delay) else f"{1e3 * known.delay:.0f} ms more"
    turn = "any" if math.isinf(known.phase) else f"{math.degrees(known.phase):.0f} deg"
    table.add_row("margins", f"gain {known.gain:.2f} times, phase {turn}, delay {later}")
    table.add_row("rings below", f"{known.softest:.2f} of the model's k(s), everywhere alike")
    if rehearsed["felt"] != "nothing":
        table.add_row("the force is felt", "by a log" if rehearsed["felt"] == "log" else "by the beam's shape")
    if rehearsed["force_off_N"]:
        table.add_row("the robot's force", f"off by {rehearsed['force_off_N']:.3g} N, across it")
    if rehearsed["hidden"]:
        table.add_row("the point", "never seen")
    console.print(table, highlight=False)
    runs = Table("true k(s)", "steady, mm", "settled to 1 mm, s", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for trial in trials:
        steady = "the beam snapped away" if trial.run is None else f"{1e3 * trial.steady:.2f}"
        settled = trial.settled(SETTLED)
        runs.add_row(trial_name(trial), steady, "never" if math.isinf(settled) else f"{settled:.1f}")
    console.print()
    console.print(runs, highlight=False)
    say_written(console, output, "loop.csv, loop.png, summary.json")


def trial_name(trial: LoopTrial) -> str:
    """Which beam a rehearsal was made on."""
    share = 100.0 * abs(trial.factor - 1.0)
    way = "lower" if trial.factor < 1.0 else "higher"
    if trial.beam.drawn:
        return f"drawn, {significant(share)} % {way} on average"
    return "as the model" if trial.factor == 1.0 else f"{share:.0f} % {way}"
