"""What every command shares: errors in one message, a place to work in, progress, JSON."""

from __future__ import annotations

import math
import signal
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console

from onebend.cli import GIVEN
from onebend.errors import OnebendError, RecordingError, reference
from onebend.escaping import printable
from onebend.files.publish import OutputFolder, abandon, finish, prepare, publish, unplaced
from onebend.progress import Progress, Silent
from onebend.report.figures.pictures import Pictures
from onebend.results.provenance import InputFile, provenance
from onebend.strict_json import to_json
from onebend.terminal.bars import Bars, text_alone


@contextmanager
def clean_errors() -> Iterator[None]:
    """A user's mistake ends in one message, not in a traceback."""
    try:
        yield
    except OnebendError as error:
        _fail(str(error), error, 2, docs=reference(error.about))
    except KeyboardInterrupt as error:
        _fail("Interrupted.", error, 130)
    except OSError as error:
        _fail(f"{error.filename or 'a file'}: {error.strerror or error}", error, 2)


def _fail(message: str, error: BaseException, code: int, *, docs: str = "") -> NoReturn:
    """Say what is wrong, what was added to the error on its way here, and where to read of it."""
    sentences = [message, *getattr(error, "__notes__", ())]
    text = " ".join(one if one.endswith((".", "?", "!")) else f"{one}." for one in sentences)
    say("\n".join(filter(None, (f"onebend: {text}", docs))), err=True)
    raise typer.Exit(code) from None


def say(text: str, *, err: bool = False) -> None:
    """A line for people; what somebody named in it is text, and not for the terminal to act on."""
    typer.echo(printable(text), err=err)


def say_warning(text: str, *, about: str) -> None:
    """A warning on standard error, and where docs/troubleshooting.md says more of it."""
    say(f"onebend: warning: {text}\n{reference(about)}", err=True)


def screen() -> Console:
    """Where tables go: standard output, with what somebody named as text. (To look for numbers in a long
    name, so as to colour them, takes minutes.)"""
    return text_alone(Console(highlight=False))


def stderr_screen() -> Console:
    """Where progress goes: standard error, with what somebody named as text."""
    return text_alone(Console(stderr=True, highlight=False))


@contextmanager
def workplace(out: Path, kind: str, overwrite: bool) -> Iterator[OutputFolder]:
    """A place to work for results in `out`; when the work ends early, its error says what was kept."""
    place = prepare(out, kind=kind, overwrite=overwrite)
    try:
        yield place
    except BaseException as error:
        kept = abandon(place)
        if place.published:
            error.add_note(f"The results are in {out}, but for the pictures.")
        if (whole := unplaced(place)) is not None:
            error.add_note(f"The results themselves are in {whole}.")
        if kept:
            again = " with --force" if place.published else ""
            error.add_note(
                f"What was found so far is kept in {place.work}; the next run for {out}{again} goes on from there."
            )
        elif isinstance(error, KeyboardInterrupt) and not place.published:
            error.add_note("Nothing was written.")
        raise
    finish(place)


def made_from_files(inputs: Sequence[InputFile], settings: Mapping[str, Any] = {}) -> dict[str, Any]:
    """Where the results of this command come from, under `provenance`."""
    return provenance(inputs, GIVEN.get({}), settings)


def put_in_place(
    place: OutputFolder,
    write: Callable[[Path], None],
    pictures: Pictures = Pictures(),
    *,
    inputs: Sequence[InputFile] = (),
    made_from: Mapping[str, Any] | None = None,
) -> None:
    """Publish what `write` writes, with where it comes from; say which pictures are missing, and why.

    Args:
        made_from: as from `made_from_files`, where `write` says it too; None: it is made from `inputs`.
    """
    made_from = made_from or made_from_files(inputs)
    again = place.published
    left = publish(place, write, {**made_from, "pictures_failed": pictures.failed})
    say_failed(pictures)
    if left is not None:
        say_warning(f"files that appeared in {place.out} during the run are in {left}.", about="changed file")
    for path in () if again else made_from["provenance"]["changed_meanwhile"]:
        text = f"{path} was changed while it was read. Run again to learn from it as it is."
        say_warning(text, about="changed file")


def open_in_browser(page: Path) -> None:
    """Show a page in the person's browser; a warning where there is none."""
    try:
        opened = webbrowser.open(page.resolve().as_uri())
    except webbrowser.Error:
        opened = False
    if not opened:
        say_warning(f"no browser was found. Open {page} in one.", about="no browser")


def say_failed(pictures: Pictures) -> None:
    """A warning on standard error for each picture that could not be drawn."""
    for name, why in pictures.failed.items():
        text = f"the picture {name!r} could not be drawn ({why}). All else is there."
        say_warning(text, about="picture failed")


@contextmanager
def progress_of(quiet: bool) -> Iterator[Progress]:
    """Bars on standard error, or nothing."""
    if quiet:
        yield Silent()
        return
    with Bars(stderr_screen()) as bars:
        yield bars


def print_json(data: object) -> None:
    """One JSON object on standard output, in characters that it can take."""
    text = to_json(data)
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        text = to_json(data, ascii_only=True)
    typer.echo(text)


def print_summary(summary: dict[str, Any], output: Path | None) -> None:
    """A summary as JSON, with the folder where there is one."""
    print_json(summary if output is None else {**summary, "output": str(output)})


def or_nan(value: float | None) -> float:
    """An option that was not given as a number that is not known."""
    return math.nan if value is None else value


def or_unlimited(limit: float | None) -> float:
    """A limit, or infinity where none was given."""
    return math.inf if limit is None else limit


@contextmanager
def stopped_by_hand() -> Iterator[tuple[threading.Event, threading.Event]]:
    """Events that Ctrl-C and the Enter key set: to end the film, and to begin it. A second Ctrl-C interrupts."""
    stop, begin = threading.Event(), threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def end(*_: object) -> None:
        stop.set()
        signal.signal(signal.SIGINT, before)

    def wait_for_enter() -> None:
        sys.stdin.readline()
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
    """A share, of text such as `5%`; NaN of none.

    Raises:
        RecordingError: no number above 0 and up to 100.
    """
    if text is None:
        return math.nan
    try:
        share = float(text.strip().removesuffix("%")) / 100.0
    except ValueError:
        share = math.nan
    if not 0.0 < share <= 1.0:
        raise RecordingError(f"--until {text}: write how exactly k(s) is wanted, as 5%.")
    return share
