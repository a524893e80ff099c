"""The maximum a posteriori: Gauss-Newton at fixed hyperparameters, hyperparameters at fixed shapes, in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from onebend.errors import LearningError
from onebend.learning.inference.allowance_sizes import choose_sizes
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, Prior, RecordingNoise, prior
from onebend.learning.inference.hyperparameters import (
    Evidence,
    averaged_posterior,
    choose_hyperparameters,
    new_noise,
)
from onebend.learning.inference.information_form import InformationForm, total
from onebend.learning.inference.linear_gaussian import (
    ResidualRows,
    data_information,
    posterior_of,
    residual_rows,
    residuals,
    rest_information,
    split_off_force,
    tag_information,
)
from onebend.learning.model.forward import Prediction, predict
from onebend.progress import Progress
from onebend.records import Array

_HELD_SD = 1e-5  # of log k where it is held in its place
_STEADY_NOISE = 0.1  # change of the log of a recording's noise from round to round, below which it has settled
_STEPS_ON_THE_WAY = 20  # at most, in all rounds but the last
_FIRST_DAMPING, _LARGEST_DAMPING = 1.0, 1e9
_ROUNDING = 1.0  # sd squared: where steps hardly lower the cost, a smaller promised gain is of the derivatives' errors
_LITTLE = 0.03  # of the cost, in sd squared, that a step lowers it by


@dataclass(frozen=True)
class OptimizerSettings:
    """When the optimizer stops."""

    most_steps: int = 60
    coarse_rounds: int = 3  # first rounds, in which the tags' noise is taken as large as their residuals
    rounds: int = 6  # at most; each but the last ends with new hyperparameters, until the noise is steady
    on_the_way: float = 0.3  # as `tolerance`, in all rounds but the last
    tolerance: float = 0.02  # expected gain of the last step, as a share of one sd


@dataclass(frozen=True)
class MapEstimate:
    """The most probable parameters found so far."""

    x: Array  # (P,)
    hyperparameters: Hyperparameters
    predictions: tuple[Prediction, ...]  # of each recording at x
    steps: int = 0
    converged: bool = False


@dataclass(frozen=True)
class Optimum:
    """The posterior, and why the optimizer stopped."""

    x: Array  # (P,) log k's mean over its hyperparameters, and all else where it is most probable with that
    covariance: Array  # (P, P)
    jumps: Array  # (p - 1,) mean steps of log k from coefficient to coefficient, without the smooth part
    shape: Array  # (levels, S) of the bands of log k, see `UncertainStiffness`
    hyperparameters: Hyperparameters
    predictions: tuple[Prediction, ...]
    log_evidence: float
    steps: int
    converged: bool
    stopped: str


def estimate_at(problem: FitProblem, x: Array, shapes: Sequence[Array] | None = None) -> MapEstimate:
    """The estimate to begin with, at parameters x; `shapes`: (F, Q) of each recording at x, where they are known.

    Raises:
        LearningError: the beam has no equilibrium there under the measured forces.
    """
    warm: Sequence[Array | None] = [None] * len(problem.recordings) if shapes is None else shapes
    predictions = tuple(predict(r, problem.layout, x, q) for r, q in zip(problem.recordings, warm, strict=True))
    if not _all_converged(predictions):
        raise LearningError(
            "the start stiffness lets the beam snap through under the measured forces; start from a stiffer beam"
        )
    return MapEstimate(x, problem.expected, predictions)


def find_maximum(
    problem: FitProblem, estimate: MapEstimate, settings: OptimizerSettings, progress: Progress
) -> MapEstimate:
    """The maximum a posteriori, from an estimate to begin with."""
    steady = False
    for round_number in range(settings.rounds):
        last = steady or round_number == settings.rounds - 1
        if round_number < settings.coarse_rounds:
            estimate = replace(estimate, hyperparameters=_coarse(problem, estimate.predictions))
        most, tolerance = (
            (settings.most_steps, settings.tolerance) if last else (_STEPS_ON_THE_WAY, settings.on_the_way)
        )
        estimate = _descend(problem, estimate, prior(problem, estimate.hyperparameters), most, tolerance)
        progress.advance()
        if last:
            break
        if round_number >= settings.coarse_rounds - 1:
            before, after = estimate.hyperparameters, _new_hyperparameters(problem, estimate)
            estimate = replace(estimate, hyperparameters=after)
            steady = round_number >= settings.coarse_rounds and _noise_is_steady(before, after)
    return estimate


def laplace_posterior(problem: FitProblem, estimate: MapEstimate, settings: OptimizerSettings) -> Optimum:
    """The posterior around the maximum, averaged over the hyperparameters that the data leave open."""
    hyperparameters = estimate.hyperparameters
    evidence = Evidence(problem, data_information(problem, _rows(estimate), estimate.x, hyperparameters))
    stiffness, covariance = averaged_posterior(evidence, hyperparameters)
    x, predictions = _at_mean_stiffness(problem, estimate, stiffness.mean, covariance)
    return Optimum(
        x=x,
        covariance=covariance,
        jumps=stiffness.steps,
        shape=stiffness.shape,
        hyperparameters=hyperparameters,
        predictions=predictions,
        log_evidence=evidence.posterior(hyperparameters).log_evidence,
        steps=estimate.steps,
        converged=estimate.converged,
        stopped=f"the last step was worth less than {settings.tolerance:g} of a sd"
        if estimate.converged
        else f"{settings.most_steps} steps were not enough",
    )


def _all_converged(predictions: Sequence[Prediction]) -> bool:
    return all(np.all(p.solved.converged) for p in predictions)


def _coarse(problem: FitProblem, predictions: Sequence[Prediction]) -> Hyperparameters:
    """What is expected, the tags' noise as large as their residuals: far from the maximum the tags' small differences
    mislead."""
    sizes = [float(np.sqrt(np.mean(residuals(p) ** 2))) for p in predictions]
    pairs = zip(problem.expected.noise, sizes, strict=True)
    return replace(problem.expected, noise=tuple(replace(noise, marker=max(size, 1.5)) for noise, size in pairs))


def _at_mean_stiffness(
    problem: FitProblem, estimate: MapEstimate, log_k: Array, covariance: Array
) -> tuple[Array, tuple[Prediction, ...]]:
    """Log k's coefficients at their mean (p,), and all else where it is most probable with them; the estimate itself
    where that beam would not stand."""
    p = problem.layout.spline.count
    x = estimate.x + np.linalg.solve(covariance[:p, :p], covariance[:p]).T @ (log_k - estimate.x[:p])
    pairs = zip(problem.recordings, estimate.predictions, strict=True)
    moved = tuple(predict(r, problem.layout, x, now.solved.q, now.own) for r, now in pairs)
    if not _all_converged(moved):
        return estimate.x, estimate.predictions
    variances = np.full_like(estimate.hyperparameters.part_variances, _HELD_SD**2)
    held = replace(estimate.hyperparameters, part_variances=variances)
    settled = _descend(problem, MapEstimate(x, held, moved), prior(problem, held, log_k), 10, 0.1)
    return settled.x, settled.predictions


def _noise_is_steady(before: Hyperparameters, after: Hyperparameters) -> bool:
    """Whether the tags' noise has settled: what the beam does not follow yet counts as noise."""
    pairs = zip(before.noise, after.noise, strict=True)
    return all(abs(np.log(b.marker / a.marker)) < _STEADY_NOISE for b, a in pairs)


def _new_hyperparameters(problem: FitProblem, estimate: MapEstimate) -> Hyperparameters:
    """Noise of every recording from its residuals, then all else by the evidence."""
    hyperparameters, layout = estimate.hyperparameters, problem.layout
    rows = _rows(estimate)
    every = list(zip(problem.recordings, rows, hyperparameters.noise, strict=True))
    tags = [tag_information(r, layout, recording.number, estimate.x, noise) for recording, r, noise in every]
    data = total([*tags, rest_information(problem)])
    covariance = posterior_of(data, prior(problem, hyperparameters)).covariance
    spent = [float(np.sum(covariance * one.matrix)) for one in tags]  # parameters that each recording settled
    noise = tuple(new_noise(*one, count) for one, count in zip(every, spent, strict=True))
    hyperparameters = replace(hyperparameters, noise=noise)
    evidence = Evidence(problem, data_information(problem, rows, estimate.x, hyperparameters))
    hyperparameters = replace(hyperparameters, sizes=choose_sizes(evidence, hyperparameters))
    return choose_hyperparameters(evidence, hyperparameters)


def _rows(estimate: MapEstimate) -> list[ResidualRows]:
    """Of every recording, its tags weighted by their noise at the estimate."""
    pairs = zip(estimate.predictions, estimate.hyperparameters.noise, strict=True)
    return [residual_rows(prediction, noise) for prediction, noise in pairs]


def _descend(
    problem: FitProblem, estimate: MapEstimate, before: Prior, most_steps: int, tolerance: float
) -> MapEstimate:
    """Levenberg-Marquardt at fixed hyperparameters; weights and frames' covariances are renewed at every step.

    Damped in z, in which the prior has covariance one: what the data hardly tell is held back, and what they fix well
    is not. Damped in the parameters' own units, a step along a valley that the data leave open would be a small part
    of its length. It ends where an undamped step would gain next to nothing.
    """
    noise, damping, rests = estimate.hyperparameters.noise, _FIRST_DAMPING, rest_information(problem)
    identity = np.eye(len(estimate.x))
    for _ in range(most_steps):
        rows = _rows(estimate)
        data = data_information(problem, rows, estimate.x, estimate.hyperparameters)
        hessian = before.root.T @ data.matrix @ before.root + identity  # of z, see `Prior`
        slope = before.root.T @ (data.vector - data.matrix @ estimate.x) - before.whiten(estimate.x)
        gain = float(slope @ cho_solve(cho_factor(hessian), slope))  # of an undamped step, in sd squared
        if gain < tolerance**2:
            return replace(estimate, converged=True)
        cost = _cost(before, rests, rows, estimate)
        estimate = replace(estimate, steps=estimate.steps + 1)
        while True:
            step = before.root @ cho_solve(cho_factor(hessian + damping * identity), slope)
            longest = float(np.max(np.abs(step[: problem.layout.spline.count])))
            x = estimate.x + step * min(1.0, 1.5 / max(longest, 1e-300))
            every = zip(rows, estimate.predictions, noise, strict=True)
            forces = [_own_force(r, now, n, x - estimate.x) for r, now, n in every]
            pairs = zip(problem.recordings, estimate.predictions, forces, strict=True)
            moved = tuple(predict(r, problem.layout, x, now.solved.q, own) for r, now, own in pairs)
            tried = replace(estimate, x=x, predictions=moved)
            reached = _cost(before, rests, rows, tried)
            if reached <= cost + 1e-6:
                break
            damping *= 8.0
            if damping > _LARGEST_DAMPING:
                return replace(estimate, converged=gain < _ROUNDING)  # no step lowers the cost any more
        estimate, damping = tried, max(damping / 16.0, 1e-12)
        if gain < _ROUNDING and cost - reached < max(_LITTLE, tolerance**2):
            return replace(estimate, converged=True)
    return replace(estimate, converged=False)


def _cost(before: Prior, rests: InformationForm, rows: Sequence[ResidualRows], estimate: MapEstimate) -> float:
    """Minus twice the log posterior at the weights of some rows, but for a constant; infinite without equilibrium."""
    if not _all_converged(estimate.predictions):
        return np.inf
    x = estimate.x
    every = zip(rows, estimate.predictions, estimate.hyperparameters.noise, strict=True)
    tags = sum(_misfit(r.root_weight * residuals(p), p.own, noise) for r, p, noise in every)
    z = before.whiten(x)
    return float(tags + z @ z + x @ rests.matrix @ x - 2.0 * rests.vector @ x)


def _misfit(residual: Array, own: Array, noise: RecordingNoise) -> float:
    """Minus twice the log probability of the tags' residuals (F, R), and of the frames' own forces (F, 2)."""
    return float(np.sum(residual**2)) / noise.marker**2 + float(np.sum(own**2)) / noise.force**2


def _own_force(rows: ResidualRows, now: Prediction, noise: RecordingNoise, step: Array) -> Array:
    """(F, 2) N: each frame's own force after a step of the parameters, to first order the most probable one."""
    mine = now.layout.known_to(now.recording.number)
    return split_off_force(rows, rows.r - rows.slopes.times(step[mine]), noise)[1]
