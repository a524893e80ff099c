"""The figure of a rehearsal: the band predicted and obtained, and the errors along the beam."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.beam.profiles.uncertain import half_width
from onebend.escaping import figure_text
from onebend.forecast.prediction import PredictedBand
from onebend.forecast.rehearsal import MEDIAN, NINETY, Rehearsal
from onebend.forecast.runs import errors_of
from onebend.learning.design.proposals import PLACES
from onebend.records import Array, BoolArray
from onebend.report.figures.style import BLUE, FAINT, INK, MUTED, ORANGE, blank, styled

SHOWN = 40  # fits drawn as lines


@styled
def rehearsal_figure(rehearsal: Rehearsal) -> Figure:
    """k(s) with the bands above, the size of its error below."""
    figure, (stiffness, error) = blank(6.4, rows=2, sharex=True)
    _bands(stiffness, rehearsal)
    _errors(error, rehearsal)
    for axes in (stiffness, error):
        _marks(axes, rehearsal)
        axes.set_xlim(0.0, 1.0)
        axes.set_ylim(bottom=0.0)
    error.set_xlabel("place along the beam s  (squares: tags; triangles: pushes)")
    return figure


def _bands(axes: Axes, rehearsal: Rehearsal) -> None:
    p, o = rehearsal.predicted, rehearsal.obtained
    k, wide = p.k, np.exp(half_width(p.sd))
    fits, _, _ = errors_of(rehearsal.runs)
    for i, error in enumerate(fits[:SHOWN]):
        axes.plot(PLACES, k * np.exp(error), color=MUTED, linewidth=0.6, alpha=0.5, label=None if i else "fits")
    axes.fill_between(PLACES, k / wide, k * wide, color=BLUE, alpha=0.2, linewidth=0.0, label="95 % band, predicted")
    if o is not None:
        obtained = np.exp(half_width(o.sd))
        style = {"color": ORANGE, "linestyle": "--", "linewidth": 1.3}
        axes.plot(PLACES, k / obtained, **style, label="95 % band, typical of the fits")  # type: ignore[arg-type]
        axes.plot(PLACES, k * obtained, **style)  # type: ignore[arg-type]
    axes.plot(PLACES, k, color=INK, label="k(s), true")
    top = float(np.max((k * wide)[_best_known(p)]))
    axes.set_ylim(0.0, 1.45 * max(top, min(float(np.max(k)), 1.3 * top)))
    axes.set_ylabel("k [N m]")
    axes.set_title(f"{figure_text(rehearsal.setup.name)}: how well k(s) would come out")
    axes.legend(ncols=2, loc="upper left")


def _errors(axes: Axes, rehearsal: Rehearsal) -> None:
    p, o = rehearsal.predicted, rehearsal.obtained
    axes.plot(PLACES, _percent(MEDIAN * p.error), color=BLUE, label="median, predicted")
    axes.plot(PLACES, _percent(NINETY * p.error), color=BLUE, linestyle=":", label="9 in 10 below, predicted")
    known = _best_known(p)
    highest = [float(np.max(_percent(NINETY * p.error)[known]))]
    if o is not None:
        axes.plot(PLACES, _percent(o.median), color=ORANGE, label=f"median of {o.runs} fits")
        axes.plot(PLACES, _percent(o.ninety), color=ORANGE, linestyle=":", label="9 in 10 below, of the fits")
        highest.append(float(np.max(_percent(o.ninety)[known])))
    axes.fill_between(
        PLACES, 0.0, 2.0 * max(highest), where=~p.identified, color=FAINT, alpha=0.6, linewidth=0.0, step="mid"
    )
    axes.set_ylim(0.0, 1.35 * max(highest))
    axes.set_ylabel("error of k [%]")
    axes.set_title("error along the beam" + ("" if np.all(p.identified) else " (grey: not identified)"))
    axes.legend(ncols=2, loc="upper left")


def _best_known(predicted: PredictedBand) -> BoolArray:
    """(S,) the places that set the axes: where k would be known; where it is nowhere, the best quarter of them."""
    known = predicted.identified
    return np.asarray(known if np.any(known) else predicted.sd <= np.quantile(predicted.sd, 0.25))


def _percent(log_error: Array) -> Array:
    """Sizes of log k as ones of k, as in the table."""
    return np.asarray(100.0 * np.expm1(log_error))


def _marks(axes: Axes, rehearsal: Rehearsal) -> None:
    """Tags as ticks below, pushes as arrows."""
    across = axes.get_xaxis_transform()
    tags = list(rehearsal.setup.tags)
    axes.plot(tags, [0.0] * len(tags), "s", color=INK, markersize=6, clip_on=False, transform=across, zorder=5)
    for push in rehearsal.setup.pushes:
        axes.plot([push.at_s], [0.06], "^", color=ORANGE, markersize=7, clip_on=False, transform=across, zorder=5)
