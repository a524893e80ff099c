"""What `onebend check` and `onebend topics` say."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.recording.bags.topics import BagContents, TopicRow
from onebend.report.wording import significant
from onebend.terminal.parts import remarks_list

if TYPE_CHECKING:
    from onebend.report.overview import Overview


def show_bag(console: Console, bag: BagContents) -> None:
    """A table of the topics, and a warning where the bag breaks off."""
    first = min((row.start for row in bag.rows if not math.isnan(row.start)), default=math.nan)
    console.print(f"[bold]{escape(str(bag.path))}[/]{begins(first)}", soft_wrap=True)
    table = Table()
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold", min_width=20)
    for name in ("count", "lost", "Hz", "from, s", "to, s"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in bag.rows:
        table.add_row(*cells(row, first))
    console.print(table)
    bare = [row.topic for row in bag.rows if row.count and row.by == "receipt"]
    if bare:
        console.print(f"Without header stamps, by when they were received: {escape(', '.join(bare))}.")
    if bag.fault:
        console.print(f"[red]The bag is damaged:[/] {escape(bag.fault)}. The table counts what comes before that.")


def begins(first: float) -> str:
    """When the first message was, in words."""
    if math.isnan(first):
        return ""
    return f", from {datetime.fromtimestamp(first, UTC).strftime('%Y-%m-%d %H:%M:%S')} UTC ({first:.6f} s)"


def cells(row: TopicRow, first: float) -> tuple[str, ...]:
    """One row of the table, in words; times count from `first`."""
    kind = row.type.replace("/msg/", "/")
    if not row.count:
        return escape(row.topic), escape(kind), "0", "", "", "", ""
    rate = "" if math.isnan(row.rate) else significant(row.rate)
    span = (f"{row.start - first:.3f}", f"{row.end - first:.3f}")
    return escape(row.topic), escape(kind), f"{row.count}", f"{row.gaps or ''}", rate, *span


def show_overview(console: Console, overview: Overview) -> None:
    """What `onebend check` understood."""
    table = Table(title=escape(overview.name), title_justify="left", box=None, show_header=False)
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="fold")
    for what, understood in overview.rows:
        table.add_row(what, escape(understood))
    console.print(table)
    console.print()
    console.print(remarks_list([(overview.name, remark) for remark in overview.remarks]))
