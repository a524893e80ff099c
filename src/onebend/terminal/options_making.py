"""What the commands for making beams take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

DesignName = Annotated[
    str | None, typer.Argument(metavar="DESIGN", help="uniform, linear, quadratic, cubic, or a design's TOML file.")
]
DesignOf = Annotated[
    str, typer.Argument(metavar="DESIGN", help="uniform, linear, quadratic, cubic, or a design's TOML file.")
]
NewDesign = Annotated[
    Path | None, typer.Option("--new", metavar="FILE", help="Write a design file to fill in, and nothing else.")
]
SiliconeName = Annotated[
    str | None, typer.Option("--silicone", metavar="NAME", help='Cast of this product, such as "Dragon Skin 30".')
]
ShoreA = Annotated[
    float | None, typer.Option("--shore-a", metavar="A", help="Cast of a silicone of this hardness, scale A.")
]
ShoreZero = Annotated[
    float | None, typer.Option("--shore-zero", metavar="00", help="Cast of a silicone of this hardness, scale 00.")
]
Modulus = Annotated[
    float | None, typer.Option("--modulus-kPa", min=1e-3, metavar="E", help="Cast of a material of this modulus.")
]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write s, width, EI, k and mass per metre.")]
Picture = Annotated[Path | None, typer.Option("--picture", metavar="FILE", help="Write a picture (PNG).")]
ModelFile = Annotated[
    Path | None, typer.Option("--model", metavar="FILE", help="Write the designed beam as a model.json.")
]
PartsOutput = Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the parts.")]
Kind = Annotated[Literal["open", "halves"], typer.Option("--kind", help="One open tray, or two halves.")]
Wall = Annotated[float, typer.Option("--wall-mm", min=0.4, metavar="MM", help="Thickness of walls and floor.")]
Draft = Annotated[float, typer.Option("--draft-deg", min=0.0, max=10.0, metavar="DEG", help="Lean of the walls.")]
Shrinkage = Annotated[
    float, typer.Option("--shrinkage-percent", min=0.0, max=9.9, metavar="P", help="How much the silicone shrinks.")
]
TagSize = Annotated[float, typer.Option("--size-mm", min=0.5, metavar="MM", help="Side of a tag's black square.")]
TagsAt = Annotated[
    list[float] | None,
    typer.Option("--tag-at", min=0.0, max=1.0, metavar="S", help="Place of a tag on the beam; may be repeated."),
]
Shape = Annotated[Literal["stl", "3mf"], typer.Option("--as", help="Kind of file.")]
StripOf = Annotated[
    Path | None, typer.Argument(metavar="[REC]", help="A recording: its tags, and a page with their places.")
]
Ids = Annotated[str | None, typer.Option("--ids", metavar="IDS", help="Such as 0-4 or 0,3,7-9.")]
TagsSize = Annotated[
    float | None, typer.Option("--size-mm", min=0.5, metavar="MM", help="Side of the black square; default: 12.")
]
TagFamily = Annotated[str | None, typer.Option("--family", metavar="FAMILY", help="Default: tag36h11.")]
Rim = Annotated[float, typer.Option("--rim-cells", min=1.0, metavar="N", help="White around the black square.")]
Paper = Annotated[Literal["a4", "letter"], typer.Option("--page", help="Size of the paper.")]
NoCuts = Annotated[bool, typer.Option("--no-cut-marks", help="Leave the cut marks out.")]
NoLabels = Annotated[bool, typer.Option("--no-labels", help="Leave the numbers out.")]
SheetFile = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A .pdf, or an .svg a page.")]
ReplaceFiles = Annotated[bool, typer.Option("--force", "--overwrite", help="Replace files that are there.")]
