"""The evidence for a place of the push, fitted on a few frames.

Evidences can be compared under one noise only. The noise of the tags and of the log is not that of greatest evidence
(its correlation in time is counted in, and it settles slowly), so the evidence goes with it to first order: one part in
twenty of the noise is worth five of its logarithm. So every place is fitted with the noise, and the sizes of the force
error and of the allowances, of one fit. What that fit misses counts as noise, at every place alike.

k(s), and all that recordings share, are integrated out. What a recording has of its own (a hundred numbers of the log's
error, mostly) is at its most probable instead: how closely the tags tell it goes by where the push acts, but by what is
assumed of the noise too, and no bench keeps to that. So the tags have one working covariance for all places, and its
determinant is no evidence (quasi-likelihood; Wedderburn 1974, Liang and Zeger 1986).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning.inference.descent import MapEstimate, descend, rows_of
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, prior
from onebend.learning.inference.hyperparameters import Evidence, with_stiffness_prior
from onebend.learning.inference.linear_gaussian import data_information
from onebend.learning.inference.optimizer import OptimizerSettings, Optimum, find_maximum
from onebend.learning.inference.stages import FitSettings, carried_over, first_problem
from onebend.learning.start import start_of
from onebend.progress import Silent
from onebend.records import Array

_FRAMES = 50  # that are fitted
_NOISE = OptimizerSettings(most_steps=20, coarse_rounds=0, rounds=4, on_the_way=0.3, tolerance=0.3)
_ROUNDS = 3  # of a fit, each but the last with a new prior of log k after it
_NEAR = 0.03  # of the length: so near to a push nothing bends, and the ratio of two moments tells nothing
_LARGEST = 10.0  # of k over that at another place, to begin with


@dataclass(frozen=True)
class AtPlace:
    """The fit of a few frames with the push at one place."""

    place: float  # s
    problem: FitProblem
    estimate: MapEstimate
    log_evidence: float  # but for a constant, under one noise


def at_written(problem: FitProblem, optimum: Optimum, place: float, settings: FitSettings) -> AtPlace | None:
    """The fit with the push where it is written, with a noise of its own; None where there is none."""
    found = MapEstimate(optimum.x, optimum.hyperparameters, optimum.predictions)
    few = _few(problem, found, place, place, settings)
    return None if few is None else with_own_noise(few)


def with_own_noise(fit: AtPlace) -> AtPlace | None:
    """The fit with noise and sizes from its own residuals."""
    try:
        estimate = find_maximum(fit.problem, fit.estimate, _NOISE, Silent())
    except (LearningError, np.linalg.LinAlgError):
        return None
    return under(replace(fit, estimate=estimate), estimate.hyperparameters)


def moved(fit: AtPlace, place: float, settings: FitSettings) -> AtPlace | None:
    """The fit with the push at another place, under the noise of one beside it; None where there is none.

    It begins at the k(s) found there, and where that leads nowhere at the even beam that is nearest to the tags: a k(s)
    that makes up for a wrong place may be one that no step leads away from.
    """
    for even in (False, True):
        few = _few(fit.problem, fit.estimate, fit.place, place, settings, even=even)
        found = None if few is None else under(few, fit.estimate.hyperparameters)
        if found is not None and found.estimate.converged:
            return found
    return None


def under(fit: AtPlace, common: Hyperparameters) -> AtPlace | None:
    """The fit under a noise that is not its own; the prior of log k stays its own."""
    problem, own = fit.problem, fit.estimate.hyperparameters
    common = replace(common, part_variances=own.part_variances, chains=own.chains)
    estimate, value = replace(fit.estimate, hyperparameters=common), np.nan
    try:
        for i in range(_ROUNDS):
            now = estimate.hyperparameters
            estimate = descend(problem, estimate, prior(problem, now), _NOISE.most_steps, _NOISE.tolerance)
            evidence = Evidence(problem, data_information(problem, rows_of(estimate), estimate.x, now))
            value = evidence.posterior(now).log_evidence_of_shared
            if i + 1 < _ROUNDS:
                estimate = replace(estimate, hyperparameters=with_stiffness_prior(evidence, now))
    except (LearningError, np.linalg.LinAlgError):
        return None
    return AtPlace(fit.place, problem, estimate, value) if np.isfinite(value) else None


def _few(
    problem: FitProblem, near: MapEstimate, before: float, place: float, settings: FitSettings, *, even: bool = False
) -> AtPlace | None:
    """A few frames with the push at `place`, and where to begin with them: as near with the push at `before`, k as much
    larger as the moment, or `even`."""
    o = problem.recordings[0].observations
    there = replace(o, push_s=np.where(np.isfinite(o.push_s), place, o.push_s))
    try:
        start = start_of([there], None) if even else 1.0
        few, begin = first_problem([there], start, replace(settings, first_frames=_FRAMES))
        few = replace(few, level=problem.level)
        x, p = near.x.copy(), problem.layout.spline.count
        x[:p] = begin[:p] if even else x[:p] + few.layout.spline.nearest(lambda s: log_ratio(s, before, place))
        return AtPlace(place, few, carried_over(problem, replace(near, x=x), few, [0]), np.nan)
    except (LearningError, np.linalg.LinAlgError):
        return None


def log_ratio(s: Array, before: float, after: float) -> Array:
    """(S,) log of the moments of a push at `after` over those of one at `before`; as at its end beyond both."""
    inside = np.minimum(s, min(before, after) - _NEAR)
    ratio = np.maximum(after - inside, _NEAR) / np.maximum(before - inside, _NEAR)
    return np.asarray(np.log(np.clip(ratio, 1.0 / _LARGEST, _LARGEST)))
