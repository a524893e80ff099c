"""What acts on a moving beam: forces, moments, gravity and the gripper's motion as functions of time.

All vectors are in one fixed frame: the beam's frame while the gripper's pose is zero. A moving gripper enters through
the same variational principle as the rest (its velocity is part of every point's velocity), so no inertial forces are
to be added by hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from onebend.beam.motion.dynamics import Body
from onebend.errors import MechanicsError
from onebend.records import Array

InTime = Callable[[float], ArrayLike]


@dataclass(frozen=True)
class AppliedForce:
    """A force on the beam at a fixed place of it: two numbers [N], or a function of time [s] that returns them."""

    value: ArrayLike | InTime
    at_s: float = 1.0
    breaks: tuple[float, ...] = ()  # s, times where the function or a derivative jumps; steps end there


@dataclass(frozen=True)
class AppliedMoment:
    """A moment about z on the beam at a fixed place of it: a number [N m], or a function of time [s]."""

    value: ArrayLike | InTime
    at_s: float = 1.0
    breaks: tuple[float, ...] = ()


@dataclass(frozen=True)
class Gripper:
    """The clamp moves: `pose(t)` = (x [m], y [m], turn [rad]), `rate(t)` its derivative, which must belong to it.

    The turn adds to the beam's clamp angle. A velocity that jumps is allowed at `breaks` (the clamp then gives an
    impulse), a pose that jumps is not.
    """

    pose: InTime
    rate: InTime
    breaks: tuple[float, ...] = ()


@dataclass(frozen=True)
class Actions:
    """All that acts on a moving beam."""

    forces: tuple[AppliedForce, ...] = ()
    moments: tuple[AppliedMoment, ...] = ()
    gravity: ArrayLike = (0.0, 0.0)  # m/s^2
    gripper: Gripper | None = None

    def __post_init__(self) -> None:
        for action in self._loads:
            if not 0.0 <= action.at_s <= 1.0:
                raise MechanicsError(f"actions are at s in [0, 1], got s = {action.at_s}")
        if np.shape(self.gravity) != (2,) or not np.all(np.isfinite(np.asarray(self.gravity, dtype=float))):
            raise MechanicsError(f"gravity has two finite components [m/s^2], got {self.gravity}")

    @property
    def _loads(self) -> tuple[AppliedForce | AppliedMoment, ...]:
        return (*self.forces, *self.moments)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times where something jumps, rising, each once."""
        gripper = self.gripper.breaks if self.gripper is not None else ()
        return tuple(sorted({*gripper, *(time for action in self._loads for time in action.breaks)}))

    @property
    def steady(self) -> bool:
        """Whether nothing depends on time."""
        return self.gripper is None and not any(callable(action.value) for action in self._loads)


@dataclass(frozen=True)
class TabulatedActions:
    """Actions on a body at R times, as the equation of motion wants them."""

    pull: Array  # (2, Q, R) N m: all that pulls beyond each node, weight included, times its lever; x and y
    forced: Array  # (2, Q, R) N m: the same of the forces alone
    force: Array  # (R, 2) N: sum of the forces
    couple: Array  # (n, R) N m: generalised force of the moments
    moment: Array  # (R,) N m: sum of the moments
    base: Array  # (R, 3) m, m, rad
    base_rate: Array  # (R, 3)


def acting(on: Body, actions: Actions, times: Array) -> TabulatedActions:
    """Actions at `times` (R,) s. Raises `MechanicsError` where a function does not return finite numbers."""
    count = len(times)
    weight = np.multiply.outer(np.asarray(actions.gravity, dtype=float), np.outer(on.lever, np.ones(count)))
    forced, total = np.zeros_like(weight), np.zeros((count, 2))
    for force in actions.forces:
        values = _values(force.value, times, 2, "a force")
        forced += np.multiply.outer(_row(on, force.at_s), values).transpose(2, 0, 1)
        total += values
    couple, moment = np.zeros((on.n, count)), np.zeros(count)
    for twist in actions.moments:
        about_z = _values(twist.value, times, 1, "a moment")[:, 0]
        couple += on.to_places(np.array([twist.at_s]))[0][:, None] * about_z
        moment += about_z
    base = base_rate = np.zeros((count, 3))
    if actions.gripper is not None:
        base = _values(actions.gripper.pose, times, 3, "the gripper's pose")
        base_rate = _values(actions.gripper.rate, times, 3, "the gripper's rate")
    return TabulatedActions(weight + forced, forced, total, couple, moment, base, base_rate)


def power(on: Body, theta: Array, rate: Array, now: TabulatedActions) -> Array:
    """(R,) W: power of forces and moments at states and rates (n, R), the gripper's motion included."""
    turn, spin = now.base[:, 2], now.base_rate[:, 2]
    alpha = on.rest_angle[:, None] + turn + on.to_angle @ theta
    turning = on.to_angle @ rate + spin
    along = np.sum(turning * (np.cos(alpha) * now.forced[1] - np.sin(alpha) * now.forced[0]), axis=0)
    carried = np.sum(now.force * now.base_rate[:, :2], axis=1) + now.moment * spin
    return np.asarray(along + carried + np.sum(now.couple * rate, axis=0))


def spline_gripper(time: ArrayLike, pose: ArrayLike) -> Gripper:
    """A gripper that moves through measured poses (T, 3) of (x [m], y [m], turn [rad]) by cubic splines.

    The spline's knots are not breaks: its third derivative jumps there, which limits the order of motion to that of
    the data. Beyond the data it extrapolates, so the motion should end with them.

    Raises:
        MechanicsError: times that do not rise, or poses that are not finite.
    """
    t, p = np.asarray(time, dtype=float), np.asarray(pose, dtype=float)
    if t.ndim != 1 or len(t) < 2 or p.shape != (len(t), 3):
        raise MechanicsError(f"a gripper needs T >= 2 times and poses (T, 3), got {t.shape} and {p.shape}")
    if not (np.all(np.diff(t) > 0.0) and np.all(np.isfinite(p))):
        raise MechanicsError("the gripper's times must rise and its poses be finite; leave out the unknown ones")
    spline = CubicSpline(t, p)
    return Gripper(spline, spline.derivative())


def check_gripper(gripper: Gripper, first: float, last: float, step: float) -> None:
    """Compare the gripper's rate with differences of its pose at a few times between two breaks.

    Raises:
        MechanicsError: they differ by more than what steps of `step` s could follow.
    """
    times = first + (last - first) * np.array([0.07, 0.23, 0.41, 0.59, 0.77, 0.93])
    near = 0.01 * min(step, last - first)
    before, after = (_values(gripper.pose, times + d, 3, "the gripper's pose") for d in (-near, near))
    moves, said = (after - before) / (2.0 * near), _values(gripper.rate, times, 3, "the gripper's rate")
    allowed = 1e-3 * np.max(np.abs(moves)) + 1e-12 * (1.0 + np.max(np.abs(after))) / near
    wrong = np.max(np.abs(moves - said), axis=1) > allowed
    if np.any(wrong):
        i = int(np.flatnonzero(wrong)[0])
        raise MechanicsError(
            f"the gripper's rate is not the derivative of its pose: at t = {times[i]:.6g} s it moves by "
            f"{np.array2string(moves[i], precision=4)} a second, and rate says {np.array2string(said[i], precision=4)}"
        )


def _row(on: Body, at_s: float) -> Array:
    """(Q,) m: lever of every node for a force at `at_s`."""
    return np.asarray(on.length * on.grid.integral_to(np.array([at_s]))[0])


def _values(value: ArrayLike | InTime, times: Array, size: int, name: str) -> Array:
    """(R, size) values of a constant or a function of time."""
    raw = [value(float(t)) for t in times] if callable(value) else [value] * len(times)
    try:
        out = np.asarray(raw, dtype=float).reshape(len(times), size)
    except (TypeError, ValueError) as error:
        raise MechanicsError(f"{name} must be {size} number(s) at every time: {error}") from error
    if not np.all(np.isfinite(out)):
        bad = times[np.flatnonzero(~np.all(np.isfinite(out), axis=1))[0]]
        raise MechanicsError(f"{name} is not finite at t = {bad:.6g} s")
    return out
