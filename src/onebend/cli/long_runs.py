"""Commands over many recordings: the paper's experiments made again, batches, populations."""

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
from onebend.cli.options import MOST, Json, Overwrite, Quiet
from onebend.errors import ResultsError
from onebend.population import writing as populations
from onebend.population.figures import draw_figures as draw_figures_of
from onebend.population.outcome import PopulationSettings
from onebend.population.outcome import population as outcome_of
from onebend.population.reading import TABLES, read_batch
from onebend.population.tolerance import read_tolerance
from onebend.results.provenance import inputs_of
from onebend.studies.figures import draw_figures
from onebend.studies.run import reproduce as run
from onebend.studies.settings import SensorKind, StudySettings
from onebend.studies.writing import REPRODUCE_FORMAT, summary_of, writer
from onebend.terminal.long_runs import show_batch, show_population, show_reproduced

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


Batch = Annotated[Path, typer.Argument(metavar="RESULTS", help="The results folder of a batch.")]
By = Annotated[str, typer.Option("--by", metavar="COLUMN", help="Of recordings.parquet, that names the group.")]
Object = Annotated[
    str | None,
    typer.Option("--object", metavar="COLUMN", help="That names the object; default: every recording has its own."),
]
PopulationOut = Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for tables and report.")]
Band = Annotated[
    float, typer.Option("--band", min=0.01, max=MOST, metavar="PERCENT", help="Wished half band of the means, of k.")
]
ToleranceFile = Annotated[
    Path | None,
    typer.Option("--tolerance", metavar="CSV", help="With s, low_N_m, high_N_m: objects pass or fail against it."),
]
Passes = Annotated[
    float,
    typer.Option("--pass-from", min=0.01, max=0.99, metavar="P", help="Probability of lying inside that passes."),
]


def population(
    results: Batch,
    *,
    output: PopulationOut,
    by: By = "group",
    same: Object = None,
    band: Band = 5.0,
    tolerance: ToleranceFile = None,
    passes: Passes = 0.5,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say what a batch tells of the populations its objects are from: mean k(s) of groups, spread, outliers."""
    with (
        clean_errors(),
        workplace(output, populations.POPULATION_FORMAT, overwrite) as place,
        progress_of(quiet) as progress,
    ):
        limits = None if tolerance is None else read_tolerance(tolerance)
        setting = PopulationSettings(by, same, band / 100.0, limits, passes)
        inputs = inputs_of([*(results / f"{name}.parquet" for name in TABLES), *filter(None, [tolerance])])
        found = outcome_of(read_batch(results, by, same), setting)
        pictures = draw_figures_of(found, progress=progress)
        summary = populations.summary_of(found, written_by=BY)
        write = populations.writer(found, pictures, summary, name=results.resolve().name, version=onebend.__version__)
        put_in_place(place, write, pictures, inputs=inputs)
    if as_json:
        print_json(summary | {"output": str(output)})
    else:
        show_population(screen(), found, output)
