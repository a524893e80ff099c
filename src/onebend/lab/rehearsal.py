"""A rehearsal: predicted band, and advice."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.beam.stiffness import half_width
from onebend.files.publish import headed
from onebend.lab import forecast
from onebend.learning.design import PLACES
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.records import Array
from onebend.report.sentences import direction_words
from onebend.report.style import BLUE, FAINT, INK, ORANGE, blank, styled
from onebend.results.tables import write_csv
from onebend.text_files import figure_text

MEDIAN, NINETY = 0.674490, 1.644854  # of |z| for a normal z


@dataclass(frozen=True)
class Rehearsal:
    setup: forecast.Setup
    predicted: forecast.PredictedBand
    advice: tuple[forecast.SetupChange, ...]  # best first

    def as_dict(self) -> dict[str, Any]:
        """For JSON, in SI."""
        s, p = self.setup, self.predicted
        pushes = [{"at_s": x.at_s, "direction_rad": x.direction, "peak_N": x.peak} for x in s.pushes]
        asked = {"name": s.name, "length_m": s.beam.length, "tags_s": list(s.tags), "pushes": pushes}
        tolerances = {"gain_sd": s.gain_sd, "placement_sd_m": s.placement_sd, "turn_sd_rad": s.turn_sd}
        said = {name: getattr(p, name).tolist() for name in ("k", "sd", "own_sd", "scatter", "bias", "error")}
        return {
            "setup": {**asked, **tolerances, "clock_sd_s": s.clock_sd, "fps": s.fps},
            "s": PLACES.tolist(),
            "predicted": {**said, "identified": forecast.ranges(p.identified), "band": asdict(p.quality)},
            "advice": [change.as_dict() for change in self.advice],
        }


@one_blas_thread
def rehearse(setup: forecast.Setup, *, count: int = 8, progress: Progress = Silent()) -> Rehearsal:
    """Expected accuracy of k(s) for a setup by Fisher information, and at most `count` changes that improve it.

    Raises:
        MechanicsError: the beam buckles, snaps through, hardly bends, or bends too far.
    """
    forecast.check_bending(setup)
    predicted = forecast.predict(setup)
    return Rehearsal(setup, predicted, forecast.advise(setup, predicted, count=count, progress=progress))


def setup_words(setup: forecast.Setup) -> str:
    pushes = "; ".join(f"s = {p.at_s:.2f}, {direction_words(p.direction)}, to {p.peak:.3g} N" for p in setup.pushes)
    return f"{setup.name}: tags at s = {', '.join(f'{s:.3g}' for s in setup.tags)}; pushed at {pushes}"


@styled
def rehearsal_figure(rehearsal: Rehearsal) -> Figure:
    """k(s) with the predicted band, and the size of the error."""
    figure, (stiffness, error) = blank(6.4, rows=2, sharex=True)
    p = rehearsal.predicted
    known = p.identified if np.any(p.identified) else p.sd <= np.quantile(p.sd, 0.25)  # they set the axes
    wide, ninety = np.exp(half_width(p.sd)), _percent(NINETY * p.error)
    stiffness.fill_between(PLACES, p.k / wide, p.k * wide, color=BLUE, alpha=0.2, linewidth=0.0, label="95 % band")
    stiffness.plot(PLACES, p.k, color=INK, label="k(s), true")
    top = float(np.max((p.k * wide)[known]))
    stiffness.set(ylim=(0.0, 1.45 * max(top, min(float(np.max(p.k)), 1.3 * top))), ylabel="k [N m]")
    stiffness.set_title(f"{figure_text(rehearsal.setup.name)}: how well k(s) would come out")
    error.plot(PLACES, _percent(MEDIAN * p.error), color=BLUE, label="median")
    error.plot(PLACES, ninety, color=BLUE, linestyle=":", label="9 in 10 below")
    highest = float(np.max(ninety[known]))
    error.fill_between(
        PLACES, 0.0, 2.0 * highest, where=~p.identified, color=FAINT, alpha=0.6, linewidth=0.0, step="mid"
    )
    error.set(ylim=(0.0, 1.35 * highest), ylabel="error of k [%]")
    error.set_title("error along the beam" + ("" if np.all(p.identified) else " (grey: not identified)"))
    error.set_xlabel("place along the beam s  (squares: tags; triangles: pushes)")
    for axes in (stiffness, error):
        _marks(axes, rehearsal)
        axes.set(xlim=(0.0, 1.0))
        axes.legend(ncols=2, loc="upper left")
    return figure


def _percent(log_error: Array) -> Array:
    return np.asarray(100.0 * np.expm1(log_error))


def _marks(axes: Axes, rehearsal: Rehearsal) -> None:
    across = axes.get_xaxis_transform()
    tags = list(rehearsal.setup.tags)
    axes.plot(tags, [0.0] * len(tags), "s", color=INK, markersize=6, clip_on=False, transform=across, zorder=5)
    for push in rehearsal.setup.pushes:
        axes.plot([push.at_s], [0.06], "^", color=ORANGE, markersize=7, clip_on=False, transform=across, zorder=5)


REHEARSE_FORMAT = "onebend-rehearse-1"
COLUMNS = ("s", "k_N_m", "sd", "median", "ninety", "identified")


def summary_of(rehearsal: Rehearsal) -> dict[str, Any]:
    return headed(REHEARSE_FORMAT, **rehearsal.as_dict())


def write_table(folder: Path, rehearsal: Rehearsal) -> None:
    """`rehearsal.csv`, one row per place; sizes of log k."""
    p = rehearsal.predicted
    numbers = zip(PLACES, p.k, p.sd, MEDIAN * p.error, NINETY * p.error, p.identified, strict=True)
    rows = ([*(f"{value:.6g}" for value in row), str(bool(known)).lower()] for *row, known in numbers)
    write_csv(folder / "rehearsal.csv", COLUMNS, rows)
