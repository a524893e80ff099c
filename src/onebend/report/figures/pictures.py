"""Pictures one by one: one that cannot be drawn costs itself, and its reason is kept."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from onebend.escaping import one_line
from onebend.progress import Progress, Silent, track

if TYPE_CHECKING:  # here and in `draw`: Matplotlib is for pictures alone
    from matplotlib.figure import Figure

    from onebend.report.figures.film import FilmStrip

Draw: TypeAlias = "Callable[[], Figure | None]"
LONGEST = 200  # characters of a reason


@dataclass(frozen=True)
class Pictures:
    """What was drawn, and what could not be."""

    drawn: dict[str, bytes] = field(default_factory=dict)  # PNGs by name
    failed: dict[str, str] = field(default_factory=dict)  # why, by name
    film: FilmStrip | None = None  # frames to look through on the page

    def write(self, folder: Path) -> None:
        """Write each as `NAME.png`."""
        for name, png in self.drawn.items():
            (folder / f"{name}.png").write_bytes(png)


def draw(wanted: Mapping[str, Draw], progress: Progress = Silent()) -> Pictures:
    """All that can be drawn; None from a function: there is nothing to show."""
    from onebend.report.figures.style import png_of

    pictures = Pictures()
    for name, make in track(progress, "drawing the figures", list(wanted.items()), len(wanted)):
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Glyph .* missing")  # a name in another script: boxes
                figure = make()
                if figure is not None:
                    pictures.drawn[name] = png_of(figure)
        except Exception as error:  # whatever it is, the results do not depend on it
            pictures.failed[name] = reason_of(error)
    return pictures


def reason_of(error: Exception) -> str:
    """Why a picture could not be drawn, on one line."""
    return one_line(f"{type(error).__name__}: {error}")[:LONGEST]
