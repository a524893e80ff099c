"""Commands over many recordings: the paper's experiments made again, and batches."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.batch import writing as batches
from onebend.batch.run import run_batch
from onebend.cli import BY
from onebend.cli.common import (
    clean_errors,
    made_from_files,
    print_json,
    progress_of,
    put_in_place,
    say,
    screen,
    workplace,
)
from onebend.cli.options import Json, Overwrite, Quiet
from onebend.errors import ResultsError
from onebend.studies.figures import draw_figures
from onebend.studies.run import reproduce as run
from onebend.studies.settings import SensorKind, StudySettings
from onebend.studies.writing import REPRODUCE_FORMAT, summary_of, writer
from onebend.terminal.long_runs import show_batch, show_reproduced

ReproduceOut = Annotated[
    Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for films, tables and report.")
]
Quick = Annotated[bool, typer.Option("--quick", help="Shorter pushes, 12 frames/s: a third of the time.")]
WithoutVideo = Annotated[
    bool, typer.Option("--without-video", help="Tags' poses with a camera's noise instead of films: a minute.")
]
ReproduceSensor = Annotated[
    SensorKind,
    typer.Option("--sensor", help="paper: errors as large as the paper's. franka: as measured on such a robot."),
]
ReproduceSeed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of all that is drawn.")]
Processes = Annotated[
    int | None, typer.Option("--processes", min=1, metavar="N", help="That work at once; default: one a core.")
]


def reproduce(
    *,
    output: ReproduceOut,
    quick: Quick = False,
    without_video: WithoutVideo = False,
    sensor: ReproduceSensor = "paper",
    seed: ReproduceSeed = 0,
    processes: Processes = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make the paper's experiments again: films of three beams, its tables, figures and tasks, in one report."""
    with clean_errors(), workplace(output, REPRODUCE_FORMAT, overwrite) as place, progress_of(quiet) as progress:
        setting = StudySettings(seed=seed, quick=quick, video=not without_video, sensor=sensor)
        found = run(place.work, setting, written_by=BY, processes=processes or 0, progress=progress)
        pictures = draw_figures(found, progress=progress)
        summary = summary_of(found, written_by=BY)
        write = writer(found, pictures, summary, place.work, version=onebend.__version__)
        put_in_place(place, write, pictures, made_from=made_from_files((), {"study": setting}))
    if as_json:
        print_json(summary | {"output": str(output)})
    else:
        show_reproduced(screen(), found, output)


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
        summary = batches.summary_of(outcome, written_by=BY)
        batches.write_batch(outcome, summary, version=onebend.__version__)
    if as_json:
        print_json({**summary, "output": str(output)})
    else:
        show_batch(screen(), outcome)
