"""Commands that begin a recording and look at what is there."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from onebend.cli.common import clean_errors, print_json
from onebend.cli.options import Json, Model, Recording
from onebend.recording.template import write_template
from onebend.report.overview import overview
from onebend.results.model import read_model
from onebend.results.summary import model_summary
from onebend.terminal.screens import show_model, show_overview

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder to make.")]


def new(folder: Folder) -> None:
    """Write a recording.toml to fill in."""
    with clean_errors():
        path = write_template(folder)
    typer.echo(f"Wrote {path}. Fill it in, put the video and the force log beside it, then: onebend check {folder}")


def check(recording: Recording, *, as_json: Json = False) -> None:
    """Read a recording's files without looking for tags, and say what was understood."""
    with clean_errors():
        found = overview(recording)
    if as_json:
        print_json(found.as_dict())
    else:
        show_overview(Console(), found)


def show(model: Model, *, as_json: Json = False) -> None:
    """Draw the learned k(s) in the terminal."""
    with clean_errors():
        stored = read_model(model)
    if as_json:
        print_json(model_summary(stored))
    else:
        show_model(Console(), stored)
