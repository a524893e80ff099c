"""Loop: closed loops as in `onebend loop`, beam by beam."""

from __future__ import annotations

from typing import Any

import numpy as np

from onebend.cli.control import trial_name
from onebend.control.loop import Controller
from onebend.control.loop_simulation import SETTLED, LoopTrial
from onebend.lab.rehearsal_commands import simulation
from onebend.results.control_files import margins_data
from onebend.studio.worker import Studio, end

MOST_MOMENTS = 600  # shown per beam


def work(studio: Studio, **options: Any) -> None:
    studio.obeyed(end)
    studio.start("gains and margins")
    del options["told"]
    control, trials = simulation(**options, progress=studio)
    studio.found({"control": control_data(control)})
    for trial in trials:
        studio.found({"trial": trial_data(trial)})


def control_data(control: Controller) -> dict[str, Any]:
    """Force, gains and margins; null is infinite."""
    reference = {"force_N": control.reference.ends.tolist(), "rise_s": control.reference.rise}
    return {**reference, "rate_per_s": control.gains.rate, **margins_data(control.margins())}


def trial_data(trial: LoopTrial) -> dict[str, Any]:
    """A run at up to `MOST_MOMENTS` moments."""
    said: dict[str, Any] = {
        "name": trial_name(trial),
        "factor": trial.beam.factor,
        "drawn": trial.beam.drawn,
        "steady_m": trial.steady,
        "settled_s": trial.settled(SETTLED),
    }
    if trial.run is None:
        return said
    run = trial.run
    shown = np.unique(np.linspace(0, len(run.time) - 1, min(MOST_MOMENTS, len(run.time))).round().astype(int))
    return {
        **said,
        "time_s": run.time[shown].round(4),
        "error_m": run.error[shown].round(7),
        "force_N": run.force[shown].round(6),
        "axis_m": run.axis[shown, ::2].round(5),
        "point_m": run.xy[shown].round(6),
    }
