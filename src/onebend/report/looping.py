"""The picture of a rehearsed closed loop: distance from the goal, and the force, over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from onebend.control.feedback import Controller
from onebend.control.prospect import Trial
from onebend.report.style import BLUE, GREEN, MUTED, ORANGE, blank, styled

MM = 1000.0
LEAST = 1e-5  # m: what the logarithmic axis shows of less
COLOURS = (BLUE, ORANGE, GREEN)


@styled
def looping(control: Controller, trials: tuple[Trial, ...]) -> Figure:
    """One curve a beam."""
    figure, (away, force) = blank(5.0, 2, 1)
    for one, colour in zip(trials, COLOURS, strict=False):
        if one.run is None:
            continue
        name = "k(s) as the model" if one.factor == 1.0 else f"k(s) times {one.factor:.3g}"
        away.semilogy(one.run.time, MM * np.maximum(one.run.error, LEAST), color=colour, label=name)
        force.plot(one.run.time, np.hypot(*one.run.asked.T), color=colour)
    away.axhline(0.5, color=MUTED, lw=1.0, ls=":")
    away.set(ylabel="from the goal [mm]", title=f"A rehearsal of the loop: goal at {_place(control)} mm")
    away.text(0.01, 0.52, "0.5 mm", fontsize=8, color=MUTED, va="bottom", transform=away.get_yaxis_transform())
    away.legend(loc="upper right")
    force.axhline(float(np.hypot(*control.reference.ends)), color=MUTED, lw=1.0, ls=":")
    force.set(xlabel="time [s]", ylabel="force asked for [N]", ylim=(0.0, None))
    return figure


def _place(control: Controller) -> str:
    x, y = MM * control.goal
    return f"({x:.4g}, {y:.4g})"
