"""Simulation of the closed loop: a beam that is not the model, in full motion (7), with an actuator and a camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.motion.actions import Actions, acting
from onebend.beam.motion.collocation import Method, tableau
from onebend.beam.motion.dynamics import Body, body
from onebend.beam.motion.integration import MotionState
from onebend.beam.motion.stepping import Stepper
from onebend.beam.motion.vibration import settle, vibration_of
from onebend.beam.profiles.stiffness import Scaled
from onebend.blas import one_blas_thread
from onebend.control.loop.controller import Controller
from onebend.control.loop.felt import Exposure, ForceSense
from onebend.records import Array

TICK = 1.0 / 120.0  # s, between two forces
AXIS_PLACES = np.linspace(0.0, 1.0, 41)  # s, of the beam's axis in `LoopSimulation`
_METHOD = Method(3, "radau")  # forgets at once what is too fast for a tick, as the strong damping up there does


@dataclass(frozen=True)
class LoopCamera:
    """The camera and all that lies between it and the controller."""

    fps: float = 30.0
    delay: float = 0.05  # s, from exposure to arrival
    jitter: float = 0.0  # s, sd of the delay of a frame
    noise: float = 5e-5  # m, sd of each coordinate
    dropped: float = 0.0  # share of frames that never arrive
    hidden: tuple[tuple[float, float], ...] = ()  # s, times in which the point is not seen


@dataclass(frozen=True)
class Actuator:
    """The robot that applies the force."""

    lag: float = 0.02  # s, time constant
    gain: float = 1.0
    bias: tuple[float, float] = (0.0, 0.0)  # N


@dataclass(frozen=True)
class TrueSystem:
    """The simulated real beam, its camera and its actuator."""

    beam: Beam
    damping_ratio: float = 0.05  # of the slowest vibration about rest
    push_s: float = 1.0
    point_s: float = 1.0
    gravity: tuple[float, float] = (0.0, 0.0)
    eye: LoopCamera = field(default_factory=LoopCamera)
    hand: Actuator = field(default_factory=Actuator)
    modes: int = 8


@dataclass(frozen=True)
class LoopSimulation:
    """A simulated run at T times."""

    goal: Array  # (2,) m
    time: Array  # (T,) s
    xy: Array  # (T, 2) m, where the point was
    asked: Array  # (T, 2) N, the force that the controller asked for
    force: Array  # (T, 2) N, the force on the beam
    axis: Array  # (T, P, 2) m, the beam's axis at `AXIS_PLACES`

    @property
    def error(self) -> Array:
        """(T,) m, distance from the goal."""
        return np.asarray(np.linalg.norm(self.xy - self.goal, axis=1))

    def steady(self, last: float = 1.0) -> float:
        """m: the largest distance from the goal in the last seconds."""
        return float(np.max(self.error[self.time > self.time[-1] - last]))

    def settled(self, within: float) -> float:
        """s: time from which the point stays `within` m of the goal. Infinite where it does not do so for at least
        the last second."""
        if self.steady() > within:
            return np.inf
        outside = np.flatnonzero(self.error > within)
        return float(self.time[outside[-1] + 1]) if outside.size else 0.0


@one_blas_thread
def simulate_loop(
    control: Controller,
    truth: TrueSystem,
    duration: float,
    *,
    seed: int = 0,
    tick: float = TICK,
    feel: ForceSense | None = None,
) -> LoopSimulation:
    """Run `control` on `truth` from rest for `duration` s; the force is set anew every `tick` s. `feel` tells the
    force in every frame that arrives, hidden point or not; it may remember, so give each run its own.

    Raises:
        MechanicsError: the beam's mass is not known, or its motion could not be followed.
    """
    arrivals = _frames(truth.eye, duration, np.random.default_rng(seed))
    moving = _MovingBeam(truth, tick)
    state = control.begin(0.0)
    rows = np.zeros((int(np.ceil(duration / tick)) + 1, 7))
    axis, bent = np.zeros((len(rows), len(AXIS_PLACES), 2)), np.zeros((len(rows), moving.body.n))
    for i, row in enumerate(rows):
        row[1:3], axis[i] = moving.point_and_axis()
        row[0], row[5:], bent[i] = i * tick, moving.force, moving.theta
        state, row[3:5] = control.step(state, None, row[0])
        while arrivals and arrivals[0][0] <= row[0] + 1e-9:
            _, exposed, noise = arrivals.popleft()
            first = max(0, int(exposed / tick))
            before = rows[first : i + 1]
            position = np.array([np.interp(exposed, before[:, 0], before[:, c]) for c in (1, 2)]) + noise
            felt = None if feel is None else feel(_exposure(moving, exposed, before, bent[first : i + 1]))
            state, row[3:5] = control.step(state, position, row[0], felt=felt)
        moving.advance(row[3:5], row[0])
    return LoopSimulation(control.goal, rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5:], axis)


def _exposure(moving: _MovingBeam, exposed: float, rows: Array, bent: Array) -> Exposure:
    """At `exposed` s, between the first two of the `rows` or at the only one, where the modes were `bent`."""
    share = 0.0 if len(rows) < 2 else min((exposed - rows[0, 0]) / (rows[1, 0] - rows[0, 0]), 1.0)
    last = min(1, len(rows) - 1)
    force, theta = ((1.0 - share) * each[0] + share * each[last] for each in (rows[:, 5:], bent))
    return Exposure(exposed, force, lambda s: moving.pose(theta, s))


class _MovingBeam:
    """The true beam in motion behind its actuator. Lives only inside `simulate_loop`."""

    def __init__(self, truth: TrueSystem, tick: float) -> None:
        self.body, self.tick, self.hand = damped_body(truth), tick, truth.hand
        self._numbers = tableau(_METHOD)
        self._stepper = Stepper(self.body, self._numbers, tick, tolerance=1e-8)
        places = np.array([truth.push_s, truth.point_s, *AXIS_PLACES])
        levers = self.body.length * self.body.grid.integral_to(places)
        self._lever, self._places = levers[0], levers[1:]
        weighed = Actions(gravity=truth.gravity)
        self._weight = acting(self.body, weighed, tick * self._numbers.c)
        start = settle(self.body, weighed)
        self.theta, self._momentum, self.force = start.theta, np.zeros(self.body.n), np.zeros(2)
        self._guess = np.zeros((self.body.n, len(self._numbers.c)))

    def point_and_axis(self) -> tuple[Array, Array]:
        """(2,) m, where the point is; (P, 2) m, the beam's axis."""
        alpha = self.body.rest_angle + self.body.to_angle @ self.theta
        found = self._places @ np.stack([np.cos(alpha), np.sin(alpha)], axis=1)
        return found[0], found[1:]

    def pose(self, theta: Array, s: Array) -> Array:
        """(m, 3) m, m, rad: the beam at `s` (m,) where its modes are `theta`."""
        alpha, grid = self.body.rest_angle + self.body.to_angle @ theta, self.body.grid
        along = self.body.length * grid.integral_to(s)
        return np.column_stack([along @ np.cos(alpha), along @ np.sin(alpha), grid.value_at(s) @ alpha])

    def advance(self, asked: Array, now: float) -> None:
        """One tick with the force going to what is asked for, by the actuator's lag."""
        goes_to = self.hand.gain * asked + np.asarray(self.hand.bias)
        decay = np.exp(-self.tick * np.append(self._numbers.c, 1.0) / max(self.hand.lag, 1e-9))
        force = goes_to + decay[:, None] * (self.force - goes_to)
        pull = self._weight.pull + self._lever[:, None] * force[:-1].T[:, None]
        acts = replace(self._weight, pull=pull, force=force[:-1])
        step = self._stepper.advance(self.theta, self._momentum, self._guess, acts, now)
        self.theta, self._momentum, self.force = step.theta, step.momentum, force[-1]
        self._guess = step.velocity @ self._numbers.ahead.T


def damped_body(truth: TrueSystem) -> Body:
    """The true beam in curvature modes, its internal damping in proportion to k(s)."""
    plain = body(truth.beam, Modes(truth.modes))
    slowest = float(vibration_of(plain, MotionState(np.zeros(plain.n), np.zeros(plain.n))).frequency[0])
    damping = Scaled(truth.damping_ratio / (np.pi * slowest), truth.beam.stiffness)
    return body(truth.beam, Modes(truth.modes), damping=damping)


def _frames(eye: LoopCamera, duration: float, rng: np.random.Generator) -> deque[tuple[float, float, Array]]:
    """Arrival, exposure and noise (2,) of every frame, in the order of arrival; NaN where the point is hidden."""
    exposed = np.arange(0.0, duration, 1.0 / eye.fps)
    arrives = exposed + np.maximum(eye.delay + eye.jitter * rng.standard_normal(len(exposed)), 0.0)
    noise = eye.noise * rng.standard_normal((len(exposed), 2))
    for first, last in eye.hidden:
        noise[(exposed >= first) & (exposed < last)] = np.nan
    kept = np.flatnonzero(rng.random(len(exposed)) >= eye.dropped)
    order = kept[np.argsort(arrives[kept], kind="stable")]
    return deque((float(arrives[j]), float(exposed[j]), noise[j]) for j in order)
