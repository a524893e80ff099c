"""The command that hands a learned beam to other software."""

from __future__ import annotations

from pathlib import Path

import typer
from rich.console import Console

from onebend.cli.common import clean_errors
from onebend.export.export import DAMPING_TIME, KINDS, Kind, export, suffix_of
from onebend.results.model import StoredModel, read_model
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
    damping_time: DampingTime = None,
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
            damping_time=_damping_time(damping_time, stored),
            sites=() if stored.origin is None else stored.origin.marker_s,
        )
        write_file(path, content, overwrite=overwrite)
    Console().print(f"Wrote {path}: {KINDS[kind].says}.", highlight=False, soft_wrap=True)
    typer.echo(KINDS[kind].use.format(path=path))


def _damping_time(asked: float | None, stored: StoredModel) -> float:
    """s: what was asked for, else what a swing said."""
    if asked is not None:
        return asked
    return DAMPING_TIME if stored.damping is None else stored.damping.loss_time
