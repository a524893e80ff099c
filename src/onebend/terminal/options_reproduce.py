"""What `onebend reproduce` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from onebend.studies.settings import SensorKind

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
