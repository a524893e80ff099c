"""Simulation of the closed loop on a beam that differs from the model, in full motion (7), with actuator and camera."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from onebend.beam import dynamics, grid, integration, problem, vibration
from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, Scaled, UncertainStiffness, Uniform
from onebend.control.loop import Controller, ControllerSettings, RequiredMargins, Timing
from onebend.errors import ControlError, MechanicsError
from onebend.options import option
from onebend.progress import one_blas_thread
from onebend.records import Array

TICK = 1.0 / 120.0  # s, between forces
AXIS_PLACES = np.linspace(0.0, 1.0, 41)  # s
_METHOD = integration.Method(3, "radau")  # damps motion faster than a tick, as the damping there does


@dataclass(frozen=True)
class LoopCamera:
    """Camera and delays."""

    fps: float = option("--fps", 30.0, metavar="HZ", within=(0.1, 100_000.0))
    delay: float = option("--delay-ms", 0.05, within=(0.0, 10_000.0))
    jitter: float = 0.0  # s, sd of the delay
    noise: float = option("--noise-mm", 5e-5, within=(0.0, 1e3))
    dropped: float = 0.0  # share of lost frames
    hidden: tuple[tuple[float, float], ...] = ()  # s, intervals


@dataclass(frozen=True)
class Actuator:
    lag: float = 0.02  # s, time constant
    gain: float = 1.0
    bias: tuple[float, float] = (0.0, 0.0)  # N


@dataclass(frozen=True)
class TrueSystem:
    """The real beam, its camera and actuator."""

    beam: Beam
    damping_ratio: float = 0.05  # of the slowest vibration
    push_s: float = 1.0
    point_s: float = 1.0
    gravity: tuple[float, float] = (0.0, 0.0)
    eye: LoopCamera = field(default_factory=LoopCamera)
    hand: Actuator = field(default_factory=Actuator)
    modes: int = 8


@dataclass(frozen=True)
class LoopSimulation:
    """A run at T times."""

    goal: Array  # (2,) m
    time: Array  # (T,) s
    xy: Array  # (T, 2) m, of the point
    asked: Array  # (T, 2) N
    force: Array  # (T, 2) N, the force on the beam
    axis: Array  # (T, P, 2) m, at `AXIS_PLACES`

    @property
    def error(self) -> Array:
        """(T,) m, from the goal."""
        return np.asarray(np.linalg.norm(self.xy - self.goal, axis=1))

    def steady(self, last: float = 1.0) -> float:
        """m: largest error in the last seconds."""
        return float(np.max(self.error[self.time > self.time[-1] - last]))

    def settled(self, within: float) -> float:
        """s after which the error stays below `within` m; infinite unless it does for the last second."""
        if self.steady() > within:
            return np.inf
        outside = np.flatnonzero(self.error > within)
        return float(self.time[outside[-1] + 1]) if outside.size else 0.0


@one_blas_thread
def simulate_loop(control: Controller, truth: TrueSystem, duration: float, *, seed: int = 0) -> LoopSimulation:
    """Runs `control` on `truth` from rest for `duration` s, with a force every `TICK` s.

    Raises `MechanicsError`: unknown mass, or unsolved motion.
    """
    arrivals = _frames(truth.eye, duration, np.random.default_rng(seed))
    moving = _MovingBeam(truth)
    state = control.begin(0.0)
    rows = np.zeros((int(np.ceil(duration / TICK)) + 1, 7))
    axis = np.zeros((len(rows), len(AXIS_PLACES), 2))
    for i, row in enumerate(rows):
        row[1:3], axis[i] = moving.point_and_axis()
        row[0], row[5:] = i * TICK, moving.force
        state, row[3:5] = control.step(state, None, row[0])
        while arrivals and arrivals[0][0] <= row[0] + 1e-9:
            _, exposed, noise = arrivals.popleft()
            first = max(0, int(exposed / TICK))
            before = rows[first : i + 1]
            position = np.array([np.interp(exposed, before[:, 0], before[:, c]) for c in (1, 2)]) + noise
            state, row[3:5] = control.step(state, position, row[0])
        moving.advance(row[3:5], row[0])
    return LoopSimulation(control.goal, rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5:], axis)


class _MovingBeam:
    """The true beam behind its actuator."""

    def __init__(self, truth: TrueSystem) -> None:
        self.body, self.hand = damped_body(truth), truth.hand
        self._numbers = integration.tableau(_METHOD)
        self._stepper = integration.Stepper(self.body, self._numbers, TICK, tolerance=1e-8)
        places = np.array([truth.push_s, truth.point_s, *AXIS_PLACES])
        levers = self.body.length * self.body.grid.integral_to(places)
        self._lever, self._places = levers[0], levers[1:]
        weighed = dynamics.Actions(gravity=truth.gravity)
        self._weight = dynamics.acting(self.body, weighed, TICK * self._numbers.c)
        start = vibration.settle(self.body, weighed)
        self.theta, self._momentum, self.force = start.theta, np.zeros(self.body.n), np.zeros(2)
        self._guess = np.zeros((self.body.n, len(self._numbers.c)))

    def point_and_axis(self) -> tuple[Array, Array]:
        """(2,) m the point, (P, 2) m the axis."""
        alpha = self.body.rest_angle + self.body.to_angle @ self.theta
        found = self._places @ np.stack([np.cos(alpha), np.sin(alpha)], axis=1)
        return found[0], found[1:]

    def advance(self, asked: Array, now: float) -> None:
        """One tick towards the requested force."""
        goes_to = self.hand.gain * asked + np.asarray(self.hand.bias)
        decay = np.exp(-TICK * np.append(self._numbers.c, 1.0) / max(self.hand.lag, 1e-9))
        force = goes_to + decay[:, None] * (self.force - goes_to)
        pull = self._weight + self._lever[:, None] * force[:-1].T[:, None]
        step = self._stepper.advance(self.theta, self._momentum, self._guess, pull, now)
        self.theta, self._momentum, self.force = step.theta, step.momentum, force[-1]
        self._guess = step.velocity @ self._numbers.ahead.T


def damped_body(truth: TrueSystem) -> dynamics.Body:
    """The true beam in modes, damping in proportion to k(s)."""
    plain = dynamics.body(truth.beam, grid.Modes(truth.modes))
    slowest = float(
        vibration.vibration_of(plain, integration.MotionState(np.zeros(plain.n), np.zeros(plain.n))).frequency[0]
    )
    damping = Scaled(truth.damping_ratio / (np.pi * slowest), truth.beam.stiffness)
    return dynamics.body(truth.beam, grid.Modes(truth.modes), damping=damping)


def _frames(eye: LoopCamera, duration: float, rng: np.random.Generator) -> deque[tuple[float, float, Array]]:
    """Arrival, exposure and noise (2,) of every frame, by arrival; NaN if hidden."""
    exposed = np.arange(0.0, duration, 1.0 / eye.fps)
    arrives = exposed + np.maximum(eye.delay + eye.jitter * rng.standard_normal(len(exposed)), 0.0)
    noise = eye.noise * rng.standard_normal((len(exposed), 2))
    for first, last in eye.hidden:
        noise[(exposed >= first) & (exposed < last)] = np.nan
    kept = np.flatnonzero(rng.random(len(exposed)) >= eye.dropped)
    order = kept[np.argsort(arrives[kept], kind="stable")]
    return deque((float(arrives[j]), float(exposed[j]), noise[j]) for j in order)


# Robustness: beams softer and stiffer than the model, or drawn from its band.

SETTLED = 1e-3  # m
MOST_DRAWN = 100
_LEAST_MASS = 0.01  # kg/m, for a beam of unknown mass
_PLACES = np.linspace(0.0, 1.0, 101)  # s, to average log k


@dataclass(frozen=True)
class TrialBeam:
    stiffness: Profile
    factor: float  # k(s) over the model's (geometric mean over s)
    drawn: bool = False  # from the band; else the factor is uniform


@dataclass(frozen=True)
class LoopTrial:
    """`run` is None if the beam snapped."""

    beam: TrialBeam
    run: LoopSimulation | None

    @property
    def steady(self) -> float:
        """m: largest error in the last second."""
        return float("inf") if self.run is None else self.run.steady()

    def settled(self, within: float) -> float:
        """s, or infinite."""
        return float("inf") if self.run is None else self.run.settled(within)


def trial_settings(fps: float, delay: float, k_error: float = 0.3, most_force: float = math.inf) -> ControllerSettings:
    """For a camera `delay` s late, with margins for k(s) wrong by `k_error`."""
    return ControllerSettings(
        timing=Timing(fps=fps, delay=delay),
        longest_delay=max(0.1, delay),
        wanted=RequiredMargins(k_error=k_error),
        most_force=most_force,
    )


def wrong_beams(beam: Beam, k_error: float) -> tuple[TrialBeam, ...]:
    """The model, and beams with k(s) lower and higher by `k_error`.

    Raises `ControlError` unless it is in [0, 1).
    """
    if not 0.0 <= k_error < 1.0:
        raise ControlError(f"the error of k is a share from 0 to below 1, got {k_error}")
    factors = (1.0, 1.0 - k_error, 1.0 + k_error) if k_error else (1.0,)
    return tuple(TrialBeam(Scaled(factor, beam.stiffness), factor) for factor in factors)


@one_blas_thread
def drawn_beams(beam: Beam, known: UncertainStiffness | None, count: int) -> tuple[TrialBeam, ...]:
    """The model, and `count` beams from the band of k(s).

    Raises `ControlError`: no band, or a count not from 1 to `MOST_DRAWN`.
    """
    if known is None:
        raise ControlError("the model has no band to draw beams from: give an error of k instead, or learn with a band")
    if not 1 <= count <= MOST_DRAWN:
        raise ControlError(f"from 1 to {MOST_DRAWN} beams can be drawn, got {count}")
    ours = np.log(beam.stiffness(_PLACES))
    drawn = [
        TrialBeam(one, float(np.exp(np.mean(np.log(one(_PLACES)) - ours))), drawn=True)
        for one in known.draw(count, seed=0)
    ]
    return (TrialBeam(beam.stiffness, 1.0), *drawn)


def simulate_trials(
    control: Controller, beams: Iterable[TrialBeam], *, eye: LoopCamera = LoopCamera(), duration: float = 8.0
) -> Iterator[LoopTrial]:
    """The loop on each beam; unknown masses are replaced by a small one.

    Raises `ControlError`: a duration below two seconds.
    """
    if not duration >= 2.0:
        raise ControlError(f"a simulation takes two seconds at least, got {duration} s")
    hand = Actuator(lag=control.settings.timing.lag)
    model, weighed = control.beam, problem.has_mass(control.beam)
    for beam in beams:
        mass = model.mass_per_length if weighed else Uniform(_LEAST_MASS)
        truth = TrueSystem(
            replace(model, stiffness=beam.stiffness, mass_per_length=mass),
            damping_ratio=control.settings.damping_ratio,
            push_s=control.push_s,
            point_s=control.point_s,
            gravity=(float(control.gravity[0]), float(control.gravity[1])),
            eye=eye,
            hand=hand,
        )
        try:
            yield LoopTrial(beam, simulate_loop(control, truth, duration))
        except MechanicsError:
            yield LoopTrial(beam, None)
