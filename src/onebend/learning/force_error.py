"""The error that is left in a force log: slow, correlated, zero-mean after the tare.

After filter and tare the log differs from the true force by what the sensor's own coloured noise and drift left in.
It is written as a cubic spline in time whose knots are as dense as the filter's cut-off lets it change. Prior of the
coefficients: independent (sd `coloured`) plus a random walk (`walk`, per root second) from an unknown level. What is
faster than the knots counts as noise of each frame. In the rests the true force is zero, so there the log shows its
error itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.records import Array, IntArray, Observations

LEVEL_SD = 0.05  # N per largest force: what a tare may miss altogether
_MARGIN = 0.2  # s, kept away from contact when a rest is read
_MOST_KNOTS = 150
_SPACING = 0.15  # of the period of the cut-off
_MEMORY = 2.0  # knots: correlation length of low-passed noise


@dataclass(frozen=True)
class ForceError:
    """Knots of one recording."""

    knots: Array  # (K,) s
    weights: Array  # (T, K): the error at each used frame is `weights @ values`
    rest_weights: Array  # (R, K): at instants of rest
    rest_values: Array  # (R, 2) N, the log there
    largest: float  # N

    def covariance(self, coloured: float, walk: float) -> Array:
        """(K, K) N^2 of one axis."""
        t = self.knots - self.knots[0] if len(self.knots) else self.knots
        lag = (t[:, None] - t[None, :]) / (_MEMORY * (t[1] - t[0]))
        out = coloured**2 * (np.exp(-0.5 * lag**2) + 0.03 * np.eye(len(t)))
        out = out + walk**2 * np.minimum(t[:, None], t[None, :])
        return np.asarray(out + (LEVEL_SD * self.largest) ** 2)


def force_error(observations: Observations, time: Array) -> ForceError:
    """Knots for the frames at `time` (T,) and the rests of the recording's force log."""
    clean = observations.clean_force
    largest = float(np.nanmax(np.linalg.norm(observations.force, axis=1))) if len(time) else 0.0
    largest = max(largest, 1e-6)  # only weight acts: no error either, but nothing may be divided by zero
    spacing = 0.3
    rest_time, rest_force = np.zeros(0), np.zeros((0, 2))
    if clean is not None:
        if np.isfinite(clean.cutoff) and clean.cutoff > 0.0:
            spacing = _SPACING / clean.cutoff
        loaded = observations.time[observations.loaded]
        if len(loaded):
            free = np.zeros(len(clean.time), dtype=bool)
            if not observations.loaded[0]:
                free |= clean.time < loaded[0] - _MARGIN
            if not observations.loaded[-1]:  # held to the end of the film, the log after it says nothing
                free |= clean.time > loaded[-1] + _MARGIN
            free &= np.all(np.isfinite(clean.force), axis=1)
            pick = _spread(clean.time, np.flatnonzero(free).astype(np.int64), 0.5 * spacing)
            rest_time, rest_force = clean.time[pick], clean.force[pick]
    everything = np.concatenate([time, rest_time])
    begin, end = float(np.min(everything)), float(np.max(everything))
    count = int(np.clip(np.ceil((end - begin) / spacing) + 3, 4, _MOST_KNOTS))
    step = (end - begin) / (count - 3)
    knots = np.asarray(begin + step * (np.arange(count) - 1.0), dtype=float)
    return ForceError(knots, spline_weights(knots, time), spline_weights(knots, rest_time), rest_force, largest)


def spline_weights(knots: Array, time: Array) -> Array:
    """(T, K) values at `time` of cubic B-splines centred at the evenly spaced `knots` (they sum to 1 inside)."""
    u = np.abs(time[:, None] - knots) / (knots[1] - knots[0])
    near = 2.0 / 3.0 - u**2 + 0.5 * u**3
    far = (2.0 - np.minimum(u, 2.0)) ** 3 / 6.0
    weights = np.where(u < 1.0, near, far)
    return np.asarray(weights / np.sum(weights, axis=1, keepdims=True))


def _spread(time: Array, rows: IntArray, step: float) -> IntArray:
    """A subset of `rows` whose times are at least `step` apart."""
    chosen: list[int] = []
    last = -np.inf
    for row in rows:
        if time[row] - last >= step:
            chosen.append(int(row))
            last = time[row]
    return np.asarray(chosen, dtype=np.int64)
