"""Inverse kinematics (22): modal states of every frame from the tags' positions and angles.

Levenberg-Marquardt on all frames at once. Each tag counts by its covariance; a missing tag counts nothing. Where a
frame has fewer data than states, the shape of least curvature among those that fit is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.modal import Modes, Places, angles, jacobians, places, positions
from onebend.errors import LearningError
from onebend.learning.model.frames import whitening
from onebend.learning.model.rest import AtRest, at_rest, beam_points
from onebend.records import Array, BoolArray, Observations, covariance_with_camera

_LEAST_CURVATURE = 1e-3  # weight of the curvature energy against whitened data (a prior sd of about 30 rad)


@dataclass(frozen=True)
class States:
    """Legendre states of every frame; NaN where a frame has no tag."""

    modes: Modes
    theta: Array  # (T, n) rad
    covariance: Array  # (T, n, n) rad^2, from the tags' covariances
    theta0: Array  # (n,) rad, at rest
    rest: AtRest
    data: Array  # (T,) measured numbers in the frame (3 a tag, or 2 without angles)
    converged: BoolArray  # (T,)


def solve_states(
    observations: Observations, n: int, *, with_angles: bool = True, rest: AtRest | None = None, most: int = 40
) -> States:
    """States of n Legendre modes for all T frames.

    Raises:
        LearningError: n is more than the tags can tell (3 a tag, 2 a tag without angles).
    """
    tags = len(observations.marker_s)
    limit = (3 if with_angles else 2) * tags
    if not 1 <= n <= limit:
        raise LearningError(f"n = {n} curvature modes, but {tags} tags can tell at most {limit}; choose n <= {limit}")
    rest = at_rest(observations) if rest is None else rest
    xy, tangent = beam_points(observations, rest)
    measured = np.concatenate([xy, tangent[..., None]], axis=-1)  # (T, m, 3)
    whiten, data = _whitening(measured, covariance_with_camera(observations), with_angles)
    target = np.where(np.isfinite(measured), measured, 0.0)
    at = places(observations.length, Modes(n), observations.marker_s)
    theta, converged = _levenberg(at, target, whiten, _start(at, target, data > 0, whiten), most)
    jacobian = _whitened(whiten, _jacobian(at, theta))
    information = np.swapaxes(jacobian, 1, 2) @ jacobian + np.diag(_energy(n))
    seen = np.any(data > 0, axis=1)
    theta[~seen] = np.nan
    return States(
        modes=Modes(n),
        theta=theta,
        covariance=np.asarray(np.linalg.inv(information)),
        theta0=rest.states(n),
        rest=rest,
        data=np.sum(data, axis=1),
        converged=converged & seen,
    )


def _whitening(measured: Array, covariance: Array, with_angles: bool) -> tuple[Array, Array]:
    """Inverse Cholesky factors (T, m, 3, 3), zero where a number is missing, and the count of numbers (T, m)."""
    if not with_angles:
        measured = measured * np.array([1.0, 1.0, np.nan])
    whiten = whitening(measured, covariance)
    return whiten, np.asarray(np.sum(np.any(whiten != 0.0, axis=-1), axis=-1, dtype=float))


def _start(at: Places, target: Array, seen: BoolArray, whiten: Array) -> Array:
    """A first guess from angles: of the tags where used, of the chords between neighbouring tags otherwise.

    theta = 0 is a singular start (no curvature direction is preferred by positions on a straight beam).
    """
    if np.any(whiten[..., 2, 2] > 0.0):
        rows, values = at.to_places, target[..., 2]
    else:
        s = np.concatenate([[0.0], at.s])
        steps = np.diff(target[..., :2], axis=1, prepend=np.zeros((len(target), 1, 2)))
        values = np.unwrap(np.arctan2(steps[..., 1], steps[..., 0]), axis=1)
        rows = at.modes.angle(0.5 * (s[1:] + s[:-1]))
    weight = seen.astype(float)
    normal = np.einsum("tm,mi,mj->tij", weight, rows, rows) + 1e-3 * np.eye(at.modes.n)
    return np.asarray(np.linalg.solve(normal, np.einsum("tm,mi,tm->ti", weight, rows, values)[..., None])[..., 0])


def _levenberg(at: Places, target: Array, whiten: Array, theta: Array, most: int) -> tuple[Array, BoolArray]:
    """Batched damped Gauss-Newton; each frame has its own damping."""
    damping = np.full(len(theta), 1e-3)
    residual = _residual(at, target, whiten, theta)
    cost = _cost(residual, theta)
    converged = np.zeros(len(theta), dtype=bool)
    for _ in range(most):
        todo = np.flatnonzero(~converged)
        if todo.size == 0:
            break
        jacobian = _whitened(whiten[todo], _jacobian(at, theta[todo]))
        step = _damped_step(jacobian, residual[todo], theta[todo], damping[todo])
        tried = theta[todo] + step
        new_residual = _residual(at, target[todo], whiten[todo], tried)
        new_cost = _cost(new_residual, tried)
        better = new_cost <= cost[todo] * (1.0 + 1e-14)
        theta[todo[better]] = tried[better]
        residual[todo[better]] = new_residual[better]
        cost[todo[better]] = new_cost[better]
        damping[todo] = np.clip(np.where(better, damping[todo] / 10.0, damping[todo] * 10.0), 1e-12, 1e12)
        small = np.max(np.abs(step), axis=1) < 1e-10 * (1.0 + np.max(np.abs(theta[todo]), axis=1))
        converged[todo] = small | (damping[todo] >= 1e12)
    return theta, converged


def _damped_step(jacobian: Array, residual: Array, theta: Array, damping: Array) -> Array:
    """Step of min |J d - r|^2 + small |theta + d|^2 + damping |D d|^2, by QR of the stacked rows."""
    count, rows, n = jacobian.shape
    energy = np.sqrt(_energy(n))
    scale = np.sqrt(np.sum(jacobian**2, axis=1) + energy**2)  # (T, n)
    stacked = np.zeros((count, rows + 2 * n, n))
    stacked[:, :rows] = jacobian
    diagonal = np.arange(n)
    stacked[:, rows + diagonal, diagonal] = energy
    stacked[:, rows + n + diagonal, diagonal] = np.sqrt(damping)[:, None] * scale
    right = np.concatenate([residual, -energy * theta, np.zeros((count, n))], axis=1)
    q, r = np.linalg.qr(stacked)
    return np.asarray(np.linalg.solve(r, np.einsum("tri,tr->ti", q, right)[..., None])[..., 0])


def _residual(at: Places, target: Array, whiten: Array, theta: Array) -> Array:
    """(T, 3 m) whitened measured minus modelled poses."""
    model = np.concatenate([positions(at, theta), angles(at, theta)[..., None]], axis=-1)
    return np.asarray(np.einsum("tmab,tmb->tma", whiten, target - model).reshape(len(theta), -1))


def _jacobian(at: Places, theta: Array) -> Array:
    """(T, m, 3, n) of positions and angles."""
    turn = np.broadcast_to(at.to_places[None, :, None, :], (len(theta), len(at.s), 1, at.modes.n))
    return np.concatenate([jacobians(at, theta), turn], axis=2)


def _whitened(whiten: Array, jacobian: Array) -> Array:
    """(T, 3 m, n)."""
    return (whiten @ jacobian).reshape(len(jacobian), -1, jacobian.shape[-1])


def _cost(residual: Array, theta: Array) -> Array:
    return np.asarray(np.sum(residual**2, axis=1) + theta**2 @ _energy(theta.shape[1]))


def _energy(n: int) -> Array:
    """(n,) weights of `int q^2 = sum theta_i^2 / (2 i + 1)` (Legendre states)."""
    return np.asarray(_LEAST_CURVATURE / (2.0 * np.arange(n) + 1.0))
