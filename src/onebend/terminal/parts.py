"""What several screens share: a list of facts, a force in words, and where the files are."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from onebend.records import Array
from onebend.report.wording import significant

NO_BAND = "not known: the model has no band on k(s)"


def facts_table() -> Table:
    """An empty table of what something is (first column) and its value."""
    return Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))


def force_words(force: Array) -> str:
    """Size, direction and parts of a force (2,) N."""
    turn = math.degrees(math.atan2(force[1], force[0]))
    size = significant(float(np.hypot(*force)))
    return f"[bold]{size} N[/] at {turn:.1f} deg: ({force[0]:.4g}, {force[1]:.4g}) N"


def say_written(console: Console, output: Path | None, files: str) -> None:
    """Which `files` are in the folder `output` now; nothing where none were written."""
    if output is not None:
        console.print(f"\nWrote {output}: {files}", highlight=False, markup=False)
