"""The maximum a posteriori: Gauss-Newton at fixed hyperparameters, hyperparameters at fixed shapes, in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning.allowances.allowance import Sizes
from onebend.learning.allowances.mounting import BETWEEN
from onebend.learning.inference.allowance_sizes import choose_sizes, likely_sizes
from onebend.learning.inference.descent import MapEstimate, all_converged, descend, release, rows_of
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, prior
from onebend.learning.inference.hyperparameters import (
    Evidence,
    averaged_posterior,
    choose_hyperparameters,
    new_noise,
)
from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.joint import solved
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.inference.linear_gaussian import (
    ResidualRows,
    data_information,
    own_information,
    residuals,
)
from onebend.learning.inference.misfit import refuse_lost_force
from onebend.learning.model.forward import Prediction, predict
from onebend.progress import Progress
from onebend.records import Array
from onebend.workers import each

_HELD_SD = 1e-5  # of log k where it is held in its place
_STEADY_NOISE = 0.1  # change of the log of a recording's noise from round to round, below which it has settled
_FEW, _LIKELY = 10, 5  # recordings; values of what they leave open of the differences between them
_STEPS_ON_THE_WAY = 20  # at most, in all rounds but the last


@dataclass(frozen=True)
class OptimizerSettings:
    """When the optimizer stops."""

    most_steps: int = 60
    coarse_rounds: int = 3  # first rounds, in which the tags' noise is taken as large as their residuals
    rounds: int = 6  # at most; each but the last ends with new hyperparameters, until the noise is steady
    on_the_way: float = 0.3  # as `tolerance`, in all rounds but the last
    tolerance: float = 0.02  # expected gain of the last step, as a share of one sd


@dataclass(frozen=True)
class Optimum:
    """The posterior, and why the optimizer stopped."""

    x: Array  # (P,) log k's mean over its hyperparameters, and all else where it is most probable with that
    covariance: JointCovariance
    jumps: Array  # (p - 1,) mean steps of log k from coefficient to coefficient, without the smooth part
    shape: Array  # (levels, S) of the bands of log k, see `UncertainStiffness`
    hyperparameters: Hyperparameters
    sizes: tuple[Sizes, ...]  # of the allowances, equally probable: those that the posterior is averaged over
    predictions: tuple[Prediction, ...]
    log_evidence: float
    steps: int
    converged: bool
    stopped: str


def estimate_at(problem: FitProblem, x: Array, shapes: Sequence[Array | None] | None = None) -> MapEstimate:
    """The estimate to begin with, at parameters x; `shapes`: (F, Q) of each recording at x, where they are known.

    Raises:
        LearningError: the beam has no equilibrium there under the measured forces, or does not stand in a posture
            in which its frequencies were measured.
    """
    warm: Sequence[Array | None] = [None] * len(problem.recordings) if shapes is None else shapes
    if not problem.swings(x):
        raise LearningError(
            "with the mass as written, the beam would buckle under its weight in a posture in which it was seen to "
            "swing. Check mass_kg, length_m and the base_angle_deg of each [[frequencies]]"
        )
    predictions = each(lambda recording, q: predict(recording, problem.layout, x, q), problem.recordings, warm)
    if not all_converged(predictions):
        raise LearningError(
            "the start stiffness lets the beam snap through under the measured forces; start from a stiffer beam"
        )
    return MapEstimate(x, problem.expected, predictions)


def find_maximum(
    problem: FitProblem, estimate: MapEstimate, settings: OptimizerSettings, progress: Progress
) -> MapEstimate:
    """The maximum a posteriori, from an estimate to begin with.

    Raises:
        LearningError: force logs with more error than force, so that k(s) goes to zero and the force with it.
    """
    steady = False
    try:
        for round_number in range(settings.rounds):
            last = steady or round_number == settings.rounds - 1
            if round_number < settings.coarse_rounds:
                estimate = replace(estimate, hyperparameters=_coarse(problem, estimate.predictions))
            most, tolerance = (
                (settings.most_steps, settings.tolerance) if last else (_STEPS_ON_THE_WAY, settings.on_the_way)
            )
            estimate = descend(problem, estimate, prior(problem, estimate.hyperparameters), most, tolerance)
            progress.advance()
            if last:
                break
            if round_number >= settings.coarse_rounds - 1:
                before, after = estimate.hyperparameters, _new_hyperparameters(problem, estimate)
                estimate = replace(estimate, hyperparameters=after)
                steady = round_number >= settings.coarse_rounds and _noise_is_steady(before, after)
    except np.linalg.LinAlgError:
        refuse_lost_force(problem, estimate)
        raise
    refuse_lost_force(problem, estimate)
    return estimate


def laplace_posterior(problem: FitProblem, estimate: MapEstimate, settings: OptimizerSettings) -> Optimum:
    """The posterior around the maximum, averaged over the hyperparameters that the data leave open."""
    hyperparameters = estimate.hyperparameters
    evidence = Evidence(problem, data_information(problem, rows_of(estimate), estimate.x, hyperparameters))
    release(estimate)
    sizes, log_evidence = _likely(evidence, hyperparameters), evidence.posterior(hyperparameters).log_evidence
    stiffness, covariance = averaged_posterior(evidence, hyperparameters, sizes)
    del evidence  # with the information of every recording
    x, predictions = _at_mean_stiffness(problem, estimate, stiffness.mean, covariance)
    return Optimum(
        x=x,
        covariance=covariance,
        jumps=stiffness.steps,
        shape=stiffness.shape,
        hyperparameters=hyperparameters,
        sizes=sizes,
        predictions=predictions,
        log_evidence=log_evidence,
        steps=estimate.steps,
        converged=estimate.converged,
        stopped=f"the last step moved the parameters by less than {settings.tolerance:g} sd"
        if estimate.converged
        else f"{settings.most_steps} steps were not enough",
    )


def _likely(evidence: Evidence, hyperparameters: Hyperparameters) -> tuple[Sizes, ...]:
    """Sizes of the allowances that are equally probable: two recordings hardly tell by how much mountings differ, many
    do."""
    sizes, few = hyperparameters.sizes, len(evidence.problem.recordings) <= _FEW
    if BETWEEN not in sizes or not few:
        return (dict(sizes),)
    return tuple({**sizes, BETWEEN: float(f)} for f in likely_sizes(evidence, hyperparameters, BETWEEN, _LIKELY))


def _coarse(problem: FitProblem, predictions: Sequence[Prediction]) -> Hyperparameters:
    """What is expected, the tags' noise as large as their residuals: far from the maximum the tags' small differences
    mislead."""
    sizes = [float(np.sqrt(np.mean(residuals(p) ** 2))) for p in predictions]
    pairs = zip(problem.expected.noise, sizes, strict=True)
    return replace(problem.expected, noise=tuple(replace(noise, marker=max(size, 1.5)) for noise, size in pairs))


def _at_mean_stiffness(
    problem: FitProblem, estimate: MapEstimate, log_k: Array, covariance: JointCovariance
) -> tuple[Array, tuple[Prediction, ...]]:
    """Log k's coefficients at their mean (p,), and all else where it is most probable with them; the estimate itself
    where that beam would not stand, or where all else does not settle."""
    p = problem.layout.spline.count
    follow = covariance.with_shared(slice(p))
    x = estimate.x + follow @ np.linalg.solve(follow[:p], log_k - estimate.x[:p])
    moved = each(lambda now: predict(now.recording, problem.layout, x, now.solved.q, now.own), estimate.predictions)
    if not (all_converged(moved) and problem.swings(x)):
        return estimate.x, estimate.predictions
    variances = np.full_like(estimate.hyperparameters.part_variances, _HELD_SD**2)
    held = replace(estimate.hyperparameters, part_variances=variances)
    settled = descend(problem, MapEstimate(x, held, moved), prior(problem, held, log_k), 10, 0.1)
    return (settled.x, settled.predictions) if settled.converged else (estimate.x, estimate.predictions)


def _noise_is_steady(before: Hyperparameters, after: Hyperparameters) -> bool:
    """Whether the tags' noise has settled: what the beam does not follow yet counts as noise."""
    pairs = zip(before.noise, after.noise, strict=True)
    return all(abs(np.log(b.marker / a.marker)) < _STEADY_NOISE for b, a in pairs)


def _new_hyperparameters(problem: FitProblem, estimate: MapEstimate) -> Hyperparameters:
    """Noise of every recording from its residuals, then all else by the evidence."""
    hyperparameters, rows = estimate.hyperparameters, rows_of(estimate)
    noise = each(new_noise, problem.recordings, rows, hyperparameters.noise, _spent(problem, estimate, rows))
    hyperparameters = replace(hyperparameters, noise=noise)
    evidence = Evidence(problem, data_information(problem, rows, estimate.x, hyperparameters))
    hyperparameters = replace(hyperparameters, sizes=choose_sizes(evidence, hyperparameters))
    return choose_hyperparameters(evidence, hyperparameters)


def _spent(problem: FitProblem, estimate: MapEstimate, rows: Sequence[ResidualRows]) -> tuple[float, ...]:
    """How many parameters each recording's tags settled: the trace of their information times the covariance."""
    x, hyperparameters = estimate.x, estimate.hyperparameters
    data = data_information(problem, rows, x, hyperparameters)
    posterior = solved(data, prior(problem, hyperparameters))

    def of(number: int, form: InformationForm) -> float:
        others = own_information(problem, number, x)
        return float(np.sum(posterior.pair(number) * (form.matrix - sum(one.matrix for one in others))))

    return each(of, range(len(rows)), data.forms)
