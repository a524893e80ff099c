"""The drive itself: 125 times a second it looks, decides and commands, and holds where anything is wrong.

    waiting -> driving -> staying -> (driving ...) -> returning -> resting -> done
                   any of these, at a fault or a stop -> holding -> releasing -> resting -> done
                   where pictures, answers or turns were only late -> holding -> the same stage again

To the recorder it is a force sensor: each reading is one turn of the loop and gives a row of the log. So a drive is
recorded as any push is, and a played clock plays it as it would go in real time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.beam.model import Beam
from onebend.control.loaded_beam import trace
from onebend.control.loop import Controller, ControllerState, bounded
from onebend.drive.placing import Placement
from onebend.drive.plan import ARM, DrivePlan
from onebend.drive.robots import ArmState, Robot, ToolForce, ToolPose
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
SETTLING = 0.5  # s for which the point must stay on its goal
NEAR_START = 0.005  # m by which the tool may be off the beam's place where it is to touch
THIN = (5e-4, math.radians(0.5))  # m and rad between places of the way that is walked back
PATIENCE = 1.0  # s for which a silent robot is waited for, in hold
CALM, LONGEST_PAUSE = 0.25, 5.0  # s of pictures and answers in time, before it goes on; for which it waits for that
MOST_STEPS = 3  # of the way to the goal in one late turn: a chord of it would bend the beam otherwise than its arc
MOST_PAUSES = 20  # of one drive, on its way out
LONGEST_REST = 2.0  # times as long as asked for, where little was seen
MOST_LATE = 0.2  # of the turns at rest: where more are late nothing moves
MOST_HOLDS = 3  # of one drive, beside the pauses; then the robot is left where it stands
AFTER_FAULT = 1.0  # s of rest behind a release


@dataclass(frozen=True)
class Happened:
    """One thing that was said."""

    time: float  # s, the film's clock; NaN before it
    text: str
    fault: bool = False


@dataclass(frozen=True)
class GoalOutcome:
    """How one goal ended."""

    goal: Array  # (2,) m
    reached: bool
    seconds: float  # from its beginning
    seen: Array  # (2,) m, mean place of the point while it stayed
    said: float  # m, within which it was said to come to rest (95 %); NaN of a goal that is passed in time
    force: Array  # (2,) N asked for at the end
    felt: Array  # (2,) N measured there


@dataclass(frozen=True)
class DriveState:
    """What is known while it drives; NaN where nothing is."""

    stage: Stage = "waiting"
    says: str = ""  # the newest thing that was said
    goal: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) m
    point: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) m, seen
    asked: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N
    felt: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N
    delay: float = math.nan  # s, measured
    said: float = math.nan  # m, within which the point is to come to rest

    @property
    def distance(self) -> float:
        """m from the goal."""
        return float(np.linalg.norm(self.point - self.goal))


@dataclass
class Lateness:
    """What of pictures, answers and turns of the loop was late."""

    paused: tuple[Stage, str] | None = None  # the stage that goes on as soon as nothing is late any more; what was
    pauses: list[float] = field(default_factory=list)  # s of each
    last: float = -math.inf  # s, when something was
    in_time: float = -math.inf  # s, when nothing was
    at_rest: list[bool] = field(default_factory=list)  # whether something was, in each turn
    way_here: float = math.inf  # s, the shortest from a picture's stamp to its arrival
    waited: float = 0.0  # s, the longest beyond that since the last pause


class Drive:
    """A plan, a robot and an eye. `read` turns the loop; `see` takes pictures, from another thread."""

    def __init__(
        self, plan: DrivePlan, robot: Robot, rec: Recording, sensor: ForceSource | None = None,
        watch: Callable[[DriveState], None] = lambda _: None,
    ) -> None:  # fmt: skip
        """`sensor`: measures the force instead of the robot; `watch`: told what is known, some ten times a second."""
        self.name, self.plan, self.events = robot.name, plan, list[Happened]()
        self.columns = (*WRENCH, *TOOL) if sensor is None else sensor.columns
        self.timing = robot.timing if sensor is None else sensor.timing
        self.stage: Stage = "waiting"
        self.state, self.outcomes = DriveState(), list[GoalOutcome]()
        self.latency: list[float] = []  # s from a picture's arrival to the command that it led to
        self.turns: list[float] = []  # s that each turn took
        self.meter = DelayMeter(plan.settings.delay)
        self._robot, self._rec, self._sensor, self._watch = robot, rec, sensor, watch
        self._period, self._settings, self._limits = 1.0 / plan.settings.rate, plan.settings, plan.limits
        tags = np.array([tag.s for tag in rec.tags.on_beam])
        self._places = np.append(tags, [plan.point_s, plan.push_s])
        self._model = BentModel(plan.model.beam, plan.push_s, self._places, plan.gravity)
        self._rest = self._model.poses()
        self._apart, self._k_sd = 0.0, -math.log(1.0 - plan.settings.k_error) / 3.0  # m; of log k
        self.eye = Eye(rec, self._rest[: len(tags)])
        assert rec.force is not None
        self._wanted = [self.columns.index(name) for name in rec.force.columns[1:]]
        bench = plan.model.bench
        known = None if bench is None else bench.force
        parts = (math.nan,) if known is None else (known.level, known.coloured, known.frame, known.load)
        self._sensor_sd = math.hypot(*parts)
        self._goal, self._control = 0, plan.goals[0].control
        self._loop: ControllerState | None = None
        self._renewed: tuple[Controller, BentModel] | None = None
        self._asked, self._felt, self._tare = np.zeros(2), np.full(2, np.nan), np.zeros(2)
        self._raw: list[Array] = []  # (2,) N of the rest
        self._lately: deque[Array] = deque(maxlen=LATELY)  # (3,) N, N, s: what was felt, and when
        self._seen: deque[SeenBeam] = deque()  # from the thread of `see`
        self._shapes: deque[tuple[float, Array]] = deque()  # what the model had at its places
        self._errors: deque[tuple[float, Array]] = deque()
        self._way: list[ToolPose] = []
        self._place: Placement = plan.placement
        self._start: ToolPose | None = None
        self._told: ToolPose | None = None
        self._arm: ArmState | None = None
        self._before: SeenBeam | None = None
        self._coarse: Picture | None = None
        self._clock: Clock | None = None
        self._next = self._turned = self._told_state = -math.inf
        self._pictured = -math.inf  # arrival of the newest picture that is not the one before
        self._answered = self._sighted = self._entered = self._goal_begun = self._led = self._changed = math.inf
        self._same_at_rest = 0.0
        self._film_begun, self._film = math.nan, (math.nan, math.nan)  # arrival and film time of the newest picture
        self._refused, self._camera_why, self._refused_by = "", "", ""
        self.fault = self._settled = self._stop = False  # fault: whether anything went wrong
        self._doubted = self._holds = 0
        self.lateness = Lateness()

    # To the recorder: a force sensor that is read turn by turn.

    def open(self, clock: Clock) -> None:
        """Connect the robot. Raises `RecordingError` where it, or the sensor, does not answer."""
        self._clock = clock
        self._robot.connect(clock)
        if self._sensor is not None:
            self._sensor.open(clock)
        self._next = self._turned = clock.now()

    def due(self) -> float:
        return math.inf if self.over else self._next

    def read(self, wait: float) -> Samples | End | None:
        """One turn of the loop, and its rows; a turn without an answer has none."""
        assert self._clock is not None
        if self.over:
            return End("the drive is over")
        now = self._clock.now()
        if self._next > now + wait:
            self._clock.wait_until(now + wait)
            return None
        self._clock.wait_until(self._next)
        now = self._clock.now()
        self._next = max(self._next + self._period, now)
        rows = self._safely(now)
        self.turns.append(self._clock.now() - now)
        return rows

    def close(self) -> None:
        """Let go slowly, if the tool is still out, and disconnect."""
        if self._clock is not None and self.stage != "waiting" and not self.over:
            self._halt(self._clock.now(), "the recording ended, and the drive with it", fault=True)
            while not self.over:
                self.read(math.inf)
        if self._sensor is not None:
            self._sensor.close()
        self._robot.close()

    @property
    def over(self) -> bool:
        return self.stage == "done"

    @property
    def moved(self) -> bool:
        """Whether the tool was ever told to move."""
        return self._start is not None

    def stop(self) -> None:
        """Hold, and release slowly; from any thread. A second time: let go at once."""
        self._stop = True

    def camera_ended(self, why: str) -> None:
        """No picture will come any more."""
        self._camera_why = why

    # Pictures, from the threads of the camera and of the recorder.

    def came(self, frame: Frame, timing: StampTiming) -> Frame:
        """The camera gave a picture: the same, which arrived when its stamp says that it should have, if it tells."""
        if timing.host and math.isfinite(frame.stamp):
            self.lateness.way_here = min(self.lateness.way_here, frame.arrival - frame.stamp)
            due = frame.stamp + self.lateness.way_here
            self.lateness.waited = max(self.lateness.waited, frame.arrival - due)
            frame = replace(frame, arrival=due)
        coarse = frame.picture[::8, ::8]
        if self._coarse is None or not np.array_equal(coarse, self._coarse):  # one that hangs shows its noise again
            self._coarse, self._pictured = coarse.copy(), frame.arrival
        return frame

    def see(self, frame: Frame, time: float, corners: Array) -> None:
        """A picture of the film at `time` [s], and its corners (b + m, 4, 2) px."""
        if frame.arrival > self._pictured:
            return
        self._film = (frame.arrival, time)
        if math.isnan(self._film_begun):
            self._film_begun = frame.arrival
        if not self._settled:
            self.eye.add_rest(time, corners)
            rested = (frame.arrival - self._film_begun) / self._settings.rest
            enough = min(self.eye.rested, len(self._raw)) >= _FEWEST_AT_REST or rested > LONGEST_REST
            if self.stage == "waiting" and rested >= 1.0 and enough:
                self._settle(frame.picture.shape)
            return
        self._seen.append(self.eye.beam(frame.arrival, corners))

    def _settle(self, shape: tuple[int, ...]) -> None:
        try:
            if min(self.eye.rested, len(self._raw)) < _FEWEST_AT_REST:
                raise OnebendError(
                    f"in {LONGEST_REST * self._settings.rest:.3g} s of rest all tags were seen in {self.eye.rested} "
                    f"pictures, and the force came {len(self._raw)} times: look at onebend record first"
                )
            if (late := float(np.mean(self.lateness.at_rest))) > MOST_LATE:
                raise OnebendError(
                    f"at rest, {100.0 * late:.0f} % of the time pictures or answers were more than "
                    f"{1e3 * SILENCE:.0f} ms late. End other programs, or let this one be scheduled in real time"
                )
            self.eye.settle((shape[0], shape[1]), self.plan.gravity)
            self._place = self._placed()
        except OnebendError as wrong:
            self._say(str(wrong), fault=True)
            self.stage = "done"
            return
        assert self.eye.reader is not None
        raw = np.array(self._raw)
        self._tare = raw.mean(axis=0) @ self.eye.reader.to_beam
        noise = float(np.sqrt(np.mean(np.var(raw, axis=0))))
        self._sensor_sd = math.hypot(noise, self._sensor_sd if math.isfinite(self._sensor_sd) else 3.0 * noise)
        same = np.all(raw[1:] == raw[:-1], axis=1)
        longest = max((len([*run]) for alike, run in groupby(same.tolist()) if alike), default=0)
        self._same_at_rest = self._period * longest
        self._settled = True

    def _placed(self) -> Placement:
        """The plan's placement, put where the tool touches the resting beam."""
        if self._arm is None:
            raise OnebendError(f"{self.name} does not say where its tool is{self._refused_by}")
        here, place, touches = self._arm.pose.position, self.plan.placement, self._rest[-1, :2]
        if place.noise > 0.0:  # it says where the beam is
            away = float(np.linalg.norm(place.to_base(touches) - here))
            if away > max(NEAR_START, DOUBT * place.sd(touches)):
                raise OnebendError(
                    f"the tool is {1e3 * away:.3g} mm from the beam at s = {self.plan.push_s:.3g}. Bring it there, so "
                    "that it touches and does not push, and begin again"
                )
        return place.moved_to(here, touches)

    # One turn.

    def _safely(self, now: float) -> Samples:
        """A turn; what goes wrong in it is a fault, and no end of the loop."""
        nothing = Samples(np.zeros(0), np.zeros((0, len(self.columns))), now)
        try:
            return self._turn(now) or nothing
        except Exception as wrong:
            if self.stage in ("holding", "releasing", "resting"):
                self._end(now, f"the drive failed again ({wrong!r}), and lets go")
            else:
                self._halt(now, f"the drive failed ({wrong!r})", fault=True)
            return nothing

    def _turn(self, now: float) -> Samples | None:
        slow, self._turned = now - self._turned, now
        self._ask(now)
        rows = self._feel(now)
        seen = self._newest(now)
        late = self._late(now, slow)
        trouble = late or self._wrong()
        if self._stop:
            self._stop = False
            if self.lateness.paused is not None:
                self.lateness.paused = None
                self._say("holds: stopped by hand")
            elif self.stage in ("holding", "releasing"):
                self._end(now, "let go at once, as asked")
            elif self.stage != "waiting":
                self._halt(now, "stopped by hand", fault=False)
            else:
                self._end(now, "stopped by hand")
        elif trouble:
            self._halt(now, trouble, fault=True, passes=bool(late))
        try:
            self._act(now, seen)
        except Exception as wrong:  # each package has errors of its own
            if self.stage == "holding":
                self._end(now, f"{self.name} takes no orders ({wrong}). Look at it before you touch the beam")
            self._answered = min(self._answered, now - SILENCE)
            self._halt(now, f"{self.name} answers no more ({wrong})", fault=True)
        if seen is not None and self.stage in LED:
            assert self._clock is not None
            self.latency.append(self._clock.now() - seen.arrival)
        self._tell(now)
        return rows

    def _act(self, now: float, seen: SeenBeam | None) -> None:
        if self.stage == "waiting" and seen is not None:  # the rest was read, and pictures do not wait
            self._begin(now)
        elif self.stage in LED:
            self._lead(now, seen)
        elif self.stage == "holding":
            self._held(now)
        elif self.stage in ("returning", "releasing"):
            self._walk_back(now)
        elif self.stage == "resting":
            rest = AFTER_FAULT if self.fault else self._settings.rest
            if now - self._entered >= rest:
                self._end(now, "the tool is back where it began, and the robot is free")

    def _ask(self, now: float) -> None:
        """The robot's state; what stands still is no answer."""
        try:
            arm = self._robot.state()
        except Exception as wrong:  # each package has errors of its own
            self._refused_by = f" ({wrong})"
            return
        if self._arm is None or arm.stamp > self._arm.stamp:
            self._answered, self._refused_by = now, ""
        self._arm = arm

    def _feel(self, now: float) -> Samples | None:
        """The newest force, and the rows for the log."""
        rows: Samples | None
        if self._sensor is not None:
            got = self._sensor.read(0.0)
            rows = got if isinstance(got, Samples) else None
            if isinstance(got, End):
                self._refused_by = f" ({got.why})"
                self._changed = -math.inf
        elif self._arm is None or self._answered != now:
            rows = None
        else:
            row = np.concatenate([self._arm.wrench, self._arm.pose.vector])
            rows = Samples(np.array([self._arm.stamp]), row[None], now)
        if rows is None or not len(rows.force):
            return rows
        raw = rows.force[-1, self._wanted]
        if not np.isfinite(raw).all():
            return rows
        if not (self._raw and np.array_equal(raw, self._raw[-1])):
            self._changed = now
        if not self._settled:
            self._raw += [] if math.isnan(self._film_begun) else [raw]
        else:
            self._raw = [raw]
            assert self.eye.reader is not None
            self._felt = self.eye.reader.to_beam.T @ raw - self._tare
            self._lately.append(np.append(self._felt, now))
        return rows

    def _newest(self, now: float) -> SeenBeam | None:
        """The newest picture that shows the beam where it may be."""
        newest = None
        while self._seen:
            newest = self._seen.popleft()
        if newest is None:
            return None
        self._refused = self._unlikely(newest)
        if self._refused or now - newest.arrival > SILENCE:
            return None
        self._sighted, self._before = now, newest
        return newest

    def _unlikely(self, seen: SeenBeam) -> str:
        """Why what a picture shows cannot be; empty where it can."""
        if self._doing not in LED:
            return ""
        point, _ = self._point(seen)
        if not np.isfinite(point).all():
            hidden = [tag.id for tag, shown in zip(self._rec.tags.on_beam, seen.shown, strict=True) if not shown]
            return f"tag {', '.join(map(str, hidden))} is hidden" if hidden else "the base's tags are hidden"
        model, count = self._at_exposure(seen), len(self._rec.tags.on_beam)
        off = np.linalg.norm(seen.xy - model[:count, :2], axis=1)
        moved = np.linalg.norm(model[:count, :2] - self._rest[:count, :2], axis=1)
        noise = math.hypot(self.eye.rest_noise, self._place.sd(model[-1, :2]) if self._settings.by == "pose" else 0.0)
        allowed = DOUBT * (noise + self._k_sd * moved) + self._limits.speed * self._settings.longest_delay
        wrong = np.flatnonzero(np.isfinite(off) & (off > allowed + _SLACK))
        if len(wrong):
            i = int(wrong[np.argmax(off[wrong])])
            return f"tag {self._rec.tags.on_beam[i].id} is {1e3 * off[i]:.3g} mm from where the model has it"
        if self._before is not None:
            step = np.linalg.norm(seen.xy - self._before.xy, axis=1)
            far = _JUMP * self._limits.speed * (seen.arrival - self._before.arrival)
            far += _SLACK + 6.0 * self.eye.rest_noise
            if np.any(step[np.isfinite(step)] > far):
                i = int(np.nanargmax(step))
                return f"tag {self._rec.tags.on_beam[i].id} jumped by {1e3 * step[i]:.3g} mm"
        return ""

    def _at_exposure(self, seen: SeenBeam) -> Array:
        """(m + 2, 3) what the model had when the picture was taken."""
        when = seen.arrival - self.meter.delay
        shapes = [shape for at, shape in self._shapes if at <= when]
        return shapes[-1] if shapes else (self._shapes[0][1] if self._shapes else self._rest)

    def _point(self, seen: SeenBeam) -> tuple[Array, float]:
        return point_between(seen, self._places[:-1], self._at_exposure(seen)[:-1], self._rec.beam.length)

    # What is watched.

    @property
    def _doing(self) -> Stage:
        """The stage, or that in which it pauses."""
        return self.stage if self.lateness.paused is None else self.lateness.paused[0]

    def _late(self, now: float, slow: float) -> str:
        """What is late, in words: it may pass; `slow` [s]: since the last turn began. Empty where nothing is."""
        late, led = "", self._doing in LED and not self._camera_why
        if self._doing not in GOING:
            if not math.isnan(self._film_begun):
                self.lateness.at_rest.append(slow > SLOW_LOOP or now - min(self._answered, self._pictured) > SILENCE)
        elif slow > SLOW_LOOP:
            late = f"one turn of the loop took {1e3 * slow:.0f} ms: this computer is busy"
        elif now - self._answered > SILENCE:
            late = f"{self.name} answers no more{self._refused_by}"
        elif led and now - self._pictured > SILENCE:
            late = f"no new picture came for {1e3 * (now - self._pictured):.0f} ms: the camera hangs, or is cut off"
        elif led and now - self._sighted > SILENCE and not self._refused:
            late = f"pictures wait {1e3 * (now - self._sighted):.0f} ms: this computer is busy"
        if late or self._refused:
            self.lateness.last = now
        elif self.lateness.paused is not None:
            self.lateness.in_time = now
        return late

    def _wrong(self) -> str:
        """What is wrong, in words; empty where nothing is."""
        if self.stage not in GOING:
            return ""
        if self.stage != "releasing" and (soon := self._force_soon()) > (limit := self._limits.force):
            return f"{soon:.3g} N will be on the beam in {1e3 * AHEAD:.0f} ms, and {limit:.3g} N are allowed"
        return self._wrong_while_led() if self.stage in LED else ""

    def _wrong_while_led(self) -> str:
        now = self._turned
        if self._camera_why:
            return self._camera_why
        if now - self._sighted > SILENCE:
            return f"the point is not seen any more: {self._refused}"
        if now - self._changed > max(SILENCE, 3.0 * self._same_at_rest):
            return "the force sensor is stuck: it gives the same number again and again"
        if (longest := self._settings.longest_delay) < self.meter.delay - 2.0 * self.meter.sd:
            return f"pictures are answered {1e3 * self.meter.delay:.0f} ms late, and {1e3 * longest:.0f} ms are allowed"
        self._doubted = self._doubted + 1 if self._force_doubt() > DOUBT else 0
        if self._doubted >= IN_A_ROW:
            x, y = self._felt
            return (
                f"under the force that is felt, ({x:.3g}, {y:.3g}) N, the model has the beam "
                f"{1e3 * self._apart:.3g} mm from the tool: more than {DOUBT:.0f} sd"
            )
        return self._outside()

    def _force_soon(self) -> float:
        """N that will be on the beam when an order to hold has been obeyed: the newest force and its trend."""
        if len(self._lately) < LATELY:
            return 0.0
        x, y, time = np.array(self._lately).T
        size, since = np.hypot(x, y), time - time.mean()
        trend = float(since @ size) / float(since @ since)
        return float(size[-IN_A_ROW:].mean()) + AHEAD * max(trend, 0.0)

    def _force_doubt(self) -> float:
        """How many sds the tool is from where the model has the beam under the force that is felt.

        Places are compared, not forces: along the beam a hair's breadth makes any force. Where they differ, the beam
        of another k that fits best counts, as far as k may be wrong: it has the model's shape under more or less
        force."""
        if not np.isfinite(self._felt).all():
            return 0.0
        force, best = np.mean([*self._lately][-IN_A_ROW:], axis=0)[:2], math.inf
        for factor in _FACTORS:
            k_off = math.log(factor) / self._k_sd
            best = min(best, math.hypot(k_off, self._place_doubt(factor * force)))
            if best <= DOUBT:
                break
        return best

    def _place_doubt(self, force: Array) -> float:
        """The same for the model's own k(s) under `force` (2,) N; 0 where it has no shape to compare with."""
        assert self._arm is not None
        pushed = self._model.pushed
        way = trace(pushed, np.append(force, 0.0), start=self._model.state, shortest=_SHORTEST)
        if not way.arrived:
            return 0.0
        here, state = self._place.to_beam(self._arm.pose.position)[:2], way.states[-1]
        away, yields = here - pushed.pose(state.q)[:2], pushed.response(state)[:2, :2]
        askew = _ASKEW[self._settings.hand] * self._k_sd**2 * float(force @ force)
        covariance = (self._sensor_sd**2 + askew) * yields @ yields.T
        covariance += (self._place.sd(here) + _CONTACT) ** 2 * np.eye(2)
        self._apart = float(np.hypot(*away))
        return math.sqrt(float(away @ np.linalg.solve(covariance, away)))

    def _outside(self) -> str:
        """Which limit of place, speed or bend is broken."""
        assert self._arm is not None
        here = self._place.to_beam(self._arm.pose.position)[:2]
        away = float(np.min(np.linalg.norm(self.plan.hand[:, :2] - here, axis=1)))
        if away > self._limits.room:
            most = 1e3 * self._limits.room
            return f"the tool is {1e3 * away:.3g} mm from its planned way, and {most:.3g} mm are allowed"
        if (margin := self._model.margin) < self._limits.margin:
            return f"the beam is near buckling: its margin is {margin:.2g}, and {self._limits.margin:.2g} is the least"
        if (bend := self._model.curvature) > self._limits.curvature * (1.0 + self._settings.k_error):
            return f"the beam is bent by {bend:.3g} 1/m, and {self._limits.curvature:.3g} 1/m are allowed"
        return ""

    # What is done.

    def _begin(self, now: float) -> None:
        assert self._arm is not None
        self._start = self._told = self._arm.pose
        self._way = [self._start]
        self._answered = self._sighted = self._changed = now
        self._say(f"moves: to {1e3 * self._control.goal[0]:.4g}, {1e3 * self._control.goal[1]:.4g} mm")
        self._to_goal(now, 0)

    def _to_goal(self, now: float, number: int, correction: Array | None = None) -> None:
        self._goal, self._control = number, self.plan.goals[number].control
        self._loop = self._control.begin(now, (0.0, 0.0) if correction is None else correction)
        self._errors.clear()
        self._goal_begun = self._led = now
        self._enter("driving", now)

    def _lead(self, now: float, seen: SeenBeam | None) -> None:
        """One turn of the closed loop."""
        assert self._loop is not None
        stood = max(now - self._led - MOST_STEPS * self._period, 0.0)
        self._loop, self._led = replace(self._loop, began=self._loop.began + stood), now
        self._goal_begun += stood
        self._take_renewed(now)
        control, point = self._timed(), None
        if seen is not None:
            point, sd = self._point(seen)
            self.meter.shown(now, point, sd)
            self._errors.append((now, point))
            while self._errors[0][0] < now - SETTLING:
                self._errors.popleft()
            self.state = replace(self.state, point=point)
        self._loop, asked = control.step(self._loop, point, now)
        asked = bounded(asked, self._limits.force)
        if not self._model.bend(asked):
            self._halt(now, "no stable shape of the beam leads on from here", fault=True)
            return
        self._asked, poses = asked, self._model.poses()
        self._shapes.append((now, poses))
        while self._shapes[0][0] < now - 2.0 * self._settings.longest_delay:
            self._shapes.popleft()
        self._command(poses[-1])
        told = self._told if self._settings.by == "pose" else None  # a force moves the tool as the true k lets it
        self.meter.told(now, self.tool if told is None else self._place.to_beam(told.position)[:2])
        self._go_on(now)

    def _timed(self) -> Controller:
        """The controller, told the delay as it was measured."""
        if not math.isfinite(self.meter.sd):
            return self._control
        settings = self._control.settings
        lag = settings.timing.lag if self._settings.by == "pose" else 0.0
        timing = replace(settings.timing, delay=max(self.meter.delay - lag, 0.0))
        return replace(self._control, settings=replace(settings, timing=timing))

    def _command(self, hand: Array) -> None:
        """The tool to (3,) m, m, rad of the beam's frame, or the force; no faster than is allowed."""
        assert self._arm is not None
        assert self._start is not None
        assert self._told is not None
        if self._settings.by == "force":
            self._robot.command(ToolForce(self._asked, self._place.rotation, self._limits.speed))
            self._keep(self._arm.pose)
            return
        place = self._start.position + self._place.rotation[:, :2] @ (hand[:2] - self._rest[-1, :2])
        turned = self._start.rotation
        if self._settings.hand == "hold":
            about = (hand[2] - self._rest[-1, 2]) * self._place.rotation[:, 2]
            turned = np.asarray(Rotation.from_rotvec(about).as_matrix() @ turned)
        self._told = stepped(self._told, ToolPose(place, turned), self._limits.speed * self._period)
        self._robot.command(self._told)
        self._keep(self._told)

    def _keep(self, pose: ToolPose) -> None:
        """Remember the way, to walk it back."""
        last = self._way[-1]
        turn = Rotation.from_matrix(pose.rotation @ last.rotation.T).magnitude()
        if float(np.linalg.norm(pose.position - last.position)) > THIN[0] or turn > THIN[1]:
            self._way.append(pose)

    def _go_on(self, now: float) -> None:
        """To the next goal, or back, when this one is done."""
        since, planned = now - self._goal_begun, self.plan.goals[self._goal]
        moved = since >= self._control.reference.rise
        if self.stage == "driving":
            if not planned.waits and moved:
                self._finish_goal(now, reached=True)
            elif moved and self._arrived(now):
                self._say(f"goal {self._goal + 1} of {len(self.plan.goals)} is reached after {since:.1f} s")
                self._enter("staying", now)
            elif since > max(self._settings.longest, 2.0 * self._control.reference.rise):
                self.fault = True
                away = 1e3 * float(np.linalg.norm(self.state.point - self._control.goal))
                self._say(f"goal {self._goal + 1} is given up after {since:.0f} s, {away:.2g} mm away", fault=True)
                self._finish_goal(now, reached=False)
        elif now - self._entered >= self._settings.stay:
            self._finish_goal(now, reached=True)

    def _arrived(self, now: float) -> bool:
        if not self._errors or self._errors[0][0] > now - 0.8 * SETTLING:
            return False
        away = np.array([place for _, place in self._errors]) - self._control.goal
        noise = 3.0 * self.eye.rest_noise
        within = float(np.linalg.norm(away.mean(axis=0))) <= self._settings.within
        return within and bool(np.all(np.linalg.norm(away, axis=1) <= self._settings.within + noise))

    def _finish_goal(self, now: float, *, reached: bool) -> None:
        places = np.array([place for _, place in self._errors]).reshape(-1, 2)
        seen = places.mean(axis=0) if len(places) else np.full(2, np.nan)
        seconds, asked, felt = now - self._goal_begun, self._asked.copy(), self._felt.copy()
        said = self.said if self.plan.goals[self._goal].waits else math.nan
        self.outcomes.append(GoalOutcome(self._control.goal, reached, seconds, seen, said, asked, felt))
        if reached and self._goal + 1 < len(self.plan.goals):
            assert self._loop is not None
            self._to_goal(now, self._goal + 1, self._asked - self.plan.goals[self._goal + 1].control.reference.begins)
        else:
            self._go_back(now, "returning")

    @property
    def said(self) -> float:
        """m within which the point is to come to rest (95 %): camera and tags, and what counts as reached."""
        if not self._settled:
            return math.nan
        return _WITHIN_95 * math.hypot(self.eye.camera_sd, self.eye.rest_noise) + self._settings.within

    # Holding, releasing, coming back.

    def _halt(self, now: float, why: str, *, fault: bool, passes: bool = False) -> None:
        """Hold at once; the release comes after, or where it `passes` it goes on."""
        if self.stage in ("holding", "resting", "done"):
            return
        if self.stage == "waiting":
            self.fault |= fault
            self._end(now, why)
            return
        pauses = passes and (len(self.lateness.pauses) < MOST_PAUSES or self.stage not in LED)
        self.lateness.paused = (self.stage, why) if pauses else None
        self._holds += not pauses
        if self._holds > MOST_HOLDS:
            self.fault |= fault
            self._end(now, f"{why}: for the {self._holds}th time, and it is left where it stands")
            return
        try:
            self._robot.hold()
        except Exception as wrong:  # each package has errors of its own
            why += f"; and it does not take the order to hold ({wrong})"
        self._say(f"holds: {why}", fault=fault and not pauses)
        self._enter("holding", now)

    def _held(self, now: float) -> None:
        silent, waited = now - self._answered, now - self._entered
        if silent > SILENCE:
            if silent > PATIENCE:
                self.fault = True
                self._end(now, f"{self.name} answers no more: it stops by itself. Look at it before you touch the beam")
            return
        if self.lateness.paused is not None and now - self.lateness.last > CALM:
            self._resume(now, self.lateness.paused[0])
        elif now - max(self._entered, self.lateness.in_time) >= self._settings.hold or waited >= LONGEST_PAUSE:
            self._go_back(now, "releasing")

    def _resume(self, now: float, stage: Stage) -> None:
        """Go on with what it did."""
        pause, self.lateness.paused, self._doubted = now - self._entered, None, 0
        self.lateness.pauses.append(pause)
        busy, self.lateness.waited = self.lateness.waited > 0.5 * SILENCE, 0.0
        self._say(f"goes on after {pause:.1f} s{': pictures had waited, as this computer was busy' if busy else ''}")
        self._errors.clear()
        self._enter(stage, now)

    def _go_back(self, now: float, stage: Stage) -> None:
        assert self._arm is not None
        if self._settings.by == "force":
            self._robot.hold()
        self._told = self._arm.pose if stage == "releasing" or self._settings.by == "force" else self._told
        late, self.lateness.paused = "" if self.lateness.paused is None else f": {self.lateness.paused[1]}", None
        self._say(f"releases slowly{late}" if stage == "releasing" else "goes back", fault=bool(late))
        self._enter(stage, now)

    def _walk_back(self, now: float) -> None:
        """One step back along the way that the tool came."""
        assert self._told is not None
        left = min(self._settings.retreat, self._limits.speed) * self._period
        while self._way:
            before, to = self._told, self._way[-1]
            self._told = stepped(before, to, left)
            if self._told is not to:
                break
            self._way.pop()
            left -= way_between(before, to)
        self._robot.command(self._told)
        if not self._way:
            self._enter("resting", now)

    def _end(self, now: float, why: str) -> None:
        if why:
            self._say(why, fault=self.fault)
        try:
            self._robot.release()
        except Exception as wrong:  # each package has errors of its own
            self._say(f"{self.name} does not take the order to let go ({wrong})", fault=True)
        self._enter("done", now)
        self._tell(math.inf)

    def _enter(self, stage: Stage, now: float) -> None:
        self.stage, self._entered = stage, now

    def _say(self, text: str, *, fault: bool = False) -> None:
        self.fault |= fault
        arrival, film = self._film
        time = film + (self._turned - arrival) if math.isfinite(film) else math.nan
        self.events.append(Happened(time, text, fault))

    def _tell(self, now: float) -> None:
        if now - self._told_state >= _TELL_EVERY:
            self._told_state = now
            self._watch(self.now())

    @property
    def tool(self) -> Array:
        """(2,) m, the tool's place in the beam's frame."""
        return np.full(2, np.nan) if self._arm is None else self._place.to_beam(self._arm.pose.position)[:2]

    def now(self) -> DriveState:
        """What is known."""
        return replace(
            self.state, stage=self.stage, says=self.events[-1].text if self.events else "", goal=self._control.goal,
            asked=self._asked.copy(), felt=self._felt.copy(), said=self.said,
            delay=self.meter.delay if math.isfinite(self.meter.sd) else math.nan,
        )  # fmt: skip

    # A better k(s), learned meanwhile.

    @property
    def leads_to(self) -> tuple[Array, Array, Beam] | None:
        """The goal (2,) m, the force (2,) N that is asked for now, and the beam they are by; None where it does not
        drive."""
        if self.stage not in LED:
            return None
        return self._control.goal, self._asked.copy(), self._control.beam

    def renew(self, control: Controller) -> None:
        """Go on to the same goal by this controller, of another k(s); from any thread."""
        model = BentModel(control.beam, self.plan.push_s, self._places, self.plan.gravity)
        if model.bend(control.reference.begins):
            self._renewed = (control, model)

    def _take_renewed(self, now: float) -> None:
        if self._renewed is None:
            return
        (control, model), self._renewed = self._renewed, None
        if not np.allclose(control.goal, self._control.goal):
            return
        stiffer = mean_ratio(control.beam, self._control.beam, self.plan.push_s)
        wanted = stiffer * self._asked
        if not model.bend(wanted):
            return
        control = replace(control, reference=replace(control.reference, rise=max(control.reference.rise, 1.0)))
        self._control, self._model = control, model
        self._loop = control.begin(now, wanted - control.reference.begins)
        self._goal_begun = now
        self._say(f"goes on with k(s) as learned now, {100.0 * (stiffer - 1.0):+.3g} % on average")


_FEWEST_AT_REST = 10  # pictures, and rows of the force
_SHORTEST = 0.02  # of the way to the shape under a felt force: a shorter step has met an end
_CONTACT = 5e-4  # m, by which the tool's place may be off the beam's
_ASKEW = {"push": 0.3, "hold": 1.0}  # of the variance of a wrong k: it turns the force, too, and makes a moment
_FACTORS = (1.0, 0.8, 1.25, 0.65, 1.55, 0.5, 2.0)  # of all of k
_SLACK = 2e-3  # m: nearer than this no tag is doubted
_JUMP = 4.0  # times the tool's largest speed: no place of the beam goes faster
_WITHIN_95 = 2.45  # sds of a plane normal variable
_TELL_EVERY = 0.1  # s


def stepped(here: ToolPose, there: ToolPose, most: float) -> ToolPose:
    """From one pose towards another, no farther than `most` [m]; it turns by the same share of the turn."""
    size = way_between(here, there)
    if size <= most:
        return there
    share = max(most, 0.0) / size
    turn = Rotation.from_matrix(there.rotation @ here.rotation.T).as_rotvec()
    turned = np.asarray(Rotation.from_rotvec(share * turn).as_matrix() @ here.rotation)
    return ToolPose(here.position + share * (there.position - here.position), turned)


def way_between(here: ToolPose, there: ToolPose) -> float:
    """m: the longer of the tool's way and that of a place `ARM` beside it as the tool turns."""
    turn = float(Rotation.from_matrix(there.rotation @ here.rotation.T).magnitude())
    return max(float(np.linalg.norm(there.position - here.position)), ARM * turn)


def bending_weights(push_s: float) -> tuple[Array, Array]:
    """(S,) places s and weights, whose sum is 1: how much each counts when a force across the straight beam at `push_s`
    bends it."""
    s = push_s * np.linspace(0.0, 1.0, 41)
    weights = (push_s - s) ** 2
    return s, weights / weights.sum()


def mean_ratio(beam: Beam, other: Beam, push_s: float) -> float:
    """The geometric mean over s of k of one over that of the other, with `bending_weights`."""
    s, weights = bending_weights(push_s)
    return float(np.exp(weights @ np.log(np.asarray(beam.stiffness(s)) / np.asarray(other.stiffness(s)))))
