"""The command that hands a learned beam to other software."""

from __future__ import annotations

from pathlib import Path

import typer
from rich.console import Console

from onebend.cli.common import clean_errors
from onebend.export.export import KINDS, Kind, export, suffix_of
from onebend.results.model import read_model
from onebend.results.single import write_file
from onebend.terminal.options import Model, Overwrite
from onebend.terminal.options_export import DampingTime, ExportTo, Hinges, MassKg, OutFile


def export_command(
    model: Model,
    *,
    to: ExportTo,
    output: OutFile = None,
    hinges: Hinges = 40,
    mass: MassKg = None,
    damping_time: DampingTime = 0.02,
    overwrite: Overwrite = False,
) -> None:
    """Write the learned beam for a simulator, a robot's description, a table, or as a function without onebend."""
    kind: Kind = to
    with clean_errors():
        stored = read_model(model)
        path = output or Path(f"beam{suffix_of(kind)}")
        content = export(
            stored.beam,
            kind,
            uncertain=stored.uncertain,
            hinges=hinges,
            mass=mass,
            damping_time=damping_time,
            sites=() if stored.origin is None else stored.origin.marker_s,
        )
        write_file(path, content, overwrite=overwrite)
    Console().print(f"Wrote {path}: {KINDS[kind].says}.", highlight=False, soft_wrap=True)
    typer.echo(KINDS[kind].use.format(path=path))
