"""The drive itself: 125 times a second it looks, decides and commands, and holds where anything is wrong.

    waiting -> driving -> staying -> (driving ...) -> returning -> resting -> done
                   any of these, at a fault or a stop -> holding -> releasing -> resting -> done
                   where pictures, answers or turns were only late -> holding -> the same stage again

To the recorder it is a force sensor: each reading is one turn of the loop and gives a row of the log. So a drive is
recorded as any push is, and a played clock plays it as it would go in real time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.control.loop import Controller, ControllerState, bounded
from onebend.drive.plan import ARM, DrivePlan
from onebend.drive.robots import Robot, ToolForce, ToolPose
from onebend.drive.seeing import BentModel
from onebend.drive.watching import LED, SILENCE, UNKNOWN, Cell, Stage, late, wrong
from onebend.live.sources import Clock, End, ForceSource, Samples
from onebend.recording.entries import Recording
from onebend.records import Array

SETTLING = 0.5  # s for which the point must stay on its goal
THIN = 5e-4  # m between places of the way that is walked back
PATIENCE = 1.0  # s for which a silent robot is waited for, in hold
CALM, LONGEST_PAUSE = 0.25, 5.0  # s of pictures and answers in time, before it goes on; for which it waits for that
MOST_STEPS = 3  # of the way to the goal in one late turn: a chord of it would bend the beam otherwise than its arc
MOST_PAUSES = 20  # of one drive, on its way out
MOST_HOLDS = 3  # of one drive, beside the pauses; then the robot is left where it stands
AFTER_FAULT = 1.0  # s of rest behind a release
WITHIN_95 = 2.45  # sds of a plane normal variable
TELL_EVERY = 0.1  # s


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
    """Where a drive stands; NaN where nothing is known. Moments are in s, of this machine's clock."""

    control: Controller  # that leads to the goal
    loop: ControllerState  # where it is on its way there
    number: int = 0  # of the goal
    begun: float = math.inf  # when its way began, later by what was lost in pauses and late turns
    led: float = math.inf  # the last turn that led it
    since: float = math.inf  # from when on the places of the point count
    stage: Stage = "waiting"
    entered: float = math.inf  # when this stage began
    paused: tuple[Stage, str] | None = None  # the stage that goes on as soon as nothing is late any more; what was
    late: float = -math.inf  # when anything was late
    in_time: float = -math.inf  # when nothing was, in a pause
    holds: int = 0  # that were no pauses
    told: ToolPose | None = None  # where the tool was sent
    way: tuple[ToolPose, ...] = ()  # by which it came
    asked: Array = field(default_factory=lambda: np.zeros(2))  # (2,) N
    felt: Array = field(default_factory=UNKNOWN.copy)  # (2,) N
    point: Array = field(default_factory=UNKNOWN.copy)  # (2,) m, seen
    delay: float = math.nan  # s, measured
    said: float = math.nan  # m, within which the point is to come to rest: 95 %, and what counts as reached
    says: str = ""  # the newest thing that was said

    @property
    def goal(self) -> Array:
        """(2,) m."""
        return self.control.goal

    @property
    def distance(self) -> float:
        """m from the goal."""
        return float(np.linalg.norm(self.point - self.goal))

    @property
    def doing(self) -> Stage:
        """The stage, or that in which it pauses."""
        return self.stage if self.paused is None else self.paused[0]


class Drive:
    """A plan, a robot and an eye. `read` turns the loop; pictures come to its `cell`, from another thread."""

    def __init__(
        self, plan: DrivePlan, robot: Robot, rec: Recording, sensor: ForceSource | None = None,
        watch: Callable[[DriveState], None] = lambda _: None,
    ) -> None:  # fmt: skip
        """`sensor`: measures the force instead of the robot; `watch`: told what is known, some ten times a second."""
        self.plan, self.cell = plan, Cell(plan, robot, rec, sensor)
        self.name, self.columns = robot.name, self.cell.columns
        self.timing = robot.timing if sensor is None else sensor.timing
        first = plan.goals[0].control
        self.state = DriveState(first, first.begin(math.inf))
        self.events, self.outcomes = list[Happened](), list[GoalOutcome]()
        self.pauses: list[float] = []  # s of each
        self.latency: list[float] = []  # s from a picture's arrival to the command that it led to
        self.turns: list[float] = []  # s that each turn took
        self._watch, self._watched = watch, -math.inf
        self._stop = False
        self._renewed: tuple[Controller, BentModel, float] | None = None
        self._clock: Clock | None = None
        self._next = -math.inf

    # To the recorder: a force sensor that is read turn by turn.

    def open(self, clock: Clock) -> None:
        """Connect the robot. Raises `RecordingError` where it, or the sensor, does not answer."""
        self._clock = clock
        self.cell.open(clock)
        self._next = clock.now()

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
        self._next = max(self._next + 1.0 / self.plan.settings.rate, now)
        rows, doing = Samples(np.zeros(0), np.zeros((0, len(self.columns))), now), "the drive failed"
        try:
            rows = self.cell.sense(now, self.state.doing)
            self.state, doing = self._decided(self.state), f"{self.name} answers no more"
            self.state = self._acted(self.state)
        except Exception as failed:  # each robot's package has errors of its own
            self.state = self._failed(self.state, f"{doing} ({failed})")
        if math.isfinite(self.cell.turn.arrival) and self.state.stage in LED:
            self.latency.append(self._clock.now() - self.cell.turn.arrival)
        self._tell(now)
        self.turns.append(self._clock.now() - now)
        return rows

    def close(self) -> None:
        """Let go slowly, if the tool is still out, and disconnect."""
        if self._clock is not None and self.state.stage != "waiting" and not self.over:
            self.state = self._halted(self.state, "the recording ended, and the drive with it", fault=True)
            while not self.over:
                self.read(math.inf)
        self.cell.close()

    @property
    def over(self) -> bool:
        return self.state.stage == "done"

    @property
    def moved(self) -> bool:
        """Whether the tool was ever told to move."""
        return self.state.told is not None

    @property
    def fault(self) -> bool:
        """Whether anything went wrong."""
        return any(one.fault for one in self.events)

    def stop(self) -> None:
        """Hold, and release slowly; from any thread. A second time: let go at once."""
        self._stop = True

    def renew(self, control: Controller, stiffer: float) -> None:
        """Go on to the same goal by this controller, of another k(s), `stiffer` times as large; from any thread."""
        model = self.cell.model_of(control.beam)
        if model.bend(control.reference.begins):
            self._renewed = (control, model, stiffer)

    def _say(self, text: str, *, fault: bool = False) -> None:
        arrival, film = self.cell.film
        self.events.append(Happened(film + self.cell.turn.now - arrival, text, fault))

    def _tell(self, now: float) -> None:
        meter, eye, says = self.cell.meter, self.cell.eye, self.events[-1].text if self.events else ""
        said = WITHIN_95 * math.hypot(eye.camera_sd, eye.rest_noise) + self.plan.settings.within
        delay = meter.delay if math.isfinite(meter.sd) else math.nan
        self.state = replace(self.state, says=says, said=said, delay=delay, felt=self.cell.turn.force)
        if self.over or now - self._watched >= TELL_EVERY:
            self._watched = now
            self._watch(self.state)

    # What a turn does, stage by stage: each gives the next state.

    def _decided(self, state: DriveState) -> DriveState:
        """Whether it may go on."""
        now, tardy = self.cell.turn.now, late(self.cell, state.doing)
        if tardy or self.cell.turn.refused:
            state = replace(state, late=now)
        elif state.paused is not None:
            state = replace(state, in_time=now)
        amiss = tardy or wrong(self.cell, state.stage)
        if self._stop:
            self._stop = False
            if state.paused is not None:
                self._say("holds: stopped by hand")
                return replace(state, paused=None)
            if state.stage in ("holding", "releasing"):
                return self._ended(state, "let go at once, as asked")
            return self._halted(state, "stopped by hand")
        return self._halted(state, amiss, fault=True, passes=bool(tardy)) if amiss else state

    def _acted(self, state: DriveState) -> DriveState:
        turn, rest = self.cell.turn, AFTER_FAULT if self.fault else self.plan.settings.rest
        if state.stage == "waiting" and self.cell.unfit:
            return self._ended(state, self.cell.unfit, fault=True)
        if state.stage == "waiting" and math.isfinite(turn.arrival):  # the rest was read, and pictures do not wait
            assert turn.arm is not None
            self._say(f"moves: to {1e3 * state.goal[0]:.4g}, {1e3 * state.goal[1]:.4g} mm")
            return self._to_goal(replace(state, told=turn.arm.pose, way=(turn.arm.pose,)), 0)
        if state.stage in LED:
            return self._led(state)
        if state.stage == "holding":
            return self._held(state)
        if state.stage in ("returning", "releasing"):
            return self._walked_back(state)
        if state.stage == "resting" and turn.now - state.entered >= rest:
            return self._ended(state, "the tool is back where it began, and the robot is free")
        return state

    def _to_goal(self, state: DriveState, number: int) -> DriveState:
        now, control = self.cell.turn.now, self.plan.goals[number].control
        loop = control.begin(now, state.asked - control.reference.begins if number else (0.0, 0.0))
        return replace(
            state,
            stage="driving",
            entered=now,
            number=number,
            control=control,
            loop=loop,
            begun=now,
            led=now,
            since=now,
        )

    def _led(self, state: DriveState) -> DriveState:
        """One turn of the closed loop."""
        cell, turn, now = self.cell, self.cell.turn, self.cell.turn.now
        stood = max(now - state.led - MOST_STEPS * cell.period, 0.0)
        loop = replace(state.loop, began=state.loop.began + stood)
        state = self._with_renewed(replace(state, loop=loop, led=now, begun=state.begun + stood))
        control, seen = self._timed(state.control), turn.point if math.isfinite(turn.arrival) else None
        if seen is not None:
            cell.meter.shown(now, seen, turn.point_sd)
            state = replace(state, point=seen)
        loop, asked = control.step(state.loop, seen, now)
        asked = bounded(asked, self.plan.limits.force)
        poses = cell.bend(asked)
        if poses is None:
            return self._halted(replace(state, loop=loop), "no stable shape of the beam leads on from here", fault=True)
        return self._gone_on(self._commanded(replace(state, loop=loop, asked=asked), poses[-1]))

    def _timed(self, control: Controller) -> Controller:
        """The controller, told the delay as it was measured."""
        if not math.isfinite(self.cell.meter.sd):
            return control
        settings = control.settings
        lag = settings.timing.lag if self.plan.settings.by == "pose" else 0.0
        timing = replace(settings.timing, delay=max(self.cell.meter.delay - lag, 0.0))
        return replace(control, settings=replace(settings, timing=timing))

    def _with_renewed(self, state: DriveState) -> DriveState:
        """By the k(s) that was learned meanwhile, if there is one."""
        if self._renewed is None:
            return state
        (control, model, stiffer), self._renewed = self._renewed, None
        wanted = stiffer * state.asked
        if not (np.allclose(control.goal, state.goal) and model.bend(wanted)):
            return state
        self._say(f"goes on with k(s) as learned now, {100.0 * (stiffer - 1.0):+.3g} % on average")
        self.cell.model, now = model, self.cell.turn.now
        control = replace(control, reference=replace(control.reference, rise=max(control.reference.rise, 1.0)))
        loop = control.begin(now, wanted - control.reference.begins)
        return replace(state, control=control, loop=loop, begun=now)

    def _commanded(self, state: DriveState, hand: Array) -> DriveState:
        """The tool to (3,) m, m, rad of the beam's frame, or the force; no faster than is allowed."""
        cell, speed = self.cell, self.plan.limits.speed
        assert cell.turn.arm is not None
        assert state.told is not None
        start, rest, axes = state.way[0], cell.rest[-1], cell.place.rotation
        if self.plan.settings.by == "force":
            told = cell.turn.arm.pose  # a force moves the tool as the true k lets it
            cell.robot.command(ToolForce(state.asked, axes, speed))
        else:
            turn = Rotation.from_rotvec((hand[2] - rest[2]) * axes[:, 2] * (self.plan.settings.hand == "hold"))
            wanted = ToolPose(start.position + axes[:, :2] @ (hand - rest)[:2], turn.as_matrix() @ start.rotation)
            told = stepped(state.told, wanted, speed * cell.period)
            cell.robot.command(told)
        cell.meter.told(cell.turn.now, cell.place.to_beam(told.position)[:2])
        far = way_between(state.way[-1], told) > THIN
        return replace(state, told=told, way=(*state.way, told) if far else state.way)

    def _gone_on(self, state: DriveState) -> DriveState:
        """To the next goal, or back, when this one is done."""
        now, settings, rise = self.cell.turn.now, self.plan.settings, state.control.reference.rise
        since, planned = now - state.begun, self.plan.goals[state.number]
        if state.stage == "staying":
            return self._left(state, reached=True) if now - state.entered >= settings.stay else state
        if since >= rise and not planned.waits:
            return self._left(state, reached=True)
        if since >= rise and self._arrived(state):
            self._say(f"goal {state.number + 1} of {len(self.plan.goals)} is reached after {since:.1f} s")
            return replace(state, stage="staying", entered=now)
        if since > max(settings.longest, 2.0 * rise):
            away = 1e3 * state.distance
            self._say(f"goal {state.number + 1} is given up after {since:.0f} s, {away:.2g} mm away", fault=True)
            return self._left(state, reached=False)
        return state

    def _arrived(self, state: DriveState) -> bool:
        time, places = self.cell.meter.newest(SETTLING, state.since)
        if not len(time) or time[0] > self.cell.turn.now - 0.8 * SETTLING:
            return False
        away, within = places - state.goal, self.plan.settings.within
        farthest = float(np.linalg.norm(away, axis=1).max())
        return float(np.linalg.norm(away.mean(axis=0))) <= within >= farthest - 3.0 * self.cell.eye.rest_noise

    def _left(self, state: DriveState, *, reached: bool) -> DriveState:
        """The goal is done with."""
        _, places = self.cell.meter.newest(SETTLING, state.since)
        seen = places.mean(axis=0) if len(places) else UNKNOWN
        seconds, felt = self.cell.turn.now - state.begun, self.cell.turn.force
        said = state.said if self.plan.goals[state.number].waits else math.nan
        self.outcomes.append(GoalOutcome(state.goal, reached, seconds, seen, said, state.asked, felt))
        if reached and state.number + 1 < len(self.plan.goals):
            return self._to_goal(state, state.number + 1)
        return self._going_back(state, "returning")

    def _failed(self, state: DriveState, why: str) -> DriveState:
        """A fault, and no end of the loop; where it holds, or no tool is out, the end of the drive."""
        if state.stage in ("waiting", "holding", "resting"):
            return self._ended(state, f"{why}. Look at it before you touch the beam", fault=True)
        return self._halted(state, why, fault=True)

    def _halted(self, state: DriveState, why: str, *, fault: bool = False, passes: bool = False) -> DriveState:
        """Hold at once; the release comes after, or where it `passes` it goes on."""
        if state.stage in ("holding", "resting", "done"):
            return state
        if state.stage == "waiting":
            return self._ended(state, why, fault=fault)
        pauses = passes and (len(self.pauses) < MOST_PAUSES or state.stage not in LED)
        paused, holds = (state.stage, why) if pauses else None, state.holds + (not pauses)
        if holds > MOST_HOLDS:
            return self._ended(state, f"{why}: for the {holds}th time, and it is left where it stands", fault=fault)
        self._say(f"holds: {why}{_refusal(self.cell.robot.hold)}", fault=fault and not pauses)
        return replace(state, stage="holding", entered=self.cell.turn.now, paused=paused, holds=holds)

    def _held(self, state: DriveState) -> DriveState:
        now, silent = self.cell.turn.now, self.cell.turn.now - self.cell.turn.answered
        waited = now - state.entered
        if silent > PATIENCE:
            why = f"{self.name} answers no more: it stops by itself. Look at it before you touch the beam"
            return self._ended(state, why, fault=True)
        if silent > SILENCE:
            return state
        if state.paused is not None and now - state.late > CALM:
            self.pauses.append(waited)
            self.cell.doubted = 0
            busy, self.cell.waited = self.cell.waited > 0.5 * SILENCE, 0.0
            self._say(
                f"goes on after {waited:.1f} s{': pictures had waited, as this computer was busy' if busy else ''}"
            )
            return replace(state, stage=state.paused[0], entered=now, paused=None, since=now)
        if now - max(state.entered, state.in_time) >= self.plan.settings.hold or waited >= LONGEST_PAUSE:
            return self._going_back(state, "releasing")
        return state

    def _going_back(self, state: DriveState, stage: Stage) -> DriveState:
        assert self.cell.turn.arm is not None
        if self.plan.settings.by == "force":
            self.cell.robot.hold()
        told = self.cell.turn.arm.pose if stage == "releasing" else state.told
        why = "" if state.paused is None else f": {state.paused[1]}"
        self._say(f"releases slowly{why}" if stage == "releasing" else "goes back", fault=bool(why))
        return replace(state, stage=stage, entered=self.cell.turn.now, paused=None, told=told)

    def _walked_back(self, state: DriveState) -> DriveState:
        """One step back along the way that the tool came."""
        told, way = state.told, state.way
        assert told is not None
        left = min(self.plan.settings.retreat, self.plan.limits.speed) * self.cell.period
        while way:
            before, told = told, stepped(told, way[-1], left)
            if told is not way[-1]:
                break
            way, left = way[:-1], left - way_between(before, told)
        self.cell.robot.command(told)
        stage, entered = (state.stage, state.entered) if way else ("resting", self.cell.turn.now)
        return replace(state, told=told, way=way, stage=stage, entered=entered)

    def _ended(self, state: DriveState, why: str, *, fault: bool = False) -> DriveState:
        refused = _refusal(self.cell.robot.release)
        self._say(why + refused, fault=fault or bool(refused))
        return replace(state, stage="done", entered=self.cell.turn.now)


def _refusal(order: Callable[[], None]) -> str:
    """Give the robot this order; why it does not take it, in words, or nothing."""
    try:
        order()
    except Exception as wrong:  # each package has errors of its own
        return f"; and it does not take the order to {order.__name__} ({wrong})"
    return ""


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
