"""Loop: closed loops as in `onebend loop`. As a process (`python -m onebend.studio.looping`) it simulates beam by
beam."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.beam.problem import has_mass
from onebend.cli.control import trial_name
from onebend.control import loop_simulation
from onebend.control.loop import Controller, controller
from onebend.errors import StudioError
from onebend.results.model import read_model
from onebend.studio.bending import BEGIN_TURN, LARGEST_TIMES, bending_force
from onebend.studio.jobs import asked_number, process, tell
from onebend.studio.places import StudioFolder, loop_line

MOST_MOMENTS = 600  # shown per beam
MOST_DRAWN = 8
FORCES = (1e-6, 1e6)  # N
NUMBERS = {  # least, most, default
    "push_s": (0.05, 1.0, 1.0),
    "point_s": (0.05, 1.0, 1.0),
    "k_error": (0.0, 0.95, 0.3),
    "delay_ms": (0.0, 10_000.0, 50.0),
    "fps": (0.1, 1000.0, 30.0),
    "noise_mm": (0.0, 1000.0, 0.05),
    "duration_s": (2.0, 600.0, 8.0),
}


def beam_data(name: str, folder: Path) -> dict[str, Any]:
    """The beam at rest, and an initial goal. Raises `ResultsError` for an unreadable model."""
    stored = read_model(folder)
    beam = stored.beam
    force = BEGIN_TURN * bending_force(beam)
    return {
        "name": name,
        "length_m": beam.length,
        "rest_m": np.round(beam.equilibrium((0.0, 0.0)).xy(loop_simulation.AXIS_PLACES), 6).tolist(),
        "goal_m": np.round(beam.equilibrium((force, 2.0 * force)).xy(1.0), 4).tolist(),
        "band": stored.uncertain is not None,
        "mass": has_mass(beam),
        "doubts": [] if stored.uncertain is None else list(stored.uncertain.doubts),
    }


def reach_asked(places: StudioFolder, asked: Mapping[str, Any]) -> tuple[str, float, float, float]:
    """Beam as JSON, two places, largest force [N]. Raises `StudioError` for an invalid request."""
    beam = read_model(places.result(str(asked.get("model", "")))).beam
    push_s, point_s = (asked_number(asked, key, *NUMBERS[key]) for key in ("push_s", "point_s"))
    most = asked.get("max_force_N")
    bound = LARGEST_TIMES * bending_force(beam) if most is None else asked_number(asked, "max_force_N", *FORCES, 1.0)
    return json.dumps(beam.as_dict(), sort_keys=True), push_s, point_s, bound


def asked_goal(asked: Mapping[str, Any]) -> list[float]:
    """(x, y) m. Raises `StudioError` for anything else."""
    goal = asked.get("goal_m")
    if not isinstance(goal, list) or len(goal) != 2:
        raise StudioError("a goal is (x, y) in m")
    return [asked_number({"goal": one}, "goal", -1e3, 1e3, 0.0) for one in goal]


def wanted_work(places: StudioFolder, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Raises `StudioError` for an invalid request."""
    model = str(asked.get("model", ""))
    places.result(model)
    wanted: dict[str, Any] = {key: asked_number(asked, key, *bounds) for key, bounds in NUMBERS.items()}
    draws = int(asked_number(asked, "draws", 0, MOST_DRAWN, 0))
    most = asked.get("max_force_N")
    wanted |= {
        "folder": str(places.root),
        "model": model,
        "goal_m": asked_goal(asked),
        "draws": draws,
        "max_force_N": None if most is None else asked_number(asked, "max_force_N", *FORCES, 1.0),
    }
    return {**wanted, "command": loop_line(wanted)}


def work(wanted: Mapping[str, Any]) -> None:
    tell({"stage": "gains and margins", "done": 0, "total": None})
    stored = read_model(Path(wanted["model"]))
    draws, k_error = wanted["draws"], wanted["k_error"]
    beam, delay = stored.beam, 1e-3 * wanted["delay_ms"]
    most = math.inf if wanted["max_force_N"] is None else wanted["max_force_N"]
    beams = (
        loop_simulation.drawn_beams(beam, stored.uncertain, draws)
        if draws
        else loop_simulation.wrong_beams(beam, k_error)
    )
    settings = loop_simulation.trial_settings(wanted["fps"], delay, 0.3 if draws else k_error, most)
    where = {"push_s": wanted["push_s"], "point_s": wanted["point_s"]}
    control = controller(beam, wanted["goal_m"], **where, settings=settings)
    tell({"found": {"control": control_data(control)}})
    eye = loop_simulation.LoopCamera(fps=wanted["fps"], delay=delay, noise=1e-3 * wanted["noise_mm"])
    tell({"stage": "simulating", "done": 0, "total": len(beams)})
    for i, trial in enumerate(
        loop_simulation.simulate_trials(control, beams, eye=eye, duration=wanted["duration_s"]), start=1
    ):
        tell({"found": {"trial": trial_data(trial)}})
        tell({"stage": "simulating", "done": i, "total": len(beams)})


def control_data(control: Controller) -> dict[str, Any]:
    """Force, gains and margins; null is infinite."""
    known = control.margins()
    margins = {"gain": known.gain, "phase_rad": known.phase, "delay_s": known.delay, "softest": known.softest}
    reference = {"force_N": control.reference.ends.tolist(), "rise_s": control.reference.rise}
    return {**reference, "rate_per_s": control.gains.rate, **margins}


def trial_data(trial: loop_simulation.LoopTrial) -> dict[str, Any]:
    """A run at up to `MOST_MOMENTS` moments."""
    said: dict[str, Any] = {
        "name": trial_name(trial),
        "factor": trial.beam.factor,
        "drawn": trial.beam.drawn,
        "steady_m": trial.steady,
        "settled_s": trial.settled(loop_simulation.SETTLED),
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


if __name__ == "__main__":
    sys.exit(process(work, alone=False))
