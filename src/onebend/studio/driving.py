"""Drive: `onebend drive` for the page, which shows the plan and says `go`."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from onebend.cli.common import stopped_by_hand
from onebend.drive import commands
from onebend.drive.machine import DriveState
from onebend.drive.plan import DrivePlan, DriveSettings, plan_rows
from onebend.drive.seeing import BentModel
from onebend.drive.watching import LED
from onebend.studio.worker import Studio

AXIS = np.linspace(0.0, 1.0, 31)  # places of the drawn line
_LOOKS = 0.1  # s between looks at what was said


def work(
    studio: Studio, *, model: Path, folder: Path, goal: tuple[float, float], asked: commands.DriveOptions, point: float,
    push_at: float, settings: DriveSettings, overwrite: bool, **_more: Any,
) -> None:  # fmt: skip
    """The plan; it moves when `go` is said. An interrupt, or the end of the studio, holds and releases slowly."""
    with stopped_by_hand(times=2) as (stop, _):
        said = Event()
        studio.obeyed(stop.set, go=said)
        studio.start("planning")
        plan, robot = commands.planned(model, folder, asked, settings, goal=goal, point_s=point, push_s=push_at)
        assert robot is not None
        bent = BentModel(plan.model.beam, plan.push_s, AXIS, plan.gravity)
        studio.found({"plan": plan_rows(plan), "band_m": band_of(plan)})
        studio.start("the plan is shown, and nothing moves before Go")
        while not said.wait(_LOOKS):
            if stop.is_set():
                raise KeyboardInterrupt
        begun = time.monotonic()
        with studio.watching(lambda state, _: {"now": state_data(state, bent, time.monotonic() - begun)}) as watch:
            outcome = commands.go(folder, asked, plan, robot, watch, (stop,), overwrite=overwrite)
    goals = outcome.data["goals"]
    studio.found({"outcome": goals, "delay_s": outcome.data["delay_s"], "folder": folder.as_posix()})
    commands.refuse_failed(outcome)


def band_of(plan: DrivePlan) -> list[list[float]] | None:
    """(49, 2) m: where the point would be by the planned force alone (95 %); None without a band of k(s)."""
    ellipse = plan.open_loop
    return None if ellipse is None else (plan.goals[-1].control.goal + ellipse.outline(49)).tolist()


def state_data(state: DriveState, bent: BentModel, seconds: float) -> dict[str, Any]:
    """What is known, SI. The line is that of the model under the force that is asked for, or felt on the way back."""
    led = state.stage in LED
    force = state.asked if led or not np.isfinite(state.felt).all() else state.felt
    bent.bend(force)
    return {
        "time_s": round(seconds, 3),
        "stage": state.stage,
        "says": state.says,
        "point_m": state.point if led else np.full(2, np.nan),
        "distance_m": state.distance if led else np.nan,
        "goal_m": state.goal,
        "said_m": state.said,
        "force_N": force,
        "felt_N": state.felt,
        "delay_s": state.delay,
        "axis_m": bent.poses()[:, :2].round(6),
    }
