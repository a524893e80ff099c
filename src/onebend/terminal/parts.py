"""What several screens share: a list of facts, what looked odd, a force in words, and where the files are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.errors import reference
from onebend.records import Array, Remark
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


def warnings_list(remarks: Sequence[tuple[str, Remark]]) -> Table:
    """Warnings alone, each with what to do about it."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for whose, remark in remarks:
        table.add_row("[yellow]![/]", Text(f"{whose}: {remark.text}"))
        _add_docs(table, remark)
    return table


def remarks_list(remarks: Sequence[tuple[str, Remark]]) -> RenderableType:
    """What looked odd: warnings in colour, notes in grey."""
    if not remarks:
        return Text("Nothing looked odd.", "dim")
    table = Table(box=None, show_header=False, pad_edge=False, title="What looked odd", title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for whose, remark in remarks:
        warning = remark.level == "warning"
        table.add_row("[yellow]![/]" if warning else "[dim]·[/]", escape(f"{whose}: {remark.text}"),
                      style="" if warning else "dim")  # fmt: skip
        _add_docs(table, remark)
    return table


def _add_docs(table: Table, remark: Remark) -> None:
    """Below a warning, where to read of it."""
    if remark.docs:
        table.add_row("", Text(reference(remark.about), "dim"))
