"""The screen: on it what a person named is text alone. Progress: bars on a screen, lines on a pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from time import monotonic

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderableType, RenderHook
from rich.markup import escape
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
from rich.segment import Segment
from rich.text import Text

from onebend.escaping import printable

QUIET_SECONDS = 1.0  # a stage that took less leaves no line behind where there is no screen to draw a bar on


class _Text:
    """A renderable whose text is escaped; colours and the like are the console's own."""

    def __init__(self, inside: RenderableType) -> None:
        self._inside = inside

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for segment in console.render(self._inside, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


class _Escape(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Text(one) for one in renderables]


def text_alone(console: Console) -> Console:
    """The console, from now on with all text escaped."""
    console.push_render_hook(_Escape())
    return console


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
        task = self._bars.add_task(escape(printable(stage)), total=total)
        self._open.append((task, stage, monotonic()))

    def advance(self, count: int = 1) -> None:
        self._bars.advance(self._open[-1][0], count)

    def done(self) -> None:
        task, stage, began = self._open.pop()
        if sys.exc_info()[0] is not None:
            return  # the stage was left early: its bar stays where it was
        count = self._count(task)
        self._bars.update(task, total=count, completed=count)
        seconds = monotonic() - began
        if not self._console.is_terminal and seconds > QUIET_SECONDS:
            self._console.print(f"{stage}: {seconds:.1f} s", markup=False, highlight=False)

    def _count(self, task: TaskID) -> float:
        return next((bar.completed for bar in self._bars.tasks if bar.id == task), 0.0)
