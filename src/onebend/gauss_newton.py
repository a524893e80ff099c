"""The most probable values of a few unknowns, in many problems at once: Levenberg-Marquardt with normal priors.

With residuals r over the noise, their derivatives J with the unknowns in units of their priors' sds and z the unknowns
in these units, a step is `(A + d diag A) dz = J^T r - z`, `A = J^T J + I`; d grows until it lowers `r^2 + z^2`. The
covariance of the unknowns is `A^-1` at the end (Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from onebend.records import Array, BoolArray, IntArray

_MOST_DAMPING = 1e8  # no step is left that lowers anything


@dataclass(frozen=True)
class Outlook:
    """B problems at their unknowns."""

    residual: Array  # (B, R) measured less predicted, over the noise
    slopes: Array  # (B, R, d) of what is predicted, likewise
    stands: BoolArray  # (B,) the problem has a solution here
    near: Array  # (B, ...) where a look nearby begins


Look = Callable[[IntArray, Array, Array], Outlook]  # from some problems, their unknowns (B, d) and `near` (B, ...)


@dataclass(frozen=True)
class DampedSteps:
    """When the search ends, and how far it goes at once."""

    steps: int = 40
    last: float = 3e-3  # posterior sds: a step this small is the last: what is left is its square
    slight: float = 0.0  # of the objective: a step that lowers it by less is the last
    damping: float = 1e-6  # at first
    longest: Array | None = None  # (d,) of one step
    inside: Callable[[Array], Array] = np.asarray  # moves unknowns (B, d) to where they may be


@dataclass(frozen=True)
class MostProbable:
    """B problems with d unknowns at the end of the search."""

    x: Array  # (B, d)
    sd: Array  # (d,) before the data
    at: Outlook
    objective: Array  # (B,) squared residuals and the prior's part; infinite where the problem has no solution
    settled: BoolArray  # (B,) the search ended because its last step was small, or none was left

    @classmethod
    def of(cls, at: Outlook, x: Array, mean: Array, sd: Array) -> MostProbable:
        """At `x` (B, d)."""
        objective = np.where(at.stands, _objective(at.residual, (x - mean) / sd), np.inf)
        return cls(x, sd, at, objective, np.zeros(len(x), dtype=bool))

    @property
    def root(self) -> Array:
        """(B, d, d) R: the covariance of the unknowns is `R R^T`."""
        return self.sd[:, None] * np.linalg.inv(_with_prior(self.at.slopes * self.sd)[1])

    def by_residual(self, root: Array) -> Array:
        """(B, d, R) change of the unknowns with each residual; `root` as above."""
        return root @ np.swapaxes(self.at.slopes @ root, 1, 2)


def most_probable(
    look: Look, first: Outlook, x: Array, mean: Array, sd: Array, search: DampedSteps = DampedSteps()
) -> MostProbable:
    """From unknowns `x` (B, d), where the problems look like `first`, with prior `mean` and `sd` (d,)."""
    begin = MostProbable.of(replace(first, near=first.near.copy()), x.copy(), mean, sd)
    x, at, objective = begin.x, begin.at, begin.objective
    rows, damping = np.flatnonzero(at.stands), np.full(len(x), search.damping)
    for _ in range(search.steps):
        if not rows.size:
            break
        step, size = _step(at.slopes[rows] * sd, at.residual[rows], (x[rows] - mean) / sd, damping[rows])
        step = sd * step
        if search.longest is not None:
            times = np.maximum(np.max(np.abs(step / search.longest), axis=1), 1.0)
            step, size = step / times[:, None], np.where(times > 1.0, np.inf, size)
        trial = search.inside(x[rows] + step)
        there = look(rows, trial, at.near[rows])
        now = np.where(there.stands, _objective(there.residual, (trial - mean) / sd), np.inf)
        better = now < objective[rows]
        won, slight = rows[better], better & ((1.0 + search.slight) * now > objective[rows])
        x[won], objective[won] = trial[better], now[better]
        for name, values in vars(at).items():
            values[won] = getattr(there, name)[better]
        damping[rows] = np.where(better, np.maximum(damping[rows] / 10.0, 1e-12), 10.0 * damping[rows])
        done = slight | (size < search.last) | (damping[rows] > _MOST_DAMPING)
        begin.settled[rows[done]] = True
        rows = rows[~done]
    return begin


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
