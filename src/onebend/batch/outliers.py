"""Recordings whose k(s) is unlike that of the others in their group: by robust scores of its level and its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from onebend.batch.record import PLACES
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

    level: Array  # (N,) of the mean of log k
    shape: Array  # (N,) of how far log k, less its mean, is from the median shape (RMS); not negative
    reasons: tuple[str, ...]  # N; empty: no outlier


def scores(log_k: Array, sd: Array, groups: Sequence[str]) -> Scores:
    """Scores from log k (N, S) at PLACES, NaN where nothing was learned, its sd (N, S), and the groups (N).

    What is nearer to the median than its own band allows is no outlier: a recording's own sd is the least scale.
    """
    level, shape = np.full(len(log_k), np.nan), np.full(len(log_k), np.nan)
    reasons = [""] * len(log_k)
    for group in sorted(set(groups)):
        rows = [i for i, one in enumerate(groups) if one == group and np.isfinite(log_k[i]).all()]
        if len(rows) < FEWEST:
            continue
        mean = log_k[rows].mean(axis=1)
        own = np.sqrt(np.mean(sd[rows] ** 2, axis=1))
        level[rows] = (mean - np.median(mean)) / np.maximum(_spread(mean), own)
        off = log_k[rows] - mean[:, None]
        off -= np.median(off, axis=0)
        far = np.sqrt(np.mean(off**2, axis=1))
        shape[rows] = far / np.maximum(MAD_TO_SD * np.median(far), own)
        limit = limit_of(len(rows))
        for row, one, less in zip(rows, off, mean - np.median(mean), strict=True):
            reasons[row] = _reason(level[row], shape[row], one, float(less), limit)
    return Scores(level, shape, tuple(reasons))


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


def _reason(level: float, shape: float, off: Array, less: float, limit: float) -> str:
    said = []
    if abs(level) > limit:
        said.append(f"k is {np.exp(less):.2g} times the group's median ({abs(level):.2g} robust sd)")
    if shape > limit:
        at = int(np.argmax(np.abs(off)))
        said.append(
            f"the shape of k(s) is {np.exp(off[at]):.2g} times the group's at s = {PLACES[at]:.2g} "
            f"({shape:.2g} robust sd)"
        )
    return "; ".join(said)
