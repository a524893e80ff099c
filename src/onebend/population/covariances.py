"""How log k(s) differs between objects of one group: a level, and a smooth shape beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.records import Array

JITTER = 1e-4  # sd of log k that no smooth shape explains: a hundredth of a percent


@dataclass(frozen=True)
class Spreads:
    """Points of the grid that the spread within groups is integrated over, N of them, with their prior."""

    level_sd: Array  # (N,) of log k, of the mean along the beam
    shape_sd: Array  # (N,) of log k less its mean, RMS along the beam
    length: Array  # (N,) of correlation of the shape along s
    lasting: Array  # (N,) share of the variance that stays with the object when it is recorded again
    log_prior: Array  # (N,)


def shape_correlation(s: Array, length: float) -> Array:
    """(S, S) covariance of a smooth curve less its mean along s, of mean variance one.

    Of the squared exponential kernel; the mean is that over the places.
    """
    kernel = np.exp(-0.5 * ((s[:, None] - s) / length) ** 2)
    centred = kernel - kernel.mean(axis=0) - kernel.mean(axis=1)[:, None] + kernel.mean()
    return np.asarray(centred / np.mean(np.diagonal(centred)))


def covariance(spreads: Spreads, s: Array) -> Array:
    """(N, S, S) of log k(s) of one recording about the group's mean: level, shape, and a little of its own."""
    found = np.empty((len(spreads.length), len(s), len(s)))
    for length in np.unique(spreads.length):
        rows = spreads.length == length
        level, shape = spreads.level_sd[rows, None, None] ** 2, spreads.shape_sd[rows, None, None] ** 2
        found[rows] = level + shape * shape_correlation(s, float(length))
    return found
