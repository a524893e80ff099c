"""What `onebend rehearse` takes; what it shares with `onebend film` stands there."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from onebend.forecast.setup import Setup
from onebend.lab.film_request import PushName

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
    typer.Option("--push-at", metavar="S", help="Where it pushes, along the beam; once for each push."),
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
    float, typer.Option("--placement-mm", min=1e-3, metavar="MM", help="How well the tags are placed, one sd.")
]
TurnSd = Annotated[
    float, typer.Option("--turn-deg", min=1e-3, metavar="DEG", help="How well the tags are turned, one sd.")
]
ClockSd = Annotated[
    float | None,
    typer.Option(
        "--clock-sd-s",
        min=0.0,
        metavar="S",
        help="How well the clocks agree; 0: one clock; default: found from the data.",
    ),
]
Runs = Annotated[int, typer.Option(min=0, metavar="N", help="Simulated recordings; 0: the prediction alone, at once.")]
Jobs = Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes that simulate; default: all cores.")]
Advices = Annotated[int, typer.Option("--count", min=0, metavar="N", help="How many changes to name.")]
RehearsalFolder = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="OUT", help="Folder for figure, table and JSON.")
]
RunSeed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Of the first run; the next ones count up.")]
