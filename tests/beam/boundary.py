"""The beam held at both ends by shooting: the same physics as an initial-value problem, integrated by scipy."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from onebend.beam.problem import Rod
from onebend.records import Array

NOTHING = np.zeros(2)


def integrate(beam: Rod, start: Array, *, point: Array = NOTHING, gravity: Array = NOTHING, places: Array) -> Array:
    """(6, S) x, y [m], alpha, and the wrench at `places` (rising, the last 1), from its values `start` (6,) at s = 0.

    `alpha' = q0 + m / k`, `m' = -L (cos alpha N_y - sin alpha N_x)`, `N' = -L mu g`; N jumps by `point` at s = 1/2. The
    wrench (N, m) is what the part beyond s puts on the part before.
    """
    length = beam.length

    def slopes(s: float, state: Array) -> Array:
        _, _, alpha, nx, ny, m = state
        cos, sin = np.cos(alpha), np.sin(alpha)
        weight = -length * float(beam.mass_per_length(s)) * gravity
        bend = float(beam.rest_curvature(s)) + m / float(beam.stiffness(s))
        return np.array([length * cos, length * sin, bend, *weight, -length * (cos * ny - sin * nx)])

    out, at = [], start
    for a, b in ((0.0, 0.5), (0.5, 1.0)):
        inside = places[(places >= a) & (places < b)]
        run = solve_ivp(slopes, (a, b), at, method="DOP853", t_eval=np.append(inside, b), rtol=1e-13, atol=1e-15)
        out.append(run.y[:, : len(inside)])
        at = run.y[:, -1]
        if a == 0.0:
            at = at - np.array([0.0, 0.0, 0.0, *point, 0.0])
    out.append(at[:, None])
    return np.concatenate(out, axis=1)


def shoot(
    beam: Rod, goal: Array, near: Array, *, point: Array = NOTHING, gravity: Array = NOTHING, places: Array
) -> Array:
    """As `integrate`, for the equilibrium with the end at `goal` (3,) m, m, rad; the clamp's wrench from `near`."""
    base = np.array([0.0, 0.0, beam.clamp_angle])
    scale = float(beam.stiffness(0.5)) * np.array([1.0 / beam.length, 1.0 / beam.length, 1.0])
    last = np.array([0.0, 1.0])

    def miss(unknown: Array) -> Array:
        end = integrate(beam, np.append(base, unknown * scale), point=point, gravity=gravity, places=last)[:3, -1]
        return np.asarray((end - goal) / [beam.length, beam.length, 1.0])

    found = root(miss, near / scale, tol=1e-13)
    assert np.max(np.abs(miss(found.x))) < 1e-11, found.message
    return integrate(beam, np.append(base, found.x * scale), point=point, gravity=gravity, places=places)
