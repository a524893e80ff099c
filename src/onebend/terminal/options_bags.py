"""What the command for bags takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

BagPath = Annotated[Path, typer.Argument(metavar="BAG", help="A .mcap, .db3 or .bag file, or a bag's folder.")]
Definitions = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder with .msg files, for a bag that does not say what it holds."),
]
