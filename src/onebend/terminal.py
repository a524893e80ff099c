"""What the command line shows: progress, tables, and k(s) drawn with block characters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import monotonic

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as RichProgress
from rich.table import Table
from rich.text import Text

from onebend.beam.model import Beam
from onebend.learning.outcome import Comparison, Learned, Trial
from onebend.learning.proposals import Plan, Proposal, direction_words, identified_words, width_words
from onebend.records import Observations, Remark
from onebend.report.findings import Findings, all_remarks, pair_remarks
from onebend.report.overview import Overview
from onebend.report.wording import millimetres, percent, significant, stage_rows, worst_marker
from onebend.results.model import StoredModel

BLOCKS = " ▁▂▃▄▅▆▇█"
QUIET_SECONDS = 1.0  # a stage that took less leaves no line behind where there is no screen to draw a bar on


class RateColumn(ProgressColumn):
    """Things a second, over the whole stage."""

    def render(self, task: Task) -> Text:
        elapsed = task.finished_time or task.elapsed
        if not elapsed or not task.completed:
            return Text("")
        return Text(f"{task.completed / elapsed:.3g}/s", style="cyan")


class Bars:
    """A `Progress` of bars with rate and time left; on a pipe, one line a stage. A context manager."""

    def __init__(self, console: Console) -> None:
        self._console = console
        columns = (
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            RateColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        self._bars = RichProgress(*columns, console=console, disable=not console.is_terminal)
        self._open: list[tuple[TaskID, str, float]] = []  # stages can be nested

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def start(self, stage: str, total: int | None) -> None:
        task = self._bars.add_task(escape(stage), total=total)
        self._open.append((task, stage, monotonic()))

    def advance(self, count: int = 1) -> None:
        self._bars.advance(self._open[-1][0], count)

    def done(self) -> None:
        task, stage, began = self._open.pop()
        count = self._count(task)
        self._bars.update(task, total=count, completed=count)
        seconds = monotonic() - began
        if not self._console.is_terminal and seconds > QUIET_SECONDS:
            self._console.print(f"{stage}: {seconds:.1f} s", markup=False, highlight=False)

    def _count(self, task: TaskID) -> float:
        return next((one.completed for one in self._bars.tasks if one.id == task), 0.0)


def selection_table(learned: Learned) -> Table:
    """The (n, m) table of the paper; the chosen row marked, rows out of the running dimmed with the reason."""
    table = Table(title=f"{learned.training.name}: RMS per marker and BIC", title_justify="left", box=None)
    table.add_column("")
    for name in ("n", "m", *_marker_names(learned.training), "BIC"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for i, trial in enumerate(learned.trials):
        chosen = i == learned.chosen
        cells = [str(trial.n), str(trial.m), *map(millimetres, trial.rms), _bic(trial)]
        style = "bold green" if chosen else "dim" if trial.why_out else ""
        table.add_row("➤" if chosen else "", *cells, escape("chosen" if chosen else trial.why_out), style=style)
    return table


def _bic(trial: Trial) -> str:
    return f"{trial.bic:.1f}" if np.isfinite(trial.bic) else "–"


def _marker_names(one: Comparison) -> list[str]:
    return [f"M{i + 1} \\[mm]" for i in range(len(one.tag_id))]


def validation_table(comparisons: Sequence[Comparison]) -> Table:
    """Tables IV to VI: RMS per marker, and in brackets what the force's noise alone explains."""
    widest = max(comparisons, key=lambda one: len(one.tag_id))
    table = Table(title="Validation: RMS per marker (explained by the force's noise)", title_justify="left", box=None)
    table.add_column("recording", overflow="fold")
    table.add_column("frames", justify="right")
    for name in _marker_names(widest):
        table.add_column(name, justify="right", no_wrap=True)
    for one in comparisons:
        pairs = zip(one.rms, one.sensor_rms, strict=True)
        cells = [f"{millimetres(rms)} [dim]({millimetres(sensor)})[/]" for rms, sensor in pairs]
        table.add_row(escape(one.name), str(len(one.frame)), *cells)
    return table


def stiffness_plot(beam: Beam, *, columns: int = 61, rows: int = 8) -> RenderableType:
    """k(s) as an area of block characters, with numbers at eleven places below."""
    k = beam.stiffness(np.linspace(0.0, 1.0, columns))
    top = max(float(k.max()), 0.0)
    level = np.zeros(columns) if top == 0.0 else np.clip(k / top, 0.0, 1.0) * rows * 8
    lines = []
    for row in range(rows - 1, -1, -1):
        cells = np.clip(np.round(level - 8 * row), 0, 8).astype(int)
        mark = f"{significant(top):>8} ┤" if row == rows - 1 else f"{'0':>8} ┤" if row == 0 else " " * 9 + "│"
        lines.append(Text(mark, "dim") + Text("".join(BLOCKS[c] for c in cells), "blue"))
    axis = " " * 9 + "└" + "─" * columns
    ends = " " * 10 + "s = 0 (clamp)" + " " * (columns - 24) + "s = 1 (tip)"
    heading = Text("Bending stiffness k(s) = EI / L [N m]", "italic")
    return Group(heading, *lines, Text(axis, "dim"), Text(ends, "dim"), _numbers(beam))


def _numbers(beam: Beam) -> Table:
    """k at eleven places, in two lines."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1, 0, 0))
    s = np.linspace(0.0, 1.0, 11)
    table.add_row("[dim]s[/]", *(f"[dim]{place:.1f}[/]" for place in s))
    table.add_row("k", *(significant(k) for k in beam.stiffness(s)))
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
    return table


def stages_table(seconds: Mapping[str, float], video_seconds: float) -> Table:
    """Time of every stage, and its share of the video's length."""
    table = Table(title=f"Time (the video plays {video_seconds:.1f} s)", title_justify="left", box=None)
    table.add_column("stage")
    table.add_column("s", justify="right")
    table.add_column("of the video", justify="right")
    *stages, total = stage_rows(seconds)
    for name, value in stages:
        table.add_row(escape(name), f"{value:.2f}", percent(value, video_seconds))
    table.add_row(total[0], f"{total[1]:.2f}", percent(total[1], video_seconds), style="bold")
    return table


def headline(learned: Learned) -> Panel:
    """The result in two lines."""
    trial = learned.trials[learned.chosen]
    k = learned.beam.stiffness(np.linspace(0.0, 1.0, 201))
    text = Text.assemble(
        ("k(s) ", "bold"), f"from {significant(k.min())} to {significant(k.max())} N m", "\n",
        ("model ", "bold"), f"n = {trial.n} curvature modes, m = {trial.m} {learned.family}, {learned.method}; ",
        f"worst marker {worst_marker(learned.training)} RMS",
    )  # fmt: skip
    return Panel(text, expand=False, border_style="green")


def show_run(console: Console, run: Findings, seconds: Mapping[str, float], out: Path) -> None:
    """All that `onebend learn` says in the end."""
    parts: list[RenderableType] = [selection_table(run.learned), stiffness_plot(run.learned.beam)]
    if run.validations:
        parts.append(validation_table(run.validations))
    parts += [remarks_list(all_remarks(run)), stages_table(seconds, run.video_seconds)]
    parts.append(headline(run.learned))
    for part in parts:
        console.print(part)
        console.print()
    say_path(console, "report", out / "report.html")


def say_path(console: Console, what: str, path: Path) -> None:
    """Where something is, on one line whatever the width, so that it can be copied."""
    console.print(f"[bold]{what}[/] {escape(str(path))}", soft_wrap=True, highlight=False)


def show_validation(console: Console, pairs: Sequence[tuple[Comparison, Observations]], out: Path | None) -> None:
    """All that `onebend validate` says."""
    console.print(validation_table([one for one, _ in pairs]))
    console.print()
    console.print(remarks_list([(one.name, remark) for one, seen in pairs for remark in pair_remarks(one, seen)]))
    if out is not None:
        say_path(console, "\ntables and figures", out)


def show_overview(console: Console, found: Overview) -> None:
    """What `onebend check` understood."""
    table = Table(title=found.name, title_justify="left", box=None, show_header=False)
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="fold")
    for what, understood in found.rows:
        table.add_row(what, escape(understood))
    console.print(table)
    console.print()
    console.print(remarks_list([(found.name, remark) for remark in found.remarks]))


def show_model(console: Console, stored: StoredModel) -> None:
    """What `onebend show` draws."""
    beam, origin = stored.beam, stored.origin
    console.print(stiffness_plot(beam))
    lowest = float(beam.stiffness(np.linspace(0.0, 1.0, 401)).min())
    if lowest <= 0.0:
        console.print(f"[yellow]k(s) falls to {significant(lowest)} N m: this is no beam and cannot be simulated.[/]")
    console.print(f"\nlength {1000 * beam.length:.4g} mm", highlight=False)
    if origin is not None:
        text = f"learned from {origin.recording} by {origin.method}: n = {origin.n}, m = {origin.m} {origin.family}"
        console.print(text, markup=False, highlight=False)


def plan_table(plan: Plan) -> Table:
    """The proposals of a plan, best first."""
    table = Table(title="What to do next, by what it would leave of the band", title_justify="left", box=None)
    for name in ("", "push at s", "force", "to \\[N]", "tip \\[mm]", "needs", "band after"):
        table.add_column(name, justify="left" if name in ("force", "needs") else "right")
    for i, one in enumerate(plan.proposals):
        needs = one.needs or ("the same once more" if one.repeats else "nothing new")
        cells = (f"{one.push.at_s:.2f}", direction_words(one.push.direction), significant(one.push.largest))
        table.add_row(str(i + 1), *cells, f"{1e3 * one.tip_moves:.0f}", needs, width_words(one.after.mean_width))
    return table


def show_plan(console: Console, plan: Plan) -> None:
    """All that `onebend plan` says."""
    before = plan.before
    console.print(
        f"Now the 95 % band of k is {width_words(before.mean_width)} wide on average, at worst "
        f"{width_words(before.worst_width)} at s = {before.worst_s:.2f}; {identified_words(before)}.\n",
        highlight=False,
    )
    console.print(plan_table(plan))
    console.print("\n[bold]best[/]", Text(plan.proposals[0].text))
    console.print("[bold]best two with what there is[/]", Text(_pair(plan.pair)))
    for one in plan.left_out:
        console.print(f"[yellow]![/] {escape(one)}")


def _pair(pair: Sequence[Proposal]) -> str:
    return "; then ".join(one.text for one in pair)
