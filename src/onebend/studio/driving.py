"""Drive: `onebend drive` for the page. As a process (`python -m onebend.studio.driving`) it shows the plan, and moves
when it reads the line `go`. An interrupt, or the end of its input, holds the robot and releases slowly."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.cli.common import stopped_by_hand
from onebend.drive import commands
from onebend.drive.machine import DriveState
from onebend.drive.plan import DrivePlan, DriveSettings, plan_rows
from onebend.drive.seeing import BentModel
from onebend.drive.watching import LED
from onebend.errors import StudioError
from onebend.lab.designs import DESIGNS
from onebend.studio import filming, jobs, looping, recorder
from onebend.studio.places import RECORDING, StudioFolder, drive_line, is_file, plain_word

AXIS = np.linspace(0.0, 1.0, 31)  # places of the drawn line
_LOOKS = 0.1  # s between looks at what was said


def wanted_work(places: StudioFolder, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Raises `StudioError` for an invalid request, or a path outside the studio's folder."""
    words = {key: filming.asked_text(asked, key) for key in ("model", "like", "robot", "camera", "out")}
    places.result(words["model"])
    places.recording(words["like"])
    if not words["out"] or places.path(words["out"]) == places.root:
        raise StudioError("a drive is recorded into a folder of its own: name it")
    if is_file(places.path(words["out"]) / RECORDING):
        raise StudioError(f"{words['out']} holds a recording already: name another folder")
    if not words["robot"]:
        raise StudioError("name a robot: virtual:linear, or another of docs/drive.md")
    kind, _, where = words["robot"].partition(":")
    if kind == "virtual" and (design := where.split(",")[0]) not in DESIGNS:
        places.path(design)
    if words["camera"]:
        filming.check_source(places, words["camera"])
    names = {key: plain_word(words[key]) for key in ("model", "like", "out")}
    numbers = {key: jobs.asked_number(asked, key, *looping.NUMBERS[key]) for key in ("push_s", "point_s")}
    wanted = {**words, **names, **numbers, "folder": str(places.root), "goal_m": looping.asked_goal(asked)}
    return {**wanted, "command": drive_line(wanted)}


def work(wanted: Mapping[str, Any]) -> None:
    """Plan, wait for `go`, and drive. Raises `OnebendError`: no plan, or something went wrong on the way."""
    said = threading.Event()
    asked = commands.DriveOptions(
        camera=wanted["camera"] or None, robot=wanted["robot"], like=Path(wanted["like"]), go=True
    )  # fmt: skip
    where = {"goal": tuple(wanted["goal_m"]), "point_s": wanted["point_s"], "push_s": wanted["push_s"]}
    with stopped_by_hand(times=2) as (stop, _):

        def obey() -> None:
            for line in recorder.lines_in(os.dup(0)):
                if line.strip() == "go":
                    said.set()
            stop.set()  # the studio is gone

        threading.Thread(target=obey, daemon=True).start()
        jobs.tell({"stage": "planning", "done": 0, "total": None})
        folder = Path(wanted["out"])
        plan, robot = commands.planned(Path(wanted["model"]), folder, asked, DriveSettings(), **where)
        assert robot is not None
        bent = BentModel(plan.model.beam, plan.push_s, AXIS, plan.gravity)
        jobs.tell({"found": {"plan": plan_rows(plan), "band_m": band_of(plan)}})
        jobs.tell({"stage": "the plan is shown, and nothing moves before Go", "done": 0, "total": None})
        while not said.wait(_LOOKS):
            if stop.is_set():
                raise KeyboardInterrupt
        begun = time.monotonic()
        talk = recorder.Talk(sys.stdout, lambda state, _: {"now": state_data(state, bent, time.monotonic() - begun)})
        try:
            outcome = commands.go(folder, asked, plan, robot, talk.watch, (stop,))
        finally:
            talk.end()
    goals = outcome.data["goals"]
    jobs.tell({"found": {"outcome": goals, "delay_s": outcome.data["delay_s"], "folder": wanted["out"]}})
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


if __name__ == "__main__":
    sys.exit(jobs.process(work))
