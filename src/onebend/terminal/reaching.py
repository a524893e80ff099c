"""What `onebend reach` says."""

from __future__ import annotations

import math
from pathlib import Path

from rich.console import Console

from onebend.control.reach.reach import Reach
from onebend.control.reach.uncertainty import SURE, PredictedError
from onebend.report.wording import length_words
from onebend.terminal.parts import NO_BAND, facts_table, force_words, say_written


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
