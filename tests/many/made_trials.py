"""Trials drawn from the model: known means, known deviations, known errors of the fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.many.population import PopulationTrial, shape_correlation
from onebend.records import Array


@dataclass(frozen=True)
class Truth:
    """How a trial is drawn."""

    sizes: tuple[int, ...] = (5, 5)  # objects of each group
    recordings: int = 1  # of each object
    level_sd: float = 0.1  # of log k
    shape_sd: float = 0.05
    length: float = 0.3
    noise: float = 0.03  # of a fit, in the middle of the beam
    lasting: float = 1.0
    between: float = 0.0  # share of the variance between objects that lies between groups
    places: int = 21


@dataclass(frozen=True)
class Made:
    """A trial and what it was drawn from."""

    trial: PopulationTrial
    means: Array  # (G, S) of log k
    objects: Array  # (O, S) of log k, as they last


def made(truth: Truth, seed: int) -> Made:
    """A trial of this kind."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, truth.places)
    group_of = np.repeat(np.arange(len(truth.sizes)), truth.sizes)
    object_of = np.repeat(np.arange(len(group_of)), truth.recordings)
    scatter = truth.level_sd**2 + truth.shape_sd**2 * shape_correlation(s, truth.length)
    root = np.linalg.cholesky(scatter + 1e-10 * np.eye(len(s)))

    def drawn(count: int, share: float) -> Array:
        return np.asarray(np.sqrt(share) * rng.standard_normal((count, len(s))) @ root.T)

    means = np.log(0.1) - 0.5 * s - 0.3 * s * np.arange(len(truth.sizes))[:, None]
    if truth.between:
        means = np.log(0.1) - 0.5 * s + drawn(len(truth.sizes), truth.between / (1.0 - truth.between))
    objects = means[group_of] + drawn(len(group_of), truth.lasting)
    log_k = objects[object_of] + drawn(len(object_of), 1.0 - truth.lasting)
    sd = truth.noise * np.exp(0.3 * rng.standard_normal((len(object_of), 1))) * (0.5 + 2.0 * s**2)
    smooth = np.exp(-0.5 * ((s[:, None] - s) / 0.2) ** 2) + 1e-6 * np.eye(len(s))
    covariance = sd[:, :, None] * sd[:, None, :] * smooth
    log_k = log_k + sd * (rng.standard_normal(log_k.shape) @ np.linalg.cholesky(smooth).T)
    alike = np.zeros((len(truth.sizes), len(s), len(s)))
    return Made(PopulationTrial(s, log_k, covariance, object_of, group_of, alike), means, objects)
