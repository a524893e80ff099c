"""What every command shares: errors in one message, a place to work in, progress, JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console

from onebend.errors import OnebendError
from onebend.progress import Progress, Silent
from onebend.results.folder import OutputFolder, abandon, prepare
from onebend.strict_json import to_json
from onebend.terminal.bars import Bars


@contextmanager
def clean_errors() -> Iterator[None]:
    """A user's mistake ends in one message, not in a traceback."""
    try:
        yield
    except OnebendError as error:
        _fail(str(error), error, 2)
    except KeyboardInterrupt as error:
        _fail("Interrupted.", error, 130)
    except OSError as error:
        _fail(f"{error.filename or 'a file'}: {error.strerror or error}", error, 2)


def _fail(message: str, error: BaseException, code: int) -> NoReturn:
    """Say what is wrong, and what was added to the error on its way here."""
    sentences = [message, *getattr(error, "__notes__", ())]
    text = " ".join(one if one.endswith((".", "?", "!")) else f"{one}." for one in sentences)
    typer.echo(f"onebend: {text}", err=True)
    raise typer.Exit(code) from None


@contextmanager
def workplace(out: Path, kind: str, overwrite: bool) -> Iterator[OutputFolder]:
    """A place to work for results in `out`; when the work ends early, its error says what was kept."""
    place = prepare(out, kind=kind, overwrite=overwrite)
    try:
        yield place
    except (OnebendError, KeyboardInterrupt, OSError) as error:
        if abandon(place):
            error.add_note(
                f"What was found so far is kept in {place.partial}; the next run for {out} goes on from there."
            )
        elif isinstance(error, KeyboardInterrupt):
            error.add_note("Nothing was written.")
        raise


@contextmanager
def progress_of(quiet: bool) -> Iterator[Progress]:
    """Bars on standard error, or nothing."""
    if quiet:
        yield Silent()
        return
    with Bars(Console(stderr=True)) as bars:
        yield bars


def print_json(data: object) -> None:
    typer.echo(to_json(data))


def print_summary(summary: dict[str, Any], output: Path | None) -> None:
    """A summary as JSON, with the folder where there is one."""
    print_json(summary if output is None else {**summary, "output": str(output)})


def or_nan(value: float | None) -> float:
    """An option that was not given as a number that is not known."""
    return math.nan if value is None else value


def or_unlimited(limit: float | None) -> float:
    """A limit, or infinity where none was given."""
    return math.inf if limit is None else limit
