"""From modal states to positions and their derivatives, on fixed nodes: (3), (4) and the Jacobian of (10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.beam.modes import Modes
from onebend.records import Array

_GRID = make_grid(order=30)  # resolves cos(alpha) of physical shapes to machine precision


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


def angles(at: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S) rad, tangent's angle for states (T, n). Equation (3)."""
    return np.asarray(alpha0 + theta @ at.to_places.T)


def positions(at: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2) m for states (T, n). Equation (4)."""
    alpha = alpha0 + theta @ at.to_nodes.T
    return np.asarray(at.length * np.stack([np.cos(alpha) @ at.rows.T, np.sin(alpha) @ at.rows.T], axis=-1))


def jacobians(at: Places, theta: Array, alpha0: float = 0.0) -> Array:
    """(T, S, 2, n) m, d r(s) / d theta: `J_i(v) = L int_0^v (-sin alpha, cos alpha) a_i ds`."""
    alpha = alpha0 + theta @ at.to_nodes.T
    weighted = np.einsum("sq,qi->sqi", at.rows, at.to_nodes).reshape(len(at.s), alpha.shape[-1], -1)
    jx = -np.einsum("tq,sqi->tsi", np.sin(alpha), weighted, optimize=True)
    jy = np.einsum("tq,sqi->tsi", np.cos(alpha), weighted, optimize=True)
    return np.asarray(at.length * np.stack([jx, jy], axis=2))
