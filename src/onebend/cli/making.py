"""Commands for making beams: designs, moulds to print, sheets of tags."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, print_json, put_in_place, say, say_failed, screen, workplace
from onebend.cli.options import MOST, Json, Overwrite
from onebend.errors import MechanicsError
from onebend.files.single_file import check_name_free, write_file
from onebend.lab.design_file import find_design, write_design_template
from onebend.lab.designs import Design
from onebend.lab.expected import expect
from onebend.lab.fabrication.clamp import TagSeat, carriers, clamp
from onebend.lab.fabrication.mould import MouldSettings, PrintedPart
from onebend.lab.fabrication.mould import mould as make_mould
from onebend.lab.fabrication.page import files_of
from onebend.lab.fabrication.sheet import Sheet, strip_page, tag_pages
from onebend.lab.materials import ModulusEstimate, from_shore_00, from_shore_a, silicone
from onebend.recording.folder import read_recording
from onebend.recording.toml.entries import FAMILIES
from onebend.report.figures.parts import design_figure, parts_figure
from onebend.report.figures.pictures import Draw, draw
from onebend.results.fabrication import (
    DESIGN_FORMAT,
    MOULD_FORMAT,
    TAGS_FORMAT,
    design_csv,
    parts_summary,
    parts_writer,
)
from onebend.results.model import StoredModel, model_text
from onebend.results.provenance import inputs_of
from onebend.terminal.making import show_design, show_parts

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
    float | None,
    typer.Option("--modulus-kPa", min=1e-3, max=MOST, metavar="E", help="Cast of a material of this modulus."),
]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write s, width, EI, k and mass per metre.")]
Picture = Annotated[Path | None, typer.Option("--picture", metavar="FILE", help="Write a picture (PNG).")]
ModelFile = Annotated[
    Path | None, typer.Option("--model", metavar="FILE", help="Write the designed beam as a model.json.")
]
PartsOutput = Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for the parts.")]
Kind = Annotated[Literal["open", "halves"], typer.Option("--kind", help="One open tray, or two halves.")]
Wall = Annotated[
    float, typer.Option("--wall-mm", min=0.4, max=MOST, metavar="MM", help="Thickness of walls and floor.")
]
Draft = Annotated[float, typer.Option("--draft-deg", min=0.0, max=10.0, metavar="DEG", help="Lean of the walls.")]
Shrinkage = Annotated[
    float, typer.Option("--shrinkage-percent", min=0.0, max=9.9, metavar="P", help="How much the silicone shrinks.")
]
TagSize = Annotated[
    float, typer.Option("--size-mm", min=0.5, max=MOST, metavar="MM", help="Side of a tag's black square.")
]
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
    float | None,
    typer.Option("--size-mm", min=0.5, max=MOST, metavar="MM", help="Side of the black square; default: 12."),
]
TagFamily = Annotated[str | None, typer.Option("--family", metavar="FAMILY", help="Default: tag36h11.")]
Rim = Annotated[
    float, typer.Option("--rim-cells", min=1.0, max=MOST, metavar="N", help="White around the black square.")
]
Paper = Annotated[Literal["a4", "letter"], typer.Option("--page", help="Size of the paper.")]
NoCuts = Annotated[bool, typer.Option("--no-cut-marks", help="Leave the cut marks out.")]
NoLabels = Annotated[bool, typer.Option("--no-labels", help="Leave the numbers out.")]
SheetFile = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="A .pdf, or an .svg a page.")]
ReplaceFiles = Annotated[bool, typer.Option("--force", "--overwrite", help="Replace files that are there.")]

MOST_TAGS = 1000
RANGE = re.compile(r"(\d{1,6})(?:-(\d{1,6}))?")


def design(
    name: DesignName = None,
    *,
    new: NewDesign = None,
    silicone: SiliconeName = None,
    shore_a: ShoreA = None,
    shore_zero: ShoreZero = None,
    modulus: Modulus = None,
    csv_file: Csv = None,
    picture: Picture = None,
    model: ModelFile = None,
    overwrite: ReplaceFiles = False,
    as_json: Json = False,
) -> None:
    """Say what a beam of a design will do on the bench: stiffness, mass, forces, buckling, vibration."""
    with clean_errors():
        if new is not None:
            say(f"Wrote {write_design_template(new)}. Fill it in, then: onebend design {new}")
            return
        if name is None:
            raise MechanicsError("name a design: uniform, linear, quadratic, cubic, or a file (--new FILE writes one)")
        found = _of_material(find_design(name), silicone, shore_a, shore_zero, modulus)
        expected = expect(found)
        _write_all(_design_files(found, csv_file, picture, model), overwrite=overwrite)
    if as_json:
        print_json({"format": DESIGN_FORMAT, "written_by": BY, **expected.as_dict()})
    else:
        show_design(screen(), expected)


def mould(
    name: DesignOf,
    *,
    output: PartsOutput,
    kind: Kind = "open",
    wall: Wall = 4.0,
    draft: Draft = 0.0,
    shrinkage: Shrinkage = 0.0,
    size: TagSize = 12.0,
    tag_at: TagsAt = None,
    shape: Shape = "stl",
    picture: Picture = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Make the mould of a design, the clamp and the carriers of its tags, as files to print."""
    with clean_errors(), workplace(output, MOULD_FORMAT, overwrite) as place:
        if picture is not None:
            check_name_free(picture, overwrite=overwrite)
        settings = MouldSettings(
            kind=kind,
            wall=1e-3 * wall,
            draft=math.radians(draft),
            shrinkage=1e-2 * shrinkage,
            tag_places=tuple(tag_at) if tag_at else MouldSettings().tag_places,
        )
        made = make_mould(find_design(name), settings)
        seat = TagSeat(1e-3 * size)
        others = (*clamp(made.design, settings, seat), carriers(made.design, settings, seat))
        parts = (*made.parts, *others, PrintedPart("cast-beam", made.cast))
        summary = parts_summary(made, parts, written_by=BY)
        put_in_place(place, parts_writer(parts, shape, summary), inputs=inputs_of([Path(name)]))
        _write_all(_picture(picture, partial(parts_figure, parts)), overwrite=overwrite)
    if as_json:
        print_json(summary)
    else:
        show_parts(screen(), made, parts, output)


def tags(
    recording: StripOf = None,
    *,
    output: SheetFile,
    ids: Ids = None,
    size: TagsSize = None,
    family: TagFamily = None,
    rim: Rim = 1.0,
    page: Paper = "a4",
    no_cut_marks: NoCuts = False,
    no_labels: NoLabels = False,
    overwrite: ReplaceFiles = False,
    as_json: Json = False,
) -> None:
    """Draw a sheet of tags at exact size, with rulers to check the printer by."""
    with clean_errors():
        known = None if recording is None else read_recording(recording)
        if (known is None) == (ids is None):
            raise MechanicsError("say which tags: --ids 0-4, or a recording whose tags they are, not both")
        if known is not None and (size is not None or family is not None):
            raise MechanicsError("the recording says the tags' size and family: leave --size-mm and --family out")
        if known is None:
            numbers, side, named = parse_ids(ids or ""), 1e-3 * (size or 12.0), family or FAMILIES[0]
        else:
            numbers = tuple(tag.id for tag in (*known.tags.on_base, *known.tags.on_beam))
            side, named = known.tags.size, known.tags.family
        sheet = Sheet(numbers, side, named, rim, page, not no_cut_marks, not no_labels)
        pages = tag_pages(sheet)
        if known is not None:
            pages = (*pages, strip_page(known, page=page, rim=rim))
        written = files_of(output, pages, f"{named}, {1e3 * side:g} mm")
        _write_all(written, overwrite=overwrite)
    if as_json:
        data = {"format": TAGS_FORMAT, "written_by": BY, "family": named, "size_m": side, "ids": list(numbers)}
        print_json({**data, "pages": len(pages), "files": [str(path) for path in written]})
    else:
        what = f"{len(numbers)} tag{'s' if len(numbers) > 1 else ''} of {named}, {1e3 * side:g} mm"
        say(f"Wrote {', '.join(map(str, written))}: {what}. Print at 100 % and measure both rulers.")


def parse_ids(text: str) -> tuple[int, ...]:
    """Numbers of tags from text such as `0-4,7`. Raises `MechanicsError` where it is something else."""
    found: list[int] = []
    for piece in text.split(","):
        match = RANGE.fullmatch(piece.strip())
        first, last = (0, -1) if match is None else (int(match[1]), int(match[2] or match[1]))
        if last < first or last - first >= MOST_TAGS:
            raise MechanicsError(
                f"--ids {text!r}: {piece.strip()!r} is no tag and no range of tags. Write 0-4 or 0,3,7-9"
            )
        found += range(first, last + 1)
    return tuple(found)


def _of_material(
    found: Design, named: str | None, shore_a: float | None, shore_zero: float | None, modulus: float | None
) -> Design:
    """The design cast of what the options say."""
    given = [value for value in (named, shore_a, shore_zero, modulus) if value is not None]
    if len(given) > 1:
        raise MechanicsError("give one of --silicone, --shore-a, --shore-zero and --modulus-kPa")
    if named is not None:
        product = silicone(named)
        return found.of(product.stiffness, product.density)
    if shore_a is not None:
        return found.of(from_shore_a(shore_a))
    if shore_zero is not None:
        return found.of(from_shore_00(shore_zero))
    return found if modulus is None else found.of(ModulusEstimate(1e3 * modulus, 0.0, "given"))


def _design_files(
    found: Design, csv_file: Path | None, picture: Path | None, model: Path | None
) -> dict[Path, str | bytes]:
    """What was asked for of a design, by where it goes."""
    files: dict[Path, str | bytes] = {}
    if csv_file is not None:
        files[csv_file] = design_csv(found)
    files |= _picture(picture, partial(design_figure, found))
    if model is not None:
        files[model] = model_text(StoredModel(found.beam(), None, found.uncertain()), written_by=BY)
    return files


def _picture(path: Path | None, make: Draw) -> dict[Path, str | bytes]:
    """A picture by where it goes, where one is wanted and can be drawn."""
    if path is None:
        return {}
    pictures = draw({path.name: make})
    say_failed(pictures)
    return {path: pictures.drawn[path.name]} if pictures.drawn else {}


def _write_all(files: Mapping[Path, str | bytes], *, overwrite: bool) -> None:
    """Each file whole; none where one of them must not be replaced."""
    for path in files:
        check_name_free(path, overwrite=overwrite)
    for path, data in files.items():
        write_file(path, data, overwrite=overwrite)
