"""k(s) drawn with block characters, with numbers below."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import Band, UncertainStiffness
from onebend.records import Array, BoolArray
from onebend.report.wording import significant

BLOCKS = " ▁▂▃▄▅▆▇█"
MOST = 4.0  # times k: a band that says nothing may leave the picture
CURVE, BAND = ("-", "━"), ("·", "░")  # where k is not identified, and where it is


def band_plot(uncertain: UncertainStiffness, *, columns: int = 61, rows: int = 12, log: bool = False) -> RenderableType:
    """k(s) as a line in its 95 % band; thinner and grey where it is not identified.

    What is known sets the axis, the rest may leave the picture. `log`: a logarithmic axis.
    """
    s = np.linspace(0.0, 1.0, columns)
    band = uncertain.band(s)
    edges = _edges(band, uncertain.best_known(s), rows, log=log)
    lines = []
    for row in range(rows - 1, -1, -1):
        low, high = edges[row], edges[row + 1]
        text = Text(_mark(row, rows, edges), "dim")
        for i in range(columns):
            known = bool(band.identified[i])
            inside = band.high[i] > low and band.low[i] < high
            cell = CURVE[known] if low <= band.k[i] < high else BAND[known] if inside else " "
            text.append(cell, "blue" if known else "bright_black")
        lines.append(text)
    unknown = "" if band.identified.all() else "; - and (): not identified"
    heading = Text(f"k(s) = EI / L [N m], with its 95 % band{unknown}", "italic")
    return Group(heading, *lines, _axis(columns)[0])


def _edges(band: Band, shown: BoolArray, rows: int, *, log: bool) -> Array:
    """(rows + 1,) N m, where the rows of a plot begin and end, the lowest first."""
    top = min(1.05 * float(np.max(band.high[shown])), MOST * float(np.max(band.k[shown])))
    if log:
        low = max(float(np.min(band.low[shown])) / 1.05, float(np.min(band.k[shown])) / MOST)
        return np.asarray(np.geomspace(low, top, rows + 1))
    return np.linspace(0.0, top, rows + 1)


def stiffness_plot(beam: Beam, *, columns: int = 61, rows: int = 8) -> RenderableType:
    """k(s) as an area of block characters, with numbers at eleven places below."""
    k = beam.stiffness(np.linspace(0.0, 1.0, columns))
    top = max(float(k.max()), 0.0)
    edges = np.linspace(0.0, top, rows + 1)
    level = np.zeros(columns) if top == 0.0 else np.clip(k / top, 0.0, 1.0) * rows * 8
    lines = []
    for row in range(rows - 1, -1, -1):
        cells = np.clip(np.round(level - 8 * row), 0, 8).astype(int)
        lines.append(Text(_mark(row, rows, edges), "dim") + Text("".join(BLOCKS[c] for c in cells), "blue"))
    heading = Text("Bending stiffness k(s) = EI / L [N m]", "italic")
    return Group(heading, *lines, *_axis(columns), _numbers(beam))


def _mark(row: int, rows: int, edges: Array) -> str:
    if row not in (0, rows - 1):
        return " " * 9 + "│"
    return f"{significant(float(edges[-1] if row else edges[0])):>8} ┤"


def _axis(columns: int) -> tuple[Text, Text]:
    ends = " " * 10 + "s = 0 (clamp)" + " " * (columns - 24) + "s = 1 (tip)"
    return Text(" " * 9 + "└" + "─" * columns, "dim"), Text(ends, "dim")


def _numbers(beam: Beam) -> Table:
    """k at eleven places, in two lines."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1, 0, 0))
    s = np.linspace(0.0, 1.0, 11)
    table.add_row("[dim]s[/]", *(f"[dim]{place:.1f}[/]" for place in s))
    table.add_row("k", *(significant(k) for k in beam.stiffness(s)))
    return table
