"""Commands that make recordings of beams that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from onebend.cli.common import BY, clean_errors, or_nan, print_json, progress_of
from onebend.lab.design_file import find_design
from onebend.lab.film_request import FilmRequest, filming_of
from onebend.lab.filming.film import film as make_film
from onebend.lab.filming.film_setup import Filming
from onebend.lab.random_bench import random_bench
from onebend.terminal.options import Json, Quiet
from onebend.terminal.options_film import (
    BaseAngle,
    Bend,
    Camera,
    Design,
    Direction,
    Distance,
    FilmFolder,
    Force,
    Fps,
    Gravity,
    PushAt,
    PushKind,
    Seconds,
    Seed,
    Sensor,
    Tilt,
    Uncalibrated,
)

FILM_FORMAT = "onebend-film-1"
DRAWN = "random"


def film(
    design: Design,
    *,
    output: FilmFolder = None,
    push: PushKind = "slow",
    push_at: PushAt = None,
    force: Force = None,
    bend: Bend = 65.0,
    direction: Direction = None,
    seconds: Seconds = None,
    camera: Camera = "hd",
    fps: Fps = None,
    tilt: Tilt = None,
    distance: Distance = None,
    sensor: Sensor = "franka",
    gravity: Gravity = 0.0,
    base_angle: BaseAngle = 0.0,
    uncalibrated: Uncalibrated = False,
    seed: Seed = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Film a known beam that is pushed: a recording folder to learn from, with the truth beside it."""
    seen = FilmRequest(camera=camera, fps=or_nan(fps), tilt=math.radians(or_nan(tilt)), distance=or_nan(distance))
    request = replace(
        seen,
        push=push,
        at_s=or_nan(push_at),
        force=or_nan(force),
        bend=math.radians(bend),
        direction=math.radians(or_nan(direction)),
        seconds=or_nan(seconds),
        sensor=sensor,
        gravity=gravity,
        base_angle=math.radians(base_angle),
        calibrated=not uncalibrated,
    )
    with clean_errors(), progress_of(quiet) as progress:
        filming, folder = _filming(design, request, seed, output)
        make_film(filming, folder, seed=seed, progress=progress)
    bench = filming.bench
    if as_json:
        data = {"length_m": bench.beam.length, "force_max_N": bench.push.peak, "video_seconds": bench.push.duration}
        print_json({"format": FILM_FORMAT, "written_by": BY, "output": str(folder), "seed": seed, **data})
        return
    typer.echo(
        f"Wrote {folder}: {bench.push.duration:.1f} s at {bench.fps:g} frames/s, a push to {bench.push.peak:.3g} N at "
        f"s = {bench.push.at_s:g}. Learn from it with: onebend learn {folder}"
    )


def _filming(design: str, request: FilmRequest, seed: int, output: Path | None) -> tuple[Filming, Path]:
    """What is filmed, and where to."""
    if design == DRAWN:
        folder = output or Path(f"{DRAWN}-{seed}")
        return random_bench(np.random.default_rng([seed, 20]), name=folder.resolve().name), folder
    found = find_design(design)
    folder = output or Path(f"{found.name}-{request.push}")
    return filming_of(found, request, folder.resolve().name), folder
