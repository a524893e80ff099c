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
    acting,
    mass_matrix,
)
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
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
#     Y = H (cos alpha o alpha'),   X = -H (sin alpha o alpha')
#     p = A^T (pi + D alpha'),                   pi = cos alpha Y - sin alpha X
#     f = A^T tau - K theta - D_theta theta',
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
        self._now: Array | None = None
        self._prepare(q, s)

    def advance(self, theta: Array, momentum: Array, guess: Array, now: Array, time: float) -> Step:
        """One step under the pull at the stages (see `acting`); `guess` (n, s) of the stage velocities.

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

    def _take(self, now: Array) -> None:
        self._now = now
        self._pull = now if np.any(now) else None
        self._mean_pull = now @ self._mean

    def _begin(self, theta: Array, momentum: Array) -> None:
        """Angles at the start, and the constant part of the residual."""
        self._start_angle = (self.body.rest_angle + self._angle @ theta)[:, None]
        constant = np.outer(self.body.stiffness @ theta, self._to_stage.sum(axis=0))
        self._constant = (constant - momentum[:, None]).ravel()

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
        np.cos(alpha, out=self._cos)
        np.sin(alpha, out=self._sin)
        np.multiply(self._directions, self._twice, out=moving)
        np.dot(self.body.carried, moving, out=carried)
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
        pull = self._mean_pull
        alpha = body.rest_angle + np.dot(self._angle, theta + np.dot(velocity, self._mean_stage))
        turning = np.dot(self._angle, np.dot(velocity, self._mean))
        weights, cos, sin = self._weights, self._weights[0], self._weights[1]
        np.cos(alpha, out=cos)
        np.sin(alpha, out=sin)
        np.multiply(weights[:2], turning, out=weights[2:])
        tables = (weights[:, None] * self._angle_t).reshape(4 * n, len(alpha))
        gram = np.dot(tables, np.dot(tables, body.carried).T).reshape(4, n, 4, n)
        self._mass = gram[0, :, 0] + gram[1, :, 1] + self._rotary
        swirl = gram[0, :, 3] - gram[1, :, 2]
        momenta = np.dot(weights[2:], body.carried)
        along = turning * (cos * momenta[0] + sin * momenta[1]) + cos * pull[0] + sin * pull[1]
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
    max_steps: int = 1_000_000


@dataclass(frozen=True)
class Motion:
    """A motion at T times."""

    body: Body
    time: Array  # (T,) s
    theta: Array  # (T, n) rad
    rate: Array  # (T, n) rad/s
    step: float  # s, longest step
    steps: int
    iterations: int  # of Newton's method, in total
    error: float  # m, of the markers by `converged`; else NaN

    def xy(self, s: ArrayLike) -> Array:
        """(T, S, 2) m at `s` (S,)."""
        return self.body.xy(np.atleast_1d(np.asarray(s, dtype=float)), self.theta)

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
    """Motion whose markers at `at_s` are accurate to `tolerance` m, by halving the step; at the times of the first.

    `Motion.error` is twice the largest change between the last two runs. It is not divided by 2^order - 1, because
    unresolved parts are equally wrong in both.

    Raises `MechanicsError`: as `simulate`, or the tolerance was not met after `halvings`.
    """
    stretches = _stretches(body, start, duration, step, actions, settings.max_steps)
    places, change = np.atleast_1d(np.asarray(at_s, dtype=float)), np.inf
    coarse = _attempt(body, start, stretches, actions, settings, every=1)
    for i in range(halvings):
        stretches = [replace(stretch, count=2 * stretch.count) for stretch in stretches]
        fine = _attempt(body, start, stretches, actions, settings, every=2 ** (i + 1))
        if coarse is not None and fine is not None:
            change = float(np.max(np.linalg.norm(fine.xy(places) - coarse.xy(places), axis=-1)))
            if 2.0 * change < tolerance:
                return replace(fine, error=2.0 * change)
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
    body: Body,
    start: MotionState,
    stretches: list[_Stretch],
    actions: Actions,
    settings: IntegrationSettings,
    *,
    every: int,
) -> Motion | None:
    """The motion at every so many steps; None if these are too long."""
    if sum(stretch.count for stretch in stretches) > settings.max_steps:
        raise MechanicsError(f"the tolerance is not met with the {settings.max_steps} steps allowed")
    try:
        found = _follow(body, start, stretches, actions, settings)
    except StepError:
        return None
    return replace(found, time=found.time[::every], theta=found.theta[::every], rate=found.rate[::every])


def _follow(
    body: Body, start: MotionState, stretches: list[_Stretch], actions: Actions, settings: IntegrationSettings
) -> Motion:
    theta = np.asarray(start.theta, dtype=float)
    momentum = mass_matrix(body, theta) @ np.asarray(start.rate, dtype=float)
    rows, iterations, numbers = [(start.time, theta, momentum)], 0, tableau(settings.method)
    for stretch in stretches:
        h = stretch.step
        stepper = Stepper(body, numbers, h, tolerance=settings.tolerance)
        inside = h * np.minimum(numbers.c, 1.0 - 1e-12)  # a stage at the end still belongs to this side of a jump
        now = acting(body, actions, stretch.first + inside)
        guess = np.repeat(_rates(body, theta[None], momentum[None]).T, len(inside), axis=1)
        for i in range(stretch.count):
            begin = stretch.first + i * h
            if i and not actions.steady:
                now = acting(body, actions, begin + inside)
            taken = stepper.advance(theta, momentum, guess, now, begin)
            theta, momentum, guess = taken.theta, taken.momentum, taken.velocity @ numbers.ahead.T
            iterations += taken.iterations
            rows.append((stretch.last if i + 1 == stretch.count else begin + h, theta, momentum))
    time, thetas, momenta = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    parts = [slice(i, i + 500) for i in range(0, len(time), 500)]  # 500 matrices fit the cache
    rate = np.concatenate([_rates(body, thetas[part], momenta[part]) for part in parts])
    longest = max(stretch.step for stretch in stretches)
    return Motion(body, time, thetas, rate, longest, len(rows) - 1, iterations, np.nan)


@dataclass(frozen=True)
class _Stretch:
    first: float
    last: float
    count: int

    @property
    def step(self) -> float:
        return (self.last - self.first) / self.count


def _rates(body: Body, theta: Array, momenta: Array) -> Array:
    """(T, n) rates for momenta (T, n)."""
    return np.asarray(np.linalg.solve(mass_matrix(body, theta), momenta[..., None])[..., 0])
