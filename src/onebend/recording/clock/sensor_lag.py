"""A slow force sensor: one whose filter takes a good part of a second, so that its peaks are too low.

A pure delay is part of the clock's offset and does no harm. A first-order filter of time constant tau also lowers what
comes and goes within some tau: k(s) comes out too small, and the clock's offset takes up the delay, so that nothing
else shows. But the log goes on falling when the tags stand still again. So the log is compared, as in the search for
the offset, with features of the tags that went through such a filter themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from onebend.recording.clock.binned_log import BinnedLog
from onebend.recording.clock.feature_search import coarse_search
from onebend.recording.clock.moment_posterior import Prior
from onebend.recording.clock.offset import ClockSettings, compared_rows, displacements, tracks
from onebend.recording.clock.polynomial_features import Track
from onebend.recording.signals import bandwidth, low_pass, outliers, step
from onebend.records import Array, ClockOffset, ForceLog, Markers

QUICK = (0.0, 0.1, 0.2)  # s: a sensor as quick as that hardly changes k(s)
SLOW = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # s
LONGEST = 0.25  # of the film: a longer lag leaves no push to see
REACH, MARGIN = 1.0, 0.1  # offsets compared: from this many lags before the one found, and s on either side
APART, OF_LAG = 0.05, 0.1  # s between them, or this share of the lag where that is more
CERTAIN = 15.0  # log evidence of a slow sensor over a quick one
FEWEST = 10  # frames
REFINED = 5  # lags between two of the grid


@dataclass(frozen=True)
class SensorLag:
    """A first-order lag of the force sensor."""

    tau: float  # s
    gain: float  # log evidence over a quick sensor


def slow_sensor(
    markers: Markers, log: ForceLog, clock: ClockOffset, *, push_s: float | None, settings: ClockSettings
) -> SensorLag | None:
    """The lag of the sensor that wrote `log`, where it is certain; `log` and `push_s` as for `fit_clock`, which found
    the `clock`."""
    rate = bandwidth(markers.time, displacements(markers))
    within = (clock.offset - REACH * SLOW[-1] - MARGIN, clock.offset + MARGIN)
    rows = compared_rows(markers, log, rate, within, settings) if clock.found and np.isfinite(rate) else None
    feature_tracks = [track for track in tracks(markers, push_s, settings) if track.covered.sum() >= FEWEST]
    if rows is None or not feature_tracks:
        return None
    return find_lag(feature_tracks[-1], rows, clock.offset, np.zeros_like)


def find_lag(track: Track, rows: BinnedLog, offset: float, prior: Prior) -> SensorLag | None:
    """The lag of the sensor that wrote the log's `rows`, where it is certain. `offset` [s] is the clock's as found."""
    same = replace(track, after=0.0)  # the beam may rest after the film; the log of a slow sensor does not
    quick = max(_evidence(same, rows, offset, lag, prior) for lag in QUICK)
    slow = [lag for lag in SLOW if lag <= LONGEST * track.duration]
    every_other = [_evidence(same, rows, offset, lag, prior) - quick for lag in slow[1::2]]
    if not max(every_other, default=-np.inf) > 0.0:
        return None
    gains = np.array([_evidence(same, rows, offset, lag, prior) for lag in slow]) - quick
    best = int(np.argmax(gains)) if len(gains) else 0
    if not np.isfinite(quick) or best + 1 >= len(slow) or not float(gains[best]) > CERTAIN:
        return None  # at the end of the range it is something else
    ends = (*QUICK[-1:], *slow)[best], slow[best + 1]
    fine = np.geomspace(*ends, 2 * REFINED + 1)
    gains = np.array([_evidence(same, rows, offset, lag, prior) for lag in fine]) - quick
    weight = np.exp(gains - np.max(gains))
    return SensorLag(tau=float(weight @ fine / np.sum(weight)), gain=float(np.max(gains)))


def without_lag(log: ForceLog, tau: float, cutoff: float) -> ForceLog:
    """The log as a sensor without its first-order lag `tau` [s] would have written it: `F + tau F'`, of the log
    low-passed at `cutoff` [Hz], since the derivative would raise its noise."""
    bad = outliers(log.force, spacing=step(log.time))
    known = [np.interp(log.time, log.time[~bad], column[~bad]) for column in log.force.T]
    smooth = low_pass(log.time, np.stack(known, axis=1), cutoff, longest_gap=max(0.1, 3.0 * step(log.time)))
    return replace(log, force=smooth + tau * np.gradient(smooth, log.time, axis=0))


def lagging(track: Track, tau: float) -> Track:
    """The features behind a first-order filter of time constant `tau` [s], at rest before the film; exact where they
    run straight between frames."""
    if tau == 0.0:
        return track
    time, value = track.time, track.integral.derivative()(track.time)
    out = np.empty_like(value)
    out[0] = value[0]
    for i, apart in enumerate(np.diff(time)):
        slope = (value[i + 1] - value[i]) / apart
        steady = value[i] - tau * slope  # the filter's output on this line, had it always run so
        out[i + 1] = steady + apart * slope + np.exp(-apart / tau) * (out[i] - steady)
    return replace(track, integral=CubicSpline(time, out, axis=0).antiderivative())


def _evidence(track: Track, rows: BinnedLog, offset: float, tau: float, prior: Prior) -> float:
    """Log evidence of the log under a lag `tau` [s], at its likeliest offset; the offset found holds the delay too."""
    apart = max(APART, OF_LAG * tau)
    offsets: Array = np.arange(offset - REACH * tau - MARGIN, offset + MARGIN + 0.5 * apart, apart)
    return float(np.max(coarse_search(lagging(track, tau), rows, offsets, prior).log_posterior))
