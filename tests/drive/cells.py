"""A virtual bench to drive on: its recording.toml, the push to learn its beam from, and drives on a played clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.drive.placing import Placement, stated_placement
from onebend.drive.plan import DriveLimits, DrivePlan, DriveSettings, make_plan
from onebend.drive.robots import ArmState, Robot, Skill, ToolForce, ToolPose
from onebend.drive.run import DriveOutcome, drive
from onebend.drive.virtual import VirtualCell, VirtualSetup
from onebend.lab.bench import PushProfile
from onebend.lab.bench_camera import BenchCamera
from onebend.lab.designs import find_design
from onebend.lab.filming import between_places, shapes_at
from onebend.lab.random_bench import FilmRequest, filming_of
from onebend.live.force_sensors import TOOL, WRENCH
from onebend.live.guidance import CaptureSettings
from onebend.live.session import record
from onebend.live.sources import CameraSource, Clock, End, Frame, PlayedClock, Samples, StampTiming
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.recording.video import Picture
from onebend.records import Array
from onebend.results.model import StoredModel

# The robot and the camera of a cell in this process, on any clock.


class CellRobot:
    """The robot of a cell."""

    can: frozenset[Skill] = frozenset(("pose", "force"))
    timing = StampTiming(delay=0.0, delay_error=0.005)

    def __init__(self, cell: VirtualCell, name: str = "the virtual robot") -> None:
        self.cell, self.name = cell, name
        self.held_at = math.nan  # s, when it was last told to hold
        self._clock: Clock | None = None

    def connect(self, clock: Clock) -> None:
        self._clock = clock

    def state(self) -> ArmState:
        assert self._clock is not None
        self.cell.advance(self._clock.now())
        return self.cell.state()

    def command(self, wanted: ToolPose | ToolForce) -> None:
        self.cell.command(wanted)

    def hold(self) -> None:
        self.held_at = self.cell.time
        self.cell.command(None)

    def release(self) -> None:
        self.cell.command(None)

    def close(self) -> None:
        """Nothing is held."""


class CellCamera:
    """The camera of a cell; a played source."""

    timing = StampTiming(host=True, delay=0.0, delay_error=0.005)

    def __init__(self, cell: VirtualCell, name: str = "the virtual camera") -> None:
        self.name, self._cell = name, cell
        self._clock: Clock | None = None
        self._count = -1

    def open(self, clock: Clock) -> None:
        self._clock = clock

    def close(self) -> None:
        """Nothing is held."""

    def due(self) -> float:
        """When the next picture comes; while none is on its way, the moment at which one may be."""
        if self._cell.frames:
            return self._cell.frames[0][0]
        return self._cell.time + self._cell.setup.delay

    def read(self, wait: float) -> Frame | End | None:
        assert self._clock is not None
        until = min(self.due(), self._clock.now() + wait)
        self._clock.wait_until(until)
        self._cell.advance(self._clock.now())
        if not self._cell.frames or self._cell.frames[0][0] > self._clock.now() + 1e-9:
            return None
        due, exposed, draw = self._cell.frames.popleft()
        self._count += 1
        return Frame(draw(), exposed, max(due, self._clock.now()), self._count)


class BlindEye(BenchCamera):
    """It draws nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def picture(self, poses: Array, force: Array, time: float) -> Picture:  # noqa: ARG002
        return np.zeros((1, 1), np.uint8)


class BlindCell(VirtualCell):
    """A cell that no picture is looked at of."""

    eye = BlindEye


class FaultyEye(BenchCamera):
    """It shows what happened to tags: "swapped", the last two; "hidden", the number of one that is covered."""

    faults: Mapping[str, Any] = MappingProxyType({})

    def faces(self, poses: Array) -> Array:
        tags = super().faces(poses)
        if "swapped" in self.faults:
            tags[[-1, -2]] = tags[[-2, -1]]
        return tags

    def picture(self, poses: Array, force: Array, time: float) -> Picture:
        y = super().picture(poses, force, time)
        if "hidden" in self.faults:
            self._cover(y, self.faces(poses)[1 + int(self.faults["hidden"])])
        return y

    def _cover(self, y: Picture, tag: Array) -> None:
        """Something dull lies on a tag."""
        view = self._staged.view
        inside = view.rotation @ np.array([tag[0], tag[1], 0.0]) + view.translation
        px = view.matrix[:2, :2] @ (inside[:2] / inside[2]) + view.matrix[:2, 2]
        half = 0.9 * view.matrix[0, 0] * self._filming.tag_size / inside[2]
        left, top, right, bottom = (max(int(v), 0) for v in (*(px - half), *(px + half)))
        y[top:bottom, left:right] = 100


class FaultyCell(VirtualCell):
    """A cell to which things happen: those of its eye; "camera", no pictures; "late", so many s; "stuck" and "flipped",
    the force; "softer", the beam by this factor."""

    eye = FaultyEye

    def __init__(self, setup: VirtualSetup) -> None:
        self.faults: dict[str, Any] = {}
        self._said = ArmState(math.nan, ToolPose(np.zeros(3), np.eye(3)), np.zeros(6))
        super().__init__(setup)

    def state(self) -> ArmState:
        if "stuck" in self.faults:
            return replace(self._said, stamp=self.time, pose=self._tool())
        self._said = super().state()
        return self._said

    def sensed(self) -> Array:
        if "stuck" in self.faults:
            return np.asarray(self.faults["stuck"])
        return -self.wrench[:2] if "flipped" in self.faults else self.wrench[:2]

    def _bent(self, wrench: Array, angle: Array) -> tuple[Array, Array]:
        whole = self._cells
        self._cells = replace(whole, joint=self.faults.get("softer", 1.0) * whole.joint)
        try:
            return super()._bent(wrench, angle)
        finally:
            self._cells = whole

    def _expose(self) -> None:
        super()._expose()
        due, exposed, draw = self.frames.pop()
        eye, faults = self._camera, dict(self.faults)
        assert isinstance(eye, FaultyEye)

        def drawn() -> Picture:
            eye.faults = faults
            return draw()

        if "camera" not in faults:
            self.frames.append((due + faults.get("late", 0.0), exposed, drawn))


LENGTH, SIZE = 0.15, 0.012
TOML = """format = 1
[beam]
length_m = {length}
[tags]
size_m = {size}
placement_sd_m = 0.0003
on_base = [{{ id = 0, s = 0.0 }}]
on_beam = [{{ id = 1, s = 0.333333 }}, {{ id = 2, s = 0.666667 }}, {{ id = 3, s = 1.0 }}]
[camera]
width = {width}
height = {height}
fx = {focal}
fy = {focal}
cx = {cx}
cy = {cy}
dist = [-0.06, 0.02, 0.0004, -0.0003]
[video]
file = "video.mp4"
[force]
file = "force.csv"
columns = ["time_s", "fx_N", "fy_N"]
gain_sd = 0.01
[push]
at_s = {at_s}
"""


def described(folder: Path, *, at_s: float = 1.0, width: int = 800) -> Path:
    """A folder with a recording.toml alone."""
    folder.mkdir(parents=True, exist_ok=True)
    height = 2 * round(9 * width / 32)
    text = TOML.format(
        length=LENGTH, size=SIZE, width=width, height=height, focal=0.94 * width, cx=(width - 1) / 2,
        cy=(height - 1) / 2, at_s=at_s,
    )  # fmt: skip
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return folder


def setup_for(
    rec: Recording, design: str = "linear", *, holds: bool = True, at_s: float = 1.0, **more: Any
) -> VirtualSetup:
    """The bench of a design's beam."""
    bench = filming_of(find_design(design), FilmRequest(), design).bench
    return VirtualSetup(replace(bench, push=replace(bench.push, at_s=at_s)), rec, holds=holds, **more)


@dataclass
class ScriptedPush:
    """A robot that leads its tool along a way: to the recorder a force sensor, as a drive is."""

    robot: Robot
    way: Array  # (T, 2) m in the beam's frame, `period` apart
    place: Placement
    columns: tuple[str, ...] = (*WRENCH, *TOOL)
    period: float = 0.008
    at: int = -1

    def __post_init__(self) -> None:
        self.name, self.timing = self.robot.name, self.robot.timing

    def open(self, clock: Clock) -> None:
        self.clock = clock
        self.robot.connect(clock)
        self.next = clock.now()

    def close(self) -> None:
        self.robot.close()

    def due(self) -> float:
        return self.next if self.at < len(self.way) else math.inf

    def read(self, wait: float) -> Samples | End | None:
        if self.at >= len(self.way):
            return End("the push is over")
        if self.next > self.clock.now() + wait:
            self.clock.wait_until(self.clock.now() + wait)
            return None
        self.clock.wait_until(self.next)
        self.next += self.period
        state = self.robot.state()
        if self.at < 0:
            self.start, self.at = state.pose, 0
        away = self.place.rotation[:, :2] @ (self.way[self.at] - self.way[0])
        self.robot.command(ToolPose(self.start.position + away, self.start.rotation))
        self.at += 1
        return Samples(np.array([state.stamp]), np.append(state.wrench, state.pose.vector)[None], self.clock.now())


def way_of(beam: Beam, push: PushProfile, period: float = 0.008) -> Array:
    """(T, 2) m of the pushed point."""
    poses = shapes_at(beam, push, np.arange(0.0, push.duration, period))
    return between_places(poses, np.array([push.at_s]))[:, 0, :2]


def recorded_push(
    folder: Path, setup: VirtualSetup, *, robot: Robot | None = None, camera: CameraSource | None = None,
    clock: Clock | None = None,
) -> Path:  # fmt: skip
    """The push of the bench made by its robot, the end free to turn, and recorded into `folder`."""
    push = replace(setup.bench.push, before=1.8, rise=2.5, hold=0.3, fall=2.2, after=1.8)
    if robot is None:
        cell = VirtualCell(replace(setup, holds=False))
        robot, camera, clock = CellRobot(cell), CellCamera(cell), PlayedClock()
    assert camera is not None
    rec = read_recording(folder, filmed=False)
    source = ScriptedPush(robot, way_of(setup.bench.beam, push), stated_placement(rec))
    settings = CaptureSettings(follow=False, setup=0.2, rest=1.0, tare=0.3, least_rest=0.4)
    record(folder, camera, source, settings, clock=clock)
    return folder


@cache
def model_of(design: str) -> StoredModel:
    """A model that is the design's own beam, without a band."""
    return StoredModel(filming_of(find_design(design), FilmRequest(), design).bench.beam, None)


QUICK = DriveSettings(rest=0.5, stay=0.3, limits=DriveLimits(force=1.2, curvature=60.0, speed=0.06))


def planned(
    rec: Recording, goals: list[tuple[float, float]], model: StoredModel | None = None,
    settings: DriveSettings = QUICK, *, at_s: float = 1.0, point_s: float = 1.0, place: Placement | None = None,
) -> DrivePlan:  # fmt: skip
    """A plan for these goals, one after the other."""
    wanted = [(math.nan, np.array(goal)) for goal in goals]
    return make_plan(
        model or model_of("linear"), rec, wanted, place or stated_placement(rec), settings, push_s=at_s, point_s=point_s
    )


def driven(folder: Path, plan: DrivePlan, setup: VirtualSetup, **more: Any) -> tuple[DriveOutcome, VirtualCell]:
    """Drive a cell on a played clock."""
    cell = VirtualCell(setup)
    return drive_cell(folder, plan, cell, **more), cell


def drive_cell(folder: Path, plan: DrivePlan, cell: VirtualCell, **more: Any) -> DriveOutcome:
    given: dict[str, Any] = {"clock": PlayedClock(), "beside": False, "setup": 0.15} | more
    robot, camera = given.pop("robot", CellRobot(cell)), given.pop("camera", CellCamera(cell))
    return drive(folder, plan, camera, robot, **given)


def true_point(cell: VirtualCell, s: float) -> Array:
    """(2,) m, where the true beam has a point now."""
    at = int(np.argmin(np.abs(cell.edges - s)))
    return cell.poses[at, :2].copy()
