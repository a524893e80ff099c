"""What a drive knows in each turn of its loop, and what of that is late or wrong.

A `Cell` asks robot, force sensor and camera, and gives a `Turn`: all that is known now. `late` and `wrong` hold a turn
against the plan and the model, and say in words what is amiss.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from onebend.beam.model import Beam
from onebend.control.loaded_beam import trace
from onebend.drive.placing import Placement
from onebend.drive.plan import DrivePlan
from onebend.drive.robots import ArmState, Robot
from onebend.drive.seeing import BentModel, DelayMeter, Eye, SeenBeam, point_between
from onebend.errors import OnebendError
from onebend.live.force_sensors import TOOL, WRENCH
from onebend.live.sources import Clock, End, ForceSource, Frame, Samples, StampTiming
from onebend.recording.entries import Recording
from onebend.recording.video import Picture
from onebend.records import Array

Stage = Literal["waiting", "driving", "staying", "returning", "holding", "releasing", "resting", "done"]
LED: tuple[Stage, ...] = ("driving", "staying")  # stages in which the beam is led by what is seen
GOING: tuple[Stage, ...] = (*LED, "returning", "releasing")  # stages in which the tool is moved

SILENCE = 0.084  # s without a new picture, a sight of the point, or an answer: with a turn or two of the loop 0.1 s
SLOW_LOOP = 0.1  # s of one turn
DOUBT = 5.0  # sds: a force, or a tag, that is farther from the model than this is a fault
IN_A_ROW, LATELY = 3, 10  # turns for which a force must be so; that tell its trend
AHEAD = 0.05  # s: what a robot takes to stop
NEAR_START = 0.005  # m by which the tool may be off the beam's place where it is to touch
LONGEST_REST = 2.0  # times as long as asked for, where little was seen
FEWEST_AT_REST = 10  # pictures, and rows of the force
MOST_LATE = 0.2  # of the turns at rest: where more are late nothing moves
SHORTEST = 0.02  # of the way to the shape under a felt force: a shorter step has met an end
CONTACT = 5e-4  # m, by which the tool's place may be off the beam's
ASKEW = {"push": 0.3, "hold": 1.0}  # of the variance of a wrong k: it turns the force, too, and makes a moment
FACTORS = (0.8, 1.25, 0.65, 1.55, 0.5, 2.0)  # of all of k
SLACK = 2e-3  # m: nearer than this no tag is doubted
JUMP = 4.0  # times the tool's largest speed: no place of the beam goes faster
UNKNOWN = np.full(2, np.nan)


@dataclass(frozen=True)
class Turn:
    """What is known in one turn. Moments are in s, of this machine's clock; NaN and infinity: never yet."""

    now: float
    took: float = 0.0  # s since the turn before began
    arm: ArmState | None = None  # what the robot said last
    answered: float = math.inf  # when that was new
    silent: str = ""  # why it, or the sensor, says nothing
    felt: tuple[Array, ...] = ()  # the last LATELY of (3,) N, N, s
    changed: float = math.inf  # when the sensor gave another number than before
    pictured: float = -math.inf  # arrival of the newest picture that is not the one before
    sighted: float = math.inf  # when a picture last showed the beam where it may be
    refused: str = ""  # why what the newest picture shows cannot be
    arrival: float = math.nan  # of the picture to be used in this turn
    point: Array = field(default_factory=UNKNOWN.copy)  # (2,) m, seen in it
    point_sd: float = math.nan  # m

    @property
    def force(self) -> Array:
        """(2,) N, felt."""
        return self.felt[-1][:2] if self.felt else UNKNOWN


class Cell:
    """Robot, force sensor and camera, and the model of the beam between them. Pictures come from another thread."""

    def __init__(self, plan: DrivePlan, robot: Robot, rec: Recording, sensor: ForceSource | None) -> None:
        """`sensor`: measures the force instead of the robot."""
        self.plan, self.robot = plan, robot
        self.columns = (*WRENCH, *TOOL) if sensor is None else sensor.columns
        self.period = 1.0 / plan.settings.rate
        self.meter = DelayMeter(plan.settings.delay)
        self.place: Placement = plan.placement
        self.k_sd = -math.log(1.0 - plan.settings.k_error) / 3.0  # of log k
        self.settled = False  # whether the rest was read
        self.unfit = self.camera_ended = ""  # why nothing may move; why no picture will come
        self._rec, self._sensor = rec, sensor
        self._tags = len(rec.tags.on_beam)
        self._s = np.array([*(tag.s for tag in rec.tags.on_beam), plan.point_s, plan.push_s])
        self.model = self.model_of(plan.model.beam)
        self.rest = self.model.poses()  # (m + 2, 3) m, m, rad: the tags, the point, the pushed place
        self.eye = Eye(rec, self.rest[: self._tags])
        assert rec.force is not None
        self._wanted = [self.columns.index(name) for name in rec.force.columns[1:]]
        known = None if plan.model.bench is None else plan.model.bench.force
        self.force_sd = math.nan if known is None else math.hypot(known.level, known.coloured, known.frame, known.load)
        self.film = (math.nan, math.nan)  # arrival and film time of the newest picture
        self.turn = Turn(0.0)
        self.same_at_rest, self.doubted = 0.0, 0  # s that the force stood still; turns for which it was doubted
        self._begun = math.nan  # arrival of the film's first picture
        self._late: list[bool] = []  # whether anything was, in each turn of the rest
        self._raw: list[Array] = []  # (2,) N of the rest; then the newest
        self._tare = np.zeros(2)
        self._seen: deque[SeenBeam] = deque()
        self._before: SeenBeam | None = None
        self._shapes: list[tuple[float, Array]] = []  # what the model had at its places
        self._coarse: Picture | None = None
        self._pictured, self._way_here = -math.inf, math.inf  # the last, s: the shortest from a stamp to its arrival
        self.waited = 0.0  # s, the longest beyond that since it was set to 0

    def open(self, clock: Clock) -> None:
        """Raises `RecordingError` where the robot, or the sensor, does not answer."""
        self.robot.connect(clock)
        if self._sensor is not None:
            self._sensor.open(clock)
        self.turn = Turn(clock.now())

    def close(self) -> None:
        if self._sensor is not None:
            self._sensor.close()
        self.robot.close()

    def model_of(self, beam: Beam) -> BentModel:
        """The tags, the point and the pushed place by another k(s)."""
        return BentModel(beam, self.plan.push_s, self._s, self.plan.gravity)

    @property
    def tool(self) -> Array:
        """(2,) m, the tool's place in the beam's frame."""
        return UNKNOWN if self.turn.arm is None else self.place.to_beam(self.turn.arm.pose.position)[:2]

    # Pictures, from the threads of the camera and of the recorder.

    def came(self, frame: Frame, timing: StampTiming) -> Frame:
        """The camera gave a picture: the same, which arrived when its stamp says that it should have, if it tells."""
        if timing.host and math.isfinite(frame.stamp):
            self._way_here = min(self._way_here, frame.arrival - frame.stamp)
            due = frame.stamp + self._way_here
            self.waited = max(self.waited, frame.arrival - due)
            frame = replace(frame, arrival=due)
        coarse = frame.picture[::8, ::8]
        if self._coarse is None or not np.array_equal(coarse, self._coarse):  # one that hangs shows its noise again
            self._coarse, self._pictured = coarse.copy(), frame.arrival
        return frame

    def see(self, frame: Frame, time: float, corners: Array) -> None:
        """A picture of the film at `time` [s], and its corners (b + m, 4, 2) px."""
        if frame.arrival > self._pictured or self.unfit:
            return
        self.film = (frame.arrival, time)
        if self.settled:
            self._seen.append(self.eye.beam(frame.arrival, corners))
            return
        self._begun = frame.arrival if math.isnan(self._begun) else self._begun
        self.eye.add_rest(time, corners)
        rested = (frame.arrival - self._begun) / self.plan.settings.rest
        enough = min(self.eye.rested, len(self._raw)) >= FEWEST_AT_REST
        if rested >= 1.0 and (enough or rested > LONGEST_REST):
            try:
                self._settle(frame.picture.shape)
            except OnebendError as wrong:
                self.unfit = str(wrong)

    def _settle(self, shape: tuple[int, ...]) -> None:
        """Read the rest: the beam's frame, the tool's place, the force's zero and its noise."""
        if min(self.eye.rested, len(self._raw)) < FEWEST_AT_REST:
            raise OnebendError(
                f"in {LONGEST_REST * self.plan.settings.rest:.3g} s of rest all tags were seen in {self.eye.rested} "
                f"pictures, and the force came {len(self._raw)} times: look at onebend record first"
            )
        if (late := float(np.mean(self._late))) > MOST_LATE:
            raise OnebendError(
                f"at rest, {100.0 * late:.0f} % of the time pictures or answers were more than "
                f"{1e3 * SILENCE:.0f} ms late. End other programs, or let this one be scheduled in real time"
            )
        self.eye.settle((shape[0], shape[1]), self.plan.gravity)
        self.place = self._placed()
        assert self.eye.reader is not None
        raw = np.array(self._raw)
        self._tare = raw.mean(axis=0) @ self.eye.reader.to_beam
        noise = float(np.sqrt(np.mean(np.var(raw, axis=0))))
        self.force_sd = math.hypot(noise, self.force_sd if math.isfinite(self.force_sd) else 3.0 * noise)
        changes = np.flatnonzero([True, *np.any(raw[1:] != raw[:-1], axis=1), True])
        self.same_at_rest = self.period * float(np.max(np.diff(changes)) - 1)
        self.settled = True

    def _placed(self) -> Placement:
        """The plan's placement, put where the tool touches the resting beam."""
        if self.turn.arm is None:
            raise OnebendError(f"{self.robot.name} does not say where its tool is{self.turn.silent}")
        here, place, touches = self.turn.arm.pose.position, self.plan.placement, self.rest[-1, :2]
        if place.noise > 0.0:  # it says where the beam is
            away = float(np.linalg.norm(place.to_base(touches) - here))
            if away > max(NEAR_START, DOUBT * place.sd(touches)):
                raise OnebendError(
                    f"the tool is {1e3 * away:.3g} mm from the beam at s = {self.plan.push_s:.3g}. Bring it there, so "
                    "that it touches and does not push, and begin again"
                )
        return place.moved_to(here, touches)

    # One turn.

    def sense(self, now: float, doing: Stage) -> Samples:
        """Ask all that there is to ask, for `turn`; the rows for the log. `doing`: the stage, or that which pauses."""
        self.turn = replace(self.turn, now=now, took=now - self.turn.now, arrival=math.nan)
        self._ask()
        rows = self._feel()
        self._look(doing)
        last = min(self.turn.answered, self.turn.pictured)
        if not (self.settled or math.isnan(self._begun)):
            self._late.append(self.turn.took > SLOW_LOOP or now - last > SILENCE)
        return rows

    def _ask(self) -> None:
        """The robot's state; what stands still is no answer."""
        turn = self.turn
        try:
            arm = self.robot.state()
        except Exception as wrong:  # each package has errors of its own
            self.turn = replace(turn, silent=f" ({wrong})")
            return
        if turn.arm is None or arm.stamp > turn.arm.stamp:
            turn = replace(turn, answered=turn.now, silent="")
        self.turn = replace(turn, arm=arm)

    def _feel(self) -> Samples:
        """The newest force, and the rows for the log."""
        turn, rows = self.turn, Samples(np.zeros(0), np.zeros((0, len(self.columns))), self.turn.now)
        if self._sensor is not None:
            got = self._sensor.read(0.0)
            rows = got if isinstance(got, Samples) else rows
            if isinstance(got, End):
                turn = replace(turn, silent=f" ({got.why})", changed=-math.inf)
        elif turn.arm is not None and turn.answered == turn.now:
            row = np.concatenate([turn.arm.wrench, turn.arm.pose.vector])
            rows = Samples(np.array([turn.arm.stamp]), row[None], turn.now)
        raw = rows.force[-1, self._wanted] if len(rows.force) else UNKNOWN
        if np.isfinite(raw).all():
            if not (self._raw and np.array_equal(raw, self._raw[-1])):
                turn = replace(turn, changed=turn.now)
            if self.settled:
                assert self.eye.reader is not None
                felt = np.append(self.eye.reader.to_beam.T @ raw - self._tare, turn.now)
                self._raw, turn = [raw], replace(turn, felt=(*turn.felt, felt)[-LATELY:])
            elif not math.isnan(self._begun):
                self._raw.append(raw)
        self.turn = turn
        return rows

    def _look(self, doing: Stage) -> None:
        """The newest picture, if it shows the beam where it may be."""
        turn, seen = replace(self.turn, pictured=self._pictured), None
        while self._seen:
            seen = self._seen.popleft()
        if seen is not None:
            when = seen.arrival - self.meter.delay
            shapes = [shape for at, shape in self._shapes if at <= when]
            modelled = shapes[-1] if shapes else self._shapes[0][1] if self._shapes else self.rest
            point, sd = point_between(seen, self._s[:-1], modelled[:-1], self._rec.beam.length)
            refused = self._unlikely(seen, modelled, point) if doing in LED else ""
            turn = replace(turn, refused=refused)
            if not refused and turn.now - seen.arrival <= SILENCE:
                self._before = seen
                turn = replace(turn, sighted=turn.now, arrival=seen.arrival, point=point, point_sd=sd)
        self.turn = turn

    def _unlikely(self, seen: SeenBeam, modelled: Array, point: Array) -> str:
        """Why what a picture shows cannot be, where the model has (m + 2, 3); empty where it can."""
        tags, count, speed = self._rec.tags.on_beam, self._tags, self.plan.limits.speed
        if not np.isfinite(point).all():
            hidden = [str(tag.id) for tag, shown in zip(tags, seen.shown, strict=True) if not shown]
            return f"tag {', '.join(hidden)} is hidden" if hidden else "the base's tags are hidden"
        off = np.linalg.norm(seen.xy - modelled[:count, :2], axis=1)
        moved = np.linalg.norm(modelled[:count, :2] - self.rest[:count, :2], axis=1)
        noise = math.hypot(
            self.eye.rest_noise, self.place.sd(modelled[-1, :2]) if self.plan.settings.by == "pose" else 0.0
        )
        allowed = DOUBT * (noise + self.k_sd * moved) + speed * self.plan.settings.longest_delay
        wrong = np.flatnonzero(np.isfinite(off) & (off > allowed + SLACK))
        if len(wrong):
            i = int(wrong[np.argmax(off[wrong])])
            return f"tag {tags[i].id} is {1e3 * off[i]:.3g} mm from where the model has it"
        if self._before is not None:
            step = np.linalg.norm(seen.xy - self._before.xy, axis=1)
            far = JUMP * speed * (seen.arrival - self._before.arrival) + SLACK + 6.0 * self.eye.rest_noise
            if np.any(step[np.isfinite(step)] > far):
                i = int(np.nanargmax(step))
                return f"tag {tags[i].id} jumped by {1e3 * step[i]:.3g} mm"
        return ""

    def bend(self, force: Array) -> Array | None:
        """(m + 2, 3) the model under `force` (2,) N from now on; None, and nothing changes, without a stable shape."""
        if not self.model.bend(force):
            return None
        oldest = self.turn.now - 2.0 * self.plan.settings.longest_delay
        poses = self.model.poses()
        self._shapes = [*(one for one in self._shapes if one[0] >= oldest), (self.turn.now, poses)]
        return poses


def late(cell: Cell, doing: Stage) -> str:
    """What of a turn came late, in words: it may pass. Empty where nothing did."""
    turn, led = cell.turn, doing in LED and not cell.camera_ended
    if doing not in GOING:
        return ""
    if turn.took > SLOW_LOOP:
        return f"one turn of the loop took {1e3 * turn.took:.0f} ms: this computer is busy"
    if turn.now - turn.answered > SILENCE:
        return f"{cell.robot.name} answers no more{turn.silent}"
    if led and turn.now - turn.pictured > SILENCE:
        return f"no new picture came for {1e3 * (turn.now - turn.pictured):.0f} ms: the camera hangs, or is cut off"
    if led and turn.now - turn.sighted > SILENCE and not turn.refused:
        return f"pictures wait {1e3 * (turn.now - turn.sighted):.0f} ms: this computer is busy"
    return ""


def wrong(cell: Cell, stage: Stage) -> str:
    """What is wrong, in words; empty where nothing is."""
    limits, settings, turn, meter = cell.plan.limits, cell.plan.settings, cell.turn, cell.meter
    if stage in (*LED, "returning") and (soon := force_soon(turn)) > limits.force:
        return f"{soon:.3g} N will be on the beam in {1e3 * AHEAD:.0f} ms, and {limits.force:.3g} N are allowed"
    if stage not in LED:
        return ""
    if cell.camera_ended:
        return cell.camera_ended
    if turn.now - turn.sighted > SILENCE:
        return f"the point is not seen any more: {turn.refused}"
    if turn.now - turn.changed > max(SILENCE, 3.0 * cell.same_at_rest):
        return "the force sensor is stuck: it gives the same number again and again"
    if settings.longest_delay < meter.delay - 2.0 * meter.sd:
        most = 1e3 * settings.longest_delay
        return f"pictures are answered {1e3 * meter.delay:.0f} ms late, and {most:.0f} ms are allowed"
    doubt, apart = force_doubt(cell)
    cell.doubted = cell.doubted + 1 if doubt > DOUBT else 0
    if cell.doubted >= IN_A_ROW:
        x, y = turn.force
        return (
            f"under the force that is felt, ({x:.3g}, {y:.3g}) N, the model has the beam "
            f"{1e3 * apart:.3g} mm from the tool: more than {DOUBT:.0f} sd"
        )
    return _outside(cell)


def _outside(cell: Cell) -> str:
    """Which limit of place, buckling or bend is broken."""
    limits = cell.plan.limits
    away = float(np.min(np.linalg.norm(cell.plan.hand[:, :2] - cell.tool, axis=1)))
    if away > limits.room:
        return f"the tool is {1e3 * away:.3g} mm from its planned way, and {1e3 * limits.room:.3g} mm are allowed"
    if (margin := cell.model.margin) < limits.margin:
        return f"the beam is near buckling: its margin is {margin:.2g}, and {limits.margin:.2g} is the least"
    if (bend := cell.model.curvature) > limits.curvature * (1.0 + cell.plan.settings.k_error):
        return f"the beam is bent by {bend:.3g} 1/m, and {limits.curvature:.3g} 1/m are allowed"
    return ""


def force_soon(turn: Turn) -> float:
    """N that will be on the beam when an order to hold has been obeyed: the newest force and its trend."""
    if len(turn.felt) < LATELY:
        return 0.0
    x, y, time = np.array(turn.felt).T
    size, since = np.hypot(x, y), time - time.mean()
    trend = float(since @ size) / float(since @ since)
    return float(size[-IN_A_ROW:].mean()) + AHEAD * max(trend, 0.0)


def force_doubt(cell: Cell) -> tuple[float, float]:
    """How many sds, and m, the tool is from where the model has the beam under the force that is felt.

    Places are compared, not forces: along the beam a hair's breadth makes any force. Where they differ, the beam of
    another k that fits best counts, as far as k may be wrong: it has the model's shape under more or less force."""
    if not cell.turn.felt:
        return 0.0, 0.0
    force = np.mean(cell.turn.felt[-IN_A_ROW:], axis=0)[:2]
    best, apart = _place_doubt(cell, force)
    for factor in FACTORS:
        if best <= DOUBT:
            break
        best = min(best, math.hypot(math.log(factor) / cell.k_sd, _place_doubt(cell, factor * force)[0]))
    return best, apart


def _place_doubt(cell: Cell, force: Array) -> tuple[float, float]:
    """The same for the model's own k(s) under `force` (2,) N; 0 where it has no shape to compare with."""
    pushed, here = cell.model.pushed, cell.tool
    way = trace(pushed, np.append(force, 0.0), start=cell.model.state, shortest=SHORTEST)
    if not way.arrived:
        return 0.0, 0.0
    state = way.states[-1]
    away, yields = here - pushed.pose(state.q)[:2], pushed.response(state)[:2, :2]
    askew = ASKEW[cell.plan.settings.hand] * cell.k_sd**2 * float(force @ force)
    covariance = (cell.force_sd**2 + askew) * yields @ yields.T
    covariance += (cell.place.sd(here) + CONTACT) ** 2 * np.eye(2)
    return math.sqrt(float(away @ np.linalg.solve(covariance, away))), float(np.hypot(*away))
