"""Mean k(s) of the groups, how they differ, and k(s) of every object, each with its 95 % band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.blas import one_blas_thread
from onebend.population.covariances import Spreads, covariance
from onebend.population.fit import Fit, objects_of
from onebend.population.gaussians import inverse, moments, quantile
from onebend.records import Array

LOW, HIGH = 0.025, 0.975  # of a 95 % band


@dataclass(frozen=True)
class Curves:
    """M curves of log k (or of its difference) with their 95 % bands at S places."""

    mean: Array  # (M, S)
    low: Array  # (M, S)
    high: Array  # (M, S)


@dataclass(frozen=True)
class Objects:
    """log k(s) of every object as itself and the others of its group tell: O normals, the common error apart."""

    mean: Array  # (O, S)
    covariance: Array  # (O, S, S)


def group_means(fit: Fit) -> Curves:
    """The groups' means, with what all recordings share in the band."""
    return _banded(fit, fit.mean, _variances(fit.covariance + fit.trial.alike) + fit.trial.common_sd**2)


def differences(fit: Fit, pairs: list[tuple[int, int]]) -> Curves:
    """The first group's log k less the second's; what all recordings share drops out."""
    first, second = [list(one) for one in zip(*pairs, strict=True)]
    variance = _variances(fit.covariance + fit.trial.alike)
    return _banded(fit, fit.mean[:, first] - fit.mean[:, second], variance[:, first] + variance[:, second])


def _banded(fit: Fit, mean: Array, variance: Array) -> Curves:
    sd = np.sqrt(variance)
    low, high = (quantile(fit.weight, mean, sd, share) for share in (LOW, HIGH))
    return Curves(np.tensordot(fit.weight, mean, axes=1), low, high)


def _variances(covariances: Array) -> Array:
    return np.asarray(np.diagonal(covariances, axis1=-2, axis2=-1))


def within(fit: Fit) -> Array:
    """(S,) sd of log k within groups at each place: the root of its mean variance."""
    return np.asarray(np.sqrt(fit.weight @ _variances(covariance(fit.spreads, fit.trial.s))))


@one_blas_thread
def shrunken(fit: Fit) -> Objects:
    """Every object's own log k: its recordings drawn towards its group's mean, as far as they are the less certain.

    What all fits of a group are off by alike is in the covariances.
    """
    trial, spreads = fit.trial, fit.spreads
    size = (len(fit.weight), trial.objects, len(trial.s))
    step = max(1, 4_000_000 // (len(trial.log_k) * size[-1] ** 2))
    total, square = np.zeros(size[1:]), np.zeros((*size[1:], size[-1]))
    for first in range(0, size[0], step):
        rows = slice(first, first + step)
        mean, cov = _drawn(fit, spreads.chosen(rows), rows)
        share = fit.weight[rows]
        total += np.tensordot(share, mean, axes=1)
        square += np.einsum("n,noi,noj->oij", share, mean, mean) + np.tensordot(share, cov, axes=1)
    return Objects(total, square - total[:, :, None] * total[:, None, :] + trial.alike[trial.group_of])


def _drawn(fit: Fit, spreads: Spreads, rows: slice) -> tuple[Array, Array]:
    trial = fit.trial
    objects = objects_of(trial, spreads)
    spread = spreads.lasting[:, None, None, None] * covariance(spreads, trial.s)[:, None]
    precision, _ = inverse(objects.covariance + spread)
    pull = spread @ precision  # towards the object's own recordings
    centre, error = fit.mean[rows][:, trial.group_of], fit.covariance[rows][:, trial.group_of]
    mean = centre + np.einsum("noij,noj->noi", pull, objects.mean - centre)
    rest = np.eye(len(trial.s)) - pull
    return mean, rest @ spread + rest @ error @ np.swapaxes(rest, -1, -2)


def banded(objects: Objects, common_sd: float) -> Curves:
    """The objects' curves, with what all recordings share in the band."""
    half = 1.959963984540054 * np.sqrt(np.maximum(_variances(objects.covariance), 0.0) + common_sd**2)
    return Curves(objects.mean, objects.mean - half, objects.mean + half)


def next_object(fit: Fit) -> Objects:
    """log k of one more object of each group, before it is recorded."""
    spread = fit.spreads.lasting[:, None, None, None] * covariance(fit.spreads, fit.trial.s)[:, None]
    return Objects(*moments(fit.weight, fit.mean, fit.covariance + fit.trial.alike + spread))
