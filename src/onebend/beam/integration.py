"""Motion in time: the equation of motion (7) by collocation.

`simulate` takes fixed steps, so that a symplectic method keeps its energy; steps end where an action jumps. `converged`
halves the step until the markers reach a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg.lapack import dgetrf, dgetrs

from onebend.beam.dynamics import (
    Actions,
    Body,
    TabulatedActions,
    acting,
    check_gripper,
    elastic_energy,
    kinetic_energy,
    mass_matrix,
    momentum,
    power,
    weight_energy,
)
from onebend.errors import MechanicsError
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.records import Array

# Collocation. A step of length h seeks stage velocities V_j at t + c_j h with the momenta
#
#     p_i = p_0 + h sum_j a_ij f_j,   theta_i = theta_0 + h sum_j a_ij V_j.
#
# Gauss with s stages has order 2 s and is symmetric, symplectic and A-stable. Radau IIA has order 2 s - 1 and is
# L-stable: it damps motions faster than the step (Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1).


@dataclass(frozen=True)
class Method:
    stages: int = 3
    family: Literal["gauss", "radau"] = "gauss"

    def __post_init__(self) -> None:
        if not 1 <= self.stages <= 6:
            raise MechanicsError(f"a collocation method has 1 to 6 stages here, got {self.stages}")

    @property
    def order(self) -> int:
        """Order of the error in the step."""
        return 2 * self.stages - (self.family == "radau")


@dataclass(frozen=True)
class Tableau:
    c: Array  # (s,) stage times
    a: Array  # (s, s)
    b: Array  # (s,)
    to_end: Array  # (s,) d = b a^-1: y_1 = y_0 + sum_i d_i (Y_i - y_0), stable for stiff parts
    ahead: Array  # (s, s): extrapolates stage values to the next equal step


def tableau(method: Method) -> Tableau:
    """Stage times are roots of P_s for Gauss, of P_s - P_(s-1) for Radau IIA."""
    polynomial = np.append(np.zeros(method.stages), 1.0)
    if method.family == "radau":
        polynomial[-2] = -1.0
    c = 0.5 * (np.sort(np.real(np.polynomial.legendre.legroots(polynomial))) + 1.0)
    powers = np.arange(1, method.stages + 1)
    values = c[:, None] ** (powers - 1)  # Vandermonde, well-conditioned for s <= 6
    a = np.linalg.solve(values.T, (c[:, None] ** powers / powers).T).T
    b = np.linalg.solve(values.T, 1.0 / powers)
    ahead = np.linalg.solve(values.T, ((c[:, None] + 1.0) ** (powers - 1)).T).T
    return Tableau(*(np.asarray(x, dtype=float) for x in (c, a, b, np.linalg.solve(a.T, b), ahead)))


# One step: simplified Newton on the stage velocities V (n, s). With X, Y the momentum carried by each node, generalised
# momentum and force follow from the Lagrangian without B, C or accelerations:
#
#     Y = H (cos alpha o alpha') + lever y_b',   X = -H (sin alpha o alpha') + lever x_b'
#     p = A^T (pi + D alpha'),                   pi = cos alpha Y - sin alpha X
#     f = A^T tau - K theta - D_theta theta' + a M,
#     tau = -alpha' (cos alpha X + sin alpha Y) + cos alpha N_y - sin alpha N_x
#
# The iteration matrix is the exact derivative at the mean stage, kept over steps while it serves. This is the hot loop,
# in place.

_ITERATIONS = 12  # per iteration matrix
_REFRESHES = 4  # of the matrix within a step
_SLOW = 0.05  # mean contraction that asks for a new matrix at the next step
_ASTRAY = 1e3  # rad, diverging update
_ROUNDING = 1e-14  # relative rounding error of states


class StepError(MechanicsError):
    """The stage equations of a step were not solved."""


@dataclass(frozen=True)
class Step:
    theta: Array  # (n,) at the end
    momentum: Array  # (n,) kg m^2/s at the end
    velocity: Array  # (n, s) at the stages
    stage_theta: Array  # (n, s)
    iterations: int


class Stepper:
    """Steps of one length; holds work arrays and the iteration matrix."""

    def __init__(self, body: Body, numbers: Tableau, h: float, *, tolerance: float) -> None:
        self.body, self.numbers, self.h, self.tolerance = body, numbers, h, tolerance
        n, s, q = body.n, len(numbers.c), len(body.lever)
        eye, first, second = np.eye(s), h * numbers.a, h * h * numbers.a @ numbers.a
        self._to_stage = first.T.copy()  # theta_i = theta_0 + V @ to_stage
        self._spread = np.hstack([eye, eye, self._to_stage])
        self._blocks = np.stack([eye, first, second]).reshape(3, s * s)
        self._products = np.einsum("qi,qj->ijq", body.to_angle, body.to_angle).reshape(n * n, q)
        self._rotary = (self._products @ body.rotary).reshape(n, n)
        self._linear = self._coupled(self._rotary, body.damping, body.stiffness)
        self._angle, self._angle_t = body.to_angle, body.to_angle.T.copy()
        self._mean, self._mean_stage = np.full(s, 1.0 / s), self._to_stage.mean(axis=1)
        self._weights = np.empty((4, q))
        self._mass = np.empty((n, n))
        self._factor: tuple[Array, Array] | None = None
        self._now: TabulatedActions | None = None
        self._prepare(q, s)

    def advance(self, theta: Array, momentum: Array, guess: Array, now: TabulatedActions, time: float) -> Step:
        """One step under the actions at the stages; `guess` (n, s) of the stage velocities.

        Raises `StepError`: stage equations not solved.
        """
        if now is not self._now:
            self._take(now)
        velocity = guess.copy()
        self._begin(theta, momentum)
        count = 0
        for attempt in range(_REFRESHES):
            if self._factor is None or attempt:
                self._renew(theta, velocity)
            solved, iterations, slow = self._iterate(theta, velocity)
            count += iterations
            if solved and self.h * float(np.abs(velocity).max()) > np.pi:
                break  # so large a turn is no solution of the motion
            if solved:
                if slow:
                    self._factor = None
                stage = velocity @ self._to_stage
                return Step(
                    theta + stage @ self.numbers.to_end,
                    momentum + (self._stage_momentum() - momentum[:, None]) @ self.numbers.to_end,
                    velocity,
                    theta[:, None] + stage,
                    count,
                )
            if not np.all(np.isfinite(velocity)):
                velocity[:] = guess
        raise StepError(
            f"the motion could not be followed beyond t = {time:.6g} s with steps of {self.h:.3g} s; "
            "give a smaller step"
        )

    def _prepare(self, q: int, s: int) -> None:
        """Work arrays and views: c, s for cos, sin; y, x for the momenta Y, -X."""
        self._turned = np.empty((q, 3 * s))
        self._twice, self._alpha = self._turned[:, : 2 * s], self._turned[:, 2 * s :]
        self._directions, self._moving = np.empty((q, 2 * s)), np.empty((q, 2 * s))
        self._carried, self._parts = np.empty((q, 2 * s)), np.empty((q, 2 * s))
        self._cos, self._sin = self._directions[:, :s], self._directions[:, s:]
        self._cos_moving, self._sin_moving = self._moving[:, :s], self._moving[:, s:]
        self._y, self._x = self._carried[:, :s], self._carried[:, s:]
        self._first, self._second = self._parts[:, :s], self._parts[:, s:]
        self._pi, self._tau, self._other = np.empty((q, s)), np.empty((q, s)), np.empty((q, s))

    def _take(self, now: TabulatedActions) -> None:
        self._now = now
        self._pull = now.pull if np.any(now.pull) else None
        moves = np.any(now.base_rate) or np.any(now.base)
        self._spin = np.tile(now.base_rate[:, 2], 2) if moves else None
        self._base_momentum = self.body.lever[:, None] * np.hstack([now.base_rate[:, 1], -now.base_rate[:, 0]])
        self._mean_turn, self._mean_rate = float(now.base[:, 2] @ self._mean), now.base_rate.T @ self._mean
        self._mean_pull = now.pull @ self._mean
        self._spun = np.outer(self.body.rotary @ self._angle, now.base_rate[:, 2])

    def _begin(self, theta: Array, momentum: Array) -> None:
        """Angles at the start, and the constant part of the residual."""
        now = self._now
        assert now is not None
        self._start_angle = (self.body.rest_angle + self._angle @ theta)[:, None]
        if self._spin is not None:
            self._start_angle = self._start_angle + now.base[:, 2]
        constant = (self.body.stiffness @ theta)[:, None] - now.couple
        self._constant = (constant @ self._to_stage - momentum[:, None] + self._spun).ravel()

    def _iterate(self, theta: Array, velocity: Array) -> tuple[bool, int, bool]:
        """Newton in place on `velocity`: solved, count, slow."""
        assert self._factor is not None
        rounding = _ROUNDING * (1.0 + float(np.abs(theta).max())) / self.h
        enough = self.tolerance * float(np.abs(velocity).max()) + rounding
        first = before = np.inf
        lu, pivots = self._factor
        for count in range(1, _ITERATIONS + 1):
            update = dgetrs(lu, pivots, self._residual(velocity))[0].reshape(velocity.shape)
            velocity -= update
            size = float(np.abs(update).max())
            if not self.h * size < _ASTRAY:  # also NaN
                return False, count, True
            contraction = size / before if count > 1 else 0.9
            if size < enough or (contraction < 0.5 and size * contraction < enough):
                self._last = update
                return True, count, count > 1 and (size / first) ** (1.0 / (count - 1)) > _SLOW
            if contraction > 0.95 and size > 1e3 * rounding:
                return False, count, True
            before = size
            first = size if count == 1 else first
        return False, _ITERATIONS, True

    def _residual(self, velocity: Array) -> Array:
        """(n s,)."""
        np.dot(self._angle, np.dot(velocity, self._spread), out=self._turned)
        alpha, moving, carried = self._alpha, self._moving, self._carried
        alpha += self._start_angle
        if self._spin is not None:
            self._twice += self._spin
        np.cos(alpha, out=self._cos)
        np.sin(alpha, out=self._sin)
        np.multiply(self._directions, self._twice, out=moving)
        np.dot(self.body.carried, moving, out=carried)
        if self._spin is not None:
            carried += self._base_momentum
        np.multiply(self._directions, carried, out=self._parts)
        np.add(self._first, self._second, out=self._pi)
        np.multiply(self._cos_moving, self._x, out=self._tau)
        np.multiply(self._sin_moving, self._y, out=self._other)
        self._tau -= self._other
        if self._pull is not None:
            self._tau += self._cos * self._pull[1] - self._sin * self._pull[0]
        np.dot(self._tau, self._to_stage, out=self._other)
        np.subtract(self._pi, self._other, out=self._other)
        out = np.dot(self._angle_t, self._other).ravel()
        out += np.dot(self._linear, velocity.ravel())
        out += self._constant
        return np.asarray(out)

    def _stage_momentum(self) -> Array:
        """(n, s) after the last update, to first order."""
        turning = self._turned[:, : self._pi.shape[1]]
        found = self._angle_t @ (self._pi + self.body.rotary[:, None] * turning)
        return np.asarray(found - self._mass @ self._last)

    def _renew(self, theta: Array, velocity: Array) -> None:
        """Factors the derivative of the stage equations at the mean stage."""
        body, n = self.body, self.body.n
        rate, pull = self._mean_rate, self._mean_pull
        alpha = body.rest_angle + self._mean_turn + np.dot(self._angle, theta + np.dot(velocity, self._mean_stage))
        turning = np.dot(self._angle, np.dot(velocity, self._mean)) + rate[2]
        weights, cos, sin = self._weights, self._weights[0], self._weights[1]
        np.cos(alpha, out=cos)
        np.sin(alpha, out=sin)
        np.multiply(weights[:2], turning, out=weights[2:])
        tables = (weights[:, None] * self._angle_t).reshape(4 * n, len(alpha))
        gram = np.dot(tables, np.dot(tables, body.carried).T).reshape(4, n, 4, n)
        self._mass = gram[0, :, 0] + gram[1, :, 1] + self._rotary
        swirl = gram[0, :, 3] - gram[1, :, 2]
        momenta = np.dot(weights[2:], body.carried)
        y, x = momenta[0] + body.lever * rate[1], body.lever * rate[0] - momenta[1]
        along = turning * (cos * y - sin * x) + cos * pull[0] + sin * pull[1]
        slope = gram[2, :, 2] + gram[3, :, 3] - np.dot(self._products, along).reshape(n, n)
        matrix = self._coupled(self._mass, body.damping + swirl.T - swirl, body.stiffness - slope)
        lu, pivots, info = dgetrf(matrix)
        if info:
            raise MechanicsError("the mass matrix is singular: use fewer coordinates, or give rotary inertia")
        self._factor = (lu, pivots)

    def _coupled(self, mass: Array, damping: Array, stiffness: Array) -> Array:
        """(n s, n s): `mass x I + damping x h a + stiffness x h^2 a^2`, Kronecker products."""
        n, s = self.body.n, len(self.numbers.c)
        parts = np.empty((n * n, 3))
        parts[:, 0], parts[:, 1], parts[:, 2] = mass.ravel(), damping.ravel(), stiffness.ravel()
        return np.asarray(np.dot(parts, self._blocks).reshape(n, n, s, s).swapaxes(1, 2).reshape(n * s, n * s))


@dataclass(frozen=True)
class MotionState:
    theta: Array  # (n,) rad
    rate: Array  # (n,) rad/s
    time: float = 0.0  # s


@dataclass(frozen=True)
class IntegrationSettings:
    method: Method = field(default_factory=Method)
    tolerance: float = 1e-10  # of stage velocities, relative to the largest
    every: int = 1  # keep every so many steps, and the last
    max_steps: int = 1_000_000
    progress: Progress = field(default_factory=Silent)


@dataclass(frozen=True)
class Motion:
    """A motion at T times; energies in the fixed frame."""

    body: Body
    time: Array  # (T,) s
    theta: Array  # (T, n) rad
    rate: Array  # (T, n) rad/s
    base: Array  # (T, 3) m, m, rad
    kinetic: Array  # (T,) J
    elastic: Array  # (T,) J
    weight: Array  # (T,) J, potential of gravity
    work: Array  # (T,) J of forces and moments since the start
    loss: Array  # (T,) J of damping since the start
    step: float  # s, longest step
    steps: int
    iterations: int  # of Newton's method, in total
    error: float  # m, of the markers by `converged`; else NaN

    @property
    def energy(self) -> Array:
        """(T,) J."""
        return self.kinetic + self.elastic + self.weight

    def xy(self, s: ArrayLike) -> Array:
        """(T, S, 2) m at `s` (S,)."""
        return self.body.xy(np.atleast_1d(np.asarray(s, dtype=float)), self.theta, self.base)

    def angle(self, s: ArrayLike) -> Array:
        """(T, S) rad at `s` (S,)."""
        return self.body.angle(np.atleast_1d(np.asarray(s, dtype=float)), self.theta, self.base[:, 2])

    def states_at(self, time: ArrayLike) -> Array:
        """(R, n) by cubic interpolation (fourth order in the spacing).

        Raises `MechanicsError`: a time outside the motion.
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

    Raises `MechanicsError`: a start that does not fit the body, too many steps, actions that are not finite, or
    unsolved stage equations.
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
    """Motion whose markers at `at_s` are accurate to `tolerance` m, by halving the step.

    `Motion.error` is twice the largest change between the last two runs. It is not divided by 2^order - 1, because
    unresolved parts are equally wrong in both.

    Raises `MechanicsError`: as `simulate`, or the tolerance was not met after `halvings`.
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
    """The motion; None if these steps are too long."""
    if sum(stretch.count for stretch in stretches) > settings.max_steps:
        raise MechanicsError(f"the tolerance is not met with the {settings.max_steps} steps allowed")
    try:
        return _follow(body, start, stretches, actions, settings)
    except StepError:
        return None


def _thinned(motion: Motion, every: int) -> Motion:
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
    first: float
    last: float
    count: int

    @property
    def step(self) -> float:
        return (self.last - self.first) / self.count


class _Ledger:
    """Steps taken so far, inside `simulate`."""

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
        """(n,) rate just after `time`, where the gripper's velocity may jump."""
        now = acting(self.body, self.actions, np.array([time + 1e-9 * h]))
        return np.asarray(_rates(self.body, self.theta[None], self.momentum[None], now.base, now.base_rate)[0])

    def add(self, taken: Step, now: TabulatedActions, weights: Array) -> None:
        """Adds a step; work and loss by the method's quadrature."""
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
        time, theta, momenta, work, loss = (np.array(column, dtype=float) for column in zip(*self._rows, strict=True))
        now = acting(self.body, self.actions, time)
        parts = [slice(i, i + 500) for i in range(0, len(time), 500)]  # 500 matrices fit the cache
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
    """(T, n) rates for momenta (T, n) and gripper poses and rates (T, 3)."""
    own = momenta - momentum(body, theta, np.zeros_like(theta), base, base_rate)
    return np.asarray(np.linalg.solve(mass_matrix(body, theta), own[..., None])[..., 0])
