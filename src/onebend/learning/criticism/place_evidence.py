"""The evidence for a place of the push.

Evidences can be compared under one noise only. The noise of the tags and of the log is not that of greatest evidence
(its correlation in time is counted in, and it settles slowly), so the evidence goes with it to first order: one part in
twenty of the noise is worth five of its logarithm. So every place is fitted with the noise, and the sizes of the force
error and of the allowances, of one fit. What that fit misses counts as noise, at every place alike.

k(s), and all that recordings share, are integrated out. What a recording has of its own (a hundred numbers of the log's
error, mostly) is at its most probable instead: how closely the tags tell it goes by where the push acts, but by what is
assumed of the noise too, and no bench keeps to that. So the tags have one working covariance for all places, and its
determinant is no evidence (quasi-likelihood; Wedderburn 1974, Liang and Zeger 1986).

A bench is not quite as the model says, in ways that stay from frame to frame, and more frames do not tell more of the
place then. So a recording counts as a few frames, and the likelihood of all its frames is raised to the power that
makes it so (coarsening; Miller and Dunson 2019). A few frames by themselves would do, but for which ones they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning.inference.descent import MapEstimate, descend, rows_of
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise, prior
from onebend.learning.inference.hyperparameters import Evidence, with_stiffness_prior
from onebend.learning.inference.linear_gaussian import data_information
from onebend.learning.inference.optimizer import OptimizerSettings, Optimum, find_maximum
from onebend.learning.inference.stages import FitSettings, carried_over, rewritten_problem, starting
from onebend.learning.model.fit_data import FitData
from onebend.learning.start import start_of
from onebend.progress import Silent
from onebend.records import Array

_FRAMES = 50.0  # that a recording counts as, at most
_NOISE = OptimizerSettings(most_steps=20, coarse_rounds=0, rounds=4, on_the_way=0.3, tolerance=0.3)
_ROUNDS = 3  # of a fit, each but the last with a new prior of log k after it
_FAR_BELOW = 50.0  # of the log evidence, below the best place: another prior of log k seldom adds more than a few
_NEAR = 0.03  # of the length: so near to a push nothing bends, and the ratio of two moments tells nothing
_LARGEST = 10.0  # of k over that at another place, to begin with


@dataclass(frozen=True)
class AtPlace:
    """The fit with the push at one place."""

    place: float  # s
    problem: FitProblem
    estimate: MapEstimate
    log_evidence: float  # but for a constant, under one noise


def at_written(problem: FitProblem, optimum: Optimum, place: float) -> AtPlace | None:
    """The fit with the push where it is written, with a noise of its own; None where there is none."""
    found = MapEstimate(optimum.x, optimum.hyperparameters, optimum.predictions)
    return with_own_noise(AtPlace(place, problem, found, np.nan))


def with_own_noise(fit: AtPlace) -> AtPlace | None:
    """The fit with noise and sizes from its own residuals."""
    try:
        estimate = find_maximum(fit.problem, fit.estimate, _NOISE, Silent())
    except (LearningError, np.linalg.LinAlgError):
        return None
    return under(replace(fit, estimate=estimate), coarsened(estimate.hyperparameters, fit.problem))


def frames_of_film(recording: FitData) -> int:
    """How many frames of the film are fitted, means counted as the frames that they are of."""
    o = recording.observations
    return int(np.sum(recording.frames if o.means is None else o.means.count[recording.frames]))


def coarsened(found: Hyperparameters, problem: FitProblem) -> Hyperparameters:
    """With noise so large that the frames of a recording tell as much as _FRAMES of them."""

    def of(noise: RecordingNoise, frames: int) -> RecordingNoise:
        wider = float(np.sqrt(max(frames / _FRAMES, 1.0)))
        return RecordingNoise(wider * noise.marker, wider * noise.force)

    each_one = zip(found.noise, problem.recordings, strict=True)
    return replace(found, noise=tuple(of(noise, frames_of_film(recording)) for noise, recording in each_one))


def moved(fit: AtPlace, place: float, settings: FitSettings, most: float = -np.inf) -> AtPlace | None:
    """The fit with the push at another place, under the noise of one beside it; None where there is none. `most`: the
    log evidence of the best place so far.

    It begins at the k(s) found there, and where that leads nowhere at the even beam that is nearest to the tags: a k(s)
    that makes up for a wrong place may be one that no step leads away from.
    """
    for even in (False, True):
        begun = _begun(fit, place, settings, even=even)
        found = None if begun is None else under(begun, fit.estimate.hyperparameters, most - _FAR_BELOW)
        if found is not None and found.estimate.converged:
            return found
    return None


def under(fit: AtPlace, common: Hyperparameters, least: float = -np.inf) -> AtPlace | None:
    """The fit under a noise that is not its own; the prior of log k stays its own. With less log evidence than `least`
    after a round it is left as it is."""
    problem, own = fit.problem, fit.estimate.hyperparameters
    common = replace(common, part_variances=own.part_variances, chains=own.chains)
    estimate, value = replace(fit.estimate, hyperparameters=common), np.nan
    try:
        for i in range(_ROUNDS):
            now = estimate.hyperparameters
            estimate = descend(problem, estimate, prior(problem, now), _NOISE.most_steps, _NOISE.tolerance)
            evidence = Evidence(problem, data_information(problem, rows_of(estimate), estimate.x, now))
            value = evidence.posterior(now).log_evidence_of_shared
            if i + 1 == _ROUNDS or not value >= least:
                break
            estimate = replace(estimate, hyperparameters=with_stiffness_prior(evidence, now))
    except (LearningError, np.linalg.LinAlgError):
        return None
    return AtPlace(fit.place, problem, estimate, value) if np.isfinite(value) else None


def _begun(fit: AtPlace, place: float, settings: FitSettings, *, even: bool) -> AtPlace | None:
    """Where to begin with the push at another place, on the same frames: as near as `fit`, k as much larger as the
    moment, or `even`."""
    problem, x, p = fit.problem, fit.estimate.x.copy(), fit.problem.layout.spline.count
    o = problem.recordings[0].observations
    there = replace(o, push_s=np.where(np.isfinite(o.push_s), place, o.push_s))
    try:
        other = rewritten_problem([there], problem, settings)
        if even:
            x[:p] = starting(other.layout, start_of([there], None))[0][:p]
        else:
            x[:p] += problem.layout.spline.nearest(lambda s: log_ratio(s, fit.place, place))
        begin = carried_over(problem, replace(fit.estimate, x=x), other, [0])
        return AtPlace(place, other, begin, np.nan)
    except (LearningError, np.linalg.LinAlgError):
        return None


def log_ratio(s: Array, before: float, after: float) -> Array:
    """(S,) log of the moments of a push at `after` over those of one at `before`; as at its end beyond both."""
    inside = np.minimum(s, min(before, after) - _NEAR)
    ratio = np.maximum(after - inside, _NEAR) / np.maximum(before - inside, _NEAR)
    return np.asarray(np.log(np.clip(ratio, 1.0 / _LARGEST, _LARGEST)))
