"""Shared by all commands: errors in one message, workplaces, progress, JSON."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import numpy as np
import typer
from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderableType, RenderHook
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress as RichProgress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from onebend.cli import GIVEN
from onebend.errors import RecordingError, reference
from onebend.files.publish import OutputFolder, publish, workplace, write_summary
from onebend.options import POSITIVE, Only, option
from onebend.progress import Progress, Silent
from onebend.records import Array, Remark
from onebend.report.sentences import significant
from onebend.results.provenance import InputFile, inputs_of, provenance
from onebend.text_files import printable, to_json

if TYPE_CHECKING:
    from onebend.report.pictures import Draw, Pictures

# Options that several commands take.

LEAST, MOST = POSITIVE


class Listener(Progress, Protocol):
    """A program that has a command carried out, in the place of a person at a screen."""

    def published(self) -> None:
        """The answer is in its folder; pictures may come later."""


@dataclass(frozen=True)
class AnswerOptions:
    """Where the answer goes, and how."""

    output: Path | None = option("--output -o", None, metavar="OUT")
    overwrite: bool = option("--overwrite --force", False)
    as_json: bool = option("--json", False)
    quiet: bool = option("--quiet -q", False)
    listener: Listener | None = None


Saved = Annotated[AnswerOptions, Only(("output", "overwrite", "as_json"))]
OwnOutput = Annotated[AnswerOptions, Only(("overwrite", "as_json", "quiet"))]  # the command has an output of its own
OwnFiles = Annotated[AnswerOptions, Only(("overwrite", "as_json"))]
Told = Annotated[AnswerOptions, Only(("as_json", "quiet"))]
Said = Annotated[AnswerOptions, Only(("as_json",))]


# The screen, on which names given by people are text only. Progress: bars on a screen, lines on a pipe.

QUIET_SECONDS = 1.0  # on a pipe, shorter stages print nothing


class _Text:
    """A renderable with escaped text."""

    def __init__(self, inside: RenderableType) -> None:
        self._inside = inside

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for segment in console.render(self._inside, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)


class _Escape(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Text(one) for one in renderables]


def text_alone(console: Console) -> Console:
    """The console with all text escaped."""
    console.push_render_hook(_Escape())
    return console


class Bars:
    """A `Progress` with time left; on a pipe, one line per stage. A context manager."""

    def __init__(self, console: Console) -> None:
        self._console = console
        columns = (
            SpinnerColumn(finished_text="[green]✓"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(elapsed_when_finished=True),
        )
        self._bars = RichProgress(*columns, console=console, disable=not console.is_terminal)
        self._open: list[tuple[TaskID, str, float]] = []  # nested stages

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
            return  # left early: the bar stays
        count = self._count(task)
        self._bars.update(task, total=count, completed=count)
        seconds = monotonic() - began
        if not self._console.is_terminal and seconds > QUIET_SECONDS:
            self._console.print(f"{stage}: {seconds:.1f} s", markup=False)

    def _count(self, task: TaskID) -> float:
        return next((bar.completed for bar in self._bars.tasks if bar.id == task), 0.0)


def say(text: str, *, err: bool = False) -> None:
    """One escaped line."""
    typer.echo(printable(text), err=err)


def say_warning(text: str, *, about: str) -> None:
    """On standard error, with its section in docs/troubleshooting.md."""
    say(f"onebend: warning: {text}\n{reference(about)}", err=True)


def screen() -> Console:
    """Standard output, escaped. (Colouring numbers in long names takes minutes.)"""
    return text_alone(Console(highlight=False))


def stderr_screen() -> Console:
    """Standard error, escaped."""
    return text_alone(Console(stderr=True, highlight=False))


@contextmanager
def place_for(told: AnswerOptions, kind: str) -> Iterator[OutputFolder | None]:
    """A `workplace` if there is an output, else None."""
    with nullcontext() if told.output is None else workplace(told.output, kind, told.overwrite) as place:
        yield place


def made_from_files(inputs: Sequence[InputFile], settings: Mapping[str, Any] = {}) -> dict[str, Any]:
    """The entry `provenance`."""
    return provenance(inputs, GIVEN.get({}), settings)


def put_in_place(
    place: OutputFolder,
    write: Callable[[Path], None],
    failed: Mapping[str, str] = {},
    *,
    inputs: Sequence[InputFile] = (),
    made_from: Mapping[str, Any] | None = None,
) -> None:
    """Publishes what `write` writes, with provenance, and names failed pictures.

    Args:
        failed: names and reasons.
        made_from: as from `made_from_files`, if `write` needs it; None: made from `inputs`.
    """
    made_from = made_from or made_from_files(inputs)
    again = place.published
    publish(place, write, {**made_from, "pictures_failed": failed})
    say_failed(failed)
    for path in () if again else made_from["provenance"]["changed_meanwhile"]:
        text = f"{path} was changed while it was read. Run again to learn from it as it is."
        say_warning(text, about="changed file")


def put_results(
    place: OutputFolder,
    summary: Mapping[str, Any],
    tables: Callable[[Path], None],
    pictures: Pictures | None = None,
    *,
    figures: str | None = "",
    inputs: Sequence[InputFile] = (),
) -> None:
    """Publishes the files of `tables`, the pictures and `summary.json`.

    Args:
        figures: folder of the pictures; None: inside a page of `tables`.
    """

    def write(folder: Path) -> None:
        tables(folder)
        if pictures is not None and figures is not None:
            pictures.write(folder / figures)
        write_summary(folder, summary)

    put_in_place(place, write, pictures.failed if pictures else {}, inputs=inputs)


def save_results(
    told: AnswerOptions,
    summary: Mapping[str, Any],
    tables: Callable[[Path], None],
    wanted: Mapping[str, Draw],
    read: Sequence[Path],
) -> None:
    """Draws the wanted pictures, and publishes all in the output, made from the files `read`."""
    from onebend.report.pictures import draw  # here: other commands draw nothing

    with place_for(told, summary["format"]) as place:
        assert place is not None
        put_results(place, summary, tables, draw(wanted), inputs=inputs_of(read))


def say_failed(failed: Mapping[str, str]) -> None:
    """Warns of each failed picture."""
    for name, why in failed.items():
        text = f"the picture {name!r} could not be drawn ({why}). All else is there."
        say_warning(text, about="picture failed")


@contextmanager
def progress_of(told: AnswerOptions) -> Iterator[Progress]:
    """The listener's, bars on standard error, or nothing."""
    if told.quiet or told.listener is not None:
        yield told.listener or Silent()
        return
    with Bars(stderr_screen()) as bars:
        yield bars


def print_json(data: object) -> None:
    text = to_json(data)
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        text = to_json(data, ascii_only=True)
    typer.echo(text)


def answer(
    told: AnswerOptions, data: Mapping[str, Any], show: Callable[[Console], None], output: Path | None = None
) -> None:
    """The data as JSON, or `show` on the screen. `output`: of a command with one of its own."""
    output = output or told.output
    if told.as_json:
        print_json(data if output is None else {**data, "output": str(output)})
    else:
        show(screen())


@contextmanager
def stopped_by_hand(times: int = 1) -> Iterator[tuple[threading.Event, threading.Event]]:
    """Events set by Ctrl-C (end the film) and Enter (begin it), each time. Ctrl-C after so many `times` interrupts."""
    stop, begin = threading.Event(), threading.Event()
    before, left = signal.getsignal(signal.SIGINT), iter(range(times - 1))

    def end(*_: object) -> None:
        stop.set()
        if next(left, None) is None:
            signal.signal(signal.SIGINT, before)

    def wait_for_enter() -> None:
        while sys.stdin.readline():
            begin.set()

    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=wait_for_enter, daemon=True).start()
    in_main = threading.current_thread() is threading.main_thread()
    if in_main:
        signal.signal(signal.SIGINT, end)
    try:
        yield stop, begin
    finally:
        if in_main:
            signal.signal(signal.SIGINT, before)


def percent(text: str | None) -> float:
    """A share from text such as `5%`; NaN for None. Raises `RecordingError` unless above 0 and up to 100."""
    if text is None:
        return math.nan
    try:
        share = float(text.strip().removesuffix("%")) / 100.0
    except ValueError:
        share = math.nan
    if not 0.0 < share <= 1.0:
        raise RecordingError(f"--until {text}: write how exactly k(s) is wanted, as 5%.")
    return share


# Shared by several screens.

NO_BAND = "not known: the model has no band on k(s)"


def facts_table() -> Table:
    """Name and value."""
    return Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))


def listing(title: str | None, *columns: str) -> Table:
    """A table without lines. Columns whose head begins with `<` hold text, the others numbers."""
    table = Table(title=title, title_justify="left", box=None)
    for name in columns:
        if name.startswith("<"):
            table.add_column(escape(name[1:]), overflow="fold")
        else:
            table.add_column(escape(name), justify="right", no_wrap=True)
    return table


def force_words(force: Array) -> str:
    """Size, direction and parts of a force (2,) N."""
    turn = math.degrees(math.atan2(force[1], force[0]))
    size = significant(float(np.hypot(*force)))
    return f"[bold]{size} N[/] at {turn:.1f} deg: ({force[0]:.4g}, {force[1]:.4g}) N"


def say_written(console: Console, output: Path | None, files: str) -> None:
    """Lists `files` in the folder `output`, if any."""
    if output is not None:
        console.print(f"\nWrote {output}: {files}", markup=False)


def remarks_list(remarks: Sequence[tuple[str, Remark]], title: str | None = "Remarks") -> RenderableType:
    """With remedies; warnings in colour, notes in grey."""
    if not remarks:
        return Text("No remarks.", "dim")
    table = Table(box=None, show_header=False, pad_edge=False, title=title, title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for whose, remark in remarks:
        warning = remark.level == "warning"
        mark, style = ("[yellow]![/]", "") if warning else ("[dim]·[/]", "dim")
        table.add_row(mark, Text(f"{whose}: {remark.text}"), style=style)
        if remark.docs:
            table.add_row("", Text(reference(remark.about), "dim"))
    return table
