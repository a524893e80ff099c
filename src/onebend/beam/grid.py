"""Panels of Gauss nodes along the beam, and integration from the base.

A quantity is given by its values at the nodes, and is a polynomial on each panel. Its integral from 0 to s is a row
vector times the values. Of curvature it gives the angle (3), of the tangent (cos, sin) the position over L (4).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from onebend.errors import MechanicsError
from onebend.records import Array

_FEW_PLACES = 64  # rows for up to so many places are cached
_NARROWEST = 1e-9  # narrowest panel; closer edges are merged


@dataclass(frozen=True)
class Grid:
    """`P` panels with `order` Gauss-Legendre nodes each, `Q = P * order` in all.

    Leading batch axes of `edges` (a push whose place varies between frames) appear in all arrays.
    """

    edges: Array  # (..., P + 1), rising from 0 to 1
    order: int

    def __post_init__(self) -> None:
        if self.order < 2:
            raise MechanicsError(f"a panel needs at least 2 nodes, got {self.order}")
        if (
            np.any(np.diff(self.edges) <= 0.0)
            or np.any(self.edges[..., 0] != 0.0)
            or np.any(self.edges[..., -1] != 1.0)
        ):
            raise MechanicsError("panel edges must rise from 0 to 1")

    @cached_property
    def nodes(self) -> Array:
        """(..., Q)"""
        x, _ = _gauss(self.order)
        h = np.diff(self.edges)
        s = self.edges[..., :-1, None] + 0.5 * h[..., None] * (x + 1.0)
        return np.asarray(s.reshape(*s.shape[:-2], -1))

    @cached_property
    def weights(self) -> Array:
        """(..., Q); they sum to 1."""
        _, w = _gauss(self.order)
        out = 0.5 * np.diff(self.edges)[..., None] * w
        return np.asarray(out.reshape(*out.shape[:-2], -1))

    def integral_to(self, s: Array) -> Array:
        """Rows R (..., S, Q) with `R @ f = int_0^s f` for `s` (..., S). Read-only."""
        s = np.asarray(s, dtype=float)
        if s.ndim == self.edges.ndim == 1 and len(s) <= _FEW_PLACES:
            return _remembered(_integral_to, s.tobytes(), self.edges.tobytes(), self.order)
        return _integral_to(s, self.edges, self.order)

    @property
    def integral_to_nodes(self) -> Array:
        """(..., Q, Q): B of `alpha = alpha0 + B q`."""
        return self.integral_to(self.nodes)

    def value_at(self, s: Array) -> Array:
        """Rows R (..., S, Q) with `R @ f` the values at `s` (S,). Read-only."""
        s = np.asarray(s, dtype=float)
        if self.edges.ndim == 1 and len(s) <= _FEW_PLACES:
            return _remembered(_value_at, s.tobytes(), self.edges.tobytes(), self.order)
        return _value_at(s, self.edges, self.order)

    def legendre_tail(self, f: Array) -> Array:
        """Share of the last two Legendre coefficients in f (..., Q), largest over the panels; 0 is resolved."""
        per_panel = f.reshape(*f.shape[:-1], -1, self.order)
        coefficients = np.abs(per_panel @ _to_legendre(self.order).T)
        largest = np.max(coefficients, axis=(-1, -2))
        tail = np.max(coefficients[..., -2:], axis=(-1, -2))
        return np.asarray(np.divide(tail, largest, out=np.zeros_like(tail), where=largest > 0.0))


def make_grid(breaks: tuple[float, ...] = (), *, order: int = 16, widest: float = 1.0) -> Grid:
    """Has an edge at each of `breaks`; no panel is wider than `widest`."""
    inner = sorted(b for b in breaks if _NARROWEST < b < 1.0 - _NARROWEST)
    edges = [0.0]
    for stop in [*inner, 1.0]:
        if stop - edges[-1] <= _NARROWEST:
            continue
        parts = int(np.ceil((stop - edges[-1]) / widest - 1e-9))
        edges.extend(np.linspace(edges[-1], stop, parts + 1)[1:].tolist())
    edges[-1] = 1.0
    return Grid(np.asarray(edges), order)


def apply(rows: Array, values: Array) -> Array:
    """rows (S, Q) or (T, S, Q) times values (Q,) or (T, Q)."""
    if rows.ndim == 2:
        return np.asarray(values @ rows.T)
    return np.asarray((rows @ values[..., None])[..., 0])


def transposed(matrix: Array) -> Array:
    return np.swapaxes(matrix, -1, -2)


def solve_each(matrices: Array, right: Array) -> Array:
    """(T, n, P) solutions of T systems; NaN if singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right))
    except np.linalg.LinAlgError:
        out = np.full_like(right, np.nan)
        for solution, matrix, side in zip(out, matrices, right, strict=True):
            with suppress(np.linalg.LinAlgError):
                solution[:] = np.linalg.solve(matrix, side)
        return out


@lru_cache(maxsize=32)
def _gauss(order: int) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(order)
    return np.asarray(x, dtype=float), np.asarray(w, dtype=float)


@lru_cache(maxsize=32)
def _to_legendre(order: int) -> Array:
    """(order, order): from values at the Gauss nodes to Legendre coefficients."""
    x, w = _gauss(order)
    degree = np.arange(order)
    return np.asarray((degree[:, None] + 0.5) * np.polynomial.legendre.legvander(x, order - 1).T * w)


@lru_cache(maxsize=64)
def _remembered(make: Callable[[Array, Array, int], Array], places: bytes, edges: bytes, order: int) -> Array:
    """Cached: the same places are asked for repeatedly."""
    rows = make(np.frombuffer(places), np.frombuffer(edges), order)
    rows.flags.writeable = False
    return rows


def _value_at(s: Array, edges: Array, order: int) -> Array:
    panels = edges.shape[-1] - 1
    panel = np.clip(np.sum(edges[..., None, :] < s[:, None], axis=-1) - 1, 0, panels - 1)  # (..., S)
    low = np.take_along_axis(edges, panel, axis=-1)
    x = 2.0 * (s - low) / np.take_along_axis(np.diff(edges), panel, axis=-1) - 1.0
    values = np.polynomial.legendre.legvander(x, order - 1) @ _to_legendre(order)
    rows = (panel[..., None] == np.arange(panels))[..., None] * values[..., None, :]
    return np.asarray(rows.reshape(*rows.shape[:-2], -1))


def _integral_to(s: Array, edges: Array, order: int) -> Array:
    h = np.diff(edges)  # (..., P)
    local = (s[..., :, None] - edges[..., None, :-1]) / h[..., None, :]  # (..., S, P), 0..1 inside
    rows = 0.5 * h[..., None, :, None] * _integral_rows(np.clip(local, 0.0, 1.0), order)
    return np.asarray(rows.reshape(*rows.shape[:-2], rows.shape[-2] * rows.shape[-1]))


def _integral_rows(local: Array, order: int) -> Array:
    """(..., order) `int_{-1}^{x} l_j dx` of the Lagrange polynomials at the Gauss nodes, x = 2 local - 1."""
    return np.asarray(_integrals(local, order) @ _to_legendre(order))


def _integrals(local: Array, count: int) -> Array:
    """(..., count) `int_{-1}^{x} P_k dx`, x = 2 local - 1."""
    p = np.polynomial.legendre.legvander(2.0 * local - 1.0, count)
    out = np.empty((*np.shape(local), count))
    out[..., 0] = 2.0 * local
    # (2k + 1) int_{-1}^{x} P_k = P_{k+1}(x) - P_{k-1}(x)
    out[..., 1:] = (p[..., 2:] - p[..., :-2]) / (2 * np.arange(1, count) + 1)
    return out


# Curvature modes `q(s) = sum_i theta_i phi_i(s)` (1), (2), and the shapes of their states (3), (4). The Legendre
# polynomials of 2 s - 1 span the same shapes as the paper's powers s^i, but the condition number of K is near 10
# instead of 1e10 (n = 8).

MOST_POWERS = 8
_GRID = make_grid(order=30)  # resolves cos(alpha) to machine precision


@dataclass(frozen=True)
class Modes:
    """n curvature modes: Legendre polynomials of 2 s - 1."""

    n: int

    def __post_init__(self) -> None:
        if self.n < 1:
            raise MechanicsError(f"at least one curvature mode is needed, got n = {self.n}")

    def curvature(self, s: Array) -> Array:
        """phi_i(s): `s.shape + (n,)`."""
        return np.asarray(np.polynomial.legendre.legvander(2.0 * np.asarray(s, dtype=float) - 1.0, self.n - 1))

    def angle(self, s: Array) -> Array:
        """Integral of phi_i from 0 to s (3): `s.shape + (n,)`."""
        return 0.5 * _integrals(np.asarray(s, dtype=float), self.n)


@lru_cache(maxsize=16)
def powers_to_legendre(n: int) -> Array:
    """(n, n): Legendre states of s^i in column i.

    Raises `MechanicsError` for more than `MOST_POWERS`, which double precision cannot separate.
    """
    if n > MOST_POWERS:
        raise MechanicsError(
            f"{n} powers of s cannot be told apart in double precision (the condition number of K passes "
            f"1e10 at n = {MOST_POWERS}); use Legendre polynomials, which span the same shapes"
        )
    out = np.zeros((n, n))
    for i in range(n):
        coefficients = np.polynomial.polynomial.polypow([0.5, 0.5], i)  # s = (1 + x) / 2
        out[: i + 1, i] = np.polynomial.legendre.poly2leg(coefficients)
    return out


@dataclass(frozen=True)
class Places:
    """Tables from states to poses at fixed places."""

    length: float  # m
    modes: Modes
    s: Array  # (S,)
    to_nodes: Array  # (Q, n): a_i at the nodes
    to_places: Array  # (S, n): a_i at s
    rows: Array  # (S, Q): integral from 0 to s


def places(length: float, modes: Modes, s: Array, grid: Grid = _GRID) -> Places:
    """For `s` (S,) on a beam of `length` m."""
    s = np.asarray(s, dtype=float)
    return Places(length, modes, s, modes.angle(grid.nodes), modes.angle(s), grid.integral_to(s))


def angles(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S) rad for states (T, n). Equation (3)."""
    return np.asarray(alpha0 + theta @ places.to_places.T)


def positions(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2) m for states (T, n). Equation (4)."""
    alpha = alpha0 + theta @ places.to_nodes.T
    return np.asarray(places.length * np.stack([np.cos(alpha) @ places.rows.T, np.sin(alpha) @ places.rows.T], axis=-1))


def jacobians(places: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2, n) m, d r(s) / d theta: `J_i(s) = L int_0^s (-sin alpha, cos alpha) a_i ds`."""
    alpha = alpha0 + theta @ places.to_nodes.T
    weighted = np.einsum("sq,qi->sqi", places.rows, places.to_nodes).reshape(len(places.s), alpha.shape[-1], -1)
    jx = -np.einsum("tq,sqi->tsi", np.sin(alpha), weighted, optimize=True)
    jy = np.einsum("tq,sqi->tsi", np.cos(alpha), weighted, optimize=True)
    return np.asarray(places.length * np.stack([jx, jy], axis=2))
