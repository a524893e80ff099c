"""The command that rehearses a push before it is filmed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, or_nan, print_json, progress_of, put_in_place, say, screen, workplace
from onebend.cli.filming import Bend, Camera, Distance, Fps, Seconds, Sensor, Tilt
from onebend.cli.options import MOST, Json, Overwrite, Quiet
from onebend.errors import RecordingError
from onebend.forecast.figure import rehearsal_figure
from onebend.forecast.rehearsal import Rehearsal
from onebend.forecast.rehearsal import rehearse as make_rehearsal
from onebend.forecast.setup import Setup, known_beam, setup_of
from onebend.forecast.writing import REHEARSE_FORMAT, summary_of, writer_of
from onebend.lab.film_request import FilmRequest, PushName
from onebend.report.figures.pictures import draw
from onebend.results.provenance import inputs_of
from onebend.terminal.rehearsals import show_rehearsal
from onebend.workers import available_cores

TURN_DEG = round(math.degrees(Setup.turn_sd), 6)  # 1.5, not 1.5000000000000002

Rehearsed = Annotated[
    str, typer.Argument(metavar="DESIGN", help="A named design, a design.toml, or a learned model.json.")
]
TagPlaces = Annotated[
    str | None,
    typer.Option(
        "--tags", metavar="S,S,...", help="Where the tags sit along the beam; default: thirds, or the model's."
    ),
]
SlowPush = Annotated[PushName, typer.Option("--push", help="slow: at the tip. s08, s06: slow, there.")]
PushesAt = Annotated[
    list[float] | None,
    typer.Option(
        "--push-at", min=0.05, max=1.0, metavar="S", help="Where it pushes, along the beam; once for each push."
    ),
]
Forces = Annotated[
    list[float] | None, typer.Option("--force-N", metavar="N", help="Peak; default: by --bend-deg. One, or one a push.")
]
Directions = Annotated[
    list[float] | None,
    typer.Option("--direction-deg", metavar="DEG", help="Against the beam's x axis; default: 100. One, or one a push."),
]
GainSd = Annotated[
    float | None,
    typer.Option("--gain-sd", min=0.0, max=0.5, metavar="SD", help="Of the force's scale; default: the sensor's."),
]
PlacementSd = Annotated[
    float,
    typer.Option("--placement-mm", min=1e-3, max=MOST, metavar="MM", help="How well the tags are placed, one sd."),
]
TurnSd = Annotated[
    float, typer.Option("--turn-deg", min=1e-3, max=MOST, metavar="DEG", help="How well the tags are turned, one sd.")
]
ClockSd = Annotated[
    float | None,
    typer.Option(
        "--clock-sd-s",
        min=0.0,
        max=MOST,
        metavar="S",
        help="How well the clocks agree; 0: one clock; default: found from the data.",
    ),
]
Runs = Annotated[
    int,
    typer.Option(min=0, max=10_000, metavar="N", help="Simulated recordings; 0: the prediction alone, at once."),
]
Jobs = Annotated[
    int | None, typer.Option(min=1, max=1024, metavar="N", help="Processes that simulate; default: all cores.")
]
Advices = Annotated[int, typer.Option("--count", min=0, metavar="N", help="How many changes to name.")]
RehearsalFolder = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="OUT", help="Folder for figure, table and JSON.")
]
RunSeed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of the first run; the next ones count up.")]


def rehearse(
    design: Rehearsed,
    *,
    output: RehearsalFolder = None,
    tags: TagPlaces = None,
    push: SlowPush = "slow",
    push_at: PushesAt = None,
    force: Forces = None,
    bend: Bend = 65.0,
    direction: Directions = None,
    seconds: Seconds = None,
    sensor: Sensor = "franka",
    gain_sd: GainSd = None,
    camera: Camera = "hd",
    fps: Fps = None,
    tilt: Tilt = None,
    distance: Distance = None,
    placement: PlacementSd = 1e3 * Setup.placement_sd,
    turn: TurnSd = TURN_DEG,
    clock_sd: ClockSd = None,
    runs: Runs = 24,
    seed: RunSeed = 0,
    jobs: Jobs = None,
    count: Advices = 8,
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say how well k(s) would come out of a push before it is filmed, what costs most, and what to change."""
    with clean_errors():
        first = FilmRequest(push, bend=math.radians(bend), seconds=or_nan(seconds), sensor=sensor, camera=camera)
        first = replace(first, fps=or_nan(fps), tilt=math.radians(or_nan(tilt)), distance=or_nan(distance))
        setup = setup_of(
            known_beam(design),
            wishes_of(first, push_at or [], force or [], direction or []),
            tags=places_of(tags),
            gain_sd=or_nan(gain_sd),
            placement_sd=1e-3 * placement,
            turn_sd=math.radians(turn),
            clock_sd=or_nan(clock_sd),
        )
        work = partial(make_rehearsal, setup, runs=runs, seed=seed, jobs=jobs or available_cores(), count=count)
        found = _carried_out(work, Path(design), output, overwrite=overwrite, quiet=quiet)
    if as_json:
        print_json(summary_of(found, written_by=BY))
        return
    show_rehearsal(screen(), found)
    if output is not None:
        say(f"\nWrote {output}: rehearsal.png, rehearsal.csv, summary.json.")


def _carried_out(
    work: Callable[..., Rehearsal], source: Path, output: Path | None, *, overwrite: bool, quiet: bool
) -> Rehearsal:
    """The rehearsal; with an `output` its runs are kept there as they end, and its files are written there."""
    if output is None:
        with progress_of(quiet) as progress:
            return work(progress=progress)
    with workplace(output, REHEARSE_FORMAT, overwrite) as place, progress_of(quiet) as progress:
        inputs = inputs_of([source])
        found = work(keep=place.work, progress=progress)
        pictures = draw({"rehearsal": partial(rehearsal_figure, found)})
        put_in_place(place, writer_of(found, pictures, written_by=BY), pictures, inputs=inputs)
    return found


def wishes_of(first: FilmRequest, at: list[float], force: list[float], direction: list[float]) -> list[FilmRequest]:
    """One wish a push. Raises `RecordingError` where the counts do not fit, or a place or force cannot be."""
    given = {"--push-at": at, "--force-N": force, "--direction-deg": direction}
    count = max(1, *map(len, given.values()))
    for name, values in given.items():
        if len(values) not in (0, 1, count):
            raise RecordingError(
                f"{name} is given {len(values)} times for {count} pushes. Give it once, or once a push"
            )
    for s in at:
        if not 0.0 < s <= 1.0:
            raise RecordingError(f"--push-at {s:g} is not on the beam: give a place in (0, 1]")

    def pick(values: list[float], i: int) -> float:
        return values[min(i, len(values) - 1)] if values else math.nan

    return [
        replace(first, at_s=pick(at, i), force=pick(force, i), direction=math.radians(pick(direction, i)))
        for i in range(count)
    ]


def places_of(text: str | None) -> tuple[float, ...]:
    """Numbers of `0.33,0.67,1`. Raises `RecordingError` where one is none."""
    if text is None:
        return ()
    try:
        places = tuple(float(one) for one in text.split(","))
    except ValueError:
        raise RecordingError(f"--tags {text!r}: write places along the beam such as 0.33,0.67,1") from None
    if not all(math.isfinite(s) for s in places):
        raise RecordingError(f"--tags {text!r}: every place must be a number in (0, 1]")
    return places
