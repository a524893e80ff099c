"""One step of motion: the stage equations of collocation, solved by a simplified Newton iteration.

Unknown are the stage velocities V (n, s). With X, Y the momentum of all that each node carries, the generalised
momentum and force come from the Lagrangian without forming B, C or an acceleration:

    Y = H (cos alpha o alpha') + lever y_b',   X = -H (sin alpha o alpha') + lever x_b'
    p = A^T (cos alpha Y - sin alpha X + D alpha')
    f = A^T (-alpha' (cos alpha X + sin alpha Y) + cos alpha N_y - sin alpha N_x) - K theta - D_theta theta' + a M

The iteration matrix is the exact derivative at one state of the step, and is kept over steps while it serves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs

from onebend.beam.actions import Acting
from onebend.beam.collocation import Tableau
from onebend.beam.dynamics import Body
from onebend.errors import MechanicsError
from onebend.records import Array

_ITERATIONS = 8  # with one iteration matrix
_REFRESHES = 4  # of that matrix within a step
_ASTRAY = 1e3  # rad, turn of an update
_ROUNDING = 1e-14  # share of the states that rounding leaves uncertain
_SLOW = 0.25  # a contraction above this asks for a new matrix at the next step


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
        s = len(numbers.c)
        self._to_stage = h * numbers.a.T.copy()  # theta_i = theta_0 + V @ to_stage
        self._kron = np.stack([np.eye(s), h * numbers.a, h * h * numbers.a @ numbers.a]).reshape(3, s * s)
        self._products = np.einsum("qi,qj->ijq", body.to_angle, body.to_angle).reshape(-1, len(body.lever))
        self._rotary = (self._products @ body.rotary).reshape(body.n, body.n)
        self._to_coordinates = body.to_angle.T.copy()
        self._damped = bool(np.any(body.damping))
        self._both = np.empty((body.n, 2 * s))
        self._factor: tuple[Array, Array] | None = None
        self._mass = np.empty((0, 0))

    def advance(self, theta: Array, momentum: Array, guess: Array, now: Acting, time: float) -> Step:
        """One step from (theta, momentum) under what acts at the stages; `guess` (n, s) of the stage velocities.

        Raises:
            StepError: the stage equations were not solved; the message names the time and the cure.
        """
        velocity = guess.copy()
        count = 0
        for attempt in range(_REFRESHES):
            if True:
                self._renew(theta, velocity, now)
            solved, iterations, slow, stage_momentum = self._iterate(theta, momentum, velocity, now)
            count += iterations
            if solved:
                if slow:
                    self._factor = None
                end = self.numbers.to_end
                stage_theta = theta[:, None] + velocity @ self._to_stage
                return Step(
                    theta + (stage_theta - theta[:, None]) @ end,
                    momentum + (stage_momentum - momentum[:, None]) @ end,
                    velocity,
                    stage_theta,
                    count,
                )
            if not np.all(np.isfinite(velocity)):
                velocity[:] = guess
        raise StepError(
            f"the motion could not be followed beyond t = {time:.6g} s with steps of {self.h:.3g} s; give a smaller step"
        )

    def _iterate(
        self, theta: Array, momentum: Array, velocity: Array, now: Acting
    ) -> tuple[bool, int, bool, Array]:
        """Newton with the iteration matrix at hand, in place on `velocity`: solved, count, slow, stage momenta."""
        assert self._factor is not None
        start, before, worst = momentum[:, None], np.inf, 0.0
        stage_momentum = momentum
        enough = self.tolerance * float(np.abs(velocity).max()) + _ROUNDING * (1.0 + float(np.abs(theta).max())) / self.h
        for count in range(1, _ITERATIONS + 1):
            stage_momentum, force = self._momentum_and_force(theta, velocity, now)
            residual = stage_momentum - start
            residual -= force @ self._to_stage
            update = dgetrs(*self._factor, residual.reshape(-1))[0].reshape(velocity.shape)
            velocity -= update
            size = float(np.abs(update).max())
            if not self.h * size < _ASTRAY:  # NaN included
                return False, count, True, stage_momentum
            contraction = size / before if count > 1 else 0.0
            worst = max(worst, contraction)
            if size < enough or (count > 1 and contraction < 0.5 and size * contraction < enough):
                return True, count, worst > _SLOW, stage_momentum - self._mass @ update
            if contraction > 0.9:
                return False, count, True, stage_momentum
            before = size
        return False, _ITERATIONS, True, stage_momentum

    def _momentum_and_force(self, theta: Array, velocity: Array, now: Acting) -> tuple[Array, Array]:
        """Generalised momenta and forces at the stages, (n, s) each."""
        body, both = self.body, self._both
        s = velocity.shape[1]
        both[:, :s] = theta[:, None] + velocity @ self._to_stage
        both[:, s:] = velocity
        nodes = body.to_angle @ both
        alpha, turning = nodes[:, :s], nodes[:, s:]
        alpha += body.rest_angle[:, None] + now.base[:, 2]
        turning += now.base_rate[:, 2]
        directions = np.empty((len(alpha), 2, s))
        cos, sin = directions[:, 0], directions[:, 1]
        np.cos(alpha, out=cos)
        np.sin(alpha, out=sin)
        carried = (body.carried @ (directions * turning[:, None]).reshape(len(alpha), -1)).reshape(directions.shape)
        carried[:, 0] += body.lever[:, None] * now.base_rate[:, 1]  # Y
        carried[:, 1] -= body.lever[:, None] * now.base_rate[:, 0]  # -X
        out = np.empty((len(alpha), 2 * s))
        out[:, :s] = cos * carried[:, 0] + sin * carried[:, 1] + body.rotary[:, None] * turning
        out[:, s:] = cos * (turning * carried[:, 1] + now.pull[1]) - sin * (turning * carried[:, 0] + now.pull[0])
        found = self._to_coordinates @ out
        force = found[:, s:] - body.stiffness @ both[:, :s] + now.couple
        if self._damped:
            force -= body.damping @ velocity
        return found[:, :s], force

    def _renew(self, theta: Array, velocity: Array, now: Acting) -> None:
        """Factor the derivative of the stage equations, taken at the mean of the stages."""
        body, n, s = self.body, self.body.n, velocity.shape[1]
        mean = np.full(s, 1.0 / s)
        alpha = body.rest_angle + now.base[:, 2] @ mean + body.to_angle @ (theta + velocity @ (self._to_stage @ mean))
        turning = body.to_angle @ (velocity @ mean) + now.base_rate[:, 2] @ mean
        cos, sin = np.cos(alpha), np.sin(alpha)
        weights = np.stack([cos, sin, cos * turning, sin * turning], axis=1)
        tables = (weights[:, :, None] * body.to_angle[:, None, :]).reshape(len(alpha), 4 * n)
        gram = (tables.T @ (body.carried @ tables)).reshape(4, n, 4, n)
        self._mass = gram[0, :, 0] + gram[1, :, 1] + self._rotary
        swirl = gram[0, :, 3] - gram[1, :, 2]
        y = body.carried @ weights[:, 2] + body.lever * (now.base_rate[:, 1] @ mean)
        x = -(body.carried @ weights[:, 3]) + body.lever * (now.base_rate[:, 0] @ mean)
        pull = now.pull @ mean
        along = turning * (cos * y - sin * x) + cos * pull[0] + sin * pull[1]
        slope = gram[2, :, 2] + gram[3, :, 3] - body.stiffness - (self._products @ along).reshape(n, n)
        parts = np.stack([self._mass, body.damping + swirl.T - swirl, -slope], axis=-1)
        matrix = (parts.reshape(n * n, 3) @ self._kron).reshape(n, n, s, s).swapaxes(1, 2).reshape(n * s, n * s)
        lu, pivots, info = dgetrf(matrix)
        if info:
            raise MechanicsError("the mass matrix is singular: fewer coordinates are needed, or rotary inertia")
        self._factor = (lu, pivots)
