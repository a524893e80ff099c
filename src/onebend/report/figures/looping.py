"""The picture of a rehearsed closed loop: distance from the goal, and the force, over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.control.loop.controller import Controller
from onebend.control.loop.robustness import SETTLED, LoopTrial
from onebend.report.figures.style import BLUE, GREEN, MUTED, ORANGE, blank, styled

MM = 1000.0
LEAST = 1e-5  # m: what the logarithmic axis shows of less
LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."))


@styled
def looping(control: Controller, trials: tuple[LoopTrial, ...]) -> Figure:
    """One curve a beam."""
    figure, (away, force) = blank(5.0, 2, 1)
    for i, trial in enumerate(trials):
        if trial.run is None:
            continue
        colour, dash = LINES[1 if trial.beam.drawn else i]
        name = "k(s) as the model" if trial.factor == 1.0 else f"k(s) times {trial.factor:.3g}"
        if trial.beam.drawn:  # one entry of the legend stands for all
            name = "k(s) drawn from its band" if i == 1 else ""
        away.semilogy(trial.run.time, MM * np.maximum(trial.run.error, LEAST), color=colour, ls=dash)
        force.plot(trial.run.time, np.hypot(*trial.run.asked.T), color=colour, ls=dash, label=name)
    away.axhline(MM * SETTLED, color=MUTED, lw=1.0, ls=":")
    away.set(ylabel="from the goal [mm]", title=f"A rehearsal of the loop: goal at {_place(control)} mm")
    _said(away, MM * SETTLED, f"settled: {MM * SETTLED:.3g} mm")
    ahead = float(np.hypot(*control.reference.ends))
    force.axhline(ahead, color=MUTED, lw=1.0, ls=":")
    _said(force, ahead, "feedforward")
    force.legend(loc="lower right")  # under the forces, which begin at 0 and stay
    force.set(xlabel="time [s]", ylabel="force asked for [N]", ylim=(0.0, None))
    return figure


def _said(axes: Axes, height: float, text: str) -> None:
    """What a dotted line is, on it."""
    axes.text(0.01, 1.03 * height, text, fontsize=8, color=MUTED, va="bottom", transform=axes.get_yaxis_transform())


def _place(control: Controller) -> str:
    x, y = MM * control.goal
    return f"({x:.4g}, {y:.4g})"
