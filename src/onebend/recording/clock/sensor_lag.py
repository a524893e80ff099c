"""A slow force sensor: one whose filter takes a good part of a second, so that its peaks are too low.

A pure delay is part of the clock's offset and does no harm. A first-order filter of time constant tau also lowers what
comes and goes within some tau: k(s) comes out too small, and the clock's offset takes up the delay, so that nothing
else shows. But the log goes on falling when the tags stand still again. So the log is compared, as in the search for
the offset, with features of the tags that went through such a filter themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from onebend.recording.clock.binned_log import BinnedLog
from onebend.recording.clock.feature_search import coarse_search
from onebend.recording.clock.moment_posterior import Prior
from onebend.recording.clock.offset import ClockSettings, averaged, compared_rows, displacements, tracks
from onebend.recording.clock.polynomial_features import Track
from onebend.recording.signals import bandwidth, low_pass, outliers, step
from onebend.records import ClockOffset, ForceLog, Markers

QUICK = (0.0, 0.2)  # s: a sensor as quick as that hardly changes k(s)
SLOW = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # s
LONGEST = 0.25  # of the film: a longer lag leaves no push to see
REACH, MARGIN = 1.0, 0.1  # offsets compared: from this many lags before the one found, and s on either side
APART, OF_LAG = 0.05, 0.1  # s between them, or this share of the lag where that is more
CERTAIN = 30.0  # log evidence of a slow sensor over a quick one; other errors that last reach half of that
FEWEST = 10  # frames, and rows of the log
REFINED = 3  # lags between two of those above


@dataclass(frozen=True)
class SensorLag:
    """A first-order lag of the force sensor."""

    tau: float  # s
    evidence: float  # its log, over that of a quick sensor


def slow_sensor(
    markers: Markers, log: ForceLog, clock: ClockOffset, *, push_s: float | None, settings: ClockSettings
) -> SensorLag | None:
    """The lag of the sensor that wrote `log`, where it is certain; `log` and `push_s` as for `fit_clock`, which found
    the `clock`."""
    rate = bandwidth(markers.time, displacements(markers))
    markers = averaged(markers, settings.most_frames)
    within = (clock.offset - REACH * SLOW[-1] - MARGIN, clock.offset + MARGIN)
    rows = compared_rows(markers, log, rate, within, settings) if clock.found and np.isfinite(rate) else None
    feature_tracks = [track for track in tracks(markers, push_s, settings) if track.covered.sum() >= FEWEST]
    if rows is None or not feature_tracks:
        return None
    return find_lag(feature_tracks[-1], rows, clock.offset, np.zeros_like)


def find_lag(track: Track, rows: BinnedLog, offset: float, prior: Prior) -> SensorLag | None:
    """The lag of the sensor that wrote the log's `rows`, where it is certain. `offset` [s] is the clock's as found."""
    rested = resting(track)
    slow = [lag for lag in SLOW if lag <= LONGEST * track.duration]

    @cache
    def at(i: int) -> float:
        return evidence(rested, rows, offset, slow[i], prior)

    best = next((i for i in range(1, len(slow), 2) if at(i) > 0.0), None)
    if best is None:
        return None
    while (higher := max(range(max(best - 1, 0), min(best + 2, len(slow))), key=at)) != best:
        best = higher
    if best + 1 >= len(slow) or not at(best) > CERTAIN:
        return None  # at the end of the range it is something else
    fine = np.geomspace((*QUICK[-1:], *slow)[best], slow[best + 1], 2 * REFINED + 3)
    logs = np.array([evidence(rested, rows, offset, lag, prior, within=float(fine[-1])) for lag in fine])
    weight = np.exp(logs - np.max(logs))
    return SensorLag(tau=float(weight @ fine / np.sum(weight)), evidence=float(np.max(logs)))


def evidence(track: Track, rows: BinnedLog, offset: float, tau: float, prior: Prior, *, within: float = 0.0) -> float:
    """Log evidence of the log under a lag `tau` [s] over that under a quick sensor, each at its likeliest offset.

    The offset found holds the delay too. Evidences of different rows cannot be compared: the rows are those that every
    offset covers, up to a lag of `within` [s] where that is longer. Minus infinity where they are too few. Where it is
    negative already over a sensor without a lag, other quick ones are not asked.
    """
    apart, reach = max(APART, OF_LAG * tau), REACH * max(tau, within)
    offsets = np.arange(offset - reach - MARGIN, offset + MARGIN + 0.5 * apart, apart)
    covered = [np.isfinite(track.mean(rows.time - shift, rows.width)).all(axis=(1, 2)) for shift in offsets]
    known = np.all(covered, axis=0)
    if known.sum() < FEWEST:
        return -np.inf
    same = replace(rows, time=rows.time[known], force=rows.force[known])

    def at_best(lag: float) -> float:
        return float(np.max(coarse_search(lagging(track, lag), same, offsets, prior).log_posterior))

    quick, slow = at_best(QUICK[0]), at_best(tau)
    if slow > quick:
        quick = max(quick, *(at_best(lag) for lag in QUICK[1:]))
    return slow - quick if np.isfinite(quick) else -np.inf


def resting(track: Track) -> Track:
    """The features with those seconds written out for which the beam, at rest in its last frames, stays so."""
    apart = step(track.time)
    more = track.time[-1] + apart * np.arange(1, int(track.after / apart) + 1)
    if not len(more):
        return track
    time, value = np.append(track.time, more), track.integral.derivative()(track.time)
    value = np.concatenate([value, np.broadcast_to(value[-1], (len(more), *value.shape[1:]))])
    covered = np.append(track.covered, np.ones(len(more), dtype=bool))
    return replace(
        track, integral=CubicSpline(time, value, axis=0).antiderivative(), covered=covered, time=time, after=0.0
    )


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
