"""The command that makes the paper's experiments again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.cli import BY
from onebend.cli.common import clean_errors, made_from_files, print_json, progress_of, put_in_place, screen, workplace
from onebend.cli.options import Json, Overwrite, Quiet
from onebend.studies.figures import draw_figures
from onebend.studies.run import reproduce as run
from onebend.studies.settings import SensorKind, StudySettings
from onebend.studies.writing import REPRODUCE_FORMAT, summary_of, writer
from onebend.terminal.reproducing import show_reproduced

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
