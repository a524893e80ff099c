"""What the commands take. Names and helps are the user's manual; docs/cli.md says more."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from onebend.records import CLAMP_SD

CLAMP_DEG = math.degrees(CLAMP_SD)
LEAST = 1e-6  # of what must be positive

Recording = Annotated[Path, typer.Argument(metavar="REC", help="Folder with recording.toml, a video and a force log.")]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="A model.json, or the results folder that holds one.")]
Recordings = Annotated[list[Path], typer.Argument(metavar="REC...", help="Folders with recording.toml, of one beam.")]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The folder to make.")]
Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="OUT", help="Folder for what comes out.")]
ValidateOn = Annotated[
    list[Path] | None,
    typer.Option("--validate", metavar="REC", help="A recording to check the learned beam on; may be repeated."),
]
Method = Annotated[
    Literal["fit", "regression", "paper"],
    typer.Option(
        help="fit: k(s) with a band, from the markers; it begins at the regression. regression: the paper's way alone, "
        "with the tags' angles. paper: its rows (17) to the letter, tags' positions only."
    ),
]
Family = Annotated[Literal["gaussians", "powers"], typer.Option(help="The functions that k(s) is made of.")]
Width = Annotated[
    float | None,
    typer.Option(min=0.001, metavar="SIGMA", help="Sigma of the Gaussians as a part of L; default: their distance."),
]
Bic = Annotated[Literal["textbook", "paper"], typer.Option(help="How complexity counts; paper: as its tables follow.")]
Modes = Annotated[int | None, typer.Option("--n", metavar="N", help="Fix the number of curvature modes.")]
Functions = Annotated[int | None, typer.Option("--m", metavar="M", help="Fix the number of stiffness functions.")]
Epsilon = Annotated[
    float | None,
    typer.Option(
        "--epsilon-s",
        min=0.0,
        metavar="SECONDS",
        help="Take the log's nearest row, at most this far from a frame (the paper's way); default: interpolate.",
    ),
]
MaxForce = Annotated[
    float | None, typer.Option("--max-force-N", min=LEAST, metavar="N", help="Default: twice the largest so far.")
]
MaxTipAngle = Annotated[
    float | None,
    typer.Option(
        "--max-tip-angle-deg",
        min=1.0,
        max=180.0,
        metavar="DEG",
        help="Default: 90, and at most 1.25 times the largest curvature so far.",
    ),
]
Count = Annotated[int, typer.Option(min=1, metavar="N", help="How many proposals.")]
ClampSd = Annotated[
    float | None,
    typer.Option(
        "--clamp-sd-deg",
        min=0.0,
        metavar="DEG",
        help=f"How far the clamp may be turned, one sd, whatever recording.toml says; default: as that says, or "
        f"{CLAMP_DEG:.2g}. It trades off against k.",
    ),
]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads that look for tags; default: all cores.")
]
Overwrite = Annotated[bool, typer.Option("--force", "--overwrite", help="Replace earlier results in OUT.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object (SI units) and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress.")]
