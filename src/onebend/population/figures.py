"""The pictures of a population."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from onebend.escaping import figure_text
from onebend.population.needed import NUMBERS
from onebend.population.outcome import PopulationOutcome
from onebend.progress import Progress, Silent
from onebend.report.figures.pictures import Draw, Pictures, draw
from onebend.report.figures.style import INK, MUTED, ORANGE, blank, colour, styled

A_ROW = 3  # panels
MOST = 24  # groups that have a panel


def draw_figures(outcome: PopulationOutcome, *, progress: Progress = Silent()) -> Pictures:
    """By name."""
    wanted: dict[str, Draw] = {"means": partial(means, outcome), "groups": partial(panels, outcome)}
    if outcome.pairs:
        wanted["ratios"] = partial(ratios, outcome)
    wanted["needed"] = partial(bands, outcome)
    return draw(wanted, progress)


@styled
def means(outcome: PopulationOutcome) -> Figure:
    """The groups' means with their bands, and the tolerance."""
    figure, (axes,) = blank(3.8)
    s, count = outcome.named.trial.s, min(len(outcome.named.groups), MOST)
    for i in range(count):
        low, mean, high = (np.exp(one[i]) for one in (outcome.means.low, outcome.means.mean, outcome.means.high))
        axes.fill_between(s, low, high, color=colour(i, count), alpha=0.2, linewidth=0)
        axes.plot(s, mean, color=colour(i, count), label=figure_text(outcome.named.groups[i] or "all"))
    if (band := outcome.setting.tolerance) is not None:
        for edge in (band.low, band.high):
            axes.plot(band.s, edge, color=INK, linestyle="--", linewidth=1.2)
    axes.set(xlabel="s", ylabel="k(s) [N m]", yscale="log")
    axes.legend(ncols=4)
    return figure


@styled
def panels(outcome: PopulationOutcome) -> Figure:
    """Each group: every object, those unlike the others, and the mean."""
    trial, count = outcome.named.trial, min(len(outcome.named.groups), MOST)
    rows = -(-count // A_ROW)
    figure, axes = blank(2.4 * rows, rows, min(count, A_ROW), sharex=True, sharey=True)
    for i, panel in enumerate(axes):
        if i >= count:
            panel.set_axis_off()
            continue
        for one in np.flatnonzero(trial.group_of == i):
            far = bool(outcome.outliers[one])
            panel.plot(trial.s, np.exp(outcome.curves.mean[one]), color=ORANGE if far else MUTED, linewidth=0.8)
        panel.plot(trial.s, np.exp(outcome.means.mean[i]), color=colour(i, count))
        panel.set(yscale="log", title=figure_text(outcome.named.groups[i] or "all"))
    axes[0].set_ylabel("k(s) [N m]")
    return figure


@styled
def ratios(outcome: PopulationOutcome) -> Figure:
    """Mean over mean, for the first pairs."""
    figure, (axes,) = blank(3.4)
    s, shown = outcome.named.trial.s, outcome.pairs[:6]
    for i, (one, other) in enumerate(shown):
        low, mean, high = (np.exp(x[i]) for x in (outcome.ratios.low, outcome.ratios.mean, outcome.ratios.high))
        axes.fill_between(s, low, high, color=colour(i), alpha=0.2, linewidth=0)
        name = f"{outcome.named.groups[one]} / {outcome.named.groups[other]}"
        axes.plot(s, mean, color=colour(i), label=figure_text(name))
    axes.axhline(1.0, color=INK, linewidth=1.0)
    axes.set(xlabel="s", ylabel="ratio of k(s)", yscale="log")
    axes.legend(ncols=3)
    return figure


@styled
def bands(outcome: PopulationOutcome) -> Figure:
    """The half band that is to be expected of so many objects."""
    figure, (axes,) = blank(3.2)
    count = min(len(outcome.named.groups), MOST)
    for i in range(count):
        name = figure_text(outcome.named.groups[i] or "all")
        axes.plot(NUMBERS, 100.0 * np.expm1(outcome.bands[i]), color=colour(i, count), label=name)
    axes.axhline(100.0 * outcome.setting.wished, color=INK, linestyle="--", linewidth=1.0)
    axes.set(xlabel="objects of the group", ylabel="half band of its mean [%]", xscale="log", yscale="log")
    axes.legend(ncols=4)
    return figure
