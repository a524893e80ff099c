"""Motion in time: the equation of motion (7) stepped by collocation, from a state, under actions.

`simulate` takes fixed steps (a fixed step is what lets a symplectic method keep its energy) that end where an action
jumps. `converged` halves the step until the markers no longer move by more than a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from onebend.beam.motion.actions import Actions, TabulatedActions, acting, check_gripper, power
from onebend.beam.motion.collocation import Method, Tableau, tableau
from onebend.beam.motion.dynamics import Body, elastic_energy, kinetic_energy, mass_matrix, momentum, weight_energy
from onebend.beam.motion.stepping import Step, StepError, Stepper
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.progress import Progress, Silent
from onebend.records import Array


@dataclass(frozen=True)
class MotionState:
    """Where a motion starts."""

    theta: Array  # (n,) rad
    rate: Array  # (n,) rad/s
    time: float = 0.0  # s


@dataclass(frozen=True)
class IntegrationSettings:
    """How a motion is stepped."""

    method: Method = field(default_factory=Method)
    tolerance: float = 1e-10  # stage velocities are solved to this share of the largest
    every: int = 1  # keep every so many steps (the last one always)
    max_steps: int = 1_000_000  # steps
    progress: Progress = field(default_factory=Silent)


@dataclass(frozen=True)
class Motion:
    """A motion at T times. Energies are of the beam in the fixed frame."""

    body: Body
    time: Array  # (T,) s
    theta: Array  # (T, n) rad
    rate: Array  # (T, n) rad/s
    base: Array  # (T, 3) m, m, rad: the gripper's pose
    kinetic: Array  # (T,) J
    elastic: Array  # (T,) J
    weight: Array  # (T,) J, potential of gravity
    work: Array  # (T,) J done by forces and moments since the start
    loss: Array  # (T,) J taken by damping since the start
    step: float  # s, the longest taken
    steps: int
    iterations: int  # of Newton's method, in all steps
    error: float  # m, estimate of `converged` for its markers; NaN after `simulate`, which makes none

    @property
    def energy(self) -> Array:
        """(T,) J."""
        return self.kinetic + self.elastic + self.weight

    def xy(self, s: ArrayLike) -> Array:
        """(T, S, 2) m, positions at places `s` (S,)."""
        return self.body.xy(np.atleast_1d(np.asarray(s, dtype=float)), self.theta, self.base)

    def angle(self, s: ArrayLike) -> Array:
        """(T, S) rad, the tangent's angle at places `s` (S,)."""
        return self.body.angle(np.atleast_1d(np.asarray(s, dtype=float)), self.theta, self.base[:, 2])

    def states_at(self, time: ArrayLike) -> Array:
        """(R, n) states between the steps, by cubic interpolation of states and rates (fourth order in the spacing).

        Raises:
            MechanicsError: a time outside the motion.
        """
        wanted = np.asarray(time, dtype=float)
        if np.any(wanted < self.time[0]) or np.any(wanted > self.time[-1]):
            raise MechanicsError(f"the motion is known from t = {self.time[0]:g} s to {self.time[-1]:g} s only")
        return np.asarray(CubicHermiteSpline(self.time, self.theta, self.rate)(wanted))


@one_blas_thread
def simulate(
    body: Body,
    start: MotionState,
    duration: float,
    step: float,
    actions: Actions = Actions(),
    *,
    settings: IntegrationSettings = IntegrationSettings(),
) -> Motion:
    """Motion from `start` for `duration` s in equal steps of at most `step` s.

    Raises:
        MechanicsError: a start that does not fit the body, more steps than allowed, actions that are not finite, or
            stage equations that could not be solved (the message names the time).
    """
    stretches = _stretches(body, start, duration, step, actions, settings.max_steps)
    return _follow(body, start, stretches, actions, settings)


@one_blas_thread
def converged(
    body: Body,
    start: MotionState,
    duration: float,
    actions: Actions = Actions(),
    *,
    tolerance: float,
    step: float,
    at_s: ArrayLike = (1.0 / 3.0, 2.0 / 3.0, 1.0),
    settings: IntegrationSettings = IntegrationSettings(),
    halvings: int = 10,
) -> Motion:
    """Motion whose markers at `at_s` are known to `tolerance` m, judged by halving the step.

    The first run takes `step`; runs are compared at all of its times. `Motion.error` is twice the largest change, and
    below `tolerance`: what no step resolved yet is wrong in both runs by as much, so the change is not divided by
    2^order - 1 as if all errors fell with the order.

    Raises:
        MechanicsError: as `simulate`, or the tolerance was not met after `halvings`.
    """
    stretches = _stretches(body, start, duration, step, actions, settings.max_steps)
    places, change, running = np.atleast_1d(np.asarray(at_s, dtype=float)), np.inf, replace(settings, every=1)
    coarse = _attempt(body, start, stretches, actions, running)
    for _ in range(halvings):
        stretches = [replace(stretch, count=2 * stretch.count) for stretch in stretches]
        running = replace(running, every=2 * running.every)
        fine = _attempt(body, start, stretches, actions, running)
        if coarse is not None and fine is not None:
            change = float(np.max(np.linalg.norm(fine.xy(places) - coarse.xy(places), axis=-1)))
            if 2.0 * change < tolerance:
                return _thinned(replace(fine, error=2.0 * change), settings.every)
        coarse = fine
    raise MechanicsError(
        f"markers still change by {change:.3g} m when the step is halved to {step / 2**halvings:.3g} s; "
        "give a smaller first step, or ask for less"
    )


def _stretches(
    body: Body, start: MotionState, duration: float, step: float, actions: Actions, max_steps: int
) -> list[_Stretch]:
    """Stretches between jumps of the actions, each in equal steps."""
    shapes = np.shape(start.theta), np.shape(start.rate)
    if shapes != ((body.n,), (body.n,)):
        raise MechanicsError(f"the start has {shapes[0]} states and {shapes[1]} rates, the body {body.n}")
    if not (np.all(np.isfinite(start.theta)) and np.all(np.isfinite(start.rate))):
        raise MechanicsError("the motion's start must be finite numbers")
    if not (duration > 0.0 and step > 0.0 and np.isfinite(duration)):
        raise MechanicsError(f"duration and step must be positive, got {duration} s and {step} s")
    end = start.time + duration
    times = [start.time, *(t for t in actions.breaks if start.time < t < end), end]
    stretches = [_Stretch(a, b, max(1, int(np.ceil((b - a) / step * (1.0 - 1e-12))))) for a, b in pairwise(times)]
    count = sum(stretch.count for stretch in stretches)
    if count > max_steps:
        raise MechanicsError(f"{duration:g} s in steps of {step:g} s are {count} steps, more than the {max_steps}")
    return stretches


def _attempt(
    body: Body, start: MotionState, stretches: list[_Stretch], actions: Actions, settings: IntegrationSettings
) -> Motion | None:
    """The motion, or None where these steps are too long for it."""
    if sum(stretch.count for stretch in stretches) > settings.max_steps:
        raise MechanicsError(f"the tolerance is not met with the {settings.max_steps} steps allowed")
    try:
        return _follow(body, start, stretches, actions, settings)
    except StepError:
        return None


def _thinned(motion: Motion, every: int) -> Motion:
    """Every so many of the times kept, and the last."""
    count = len(motion.time)
    kept = np.unique(np.append(np.arange(0, count, every), count - 1))
    names = ("time", "theta", "rate", "base", "kinetic", "elastic", "weight", "work", "loss")
    return replace(motion, **{name: getattr(motion, name)[kept] for name in names})


def _follow(
    body: Body, start: MotionState, stretches: list[_Stretch], actions: Actions, settings: IntegrationSettings
) -> Motion:
    for stretch in stretches:
        if actions.gripper is not None:
            check_gripper(actions.gripper, stretch.first, stretch.last, stretch.step)
    ledger = _Ledger(body, start, actions)
    numbers = tableau(settings.method)
    settings.progress.start("motion", sum(stretch.count for stretch in stretches))
    try:
        for stretch in stretches:
            _run(ledger, stretch, numbers, actions, settings)
    finally:
        settings.progress.done()
    return ledger.motion(max(stretch.step for stretch in stretches))


def _run(ledger: _Ledger, stretch: _Stretch, numbers: Tableau, actions: Actions, settings: IntegrationSettings) -> None:
    """Equal steps between two jumps of the actions."""
    body, h = ledger.body, stretch.step
    stepper = Stepper(body, numbers, h, tolerance=settings.tolerance)
    inside = h * np.minimum(numbers.c, 1.0 - 1e-12)  # a stage at the end still belongs to this side of a jump
    now = acting(body, actions, stretch.first + inside)
    guess = np.repeat(ledger.rate_after(stretch.first, h)[:, None], len(inside), axis=1)
    theta, momentum = ledger.theta, ledger.momentum
    for i in range(stretch.count):
        begin = stretch.first + i * h
        if i and not actions.steady:
            now = acting(body, actions, begin + inside)
        taken = stepper.advance(theta, momentum, guess, now, begin)
        theta, momentum = taken.theta, taken.momentum
        guess = taken.velocity @ numbers.ahead.T
        ledger.add(taken, now, h * numbers.b)
        if (i + 1) % settings.every == 0 or i + 1 == stretch.count:
            ledger.keep(stretch.last if i + 1 == stretch.count else begin + h)
        settings.progress.advance()


@dataclass(frozen=True)
class _Stretch:
    """A time in which no action jumps."""

    first: float
    last: float
    count: int

    @property
    def step(self) -> float:
        return (self.last - self.first) / self.count


class _Ledger:
    """What a run has taken so far. Lives only inside `simulate`."""

    def __init__(self, body: Body, start: MotionState, actions: Actions) -> None:
        now = acting(body, actions, np.array([start.time]))
        self.body, self.actions = body, actions
        self.theta = np.asarray(start.theta, dtype=float)
        self.momentum = momentum(body, self.theta, np.asarray(start.rate, dtype=float), now.base[0], now.base_rate[0])
        self.work, self.loss, self.steps, self.iterations = 0.0, 0.0, 0, 0
        self._forced = bool(actions.forces or actions.moments)
        self._damped = bool(np.any(body.damping))
        self._rows: list[tuple[float, Array, Array, float, float]] = []
        self.keep(start.time)

    def rate_after(self, time: float, h: float) -> Array:
        """(n,) rate just after `time`, where the gripper's velocity may have jumped."""
        now = acting(self.body, self.actions, np.array([time + 1e-9 * h]))
        return np.asarray(_rates(self.body, self.theta[None], self.momentum[None], now.base, now.base_rate)[0])

    def add(self, taken: Step, now: TabulatedActions, weights: Array) -> None:
        """One more step; work and loss by the method's own quadrature at its stages."""
        self.theta, self.momentum = taken.theta, taken.momentum
        self.steps += 1
        self.iterations += taken.iterations
        if self._forced:
            self.work += float(power(self.body, taken.stage_theta, taken.velocity, now) @ weights)
        if self._damped:
            self.loss += float(np.sum(taken.velocity * (self.body.damping @ taken.velocity), axis=0) @ weights)

    def keep(self, time: float) -> None:
        self._rows.append((time, self.theta, self.momentum, self.work, self.loss))

    def motion(self, longest: float) -> Motion:
        """The record of what was kept."""
        time, theta, momenta, work, loss = (np.array(column, dtype=float) for column in zip(*self._rows, strict=True))
        now = acting(self.body, self.actions, time)
        parts = [slice(i, i + 500) for i in range(0, len(time), 500)]  # 500 matrices at a time fit the cache
        rate = np.concatenate([_rates(self.body, theta[p], momenta[p], now.base[p], now.base_rate[p]) for p in parts])
        return Motion(
            body=self.body,
            time=time,
            theta=theta,
            rate=rate,
            base=now.base,
            kinetic=kinetic_energy(self.body, theta, rate, now.base, now.base_rate),
            elastic=elastic_energy(self.body, theta),
            weight=weight_energy(self.body, theta, np.asarray(self.actions.gravity, dtype=float), now.base),
            work=work,
            loss=loss,
            step=longest,
            steps=self.steps,
            iterations=self.iterations,
            error=np.nan,
        )


def _rates(body: Body, theta: Array, momenta: Array, base: Array, base_rate: Array) -> Array:
    """(T, n) rates that belong to momenta (T, n) while the gripper is at `base` (T, 3) and moves at `base_rate`."""
    own = momenta - momentum(body, theta, np.zeros_like(theta), base, base_rate)
    return np.asarray(np.linalg.solve(mass_matrix(body, theta), own[..., None])[..., 0])
