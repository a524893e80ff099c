"""The command that makes the paper's experiments again."""

from __future__ import annotations

from rich.console import Console

import onebend
from onebend.cli.common import BY, clean_errors, print_json, progress_of, workplace
from onebend.results.folder import publish
from onebend.studies.figures import draw_figures
from onebend.studies.run import reproduce as run
from onebend.studies.settings import StudySettings
from onebend.studies.writing import REPRODUCE_FORMAT, summary_of, writer
from onebend.terminal.options import Json, Overwrite, Quiet
from onebend.terminal.options_reproduce import (
    Processes,
    Quick,
    ReproduceOut,
    ReproduceSeed,
    ReproduceSensor,
    WithoutVideo,
)
from onebend.terminal.reproducing import show_reproduced


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
        found = run(place.partial, setting, written_by=BY, processes=processes or 0, progress=progress)
        figures = draw_figures(found, progress=progress)
        summary = summary_of(found, written_by=BY)
        publish(place, writer(found, figures, summary, place.partial, version=onebend.__version__))
    if as_json:
        print_json(summary | {"output": str(output)})
    else:
        show_reproduced(Console(), found, output)
