"""The force log averaged over bins of equal width, as the search for the clock offset uses it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from onebend.recording.signals import outliers, step
from onebend.records import Array, ForceLog, ForceNoise

LOCAL = 1.0  # s, window around a row over which the power of its changes is averaged
CHANGES = 2.0  # times the power of the noise's own changes: above it the force itself changes


@dataclass(frozen=True)
class BinnedLog:
    """The log averaged over bins of equal width, without outliers."""

    time: Array  # (N,) s, mean time of each bin's rows, log's clock
    force: Array  # (N, 2) N
    width: float  # s
    largest: float  # N, largest deviation from the median

    def walk_variance(self, noise: ForceNoise) -> Array:
        """(N,) N^2: the variance so far of a random walk that moves only where the force changes, and by as much."""
        gaps = np.diff(self.time)
        own = 2 * noise.white**2 + 2 * noise.coloured**2 * (1 - np.exp(-gaps / noise.tau)) + noise.walk**2 * gaps
        power = np.mean(np.diff(self.force, axis=0) ** 2, axis=1)
        size = max(3, round(LOCAL / self.width))
        local = uniform_filter1d(power, size, mode="nearest")
        return np.concatenate([[0.0], np.cumsum(np.where(local > CHANGES * own, local, 0.0))])


def binned(log: ForceLog, rate: float, span: tuple[float, float], highest_rate: float) -> BinnedLog:
    """The log within `span` [s] at `rate` rows per second, at most `highest_rate`, and no more than the log has."""
    inside = (log.time >= span[0]) & (log.time <= span[1]) & ~outliers(log.force, spacing=step(log.time))
    time, force = log.time[inside], log.force[inside]
    if len(time) < 10:
        return BinnedLog(np.empty(0), np.empty((0, 2)), 1.0, 0.0)
    width = 1 / min(rate, highest_rate, 1 / step(time))
    index = np.floor((time - time[0]) / width + 1e-6).astype(np.int64)
    count = np.bincount(index)
    total = np.stack([np.bincount(index, column) for column in force.T], axis=1)
    # A bin that lost most of its rows to a dropout does not stand for its whole span.
    good = count > 0.5 * np.median(count[count > 0])
    mean = total[good] / count[good, None]
    largest = float(np.abs(mean - np.median(mean, axis=0)).max())
    # The time of a bin is the mean of its samples' times, not its middle.
    return BinnedLog(np.bincount(index, time)[good] / count[good], mean, width, largest)


def thinned(rows: BinnedLog, rate: float) -> BinnedLog:
    """Rows averaged further, to at most `rate` per second."""
    size = int(np.ceil(1.0 / (rate * rows.width) - 1e-9))
    count = len(rows.time) // max(size, 1)
    if size <= 1 or count < 10:
        return rows
    time = rows.time[: count * size].reshape(count, size).mean(axis=1)
    force = rows.force[: count * size].reshape(count, size, 2).mean(axis=1)
    return BinnedLog(time, force, size * rows.width, rows.largest)
