"""A drive from rest to rest, on a played clock."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.beam.stiffness import Scaled
from onebend.drive.machine import Drive, DriveState, stepped, way_between
from onebend.drive.placing import stated_placement
from onebend.drive.plan import Hand, make_plan
from onebend.drive.robots import Skill, ToolForce, ToolPose, pose_of
from onebend.drive.run import SUMMARY, TABLE
from onebend.drive.virtual import VirtualCell
from onebend.errors import RecordingError
from onebend.live.sources import End, PlayedClock
from onebend.pipeline import learn
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.records import Array
from onebend.results.model import StoredModel
from tests.drive.cells import (
    QUICK,
    BlindCell,
    CellCamera,
    CellRobot,
    FaultyCell,
    described,
    drive_cell,
    driven,
    model_of,
    planned,
    setup_for,
    true_point,
)
from tests.drive.faults import OFF

FORCE = (-0.02, 0.3)  # N


def goal_of(at_s: float = 1.0, force: tuple[float, float] = FORCE) -> tuple[float, float]:
    x, y = np.asarray(model_of("linear").beam.equilibrium(force, at_s).xy(at_s)).reshape(2)
    return float(x), float(y)


class Noting(CellRobot):
    """A robot that keeps what it was told, and when."""

    def __init__(self, cell: VirtualCell) -> None:
        super().__init__(cell)
        self.told: list[tuple[float, ToolPose | ToolForce]] = []
        self.released = 0

    def command(self, wanted: ToolPose | ToolForce) -> None:
        self.told.append((self.cell.time, wanted))
        super().command(wanted)

    def release(self) -> None:
        self.released += 1
        super().release()


@pytest.mark.slow  # the studio leads a point to its goal quickly enough: tests/studio/test_driving.py
@pytest.mark.parametrize(
    ("hand", "by", "at_s", "factor"),
    [
        ("push", "pose", 0.8, 0.7),
        ("hold", "pose", 1.0, 1.3),
        ("push", "force", 1.0, 0.7),
    ],
)
def test_the_true_point_comes_to_rest_on_the_goal(
    hand: Hand, by: Skill, at_s: float, factor: float, tmp_path: Path
) -> None:
    rec = read_recording(described(tmp_path, at_s=at_s, width=640), filmed=False)
    setup = setup_for(rec, holds=hand == "hold", at_s=at_s, sees=math.radians(60.0), off=OFF)
    beam = replace(setup.bench.beam, stiffness=Scaled(factor, setup.bench.beam.stiffness))
    cell = VirtualCell(replace(setup, bench=replace(setup.bench, beam=beam)))
    goal = goal_of(at_s)
    plan = planned(rec, [goal], settings=replace(QUICK, hand=hand, by=by), at_s=at_s, point_s=at_s)
    true: list[Array] = []

    def watch(state: DriveState) -> None:
        if state.stage == "staying":
            true.append(true_point(cell, at_s))

    robot = Noting(cell)
    outcome = drive_cell(tmp_path, plan, cell, watch=watch, robot=robot)
    (one,) = outcome.drive.outcomes
    assert outcome.good, outcome.drive.events
    # Most of what is said is the heights of the tags, which pictures of the rest leave open.
    assert np.linalg.norm(true[-1] - goal) < min(one.said, 1e-3)
    assert one.said < 1.5e-3
    lag = 0.02 if by == "pose" else 0.0
    assert outcome.drive.cell.meter.delay == pytest.approx(0.06 + lag + TURN, abs=0.02)
    assert float(np.linalg.norm(true_point(cell, 1.0) - [0.15, 0.0])) < 1e-3  # it was brought back
    assert robot.released == 1
    settled = outcome.drive.events[0].time
    assert settled == pytest.approx(0.5, abs=0.1)
    poses = [(at, one) for at, one in robot.told if isinstance(one, ToolPose)]
    steps = [(other[0] - one[0], way_between(one[1], other[1])) for one, other in pairwise(poses)]
    assert max(way / max(time, 0.008) for time, way in steps) <= QUICK.limits.speed * (1.0 + 1e-6)


TURN = 0.008


@pytest.mark.slow
def test_a_drive_is_a_recording(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path), filmed=False)
    plan = planned(rec, [goal_of(), goal_of(force=(0.0, 0.15))], settings=replace(QUICK, rest=1.0))
    outcome, _ = driven(tmp_path, plan, setup_for(rec, holds=False, off=OFF))
    data = json.loads((tmp_path / SUMMARY).read_text(encoding="utf-8"))
    assert [one["reached"] for one in data["goals"]] == [True, True]
    assert data["plan"]["force_N"] == pytest.approx([0.0, 0.15], abs=1e-3)
    assert data["happened"][-1]["text"] == "the tool is back where it began, and the robot is free"
    with (tmp_path / TABLE).open(encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) > 100
    assert {row["goal"] for row in rows} == {"0", "1", "2"}
    made = observe(read_recording(tmp_path))
    assert len(made.time) >= len(rows)
    assert float(np.max(np.hypot(*made.force[made.loaded].T))) == pytest.approx(0.3, abs=0.05)
    assert outcome.recorded.film is not None


@pytest.mark.slow
def test_a_drive_is_learned_from(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path), filmed=False)
    plan = planned(rec, [goal_of()], settings=replace(QUICK, rest=2.0))
    driven(tmp_path, plan, setup_for(rec, holds=False))
    run = learn(tmp_path)
    assert run.posterior is not None
    band = run.posterior.stiffness.band(np.array([0.1, 0.3, 0.5]))
    true = np.asarray(model_of("linear").beam.stiffness(np.array([0.1, 0.3, 0.5])))
    assert np.all((band.low < true) & (true < band.high))


@pytest.mark.slow
def test_goals_in_time_are_passed_when_their_time_is_over(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    forces, times = [(0.0, 0.1), (-0.01, 0.2), FORCE], [1.0, 2.0, 3.0]
    wanted = [(time, np.array(goal_of(force=force))) for time, force in zip(times, forces, strict=True)]
    plan = make_plan(model_of("linear"), rec, wanted, stated_placement(rec), QUICK)
    assert [one.waits for one in plan.goals] == [False, False, True]
    outcome, cell = driven(tmp_path, plan, setup_for(rec, holds=False, sees=math.radians(60.0)))
    assert outcome.good, outcome.drive.events
    first, second, last = outcome.drive.outcomes
    assert [first.seconds, second.seconds] == pytest.approx([1.0, 1.0], abs=0.05)
    assert [math.isnan(one.said) for one in (first, second, last)] == [True, True, False]
    assert last.seconds > 1.0  # it waits until it is there
    assert np.linalg.norm(last.seen - wanted[-1][1]) < last.said
    assert cell.largest < QUICK.limits.force


@pytest.mark.slow
def test_a_drive_learns_k_meanwhile_and_goes_on_with_it(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    setup, true = setup_for(rec, holds=False, sees=math.radians(60.0)), model_of("linear").beam
    model = StoredModel(replace(true, stiffness=Scaled(1.25, true.stiffness)), None)
    settings = replace(QUICK, learn=True, rest=2.0, stay=2.0)
    plan = planned(rec, [goal_of(force=(0.0, 0.35)), goal_of(force=(-0.05, 0.45))], model, settings)
    outcome, _ = driven(tmp_path, plan, setup)
    assert outcome.good, outcome.drive.events
    said = [one.text for one in outcome.drive.events if "k(s) as learned now" in one.text]
    assert said, outcome.drive.events


class Stop:
    """Set after a time of the drive, once or twice."""

    def __init__(self, cell: VirtualCell, *moments: float) -> None:
        self.cell, self.moments = cell, moments

    def is_set(self) -> bool:
        return any(one < self.cell.time < one + 0.3 for one in self.moments)


@pytest.mark.slow
def test_a_stop_holds_and_releases_slowly(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    plan, robot = planned(rec, [goal_of()]), Noting(cell)
    outcome = drive_cell(tmp_path, plan, cell, robot=robot, stop=Stop(cell, 1.8))
    texts = [one.text for one in outcome.drive.events]
    assert texts[1:] == [
        "holds: stopped by hand",
        "releases slowly",
        "the tool is back where it began, and the robot is free",
    ]
    assert not outcome.drive.fault
    assert not outcome.good  # the goal was not reached
    assert 1.8 < robot.held_at < 1.95
    later = [one for at, one in robot.told if at > robot.held_at]
    first, last = later[0], later[-1]
    assert isinstance(first, ToolPose)
    assert isinstance(last, ToolPose)
    back = float(np.linalg.norm(first.position - last.position))
    assert back / (plan.settings.retreat * 0.008) <= len(later) + 1
    assert np.linalg.norm(true_point(cell, 1.0) - [0.15, 0.0]) < 1e-3


@pytest.mark.slow
def test_a_second_stop_lets_go_at_once(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    robot = Noting(cell)
    outcome = drive_cell(tmp_path, planned(rec, [goal_of()]), cell, robot=robot, stop=Stop(cell, 1.8, 2.3))
    texts = [one.text for one in outcome.drive.events]
    assert texts[1:] == ["holds: stopped by hand", "let go at once, as asked"]
    assert robot.released == 1
    assert all(at < 1.95 for at, _ in robot.told)


@pytest.mark.slow
def test_what_was_only_late_pauses_and_goes_on(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = FaultyCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    plan, robot = planned(rec, [goal_of()]), Noting(cell)
    moved: list[float] = []

    def watch(state: DriveState) -> None:
        if state.stage == "driving":
            moved.append(cell.time)
        if moved and cell.time > moved[0] + 0.6:
            cell.faults["camera"] = True
        if moved and cell.time > moved[0] + 1.1:
            cell.faults.clear()

    outcome = drive_cell(tmp_path, plan, cell, robot=robot, watch=watch)
    texts = [one.text for one in outcome.drive.events]
    assert texts[1].startswith("holds: no new picture came")
    assert texts[2].startswith("goes on after")
    assert outcome.good, texts
    (pause,) = outcome.drive.pauses
    assert 0.4 < pause < 1.0
    assert not [at for at, _ in robot.told if robot.held_at < at < robot.held_at + pause - 0.01]
    (one,) = outcome.drive.outcomes
    elapsed = outcome.drive.events[3].time - outcome.drive.events[0].time + plan.settings.stay
    assert one.seconds == pytest.approx(elapsed - pause, abs=0.05)  # the pause does not count
    assert np.linalg.norm(one.seen - np.array(goal_of())) < one.said


def test_a_computer_that_is_late_at_rest_moves_nothing(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0), fps=8.0))
    robot = Noting(cell)
    with pytest.raises(RecordingError, match=r"% of the time pictures or answers.*nothing moved"):
        drive_cell(tmp_path, planned(rec, [goal_of()], settings=replace(QUICK, rest=2.0)), cell, robot=robot)
    assert not robot.told


def made_drive(tmp_path: Path, **settings: Any) -> tuple[Drive, VirtualCell, Noting]:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = BlindCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    robot = Noting(cell)
    made = Drive(planned(rec, [goal_of()], settings=replace(QUICK, **settings)), robot, rec)
    return made, cell, robot


def test_nothing_moves_before_the_rest_was_seen(tmp_path: Path) -> None:
    made, _, robot = made_drive(tmp_path)
    made.open(PlayedClock())
    for _ in range(500):
        made.read(math.inf)
    assert made.state.stage == "waiting"
    assert not robot.told
    made.stop()
    made.read(math.inf)
    assert made.over
    assert made.events[-1].text == "stopped by hand"
    assert isinstance(made.read(math.inf), End)
    assert robot.released == 1


@pytest.mark.slow
def test_a_rest_without_tags_moves_nothing(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = FaultyCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    cell.faults["hidden"] = 2
    robot = Noting(cell)
    with pytest.raises(RecordingError, match="nothing moved"):
        drive_cell(tmp_path, planned(rec, [goal_of()]), cell, robot=robot, stop=Stop(cell, 3.0))
    assert not robot.told


@pytest.mark.slow
def test_a_camera_that_ends_before_anything_moved(tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, width=640), filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0)))

    class Unplugged(CellCamera):
        def read(self, wait: float) -> Any:
            return End("its cable was pulled", fault=True) if cell.time > 0.4 else super().read(wait)

    robot = Noting(cell)
    with pytest.raises(RecordingError, match=r"cable was pulled.*nothing moved"):
        drive_cell(tmp_path, planned(rec, [goal_of()]), cell, robot=robot, camera=Unplugged(cell))
    assert not robot.told


def test_a_step_keeps_its_length_and_its_turn() -> None:
    here = pose_of([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    there = pose_of([0.1, 0.24, 0.33, 0.0, 0.6, 0.0])
    size = way_between(here, there)
    assert size == pytest.approx(0.05)
    assert stepped(here, there, 1.0) is there
    some = stepped(here, there, 0.01)
    assert way_between(here, some) == pytest.approx(0.01)
    assert some.vector == pytest.approx([0.1, 0.208, 0.306, 0.0, 0.12, 0.0])
    only_turned = pose_of([0.1, 0.2, 0.3, 0.0, 0.0, 1.0])
    assert way_between(here, only_turned) == pytest.approx(0.05)  # as a place 50 mm beside it goes
