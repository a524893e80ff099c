"""The figures of what was learned: k(s) with its band, and the nuisances before and after the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Profile
from onebend.beam.profiles.uncertain import Band, UncertainStiffness
from onebend.escaping import figure_text
from onebend.learning.posterior import Nuisance
from onebend.records import Array, BoolArray
from onebend.report.figures.bands import LEVELS, highest_shown
from onebend.report.figures.style import BLUE, FAINT, INK, MUTED, ORANGE, blank, colour, named, shape, styled

MM = 1000.0
GREY = "#98a2b3"
_S = np.linspace(0.0, 1.0, 401)
_MOST_ROWS = 40  # of a picture
_SAID = 0.05  # of the sd before the data: what it shrank by, or the value


@styled
def stiffness(
    beam: Beam,
    *,
    uncertain: UncertainStiffness | None = None,
    regression: Profile | None = None,
    tags: Mapping[int, float] = MappingProxyType({}),
    push_s: float | None = None,
) -> Figure:
    """k(s) along the beam with its bands, grey where the data are blind; the regression's k(s) beside it.

    The symbols are the tags, by id and place; hatched: what no push reached.
    """
    if uncertain is None:
        figure, (axes,) = blank(3.1)
        low, top = _plain(axes, beam.stiffness(_S))
    else:
        figure, (axes, relative) = blank(4.9, 2, 1, sharex=True, height_ratios=(2.6, 1.0))
        low, top = 0.0, _banded(axes, uncertain)
        _relative(relative, uncertain, regression)
    if regression is not None:
        axes.plot(_S, regression(_S), color=ORANGE, linewidth=1.3, linestyle="--", label="the paper's regression")
        top = max(top, min(float(np.max(regression(_S))), 1.5 * top))
    axes.set(xlim=(0, 1), ylabel="bending stiffness k = EI / L [N m]", ylim=(1.15 * low, 1.15 * top or None))
    _places(axes, tags, push_s)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
    figure.axes[-1].set_xlabel("place along the beam s")
    length = MM * beam.length
    above = axes.secondary_xaxis("top", functions=(partial(np.multiply, length), partial(np.multiply, 1.0 / length)))
    above.set_xlabel("distance from the clamp [mm]", color=MUTED)
    return figure


def _plain(axes: Axes, k: Array) -> tuple[float, float]:
    """A curve without a band; returns the lowest and highest value to show."""
    axes.plot(_S, k, color=BLUE)
    axes.fill_between(_S, 0.0, k, color=BLUE, alpha=0.08, linewidth=0)
    if k.min() <= 0.0:
        axes.fill_between(_S, 0.0, k, where=k <= 0.0, color=ORANGE, alpha=0.35, label="not positive: no beam")
    return min(0.0, float(k.min())), max(float(k.max()), 0.0)


def _banded(axes: Axes, uncertain: UncertainStiffness) -> float:
    """The curve with its bands; returns the highest value to show: what is not known may leave the picture."""
    wide = _bands(axes, uncertain, np.asarray)
    known, k = wide.identified, wide.k
    axes.plot(_S, np.where(known, k, np.nan), color=BLUE, label="k(s)")
    axes.fill_between([], [], color=BLUE, alpha=0.5, linewidth=0, label="50, 80, 95 % band")  # for the legend
    if not known.all():
        axes.plot(_S, np.where(_reach(~known), k, np.nan), color=GREY)
        why = "not to be trusted" if uncertain.doubts else "not identified"
        axes.fill_between([], [], color=GREY, alpha=0.6, linewidth=0, label=why)
    return highest_shown(uncertain)


def _relative(axes: Axes, uncertain: UncertainStiffness, regression: Profile | None) -> None:
    """The bands, and the regression, in per cent of k(s)."""
    k = uncertain.profile(_S)
    wide = _bands(axes, uncertain, lambda value: 100.0 * (value / k - 1.0))
    axes.plot(_S, np.where(wide.identified, 0.0, np.nan), color=BLUE)
    axes.plot(_S, np.where(_reach(~wide.identified), 0.0, np.nan), color=GREY)
    if regression is not None:
        axes.plot(_S, 100.0 * (regression(_S) / k - 1.0), color=ORANGE, linewidth=1.3, linestyle="--")
    reach = 120.0 * float(np.max((wide.high / k - 1.0)[uncertain.best_known(_S)]))
    axes.set(ylim=(-min(reach, 100.0), reach), ylabel="against k [%]")


def _bands(axes: Axes, uncertain: UncertainStiffness, shown: Callable[[Array], Array]) -> Band:
    """The bands as `shown`, grey where the data are blind; returns the widest."""
    for level, strength in LEVELS:
        band = uncertain.band(_S, level)
        for where, tint in ((band.identified, BLUE), (~band.identified, GREY)):
            axes.fill_between(
                _S, shown(band.low), shown(band.high), where=_reach(where), color=tint, alpha=strength, linewidth=0
            )  # fmt: skip
    return uncertain.band(_S, LEVELS[0][0])


def _reach(where: BoolArray) -> BoolArray:
    """Flags, one place wider to the right, so that two neighbouring pieces of a curve touch."""
    return np.concatenate([where[:1], where[1:] | where[:-1]])


def _places(axes: Axes, tags: Mapping[int, float], push_s: float | None) -> None:
    """The tags on the axis, and what no push reached."""
    count = len(tags)
    for i, (tag, place) in enumerate(tags.items()):
        tint, text = colour(i, count), f"tag {tag}" if i == 0 else f"{tag}"
        axes.plot(place, 0.0, marker=shape(i), color=tint, markersize=7, clip_on=False, zorder=5)
        if i in named(count):
            axes.annotate(text, (place, 0.0), (0, 7), textcoords="offset points", ha="center", color=tint, fontsize=8.5)
    if push_s is not None and push_s < 0.999:
        axes.axvspan(push_s, 1.0, facecolor="none", edgecolor=FAINT, hatch="///", linewidth=0)
        axes.annotate("never loaded", ((1 + push_s) / 2, 0.5), xycoords=("data", "axes fraction"), ha="center")


def told(every: Sequence[Nuisance]) -> list[Nuisance]:
    """The nuisances of which the data say something, in their order; of many the 40 of which they say most."""
    said = np.array([max(1.0 - n.sd / n.prior_sd, abs(n.value) / n.prior_sd) for n in every])
    most = np.argsort(-said, kind="stable")[:_MOST_ROWS]
    return [every[i] for i in sorted(most.tolist()) if said[i] > _SAID]


@styled
def nuisances(rows: Sequence[Nuisance]) -> Figure:
    """Nuisances in units of their prior's sd: grey what was allowed (one sd), blue what the data made of it."""
    figure, (axes,) = blank(0.9 + 0.24 * len(rows))
    value, sd = (
        np.array(column) for column in zip(*((n.value / n.prior_sd, n.sd / n.prior_sd) for n in rows), strict=True)
    )
    axes.barh(range(len(rows)), 2.0, left=-1.0, height=0.72, color=FAINT, alpha=0.7)
    axes.errorbar(value, range(len(rows)), xerr=sd, fmt="o", color=BLUE, markersize=4.5, elinewidth=1.6, capsize=2.5)
    axes.axvline(0.0, color=MUTED, linewidth=0.8)
    axes.set_yticks(range(len(rows)), [figure_text(n.name) for n in rows], color=INK)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    reach = 1.15 * max((abs(n.value) + n.sd) / n.prior_sd for n in rows)
    axes.set(xlim=(-max(reach, 1.3), max(reach, 1.3)))
    axes.set(xlabel="value [sd before the data]\n(grey: one sd before; blue: value and one sd after)")
    return figure
