"""A page for a person who runs no simulator: EI(s) with its band, E(s), how it was measured, and how it bends."""

from __future__ import annotations

import io
import math
import textwrap
import warnings
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from onebend.beam.section import modulus_band, one_modulus
from onebend.errors import MechanicsError
from onebend.export.sample import RodSample, axial_bands, damping_words, drawn_for_bands, relaxing_bands
from onebend.records import Array

A4 = (8.27, 11.69)  # inches
INK, BLUE, ORANGE, FAINT = "#1b2430", "#0072b2", "#d55e00", "#d5dae1"
_LOOK: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": FAINT,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "text.color": INK,
    "text.parse_math": False,  # names are text
}
_LINE = np.linspace(0.0, 1.0, 201)
_ROWS = np.linspace(0.0, 1.0, 11)
_WIDE, _LINES = 88, 5  # characters of a line of a fact, and lines


def sheet(rod: RodSample) -> bytes:
    """The PDF, without a date. Raises `ExportError`: k(s) is not positive somewhere."""
    with rc_context(_LOOK), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # a name in another script: boxes
        figure = Figure(figsize=A4)
        FigureCanvasPdf(figure)
        figure.text(0.08, 0.955, "Bending stiffness of a slender beam", fontsize=16, weight="bold")
        y = 0.925
        for name, text in _facts(rod):
            lines = textwrap.wrap(text, _WIDE, max_lines=_LINES, placeholder=" …") or [""]
            figure.text(0.08, y, name, fontsize=9, weight="bold", va="top")
            figure.text(0.24, y, "\n".join(lines), fontsize=9, va="top", linespacing=1.25)
            y -= 0.005 + 0.0145 * len(lines)
        modulus = rod.section is not None
        top = y - 0.035
        height = 0.5 * (top - 0.375) if modulus else top - 0.30
        _draw_stiffness(figure.add_axes((0.12, top - height, 0.80, height)), rod)
        if modulus:
            _draw_modulus(figure.add_axes((0.12, 0.30, 0.80, height)), rod)
        _draw_shapes(figure.add_axes((0.12, 0.055, 0.36, 0.18)), rod)
        _draw_table(figure.add_axes((0.54, 0.04, 0.40, 0.215)), rod)
        stream = io.BytesIO()
        figure.savefig(stream, format="pdf", metadata={"CreationDate": None, "Title": "Bending stiffness"})
    return stream.getvalue()


def _facts(rod: RodSample) -> list[tuple[str, str]]:
    """Names and texts of the head."""
    beam, k = rod.beam, rod.stiffness(_LINE)
    weight = beam.length * float(np.trapezoid(np.asarray(beam.mass_per_length(_LINE)), _LINE))
    weight += sum(one.mass for one in beam.masses)
    facts = [("length", f"{1e3 * beam.length:.4g} mm from the clamp to the tip")]
    facts += [("mass", f"{1e3 * weight:.3g} g")] if weight > 0.0 else []
    low, high = beam.length * float(k.min()), beam.length * float(k.max())
    facts += [("EI", f"{low:.3g} to {high:.3g} N m²")]
    one = one_modulus(rod.uncertain or beam.stiffness, beam.length, rod.section)
    if one is not None:
        facts += [("E", f"{_pascal(one[0])} as one number; 95 %: {_pascal(one[1])} to {_pascal(one[2])}")]
    draws = drawn_for_bands(rod) if rod.stretches or rod.relaxation else ()
    if rod.stretches:
        stretch, shear = rod.axial(_LINE)
        (low, high), _ = axial_bands(rod, draws, _LINE).values()
        end = f"to {_digits(high.max())} N" if np.isfinite(high).all() else "N or more"  # it may not stretch at all
        band = f"; 95 %: {_digits(low.min())} {end}" if np.isfinite(low).all() else ""
        facts += [("EA", f"{_digits(stretch.min())} to {_digits(stretch.max())} N{band}")]
        facts += [("kGA", f"{_digits(shear.min())} to {_digits(shear.max())} N")]
    facts += [("damping", damping_words(rod))] if rod.damping_time is not None else []
    bands = relaxing_bands(rod, draws) or ((math.nan, math.nan),) * len(rod.relaxation)
    for part, (low_share, high_share) in zip(rod.relaxation, bands, strict=True):
        said = f"; 95 %: {100 * low_share:.2g} to {100 * high_share:.2g} %" if math.isfinite(low_share) else ""
        facts += [("relaxes", f"{100 * part.share:.2g} % within {part.time:.3g} s{said}")]
    return [*facts, *rod.told]


def _draw_stiffness(axes: Axes, rod: RodSample) -> None:
    length = rod.beam.length
    edges: tuple[Array, Array] | None = None
    if rod.uncertain is not None:
        band = rod.uncertain.band(_LINE)
        edges = length * band.low, length * band.high
        unknown = np.where(band.identified, np.nan, length * band.k)
        axes.plot(1e3 * length * _LINE, unknown, color=ORANGE, lw=4, alpha=0.6, label="not identified by the data")
        if not np.all(band.identified):
            axes.legend(loc="upper center")
    said = ", with its 95 % band" if rod.uncertain is not None else " (no band was learned)"
    _draw_along(axes, length, f"EI(s) [N m²]{said}", BLUE, length * rod.stiffness(_LINE), edges)


def _draw_modulus(axes: Axes, rod: RodSample) -> None:
    assert rod.section is not None
    found = modulus_band(rod.uncertain or rod.beam.stiffness, rod.beam.length, rod.section, _LINE)
    values, low, high = (1e-6 * one for one in (found.modulus, found.low, found.high))
    _draw_along(
        axes, rod.beam.length, "Young's modulus E(s) [MPa], from the stated section", ORANGE, values, (low, high)
    )


def _draw_along(
    axes: Axes, length: float, title: str, colour: str, values: Array, edges: tuple[Array, Array] | None
) -> None:
    """Values along the beam with their band, if any. The axis shows all of it, up to three times the largest value."""
    places = 1e3 * length * _LINE
    if edges is not None:
        axes.fill_between(places, *edges, color=colour, alpha=0.2, lw=0)
    axes.plot(places, values, color=colour)
    axes.set(title=title, xlabel="from the clamp [mm]", xlim=(0.0, 1e3 * length))
    axes.set_ylim(0.0, min(axes.get_ylim()[1], 3.0 * float(np.nanmax(values))))


def _draw_shapes(axes: Axes, rod: RodSample) -> None:
    """At rest, and under the largest recorded force."""
    rest = 1e3 * rod.beam.equilibrium((0.0, 0.0)).xy(_LINE)
    axes.plot(*rest.T, color=INK, lw=2)
    title = "At rest"
    if rod.push is not None:
        force, at_s = rod.push
        try:
            bent = 1e3 * rod.beam.equilibrium(force, at_s).xy(_LINE)
        except MechanicsError:
            bent = None
        if bent is not None:
            axes.plot(*bent.T, color=BLUE, lw=2)
            place = bent[round(200 * at_s)]
            way = 0.25e3 * rod.beam.length * np.array(force) / math.hypot(*force)
            axes.annotate("", place, place - way, arrowprops={"arrowstyle": "->", "color": ORANGE})
            title = f"At rest, and under {math.hypot(*force):.3g} N"
    axes.plot([0.0], [0.0], "s", color=INK)
    axes.set(title=title, xlabel="x [mm]", ylabel="y [mm]")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_table(axes: Axes, rod: RodSample) -> None:
    """EI and its band at eleven places."""
    axes.axis("off")
    length = rod.beam.length
    k = length * rod.stiffness(_ROWS)
    band = None if rod.uncertain is None else rod.uncertain.band(_ROWS)
    heads = ["mm", "EI [N m²]", *(["95 % from", "to"] if band is not None else [])]
    rows = [[f"{1e3 * length * s:.4g}", f"{k[i]:#.3g}"] for i, s in enumerate(_ROWS)]
    if band is not None:
        rows = [[*row, f"{length * band.low[i]:#.3g}", f"{length * band.high[i]:#.3g}"] for i, row in enumerate(rows)]
    table = axes.table(rows, colLabels=heads, cellLoc="right", edges="horizontal", bbox=Bbox.unit())
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for cell in table.get_celld().values():
        cell.set_edgecolor(FAINT)


def _digits(value: float) -> str:
    """Three digits, thousands written out."""
    return f"{float(f'{value:.3g}'):g}"


def _pascal(value: float) -> str:
    return f"{1e-6 * value:.3g} MPa"
