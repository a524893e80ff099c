"""The sizes in log k's prior, drawn frame by frame from their posterior: the same density as in `stiffness_prior.py`.

A few chains go on for as long as frames come. What the data say changes little from frame to frame, so that a step of
every chain at a time keeps up with it. The last draws are kept: given the sizes log k is normal, so its mean and
covariance are averages over them.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dpstrf, dtrtrs

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
_KEPT = 20  # steps whose draws are kept
_COPIES, _LEFT_OUT, _READ = 2, 5, 20  # of every chain, where the band is read, and their steps
_TOLD = 1e-3  # information of log k: directions of which no more is told are left out


@dataclass(frozen=True)
class OfK:
    """What is known of log k beside its prior, all else integrated out: `-2 log p = c' H c - 2 b' c`."""

    information: Array  # (p, p)
    b: Array  # (p,)


@dataclass(frozen=True)
class _Data:
    """What the data say of log k's parts: `seen = on_parts @ parts + unit noise`."""

    on_parts: Array  # (r, n)
    seen: Array  # (r,)


class Sizes:
    """Chains, and their last draws."""

    def __init__(self, spline: Spline, level: float, tau: float, rho: float) -> None:
        """`level`: prior mean of log k; `tau`, `rho`: where roughness and steps begin."""
        self._spline, self._level = spline, level
        self._rng = np.random.default_rng(0)
        self._logs = np.tile(np.log([tau, rho]), (_CHAINS, 1))
        self._own = np.ones((_CHAINS, len(spline.share)))
        self._expected = np.log([TAU, RHO])
        first = part_variances(spline, self._logs, self._own)[0]
        self._logs_drawn = np.tile(np.log(first), (_KEPT, 1))  # (B KEPT, n) of the parts' variances
        self._at = 0

    @property
    def parts(self) -> Array:
        """(n,) usual variances of the parts, by their mean logs: the prior under which the estimate moves.

        A few draws of large steps make the plain mean so large that, of the few frames of a push that begins, log k
        would follow every error.
        """
        return np.asarray(np.exp(np.mean(self._logs_drawn, axis=0)))

    def step(self, told: OfK) -> None:
        """One step of every chain."""
        b = _CHAINS
        self._logs, self._own = self._moved(self._data(told), self._logs, self._own, self._rng)
        self._logs_drawn[self._at : self._at + b] = np.log(part_variances(self._spline, self._logs, self._own)[0])
        self._at = (self._at + b) % len(self._logs_drawn)

    def mixed(self, told: OfK) -> tuple[Array, Array, Array]:
        """Mean (p,) and covariance (p, p) of log k averaged over fresh draws, and the mean steps (p - 1,).

        The kept draws lag behind: they are of less data. So copies of the chains go on from where these stand, which
        stay there: reading changes nothing.
        """
        data, rng, drawn = self._data(told), deepcopy(self._rng), []
        logs, own = np.repeat(self._logs, _COPIES, axis=0), np.repeat(self._own, _COPIES, axis=0)
        for i in range(_LEFT_OUT + _READ):
            logs, own = self._moved(data, logs, own, rng)
            if i >= _LEFT_OUT:
                drawn.append(part_variances(self._spline, logs, own)[0])
        return self._averaged(data, np.concatenate(drawn))

    def _averaged(self, data: _Data, drawn: Array) -> tuple[Array, Array, Array]:
        """`mixed` over parts of these variances (D, n)."""
        weights, count = self._spline.parts, self._spline.count
        across = data.on_parts * drawn[:, None]  # (D, r, n)
        root = np.linalg.cholesky(across @ data.on_parts.T + np.eye(len(data.seen)))
        half = np.linalg.solve(root, across)
        away = np.linalg.solve(root, np.broadcast_to(data.seen[:, None], (*root.shape[:2], 1)))
        parts = (np.swapaxes(half, 1, 2) @ away)[..., 0]  # (D, n)
        means, half = parts @ weights.T, (half @ weights.T).reshape(-1, count)
        mean, draws = np.mean(means, axis=0), len(drawn)
        out = (weights * np.mean(drawn, axis=0)) @ weights.T - half.T @ half / draws
        out += (means - mean).T @ (means - mean) / draws
        return mean + self._level, 0.5 * (out + out.T), np.mean(parts, axis=0)[count : 2 * count - 1]

    def _moved(self, data: _Data, logs: Array, own: Array, rng: np.random.Generator) -> tuple[Array, Array]:
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

    def _data(self, told: OfK) -> _Data:
        """What the data say, as rows of unit noise on log k less its level: as many as they tell of directions."""
        lower, order, rank, _ = dpstrf(told.information, tol=_TOLD, lower=1)
        if rank == 0:
            return _Data(np.zeros((1, self._spline.parts.shape[1])), np.zeros(1))
        order, right = order - 1, told.b - self._level * np.sum(told.information, axis=1)
        seen, _ = dtrtrs(lower[:rank, :rank], right[order[:rank]], lower=1)
        rows = np.zeros((rank, len(order)))
        rows[:, order] = np.tril(lower[:, :rank]).T
        return _Data(rows @ self._spline.parts, seen)

    def _density(self, logs: Array, capped: Array, variance: Array, data: _Data) -> tuple[list[Array], Array]:
        """Factors of the data's covariances, and the log densities of the sizes (B,), log k integrated out."""
        spread = (data.on_parts * variance[:, None]) @ data.on_parts.T
        spread.reshape(len(spread), -1)[:, :: len(data.seen) + 1] += 1.0
        value = -0.5 * np.sum(np.log1p(capped), axis=1)
        value -= 0.5 * np.sum(((logs - self._expected) / SPREAD) ** 2, axis=1)
        factors = []
        for i, one in enumerate(spread):
            root, _ = dpotrf(one, lower=1)
            white, _ = dtrtrs(root, data.seen, lower=1)
            value[i] -= np.sum(np.log(np.diag(root))) + 0.5 * (white @ white)
            factors.append(root)
        return factors, value

    def _local(self, variance: Array, factors: list[Array], data: _Data, rng: np.random.Generator) -> Array:
        """(B, 2 p - 1) steps and bumps from their posterior at these sizes: a draw from the prior, corrected by what it
        misses."""
        drawn = np.sqrt(variance) * rng.standard_normal(variance.shape)
        missed = data.seen - drawn @ data.on_parts.T - rng.standard_normal((len(factors), len(data.seen)))
        pull = np.stack([dpotrs(root, one, lower=1)[0] for root, one in zip(factors, missed, strict=True)])
        steps = slice(self._spline.count, None)
        return np.asarray(drawn[:, steps] + variance[:, steps] * (pull @ data.on_parts[:, steps]))
