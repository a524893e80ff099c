"""Options that several commands take. Names and helps are the user's manual; docs/cli.md says more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LEAST, MOST = 1e-6, 1e9  # of what must be positive; beyond it, numbers are no measures of a beam

PushAt = Annotated[
    float,
    typer.Option("--push-at", min=LEAST, max=1.0, metavar="S", help="Where the force acts: s in (0, 1], 1 the tip."),
]
Point = Annotated[
    float,
    typer.Option("--point", min=LEAST, max=1.0, metavar="S", help="The point that is led to the goal: s in (0, 1]."),
]
Goal = Annotated[tuple[float, float], typer.Option("--goal", metavar="X Y", help="m, in the beam's frame.")]
Gravity = Annotated[
    tuple[float, float],
    typer.Option(
        "--gravity-m-s2",
        metavar="GX GY",
        help="In the beam's frame; needs a model with a mass. Default: none in plane.",
    ),
]
Recording = Annotated[
    Path, typer.Argument(metavar="REC", help="Folder with recording.toml, a video and a force log; or that file.")
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="A model.json, or the results folder that holds one.")]
Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="OUT", help="Folder for what comes out.")]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads that look for tags; default: all cores.")
]
Overwrite = Annotated[bool, typer.Option("--force", "--overwrite", help="Replace earlier results in OUT.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object (SI units) and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
LogAxis = Annotated[bool, typer.Option("--log", help="Draw k(s) on a logarithmic axis.")]
