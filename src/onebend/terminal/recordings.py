"""What `onebend check`, `onebend topics` and `onebend record` say."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.recording.bags.topics import BagContents, TopicRow
from onebend.report.wording import significant
from onebend.terminal.parts import remarks_list

if TYPE_CHECKING:
    from onebend.capture.state import CaptureState
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


STAGE_NAMES: dict[str, str] = {
    "exposure": "picture",
    "tare": "tare",
    "first rest": "first rest",
    "push": "push",
    "last rest": "last rest",
    "done": "done",
}
_BAR = 30  # columns


class RecordingView:
    """What `onebend record` shows while it records: on a screen a picture that is renewed, on a pipe a line for each
    stage and each new advice. A context manager."""

    def __init__(self, console: Console | None) -> None:
        """`console`: None: nothing is shown."""
        self._console = console
        self._live = None
        if console is not None and console.is_terminal:
            self._live = Live(console=console, refresh_per_second=8, transient=True)
        self._said: tuple[str, str] = ("", "")

    def __enter__(self) -> RecordingView:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, state: CaptureState) -> None:
        """What is known now."""
        if self._live is not None:
            self._live.update(recording_screen(state))
        elif self._console is not None:
            said = state.stage, without_numbers(state.advice[0] if state.advice else "")
            if said != self._said:
                self._said = said
                advice = "; ".join(state.advice[:2])
                self._console.print(f"{state.seconds:6.1f} s  {STAGE_NAMES[state.stage]}: {advice}", markup=False)


def without_numbers(text: str) -> str:
    """The sentence but for the numbers in it, which change all the time."""
    return "".join(letter for letter in text if not letter.isdigit())


def recording_screen(state: CaptureState) -> RenderableType:
    """One screen: the stages, what to do, and what is known."""
    order = list(STAGE_NAMES)
    now = order.index(state.stage)
    stages = Text("  ").join(
        Text(f"{'✓' if i < now else '▶' if i == now else '·'} {STAGE_NAMES[name]}", style="bold" if i == now else "dim")
        for i, name in enumerate(order)
    )
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for what, known in recording_rows(state):
        table.add_row(what, known)
    advice = [Text(f"→ {one}", style="bold" if i == 0 else "") for i, one in enumerate(state.advice)]
    keys = Text("Ctrl-C ends it" if now else "Enter begins the film as it is, Ctrl-C ends it", style="dim")
    return Group(stages, Text(""), *advice, Text(""), table, Text(""), keys)


def recording_rows(state: CaptureState) -> list[tuple[str, str]]:
    """What is known, in words."""
    rows = []
    if state.tags:
        sizes = (f"{tag.id}: {tag.side_px:.0f} px" if tag.seen else f"{tag.id}: not seen" for tag in state.tags)
        rows.append(("tags", ", ".join(sizes)))
    if not math.isnan(state.displacement):
        rows.append(("tip", f"{100 * state.displacement:.0f} % of the length; farthest {100 * state.largest:.0f} %"))
    if np.isfinite(state.force).all():
        rows.append(
            (
                "force",
                f"{state.force[0]:+.3f}, {state.force[1]:+.3f} N, less {state.tare[0]:.3g}, {state.tare[1]:.3g} N",
            )
        )
    if not math.isnan(state.half_width):
        wanted = "" if math.isnan(state.until) else f", wanted ± {100 * state.until:.2g} %"
        bar = "█" * max(1, round(_BAR * min(state.half_width, 1.0)))
        rows.append(("k(s)", f"± {100 * state.half_width:.2g} % (95 %, median){wanted}\n{bar:░<{_BAR}}"))
    elif state.live is not None:
        rows.append(("k(s)", state.live.verdict.headline))
    if state.frames:
        missing = f", {state.drops} missing" if state.drops else ""
        rows.append(("film", f"{state.seconds:.1f} s, {state.frames} frames{missing}, {state.bytes / 1e6:.1f} MB"))
    if state.samples:
        missing = f", {state.lost_samples} missing" if state.lost_samples else ""
        clock = "" if math.isnan(state.clock_sd) else f"; clocks to {1e3 * state.clock_sd:.1f} ms"
        rows.append(("log", f"{state.samples} samples{missing}{clock}"))
    if not math.isnan(state.disk_left):
        rows.append(("disk", f"{state.disk_left / 1e9:.1f} GB left"))
    return rows
