"""The force log as the clock search sees it: averaged over even bins, and where in it the force changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from onebend.recording.signals import outliers, step
from onebend.records import Array, ForceLog, ForceNoise

LOCAL = 1.0  # s around a row from which its changes are read
CHANGES = 2.0  # times the power of the noise's own changes: more is a force that changes


@dataclass(frozen=True)
class Rows:
    """The log averaged over even bins (boxcar), outliers left out."""

    time: Array  # (N,) s, mean time of each bin's rows, log's clock
    force: Array  # (N, 2) N
    width: float  # s
    largest: float  # N, largest deviation from the median

    def moved(self, noise: ForceNoise) -> Array:
        """(N,) N^2, rising: variance of a random walk that changes where, and as much as, the force does."""
        apart = np.diff(self.time)
        own = 2 * noise.white**2 + 2 * noise.coloured**2 * (1 - np.exp(-apart / noise.tau)) + noise.walk**2 * apart
        power = np.mean(np.diff(self.force, axis=0) ** 2, axis=1)
        size = max(3, round(LOCAL / self.width))
        near = uniform_filter1d(power, size, mode="nearest")
        return np.concatenate([[0.0], np.cumsum(np.where(near > CHANGES * own, near, 0.0))])


def binned(log: ForceLog, wanted: float, span: tuple[float, float], most: float) -> Rows:
    """The log within `span` [s], averaged: `wanted` rows per second, at most `most` and no more than the log has."""
    inside = (log.time >= span[0]) & (log.time <= span[1]) & ~outliers(log.force)
    time, force = log.time[inside], log.force[inside]
    if len(time) < 10:
        return Rows(np.empty(0), np.empty((0, 2)), 1.0, 0.0)
    width = 1 / min(wanted, most, 1 / step(time))
    index = np.floor((time - time[0]) / width + 1e-6).astype(np.int64)
    count = np.bincount(index)
    total = np.stack([np.bincount(index, column) for column in force.T], axis=1)
    # A bin that lost most of its rows to a dropout does not stand for its whole span.
    good = count > 0.5 * np.median(count[count > 0])
    mean = total[good] / count[good, None]
    largest = float(np.abs(mean - np.median(mean, axis=0)).max())
    # A sample stands for its own time, not for the middle of the bin that it happens to fall in.
    return Rows(np.bincount(index, time)[good] / count[good], mean, width, largest)


def thinned(rows: Rows, most: float) -> Rows:
    """Rows averaged further, to at most `most` a second."""
    size = int(np.ceil(1.0 / (most * rows.width) - 1e-9))
    count = len(rows.time) // max(size, 1)
    if size <= 1 or count < 10:
        return rows
    time = rows.time[: count * size].reshape(count, size).mean(axis=1)
    force = rows.force[: count * size].reshape(count, size, 2).mean(axis=1)
    return Rows(time, force, size * rows.width, rows.largest)
