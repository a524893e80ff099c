"""The hierarchical model: objects of a group scatter about its mean, recordings about their object.

    log k of a recording = mean of its group + its object's deviation + the occasion's deviation + the fit's error

Means have flat priors, deviations are Gaussian with `covariances.covariance`, of which the share `lasting` is the
object's, and the fit's error has the covariance of its posterior. Given the spreads all is linear and Gaussian; the
spreads, alike in all groups, are integrated over a grid that closes in on where their evidence is (restricted maximum
likelihood would take its top alone).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from onebend.blas import one_blas_thread
from onebend.population.covariances import Spreads, covariance, log_prior
from onebend.population.gaussians import Means, means
from onebend.population.objects import PopulationTrial
from onebend.records import Array

LEAST_SD, MOST_SD = 1e-3, 3.0  # of log k
LENGTHS = (0.1, 0.25, 0.6)
POINTS, FEWER = 11, 7  # of an axis of the grid; where there is a third axis
ROUNDS = 5  # at most, of closing in
TAIL = 1e-4  # of the weight that a range may lose on either side
AT_ONCE = 4_000_000  # numbers of the largest array


@dataclass(frozen=True)
class Fit:
    """The population, given its trial: N spreads with weights, and the groups' means under each."""

    trial: PopulationTrial
    spreads: Spreads
    weight: Array  # (N,) sums to one
    mean: Array  # (N, G, S) of log k
    covariance: Array  # (N, G, S, S) of that mean, what all recordings share apart


@one_blas_thread
def fit(trial: PopulationTrial) -> Fit:
    """Close in on the spreads."""
    points = FEWER if trial.repeated else POINTS
    axes = [np.linspace(np.log(LEAST_SD), np.log(MOST_SD), points)] * 2
    axes.append(np.linspace(0.02, 0.98, points) if trial.repeated else np.ones(1))
    for i in range(ROUNDS):
        found = _on_grid(trial, axes)
        closer = [_closer(axis, share) for axis, share in zip(axes, _shares(found, axes), strict=True)]
        if i == ROUNDS - 1 or all(
            len(a) < 2 or np.ptp(b) > 0.75 * np.ptp(a) for a, b in zip(axes, closer, strict=True)
        ):
            break
        axes = closer
    kept = found.weight > 1e-5 * found.weight.max()
    weight = found.weight[kept] / found.weight[kept].sum()
    return Fit(trial, found.spreads.chosen(kept), weight, found.mean[kept], found.covariance[kept])


def _on_grid(trial: PopulationTrial, axes: list[Array]) -> Fit:
    points = np.array(list(product(*axes, LENGTHS)))
    spreads = Spreads(np.exp(points[:, 0]), np.exp(points[:, 1]), points[:, 3], points[:, 2])
    step = max(1, AT_ONCE // (len(trial.log_k) * len(trial.s) ** 2))
    parts = [_given(trial, spreads.chosen(slice(i, i + step))) for i in range(0, len(points), step)]
    log = np.concatenate([evidence for _, evidence in parts]) + log_prior(spreads, trial)
    weight = np.exp(log - log.max())
    return Fit(
        trial,
        spreads,
        weight / weight.sum(),
        np.concatenate([one.mean for one, _ in parts]),
        np.concatenate([one.covariance for one, _ in parts]),
    )


def _given(trial: PopulationTrial, spreads: Spreads) -> tuple[Means, Array]:
    """The groups' means, and (N,) the logarithm of the evidence."""
    objects = objects_of(trial, spreads)
    spread = spreads.lasting[:, None, None, None] * covariance(spreads, trial.s)[:, None]
    groups = means(objects.mean, objects.covariance + spread, trial.group_of)
    return groups, objects.log_evidence.sum(axis=1) + groups.log_evidence.sum(axis=1)


def objects_of(trial: PopulationTrial, spreads: Spreads) -> Means:
    """What the recordings of each object say of it, without the other objects; (1, O, ...) where none has two."""
    if not trial.repeated:
        rows = np.argsort(trial.object_of)
        return Means(trial.log_k[None, rows], trial.noise[None, rows], np.zeros((1, trial.objects)))
    passing = (1.0 - spreads.lasting)[:, None, None, None] * covariance(spreads, trial.s)[:, None]
    return means(trial.log_k[None], trial.noise + passing, trial.object_of)


def _shares(found: Fit, axes: list[Array]) -> list[Array]:
    """The weight at each point of each axis."""
    whole = found.weight.reshape([len(axis) for axis in axes] + [len(LENGTHS)])
    return [np.asarray(whole.sum(axis=tuple(j for j in range(whole.ndim) if j != i))) for i in range(len(axes))]


def _closer(axis: Array, share: Array) -> Array:
    """The axis from one point before where the weight begins to one after where it ends."""
    before = np.cumsum(share)
    first = max(int(np.searchsorted(before, TAIL)) - 1, 0)
    last = min(int(np.searchsorted(before, 1.0 - TAIL)) + 1, len(axis) - 1)
    return np.linspace(axis[first], axis[last], len(axis))
