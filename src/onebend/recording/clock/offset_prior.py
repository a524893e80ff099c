"""The range of clock offsets that is searched, and the prior over it."""

from __future__ import annotations

import numpy as np

from onebend.recording.clock.moment_posterior import Prior, moments_of
from onebend.records import Array

ROUGHLY = 0.1  # s: a start stated to this uncertainty or less was measured, and is trusted
_REACH = 20.0  # times a small uncertainty: how far beyond it is searched
_LEAST = 1e-6  # s, a smaller uncertainty counts as this
_SLACK = 0.05  # s, added to the prior's sd of a start with an uncertainty of `ROUGHLY` or more


def search_range(
    film: Array, log: Array, stated: float, uncertainty: float, margin: float
) -> tuple[float, float, Prior]:
    """The lowest and highest offset to try [s], and the log prior of offsets. `uncertainty` must be above 0."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(stated) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    uncertainty = max(uncertainty, _LEAST)
    reach = reach_of(uncertainty, margin)
    scale = uncertainty / 2 + _SLACK * min(1.0, (uncertainty / ROUGHLY) ** 2)

    def prior(offset: Array) -> Array:
        distance = np.abs(offset - stated) / scale
        return np.asarray(-np.where(distance < 2, 0.5 * distance**2, 2 * distance - 2))

    return max(first, stated - reach), min(last, stated + reach), prior


def reach_of(uncertainty: float, margin: float) -> float:
    """s, how far from the stated offset is searched: `margin` [s] beyond its uncertainty, less where that is small."""
    return uncertainty + min(margin, _REACH * uncertainty)


def prior_spread(low: float, high: float, prior: Prior) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return moments_of(offset, prior(offset))[1]
