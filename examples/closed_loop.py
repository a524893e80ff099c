"""Draws docs/images/loop.png: the distance from a goal over time, k(s) being 30 % lower than the model says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from onebend import Beam, Uniform, controller
from onebend.beam import Powers, Scaled
from onebend.control import ControllerSettings, LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.report.style import BLUE, GREEN, ORANGE, blank, png_of, styled

TARGET = Path(__file__).parents[1] / "docs" / "images" / "loop.png"
MODEL = Beam(0.15, Powers((0.03, -0.02)), mass_per_length=Uniform(0.1))
TRUTH = TrueSystem(
    replace(MODEL, stiffness=Scaled(0.7, MODEL.stiffness)),
    eye=LoopCamera(delay=0.06, jitter=0.01, noise=1e-4, dropped=0.1, hidden=((2.2, 2.7),)),
)
VARIANTS = {
    "open loop: the learned beam's force": (True, False, ORANGE, "--"),
    "feedback alone": (False, True, GREEN, "-."),
    "both": (True, True, BLUE, "-"),
}


def runs(duration: float = 5.0) -> dict[str, LoopSimulation]:
    """The three variants on one beam, through the same camera."""
    control = controller(MODEL, MODEL.equilibrium((-0.1, 0.3)).xy(1.0))
    found = {}
    for name, (feedforward, feedback, *_) in VARIANTS.items():
        settings = ControllerSettings(feedforward=feedforward, feedback=feedback)
        found[name] = simulate_loop(replace(control, settings=settings), TRUTH, duration, seed=1)
    return found


@styled
def picture(found: dict[str, LoopSimulation]) -> Figure:
    """Distance from the goal, in mm, on a logarithmic axis."""
    figure, (axes,) = blank(3.2)
    for name, run in found.items():
        axes.semilogy(
            run.time, 1e3 * np.maximum(run.error, 1e-6), label=name, color=VARIANTS[name][2], ls=VARIANTS[name][3]
        )
    axes.axhline(0.5, color="0.4", lw=1.0, ls=":")
    axes.text(0.02, 0.52, "0.5 mm", fontsize=8, color="0.4", va="bottom")
    for first, last in TRUTH.eye.hidden:
        axes.axvspan(first, last, color="0.9", zorder=0)
        axes.text(0.5 * (first + last), 60.0, "hidden", ha="center", fontsize=8, color="0.4")
    axes.set(
        xlabel="time [s]", ylabel="distance from the goal [mm]", ylim=(0.02, 150.0), xlim=(0.0, found["both"].time[-1])
    )
    axes.legend(loc="lower left")
    return figure


def main(target: Path = TARGET) -> None:
    target.write_bytes(png_of(picture(runs())))


if __name__ == "__main__":
    main()
