"""The beam about a working point, as a loop sees it: from the force at `push_s` to the position of `point_s`.

Near an equilibrium the beam moves as its small vibrations do, `eta_i'' + 2 zeta_i omega_i eta_i' + omega_i^2 eta_i =
phi_i(push)^T F`, and the point by `sum_i phi_i(point) eta_i`. What the modes left out would add is taken as moving at
once, so that at rest the compliance is the exact `J(s_p) T^-1 J(s_a)^T` of (24).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from onebend.beam.loads import push, weight
from onebend.beam.motion.vibration import vibration
from onebend.beam.statics.continuation import equilibrium
from onebend.beam.statics.rod import Rod, has_mass
from onebend.beam.statics.sensitivity import of_force, respond
from onebend.errors import MechanicsError
from onebend.records import Array

MODES = 6
_SHORTEST_LAG = 1e-4  # s, the shortest lag of an actuator: far below a frame, and still well-conditioned


@dataclass(frozen=True)
class Plant:
    """A beam linearised about an equilibrium; m modes, none where its mass is not known (it then moves at once)."""

    omega: Array  # (m,) rad/s
    damping: Array  # (m,) damping ratios
    pushed: Array  # (m, 2) kg^-1/2: modes at the place of the force
    seen: Array  # (m, 2) kg^-1/2: modes at the point
    compliance: Array  # (2, 2) m/N, exact

    @property
    def at_once(self) -> Array:
        """(2, 2) m/N: compliance of the modes that are left out."""
        return np.asarray(self.compliance - self.seen.T @ (self.pushed / self.omega[:, None] ** 2))

    def stiffer(self, factor: float) -> Plant:
        """The same shape of the beam with all of k(s) times `factor`, damping ratios kept.

        Without weight that is exact: the force that holds the shape grows by `factor`, and so does the tangent.
        """
        return replace(self, omega=sqrt(factor) * self.omega, compliance=self.compliance / factor)


def plant_at(
    beam: Rod,
    force: ArrayLike,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    damping_ratio: float = 0.05,
    gravity: ArrayLike | None = None,
) -> Plant:
    """The beam about its equilibrium under `force` (2,) N.

    `damping_ratio`: of the slowest vibration; those above have more in proportion to their frequency (Kelvin-Voigt).

    Raises:
        MechanicsError: no stable equilibrium under this force.
    """
    loads = push(np.asarray(force, dtype=float)[None], push_s)
    if gravity is not None:
        loads = loads + weight(gravity)
    solved = equilibrium(beam, loads)
    if not (solved.converged[0] and solved.stable[0]):
        raise MechanicsError(f"the beam has no stable shape under {np.asarray(force)} N to control it about")
    point = np.array([point_s])
    compliance = respond(solved, of_force(solved.problem, np.array([push_s]))).xy(point)[0, 0]
    if not has_mass(beam):
        return Plant(np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), compliance)
    small = vibration(beam, solved, count=MODES)
    omega = np.sqrt(small.squared)
    moved = small.moved(np.array([push_s, point_s]))
    return Plant(omega, damping_ratio * omega / omega[0], moved[:, 0], moved[:, 1], compliance)


@dataclass(frozen=True)
class StateSpace:
    """`x' = a x + b u`, `y = c x`: the plant behind its actuator. N = 2 m + 2 states."""

    a: Array  # (N, N) 1/s
    b: Array  # (N, 2)
    c: Array  # (2, N)

    def over(self, time: float) -> tuple[Array, Array]:
        """(N, N), (N, 2): the state after `time` s at constant input, from the state and the input."""
        n = len(self.a)
        moved = expm(time * np.block([[self.a, self.b], [np.zeros((2, n + 2))]]))
        return moved[:n, :n], moved[:n, n:]


def behind_actuator(plant: Plant, lag: float) -> StateSpace:
    """The plant driven by an actuator of first order with time constant `lag` s."""
    m, slow = len(plant.omega), max(lag, _SHORTEST_LAG)
    a = np.zeros((2 * m + 2, 2 * m + 2))
    a[:m, m : 2 * m] = np.eye(m)
    a[m : 2 * m, :m] = -np.diag(plant.omega**2)
    a[m : 2 * m, m : 2 * m] = -np.diag(2.0 * plant.damping * plant.omega)
    a[m : 2 * m, 2 * m :] = plant.pushed
    a[2 * m :, 2 * m :] = -np.eye(2) / slow
    b = np.vstack([np.zeros((2 * m, 2)), np.eye(2) / slow])
    c = np.hstack([plant.seen.T, np.zeros((2, m)), plant.at_once])
    return StateSpace(a, b, c)
