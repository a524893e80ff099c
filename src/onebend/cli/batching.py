"""The command that learns from many recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.batch.run import run_batch
from onebend.batch.writing import summary_of, write_batch
from onebend.cli import BY
from onebend.cli.common import clean_errors, print_json, progress_of, say, screen
from onebend.cli.options import Json, Quiet
from onebend.errors import ResultsError
from onebend.terminal.batches import show_batch

Source = Annotated[
    Path,
    typer.Argument(
        metavar="FOLDER|LIST.csv",
        help="A folder with recordings in it, or a CSV with a column path.",
    ),
]
Results = Annotated[
    Path, typer.Option("--output", "-o", metavar="RESULTS", help="Folder for what comes out; a stopped run goes on.")
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster that sees these folders under these paths."),
]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, metavar="N", help="On this machine; default: one a core.")
]
Folders = Annotated[
    bool, typer.Option("--folders", help="Also write a results folder of each recording, without pictures.")
]


def batch(
    source: Source,
    *,
    output: Results,
    scheduler: Scheduler = None,
    workers: Workers = None,
    folders: Folders = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn k(s) of thousands of recordings, each by itself, on all cores or a cluster; go on where it was stopped."""

    def began(link: str) -> None:
        if link and not quiet:
            say(f"The cluster's page: {link}", err=True)

    with clean_errors():
        if scheduler is not None and workers is not None:
            raise ResultsError("a cluster has its own workers. Give --scheduler or --workers, not both")
        with progress_of(quiet) as progress:
            outcome = run_batch(
                source, output, scheduler=scheduler, workers=workers, folders=folders, progress=progress, began=began
            )
        summary = summary_of(outcome, written_by=BY)
        write_batch(outcome, summary, version=onebend.__version__)
    if as_json:
        print_json({**summary, "output": str(output)})
    else:
        show_batch(screen(), outcome)
