"""Pages at exact size: a few kinds of marks in mm from the upper left corner, written as PDF or as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from xml.sax.saxutils import escape

import numpy as np

from onebend.errors import MechanicsError
from onebend.extras import package
from onebend.records import Array

if TYPE_CHECKING:  # an optional package
    from reportlab.pdfgen.canvas import Canvas

POINT = 25.4 / 72.0  # mm
PAGES = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}  # mm, upright
SUFFIXES = (".pdf", ".svg")


@dataclass(frozen=True)
class Fill:
    """Black polygons that are filled as one, so that no seam shows where they touch."""

    polygons: Array  # (n, c, 2) mm


@dataclass(frozen=True)
class Line:
    """A straight line."""

    start: tuple[float, float]  # mm
    end: tuple[float, float]  # mm
    width: float = 0.15  # mm


@dataclass(frozen=True)
class Text:
    """One line of text on a baseline."""

    at: tuple[float, float]  # mm, on the baseline
    text: str
    height: float = 2.5  # mm, of the font
    anchor: Literal["start", "middle"] = "start"


Mark = Fill | Line | Text


@dataclass(frozen=True)
class Page:
    """One page."""

    width: float  # mm
    height: float  # mm
    marks: tuple[Mark, ...]


def write_pages(path: Path | str, pages: Sequence[Page], title: str) -> tuple[Path, ...]:
    """Write pages as one PDF, or as an SVG a page (`name.svg`, `name-2.svg`, ...); the paths written.

    Raises:
        MechanicsError: a file name that ends in neither.
        OSError: the file cannot be written.
    """
    files = files_of(path, pages, title)
    for one, data in files.items():
        one.write_bytes(data)
    return tuple(files)


def files_of(path: Path | str, pages: Sequence[Page], title: str) -> dict[Path, bytes]:
    """What `write_pages` writes: the files' contents by their paths. Raises `MechanicsError` as it does."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise MechanicsError(f"{path}: sheets are written as {' or '.join(SUFFIXES)}. Name the file so.")
    if path.suffix.lower() == ".pdf":
        return {path: pdf(pages, title)}
    paths = (path if i == 0 else path.with_name(f"{path.stem}-{i + 1}{path.suffix}") for i in range(len(pages)))
    return {one: svg(page, title).encode("utf-8") for one, page in zip(paths, pages, strict=True)}


def pdf(pages: Sequence[Page], title: str) -> bytes:
    """The pages as a PDF document; the same pages give the same bytes."""
    canvas = package("reportlab.pdfgen.canvas", "make").Canvas("", invariant=1, initialFontName="Helvetica")
    canvas.setTitle(title)
    canvas.setCreator("onebend")
    for page in pages:
        canvas.setPageSize((page.width / POINT, page.height / POINT))
        for mark in page.marks:
            _draw(canvas, page, mark)
        canvas.showPage()
    return bytes(canvas.getpdfdata())


def _draw(canvas: Canvas, page: Page, mark: Mark) -> None:
    def at(x: float, y: float) -> tuple[float, float]:
        return float(x) / POINT, (page.height - float(y)) / POINT

    if isinstance(mark, Fill):
        path = canvas.beginPath()
        for polygon in mark.polygons:
            path.moveTo(*at(*polygon[0]))
            for corner in polygon[1:]:
                path.lineTo(*at(*corner))
            path.close()
        canvas.drawPath(path, stroke=0, fill=1)
    elif isinstance(mark, Line):
        canvas.setLineWidth(mark.width / POINT)
        canvas.line(*at(*mark.start), *at(*mark.end))
    else:
        canvas.setFont("Helvetica", mark.height / POINT)
        write = canvas.drawCentredString if mark.anchor == "middle" else canvas.drawString
        write(*at(*mark.at), mark.text)


def svg(page: Page, title: str) -> str:
    """The page as an SVG document; its units are mm."""
    rows = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width:g}mm" height="{page.height:g}mm" '
        f'viewBox="0 0 {page.width:g} {page.height:g}">',
        f"<title>{escape(title)}</title>",
        f'<rect width="{page.width:g}" height="{page.height:g}" fill="white"/>',
        *(_element(mark) for mark in page.marks),
        "</svg>",
        "",
    ]
    return "\n".join(rows)


def _element(mark: Mark) -> str:
    if isinstance(mark, Fill):
        outlines = ("M" + "L".join(f"{x:.9g},{y:.9g}" for x, y in np.round(p, 5)) + "Z" for p in mark.polygons)
        return f'<path fill="black" d="{"".join(outlines)}"/>'
    if isinstance(mark, Line):
        (x1, y1), (x2, y2) = mark.start, mark.end
        return (
            f'<line x1="{x1:.6g}" y1="{y1:.6g}" x2="{x2:.6g}" y2="{y2:.6g}" stroke="black" '
            f'stroke-width="{mark.width:g}"/>'
        )
    x, y = mark.at
    return (
        f'<text x="{x:.6g}" y="{y:.6g}" font-family="Helvetica, Arial, sans-serif" font-size="{mark.height:g}" '
        f'text-anchor="{mark.anchor}">{escape(mark.text)}</text>'
    )
