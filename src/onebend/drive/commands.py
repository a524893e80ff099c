"""The command that drives a beam."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Literal

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from onebend.cli import common
from onebend.cli.models import read_trusted
from onebend.drive import plan as plans, specs
from onebend.drive.machine import DriveState
from onebend.drive.placing import Placement, from_recording, stated_placement
from onebend.drive.plan import DriveSettings
from onebend.drive.robots import Robot
from onebend.drive.run import SUMMARY, DriveOutcome, drive as run
from onebend.drive.virtual import VirtualRobot
from onebend.errors import RecordingError
from onebend.live.commands import StateView
from onebend.live.recording_folder import copy_description
from onebend.options import option
from onebend.progress import Progress, Silent
from onebend.recording.entries import Recording
from onebend.recording.folder import FILE_NAME, folder_of, read_recording


@dataclass(frozen=True)
class DriveOptions:
    """What is wanted, who moves and who sees."""

    goals: Path | None = option("--goals", None, metavar="CSV")
    shape: Path | None = option("--shape", None, metavar="CSV")
    camera: str | None = option("--camera", None, metavar="SPEC")
    robot: str | None = option("--robot", None, metavar="SPEC")
    force: str | None = option("--force", None, metavar="SPEC")
    like: Path | None = option("--like", None, metavar="REC")
    place: Literal["start", "push", "tag"] = option("--place", "start")
    tool_tag: int | None = option("--tool-tag", None, metavar="ID", within=(0, None))
    go: bool = option("--go", False)


def drive(
    model: Path, folder: Path, *, goal: tuple[float, float] | None = None, asked: DriveOptions, point: float = 1.0,
    push_at: float = 1.0, settings: DriveSettings, overwrite: bool = False, told: common.Told,
) -> None:  # fmt: skip
    """Bend a learned beam to a goal with a robot and a camera: a plan first, and with --go the real loop, recorded."""
    told = replace(told, quiet=told.quiet or told.as_json)
    with common.progress_of(told) as progress:
        plan, made = planned(
            model, folder, asked, settings, goal=goal, point_s=point, push_s=push_at, progress=progress
        )  # fmt: skip
    if not told.as_json:
        table = common.facts_table()
        for what, says in plans.plan_rows(plan):
            table.add_row(what, Text(says))
        common.screen().print(table)
    if not asked.go:
        if told.as_json:
            common.print_json({"plan": plans.plan_data(plan), "moved": False})
        else:
            common.say("Nothing moved. To move, add --go.")
        return
    if made is None:
        raise RecordingError("--robot is missing: which one is to move? See docs/drive.md.")
    with (
        common.stopped_by_hand(times=2) as (stop, enter),
        StateView(None if told.quiet else common.stderr_screen(), _screen, lambda one: (one.says, one.says)) as view,
    ):
        outcome = go(folder, asked, plan, made, view.show, (stop, enter), overwrite=overwrite)
    _answer(outcome, data_alone=told.as_json)
    refuse_failed(outcome)


def planned(
    model: Path, folder: Path, asked: DriveOptions, settings: DriveSettings, *, goal: tuple[float, float] | None,
    point_s: float, push_s: float, progress: Progress = Silent(),
) -> tuple[plans.DrivePlan, Robot | None]:  # fmt: skip
    """The plan, and the robot where one is named. Raises `OnebendError`: what cannot be."""
    stored = read_trusted(model)
    rec = _described(folder, asked.like)
    rec = replace(rec, push=None if rec.push is None else replace(rec.push, at=push_s))
    limits, gravity = plans.known_limits(stored, rec, settings.limits), plans.gravity_of(rec)
    wanted = plans.read_wanted(
        plans.levelled(stored, rec, gravity), limits, goal=goal, goals=asked.goals, targets=asked.shape,
        push_s=push_s, point_s=point_s, gravity=gravity,
    )  # fmt: skip
    placement = _placement(rec, asked.like, asked.place, asked.tool_tag)
    plan = plans.make_plan(stored, rec, wanted, placement, settings, push_s=push_s, point_s=point_s, progress=progress)
    made = specs.robot_of(asked.robot)(rec, settings) if asked.robot is not None else None
    if made is not None and settings.by not in made.can:
        raise RecordingError(f"--by {settings.by}: {made.name} cannot be asked for it. Take --by pose.")
    if made is not None and asked.camera is None and not isinstance(made, VirtualRobot) and asked.go:
        raise RecordingError("--camera is missing: /dev/video0, or another of docs/record.md.")
    return plan, made


def go(
    folder: Path, asked: DriveOptions, plan: plans.DrivePlan, made: Robot, watch: Callable[[DriveState], None],
    stops: tuple[Event, ...], *, overwrite: bool = False,
) -> DriveOutcome:  # fmt: skip
    """Drive. Each time that one of `stops` is set counts as one press: hold and release slowly, then let go at once."""
    if asked.like is not None:
        copy_description(asked.like, folder)
    own = made.camera() if asked.camera is None and isinstance(made, VirtualRobot) else None
    eye = own or specs.camera_of(str(asked.camera))
    sensor = None if asked.force is None else specs.force_of(asked.force)

    def pressed() -> bool:
        found = [one for one in stops if one.is_set()]
        for one in found:
            one.clear()
        return bool(found)

    return run(
        folder, plan, eye, made, sensor, watch=watch, stop=SimpleNamespace(is_set=pressed), overwrite=overwrite
    )  # fmt: skip


def refuse_failed(outcome: DriveOutcome) -> None:
    """Raises `RecordingError` where something went wrong."""
    if not outcome.good:
        events = outcome.drive.events
        last = next((one.text for one in events if one.fault), events[-1].text if events else "it ended")
        raise RecordingError(f"{last}. What happened is in {outcome.recorded.folder / SUMMARY}")


def _described(folder: Path, like: Path | None) -> Recording:
    """What recording.toml says, of the folder itself or of the one that it is to be like."""
    if (folder / FILE_NAME).is_file():
        return read_recording(folder, filmed=False)
    if like is None:
        raise RecordingError(f"{folder} holds no {FILE_NAME}. Name a recording of this beam with --like, or write one.")
    return read_recording(folder_of(like), filmed=False)


def _placement(rec: Recording, like: Path | None, place: str, tag: int | None) -> Placement:
    if (place == "tag") != (tag is not None):
        raise RecordingError("--place tag goes with --tool-tag, the number of the tag on the tool.")
    if place == "start":
        return stated_placement(rec)
    if like is None:
        raise RecordingError(f"--place {place} takes the push of a recording: name it with --like.")
    return from_recording(read_recording(folder_of(like)), tool_tag=tag)


def _screen(state: DriveState) -> RenderableType:
    table = common.facts_table()
    table.add_row("stage", Text(state.stage, "bold"))
    table.add_row(
        "from the goal", f"{1e3 * state.distance:.2f} mm" if math.isfinite(state.distance) else "not seen yet"
    )
    for name, force in (("force asked", state.asked), ("force felt", state.felt)):
        if np.isfinite(force).all():
            table.add_row(name, f"{float(np.hypot(*force)):.3f} N: ({force[0]:+.3f}, {force[1]:+.3f})")
    if math.isfinite(state.delay):
        table.add_row("delay", f"{1e3 * state.delay:.0f} ms, measured")
    return Group(
        Text(state.says), Text(""), table, Text(""), Text("Enter or Ctrl-C: hold, and release slowly", style="dim")
    )


def _answer(outcome: DriveOutcome, *, data_alone: bool) -> None:
    made, folder = outcome.drive, outcome.recorded.folder
    if data_alone:
        common.print_json({**outcome.data, "folder": str(folder)})
    else:
        for one in made.outcomes:
            off, x, y = 1e3 * float(np.linalg.norm(one.seen - one.goal)), *(1e3 * one.goal)
            passed = math.isnan(one.said)
            word = "not reached" if not one.reached else "passed in time" if passed else "reached"
            said = "" if passed else f" (said: to {1e3 * one.said:.2g} mm)"
            common.say(f"({x:.4g}, {y:.4g}) mm: {word}, seen {off:.2g} mm off{said}")
        if pauses := made.pauses:
            common.say(
                f"It paused {len(pauses)} times, {sum(pauses):.1f} s in all: pictures, answers or turns of the loop "
                "were late. On a busy computer end other programs, or see docs/drive.md on real-time scheduling."
            )
        learning = made.plan.remarks or (f"learn from it with: onebend learn {folder}",)
        common.say(f"Recorded {folder}; {learning[0]}")
