"""Gaussian means of Gaussian means (recordings of an object, objects of a group, groups), and mixtures of normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from onebend.records import Array, IntArray

HALVINGS = 50  # of the interval in which a quantile is


@dataclass(frozen=True)
class Means:
    """Estimates of M means under N spreads."""

    mean: Array  # (N, M, S)
    covariance: Array  # (N, M, S, S) of the estimate
    log_evidence: Array  # (N, M) of what the parts say of one another, the mean being flat


def inverse(covariance: Array) -> tuple[Array, Array]:
    """(..., S, S) the inverses of covariances, and (...) the logarithms of their determinants, by Cholesky factors."""
    factor = np.linalg.cholesky(covariance)
    root = np.linalg.inv(factor)
    logs = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.swapaxes(root, -1, -2) @ root, logs


def means(parts: Array, covariance: Array, whole_of: IntArray) -> Means:
    """The means that the parts are scattered about, each with a flat prior.

    Args:
        parts: (N, R, S) or (1, R, S), what is known of each part.
        covariance: (N, R, S, S) of the parts about their mean: their error and their scatter.
        whole_of: (R,) whose part each is, from 0 to M - 1.
    """
    precision, logs = inverse(covariance)
    weighted = np.einsum("nrij,nrj->nri", precision, np.broadcast_to(parts, precision.shape[:-1]))
    squares = np.einsum("nri,nri->nr", weighted, np.broadcast_to(parts, weighted.shape))
    count = int(whole_of.max()) + 1
    together = np.stack([precision[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    pulled = np.stack([weighted[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    found, less = inverse(together)
    mean = np.einsum("nmij,nmj->nmi", found, pulled)
    own = np.stack([(logs + squares)[:, whole_of == i].sum(axis=1) for i in range(count)], axis=1)
    sizes = np.bincount(whole_of, minlength=count)
    turns = 0.5 * parts.shape[-1] * np.log(2.0 * np.pi) * (sizes - 1)
    evidence = -0.5 * (own + less - np.einsum("nmi,nmi->nm", mean, pulled)) - turns
    return Means(mean, found, evidence)


def quantile(weight: Array, mean: Array, sd: Array, share: float) -> Array:
    """(...) where the mixture of N normals, `mean` and `sd` (N, ...), has this share below it."""
    centre = ndtri(share) * sd + mean
    low, high = (np.asarray(edge(centre, axis=0)) for edge in (np.min, np.max))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        below = np.tensordot(weight, ndtr((middle - mean) / sd), axes=1) < share
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def moments(weight: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """(..., S) mean and (..., S, S) covariance of the mixture of `mean` (N, ..., S) and `covariance` (N, ..., S, S)."""
    centre = np.tensordot(weight, mean, axes=1)
    off = mean - centre
    return centre, np.tensordot(weight, covariance + off[..., :, None] * off[..., None, :], axes=1)


def weighted_quantiles(values: Array, weight: Array, shares: tuple[float, ...]) -> tuple[float, ...]:
    """Quantiles of values that have weights."""
    places, number = np.unique(values, return_inverse=True)
    share_of = np.bincount(number, weight)
    before = (np.cumsum(share_of) - 0.5 * share_of) / share_of.sum()
    return tuple(float(np.interp(share, before, places)) for share in shares)
