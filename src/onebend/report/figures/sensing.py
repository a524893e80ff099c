"""The picture of a force that a beam's shape told."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.learning.sensing.sensed import Sensed
from onebend.report.figures.style import BLUE, GREEN, INK, MUTED, ORANGE, blank, styled

_WIDE = 1.96  # sds of a 95 % band
_BEYOND = 1.6  # of the largest force: the axes show no more of a band


@styled
def sensing(found: Sensed) -> Figure:
    """Both components with their bands over time, and the log's; the place; the misfit of each frame."""
    figure, (x, y, place, misfit) = blank(8.0, 4, 1, sharex=True)
    for c, (axes, name, colour) in enumerate(((x, "x", BLUE), (y, "y", GREEN))):
        _component(axes, found, c, name, colour)
    x.set_title("Force from the shape, 95 % bands")
    x.legend(loc="upper left")
    low, high = found.place - _WIDE * found.place_sd, found.place + _WIDE * found.place_sd
    shown = found.touched
    place.fill_between(found.time, low, high, where=shown, color=ORANGE, alpha=0.25, lw=0.0)
    place.plot(found.time, np.where(shown, found.place, np.nan), color=ORANGE)
    place.plot(found.time, found.other_place, "x", color=MUTED, markersize=3)
    place.set(ylabel="place s", ylim=(0.0, 1.05))
    misfit.plot(found.time, found.chi2, ".", color=INK, markersize=2.5)
    misfit.set(ylabel="squared misfit", xlabel="time [s]", ylim=(0.0, None))
    for axes in (x, y, place, misfit):
        for one in found.contacts:
            axes.axvspan(one.begin, one.end, color=MUTED, alpha=0.08, lw=0.0)
    return figure


def _component(axes: Axes, found: Sensed, c: int, name: str, colour: str) -> None:
    middle, sd = found.force[:, c], np.sqrt(found.covariance[:, c, c])
    axes.fill_between(found.time, middle - _WIDE * sd, middle + _WIDE * sd, color=colour, alpha=0.25, lw=0.0)
    axes.plot(found.time, middle, color=colour, label="from the shape")
    axes.plot(found.time, found.logged[:, c], "--", color=INK, lw=1.0, label="log")
    axes.set_ylabel(f"force along {name} [N]")
    size = np.linalg.norm(found.force[found.touched], axis=1)
    if size.size and np.isfinite(size).any():
        most = _BEYOND * float(np.nanmax(size))
        axes.set_ylim(-most, most)
