"""Whether beam and mounting explain the tags under any force: their residuals in frames taken together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from onebend.learning.model.frames import whitening
from onebend.learning.sensing.bench import Bench, problem_of, solve, tags_of
from onebend.learning.sensing.estimate import Estimates
from onebend.records import Array, IntArray, covariance_with_camera


@dataclass(frozen=True)
class Misfit:
    """Squared residuals of some frames, in units of their noise, with what the frames share in common to them."""

    chi2: float
    freedom: int  # numbers measured, less the frames' own unknowns
    frames: int

    @property
    def ratio(self) -> float:
        """About 1 where beam, mounting and noise are as stated; NaN where nothing is left to tell."""
        return self.chi2 / self.freedom if self.freedom > 0 else float("nan")

    @property
    def probability(self) -> float:
        """Of residuals as large or larger, were all as stated."""
        return float(chi2.sf(self.chi2, self.freedom)) if self.freedom > 0 else float("nan")


def misfit(bench: Bench, frames: IntArray, found: Estimates, *, sought_place: bool) -> Misfit:
    """Of the `frames` (F,), rising, and what was `found` in them: whatever a frame's own force (and place) would change
    is taken off its residuals, to first order."""
    o, place = bench.observations, found.place
    seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    whiten = whitening(seen, covariance_with_camera(o)[frames])
    tags = tags_of(bench, solve(problem_of(bench, frames, place), found.force, place, None), found.force, place)

    def flat(of_tags: Array) -> Array:
        return np.asarray((whiten @ of_tags).reshape(len(frames), -1, of_tags.shape[-1]))

    along, shared = flat(tags.by_place[..., None]), flat(tags.by_shared @ bench.root)
    own = np.concatenate([flat(tags.by_force), along], axis=-1) if sought_place else flat(tags.by_force)
    if not sought_place:
        shared = np.concatenate([shared, along * bench.place_sd], axis=-1)
    left = flat(np.nan_to_num(seen - tags.pose)[..., None])
    basis, size, _ = np.linalg.svd(
        own / np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-300), full_matrices=False
    )
    basis = basis * (size > 1e-9 * size[:, :1])[:, None]
    left, shared = (x - basis @ (np.swapaxes(basis, 1, 2) @ x) for x in (left, shared))
    rows, away = shared.reshape(-1, shared.shape[-1]), left.ravel()
    by = rows.T @ away
    value = float(away @ away - by @ np.linalg.solve(np.eye(len(by)) + rows.T @ rows, by))
    measured = int(np.sum(np.isfinite(seen) & np.any(whiten != 0.0, axis=-1)))
    return Misfit(max(value, 0.0), measured - int(np.sum(size > 1e-9 * size[:, :1])), len(frames))
