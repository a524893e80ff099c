"""Exact solutions by elliptic integrals and the like, independent of the code under test."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


def elastica_tip(load: float, direction: float) -> tuple[float, float, float]:
    """Tip (x, y)/L and tangent angle of a uniform cantilever under a dead tip force, `load` = P L^2 / EI.

    With chi = pi - direction + alpha the beam is a pendulum, chi'' = -load sin(chi), released at the tip (chi' = 0):
    Euler's elastica. The branch is the one that grows from the straight beam (chi monotone from clamp to tip).
    """
    chi0 = np.arctan2(np.sin(np.pi - direction), np.cos(np.pi - direction))
    mirror = -1.0 if chi0 < 0.0 else 1.0
    chi0, omega = abs(chi0), np.sqrt(load)

    def excess(p: float) -> float:
        start = np.arcsin(min(np.sin(0.5 * chi0) / p, 1.0))
        return float(ellipk(p**2) - ellipkinc(start, p**2) - omega)

    lowest = max(np.sin(0.5 * chi0), 1e-9)
    p = float(brentq(excess, lowest * (1.0 + 1e-15), 1.0 - 1e-15, xtol=1e-16, rtol=1e-15))
    start = np.arcsin(np.sin(0.5 * chi0) / p)
    along = (2.0 * (ellipe(p**2) - ellipeinc(start, p**2)) - omega) / omega
    across = 2.0 * p * np.cos(start) / omega
    turn = -(np.pi - mirror * direction)
    x = along * np.cos(turn) - across * np.sin(turn)
    y = along * np.sin(turn) + across * np.cos(turn)
    alpha = 2.0 * np.arcsin(p) + turn
    alpha = np.arctan2(np.sin(alpha), np.cos(alpha))
    return float(x), float(mirror * y), float(mirror * alpha)
