"""Collocation methods for motion: Gauss (symplectic, keeps energy) and Radau IIA (damps what it cannot resolve).

A step of length h seeks stage velocities V_j at the times t + c_j h such that the momenta obey

    p_i = p_0 + h sum_j a_ij f_j,   theta_i = theta_0 + h sum_j a_ij V_j.

Gauss with s stages has order 2 s and is symmetric, symplectic and A-stable; one stage is the implicit midpoint rule,
which for mechanics is also the variational integrator of Veselov. Radau IIA has order 2 s - 1 and is L-stable: it takes
energy out of motions faster than the step. Reference: Hairer, Lubich, Wanner, Geometric Numerical Integration, II.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.errors import MechanicsError
from onebend.records import Array


@dataclass(frozen=True)
class Method:
    """A family and its number of stages; `gauss` with three stages (order 6) is the default of motion."""

    stages: int = 3
    family: Literal["gauss", "radau"] = "gauss"

    def __post_init__(self) -> None:
        if not 1 <= self.stages <= 6:
            raise MechanicsError(f"a collocation method has 1 to 6 stages here, got {self.stages}")

    @property
    def order(self) -> int:
        """The error after a given time falls with this power of the step."""
        return 2 * self.stages - (self.family == "radau")


@dataclass(frozen=True)
class Tableau:
    """Numbers of a method: checked against the conditions that define collocation when made."""

    c: Array  # (s,) stage times
    a: Array  # (s, s)
    b: Array  # (s,)
    to_end: Array  # (s,) d = b a^-1: y_1 = y_0 + sum_i d_i (Y_i - y_0) without amplifying what is stiff
    ahead: Array  # (s, s): values at the stages of the next equal step, by the polynomial through this step's stages

    def __post_init__(self) -> None:
        power = np.arange(1, len(self.c) + 1)
        if not (
            np.allclose(self.a @ (self.c[:, None] ** (power - 1)), self.c[:, None] ** power / power, atol=1e-13)
            and np.allclose(self.b @ (self.c[:, None] ** (power - 1)), 1.0 / power, atol=1e-13)
        ):
            raise MechanicsError("these numbers are not a collocation method")


def tableau(method: Method) -> Tableau:
    """The numbers of a method, from the roots of its polynomial."""
    c = _places(method)
    powers = np.arange(1, method.stages + 1)
    values = c[:, None] ** (powers - 1)  # Vandermonde; s <= 6 keeps it harmless
    a = np.linalg.solve(values.T, (c[:, None] ** powers / powers).T).T
    b = np.linalg.solve(values.T, 1.0 / powers)
    ahead = np.linalg.solve(values.T, ((c[:, None] + 1.0) ** (powers - 1)).T).T
    return Tableau(*(np.asarray(x, dtype=float) for x in (c, a, b, np.linalg.solve(a.T, b), ahead)))


def _places(method: Method) -> Array:
    """Stage times in (0, 1]: roots of P_s for Gauss, of P_s - P_(s-1) for Radau IIA, moved to [0, 1]."""
    coefficients = np.zeros(method.stages + 1)
    coefficients[-1] = 1.0
    if method.family == "radau":
        coefficients[-2] = -1.0
    roots = np.sort(np.real(np.polynomial.legendre.legroots(coefficients)))
    return np.asarray(0.5 * (roots + 1.0))
