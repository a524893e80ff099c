"""Recordings whose k(s) is unlike that of the others in their group: by robust scores of its level and its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.batch.record import PLACES
from onebend.records import Array

FEWEST = 5  # recordings of a group, for the others to have a spread
FAR = 3.5  # robust standard deviations (Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993)
MAD_TO_SD = 1.4826  # of a normal


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
        for row, one, less in zip(rows, off, mean - np.median(mean), strict=True):
            reasons[row] = _reason(level[row], shape[row], one, float(less))
    return Scores(level, shape, tuple(reasons))


def _spread(values: Array) -> float:
    """Robust sd, by the median of absolute deviations."""
    return max(MAD_TO_SD * float(np.median(np.abs(values - np.median(values)))), 1e-12)


def _reason(level: float, shape: float, off: Array, less: float) -> str:
    said = []
    if abs(level) > FAR:
        said.append(f"k is {np.exp(less):.2g} times the group's median ({abs(level):.2g} robust sd)")
    if shape > FAR:
        at = int(np.argmax(np.abs(off)))
        said.append(
            f"the shape of k(s) is {np.exp(off[at]):.2g} times the group's at s = {PLACES[at]:.2g} "
            f"({shape:.2g} robust sd)"
        )
    return "; ".join(said)
