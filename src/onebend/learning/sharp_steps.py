"""Steps and bumps of log k(s), chosen one by one, for maxima that the search from a smooth beam does not reach.

The fit averages over steps and bumps of every size in a model that is linear about one maximum. About a ramp such a
model is wrong about a step: where log k changes by one, the curvature does not change in proportion. So the few steps
and bumps of greatest evidence are chosen beside a smooth part, the fit is made again with them alone, and the evidence
about both maxima is compared. Each of the n steps and bumps is as probable as any other: one costs log n.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.learning.linear import FitProblem, prior
from onebend.learning.normal import InformationForm, stand_at
from onebend.learning.optimizer import MapEstimate, descend, evidence_at
from onebend.learning.parameters import Spline
from onebend.records import Array

_MOST = 4  # steps and bumps
_VARIANCES = np.array([0.1, 1.0])  # of log k, that are tried for one
_ROUGHNESS = (0.3, 1.0, 3.0, 8.0)  # of the smooth part
_LEAST = 1e-8  # variance of the others
_STRONG = 5.0  # of the log evidence: "very strong" in Kass and Raftery (1995); below it the band of many steps stands
_ROUNDS = 3  # of choice and fit: the choice is that of a linear model
_STEPS, _TOLERANCE = 25, 0.05  # of a fit on the way


@dataclass(frozen=True)
class _Choice:
    """A smooth part and some steps and bumps."""

    variances: Array  # (n,) of the parts of log k
    count: int  # of steps and bumps
    score: float  # log evidence of the linear model less `log n` for each


def with_sharp_steps(problem: FitProblem, estimate: MapEstimate) -> MapEstimate:
    """The maximum with few steps and bumps if its evidence is far greater than that of `estimate` and the model
    that is linear about it would choose some again, else `estimate`."""
    if problem.layout.known is not None:
        return estimate
    evidence = evidence_at(problem, estimate)
    now = evidence.posterior(estimate.hyperparameters)
    spline, least, best = problem.layout.spline, now.log_evidence + _STRONG, None
    tried: list[Array] = []
    trial = estimate
    for _ in range(_ROUNDS):
        choice = chosen(evidence.stiffness_form(now), spline, problem.level)
        if not choice.count:  # nor does the model about the maximum with steps want any
            return estimate
        if any(np.array_equal(choice.variances, one) for one in tried):
            break
        tried.append(choice.variances)
        variances = np.maximum(choice.variances, _LEAST)
        held = replace(trial, hyperparameters=replace(estimate.hyperparameters, part_variances=variances))
        trial = descend(problem, held, prior(problem, held.hyperparameters), _STEPS, _TOLERANCE)
        evidence = evidence_at(problem, trial)
        now = evidence.posterior(trial.hyperparameters)
        if trial.converged and now.log_evidence > least:
            least, best = now.log_evidence, trial
    if best is None:
        return estimate
    begin = stand_at(spline, best.hyperparameters.part_variances)
    found = replace(best.hyperparameters, chains=begin[None])
    steps, converged = estimate.steps + best.steps, estimate.converged and best.converged
    return replace(best, hyperparameters=found, steps=steps, converged=converged)


def chosen(form: InformationForm, spline: Spline, level: float) -> _Choice:
    """Forward selection by evidence (Tipping and Faul 2003) from the likelihood of log k, linear about a maximum."""
    return max((_chosen(form, spline, level, tau) for tau in _ROUGHNESS), key=lambda one: one.score)


def _chosen(form: InformationForm, spline: Spline, level: float, tau: float) -> _Choice:
    """With a smooth part of roughness tau."""
    p, parts, one = spline.count, spline.parts, np.eye(spline.count)
    cost = np.log(len(spline.share))
    variances, gap = spline.variances(tau, 0.0), form.vector - form.matrix @ np.full(spline.count, level)
    score, count = _log_evidence(form, parts, variances, gap), 0
    while count < _MOST:
        covariance = (parts * variances) @ parts.T
        both = np.linalg.solve(one + form.matrix @ covariance, np.column_stack([form.matrix, gap]))
        local = parts[:, p:]
        known, shown = np.einsum("pi,pq,qi->i", local, both[:, :-1], local), both[:, -1] @ local
        added = _VARIANCES[:, None]
        gains = 0.5 * (added * shown**2 / (1.0 + added * known) - np.log1p(added * known))
        size, place = np.unravel_index(np.argmax(gains), gains.shape)
        gain = float(gains[size, place] - cost)
        if gain <= 0.0:
            break
        variances[p + place] += _VARIANCES[size]
        score, count = score + gain, count + 1
    return _Choice(variances, count, score)


def _log_evidence(form: InformationForm, parts: Array, variances: Array, gap: Array) -> float:
    """Of log k's prior covariance `S = W diag(v) W'`: `g' S (I + H S)^-1 g / 2 - log det(I + H S) / 2`."""
    covariance = (parts * variances) @ parts.T
    inner = np.eye(len(gap)) + form.matrix @ covariance
    return 0.5 * float(gap @ covariance @ np.linalg.solve(inner, gap) - np.linalg.slogdet(inner)[1])
