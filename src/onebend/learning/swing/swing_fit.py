"""Least squares between a film of a free swing and the simulated motion, and how sure its result is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import MechanicsError
from onebend.learning.swing.free_swing import shortened
from onebend.learning.swing.swing_motion import SwingProblem, predict
from onebend.progress import Progress
from onebend.recording.signals import MAD_TO_SD
from onebend.records import Array

_ROUNDS, _ENOUGH = 25, 1e-3  # of Gauss-Newton; the step in sd at which it stops
_HUBER = 3.0  # scaled sd beyond which a residual counts linearly
_BOLD = 0.7  # the most that the logarithms of loss time and factor change in a step


@dataclass(frozen=True)
class Fitted:
    """Where the search ended."""

    x: Array
    covariance: Array
    predicted: Array  # (T, m, 3)
    moved: bool  # still, when the rounds were used up


def fit_swing(problem: SwingProblem, x: Array, progress: Progress) -> Fitted:
    """Gauss-Newton on the first three swings, then on all."""
    omega = float(np.sqrt(problem.about.squared[0] * np.exp(x[1])))
    near = shortened(problem.swing, 6.0 * np.pi / omega)
    progress.start("fitting the swing", None)
    try:
        x = _search(replace(problem, swing=near), x, progress).x
        return _search(problem, x, progress)
    finally:
        progress.done()


def _search(problem: SwingProblem, x: Array, progress: Progress) -> Fitted:
    """Least squares with Huber's weights, a step halved where it does not lower the cost."""
    left = _residual(problem, predict(problem, x))
    moved = True
    for _ in range(_ROUNDS):
        scale = _scale(left)
        weights = np.sqrt(np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(left), 1e-300)))
        slope = _slope(problem, x, left)
        rows = np.concatenate([weights[:, None] * slope, _prior_rows(problem, scale)])
        right = np.concatenate([-weights * left, -_prior_rows(problem, scale) @ x])
        step = np.linalg.lstsq(rows, right, rcond=None)[0]
        x, left, share = _stepped(problem, x, step, left, scale)
        progress.advance()
        sd = scale * np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))
        moved = bool(np.any(np.abs(share * step) > _ENOUGH * sd)) and share > 0.0
        if not moved:
            break
    return Fitted(x, _covariance(problem, rows, weights * left, scale), predict(problem, x), moved)


def _stepped(problem: SwingProblem, x: Array, step: Array, left: Array, scale: float) -> tuple[Array, Array, float]:
    """The new parameters and residuals, and the share of the step that was taken (0: none lowers the cost)."""
    before = _cost(left, x, scale)
    share = min(1.0, _BOLD / max(float(np.abs(step[:2]).max()), 1e-300))
    for _ in range(8):
        tried = x + share * step
        try:
            found = _residual(problem, predict(problem, tried))
        except MechanicsError:
            found = np.full_like(left, np.inf)
        if _cost(found, tried, scale) < before:
            return tried, found, share
        share *= 0.5
    return x, left, 0.0


def _cost(left: Array, x: Array, scale: float) -> float:
    """Huber's, with the prior of the start."""
    size = np.abs(left) / scale
    spread = np.where(size < _HUBER, 0.5 * size**2, _HUBER * size - 0.5 * _HUBER**2)
    return float(np.sum(spread) + 0.5 * np.sum(x[2:] ** 2))


def _prior_rows(problem: SwingProblem, scale: float) -> Array:
    """Each mode starts with no more than the whole swing (one sd)."""
    rows = scale * np.eye(problem.unknown)
    return rows[2:]


def _residual(problem: SwingProblem, predicted: Array) -> Array:
    """(R,) whitened, of all that was seen."""
    away = np.nan_to_num(predicted - problem.swing.seen)
    whitened = np.einsum("tmij,tmj->tmi", problem.swing.whiten, away)
    return np.asarray(whitened[np.isfinite(problem.swing.seen)])


def _slope(problem: SwingProblem, x: Array, left: Array) -> Array:
    """(R, p) by differences; the simulation's own error is far below the step's effect."""
    out = np.empty((len(left), len(x)))
    for i in range(len(x)):
        moved = x.copy()
        moved[i] += 1e-4
        out[:, i] = (_residual(problem, predict(problem, moved)) - left) / 1e-4
    return out


def _scale(left: Array) -> float:
    """Spread of the residuals in sd of the tags' noise, at least a tenth of it."""
    return max(MAD_TO_SD * float(np.median(np.abs(left))), 0.1)


def _covariance(problem: SwingProblem, rows: Array, left: Array, scale: float) -> Array:
    """(p, p): residuals summed over half swings; no smaller than what their size alone gives."""
    bread = np.linalg.pinv(rows.T @ rows)
    period = 2.0 * np.pi / np.sqrt(problem.about.squared[0])
    there = np.isfinite(problem.swing.seen)
    when = np.broadcast_to(problem.swing.time[:, None, None], there.shape)[there]
    block = (when / (0.5 * period)).astype(int)
    scores = np.zeros((block.max() + 1, rows.shape[1]))
    np.add.at(scores, block, rows[: len(left)] * left[:, None])
    count = len(np.unique(block))
    blocks = bread @ (scores.T @ scores) @ bread * count / max(count - 2, 1)
    plain = scale**2 * bread
    grown = np.maximum(np.sqrt(np.diag(blocks) / np.diag(plain)), 1.0)
    return np.asarray(grown[:, None] * plain * grown)
