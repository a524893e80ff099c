"""Hyperparameters of log k's prior in the live learner: drawn from the same density as in `stiffness_prior.py`.

A few Markov chains run for as long as frames come. The posterior changes little from frame to frame, so a few steps of
the chains follow it. The last draws are kept. Given the hyperparameters log k is normal, so its mean and covariance
are averages over draws.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dpstrf, dtrtrs

from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.stiffness_prior import (
    RHO,
    SPREAD,
    STEP_DIRECTIONS,
    TAU,
    WIDE_SHARE,
    drawn_sizes,
    part_variances,
)
from onebend.learning.model.spline import Spline
from onebend.records import Array

_CHAINS = 2
_KEPT_STEPS = 20  # the last steps, whose draws are kept
_COPIES, _LEFT_OUT, _READ = 2, 5, 20  # for the band: copies of every chain, their burn-in and draws
_LEAST_INFORMATION = 1e-3  # of log k: directions with less are left out


@dataclass(frozen=True)
class _PartRows:
    """The data's information on log k's parts as rows: `values = on_parts @ parts + unit noise`."""

    on_parts: Array  # (r, n)
    values: Array  # (r,)


class StiffnessChains:
    """The chains and their last draws."""

    def __init__(self, spline: Spline, level: float, tau: float, rho: float) -> None:
        """`level`: prior mean of log k; `tau`, `rho`: first values of roughness and steps."""
        self._spline, self._level = spline, level
        self._rng = np.random.default_rng(0)
        self._logs = np.tile(np.log([tau, rho]), (_CHAINS, 1))
        self._own = np.ones((_CHAINS, len(spline.share)))
        self._expected = np.log([TAU, RHO])
        first = part_variances(spline, self._logs, self._own)[0]
        self._logs_drawn = np.tile(np.log(first), (_KEPT_STEPS, 1))  # (B KEPT, n) of the parts' variances
        self._next_draw = 0

    @property
    def parts(self) -> Array:
        """(n,) geometric means of the parts' variances over the kept draws: the prior for the estimate.

        A few draws of large steps would dominate the plain mean; under so wide a prior log k would follow every error
        of the first few frames.
        """
        return np.asarray(np.exp(np.mean(self._logs_drawn, axis=0)))

    def step(self, stiffness_form: InformationForm) -> None:
        """One step of every chain."""
        b = _CHAINS
        self._logs, self._own = self._moved(self._data(stiffness_form), self._logs, self._own, self._rng)
        self._logs_drawn[self._next_draw : self._next_draw + b] = np.log(
            part_variances(self._spline, self._logs, self._own)[0]
        )
        self._next_draw = (self._next_draw + b) % len(self._logs_drawn)

    def mixed(self, stiffness_form: InformationForm) -> tuple[Array, Array, Array]:
        """Mean (p,) and covariance (p, p) of log k averaged over fresh draws, and the mean steps (p - 1,).

        The kept draws are of earlier data. So copies of the chains make fresh draws; the chains themselves stay as they
        are, and reading a band changes nothing.
        """
        data, rng, drawn = self._data(stiffness_form), deepcopy(self._rng), []
        logs, own = np.repeat(self._logs, _COPIES, axis=0), np.repeat(self._own, _COPIES, axis=0)
        for i in range(_LEFT_OUT + _READ):
            logs, own = self._moved(data, logs, own, rng)
            if i >= _LEFT_OUT:
                drawn.append(part_variances(self._spline, logs, own)[0])
        return self._averaged(data, np.concatenate(drawn))

    def _averaged(self, data: _PartRows, drawn: Array) -> tuple[Array, Array, Array]:
        """`mixed` over parts of these variances (D, n)."""
        weights, count = self._spline.parts, self._spline.count
        across = data.on_parts * drawn[:, None]  # (D, r, n)
        root = np.linalg.cholesky(across @ data.on_parts.T + np.eye(len(data.values)))
        half = np.linalg.solve(root, across)
        away = np.linalg.solve(root, np.broadcast_to(data.values[:, None], (*root.shape[:2], 1)))
        parts = (np.swapaxes(half, 1, 2) @ away)[..., 0]  # (D, n)
        means, half = parts @ weights.T, (half @ weights.T).reshape(-1, count)
        mean, draws = np.mean(means, axis=0), len(drawn)
        out = (weights * np.mean(drawn, axis=0)) @ weights.T - half.T @ half / draws
        out += (means - mean).T @ (means - mean) / draws
        return mean + self._level, 0.5 * (out + out.T), np.mean(parts, axis=0)[count : 2 * count - 1]

    def _moved(self, data: _PartRows, logs: Array, own: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """One step of chains at sizes (B, 2) and (B, 2 p - 1)."""
        b = len(logs)
        stride = np.where(rng.random((b, 1)) < WIDE_SHARE, 1.5, 0.5) * SPREAD
        tried = logs + STEP_DIRECTIONS[rng.integers(0, 3, b)] * stride * rng.standard_normal((b, 2))
        both = np.concatenate([logs, tried])
        variance, capped = part_variances(self._spline, both, np.concatenate([own, own]))
        factors, value = self._density(both, capped, variance, data)
        taken = np.log(rng.random(b)) < value[b:] - value[:b]
        chosen = np.where(taken, np.arange(b, 2 * b), np.arange(b))
        local = self._local(variance[chosen], [factors[i] for i in chosen.tolist()], data, rng)
        return both[chosen], drawn_sizes(self._spline, both[chosen], local, rng)

    def _data(self, stiffness_form: InformationForm) -> _PartRows:
        """The information form as rows on log k less its level, one for each direction with information."""
        lower, order, rank, _ = dpstrf(stiffness_form.matrix, tol=_LEAST_INFORMATION, lower=1)
        if rank == 0:
            return _PartRows(np.zeros((1, self._spline.parts.shape[1])), np.zeros(1))
        order, right = order - 1, stiffness_form.vector - self._level * np.sum(stiffness_form.matrix, axis=1)
        values, _ = dtrtrs(lower[:rank, :rank], right[order[:rank]], lower=1)
        rows = np.zeros((rank, len(order)))
        rows[:, order] = np.tril(lower[:, :rank]).T
        return _PartRows(rows @ self._spline.parts, values)

    def _density(self, logs: Array, capped: Array, variance: Array, data: _PartRows) -> tuple[list[Array], Array]:
        """Factors of the data's covariances, and the log densities of the sizes (B,), log k integrated out."""
        spread = (data.on_parts * variance[:, None]) @ data.on_parts.T
        spread.reshape(len(spread), -1)[:, :: len(data.values) + 1] += 1.0
        value = -0.5 * np.sum(np.log1p(capped), axis=1)
        value -= 0.5 * np.sum(((logs - self._expected) / SPREAD) ** 2, axis=1)
        factors = []
        for i, covariance in enumerate(spread):
            root, _ = dpotrf(covariance, lower=1)
            white, _ = dtrtrs(root, data.values, lower=1)
            value[i] -= np.sum(np.log(np.diag(root))) + 0.5 * (white @ white)
            factors.append(root)
        return factors, value

    def _local(self, variance: Array, factors: list[Array], data: _PartRows, rng: np.random.Generator) -> Array:
        """(B, 2 p - 1) steps and bumps from their posterior at these sizes: a draw from the prior, corrected by its
        residual."""
        drawn = np.sqrt(variance) * rng.standard_normal(variance.shape)
        missed = data.values - drawn @ data.on_parts.T - rng.standard_normal((len(factors), len(data.values)))
        pull = np.stack([dpotrs(root, residual, lower=1)[0] for root, residual in zip(factors, missed, strict=True)])
        steps = slice(self._spline.count, None)
        return np.asarray(drawn[:, steps] + variance[:, steps] * (pull @ data.on_parts[:, steps]))
