"""Sheets of AprilTags to print at exact size, with rulers to check the print.

Tags stand upright: the printed right-hand side, as in a recording's `turn_deg`, is the page's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise, product
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from onebend.errors import MechanicsError
from onebend.recording.entries import FAMILIES, Recording, TagEntry
from onebend.recording.tag_finder import PrintedTag, printed_tag
from onebend.records import Array, rotated

# Pages, drawn in mm from the upper left corner, as PDF or SVG.

INCH, POINT = 25.4, 25.4 / 72.0  # mm
PAGES = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}  # mm, upright
SUFFIXES = (".pdf", ".svg")
Place = tuple[float, float]  # mm


def blank_page(width: float, height: float) -> Figure:
    """An empty page of this size [mm]."""
    figure = Figure(figsize=(width / INCH, height / INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, width), ylim=(height, 0.0))
    axes.set_axis_off()
    return figure


def _fill(page: Figure, polygons: Array) -> None:
    """Black polygons (n, c, 2) mm, filled as one, so that no seam shows."""
    outline = Outline.make_compound_path_from_polys(polygons)
    page.axes[0].add_patch(PathPatch(outline, facecolor="black", linewidth=0.0))


def _line(page: Figure, start: Place, end: Place, width: float = 0.15) -> None:
    """`width`: mm."""
    x, y = zip(start, end, strict=True)
    page.axes[0].add_line(Line2D(x, y, linewidth=width / POINT, color="black", solid_capstyle="butt"))


def _text(page: Figure, at: Place, text: str, height: float = 2.5, align: Literal["left", "center"] = "left") -> None:
    """`at`: on the baseline; `height` of the font: mm."""
    page.axes[0].text(*at, text, fontsize=height / POINT, ha=align, va="baseline", parse_math=False)


def write_pages(path: Path | str, pages: Sequence[Figure], title: str) -> tuple[Path, ...]:
    """Write the files of `files_of`; returns their paths. Raises `OSError`: a file cannot be written."""
    files = files_of(path, pages, title)
    for one, data in files.items():
        one.write_bytes(data)
    return tuple(files)


def files_of(path: Path | str, pages: Sequence[Figure], title: str) -> dict[Path, bytes]:
    """Contents of one PDF, or of one SVG per page (`name.svg`, `name-2.svg`, ...), by path. Equal pages give equal
    bytes. Raises `MechanicsError`: another file ending."""
    path, metadata = Path(path), {"Title": title, "Creator": "onebend"}
    if path.suffix.lower() not in SUFFIXES:
        raise MechanicsError(f"{path}: sheets are written as {' or '.join(SUFFIXES)}. Name the file so.")
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "onebend", "pdf.fonttype": 42}):
        if path.suffix.lower() == ".svg":
            names = (path if i == 0 else path.with_name(f"{path.stem}-{i + 1}{path.suffix}") for i in range(len(pages)))
            return {one: _svg(page, metadata) for one, page in zip(names, pages, strict=True)}
        stream = BytesIO()
        with PdfPages(stream, metadata={**metadata, "CreationDate": None}) as document:
            for page in pages:
                document.savefig(page)
        return {path: stream.getvalue()}


def _svg(page: Figure, metadata: dict[str, str]) -> bytes:
    stream = BytesIO()
    page.savefig(stream, format="svg", metadata={**metadata, "Date": None})
    return stream.getvalue()


LEFT, RIGHT, TOP, BOTTOM = 20.0, 10.0, 24.0, 28.0  # mm around the tags; rulers to the left and below
GAP = 8.0  # mm between white rims: cut marks and a label
CUT, AWAY = 2.0, 0.5  # mm, length of a cut mark and its distance from the rim
RULER = 100.0  # mm
LEAST_RIM = 1.0  # cells


@dataclass(frozen=True)
class Sheet:
    ids: tuple[int, ...]
    size: float = 0.012  # m, side of the black square (`size_m` of a recording)
    family: str = FAMILIES[0]
    rim: float = 1.0  # cells of white around the black square, at least 1
    page: str = "a4"

    def __post_init__(self) -> None:
        if not self.ids:
            raise MechanicsError("a sheet needs at least one tag")
        doubles = sorted({tag for tag in self.ids if self.ids.count(tag) > 1})
        if doubles:
            raise MechanicsError(f"tag {doubles[0]} is asked for twice, but each tag of a recording has its own number")
        if not (math.isfinite(self.size) and self.size > 0.0):
            raise MechanicsError(f"a tag's size must be positive, got {self.size} m")
        if not (math.isfinite(self.rim) and self.rim >= LEAST_RIM):
            raise MechanicsError(f"a tag needs a white rim of at least {LEAST_RIM:g} cell, got {self.rim}")
        if self.page not in PAGES:
            raise MechanicsError(f"no page is named {self.page!r}. Take one of {', '.join(PAGES)}.")

    def outer(self, tag: PrintedTag) -> float:
        """mm, side of the cut-out square."""
        return 1e3 * self.size / tag.border * max(len(tag.cells), tag.border + 2.0 * self.rim)


def tag_pages(sheet: Sheet) -> tuple[Figure, ...]:
    """The tags in rows, upright, on as many pages as needed. Raises `MechanicsError`: a tag larger than the page.
    Raises `RecordingError`: unknown family or id."""
    tags = [printed_tag(tag_id, sheet.family) for tag_id in sheet.ids]
    width, height = PAGES[sheet.page]
    pitch = sheet.outer(tags[0]) + GAP
    across, down = int((width - LEFT - RIGHT) // pitch), int((height - TOP - BOTTOM) // pitch)
    if across < 1 or down < 1:
        most = min(width - LEFT - RIGHT, height - TOP - BOTTOM) - GAP
        raise MechanicsError(
            f"a tag of {1e3 * sheet.size:g} mm with its rim is {pitch - GAP:.1f} mm wide, but {sheet.page} has room "
            f"for {most:.1f} mm. Ask for smaller tags"
        )
    pages = []
    for first in range(0, len(tags), across * down):
        page = blank_page(width, height)
        _furnish(page, sheet, height)
        for place, tag in enumerate(tags[first : first + across * down]):
            x = LEFT + pitch * (place % across + 0.5)
            y = TOP + pitch * (place // across + 0.5)
            _put_tag(page, sheet, tag, (x, y))
        pages.append(page)
    return tuple(pages)


def strip_page(recording: Recording, *, page: str = "a4", rim: float = 1.0) -> Figure:
    """A page with a recording's tags at their places along the beam, to lay the beam on; landscape if it is long. Of
    those on the base it has the first: others may stand anywhere on the bench.
    Raises `MechanicsError`: the beam is longer than the page, or tags overlap. Raises `RecordingError`: unknown id."""
    entries = (*recording.tags.on_base[:1], *recording.tags.on_beam)
    family = recording.tags.family
    sheet = Sheet(tuple(entry.id for entry in entries), recording.tags.size, family, rim, page)
    tags = [printed_tag(entry.id, family) for entry in entries]
    length, outer = 1e3 * recording.beam.length, sheet.outer(tags[0])
    _refuse_overlap(entries, length, outer)
    upright = PAGES[page]
    size = upright if length + outer + LEFT + RIGHT <= upright[0] else upright[::-1]
    if length + outer + LEFT + RIGHT > size[0]:
        raise MechanicsError(
            f"a beam of {length:.0f} mm with its tags does not fit on {page} ({size[0]:.0f} mm lying). Print the tags "
            "alone (--ids) and measure their places"
        )
    left, y = 0.5 * (size[0] - length) + 0.5 * (LEFT - RIGHT), 0.5 * size[1]
    strip = blank_page(*size)
    _furnish(strip, sheet, size[1], f"places along the beam of {recording.name}, {length:g} mm from clamp to tip")
    for tag, entry in zip(tags, entries, strict=True):
        x = left + entry.s * length
        _fill(strip, tag_polygons(tag, sheet.size, (x, y), entry.turn))
        for side in (-1.0, 1.0):
            near = y + side * (0.5 * outer * (abs(math.cos(entry.turn)) + abs(math.sin(entry.turn))) + AWAY)
            _line(strip, (x, near), (x, near + side * 4.0))
        _text(strip, (x, y + 0.75 * outer + 9.0), f"{entry.id}: s = {entry.s:.4g}", 2.2, "center")
    for x, name in ((left, "clamp"), (left + length, "tip")):
        _line(strip, (x, y - outer - 14.0), (x, y - outer - 6.0))
        _text(strip, (x, y - outer - 15.0), name, 2.5, "center")
    _line(strip, (left, y - outer - 10.0), (left + length, y - outer - 10.0))
    return strip


def _refuse_overlap(entries: Sequence[TagEntry], length: float, outer: float) -> None:
    ordered = sorted(entries, key=lambda entry: entry.s)
    for one, other in pairwise(ordered):
        if (other.s - one.s) * length < outer:
            raise MechanicsError(
                f"tags {one.id} and {other.id} are {(other.s - one.s) * length:.1f} mm apart, but {outer:.1f} mm wide "
                "with their rims. Take smaller tags, or other places"
            )


def tag_polygons(tag: PrintedTag, size: float, centre: tuple[float, float], turn: float = 0.0) -> Array:
    """(n, 4, 2) mm: black runs of a tag of `size` m about `centre` mm, turned counter-clockwise by `turn` rad."""
    cell, half = 1e3 * size / tag.border, 0.5 * len(tag.cells)
    flat = cell * (tag.ink - half)
    return np.asarray(rotated(flat, -turn) + np.array(centre))  # y runs down the page


def _put_tag(page: Figure, sheet: Sheet, tag: PrintedTag, centre: Place) -> None:
    """A tag with its cut marks and its number."""
    x, y = centre
    half = 0.5 * sheet.outer(tag)
    _fill(page, tag_polygons(tag, sheet.size, centre))
    for right, low in product((-1.0, 1.0), repeat=2):
        corner_x, corner_y = x + right * half, y + low * half
        _line(page, (corner_x + right * AWAY, corner_y), (corner_x + right * (AWAY + CUT), corner_y))
        _line(page, (corner_x, corner_y + low * AWAY), (corner_x, corner_y + low * (AWAY + CUT)))
    _text(page, (x, y + half + 3.2), f"{tag.id}", 2.5, "center")


def _furnish(page: Figure, sheet: Sheet, height: float, what: str = "cut along the marks") -> None:
    """Heading and two rulers, on a page of this height [mm]."""
    base = height - 14.0
    title = f"{len(sheet.ids)} tags of {sheet.family}; black squares {1e3 * sheet.size:g} mm wide; {what}"
    _text(page, (LEFT, 10.0), title, 3.0)
    for y, text in (
        (14.5, "Print at 100 % (actual size, no fitting to the page). The right-hand side of this page is the"),
        (18.0, "tags' right-hand side: towards the beam's tip where turn_deg = 0."),
        (base + 6.5, f"Both lines must be {RULER:g} mm long. If both are M mm instead, write"),
        (base + 10.0, f"size_m = {sheet.size:g} * M / {RULER:g}; if they differ, use another printer."),
    ):
        _text(page, (LEFT, y), text)
    _ruler(page, (LEFT, base), (1.0, 0.0))
    _ruler(page, (11.0, height - 28.0), (0.0, -1.0))


def _ruler(page: Figure, start: Place, along: Place) -> None:
    """A ruler of `RULER` mm; ticks point to the left of its direction."""
    (x, y), (dx, dy) = start, along
    _line(page, start, (x + RULER * dx, y + RULER * dy))
    for i in range(int(RULER) + 1):
        tall = 4.0 if i % 10 == 0 else 3.0 if i % 5 == 0 else 1.8
        foot = (x + i * dx, y + i * dy)
        _line(page, foot, (foot[0] + tall * dy, foot[1] - tall * dx), 0.1)
        if i % 10 == 0:
            _text(page, (foot[0] + 6.5 * dy, foot[1] - 5.0 * dx - 0.7 * dy), f"{i}", 2.0, "center")
