"""One drive, from the plan to the folder of its recording: what `onebend drive --go` does."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.control.loop import Controller, controller
from onebend.drive.machine import Drive, DriveState
from onebend.drive.plan import DrivePlan, plan_data
from onebend.drive.robots import Robot
from onebend.drive.watching import LED
from onebend.errors import OnebendError, RecordingError
from onebend.files.single_file import write_file
from onebend.live import guidance, live, recording_folder, session
from onebend.live.sources import CameraSource, Clock, End, ForceSource, Frame
from onebend.progress import interrupts_held, leave_interrupts_to_parent, real_time
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.recording.tags import TrackedFrame
from onebend.records import Array
from onebend.text_files import to_json

TABLE, SUMMARY = "drive.csv", "drive.json"
COLUMNS = (
    *("time_s", "goal", "x_m", "y_m", "distance_m", "asked_x_N", "asked_y_N", "felt_x_N", "felt_y_N"),
    *("tool_x_m", "tool_y_m", "delay_s"),
)
_FORMATS = ("%.6f", "%d", *("%.7g",) * 10)
LEARNED_CHANGE = 0.03  # of k, on average: less, or less than 2 sd, is not worth a new plan
LEARNED_EVERY = 3.0  # s


@dataclass(frozen=True)
class DriveOutcome:
    """What a drive left."""

    recorded: guidance.CaptureOutcome
    drive: Drive
    data: dict[str, Any]  # as in drive.json

    @property
    def good(self) -> bool:
        """Whether every goal was reached and nothing went wrong."""
        return not self.drive.fault and bool(self.data["reached"])


class _Watched:
    """A camera whose end is the drive's business: the film goes on until the tool is back."""

    def __init__(self, camera: CameraSource, drive: Drive) -> None:
        self.name, self.timing, self._camera, self._drive = camera.name, camera.timing, camera, drive
        self._ended = False
        self._clock: Clock | None = None

    def open(self, clock: Clock) -> None:
        self._clock = clock
        self._camera.open(clock)
        self.timing = self._camera.timing

    def close(self) -> None:
        self._camera.close()

    def due(self) -> float:
        return math.inf if self._ended else float(self._camera.due())  # type: ignore[attr-defined]

    def read(self, wait: float) -> Frame | End | None:
        assert self._clock is not None
        if not self._ended:
            got = self._camera.read(wait)
            if isinstance(got, Frame):
                got = self._drive.cell.came(got, self.timing)
            if not isinstance(got, End) or self._drive.state.stage == "waiting":
                return got
            self._ended = True
            self._drive.cell.camera_ended = got.why
        if self._drive.over:
            return End("the drive is over")
        self._clock.wait_until(self._clock.now() + min(wait, 0.05))
        return None


def drive(
    folder: Path, plan: DrivePlan, camera: CameraSource, robot: Robot, sensor: ForceSource | None = None, *,
    watch: Callable[[DriveState], None] = lambda _: None, stop: guidance.Stop | None = None, clock: Clock | None = None,
    beside: bool = True, overwrite: bool = False, setup: float = 1.0,
) -> DriveOutcome:  # fmt: skip
    """Drive, and record into `folder`, which holds a recording.toml.

    Args:
        stop: set from anywhere: hold, and release slowly; set anew: let go at once.
        clock: None: this machine's.
        beside: False: all in this process, as tests on a played clock want it.
        setup: s for which the picture must be good before the film begins.

    Raises:
        RecordingError: it ended before anything moved.
    """
    rec = read_recording(folder, filmed=False)
    if rec.push is not None and rec.push.at != plan.push_s:
        recording_folder.state_values(folder, "push", {"at_s": f"{plan.push_s:.6g}"})
        rec = read_recording(folder, filmed=False)
    made = Drive(plan, robot, rec, sensor, watch)
    over, table = threading.Event(), _DriveTable(folder / TABLE, made, overwrite=overwrite)

    def now_and_then(state: guidance.CaptureState) -> None:
        was, pressed[0] = pressed[0], stop is not None and stop.is_set()
        if pressed[0] and not was:
            made.stop()
        if learner is not None:
            learner.go_on(state.seconds)
        if made.over:
            over.set()

    pressed = [False]
    settings = guidance.CaptureSettings(
        ends=False, setup=setup, share=0.0, rest=plan.settings.rest, follow=False, overwrite=overwrite,
        longest=1e5, most_waiting=0,
    )  # fmt: skip
    learner = Renewer(made, rec, settings, beside=beside) if plan.settings.learn else None
    try:
        with real_time() if clock is None else nullcontext():
            recorded = session.record(
                folder, _Watched(camera, made), made, settings, now_and_then, over, clock=clock, tags=table.see,
                follower=learner,
            )  # fmt: skip
    finally:
        table.close()
        if learner is not None:
            learner.close()
    data = drive_data(plan, made)
    if not made.moved:
        why = made.events[-1].text if made.events else recorded.why
        raise RecordingError(f"{why.rstrip('.')}: nothing moved")
    write_file(folder / SUMMARY, to_json(data), overwrite=True)
    return DriveOutcome(recorded, made, data)


def drive_data(plan: DrivePlan, made: Drive) -> dict[str, Any]:
    """What drive.json holds, SI."""
    latency, turns, state, meter = np.array(made.latency), np.array(made.turns), made.state, made.cell.meter
    goals = [
        {
            "goal_m": one.goal.tolist(), "reached": one.reached, "seconds": one.seconds, "seen_m": one.seen.tolist(),
            "off_m": float(np.linalg.norm(one.seen - one.goal)), "said_within_m": one.said,
            "asked_N": one.force.tolist(), "felt_N": one.felt.tolist(),
        }
        for one in made.outcomes
    ]  # fmt: skip
    return {
        "format": "onebend-drive-1",
        "plan": plan_data(plan),
        "reached": len(goals) == len(plan.goals) and all(one["reached"] for one in goals),
        "fault": made.fault,
        "goals": goals,
        "happened": [{"time_s": one.time, "text": one.text, "fault": one.fault} for one in made.events],
        "delay_s": state.delay,
        "delay_sd_s": meter.sd,
        "picture_to_command_s": _middle_and_worst(latency),
        "turn_s": _middle_and_worst(turns),
        "pauses_s": made.pauses,
    }


def _middle_and_worst(values: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return {"median": float(np.median(values)), "p99": float(np.quantile(values, 0.99)), "count": len(values)}


class _DriveTable:
    """drive.csv: a row a picture that is driven by."""

    def __init__(self, path: Path, made: Drive, *, overwrite: bool) -> None:
        self._path, self._drive = path, made
        if path.exists() and not overwrite:
            raise RecordingError(f"{path} is there already. Drive into another folder, or add --overwrite.")
        self._table: recording_folder.GrowingTable | None = None

    def see(self, frame: Frame, time: float, corners: Array) -> None:
        made, state = self._drive, self._drive.state
        made.cell.see(frame, time, corners)
        if state.stage == "waiting":
            return
        if self._table is None:
            self._path.unlink(missing_ok=True)
            self._table = recording_folder.GrowingTable(self._path, COLUMNS)
        goal = [float(len(made.outcomes)), *state.point, state.distance, *state.asked, *state.felt]
        self._table.add(np.array([[time, *goal, *made.cell.tool, state.delay]]), _FORMATS)
        if self._table.rows % 30 == 0:
            self._table.flush()

    def close(self) -> None:
        if self._table is not None:
            self._table.close()


# k(s), learned while driving from what the tags and the sensor show, and a new controller by it. All of it is done in a
# process beside this one: it takes seconds at a time.

_REVIEWS = live.LiveSettings(least_apart=3.0, review_growth=1.5)  # for some seconds each no frame is learned from


class _Learner:
    """k(s) so far, and controllers by it."""

    def __init__(self, plan: DrivePlan, rec: Recording, error: float) -> None:
        """The clock of the force is that of the film to `error` [s]."""
        self.live = live.Live(rec, clock=(0.0, error), settings=_REVIEWS, beside=False)
        self._plan = plan

    def renewed(self, goal: Array, force: Array, old: Beam) -> tuple[Controller, float] | None:
        """The loop to the goal (2,) m by k(s) as it is known now, from the force (2,) N that holds the `old` beam where
        it is, and by what factor k(s) grew; None where it is not known to, or where this beam cannot be led there."""
        known, plan, control = self.live.state(), self._plan, self._plan.goals[0].control
        if known.stiffness is None or known.verdict.grade == "not to be trusted":
            return None
        beam = replace(old, stiffness=known.stiffness.profile)
        s = plan.push_s * np.linspace(0.0, 1.0, 41)
        weights = (plan.push_s - s) ** 2 / np.sum(
            (plan.push_s - s) ** 2
        )  # as a force across the straight beam bends it
        ratio = np.asarray(beam.stiffness(s)) / np.asarray(old.stiffness(s))
        stiffer = float(np.exp(weights @ np.log(ratio)))
        sd = math.sqrt(weights @ known.stiffness.log_covariance(s) @ weights + known.stiffness.gain_sd**2)
        if abs(math.log(stiffer)) < max(LEARNED_CHANGE, 2.0 * sd):
            return None
        try:
            made = controller(
                beam, goal, push_s=plan.push_s, point_s=plan.point_s, gravity=plan.gravity, start=stiffer * force,
                settings=replace(control.settings, gains=control.gains),
            )  # fmt: skip
        except OnebendError:
            return None
        return made, stiffer


class Renewer(session.Follower):
    """Finds the tags, tells a learner, and the drive how to go on."""

    def __init__(self, made: Drive, rec: Recording, settings: guidance.CaptureSettings, *, beside: bool) -> None:
        """`beside`: the learner has a process of its own."""
        super().__init__(rec, settings)
        self._drive, self._next, self._asked = made, 0.0, False
        self._learner: _Learner | None = None
        self._process: BaseProcess | None = None
        context = get_context("spawn")
        self._told, self._made = context.Queue(), context.Queue()  # a thread fills them: no turn waits
        if beside:
            self._process = context.Process(target=_learn, args=(made.plan, self._told, self._made), daemon=True)
            with interrupts_held():
                self._process.start()

    def begin(self, error: float) -> None:
        super().begin(error)
        if self._process is None:
            self._learner = _Learner(self._drive.plan, self.rec, error)
        else:
            self._told.put((self.rec, error))

    def frame(self, frame: Frame, time: float) -> TrackedFrame | None:
        seen = super().frame(frame, time)
        if seen is not None:
            self._tell("tracked", seen)
        return seen

    def force(self, time: Array, force: Array, place: Array | None) -> None:
        if len(time):
            self._tell("force", time, force, place)

    def go_on(self, now: float) -> None:
        """Take the controller that was made, and ask for another; `now` [s]."""
        with suppress(Empty):
            while self._asked:
                made, self._asked = self._made.get_nowait(), False
                if made is not None:
                    self._drive.renew(*made)
        state = self._drive.state
        if state.stage in LED and not self._asked and now >= self._next:
            self._next, self._asked = now + LEARNED_EVERY, True
            self._tell("renewed", state.goal, state.asked, state.control.beam)

    def _tell(self, what: str, *values: Any) -> None:
        if self._learner is None:
            self._told.put((what, values))
        else:
            _obey(self._learner, what, values, self._made)

    def close(self) -> None:
        super().close()
        if self._process is not None:
            self._told.cancel_join_thread()
            self._process.kill()


def _learn(plan: DrivePlan, told: Queue[Any], made: Queue[tuple[Controller, float] | None]) -> None:
    """The process."""
    leave_interrupts_to_parent()
    learner = _Learner(plan, *told.get())
    while True:
        what, values = told.get()
        _obey(learner, what, values, made)


def _obey(learner: _Learner, what: str, values: tuple[Any, ...], made: Queue[tuple[Controller, float] | None]) -> None:
    if what == "renewed":
        made.put(learner.renewed(*values))
    else:
        getattr(learner.live, what)(*values)
