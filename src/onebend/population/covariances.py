"""How log k(s) differs between objects of one group: a level, and a smooth shape beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.population.objects import PopulationTrial
from onebend.records import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Spreads:
    """Points that the spread within groups is integrated over, N of them."""

    level_sd: Array  # (N,) of log k, of the mean along the beam
    shape_sd: Array  # (N,) of log k less its mean, RMS along the beam
    length: Array  # (N,) of correlation of the shape along s
    lasting: Array  # (N,) share of the variance that an object keeps when it is recorded again

    def chosen(self, rows: BoolArray | IntArray | slice) -> Spreads:
        """Some of the points."""
        return Spreads(self.level_sd[rows], self.shape_sd[rows], self.length[rows], self.lasting[rows])


def shape_correlation(s: Array, length: float) -> Array:
    """(S, S) covariance of a smooth curve less its mean along s, of mean variance one: squared exponential."""
    kernel = np.exp(-0.5 * ((s[:, None] - s) / length) ** 2)
    centred = kernel - kernel.mean(axis=0) - kernel.mean(axis=1)[:, None] + kernel.mean()
    return np.asarray(centred / np.mean(np.diagonal(centred)))


def covariance(spreads: Spreads, s: Array) -> Array:
    """(N, S, S) of log k(s) of a recording about its group's mean, its own error apart."""
    found = np.empty((len(spreads.length), len(s), len(s)))
    for length in np.unique(spreads.length):
        rows = spreads.length == length
        level, shape = spreads.level_sd[rows, None, None] ** 2, spreads.shape_sd[rows, None, None] ** 2
        found[rows] = level + shape * shape_correlation(s, float(length))
    return found


def log_prior(spreads: Spreads, trial: PopulationTrial) -> Array:
    """(N,) for equal steps of the logarithms of both sd: p(sd) = 1 / (sd + e), with e the sd of one recording's fit.

    Where the spread is far above e this is 1 / sd, with which the band of a mean is Student's; far below, it is flat,
    so that a spread of zero has no more weight than it should.
    """
    noise = trial.covariance
    level = np.median(np.sqrt(np.maximum(noise.mean(axis=(1, 2)), 0.0)))
    whole = np.median(np.sqrt(np.mean(np.diagonal(noise, axis1=1, axis2=2), axis=1)))
    pairs = ((spreads.level_sd, level), (spreads.shape_sd, np.sqrt(max(whole**2 - level**2, 1e-12))))
    return np.asarray(sum(np.log(sd / (sd + error)) for sd, error in pairs))
