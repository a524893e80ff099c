"""Commands that make recordings of beams that are known."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, or_nan, print_json, progress_of, put_in_place, say, workplace
from onebend.cli.options import MOST, Json, Quiet
from onebend.lab.design_file import find_design
from onebend.lab.effects.real_bench import PATCH_OVER_TAG, effects_named
from onebend.lab.film_request import CameraName, FilmRequest, PushName, SensorName, filming_of
from onebend.lab.filming.film import film as make_film
from onebend.lab.filming.film_setup import Filming, check
from onebend.lab.marker_folder import check_trackable, marker_recording
from onebend.lab.random_bench import BenchRanges, design_with_effects, random_bench
from onebend.lab.random_effects import LABORATORY
from onebend.progress import Progress

Design = Annotated[
    str,
    typer.Argument(
        metavar="DESIGN", help="A named design, a design.toml, or `random`: all but the seed is drawn then."
    ),
]
FilmFolder = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="OUT", help="Folder to make; default: DESIGN-PUSH.")
]
PushKind = Annotated[
    PushName,
    typer.Option(
        "--push", help="slow: at the tip. s08, s06: slow, there. fast: the beam swings. free: released at once."
    ),
]
PushAt = Annotated[
    float | None, typer.Option("--push-at", min=0.05, max=1.0, metavar="S", help="Where it pushes, along the beam.")
]
Force = Annotated[
    float | None, typer.Option("--force-N", min=1e-6, max=MOST, metavar="N", help="Peak; default: by --bend-deg.")
]
Bend = Annotated[
    float, typer.Option("--bend-deg", min=1.0, max=150.0, metavar="DEG", help="How far the pushed place turns.")
]
Direction = Annotated[
    float | None,
    typer.Option("--direction-deg", metavar="DEG", help="Of the push against the beam's x axis; default: 100."),
]
Seconds = Annotated[
    float | None, typer.Option("--seconds", min=0.05, max=600.0, metavar="S", help="From first to last contact.")
]
Camera = Annotated[CameraName, typer.Option("--camera", help="Its picture, rate, lens and tilt.")]
Fps = Annotated[float | None, typer.Option("--fps", min=1.0, max=240.0, metavar="HZ", help="Default: the camera's.")]
Tilt = Annotated[
    float | None, typer.Option("--tilt-deg", min=-45.0, max=45.0, metavar="DEG", help="Default: the camera's.")
]
Distance = Annotated[
    float | None,
    typer.Option(
        "--distance-m", min=0.05, max=MOST, metavar="M", help="Of the camera; default: as near as shows the push."
    ),
]
Sensor = Annotated[
    SensorName, typer.Option("--sensor", help="A robot's own estimate, a six-axis sensor, or one without errors.")
]
Gravity = Annotated[
    float,
    typer.Option("--gravity-m-s2", min=0.0, max=MOST, metavar="G", help="In the plane of bending; 0: across it."),
]
BaseAngle = Annotated[
    float, typer.Option("--base-angle-deg", metavar="DEG", help="The beam's x axis in the room; -90: it hangs.")
]
Uncalibrated = Annotated[bool, typer.Option("--uncalibrated", help="Do not tell the camera's calibration.")]
Effects = Annotated[
    bool, typer.Option("--effects", help="What real benches do beside bending, all drawn at random: stretch, creep ...")
]
Effect = Annotated[
    list[str] | None,
    typer.Option(
        "--effect",
        metavar="NAME=SIZE",
        help="One effect of a real bench by its size in SI units, as relaxation=0.1. More than one can be given.",
    ),
]
Markers = Annotated[
    bool,
    typer.Option("--markers", help="Tracked markers in place of a film: no pixels, so it takes a second. Slow pushes."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="The same seed makes the same files.")]

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
    effects: Effects = False,
    effect: Effect = None,
    markers: Markers = False,
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
        filming, folder = _filming(design, request, seed, output, effects)
        if effect:
            filming = _with_effects(filming, effect, effects)
        check(filming, folder)
        if markers:
            check_trackable(filming)
        make = partial(_make, filming, markers=markers, seed=seed, progress=progress)
        with workplace(folder, FILM_FORMAT, overwrite=False) as place:
            put_in_place(place, make)
    bench = filming.bench
    if as_json:
        data = {"length_m": bench.beam.length, "force_max_N": bench.push.peak, "video_seconds": bench.push.duration}
        print_json({"format": FILM_FORMAT, "written_by": BY, "output": str(folder), "seed": seed, **data})
        return
    say(
        f"Wrote {folder}: {bench.push.duration:.1f} s at {bench.fps:g} frames/s, a push to {bench.push.peak:.3g} N at "
        f"s = {bench.push.at_s:g}. Learn from it with: onebend learn {folder}"
    )


def _make(filming: Filming, folder: Path, *, markers: bool, seed: int, progress: Progress) -> None:
    if markers:
        marker_recording(filming.bench, folder, seed=seed)
        return
    make_film(filming, folder, seed=seed, progress=progress)


def _with_effects(filming: Filming, named: list[str], drawn: bool) -> Filming:
    """What is filmed, with effects that are named beside those that are drawn."""
    bench = filming.bench
    before = bench.effects if drawn else replace(bench.effects, patch_length=PATCH_OVER_TAG * filming.tag_size)
    return replace(filming, bench=replace(bench, effects=effects_named(named, before)))


def _filming(design: str, request: FilmRequest, seed: int, output: Path | None, effects: bool) -> tuple[Filming, Path]:
    """What is filmed, with effects drawn where they are asked for, and where to."""
    if design == DRAWN:
        folder = output or Path(f"{DRAWN}-{seed}")
        ranges = BenchRanges(effects=LABORATORY if effects else None)
        return random_bench(np.random.default_rng([seed, 20]), ranges, name=folder.resolve().name), folder
    found = find_design(design)
    folder = output or Path(f"{found.name}-{request.push}")
    filming = filming_of(found, request, folder.resolve().name)
    return design_with_effects(filming, np.random.default_rng([seed, 21])) if effects else filming, folder
