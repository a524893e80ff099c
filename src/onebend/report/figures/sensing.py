"""The picture of a force that a beam's shape told."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.learning.sensing.search import TOUCH
from onebend.learning.sensing.sensed import WIDE, Sensed
from onebend.records import Array
from onebend.report.figures.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, blank, styled

_FROM_PRIOR = 0.25  # of a component's prior variance that the data left: from there on it is shaded
_ROUND = np.linspace(0.0, 2.0 * np.pi, 90)
_ELLIPSES = 7  # frames of a contact that are drawn
_BEYOND = 1.6  # of the largest force: the axes show no more of a band


@styled
def sensing(found: Sensed) -> Figure:
    """Both components with their bands over time, and the log's; the moment and the second force, where they were asked
    for; the place; the misfit of each frame; when contacts begin and end."""
    more = (found.moment is not None) + 2 * (found.second is not None)
    figure, (x, y, *others, place, misfit) = blank(8.0 + 1.6 * more, 4 + more, 1, sharex=True)
    if found.moment is not None:
        _band(others[0], found.time, found.moment.moment, found.moment.sd, "moment [N m]")
    if found.second is not None:
        for c, axes in enumerate(others):
            sd = np.sqrt(found.second.covariance[:, c, c])
            _band(axes, found.time, found.second.force[:, c], sd, f"second along {'xy'[c]} [N]")
    for c, (axes, name, colour) in enumerate(((x, "x", BLUE), (y, "y", GREEN))):
        _component(axes, found, c, name, colour)
    x.set_title("Force from the shape, 95 % bands", loc="left")
    x.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    low, high = found.place - WIDE * found.place_sd, found.place + WIDE * found.place_sd
    shown = found.touched
    place.fill_between(found.time, low, high, where=shown, color=ORANGE, alpha=0.25, lw=0.0)
    place.plot(found.time, np.where(shown, found.place, np.nan), color=ORANGE)
    place.plot(found.time, found.other_place, "x", color=MUTED, markersize=3)
    place.set(ylabel="place s", ylim=(0.0, 1.05))
    misfit.plot(found.time, found.chi2, ".", color=INK, markersize=2.5)
    misfit.set(ylabel="squared misfit", xlabel="time [s]", ylim=(0.0, None))
    for axes in (x, y, *others, place, misfit):
        for one in found.contacts:
            axes.axvspan(one.first, one.last, color=MUTED, alpha=0.08, lw=0.0)
            for edge in (one.begin, one.end):
                if np.isfinite(edge.sd):
                    half = WIDE * edge.sd
                    axes.axvspan(edge.time - half, edge.time + half, color=ORANGE, alpha=0.2, lw=0.0)
    return figure


def _band(axes: Axes, time: Array, middle: Array, sd: Array, name: str) -> None:
    axes.fill_between(time, middle - WIDE * sd, middle + WIDE * sd, color=ORANGE, alpha=0.25, lw=0.0)
    axes.plot(time, middle, color=ORANGE)
    axes.set_ylabel(name)


def _component(axes: Axes, found: Sensed, c: int, name: str, colour: str) -> None:
    middle, sd = found.force[:, c], np.sqrt(found.covariance[:, c, c])
    weak = found.prior_share[:, c] > _FROM_PRIOR
    if weak.any():
        across, shaded = axes.get_xaxis_transform(), "not observable: prior"
        axes.fill_between(
            found.time, 0.0, 1.0, where=weak, transform=across, label=shaded, color=FAINT, alpha=0.7, lw=0.0
        )
    axes.fill_between(found.time, middle - WIDE * sd, middle + WIDE * sd, color=colour, alpha=0.25, lw=0.0)
    axes.plot(found.time, middle, color=colour, label="from the shape")
    if found.smoothed is not None:
        smooth, spread = found.smoothed.force[:, c], np.sqrt(found.smoothed.covariance[:, c, c])
        low, high = smooth - WIDE * spread, smooth + WIDE * spread
        axes.fill_between(found.time, low, high, color=ORANGE, alpha=0.35, lw=0.0)
        axes.plot(found.time, smooth, color=ORANGE, lw=1.0, label="smoothed")
    axes.plot(found.time, found.logged[:, c], "--", color=INK, lw=1.0, label="log")
    axes.set_ylabel(f"force along {name} [N]")
    size = np.linalg.norm(found.force[found.touched], axis=1)
    if size.size and np.isfinite(size).any():
        most = _BEYOND * float(np.nanmax(size))
        axes.set_ylim(-most, most)


@styled
def sensed_regions(found: Sensed) -> Figure:
    """The force in its plane: 95 % regions of some frames, the log's path, and the direction that is known least."""
    figure, (axes,) = blank(4.6)
    rows = np.flatnonzero(found.touched)
    chosen = rows[np.linspace(0, len(rows) - 1, min(_ELLIPSES, len(rows))).astype(int)]
    axes.plot(*found.logged.T, "--", color=INK, lw=1.0, label="log")
    axes.plot(*found.force[rows].T, color=BLUE, lw=1.0, label="from the shape")
    for i, t in enumerate(chosen):
        way = np.array([np.cos(found.weak_angle[t]), np.sin(found.weak_angle[t])])
        values, vectors = np.linalg.eigh(found.covariance[t])
        turned = vectors @ (np.sqrt(TOUCH * values)[:, None] * np.stack([np.cos(_ROUND), np.sin(_ROUND)]))
        ring = found.force[t][:, None] + turned
        axes.fill(*ring, color=BLUE, alpha=0.15, lw=0.8, label="95 % region" if i == 0 else None)
        reach = np.sqrt(TOUCH) * found.weak_sd[t]
        ends = np.stack([found.force[t] - reach * way, found.force[t] + reach * way])
        axes.plot(*ends.T, color=ORANGE, lw=1.0, label="where it is known least" if i == 0 else None)
    axes.plot(0.0, 0.0, "+", color=MUTED)
    axes.set(xlabel="force along x [N]", ylabel="force along y [N]", aspect="equal")
    axes.set_title("Where the force is known, and where not")
    axes.legend(loc="best")
    return figure
