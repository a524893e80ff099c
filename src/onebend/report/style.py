"""One look for all figures: colour-blind safe colours, quiet axes, no global state of pyplot."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, ParamSpec

import numpy as np
from matplotlib import colormaps, rc_context, rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

DPI = 150
PACKING = 3  # of 9 for PNGs: twice as fast as the usual 6, a tenth larger
WIDTH = 7.2  # inches: 1080 px, the page's width
INK = "#1b2430"
MUTED = "#667085"
FAINT = "#d5dae1"
BLUE, ORANGE, GREEN, PINK = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
# Okabe and Ito's colours, dark ones first; symbols differ too, for print in grey.
MARKER_COLOURS = (BLUE, ORANGE, GREEN, PINK, "#56b4e9", "#e69f00", "#000000")
_LIGHTEST = 0.9  # of the colour map, visible on white
MARKER_SHAPES = ("o", "s", "^", "D", "v", "P", "X")

_LOOK = rc_params_from_file(Path(__file__).with_name("look.mplstyle"), use_default_template=False)

P = ParamSpec("P")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draws with this look, leaving the caller's settings."""

    @functools.wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with rc_context(_LOOK):
            return draw(*args, **kwargs)

    return inside


def blank(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure as wide as the page, axes row by row."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, list(np.ravel(axes))


def png_of(figure: Figure, *, software: str | None = None) -> bytes:
    """PNG without a date, laid out and drawn once (`Figure.savefig` draws twice)."""
    with rc_context(_LOOK):
        stream = io.BytesIO()
        if (engine := figure.get_layout_engine()) is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        canvas = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
        packed = {"compress_level": PACKING}
        canvas.print_png(stream, metadata={"Software": software}, pil_kwargs=packed)  # type: ignore[no-untyped-call]
    return stream.getvalue()


def plane(axes: Axes, title: str, *, adjustable: Literal["box", "datalim"] = "box") -> None:
    """The plane of bending to scale in mm, with the clamp as a square."""
    axes.plot([0.0], [0.0], "s", color=INK, markersize=7, zorder=6)
    axes.grid(color=FAINT)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title=title)
    axes.set_aspect("equal", adjustable=adjustable)


def hue_of(i: int, count: int = 0) -> str:
    """Colour of the i-th marker; a colour map if there are many."""
    if count <= len(MARKER_COLOURS):
        return MARKER_COLOURS[i % len(MARKER_COLOURS)]
    return to_hex(colormaps["viridis"](_LIGHTEST * i / (count - 1)))


def named(count: int) -> frozenset[int]:
    """Markers that a legend names: all, or as many as colours, evenly spread."""
    most = len(MARKER_COLOURS)
    return frozenset(range(count) if count <= most else np.rint(np.linspace(0, count - 1, most)).astype(int).tolist())


def shape(i: int) -> str:
    return MARKER_SHAPES[i % len(MARKER_SHAPES)]
