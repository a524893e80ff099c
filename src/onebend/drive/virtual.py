"""A beam, a robot and a camera that are not there, behind the interface of those that are.

The beam is the lab's rod with the effects of a bench; the hand holds it through a spring. Asked for a pose, the hand
goes there with a lag; asked for a force, it moves until its sensor shows it. The beam follows without swinging. The
camera draws it as the lab's films do (luma alone, no shadows), and each picture comes late. `VirtualRobot` runs all of
it in a process of its own in real time.
"""

from __future__ import annotations

import math
import time as host
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.drive.placing import axes_of
from onebend.drive.robots import DEAD_MAN, ArmState, Skill, ToolForce, ToolPose
from onebend.errors import MechanicsError, RecordingError
from onebend.lab import bench_camera, filming, rod, virtual
from onebend.live.sources import Clock, End, Frame, StampTiming
from onebend.progress import interrupts_held, leave_interrupts_to_parent, real_time
from onebend.recording.entries import Recording
from onebend.recording.video import Picture
from onebend.records import Array

TICK = 0.008  # s of the simulation


@dataclass(frozen=True)
class VirtualSetup:
    """All that is there."""

    bench: virtual.VirtualBench  # its beam, tags and effects; its push and its sensor play no part
    rec: Recording  # what recording.toml says: camera, axes of the force, place of the push
    holds: bool = True  # the hand holds the end and turns it
    lag: float = 0.02  # s, of the robot
    give: float = 1.0 / 2000.0  # m/N of the hand and the arm behind it
    turn_give: float = 0.2  # rad/(N m)
    admittance: float = 8.0  # m/s per N that is lacking, asked for a force
    fastest: float = 0.25  # m/s
    white: float = 0.005  # N, of one sample of the wrench
    slow: tuple[float, float] = (0.005, 2.0)  # N and s: sd and correlation time of what wanders
    bias: tuple[float, float, float] = (0.4, -0.2, 0.6)  # N
    gain: float = 1.0
    fps: float = 30.0
    delay: float = 0.06  # s, from exposure to arrival
    noise: float = 1.5  # of 255
    sees: float = math.radians(85.0)  # of a beam bent to an arc of this angle, to either side
    off: tuple[float, float, float] = (0.004, -0.003, 0.005)  # rad, by which the axes really lie
    base: tuple[float, float, float] = (0.45, -0.2, 0.3)  # m, the clamp in the robot's base
    seed: int = 0


class VirtualCell:
    """The simulation; it stands until it is told to go on. Not for two threads."""

    eye: type[bench_camera.BenchCamera] = bench_camera.BenchCamera

    def __init__(self, setup: VirtualSetup, begin: float = 0.0) -> None:
        """At rest at `begin` [s], the hand on the beam without pushing."""
        self.setup, self.time = setup, begin
        self.slipped = False  # the beam has jumped off the hand
        bench, rec = setup.bench, setup.rec
        assert rec.force is not None
        self._axes = axes_of(rec.force) @ Rotation.from_rotvec(setup.off).as_matrix()
        self._sign = -1.0 if rec.force.acts_on == "robot" else 1.0
        at = 1.0 if setup.holds or rec.push is None else bench.push.at_s
        self._task = rod.RodTask(bench.beam, bench.effects, np.array([tag.s for tag in bench.tags]), _nothing, at, 1.0)
        self._cells = rod.cells_of(self._task, filming.PLACES)
        self.edges = self._cells.edges  # (N + 1,) s of `poses`
        self._contact = rod.contact_of(self._task, self._cells)
        count = len(self._cells.size)
        self._decay, self._old, self._new = rod.relaxation(bench.effects, TICK)
        self._angle, self._lagged, self._turned = self._contact.rest, np.zeros(count), np.zeros(count)
        self._node = int(np.argmin(np.abs(self._cells.edges - at)))
        self._shown = np.searchsorted(self._cells.edges, filming.PLACES - 1e-9)
        self.wrench = np.zeros(3 if setup.holds else 2)
        self._inverse: Array = np.zeros((0, 0))
        self._by_wrench: Array = np.zeros((0, 0))
        self.poses = self._bent(self.wrench, self._angle)[1]
        self.hand = self._touched = self.poses[self._node].copy()  # m, m, rad; as the beam followed it last
        self._wanted: ToolPose | ToolForce | None = None
        self._rng, self._wander = np.random.default_rng([setup.seed, 21]), np.zeros(3)
        self._next = begin
        self.frames: deque[tuple[float, float, Callable[[], Picture]]] = deque()  # due, exposed, drawn when taken
        self._exposed = begin  # s, of the next picture
        self._camera = self.eye(bench, rec, noise=setup.noise, sees=setup.sees, seed=setup.seed)
        self.largest = 0.0  # N on the beam so far

    def advance(self, until: float) -> None:
        """Go on to `until` [s]."""
        while self._next <= until + 1e-9:
            self.time = self._next
            self._step()
            if self.time >= self._exposed - 1e-9:
                self._expose()
            self._next += TICK

    def skip_to(self, now: float) -> None:
        """Nothing happened until then: this process stood still."""
        self._next = self._exposed = now

    def command(self, wanted: ToolPose | ToolForce | None) -> None:
        """None: stay."""
        self._wanted = wanted if wanted is not None else self._tool()

    def state(self) -> ArmState:
        """As the robot says it."""
        felt = self.sensed()
        wrench = np.concatenate([self._sign * self.setup.gain * (self._axes[:, :2] @ felt), np.zeros(3)])
        wrench[:3] += np.array(self.setup.bias) + self._wander + self.setup.white * self._rng.standard_normal(3)
        return ArmState(self.time, self._tool(), wrench)

    def sensed(self) -> Array:
        """(2,) N on the beam, as the sensor has it but for its noise."""
        return self.wrench[:2]

    def _tool(self) -> ToolPose:
        place = np.array(self.setup.base) + self._axes[:, :2] @ self.hand[:2]
        turn = Rotation.from_rotvec((self.hand[2] - self._contact.rest[-1]) * self._axes[:, 2]).as_matrix()
        return ToolPose(place, np.asarray(turn))

    def _step(self) -> None:
        setup = self.setup
        sd, memory = setup.slow
        keep = math.exp(-TICK / memory)
        self._wander = keep * self._wander + math.sqrt(1.0 - keep**2) * sd * self._rng.standard_normal(3)
        goal, most = self.hand, setup.fastest * TICK
        if isinstance(self._wanted, ToolPose):
            away = (self._wanted.position - np.array(setup.base)) @ self._axes
            about = Rotation.from_matrix(self._wanted.rotation).as_rotvec() @ self._axes[:, 2]
            share = 1.0 - math.exp(-TICK / max(setup.lag, 1e-6))
            goal = self.hand + share * (np.array([*away[:2], self._contact.rest[-1] + about]) - self.hand)
        elif isinstance(self._wanted, ToolForce):
            base = (self._wanted.plane[:, :2] @ self._wanted.force) @ self._axes[:, :2]
            lacks, stiff = base - self.sensed(), self._inverse[:2, :2] if len(self._inverse) else np.zeros((2, 2))
            way = np.linalg.solve(np.eye(2) + setup.admittance * TICK * stiff, setup.admittance * TICK * lacks)
            goal, most = self.hand + np.append(way, 0.0), min(self._wanted.speed, setup.fastest) * TICK
        step = goal - self.hand
        size = float(np.hypot(step[0], step[1]))
        self.hand = self.hand + step * (min(1.0, most / size) if size > 0.0 else 1.0)
        self._follow()
        self.largest = max(self.largest, float(np.hypot(*self.wrench[:2])))

    def _follow(self) -> None:
        """The beam goes where the hand is: at once, else in small steps, else it slips off."""
        if self.slipped:
            return
        begin = self._touched
        for parts in (1, 8):
            try:
                for share in np.linspace(0.0, 1.0, parts + 1)[1:]:
                    self._lead_to(begin + share * (self.hand - begin))
                break
            except MechanicsError:
                self._inverse = np.zeros((0, 0))
        else:
            self.slip()
            return
        self._touched = self.hand
        turned = np.diff(self._angle) - self._cells.rest
        self._lagged = self._held() + self._new * turned
        self._turned = turned

    def _lead_to(self, hand: Array) -> None:
        """The wrench with which the beam is at `hand` (3,), by Newton's method with an inverse that is kept."""
        count = len(self.wrench)
        gives = np.array([self.setup.give, self.setup.give, self.setup.turn_give])[:count]
        wrench, angle, poses = self.wrench.copy(), self._angle, self.poses
        off = change = np.zeros(count)
        for attempt in range(_MOST_TRIES):
            before, off = off, hand[:count] - poses[self._node, :count] - gives * wrench
            if attempt > 0 and float(np.abs(off).max()) < _CLOSE:
                break
            if not len(self._inverse) or attempt in _ANEW:
                self._linearise(wrench, angle, gives)
            elif attempt > 0:  # Broyden's better matrix
                went = self._inverse @ (before - off)
                self._inverse += np.outer(change - went, change @ self._inverse) / float(change @ went)
            change = self._inverse @ off
            wrench = wrench + change
            angle, poses = self._bent(wrench, angle + self._by_wrench @ change)
        self.wrench, self._angle, self.poses = wrench, angle, poses

    def slip(self) -> None:
        """No shape is near: the beam has jumped off the hand, and lies at rest."""
        self.slipped = True
        self.wrench = np.zeros_like(self.wrench)
        self._angle, self.poses = self._bent(self.wrench, self._contact.rest)

    def _linearise(self, wrench: Array, angle: Array, gives: Array) -> None:
        count = len(wrench)
        begin, there = self._bent(wrench, angle)
        columns, turns = np.zeros((count, count)), np.zeros((len(angle), count))
        for i, size in enumerate((1e-4, 1e-4, 1e-5)[:count]):
            step = np.zeros(count)
            step[i] = size
            turned, moved = self._bent(wrench + step, begin)
            columns[:, i] = (moved - there)[self._node, :count] / size
            turns[:, i] = (turned - begin) / size
        self._inverse = np.asarray(np.linalg.inv(columns + np.diag(gives)), dtype=np.float64)
        self._by_wrench = turns

    def _held(self) -> Array:
        """What of the turns has relaxed already, as `rod.follow` has it."""
        return np.asarray(self._decay * self._lagged + self._old * self._turned)

    def _bent(self, wrench: Array, angle: Array) -> tuple[Array, Array]:
        """Angles of clamp and cells, and poses (N + 1, 3) at their ends. A moment is a pair of forces on the last
        cell."""
        cells, share = self._cells, self._task.effects.relaxation
        beyond = np.zeros((len(cells.size), 2))
        if len(wrench) == 3:
            last, arm = float(angle[-1]), cells.length * cells.size[-1]
            beyond[-1] = wrench[2] / arm * np.array([-math.sin(last), math.cos(last)])
        found, place = rod.balanced(
            cells, self._contact, angle, wrench[:2], beyond, share * self._held(), share * self._new
        )
        held = wrench[:2] * self._contact.loaded(place)[:, None] + beyond
        return found, rod.poses_of(cells, found, held)

    def _expose(self) -> None:
        """A picture is taken now, and drawn when it is fetched."""
        self._exposed += 1.0 / self.setup.fps
        shown, force = self.poses[self._shown].copy(), self.wrench[:2].copy()
        draw = partial(self._camera.picture, shown, force, self.time)
        self.frames.append((self.time + self.setup.delay, self.time, draw))


_MOST_TRIES, _ANEW = 12, (4, 8)  # turns of Newton's method, and those before which its matrix is made anew
_CLOSE = 1e-6  # m, rad


def _nothing(time: Array) -> Array:
    return np.zeros((len(time), 2))


# In real time, in a process of its own.


class VirtualRobot:
    """The robot, and its cell, in another process."""

    can: frozenset[Skill] = frozenset(("pose", "force"))
    timing = StampTiming(host=True, delay=0.0, delay_error=0.005)
    name = "the virtual robot"

    def __init__(self, setup: VirtualSetup) -> None:
        context = get_context("spawn")
        self._orders, orders = context.Pipe()
        states, self._states = context.Pipe(duplex=False)
        pictures, self._frames = context.Pipe(duplex=False)
        size, self._here = setup.rec.camera, states
        assert size is not None
        film = _Film(
            context.RawArray("B", _BUFFERS * size.width * size.height), context.Semaphore(_BUFFERS), size.height
        )  # fmt: skip
        self._camera = VirtualCamera(pictures, film, self.begin)
        there = (setup, orders, self._states, self._frames, film)
        self._process = context.Process(target=_serve, args=there, daemon=True)
        self._newest: ArmState | None = None

    def camera(self) -> VirtualCamera:
        """Its camera; it is read only while the robot is connected."""
        return self._camera

    def begin(self) -> None:
        """Start the process, once."""
        if self._process.pid is None:
            with interrupts_held():
                self._process.start()

    def connect(self, clock: Clock) -> None:  # noqa: ARG002 (it keeps the same time)
        self.begin()
        if not self._here.poll(_PATIENCE):
            raise RecordingError(f"{self.name} did not start within {_PATIENCE:.0f} s. Is there memory left?")

    def state(self) -> ArmState:
        while self._here.poll():
            self._newest = self._here.recv()
        if self._newest is None:
            raise ConnectionError("it has said nothing yet")
        return self._newest

    def command(self, wanted: ToolPose | ToolForce) -> None:
        self._orders.send(wanted)

    def hold(self) -> None:
        self._orders.send("hold")

    def release(self) -> None:
        self._orders.send("hold")

    def ask(self, what: str) -> Any:
        """The truth, for those who compare: `poses`, `largest`."""
        self._orders.send(what)
        return self._orders.recv() if self._orders.poll(_PATIENCE) else None

    def close(self) -> None:
        if self._process.pid is not None and self._process.is_alive():
            self._orders.send("end")
            self._process.join(timeout=2.0)
            if self._process.is_alive():
                self._process.terminate()


_PATIENCE = 60.0  # s for a process to begin
_BUFFERS = 4  # pictures that the camera keeps until they are read; further ones are lost


@dataclass(frozen=True)
class _Film:
    """Memory that both processes see: a pipe would hand a picture over in a dozen pieces, each when the other has the
    processor."""

    bytes: Any
    free: Any  # semaphore: buffers that may be written
    height: int

    def buffer(self, number: int) -> Picture:
        """(H, W) of a picture."""
        buffers = np.frombuffer(self.bytes, np.uint8).reshape(_BUFFERS, self.height, -1)
        return np.asarray(buffers[number % _BUFFERS])


class VirtualCamera:
    """The camera of that process."""

    name = "the virtual camera"
    timing = StampTiming(host=True, delay=0.0, delay_error=0.005)

    def __init__(self, frames: Connection, film: _Film, begin: Callable[[], None]) -> None:
        self._frames, self._film, self._begin = frames, film, begin
        self._clock: Clock | None = None

    def open(self, clock: Clock) -> None:
        self._clock = clock
        self._begin()

    def close(self) -> None:
        """The process is its robot's."""

    def read(self, wait: float) -> Frame | End | None:
        assert self._clock is not None
        try:
            if not self._frames.poll(wait):
                return None
            exposed, number, buffer = self._frames.recv()
        except (EOFError, OSError):
            return End(f"{self.name} is gone", fault=True)
        picture = self._film.buffer(buffer).copy()
        self._film.free.release()
        return Frame(picture, exposed, self._clock.now(), number)


def _serve(setup: VirtualSetup, orders: Connection, states: Connection, frames: Connection, film: _Film) -> None:
    """The process: it keeps up with the clock, and says what is new."""
    leave_interrupts_to_parent()
    with real_time():
        _keep_up(setup, orders, states, frames, film)


def _keep_up(setup: VirtualSetup, orders: Connection, states: Connection, frames: Connection, film: _Film) -> None:
    cell = VirtualCell(setup, host.monotonic())
    ready: deque[tuple[float, float, Picture]] = deque()
    number, sent, asked, heard = 0, 0, True, math.inf
    try:
        while asked:
            now = host.monotonic()
            if now - cell.time > 1.0:  # it stood still: the time between is lost
                cell.skip_to(now)
            cell.advance(now)
            states.send(cell.state())
            while len(cell.frames) > 1:  # it is late: the camera loses pictures
                cell.frames.popleft()
                number += 1
            if cell.frames:
                due, exposed, draw = cell.frames.popleft()
                ready.append((due, exposed, draw()))
            while ready and ready[0][0] <= host.monotonic():
                _, exposed, picture = ready.popleft()
                if film.free.acquire(block=False):
                    film.buffer(sent)[:] = picture
                    frames.send((exposed, number, sent))
                    sent += 1
                number += 1
            while orders.poll():
                heard, asked = now, _obey(cell, orders, orders.recv()) and asked
            if now - heard > DEAD_MAN:
                cell.command(None)
            due_next = [ready[0][0]] if ready else []
            host.sleep(max(min([cell.time + TICK, *due_next]) - host.monotonic(), 2e-4))
    except (EOFError, OSError, BrokenPipeError):
        return


def _obey(cell: VirtualCell, orders: Connection, order: Any) -> bool:
    if isinstance(order, (ToolPose, ToolForce)):
        cell.command(order)
    elif order == "hold":
        cell.command(None)
    elif order == "end":
        return False
    else:
        orders.send(getattr(cell, order))
    return True
