"""The command that shows a learned beam, and what the commands that take one share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.beam.model import Beam
from onebend.beam.problem import has_mass
from onebend.cli.common import (
    Json,
    LogAxis,
    Model,
    Overwrite,
    Quiet,
    Recording,
    Threads,
    clean_errors,
    print_json,
    progress_of,
    say,
    say_warning,
    screen,
)
from onebend.errors import ControlError
from onebend.export.export import DAMPING_TIME, KINDS, Kind, export
from onebend.export.rerun_file import write_rerun
from onebend.files.single_file import fresh_file, write_file
from onebend.pipeline import compare
from onebend.recording.folder import folder_of, read_recording
from onebend.recording.observe import ObserveSettings
from onebend.recording.video import read_frames
from onebend.results.detection_cache import detection_cache
from onebend.results.model import StoredModel, model_file, read_model

HEAVY = 100.0  # m/s^2: what is more is another unit


def show(model: Model, *, log: LogAxis = False, as_json: Json = False) -> None:
    """Draw the learned k(s) in the terminal."""
    # here: the other commands that take a model, which share what is below, do without
    from onebend.cli.screens import show_model
    from onebend.results.learned_files import model_summary

    with clean_errors():
        stored = read_model(model)
        say_changed(model, stored)
    if as_json:
        print_json(model_summary(stored))
    else:
        show_model(screen(), stored, log=log)


def read_trusted(model: Path) -> StoredModel:
    """The model; a warning on standard error where its k(s) is in doubt."""
    stored = read_model(model)
    say_changed(model, stored)
    doubts = () if stored.uncertain is None else stored.uncertain.doubts
    if doubts:
        say_warning(f"k(s) of {model} is NOT TO BE TRUSTED: {'; '.join(doubts)}.", about="not trusted")
    return stored


def say_changed(model: Path, stored: StoredModel) -> None:
    """A warning on standard error where the file is not as it was written, or another than its folder's."""
    for words in filter(None, (stored.changed, stored.swapped)):
        say_warning(f"{model_file(model)} {words}.", about="changed file")


def gravity_on(beam: Beam, gravity: tuple[float, float]) -> tuple[float, float]:
    """The gravity [m/s^2] that was asked for. Raises `ControlError` where the model has no mass for it to act on."""
    if not all(math.isfinite(one) for one in gravity):
        raise ControlError(f"gravity is two finite numbers [m/s^2], got {gravity[0]:g} and {gravity[1]:g}")
    if math.hypot(*gravity) > HEAVY:
        raise ControlError(f"gravity of {math.hypot(*gravity):g} m/s^2 is no planet's: is it in m/s^2?")
    if any(gravity) and not has_mass(beam):
        raise ControlError("the model has no mass, so gravity does nothing: learn with mass_kg, or leave gravity out")
    return gravity


# The commands that hand a learned beam, or a recording with it, to other software.

ExportTo = Annotated[Kind, typer.Option("--to", help="What the beam is for.")]
OutFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: beam, with the ending."),
]
Hinges = Annotated[int, typer.Option(min=2, max=10_000, metavar="N", help="Hinges of a chain (mujoco, urdf, sdf).")]
MassKg = Annotated[
    float | None,
    typer.Option("--mass-kg", metavar="KG", help="The beam's mass, spread evenly; default: as it was learned with."),
]
DampingTime = Annotated[
    float | None,
    typer.Option(
        "--damping-time-s",
        metavar="SECONDS",
        help="Of every hinge, damping over stiffness; default: as `onebend damp` found it, else 0.02.",
    ),
]
RerunFile = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="The file to write; default: the recording's name.rrd."),
]
Every = Annotated[int, typer.Option(min=1, metavar="N", help="Keep one picture of the video in N.")]


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
    say(f"Wrote {path}: {KINDS[kind].says}.")
    say(KINDS[kind].use.format(path=path))


def _damping_time(asked: float | None, stored: StoredModel) -> float:
    """s: what was asked for, else what a swing said."""
    if asked is not None:
        return asked
    return DAMPING_TIME if stored.damping is None else stored.damping.loss_time


def rerun_command(
    model: Model,
    recording: Recording,
    *,
    output: RerunFile = None,
    every: Every = 2,
    threads: Threads = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Write a recording and the learned beam as a Rerun file: video, tags, beam, forces, residuals."""
    with clean_errors():
        stored = read_trusted(model)
        path = output or Path(f"{folder_of(recording).resolve().name}.rrd")
        with fresh_file(path, overwrite=overwrite) as beside, progress_of(quiet) as progress:
            observing, detect = ObserveSettings(threads=threads), detection_cache(onebend.__version__).detect
            [(found, seen)] = compare(
                stored.beam,
                [recording],
                stiffness=stored.uncertain,
                observing=observing,
                detect=detect,
                progress=progress,
            )
            video = read_recording(recording).video
            frames = () if video is None else read_frames(video)
            write_rerun(beside, stored.beam, found, seen, frames, uncertain=stored.uncertain, every=every)
    say(f"Wrote {path}. Look at it with: rerun {path}")
