"""How much of what differs lies between groups, and how much an object keeps when it is recorded again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.blas import one_blas_thread
from onebend.population.covariances import covariance
from onebend.population.fit import Fit
from onebend.population.gaussians import means, weighted_quantiles
from onebend.records import Array

BAND = (0.5, 0.025, 0.975)
FEWEST = 3  # groups, to say anything of how groups scatter
HEAVY = 200  # points of the grid that are kept, the heaviest
STEPS = np.linspace(0.0, 0.99, 34)  # of the share between groups


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; NaN where the trial cannot tell."""

    value: float  # the median
    low: float
    high: float


UNKNOWN = Estimate(np.nan, np.nan, np.nan)


@dataclass(frozen=True)
class Shares:
    """Of the variance of log k between objects."""

    level_sd: Estimate  # within groups, of the mean along the beam
    shape_sd: Estimate  # within groups, RMS along the beam
    repeatability: Estimate  # of the variance within groups: what stays with the object when it is recorded again
    between: Estimate  # of all variance between objects: between groups (intraclass correlation, heritability)
    between_sd: Estimate  # of the groups' means, RMS along the beam


def shares(fit: Fit) -> Shares:
    """The spreads that the trial tells, each from its posterior."""
    spreads, weight = fit.spreads, fit.weight
    lasting = np.sqrt(spreads.lasting)
    between, between_sd = _between(fit) if fit.trial.groups >= FEWEST else (UNKNOWN, UNKNOWN)
    return Shares(
        _estimate(lasting * spreads.level_sd, weight),
        _estimate(lasting * spreads.shape_sd, weight),
        _estimate(spreads.lasting, weight) if fit.trial.repeated else UNKNOWN,
        between,
        between_sd,
    )


def _estimate(values: Array, weight: Array) -> Estimate:
    return Estimate(*weighted_quantiles(values, weight, BAND))


@one_blas_thread
def _between(fit: Fit) -> tuple[Estimate, Estimate]:
    """The groups' means scattered about one mean, with h / (1 - h) of the covariance within groups; h is flat."""
    heavy = np.argsort(-fit.weight)[:HEAVY]
    spreads = fit.spreads.chosen(heavy)
    within = spreads.lasting[:, None, None] * covariance(spreads, fit.trial.s)
    log, every = [], np.zeros(fit.trial.groups, dtype=int)
    for share in STEPS:
        scatter = share / (1.0 - share) * within[:, None]
        log.append(means(fit.mean[heavy], fit.covariance[heavy] + scatter, every).log_evidence[:, 0])
    joint = np.array(log) + np.log(fit.weight[heavy])
    weight = np.exp(joint - joint.max())
    rms = np.sqrt(np.mean(np.diagonal(within, axis1=1, axis2=2), axis=1))
    sd = np.sqrt(STEPS / (1.0 - STEPS))[:, None] * rms
    return _estimate(STEPS, weight.sum(axis=1)), _estimate(sd.ravel(), weight.ravel())
