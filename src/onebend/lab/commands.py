"""Commands for designs, films and sheets of tags."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.beam.stiffness import half_width
from onebend.cli import common
from onebend.errors import MechanicsError, reference
from onebend.files.publish import headed, this_onebend, workplace
from onebend.files.single_file import write_files
from onebend.lab import designs
from onebend.lab.filming import Filming, check, check_trackable, film as make_film, marker_recording
from onebend.lab.random_bench import LABORATORY, BenchRanges, FilmRequest, design_with_effects, filming_of, random_bench
from onebend.lab.sheet import Sheet, files_of, strip_page, tag_pages
from onebend.options import option
from onebend.recording.entries import FAMILIES
from onebend.recording.folder import read_recording
from onebend.report.sentences import say, significant, worded
from onebend.results.model import StoredModel, model_text

FILM_FORMAT, DESIGN_FORMAT, TAGS_FORMAT = "onebend-film-1", "onebend-design-1", "onebend-tags-1"
DRAWN = "random"


def film(
    design: str,
    *,
    output: Path | None = None,
    request: FilmRequest,
    effects: bool = False,
    markers: bool = False,
    seed: int = 0,
    told: common.Told,
) -> None:
    with common.progress_of(told) as progress:
        filming, folder = _filming(design, request, seed, output, effects)
        check(filming, folder)
        if markers:
            check_trackable(filming)

        def make(folder: Path) -> None:
            if markers:
                marker_recording(filming.bench, folder, seed=seed)
            else:
                make_film(filming, folder, seed=seed, progress=progress)

        with workplace(folder, FILM_FORMAT, overwrite=False) as place:
            common.put_in_place(place, make)
    bench = filming.bench
    if told.as_json:
        data = {"length_m": bench.beam.length, "force_max_N": bench.push.peak, "video_seconds": bench.push.duration}
        common.print_json(headed(FILM_FORMAT, output=str(folder), seed=seed, **data))
        return
    common.say(
        f"Wrote {folder}: {bench.push.duration:.1f} s at {bench.fps:g} frames/s, a push to {bench.push.peak:.3g} N at "
        f"s = {bench.push.at_s:g}. Learn from it with: onebend learn {folder}"
    )


def _filming(design: str, request: FilmRequest, seed: int, output: Path | None, effects: bool) -> tuple[Filming, Path]:
    if design == DRAWN:
        folder = output or Path(f"{DRAWN}-{seed}")
        ranges = BenchRanges(effects=LABORATORY if effects else None)
        return random_bench(np.random.default_rng([seed, 20]), ranges, name=folder.resolve().name), folder
    found = designs.find_design(design)
    folder = output or Path(f"{found.name}-{request.push}")
    filming = filming_of(found, request, folder.resolve().name)
    return design_with_effects(filming, np.random.default_rng([seed, 21])) if effects else filming, folder


def show_design(console: Console, expected: designs.Expected) -> None:
    design = expected.design
    console.print(f"[bold]{escape(design.name)}[/]")
    console.print(design_table(expected))
    console.print(bends_table(expected))
    if design.modulus_log_sd > 0.0:
        factor = math.exp(half_width(design.modulus_log_sd))
        console.print(say("modulus roughly known", factor=factor))
    for remark in worded(design.remarks):
        console.print(f"[yellow]![/] {escape(remark.text)}\n[dim]{reference(remark.about)}[/]")


def design_table(expected: designs.Expected) -> Table:
    design = expected.design
    width, bending = 1e3 * np.asarray(design.width(designs.DENSE)), design.bending(designs.DENSE)
    droop = f"{1e3 * expected.droop:.1f} mm" if math.isfinite(expected.droop) else "no equilibrium"
    k = bending / design.length
    rows = (
        ("length, depth", f"{1e3 * design.length:g} mm, {1e3 * design.depth:g} mm"),
        ("width", f"{width.min():.4g} to {width.max():.4g} mm, narrowest at s = {designs.DENSE[width.argmin()]:.2f}"),
        ("modulus E", f"{significant(design.modulus / 1e6)} MPa ({design.source})"),
        ("EI", f"{significant(1e6 * bending.min())} to {significant(1e6 * bending.max())} N mm^2"),
        ("k = EI / L", f"{significant(k.min())} to {significant(k.max())} N m"),
        ("mass", f"{1e3 * design.mass:.1f} g"),
        ("tip moves", f"{significant(1e3 * expected.compliance)} mm/N (small forces across)"),
        ("buckles at", f"{significant(expected.buckling)} N on the tip along the beam"),
        ("vibrates at", f"{', '.join(significant(f) for f in expected.frequency)} Hz"),
        ("weight lowers the tip", f"{1e3 * expected.sag:.1f} mm lying flat, {droop} on edge"),
    )
    table = Table(show_header=False, box=None)
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def bends_table(expected: designs.Expected) -> Table:
    title = "To turn the tip, by a push square to the beam at its tip"
    table = common.listing(title, "turn [deg]", "force [N]", "tip x [mm]", "tip y [mm]", "strain [%]")
    for bend in expected.bends:
        x, y = 1e3 * bend.tip
        turn, strain = f"{math.degrees(bend.turn):.0f}", f"{100 * bend.strain:.1f}"
        table.add_row(turn, significant(bend.force), f"{x:.1f}", f"{y:.1f}", strain)
    return table


@dataclass(frozen=True)
class TagOptions:
    """The tags of a sheet, and how it looks."""

    ids: str | None = option("--ids", None, metavar="IDS")
    size: float | None = option("--size-mm", None, within=(0.5, common.MOST))
    family: str | None = option("--family", None, metavar="FAMILY")
    rim: float = option("--rim-cells", 1.0, metavar="N", within=(1.0, common.MOST))
    page: Literal["a4", "letter"] = option("--page", "a4")


MOST_TAGS = 1000
RANGE = re.compile(r"(\d{1,6})(?:-(\d{1,6}))?")


def design(
    name: str | None = None,
    *,
    new: Path | None = None,
    model: Path | None = None,
    told: common.OwnFiles,
) -> None:
    if new is not None:
        common.say(f"Wrote {designs.write_design_template(new)}. Fill it in, then: onebend design {new}")
        return
    if name is None:
        raise MechanicsError("name a design: uniform, linear, quadratic, cubic, or a file (--new FILE writes one)")
    found = designs.find_design(name)
    expected = designs.expect(found)
    if model is not None:
        text = model_text(StoredModel(found.beam(), None, found.uncertain()), written_by=this_onebend())
        write_files({model: text}, overwrite=told.overwrite)
    common.answer(told, headed(DESIGN_FORMAT, **expected.as_dict()), lambda console: show_design(console, expected))


def tags(
    recording: Path | None = None,
    *,
    output: Path,
    asked: TagOptions,
    told: common.OwnFiles,
) -> None:
    known = None if recording is None else read_recording(recording)
    if (known is None) == (asked.ids is None):
        raise MechanicsError("say which tags: --ids 0-4, or a recording whose tags they are, not both")
    if known is not None and (asked.size is not None or asked.family is not None):
        raise MechanicsError("the recording says the tags' size and family: leave --size-mm and --family out")
    if known is None:
        numbers, side, named = parse_ids(asked.ids or ""), asked.size or 0.012, asked.family or FAMILIES[0]
    else:
        numbers = tuple(tag.id for tag in (*known.tags.on_base, *known.tags.on_beam))
        side, named = known.tags.size, known.tags.family
    sheet = Sheet(numbers, side, named, asked.rim, asked.page)
    pages = tag_pages(sheet)
    if known is not None:
        pages = (*pages, strip_page(known, page=asked.page, rim=asked.rim))
    written = files_of(output, pages, f"{named}, {1e3 * side:g} mm")
    write_files(written, overwrite=told.overwrite)
    if told.as_json:
        files = [str(path) for path in written]
        common.print_json(
            headed(TAGS_FORMAT, family=named, size_m=side, ids=list(numbers), pages=len(pages), files=files)
        )
    else:
        what = f"{len(numbers)} tag{'s' if len(numbers) > 1 else ''} of {named}, {1e3 * side:g} mm"
        common.say(f"Wrote {', '.join(map(str, written))}: {what}. Print at 100 % and measure both rulers.")


def parse_ids(text: str) -> tuple[int, ...]:
    """Tag ids from text such as `0-4,7`. Raises `MechanicsError`: any other text."""
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
