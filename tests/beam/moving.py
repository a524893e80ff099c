"""Beams that the tests of motion share, and an independent route to their motion."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from onebend.beam.dynamics import Actions, Body, body, mass_matrix
from onebend.beam.grid import Modes
from onebend.beam.integration import Motion, MotionState
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Powers, Scaled, Steps, Uniform
from onebend.records import Array

SOFT = Beam(0.15, Uniform(0.02), mass_per_length=Uniform(0.1))  # 150 mm, fundamental 4.3 Hz
# Nothing uniform, nothing straight: stiffness, mass with a jump, natural curvature, clamp angle.
ODD = Beam(0.15, Powers((0.03, -0.02)), Powers((0.5, 1.0)), 0.3, Steps((0.0, 0.6, 1.0), (0.12, 0.06)))
THICK = Powers((2e-6, -1e-6))  # rotary inertia, kg m: some thousand times that of a thin strip, so that it shows
LOSSY = Scaled(2e-3, Powers((0.03, -0.02)))  # damping, N m s


def soft_body(n: int = 4) -> Body:
    return body(SOFT, Modes(n), resolution=Resolution(20))


def odd_body(n: int = 4) -> Body:
    return body(ODD, Modes(n), rotary_inertia=THICK, damping=LOSSY)


def directions(of: Body, theta: Array) -> tuple[Array, Array]:
    """cos and sin of the angles at the nodes, (..., Q) each."""
    alpha = of.rest_angle + theta @ of.to_angle.T
    return np.cos(alpha), np.sin(alpha)


def coriolis_matrix(of: Body, theta: Array, rate: Array) -> Array:
    """(..., n, n) kg m^2/s: C of (7) by Christoffel's symbols, so that B' - 2 C is skew-symmetric."""
    c, s = directions(of, theta)
    turned = (rate @ of.to_angle.T)[..., None] * of.to_angle
    ca, sa = c[..., None] * of.to_angle, s[..., None] * of.to_angle
    first = np.swapaxes(sa, -1, -2) @ (of.carried @ (c[..., None] * turned))
    return np.asarray(first - np.swapaxes(ca, -1, -2) @ (of.carried @ (s[..., None] * turned)))


def gravity_vector(of: Body, theta: Array, gravity: Array) -> Array:
    """(..., n) N m: G of (7) for gravity (2,) m/s^2 in the beam's frame; on the left side of the equation."""
    c, s = directions(of, theta)
    return np.asarray(-(of.lever * (c * gravity[1] - s * gravity[0])) @ of.to_angle)


def force_jacobian(of: Body, theta: Array, at_s: float) -> Array:
    """(..., 2, n) m: J(s) = d r(s) / d theta; a force F there acts as J^T F."""
    c, s = directions(of, theta)
    row = of.length * of.grid.integral_to(np.array([at_s]))[0]
    return np.stack([(-row * s) @ of.to_angle, (row * c) @ of.to_angle], axis=-2)


def kinetic_energy(of: Body, theta: Array, rate: Array) -> Array:
    """(...,) J for states and rates (..., n)."""
    turning, (c, s) = rate @ of.to_angle.T, directions(of, theta)
    ct, st = c * turning, s * turning
    carried = ct * (ct @ of.carried) + st * (st @ of.carried) + of.rotary * turning**2
    return np.asarray(0.5 * np.sum(carried, axis=-1))


def elastic_energy(of: Body, theta: Array) -> Array:
    """(...,) J: `1/2 int k (q - q0)^2`."""
    return np.asarray(0.5 * np.sum(theta * (theta @ of.stiffness), axis=-1))


def weight_energy(of: Body, theta: Array, gravity: Array) -> Array:
    """(...,) J under gravity (2,) m/s^2, 0 at the origin."""
    c, s = directions(of, theta)
    return np.asarray(-(gravity[0] * c + gravity[1] * s) @ of.lever)


def energy_of(motion: Motion) -> Array:
    """(T,) J, without weight."""
    return kinetic_energy(motion.body, motion.theta, motion.rate) + elastic_energy(motion.body, motion.theta)


def by_the_matrices(of: Body, start: MotionState, duration: float, actions: Actions) -> Array:
    """(2 n,) state and rate after `duration` from (7) as printed, by an explicit method of order 8."""
    gravity = np.asarray(actions.gravity, dtype=float)

    def slope(time: float, y: Array) -> Array:
        theta, rate = y[: of.n], y[of.n :]
        right = -coriolis_matrix(of, theta, rate) @ rate - gravity_vector(of, theta, gravity)
        right -= of.stiffness @ theta + of.damping @ rate
        for force in actions.forces:
            value = force.value(time) if callable(force.value) else force.value
            right += force_jacobian(of, theta, force.at_s).T @ np.asarray(value, dtype=float)
        return np.concatenate([rate, np.linalg.solve(mass_matrix(of, theta), right)])

    y0 = np.concatenate([start.theta, start.rate])
    solved = solve_ivp(slope, (start.time, start.time + duration), y0, method="DOP853", rtol=1e-11, atol=1e-11)
    return np.asarray(solved.y[:, -1])
