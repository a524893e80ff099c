"""What is fitted: the recordings' data, where each parameter stands, and what is expected before the data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.learning.model.fit_data import FitData
from onebend.learning.model.parameters import Layout
from onebend.records import Array


@dataclass(frozen=True)
class RecordingNoise:
    """Noise of one recording's frames, correlation in time included."""

    marker: float  # over what the tags' covariances say
    force: float  # N, the force error that is faster than its knots


@dataclass(frozen=True)
class Hyperparameters:
    """Sizes of priors and noise, which the data choose."""

    part_variances: Array  # (n,) variances of the parts of log k, see `Spline.parts`
    coloured: float  # sd of the force error's coloured part, over what was expected
    memory: float  # its correlation time, likewise
    walk: float  # the random walk of the force error, likewise
    load: float  # sd of the force error that comes with the load, likewise
    noise: tuple[RecordingNoise, ...]
    chains: Array | None = None  # where the sampler's chains stand, see `stiffness_prior.mean_part_variances`


@dataclass(frozen=True)
class FitProblem:
    """One or several recordings of one beam, and the prior of the parameters."""

    recordings: tuple[FitData, ...]
    layout: Layout
    level: float  # prior mean of log k
    expected: Hyperparameters


@dataclass(frozen=True)
class Prior:
    """The parameters before the data: normal with this precision and mean."""

    precision: Array  # (P, P)
    mean: Array  # (P,)
    log_det: float  # of the precision


def prior(problem: FitProblem, hyperparameters: Hyperparameters, log_k: Array | None = None) -> Prior:
    """The prior at given hyperparameters; `log_k` (p,): mean of log k's coefficients, where it is not one level."""
    layout, size = problem.layout, problem.layout.size
    precision, mean, log_det = np.zeros((size, size)), np.zeros(size), 0.0
    for block in layout.blocks:
        if block.start < 0:
            continue
        where = block.where
        if block.name == "stiffness":
            precision[where, where] = layout.spline.precision_of(hyperparameters.part_variances) + layout.evenness
            mean[where] = problem.level if log_k is None else log_k
            log_det += float(np.linalg.slogdet(precision[where, where])[1])
        elif block.name == "force":  # x and y in turn, alike
            error, h = problem.recordings[block.recording].error, hyperparameters
            covariance = error.covariance(h.coloured, h.memory, h.walk, h.load)
            mean[where] = error.mean.ravel()
            inverse = np.linalg.inv(covariance)
            for axis in range(2):
                same_axis = slice(where.start + axis, where.stop, 2)
                precision[same_axis, same_axis] = inverse
            log_det -= 2.0 * float(np.linalg.slogdet(covariance)[1])
        else:
            precision[where, where] = np.diag(1.0 / block.prior_sd**2)
            log_det -= 2.0 * float(np.sum(np.log(block.prior_sd)))
    return Prior(precision, mean, log_det)
