"""The paper's regression (12)-(18): `X gamma = Y`, linear in the coefficients gamma of k(s).

For frame t and test function phi_j, with the curvature's departure from rest q - q0 (the paper's beams have q0 = 0):

    sum_w gamma_w int Pi_w (q - q0) phi_j ds = (J(s_a)^T F)_j  (+ the weight's share)

Solved by an orthogonal decomposition, never by normal equations. The rows are those of the test functions: the
paper's are the powers of s, unweighted, which is part of its method (under noise the answer depends on the basis). As
an improvement the rows of a frame can be weighted by what noise does to them: an error in theta moves them by the
tangent of the equilibrium, one in F by J^T.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.beam.grid import apply, make_grid
from onebend.beam.modal import Modes
from onebend.beam.profiles.stiffness import Gaussians, Powers, Profile, equidistant, gaussian_basis, power_basis
from onebend.errors import LearningError
from onebend.learning.model.frames import mass_profile, push_places
from onebend.learning.model.mass import NEEDS_MASS, weighs
from onebend.learning.paper.inverse_kinematics import States
from onebend.records import Array, BoolArray, Observations

Family = Literal["gaussians", "powers"]
_GRID = make_grid(order=32)
_ROUNDING = 1e-9  # of a spectrum that adds up to the number of rows: below lies rounding, not knowledge


@dataclass(frozen=True)
class MomentRows:
    """Rows of `X gamma = Y` before a family is chosen; Q nodes on the beam, test functions in Legendre form."""

    elastic: Array  # (T, n, Q): weight times (q - q0) phi_j at the nodes; X = elastic @ Pi
    load: Array  # (T, n): Y
    load_per_force: Array  # (T, n, 2): J(s_a)
    geometric: Array  # (T, n, n): the load's part of the equilibrium's tangent
    states: States


def assemble(observations: Observations, states: States) -> MomentRows:
    """Rows of all T frames (NaN where a frame has no states). Equations (9)-(11)."""
    grid, modes, length = _GRID, states.modes, observations.length
    phi, a = modes.curvature(grid.nodes), modes.angle(grid.nodes)  # (Q, n)
    q = (states.theta - states.theta0) @ phi.T
    elastic = (grid.weights * q)[:, None, :] * phi.T
    alpha = states.theta @ a.T
    u = np.stack([np.cos(alpha), np.sin(alpha)], axis=-1)  # (T, Q, 2)
    across = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    to_push = grid.integral_to(push_places(observations)[:, None])[:, 0]  # (T, Q)
    load_per_force = length * np.einsum("tq,tqc,qi->tic", to_push, across, a, optimize=True)
    beyond = _weight_beyond(observations)  # (T, Q, 2)
    load = np.einsum("tic,tc->ti", load_per_force, observations.force)
    load = load + length * np.einsum("tqc,tqc,qi->ti", grid.weights[:, None] * beyond, across, a, optimize=True)
    along = to_push * np.einsum("tqc,tc->tq", u, observations.force)
    along = along + grid.weights * np.einsum("tqc,tqc->tq", u, beyond)
    geometric = length * np.einsum("tq,qi,qj->tij", along, a, a, optimize=True)
    return MomentRows(elastic, load, load_per_force, geometric, states)


def basis(family: Family, m: int, width: float | None) -> tuple[Array, float]:
    """Functions Pi_w at the nodes (Q, m), and the Gaussians' width (the distance of their centres if not given)."""
    if family == "powers":
        return power_basis(_GRID.nodes, m), np.nan
    sigma = (1.0 / max(m - 1, 1)) if width is None else width
    return gaussian_basis(_GRID.nodes, equidistant(m), sigma), sigma


def profile(family: Family, coefficients: Array, sigma: float) -> Profile:
    """k(s) of the coefficients."""
    gamma = tuple(float(c) for c in coefficients)
    return Powers(gamma) if family == "powers" else Gaussians(equidistant(len(gamma)), sigma, gamma)


def literal(rows: MomentRows, use: BoolArray, pi: Array) -> tuple[Array, float]:
    """gamma (m,) of (18) with the paper's rows: powers as test functions, no weights; and the condition of X."""
    return _orthogonal(*literal_rows(rows, use, pi))


def literal_rows(rows: MomentRows, use: BoolArray, pi: Array) -> tuple[Array, Array]:
    """X (R, m) and Y (R,) as the paper writes them, with powers of s as test functions; n rows a frame."""
    to_legendre = Modes(rows.states.modes.n, "powers").to_legendre
    x = np.einsum("lj,tlq,qw->tjw", to_legendre, rows.elastic[use], pi, optimize=True).reshape(-1, pi.shape[1])
    return x, (rows.load[use] @ to_legendre).ravel()


def weighted(
    rows: MomentRows, use: BoolArray, pi: Array, *, force_sd: Array, tag_noise: float = 1.0, rounds: int = 8
) -> tuple[Array, float]:
    """gamma (m,) with each frame's rows weighted by the covariance that noise gives them; and the condition of X.

    The covariance depends on gamma through the tangent, so a few rounds of reweighting are made from a start that
    uses the load's noise alone. `tag_noise` scales the states' covariance.
    """
    elastic, load = rows.elastic[use] @ pi, rows.load[use]
    jacobian, geometric = rows.load_per_force[use], rows.geometric[use]
    spread = tag_noise**2 * rows.states.covariance[use]
    phi = rows.states.modes.curvature(_GRID.nodes)
    from_force = (jacobian * force_sd**2) @ np.swapaxes(jacobian, 1, 2)
    gamma, condition = _orthogonal(elastic.reshape(-1, pi.shape[1]), load.ravel())
    for _ in range(rounds):
        k = np.maximum(pi @ gamma, 0.05 * np.mean(np.abs(pi @ gamma)))  # weights need a positive stiffness
        tangent = (phi.T * (_GRID.weights * k)) @ phi + geometric
        covariance = tangent @ spread @ np.swapaxes(tangent, 1, 2) + from_force
        sd = np.sqrt(np.einsum("tii->ti", covariance))
        # Rows are brought to one scale first: their variances differ by ten orders and more.
        whiten = _whitening(covariance / (sd[:, :, None] * sd[:, None, :])) / sd[:, None, :]
        x = (whiten @ elastic).reshape(-1, pi.shape[1])
        y = (whiten @ load[..., None]).ravel()
        previous = gamma
        gamma, condition = _orthogonal(x, y)
        if np.max(np.abs(gamma - previous)) < 1e-9 * np.max(np.abs(gamma)):
            break
    return gamma, condition


def _whitening(correlation: Array) -> Array:
    """(T, n, n) W: `W' W` is the inverse of each correlation matrix (T, n, n), whose spectrum begins at `_ROUNDING`.

    A Cholesky factor takes an eighth of the time of a spectrum, and says where that is needed: the sum of the inverse
    spectrum is the sum of the inverse factor's squares.
    """
    try:
        whiten = np.linalg.inv(np.linalg.cholesky(correlation))
    except np.linalg.LinAlgError:
        return _floored(correlation)
    low = ~(np.einsum("tij,tij->t", whiten, whiten) < 1.0 / _ROUNDING)
    if low.any():
        whiten[low] = _floored(correlation[low])
    return np.asarray(whiten)


def _floored(correlation: Array) -> Array:
    """As `_whitening`, by the spectra."""
    spectrum, vectors = np.linalg.eigh(correlation)
    return np.asarray(np.swapaxes(vectors / np.sqrt(np.maximum(spectrum, _ROUNDING))[:, None, :], 1, 2))


def _orthogonal(x: Array, y: Array) -> tuple[Array, float]:
    """Least squares by singular values with scaled columns; the condition number is that of the scaled matrix."""
    if not np.all(np.linalg.norm(x, axis=0) > 0.0):
        raise LearningError("a stiffness function meets no curvature at all: the beam did not bend there in any frame")
    solution, singular = least_squares(x, y)
    return solution, float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf


def column_sizes(x: Array) -> Array:
    """(m,) what each column is divided by before it is solved for; 1 for one of zeros."""
    sizes = np.linalg.norm(x, axis=0)
    return np.where(sizes > 0.0, sizes, 1.0)


def least_squares(x: Array, y: Array) -> tuple[Array, Array]:
    """Solution (m,) with columns brought to one size, and the singular values of the matrix so scaled."""
    scale = column_sizes(x)
    solution, _, _, singular = np.linalg.lstsq(x / scale, y, rcond=None)
    return np.asarray(solution / scale), np.asarray(singular)


def _weight_beyond(observations: Observations) -> Array:
    """(T, Q, 2) N: the weight of the beam beyond each node, its mass spread as it is written down."""
    if not weighs(observations):
        return np.zeros((len(observations.time), len(_GRID.nodes), 2))
    if not np.isfinite(observations.stated.mass):
        raise LearningError(f"{observations.source.name}: {NEEDS_MASS}")
    line = observations.length * np.asarray(mass_profile(observations)(_GRID.nodes))
    beyond = _GRID.weights @ line - apply(_GRID.integral_to_nodes, line)
    for one in observations.stated.masses:
        beyond = beyond + one.mass * (_GRID.nodes < one.s)
    return np.asarray(beyond[None, :, None] * observations.gravity[:, None, :])
