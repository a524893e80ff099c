"""Robots as the drive sees them: connected, asked for their state, commanded, held, released, closed.

A call may raise whatever the maker's package raises: the drive takes it as "answers no more". No call waits for the
robot's motion. A robot that is not asked for its state for 0.1 s must stop by itself; each class says how it does.
"""

from __future__ import annotations

import ctypes
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.errors import RecordingError
from onebend.extras import package
from onebend.live.sources import Clock, StampTiming
from onebend.records import Array

Skill = Literal["pose", "force"]
DEAD_MAN = 0.1  # s without a word from the drive, after which a robot stops by itself


@dataclass(frozen=True)
class ToolPose:
    """Where the tool is, or is to be, in the robot's base."""

    position: Array  # (3,) m
    rotation: Array  # (3, 3), the tool's axes in those of the base

    @property
    def vector(self) -> list[float]:
        """x, y, z [m] and the rotation vector [rad]."""
        return [*self.position.tolist(), *Rotation.from_matrix(self.rotation).as_rotvec().tolist()]


def pose_of(vector: Any) -> ToolPose:
    """The pose of x, y, z [m] and a rotation vector [rad]."""
    numbers = np.asarray(vector, dtype=float)
    return ToolPose(numbers[:3].copy(), np.asarray(Rotation.from_rotvec(numbers[3:6]).as_matrix()))


@dataclass(frozen=True)
class ToolForce:
    """The force that the tool is to put on the beam, in a plane in which it yields; across it, it stays."""

    force: Array  # (2,) N, in the plane's own axes
    plane: Array  # (3, 3), the plane's axes and its normal in those of the base
    speed: float  # m/s: it moves no faster


@dataclass(frozen=True)
class ArmState:
    """What a robot says of itself."""

    stamp: float  # s, its own clock
    pose: ToolPose
    wrench: Array  # (6,) N, N m in its base's axes; NaN where it has none


class Robot(Protocol):
    """A robot; an entry of `ROBOTS` makes one."""

    name: str  # for messages
    timing: StampTiming  # of its stamps
    can: frozenset[Skill]

    def connect(self, clock: Clock) -> None:
        """Raises `RecordingError` where it does not answer."""

    def state(self) -> ArmState:
        """The newest; it also tells the robot that the drive is alive."""
        ...

    def command(self, wanted: ToolPose | ToolForce) -> None:
        """Go there, or push so, from now on."""

    def hold(self) -> None:
        """Stay where it is, whatever was asked for before."""

    def release(self) -> None:
        """Give up control: the robot stands under its own program again."""

    def close(self) -> None: ...


SERVO_LOOKAHEAD, SERVO_GAIN = 0.1, 300.0  # s and without unit, of servoL
FORCE_FRAME = 2  # of forceMode: the task frame is not transformed
DEVIATION = (0.02, 0.02, 0.02, 0.17, 0.17, 0.17)  # m and rad, by which stiff axes may give in force mode


class UniversalRobot:
    """A Universal Robot through `ur-rtde`: servoL at the drive's own rate, force mode in the plane of bending.

    Its watchdog in the controller ends the program where the drive is silent.
    """

    can: frozenset[Skill] = frozenset(("pose", "force"))
    timing = StampTiming(delay=0.001, delay_error=0.01)

    def __init__(self, host: str, *, period: float, lookahead: float = SERVO_LOOKAHEAD) -> None:
        """`period` [s] of the drive's commands."""
        self.name, self._host, self._period, self._lookahead = f"the robot {host}", host, period, lookahead
        self._control: Any = None
        self._receive: Any = None
        self._forcing = False

    def connect(self, clock: Clock) -> None:  # noqa: ARG002 (its stamps are its own)
        control, receive = package("rtde_control", "ur"), package("rtde_receive", "ur")
        try:
            self._receive = receive.RTDEReceiveInterface(self._host)
            self._control = control.RTDEControlInterface(self._host)
            self._control.setWatchdog(1.0 / DEAD_MAN)
        except Exception as wrong:
            self.close()
            raise RecordingError(
                f"{self.name} does not answer ({wrong}). Is it on, in remote control, and is RTDE allowed?"
            ) from None

    def state(self) -> ArmState:
        receive = self._receive
        if not receive.isConnected():
            raise ConnectionError("the connection was lost")
        if receive.isProtectiveStopped() or receive.isEmergencyStopped():
            raise ConnectionError("it has stopped itself: see its own screen")
        self._done(self._control.kickWatchdog(), "its watchdog is not heard")
        wrench = np.array(receive.getActualTCPForce(), dtype=float)
        return ArmState(float(receive.getTimestamp()), pose_of(receive.getActualTCPPose()), wrench)

    def command(self, wanted: ToolPose | ToolForce) -> None:
        if isinstance(wanted, ToolPose):
            self._end_force()
            asked = (wanted.vector, 0.0, 0.0, self._period, self._lookahead, SERVO_GAIN)
            self._done(self._control.servoL(*asked), "it does not take servoL")
            return
        frame = [0.0, 0.0, 0.0, *Rotation.from_matrix(wanted.plane).as_rotvec().tolist()]
        wrench = [*wanted.force.tolist(), 0.0, 0.0, 0.0, 0.0]
        limits = [wanted.speed, wanted.speed, *DEVIATION[2:]]
        answer = self._control.forceMode(frame, [1, 1, 0, 0, 0, 0], wrench, FORCE_FRAME, limits)
        self._done(answer, "it does not take forceMode")
        self._forcing = True

    def hold(self) -> None:
        self.command(pose_of(self._receive.getActualTCPPose()))

    def release(self) -> None:
        self._end_force()
        self._control.servoStop()
        self._control.stopScript()

    def close(self) -> None:
        lost = self._receive is not None and not self._receive.isConnected()
        for one in filter(None, (self._control, self._receive)):
            if lost:  # its own thread is trying to connect again: closed or deleted meanwhile, ur-rtde crashes
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(one))
                continue
            with suppress(Exception):
                one.disconnect()
        self._control = self._receive = None

    def _end_force(self) -> None:
        if self._forcing:
            self._control.forceModeStop()
            self._forcing = False

    def _done(self, answer: bool, why: str) -> None:
        if not answer:
            raise ConnectionError(why)


FCI = 1e-3  # s, a Franka's cycle
FOLLOW = 25.0  # rad/s of the critically damped filter between the drive's poses and the arm's
STIFFNESS = (1500.0, 100.0)  # N/m and N m/rad, of the arm's own impedance
FASTEST, STRONGEST = (0.25, 1.0), (2.0, 8.0)  # m/s and rad/s; m/s^2 and rad/s^2


class FrankaArm:
    """A Franka arm through `pylibfranka`: Cartesian poses at 1 kHz to its own controller, stiff or as a spring.

    The arm has no force to be asked for: the beam is pushed by pose. Its own reflex stops it where a cycle is missed.
    """

    can: frozenset[Skill] = frozenset(("pose",))
    timing = StampTiming(delay=0.001, delay_error=0.01)

    def __init__(self, host: str, *, impedance: bool = True, stiffness: tuple[float, float] = STIFFNESS) -> None:
        """`impedance`: it gives like a spring of this stiffness; else it follows its joints' positions."""
        self.name, self._host, self._impedance, self._stiffness = f"the arm {host}", host, impedance, stiffness
        self._robot: Any = None
        self._made: Any = None
        self._wanted: ToolPose | None = None
        self._state: ArmState | None = None
        self._wrong = ""
        self._heard = 0.0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def connect(self, clock: Clock) -> None:  # noqa: ARG002 (its stamps are its own)
        self._made = made = package("pylibfranka", "franka")
        try:
            self._robot = made.Robot(self._host)
            if self._impedance:
                self._robot.set_cartesian_impedance([self._stiffness[0]] * 3 + [self._stiffness[1]] * 3)
            self._state = _franka_state(self._robot.read_once())
        except Exception as wrong:
            self.close()
            raise RecordingError(
                f"{self.name} does not answer ({wrong}). Is FCI active, nobody else on it, and the kernel real-time?"
            ) from None
        self._heard = time.monotonic()

    def state(self) -> ArmState:
        if self._wrong:
            raise ConnectionError(self._wrong)
        self._heard = time.monotonic()
        if self._thread is None:  # nobody reads for us
            self._state = _franka_state(self._robot.read_once())
        assert self._state is not None
        return self._state

    def command(self, wanted: ToolPose | ToolForce) -> None:
        if not isinstance(wanted, ToolPose):
            raise TypeError("the arm takes poses")
        self._wanted = wanted
        if self._thread is None:
            self._stop.clear()
            self._thread = threading.Thread(target=self._serve, daemon=True)
            self._thread.start()

    def hold(self) -> None:
        self._wanted = self._state.pose if self._state is not None else None

    def release(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=1.0)
            self._thread = None

    def close(self) -> None:
        self.release()
        self._robot = None

    def _serve(self) -> None:
        """A thousand times a second: where it is, and where to go next."""
        made = self._made
        mode = made.ControllerMode.CartesianImpedance if self._impedance else made.ControllerMode.JointImpedance
        try:
            control = self._robot.start_cartesian_pose_control(mode)
            state, _ = control.readOnce()
            follower = SmoothFollower(_matrix_pose(state.O_T_EE_c))
            while True:
                self._state = _franka_state(state)
                late = time.monotonic() - self._heard > DEAD_MAN
                there = follower.step(follower.pose if late else self._wanted or follower.pose, FCI)
                asked = made.CartesianPose(_columns(there))
                asked.motion_finished = self._stop.is_set() and follower.still
                control.writeOnce(asked)
                if asked.motion_finished:
                    return
                if self._stop.is_set():
                    self._wanted = follower.pose
                state, _ = control.readOnce()
        except Exception as wrong:
            self._wrong = f"{wrong}"


def _matrix_pose(columns: Any) -> ToolPose:
    """Of a 4 x 4 matrix that comes column by column."""
    matrix = np.asarray(columns, dtype=float).reshape(4, 4).T
    return ToolPose(matrix[:3, 3].copy(), matrix[:3, :3].copy())


def _columns(pose: ToolPose) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return [float(one) for one in matrix.T.reshape(-1)]


def _franka_state(state: Any) -> ArmState:
    return ArmState(float(state.time.to_sec()), _matrix_pose(state.O_T_EE), np.array(state.O_F_ext_hat_K, dtype=float))


class SmoothFollower:
    """A pose that follows another without jumps of place or speed: two equal lags, speed and acceleration bounded."""

    def __init__(self, start: ToolPose) -> None:
        self.pose = start
        self._speed = np.zeros((2, 3))  # m/s and rad/s

    @property
    def still(self) -> bool:
        """Whether it stands."""
        return bool(np.linalg.norm(self._speed) < 1e-4)

    def step(self, wanted: ToolPose, period: float) -> ToolPose:
        """One period [s] on."""
        turn = Rotation.from_matrix(wanted.rotation @ self.pose.rotation.T).as_rotvec()
        away = np.stack([wanted.position - self.pose.position, turn])
        pull = FOLLOW**2 * away - 2.0 * FOLLOW * self._speed
        self._speed = self._speed + period * _bounded_rows(pull, STRONGEST)
        self._speed = _bounded_rows(self._speed, FASTEST)
        turned = Rotation.from_rotvec(period * self._speed[1]).as_matrix()
        self.pose = ToolPose(self.pose.position + period * self._speed[0], np.asarray(turned @ self.pose.rotation))
        return self.pose


def _bounded_rows(rows: Array, most: tuple[float, float]) -> Array:
    """(2, 3), each row shortened to its bound."""
    size = np.linalg.norm(rows, axis=1)
    return np.asarray(rows * np.minimum(1.0, np.array(most) / np.maximum(size, 1e-12))[:, None])
