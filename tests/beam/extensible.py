"""A beam that stretches and shears as an initial-value problem, integrated by scipy: nothing of the code under test.

`r' = L ((1 + N/EA) d1 + (Q/kGA) d2)`, `alpha' = q0 + M/k`, `M' = -(r' x n)`, `n' = -L mu g`; n jumps at the forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

from onebend.beam.model import Beam
from onebend.records import Array


@dataclass(frozen=True)
class PointForce:
    """A dead force on the beam."""

    at_s: float
    force: tuple[float, float]  # N


def compliance(beam: Beam, s: float, mean: float) -> tuple[float, float]:
    """1/EA and 1/kGA from the beam's thickness, by the textbook: A = b h, I = b h^3 / 12."""
    assert beam.thickness is not None
    k = float(beam.stiffness(s))
    h = beam.thickness * (k / mean) ** (1.0 / 3.0 if beam.varies == "thickness" else 0.0)
    width_times_modulus = 12.0 * k * beam.length / h**3
    area = width_times_modulus * h
    shear = 5.0 / 6.0 * area / (2.0 * (1.0 + beam.poisson))
    return 1.0 / area, 1.0 / shear


def mean_stiffness(beam: Beam) -> float:
    """By the trapezoidal rule."""
    s = np.linspace(0.0, 1.0, 200001)
    return float(np.trapezoid(np.asarray(beam.stiffness(s)), s))


def shoot(
    beam: Beam, forces: tuple[PointForce, ...], gravity: tuple[float, float], places: Array, near: float
) -> Array:
    """(S, 3) x, y, alpha at rising `places`; the clamp's moment is sought from `near` [N m]."""
    mean, g = mean_stiffness(beam), np.asarray(gravity)
    edges = sorted({0.0, 1.0, *(f.at_s for f in forces)})
    total = np.sum([f.force for f in forces], axis=0)
    mass = solve_ivp(lambda s, _: [float(beam.mass_per_length(s))], (0.0, 1.0), [0.0], rtol=1e-12, atol=1e-14).y[0, -1]
    start = np.array([0.0, 0.0, beam.clamp_angle, *(total + beam.length * mass * g)])

    def slopes(s: float, y: Array) -> Array:
        alpha, n, m = y[2], y[3:5], y[5]
        d1, d2 = np.array([np.cos(alpha), np.sin(alpha)]), np.array([-np.sin(alpha), np.cos(alpha)])
        stretch, shear = compliance(beam, s, mean)
        way = beam.length * ((1.0 + stretch * (n @ d1)) * d1 + shear * (n @ d2) * d2)
        bend = float(beam.rest_curvature(s)) + m / float(beam.stiffness(s))
        weight = -beam.length * float(beam.mass_per_length(s)) * g
        return np.array([*way, bend, *weight, -(way[0] * n[1] - way[1] * n[0])])

    def integrate(moment: float) -> tuple[Array, float]:
        y, out = np.append(start, moment), []
        for a, b in pairwise(edges):
            inside = places[(places > a) & (places <= b)]
            run = solve_ivp(slopes, (a, b), y, method="DOP853", t_eval=np.unique([*inside, b]), rtol=1e-11, atol=1e-14)
            out.append(run.y[:3, : len(inside)].T)
            y = run.y[:, -1].copy()
            for f in forces:
                if f.at_s == b:
                    y[3:5] -= f.force
        return np.concatenate(out), float(y[5])

    scale = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 11)))))
    found = root(lambda m: [integrate(float(m[0]) * scale)[1] / scale], [near / scale], tol=1e-13)
    assert abs(found.fun[0]) < 1e-10, found.message
    return integrate(float(found.x[0]) * scale)[0]
