"""k(s) drawn with block characters, with numbers below."""

from __future__ import annotations

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.report.wording import significant

BLOCKS = " ▁▂▃▄▅▆▇█"


def band_plot(uncertain: UncertainStiffness, *, columns: int = 61, rows: int = 12) -> RenderableType:
    """k(s) as a line in its 95 % band; grey where it is not identified. The band may leave the picture there."""
    s = np.linspace(0.0, 1.0, columns)
    band = uncertain.band(s)
    seen = band.identified if band.identified.any() else np.ones(columns, dtype=bool)
    top = 1.05 * max(float(np.max(band.high[seen])), min(float(np.max(band.high)), 1.5 * float(np.max(band.k))))
    lines = []
    for row in range(rows - 1, -1, -1):
        low, high = top * row / rows, top * (row + 1) / rows
        text = Text(_mark(row, rows, top), "dim")
        for i in range(columns):
            inside = band.high[i] > low and band.low[i] < high
            cell = "━" if low <= band.k[i] < high else "░" if inside else " "
            text.append(cell, "blue" if band.identified[i] else "bright_black")
        lines.append(text)
    heading = Text("Bending stiffness k(s) = EI / L [N m], with its 95 % band (grey: not identified)", "italic")
    return Group(heading, *lines, *_axis(columns))


def stiffness_plot(beam: Beam, *, columns: int = 61, rows: int = 8) -> RenderableType:
    """k(s) as an area of block characters, with numbers at eleven places below."""
    k = beam.stiffness(np.linspace(0.0, 1.0, columns))
    top = max(float(k.max()), 0.0)
    level = np.zeros(columns) if top == 0.0 else np.clip(k / top, 0.0, 1.0) * rows * 8
    lines = []
    for row in range(rows - 1, -1, -1):
        cells = np.clip(np.round(level - 8 * row), 0, 8).astype(int)
        lines.append(Text(_mark(row, rows, top), "dim") + Text("".join(BLOCKS[c] for c in cells), "blue"))
    heading = Text("Bending stiffness k(s) = EI / L [N m]", "italic")
    return Group(heading, *lines, *_axis(columns), _numbers(beam))


def _mark(row: int, rows: int, top: float) -> str:
    return f"{significant(top):>8} ┤" if row == rows - 1 else f"{'0':>8} ┤" if row == 0 else " " * 9 + "│"


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
