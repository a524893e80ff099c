"""The most probable values of a few unknowns, in many problems at once: Levenberg-Marquardt with normal priors.

With residuals r over the noise, their derivatives J with the unknowns in units of their priors' sds and z the unknowns
in these units, a step is `(A + d diag A) dz = J^T r - z`, `A = J^T J + I`; d grows until it lowers `r^2 + z^2`. An
unknown at a bound that it would pass stays there. The last step is so small that it is taken to first order. The
covariance of the unknowns is `A^-1` at the end (Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from onebend.records import Array, BoolArray, IntArray

_MOST_DAMPING = 1e8  # no step is left that lowers anything


@dataclass(frozen=True)
class Linearised:
    """B problems to first order about their unknowns."""

    residual: Array  # (B, R) measured less predicted, over the noise
    slopes: Array  # (B, R, d) of what is predicted, likewise
    feasible: BoolArray  # (B,) the problem has a solution here
    warm: Array  # (B, ...) from which a solution nearby is sought


Linearise = Callable[[IntArray, Array, Array], Linearised]  # some problems, about unknowns (B, d), from `warm` (B, ...)


@dataclass(frozen=True)
class SearchLimits:
    """When the search ends, and how far it goes at once."""

    steps: int = 40
    tolerance: float = 3e-3  # posterior sds: a step this small is the last: what is left is its square
    decrease: float = 0.0  # of the objective, relative: a step that lowers it by less is the last
    damping: float = 1e-6  # at first
    longest: Array | None = None  # (d,) of one step
    within: tuple[Array | float, Array | float] = (-np.inf, np.inf)  # (d,) each: lower and upper bounds


@dataclass(frozen=True)
class MostProbable:
    """B problems with d unknowns at the end of the search."""

    x: Array  # (B, d)
    sd: Array  # (d,) before the data
    at: Linearised
    objective: Array  # (B,) squared residuals and the prior's part; infinite where the problem has no solution
    converged: BoolArray  # (B,) the search ended because its last step was small, or none was left

    @classmethod
    def of(cls, at: Linearised, x: Array, mean: Array, sd: Array) -> MostProbable:
        """At `x` (B, d)."""
        objective = np.where(at.feasible, _objective(at.residual, (x - mean) / sd), np.inf)
        return cls(x, sd, at, objective, np.zeros(len(x), dtype=bool))

    @property
    def root(self) -> Array:
        """(B, d, d) R: the covariance of the unknowns is `R R^T`."""
        return self.sd[:, None] * np.linalg.inv(_with_prior(self.at.slopes * self.sd)[1])

    def by_residual(self, root: Array) -> Array:
        """(B, d, R) change of the unknowns with each residual; `root` as above."""
        return root @ np.swapaxes(self.at.slopes @ root, 1, 2)


def most_probable(
    linearise: Linearise, first: Linearised, x: Array, mean: Array, sd: Array, limits: SearchLimits = SearchLimits()
) -> MostProbable:
    """From unknowns `x` (B, d), about which the problems are `first`, with prior `mean` and `sd` (d,)."""
    begin = MostProbable.of(Linearised(*(values.copy() for values in vars(first).values())), x.copy(), mean, sd)
    x, at, objective = begin.x, begin.at, begin.objective
    rows, damping = np.flatnonzero(at.feasible), np.full(len(x), limits.damping)
    low, high = limits.within
    for _ in range(limits.steps):
        slopes, residual, z = at.slopes[rows] * sd, at.residual[rows], (x[rows] - mean) / sd
        down = np.einsum("brd,br->bd", slopes, residual) - z
        held = ((x[rows] <= low) & (down < 0.0)) | ((x[rows] >= high) & (down > 0.0))  # at a bound that it would pass
        step, size = _step(np.where(held[:, None], 0.0, slopes), residual, np.where(held, 0.0, z), damping[rows])
        step = sd * step
        if limits.longest is not None:
            times = np.maximum(np.max(np.abs(step / limits.longest), axis=1), 1.0)
            step, size = step / times[:, None], np.where(times > 1.0, np.inf, size)
        trial = np.clip(x[rows] + step, low, high)
        small = size < limits.tolerance
        last, rows, trial = (rows[small], trial[small]), rows[~small], trial[~small]
        if small.any():
            _move(begin, *last, mean)
        if not rows.size:
            break
        there = linearise(rows, trial, at.warm[rows])
        now = np.where(there.feasible, _objective(there.residual, (trial - mean) / sd), np.inf)
        better = now < objective[rows]
        won, slight = rows[better], better & ((1.0 + limits.decrease) * now > objective[rows])
        x[won], objective[won] = trial[better], now[better]
        for name, values in vars(at).items():
            values[won] = getattr(there, name)[better]
        damping[rows] = np.where(better, np.maximum(damping[rows] / 10.0, 1e-12), 10.0 * damping[rows])
        done = slight | (damping[rows] > _MOST_DAMPING)
        begin.converged[rows[done]] = True
        rows = rows[~done]
    return begin


def _move(found: MostProbable, rows: IntArray, x: Array, mean: Array) -> None:
    """Some problems to their unknowns `x` (B, d) nearby, to first order."""
    moved = found.at.slopes[rows] @ (x - found.x[rows])[..., None]
    found.at.residual[rows] -= moved[..., 0]
    found.x[rows], found.converged[rows] = x, True
    found.objective[rows] = _objective(found.at.residual[rows], (x - mean) / found.sd)


def _objective(residual: Array, z: Array) -> Array:
    return np.asarray(np.sum(residual**2, axis=1) + np.sum(z**2, axis=1))


def _with_prior(slopes: Array) -> tuple[Array, Array]:
    """Q (B, R + d, d) and R (B, d, d) of the slopes (B, R, d) with those of the priors below."""
    count = slopes.shape[2]
    return np.linalg.qr(np.concatenate([slopes, np.broadcast_to(np.eye(count), (len(slopes), count, count))], axis=1))


def _step(slopes: Array, residual: Array, z: Array, damping: Array) -> tuple[Array, Array]:
    """The step (B, d), and its size (B,) in posterior sds without damping."""
    side, corner = _with_prior(slopes)
    right = np.einsum("brd,br->bd", side, np.concatenate([residual, -z], axis=1))
    scale = np.sqrt(damping[:, None] * np.sum(corner**2, axis=1))
    side, damped = np.linalg.qr(np.concatenate([corner, scale[:, None] * np.eye(scale.shape[1])], axis=1))
    left = np.einsum("bed,be->bd", side[:, : scale.shape[1]], right)
    return np.linalg.solve(damped, left[..., None])[..., 0], np.sqrt(np.sum(right**2, axis=1))
