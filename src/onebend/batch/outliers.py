"""Recordings whose k(s) is unlike that of the others in their group: by robust scores of its level and its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from onebend.records import Array

FEWEST = 5  # recordings of a group, for the others to have a spread
MAD_TO_SD = 1.4826  # of a normal
FALSE_ALARMS = 0.025  # of groups in which nothing differs, for the level and again for the shape
# The largest score of a normal group of that number, at 1 - FALSE_ALARMS (simulated: tests/batch/test_outliers.py). The
# median of absolute deviations of few varies much, so that scores of small groups do too.
NUMBERS = (5, 6, 7, 8, 9, 10, 11, 12, 15, 20, 25, 30, 50, 100, 200, 1000)
LIMITS = (11.3, 7.2, 7.6, 6.1, 6.3, 5.5, 5.6, 5.2, 4.95, 4.5, 4.4, 4.25, 4.06, 3.98, 4.02, 4.25)


@dataclass(frozen=True)
class Scores:
    """How far recordings are from the median of their group, in robust standard deviations; NaN: too few others."""

    level: Array  # (N,) of the mean of log k, weighted by how well the group's recordings tell it
    shape: Array  # (N,) of how far log k, less its mean, is from the median shape (RMS, so weighted); not negative
    reasons: tuple[str, ...]  # N; empty: no outlier


def scores(log_k: Array, covariance: Array, groups: Sequence[str]) -> Scores:
    """Scores from log k (N, S) at S places from s = 0 to 1, NaN where nothing was learned, its covariance (N, S, S),
    and the groups (N).

    What is nearer to the median than its own band allows is no outlier: a recording's own sd is the least scale.
    """
    level, shape = np.full(len(log_k), np.nan), np.full(len(log_k), np.nan)
    reasons = [""] * len(log_k)
    for group in sorted(set(groups)):
        rows = [i for i, one in enumerate(groups) if one == group and np.isfinite(log_k[i]).all()]
        if len(rows) < FEWEST:
            continue
        weight = 1.0 / np.median(np.diagonal(covariance[rows], axis1=1, axis2=2), axis=0)
        weight /= weight.sum()
        mean = log_k[rows] @ weight
        level[rows] = (mean - np.median(mean)) / np.maximum(_spread(mean), _own_sd(covariance[rows], weight))
        off = log_k[rows] - mean[:, None]
        off -= np.median(off, axis=0)
        far = np.sqrt(off**2 @ weight)
        shape[rows] = far / np.maximum(MAD_TO_SD * np.median(far), _own_shape_sd(covariance[rows], weight))
        limit = limit_of(len(rows))
        for row, one, less in zip(rows, off * np.sqrt(weight), mean - np.median(mean), strict=True):
            at = int(np.argmax(np.abs(one)))
            there = (at / (len(one) - 1), float(one[at] / np.sqrt(weight[at])))
            reasons[row] = _reason(float(level[row]), float(shape[row]), there, float(less), limit)
    return Scores(level, shape, tuple(reasons))


def _own_sd(covariance: Array, weight: Array) -> Array:
    """(N,) sd of the weighted mean of log k, as the recordings' own bands have it."""
    return np.asarray(np.sqrt(np.einsum("s,nst,t->n", weight, covariance, weight)))


def _own_shape_sd(covariance: Array, weight: Array) -> Array:
    """(N,) weighted RMS sd of log k less its mean."""
    whole = np.diagonal(covariance, axis1=1, axis2=2) @ weight
    return np.asarray(np.sqrt(np.maximum(whole - _own_sd(covariance, weight) ** 2, 0.0)))


def limit_of(count: int) -> float:
    """The score beyond which a recording of a group of `count` is named.

    A shape that varies in more than one way has smaller scores than the level, so that its alarms are rarer.
    """
    if count > NUMBERS[-1]:  # the spread is as good as known: Bonferroni
        return float(ndtri(1.0 - FALSE_ALARMS / (2 * count)))
    return float(np.interp(np.log(count), np.log(NUMBERS), LIMITS))


def _spread(values: Array) -> float:
    """Robust sd, by the median of absolute deviations."""
    return max(MAD_TO_SD * float(np.median(np.abs(values - np.median(values)))), 1e-12)


def _reason(level: float, shape: float, there: tuple[float, float], less: float, limit: float) -> str:
    """In words.

    Args:
        there: s where the shape is farthest off, and log k off there.
    """
    said = []
    if abs(level) > limit:
        said.append(f"k is {np.exp(less):.2g} times the group's median ({abs(level):.2g} robust sd)")
    if shape > limit:
        where = f"at s = {there[0]:.2g} ({shape:.2g} robust sd)"
        said.append(f"the shape of k(s) is {np.exp(there[1]):.2g} times the group's {where}")
    return "; ".join(said)
