"""What `onebend design` and `onebend mould` say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.beam.profiles.uncertain import half_width
from onebend.errors import reference
from onebend.lab.expected import DENSE, Expected
from onebend.lab.fabrication.mould import Mould, PrintedPart
from onebend.report.wording import significant


def show_design(console: Console, expected: Expected) -> None:
    """The figures of a design."""
    design = expected.design
    console.print(f"[bold]{escape(design.name)}[/]", highlight=False)
    console.print(design_table(expected))
    console.print(bends_table(expected))
    if design.modulus_log_sd > 0.0:
        factor = math.exp(half_width(design.modulus_log_sd))
        console.print(
            f"E is known to a factor of {factor:.2g} either way (95 %), and so are all forces, k and, to its root, "
            "the frequencies. Turns and shapes do not depend on it.",
            highlight=False,
        )
    for remark in design.remarks:
        console.print(f"[yellow]![/] {escape(remark.text)}\n[dim]{reference(remark.about)}[/]", highlight=False)


def design_table(expected: Expected) -> Table:
    """What the beam is, and what it does by itself."""
    design = expected.design
    width, bending = 1e3 * np.asarray(design.width(DENSE)), design.bending(DENSE)
    rows = (
        ("length, depth", f"{1e3 * design.length:g} mm, {1e3 * design.depth:g} mm"),
        ("width", f"{width.min():.4g} to {width.max():.4g} mm, narrowest at s = {DENSE[width.argmin()]:.2f}"),
        ("modulus E", f"{significant(design.modulus / 1e6)} MPa ({design.source})"),
        ("EI", f"{significant(1e6 * bending.min())} to {significant(1e6 * bending.max())} N mm^2"),
        (
            "k = EI / L",
            f"{significant(bending.min() / design.length)} to {significant(bending.max() / design.length)} N m",
        ),
        ("mass", f"{1e3 * design.mass:.1f} g"),
        ("tip moves", f"{significant(1e3 * expected.compliance)} mm/N (small forces across)"),
        ("buckles at", f"{significant(expected.buckling)} N on the tip along the beam"),
        ("vibrates at", f"{', '.join(significant(f) for f in expected.frequency)} Hz"),
        ("weight lowers the tip", f"{1e3 * expected.sag:.1f} mm lying flat, {_droop(expected)} on edge"),
    )
    table = Table(show_header=False, box=None)
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def bends_table(expected: Expected) -> Table:
    """Forces for turns of the tip."""
    table = Table(title="To turn the tip, by a push square to the beam at its tip", title_justify="left", box=None)
    for name in ("turn \\[deg]", "force \\[N]", "tip x \\[mm]", "tip y \\[mm]", "strain \\[%]"):
        table.add_column(name, justify="right")
    for bend in expected.bends:
        x, y = 1e3 * bend.tip
        table.add_row(
            f"{math.degrees(bend.turn):.0f}",
            significant(bend.force),
            f"{x:.1f}",
            f"{y:.1f}",
            f"{100 * bend.strain:.1f}",
        )
    return table


def show_parts(console: Console, made: Mould, parts: Sequence[PrintedPart], out: Path) -> None:
    """The parts and what to pour."""
    table = Table(title=f"Parts of {escape(made.design.name)}", title_justify="left", box=None)
    for name in ("part", "size \\[mm]", "plastic \\[cm^3]"):
        table.add_column(name, justify="left" if name == "part" else "right")
    for part in parts:
        size = " x ".join(f"{extent:.1f}" for extent in part.mesh.extents)
        table.add_row(part.name, size, f"{part.mesh.volume / 1e3:.1f}")
    console.print(table)
    console.print(
        f"Pour {1e6 * made.volume:.1f} ml ({1e3 * made.pour:.1f} g) of silicone. Files are in {escape(str(out))}.",
        highlight=False,
    )


def _droop(expected: Expected) -> str:
    return f"{1e3 * expected.droop:.1f} mm" if math.isfinite(expected.droop) else "no equilibrium"
