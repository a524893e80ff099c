"""One step of motion: the stage equations of collocation, solved by a simplified Newton iteration.

Unknown are the stage velocities V (n, s). With X, Y the momentum of all that each node carries, the generalised
momentum and force come from the Lagrangian without forming B, C or an acceleration:

    Y = H (cos alpha o alpha') + lever y_b',   X = -H (sin alpha o alpha') + lever x_b'
    p = A^T (pi + D alpha'),                   pi = cos alpha Y - sin alpha X
    f = A^T tau - K theta - D_theta theta' + a M,
    tau = -alpha' (cos alpha X + sin alpha Y) + cos alpha N_y - sin alpha N_x

and the stages obey `p_i = p_0 + h sum_j a_ij f_j`. What is linear in V (K, damping, rotary inertia) is one matrix. The
iteration matrix is the exact derivative at the mean of the stages, and is kept over steps while it serves.

This is the hot loop: it works in place on arrays made once, since at this size a call costs more than its arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from onebend.beam.motion.actions import TabulatedActions
from onebend.beam.motion.collocation import Tableau
from onebend.beam.motion.dynamics import Body
from onebend.errors import MechanicsError
from onebend.records import Array

_ITERATIONS = 12  # with one iteration matrix
_REFRESHES = 4  # of that matrix within a step
_SLOW = 0.05  # a mean contraction above this asks for a new matrix at the next step
_ASTRAY = 1e3  # rad, turn of an update
_ROUNDING = 1e-14  # share of the states that rounding leaves uncertain


class StepError(MechanicsError):
    """The stage equations of a step were not solved."""


@dataclass(frozen=True)
class Step:
    """What a step found."""

    theta: Array  # (n,) at its end
    momentum: Array  # (n,) kg m^2/s at its end
    velocity: Array  # (n, s) at the stages
    stage_theta: Array  # (n, s)
    iterations: int


class Stepper:
    """Steps of one length with one body and method. Holds the work arrays and the iteration matrix."""

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
        """One step from (theta, momentum) under what acts at the stages; `guess` (n, s) of the stage velocities.

        Raises:
            StepError: the stage equations were not solved; the message names the time and the cure.
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
                break  # a step that turns the beam this far has solved equations that no longer mean its motion
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
        """Work arrays and the views of them that a residual needs: c, s for cos, sin; y, x for the momenta Y, -X."""
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
        """What acts from here on; absent kinds of action cost nothing in the residual."""
        self._now = now
        self._pull = now.pull if np.any(now.pull) else None
        moves = np.any(now.base_rate) or np.any(now.base)
        self._spin = np.tile(now.base_rate[:, 2], 2) if moves else None
        self._base_momentum = self.body.lever[:, None] * np.hstack([now.base_rate[:, 1], -now.base_rate[:, 0]])
        self._mean_turn, self._mean_rate = float(now.base[:, 2] @ self._mean), now.base_rate.T @ self._mean
        self._mean_pull = now.pull @ self._mean
        self._spun = np.outer(self.body.rotary @ self._angle, now.base_rate[:, 2])

    def _begin(self, theta: Array, momentum: Array) -> None:
        """What is constant during the iteration: angles at the start, and the constant part of the residual."""
        now = self._now
        assert now is not None
        self._start_angle = (self.body.rest_angle + self._angle @ theta)[:, None]
        if self._spin is not None:
            self._start_angle = self._start_angle + now.base[:, 2]
        constant = (self.body.stiffness @ theta)[:, None] - now.couple
        self._constant = (constant @ self._to_stage - momentum[:, None] + self._spun).ravel()

    def _iterate(self, theta: Array, velocity: Array) -> tuple[bool, int, bool]:
        """Newton with the iteration matrix at hand, in place on `velocity`: solved, count, slow."""
        assert self._factor is not None
        rounding = _ROUNDING * (1.0 + float(np.abs(theta).max())) / self.h
        enough = self.tolerance * float(np.abs(velocity).max()) + rounding
        first = before = np.inf
        lu, pivots = self._factor
        for count in range(1, _ITERATIONS + 1):
            update = dgetrs(lu, pivots, self._residual(velocity))[0].reshape(velocity.shape)
            velocity -= update
            size = float(np.abs(update).max())
            if not self.h * size < _ASTRAY:  # NaN included
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
        """(n s,) of the stage equations."""
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
        """(n, s) after the last update of the iteration, whose effect is added to first order."""
        turning = self._turned[:, : self._pi.shape[1]]
        found = self._angle_t @ (self._pi + self.body.rotary[:, None] * turning)
        return np.asarray(found - self._mass @ self._last)

    def _renew(self, theta: Array, velocity: Array) -> None:
        """Factor the derivative of the stage equations, taken at the mean of the stages."""
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
        """(n s, n s): `mass x I + damping x h a + stiffness x h^2 a^2`, Kronecker products over the stages."""
        n, s = self.body.n, len(self.numbers.c)
        parts = np.empty((n * n, 3))
        parts[:, 0], parts[:, 1], parts[:, 2] = mass.ravel(), damping.ravel(), stiffness.ravel()
        return np.asarray(np.dot(parts, self._blocks).reshape(n, n, s, s).swapaxes(1, 2).reshape(n * s, n * s))
