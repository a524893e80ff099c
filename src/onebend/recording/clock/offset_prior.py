"""Which offsets between two clocks are looked at, and how likely each is before the data."""

from __future__ import annotations

import numpy as np

from onebend.recording.clock.moment_posterior import Prior, moments_of
from onebend.records import Array

ROUGHLY = 0.1  # s: a start said to be right to this or less was not read off a watch, and is taken at its word
_REACH = 20.0  # times such an uncertainty: how far beyond it is looked
_LEAST = 1e-6  # s, a smaller uncertainty counts as this
_SLACK = 0.05  # s, in the prior's sd, of a start that is known to `ROUGHLY` or worse


def search_range(film: Array, log: Array, said: float, uncertainty: float, margin: float) -> tuple[float, float, Prior]:
    """Lowest and highest offset to try, and the log of the prior over offsets. `uncertainty` is above 0."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(said) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    uncertainty = max(uncertainty, _LEAST)
    reach = reach_of(uncertainty, margin)
    scale = uncertainty / 2 + _SLACK * min(1.0, (uncertainty / ROUGHLY) ** 2)

    def prior(offset: Array) -> Array:
        away = np.abs(offset - said) / scale
        return np.asarray(-np.where(away < 2, 0.5 * away**2, 2 * away - 2))

    return max(first, said - reach), min(last, said + reach), prior


def reach_of(uncertainty: float, margin: float) -> float:
    """s, how far from what was said is looked: `margin` [s] beyond its uncertainty, less where that is small."""
    return uncertainty + min(margin, _REACH * uncertainty)


def prior_spread(low: float, high: float, prior: Prior) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return moments_of(offset, prior(offset))[1]
