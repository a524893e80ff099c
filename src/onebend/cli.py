"""The command line. Results go to standard output, progress and errors to standard error.

Exit codes: 0 done; 2 the input or the request cannot be used, with one message that says what to do; 130 interrupted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import typer
from rich.console import Console

import onebend
from onebend.errors import OnebendError
from onebend.learning.candidates import Limits
from onebend.learning.parameters import Priors
from onebend.learning.planning import PlanSettings
from onebend.learning.posterior import FitSettings
from onebend.learning.selection import Settings
from onebend.pipeline import compare, learn_recording, plan_next
from onebend.progress import Progress, Silent
from onebend.recording.observe import ObserveSettings
from onebend.recording.template import write_template
from onebend.report.drawing import draw, draw_all, validation_figures
from onebend.report.overview import overview
from onebend.results.folder import Workplace, abandon, prepare, publish
from onebend.results.kept import KeptDetections
from onebend.results.model import read_model
from onebend.results.summary import (
    LEARN_FORMAT,
    PLAN_FORMAT,
    VALIDATE_FORMAT,
    model_summary,
    summary_of,
    to_json,
    validation_summary,
)
from onebend.results.writing import learned_writer, validation_writer
from onebend.terminal.bars import Bars
from onebend.terminal.options import (
    Bic,
    ClampSd,
    Count,
    Epsilon,
    Family,
    Folder,
    Functions,
    Json,
    MaxForce,
    MaxTipAngle,
    Method,
    Model,
    Modes,
    Output,
    Overwrite,
    Quiet,
    Recording,
    Recordings,
    Threads,
    ValidateOn,
    Width,
)
from onebend.terminal.plans import show_plan
from onebend.terminal.screens import show_model, show_overview, show_run, show_validation

BY = f"onebend {onebend.__version__}"

app = typer.Typer(
    help="Learn how stiff a soft slender object is along its length from one filmed push.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def learn(
    recordings: Recordings,
    *,
    output: Output = None,
    validate_on: ValidateOn = None,
    method: Method = "fit",
    family: Family = "gaussians",
    width: Width = None,
    bic: Bic = "textbook",
    n: Modes = None,
    m: Functions = None,
    clamp_sd: ClampSd = None,
    epsilon: Epsilon = None,
    threads: Threads = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn k(s) with a band from one or several recordings of a beam; results go to OUT (default: REC-results)."""
    out = output or Path(f"{recordings[0].resolve().name}-results")
    regression: Literal["regression", "paper"] = "paper" if method == "paper" else "regression"
    settings = Settings(method=regression, family=family, width=width, bic=bic, n=n, m=m)
    fitting = _fitting(clamp_sd) if method == "fit" else None
    with _clean_errors(), _workplace(out, LEARN_FORMAT, overwrite) as place, _progress(quiet) as progress:
        run = learn_recording(
            *recordings,
            settings=settings,
            fitting=fitting,
            observing=_observing(threads, epsilon),
            validate_on=validate_on or (),
            detect=KeptDetections(place.partial, onebend.__version__).detect,
            progress=progress,
        )
        began = time.perf_counter()
        summary = summary_of(run, written_by=BY)
        publish(place, learned_writer(run, draw_all(run, progress=progress), summary, version=onebend.__version__))
    seconds = {**run.stage_seconds, "report": time.perf_counter() - began}
    if as_json:
        _print_json({**summary, "stage_seconds": seconds, "output": str(out)})
    else:
        show_run(Console(), run, seconds, out)


@app.command()
def validate(
    model: Model,
    recordings: Recordings,
    *,
    output: Output = None,
    epsilon: Epsilon = None,
    threads: Threads = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate the learned beam under the forces of other recordings and compare the markers (Tables IV to VI)."""
    observing = _observing(threads, epsilon)
    with _clean_errors():
        beam = read_model(model).beam
        if output is None:
            with _progress(quiet) as progress:
                pairs = compare(beam, recordings, observing=observing, progress=progress)
        else:
            with _workplace(output, VALIDATE_FORMAT, overwrite) as place, _progress(quiet) as progress:
                detect = KeptDetections(place.partial, onebend.__version__).detect
                pairs = compare(beam, recordings, observing=observing, detect=detect, progress=progress)
                figures = draw(validation_figures(beam, pairs), progress)
                publish(place, validation_writer(pairs, figures, validation_summary(str(model), pairs, written_by=BY)))
    if as_json:
        _print_json(validation_summary(str(model), pairs, written_by=BY))
    else:
        show_validation(Console(), pairs, output)


@app.command()
def new(folder: Folder) -> None:
    """Write a recording.toml to fill in."""
    with _clean_errors():
        path = write_template(folder)
    typer.echo(f"Wrote {path}. Fill it in, put the video and the force log beside it, then: onebend check {folder}")


@app.command()
def check(recording: Recording, *, as_json: Json = False) -> None:
    """Read a recording's files without looking for tags, and say what was understood."""
    with _clean_errors():
        found = overview(recording)
    if as_json:
        _print_json(found.as_dict())
    else:
        show_overview(Console(), found)


@app.command()
def show(model: Model, *, as_json: Json = False) -> None:
    """Draw the learned k(s) in the terminal."""
    with _clean_errors():
        stored = read_model(model)
    if as_json:
        _print_json(model_summary(stored))
    else:
        show_model(Console(), stored)


@app.command()
def plan(
    model: Model,
    *,
    max_force: MaxForce = None,
    max_tip_angle: MaxTipAngle = None,
    count: Count = 8,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say which push to make next: what each would leave of the band on k(s)."""
    turn = None if max_tip_angle is None else math.radians(max_tip_angle)
    settings = PlanSettings(limits=Limits(force=max_force, tip_turn=turn), count=count)
    with _clean_errors(), _progress(quiet) as progress:
        found = plan_next(model, settings=settings, progress=progress)
    if as_json:
        _print_json({"format": PLAN_FORMAT, "written_by": BY, "model": str(model), **found.as_dict()})
    else:
        show_plan(Console(), found)


def _observing(threads: int | None, epsilon: float | None) -> ObserveSettings:
    if epsilon is None:
        return ObserveSettings(threads=threads)
    return ObserveSettings(threads=threads, pairing="nearest", epsilon=epsilon)


def _fitting(clamp_sd: float | None) -> FitSettings:
    if clamp_sd is None:
        return FitSettings()
    return FitSettings(priors=Priors(clamp=math.radians(clamp_sd)))


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(BY)
        raise typer.Exit


@app.callback()
def _all_commands(
    *, version: Annotated[bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say it.")] = False
) -> None:
    pass


@contextmanager
def _clean_errors() -> Iterator[None]:
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
def _workplace(out: Path, kind: str, overwrite: bool) -> Iterator[Workplace]:
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
def _progress(quiet: bool) -> Iterator[Progress]:
    """Bars on standard error, or nothing."""
    if quiet:
        yield Silent()
        return
    with Bars(Console(stderr=True)) as bars:
        yield bars


def _print_json(data: object) -> None:
    typer.echo(to_json(data))


def main() -> None:
    """The entry point of `onebend`."""
    app()
