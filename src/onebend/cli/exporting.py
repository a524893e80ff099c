"""Commands that write a learned beam, or a recording with it, for other software."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.cli import common
from onebend.cli.models import read_trusted
from onebend.export.export import DAMPING_TIME, KINDS, Kind, export
from onebend.export.rerun_file import write_rerun
from onebend.files.single_file import fresh_file, write_file
from onebend.options import Only
from onebend.pipeline import compare
from onebend.recording.folder import folder_of, read_recording
from onebend.recording.observe import ObserveSettings
from onebend.recording.video import read_frames
from onebend.results.detection_cache import detection_cache
from onebend.results.model import StoredModel

ExportTo = Annotated[Kind, typer.Option("--to", help="The software or format.")]
OutFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: beam, with the format's ending."),
]
Hinges = Annotated[int, typer.Option(min=2, max=10_000, metavar="N", help="Hinges of a chain (mujoco, urdf, sdf).")]
MassKg = Annotated[
    float | None,
    typer.Option("--mass-kg", metavar="KG", help="The beam's mass, spread evenly; default: the mass in MODEL."),
]
DampingTime = Annotated[
    float | None,
    typer.Option(
        "--damping-time-s",
        metavar="SECONDS",
        help="Damping over stiffness of every hinge; default: the one in MODEL (`onebend damp`), else 0.02.",
    ),
]
Observing = Annotated[ObserveSettings, Only(("threads",))]
RerunFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: the recording's name.rrd."),
]
Every = Annotated[int, typer.Option(min=1, metavar="N", help="Keep one picture of the video in N.")]


def export_command(
    model: common.Model,
    *,
    to: ExportTo,
    output: OutFile = None,
    hinges: Hinges = 40,
    mass: MassKg = None,
    damping_time: DampingTime = None,
    overwrite: common.Overwrite = False,
) -> None:
    kind: Kind = to
    with common.clean_errors():
        stored = read_trusted(model)
        path = output or Path(f"beam{KINDS[kind].suffix}")
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
    common.say(f"Wrote {path}: {KINDS[kind].says}.")
    common.say(KINDS[kind].use.format(path=path))


def _damping_time(asked: float | None, stored: StoredModel) -> float:
    if asked is not None:
        return asked
    return DAMPING_TIME if stored.damping is None else stored.damping.loss_time


def rerun_command(
    model: common.Model,
    recording: common.Recording,
    *,
    output: RerunFile = None,
    every: Every = 2,
    observing: Observing,
    overwrite: common.Overwrite = False,
    quiet: common.Quiet = False,
) -> None:
    with common.clean_errors():
        stored = read_trusted(model)
        path = output or Path(f"{folder_of(recording).resolve().name}.rrd")
        with fresh_file(path, overwrite=overwrite) as beside, common.progress_of(quiet) as progress:
            [(found, seen)] = compare(
                stored.beam,
                [recording],
                stiffness=stored.uncertain,
                observing=observing,
                detect=detection_cache(onebend.__version__).detect,
                progress=progress,
            )
            video = read_recording(recording).video
            frames = () if video is None else read_frames(video)
            write_rerun(beside, stored.beam, found, seen, frames, uncertain=stored.uncertain, every=every)
    common.say(f"Wrote {path}. Look at it with: rerun {path}")
