"""The screen for a robot's log."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.recording.bag_topics import BagContents, TopicRow
from onebend.report.wording import significant


def show_bag(console: Console, found: BagContents) -> None:
    """A table of the topics, and a warning where the bag breaks off."""
    table = Table(title=escape(str(found.path)), title_justify="left")
    for name in ("topic", "type", "messages", "rate", "from", "lasts", "times by"):
        table.add_column(name, justify="right" if name in ("messages", "rate", "lasts") else "left", overflow="fold")
    for row in found.rows:
        table.add_row(*cells(row))
    console.print(table)
    if found.fault:
        console.print(f"[red]The bag is damaged:[/] {escape(found.fault)}. The table counts what comes before that.")


def cells(row: TopicRow) -> tuple[str, ...]:
    """One row of the table, in words."""
    begins = "" if math.isnan(row.start) else datetime.fromtimestamp(row.start, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
    lasts = "" if math.isnan(row.start) else f"{row.end - row.start:.3f} s"
    rate = "" if math.isnan(row.rate) else f"{significant(row.rate)} Hz"
    count = f"{row.count}" + (f" ({row.gaps} missing)" if row.gaps else "")
    return escape(row.topic), escape(row.type), count, rate, begins[:-3], lasts, row.by if row.count else ""
