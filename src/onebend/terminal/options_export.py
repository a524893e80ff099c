"""Options of `onebend export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from onebend.export.export import Kind

ExportTo = Annotated[Kind, typer.Option("--to", help="What the beam is for.")]
OutFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: beam, with the ending."),
]
Hinges = Annotated[int, typer.Option(min=2, metavar="N", help="Hinges of a chain (mujoco, urdf, sdf).")]
MassKg = Annotated[
    float | None,
    typer.Option("--mass-kg", metavar="KG", help="The beam's mass, spread evenly; default: as it was learned with."),
]
DampingTime = Annotated[
    float, typer.Option("--damping-time-s", metavar="SECONDS", help="Of every hinge, damping over stiffness.")
]
RerunFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: the recording's name.rrd."),
]
Every = Annotated[int, typer.Option(min=1, metavar="N", help="Keep one picture of the video in N.")]
