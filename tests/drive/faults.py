"""What goes wrong on a bench, put into a drive at a chosen moment."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from onebend.drive.plan import Hand
from onebend.drive.robots import ArmState, Skill, ToolForce, ToolPose
from onebend.drive.run import DriveOutcome
from onebend.live.sources import Clock, End, Frame, PlayedClock
from onebend.recording.folder import read_recording
from onebend.recording.video import Picture
from tests.drive.cells import (
    QUICK,
    CellCamera,
    CellRobot,
    FaultyCell,
    described,
    drive_cell,
    model_of,
    planned,
    setup_for,
)

OFF = (0.002, -0.001, 0.001)  # rad, of the robot's axes
LIMIT_OVER_PLAN = 2.0  # the force that is allowed, over the planned one


@dataclass(frozen=True)
class Injected:
    """One fault: what, and when after the first motion [s]."""

    kind: str
    after: float
    seed: int = 0
    hand: Hand = "hold"
    by: Skill = "pose"


SAYS = {  # words of the message
    "frozen": "no new picture came",
    "no pictures": "no new picture came",
    "late": "no new picture came",
    "unplugged": "its cable was pulled",
    "hidden": "the point is not seen any more: tag . is hidden",
    "swapped": "the point is not seen any more: tag .*(jumped|from where|hidden)",
    "stuck": "the force sensor is stuck",
    "flipped": "under the force that is felt|N will be on the beam",
    "silent": "answers no more",
    "raises": "answers no more",
    "deaf": "answers no more",
    "cut": "answers no more|no new picture",
    "slow": "one turn of the loop took",
    "cracked": "jumped|from where the model has it|under the force that is felt|no stable shape",
    "slipped": "jumped|from where the model has it|under the force that is felt",
}
BY_PICTURE = {"hidden", "swapped"}  # what pictures alone can tell: known when one comes that was taken then
PASSES = {"slow"}  # it was only late, and goes on
DEAD = {"silent", "raises", "deaf", "cut"}  # the robot cannot be told to hold


class FaultyClock(PlayedClock):
    """It may jump, as when another program had the processor."""

    jump_at = math.inf

    def wait_until(self, moment: float) -> None:
        if moment >= self.jump_at:
            moment, self.jump_at = moment + 0.15, math.inf
        super().wait_until(moment)


class FaultyRobot(CellRobot):
    """A robot that fails at a moment."""

    cell: FaultyCell

    def __init__(self, cell: FaultyCell, fault: Injected) -> None:
        super().__init__(cell)
        self.fault, self.begun, self.fails_at = fault, math.nan, math.inf
        self.told_to_hold = math.nan
        self.kept: ArmState | None = None

    def connect(self, clock: Clock) -> None:
        super().connect(clock)
        self.clock = clock

    @property
    def failing(self) -> bool:
        return self.clock.now() >= self.fails_at - 1e-9

    def state(self) -> ArmState:
        state = super().state()
        if self.failing and not self.cell.faults.get("done"):
            self._fail()
        if self.failing and self.fault.kind in ("silent", "cut"):
            assert self.kept is not None
            return self.kept
        if self.failing and self.fault.kind == "raises":
            raise ConnectionError("timed out")
        self.kept = state
        return state

    def command(self, wanted: ToolPose | ToolForce) -> None:
        if math.isnan(self.begun):
            self.begun = self.clock.now()
            self.fails_at = self.begun + self.fault.after
            if self.fault.kind == "slow":
                self.clock.jump_at = self.fails_at  # type: ignore[attr-defined]
        if self.failing and self.fault.kind == "deaf":
            raise ConnectionError("it does not take servoL")
        if not (self.failing and self.fault.kind in ("silent", "cut")):
            super().command(wanted)

    def hold(self) -> None:
        if math.isnan(self.told_to_hold):
            self.told_to_hold = self.clock.now()
        if self.failing and self.fault.kind in DEAD:
            raise ConnectionError("no answer")
        super().hold()

    def _fail(self) -> None:
        cell, kind = self.cell, self.fault.kind
        cell.faults["done"] = True
        if kind in ("no pictures", "cut"):
            cell.faults["camera"] = True
        elif kind == "late":
            cell.faults["late"] = 0.2
        elif kind == "hidden":
            cell.faults["hidden"] = 2
        elif kind in ("swapped", "stuck", "flipped"):
            cell.faults[kind] = cell.wrench[:2].copy()
        elif kind == "cracked":
            cell.faults["softer"] = 0.3
        elif kind == "slipped":
            cell.slip()


class FaultyCamera(CellCamera):
    """A camera that fails when the robot says so."""

    def __init__(self, cell: FaultyCell, robot: FaultyRobot) -> None:
        super().__init__(cell)
        self.robot, self.exposed_after = robot, math.inf
        self.last: Picture | None = None
        self.arrivals = [0.0]  # s, of pictures that were new

    def read(self, wait: float) -> Frame | End | None:
        got = super().read(wait)
        if not isinstance(got, Frame):
            return got
        failing = got.arrival >= self.robot.fails_at
        if failing and self.robot.fault.kind == "unplugged":
            return End(f"{self.name} is gone: its cable was pulled", fault=True)
        if failing and self.robot.fault.kind == "frozen" and self.last is not None:
            return replace(got, picture=self.last)
        self.last = got.picture
        if got.stamp >= self.robot.fails_at and self.exposed_after == math.inf:
            self.exposed_after = got.arrival
        self.arrivals.append(got.arrival)
        return got


@dataclass(frozen=True)
class Suffered:
    """How a drive took a fault."""

    fault: Injected
    outcome: DriveOutcome
    cell: FaultyCell
    limit: float  # N
    hold_after: float  # s, from when it could be known to the order to hold
    folder: Path

    @property
    def message(self) -> str:
        """The first thing that was wrong."""
        events = self.outcome.drive.events
        return next((one.text for one in events if one.fault or one.text.startswith("holds: ")), "")

    @property
    def ended(self) -> bool:
        """Whether it ended as it should: as a fault, or on its goal after a pause."""
        made = self.outcome.drive
        as_said = self.outcome.good and len(made.pauses) == 1 if self.fault.kind in PASSES else made.fault
        return made.over and as_said


def suffer(folder: Path, fault: Injected) -> Suffered:
    """Drive to a goal, with this fault on the way."""
    rng = np.random.default_rng([fault.seed, 5])
    at_s = 1.0 if fault.hand == "hold" or fault.kind == "hidden" else float(rng.choice([0.6, 0.8, 1.0]))
    rec = read_recording(described(folder, at_s=at_s, width=640), filmed=False)
    beam = model_of("linear").beam
    turn, size = math.radians(rng.uniform(75.0, 105.0)) * rng.choice([-1.0, 1.0]), rng.uniform(0.5, 1.1)
    force = 0.35 * size / at_s**2 * np.array([math.cos(turn), math.sin(turn)])
    goal = beam.equilibrium(force, at_s).xy(at_s).reshape(2)
    limit = LIMIT_OVER_PLAN * float(np.hypot(*force))
    settings = replace(
        QUICK, hand=fault.hand, by=fault.by, rest=0.4, stay=0.4, limits=replace(QUICK.limits, force=limit)
    )  # fmt: skip
    plan = planned(rec, [(float(goal[0]), float(goal[1]))], settings=settings, at_s=at_s, point_s=at_s)
    setup = setup_for(rec, holds=fault.hand == "hold", at_s=at_s, seed=fault.seed, sees=math.radians(60.0), off=OFF)
    cell = FaultyCell(setup)
    robot = FaultyRobot(cell, fault)
    camera, clock = FaultyCamera(cell, robot), FaultyClock()
    more: dict[str, Any] = {"robot": robot, "camera": camera, "clock": clock}
    outcome = drive_cell(folder, plan, cell, **more)
    known = robot.fails_at
    if fault.kind in BY_PICTURE:
        known = camera.exposed_after
    elif fault.kind in ("frozen", "no pictures", "late", "unplugged"):
        known = max(one for one in camera.arrivals if one <= robot.told_to_hold)
    elif fault.kind in ("cracked", "slipped"):
        known = max(camera.exposed_after, robot.fails_at)
    elif fault.kind == "slow":
        known = robot.fails_at + 0.15
    return Suffered(fault, outcome, cell, limit, robot.told_to_hold - known, folder)
