"""What `onebend film` takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from onebend.lab.film_request import CameraName, PushName, SensorName

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
Force = Annotated[float | None, typer.Option("--force-N", min=1e-6, metavar="N", help="Peak; default: by --bend-deg.")]
Bend = Annotated[
    float, typer.Option("--bend-deg", min=1.0, max=150.0, metavar="DEG", help="How far the pushed place turns.")
]
Direction = Annotated[
    float | None,
    typer.Option("--direction-deg", metavar="DEG", help="Of the push against the beam's x axis; default: 100."),
]
Seconds = Annotated[float | None, typer.Option("--seconds", min=0.05, metavar="S", help="From first to last contact.")]
Camera = Annotated[CameraName, typer.Option("--camera", help="Its picture, rate, lens and tilt.")]
Fps = Annotated[float | None, typer.Option("--fps", min=1.0, max=240.0, metavar="HZ", help="Default: the camera's.")]
Tilt = Annotated[
    float | None, typer.Option("--tilt-deg", min=-45.0, max=45.0, metavar="DEG", help="Default: the camera's.")
]
Distance = Annotated[
    float | None,
    typer.Option("--distance-m", min=0.05, metavar="M", help="Of the camera; default: as near as shows the push."),
]
Sensor = Annotated[
    SensorName, typer.Option("--sensor", help="A robot's own estimate, a six-axis sensor, or one without errors.")
]
Gravity = Annotated[
    float,
    typer.Option("--gravity-m-s2", min=0.0, metavar="G", help="In the plane of bending; 0: across it."),
]
BaseAngle = Annotated[
    float, typer.Option("--base-angle-deg", metavar="DEG", help="The beam's x axis in the room; -90: it hangs.")
]
Uncalibrated = Annotated[bool, typer.Option("--uncalibrated", help="Do not tell the camera's calibration.")]
Seed = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="The same seed makes the same files.")]
