"""What `onebend loop` leaves in a folder: the rehearsals in time, the picture, and a summary."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from onebend.control.loop.controller import Controller
from onebend.control.loop.margins import Margins
from onebend.control.loop.robustness import SETTLED, LoopTrial
from onebend.files.manifest import write_summary
from onebend.report.figures.pictures import Pictures
from onebend.results.tables import write_csv

LOOP_FORMAT = "onebend-loop-1"
LOOP_COLUMNS = ("k_factor", "time_s", "x_m", "y_m", "asked_x_N", "asked_y_N", "force_x_N", "force_y_N", "error_m")


def loop_summary(
    model: str,
    control: Controller,
    known: Margins,
    trials: tuple[LoopTrial, ...],
    rehearsed: Mapping[str, object],
    *,
    written_by: str,
) -> dict[str, Any]:
    """What `onebend loop --json` prints and `summary.json` holds (there with `files`); SI; null is infinite.
    `rehearsed`: what the rehearsals were made with beside the controller."""
    timing = control.settings.timing
    return {
        "format": LOOP_FORMAT,
        "written_by": written_by,
        "model": model,
        "push_s": control.push_s,
        "point_s": control.point_s,
        "goal_m": control.goal.tolist(),
        "feedforward_N": control.reference.ends.tolist(),
        "rise_s": control.reference.rise,
        "fps": timing.fps,
        "delay_s": timing.delay,
        "rate_per_s": control.gains.rate,
        "corner_rad_per_s": control.gains.corner,
        "margins": {
            "gain": _finite(known.gain),
            "phase_rad": _finite(known.phase),
            "delay_s": _finite(known.delay),
            "softest": _finite(known.softest),
        },
        **rehearsed,
        "rehearsals": [
            {
                "k_factor": trial.factor,
                "drawn": trial.beam.drawn,
                "stands": trial.run is not None,
                "steady_m": _finite(trial.steady),
                "settled_s": _finite(trial.settled(SETTLED)),
            }
            for trial in trials
        ],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_loop(path: Path, trials: tuple[LoopTrial, ...]) -> None:
    """One row a moment of every rehearsal."""
    rows = (
        (trial.factor, time, *trial.run.xy[i], *trial.run.asked[i], *trial.run.force[i], trial.run.error[i])
        for trial in trials
        if trial.run is not None
        for i, time in enumerate(trial.run.time)
    )
    write_csv(path, LOOP_COLUMNS, ([f"{value:.7g}" for value in row] for row in rows))


def loop_writer(
    trials: tuple[LoopTrial, ...], pictures: Pictures, summary: Mapping[str, Any]
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder."""

    def write(folder: Path) -> None:
        write_loop(folder / "loop.csv", trials)
        pictures.write(folder)
        write_summary(folder, summary)

    return write
