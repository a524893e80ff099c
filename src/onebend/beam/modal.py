"""Curvature modes `q(s) = sum_i theta_i phi_i(s)` (1), (2), and the shapes of their states (3), (4), on fixed nodes.

The paper's modes are the powers s^i. They span the same shapes as the Legendre polynomials of 2 s - 1, which are
orthogonal: the condition number of K is near 10 where the powers reach 1e10 (n = 8). So computations run on Legendre
polynomials, and powers appear only where the paper's own rows are wanted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.errors import MechanicsError
from onebend.records import Array

MOST_POWERS = 8
_GRID = make_grid(order=30)  # resolves cos(alpha) of physical shapes to machine precision


@dataclass(frozen=True)
class Modes:
    """n curvature modes of one kind."""

    n: int
    kind: Literal["legendre", "powers"] = "legendre"

    def __post_init__(self) -> None:
        if self.n < 1:
            raise MechanicsError(f"at least one curvature mode is needed, got n = {self.n}")
        if self.kind == "powers" and self.n > MOST_POWERS:
            raise MechanicsError(
                f"{self.n} powers of s cannot be told apart in double precision (the condition number of K passes "
                f"1e10 at n = {MOST_POWERS}); use kind='legendre', which spans the same shapes"
            )

    def curvature(self, s: Array) -> Array:
        """phi_i(s): `s.shape + (n,)`."""
        s = np.asarray(s, dtype=float)
        if self.kind == "powers":
            return np.asarray(s[..., None] ** np.arange(self.n))
        return np.asarray(np.polynomial.legendre.legvander(2.0 * s - 1.0, self.n - 1))

    def angle(self, s: Array) -> Array:
        """a_i(s), the integral of phi_i from 0 to s (3): `s.shape + (n,)`."""
        s = np.asarray(s, dtype=float)
        if self.kind == "powers":
            i = np.arange(1, self.n + 1)
            return np.asarray(s[..., None] ** i / i)
        p = np.polynomial.legendre.legvander(2.0 * s - 1.0, self.n)
        out = np.empty((*s.shape, self.n))
        out[..., 0] = s
        degree = np.arange(1, self.n)
        out[..., 1:] = 0.5 * (p[..., 2:] - p[..., :-2]) / (2 * degree + 1)
        return out

    @property
    def to_legendre(self) -> Array:
        """(n, n): Legendre states from states of this kind."""
        return np.eye(self.n) if self.kind == "legendre" else _powers_to_legendre(self.n)


@lru_cache(maxsize=16)
def _powers_to_legendre(n: int) -> Array:
    """Columns: Legendre coefficients (in x = 2 s - 1) of s^i."""
    out = np.zeros((n, n))
    for i in range(n):
        coefficients = np.polynomial.polynomial.polypow([0.5, 0.5], i)  # s = (1 + x) / 2
        out[: i + 1, i] = np.polynomial.legendre.poly2leg(coefficients)
    return out


@dataclass(frozen=True)
class Places:
    """Tables that turn states into poses at fixed places of the beam; made once, used for every frame."""

    length: float  # m
    modes: Modes
    s: Array  # (S,)
    grid: Grid
    to_nodes: Array  # (Q, n): a_i at the nodes
    to_places: Array  # (S, n): a_i at s
    rows: Array  # (S, Q): integral from 0 to s


def places(length: float, modes: Modes, s: Array, grid: Grid = _GRID) -> Places:
    """Tables for positions, angles and Jacobians at `s` (S,) of a beam of `length` m."""
    s = np.asarray(s, dtype=float)
    return Places(length, modes, s, grid, modes.angle(grid.nodes), modes.angle(s), grid.integral_to(s))


def angles(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S) rad, tangent's angle for states (T, n). Equation (3)."""
    return np.asarray(alpha0 + theta @ places.to_places.T)


def positions(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2) m for states (T, n). Equation (4)."""
    alpha = alpha0 + theta @ places.to_nodes.T
    return np.asarray(places.length * np.stack([np.cos(alpha) @ places.rows.T, np.sin(alpha) @ places.rows.T], axis=-1))


def jacobians(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2, n) m, d r(s) / d theta: `J_i(v) = L int_0^v (-sin alpha, cos alpha) a_i ds`."""
    alpha = alpha0 + theta @ places.to_nodes.T
    weighted = np.einsum("sq,qi->sqi", places.rows, places.to_nodes).reshape(len(places.s), alpha.shape[-1], -1)
    jx = -np.einsum("tq,sqi->tsi", np.sin(alpha), weighted, optimize=True)
    jy = np.einsum("tq,sqi->tsi", np.cos(alpha), weighted, optimize=True)
    return np.asarray(places.length * np.stack([jx, jy], axis=2))
