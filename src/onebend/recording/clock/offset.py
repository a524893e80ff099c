"""The offset between the video's clock and the force log's, from the data.

For every offset the log is modelled by features of the markers with unknown coefficients (`polynomial_features.py`:
levers and polynomials; no stiffness enters) plus the sensor's noise. The evidence of the log under this model is the
likelihood of the offset. Three choices matter for the accuracy:

- the log's rows stay fixed and the markers are shifted. Shifting the log would compare different samples of its noise,
  whose scatter is larger than the effect of an offset of some hundredths of a second;
- coefficients are integrated out under a prior (evidence), not fitted: for a push in one direction a free function of
  the displacement fits any offset, and the maximum would claim more accuracy than there is;
- the noise has coloured and random-walk parts (`noise.py`); its sizes come from the same data.

A push whose force rises at F' [N/s] during T under a noise of spectral density S tells the offset to about
sqrt(S / (F'^2 T)), and no method does better: slow pushes with a weak force leave tens of milliseconds in `sd`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import BinnedLog, binned, thinned
from onebend.recording.clock.feature_search import (
    OffsetScan,
    apart,
    coarse_search,
    likely_offsets,
    likely_span,
    peaks,
    refined,
)
from onebend.recording.clock.messages import TOO_LITTLE, remarks_on, unsettled_remark
from onebend.recording.clock.moment_posterior import STEP_DOUBT, Prior, offset_from_moments
from onebend.recording.clock.offset_prior import ROUGHLY, prior_spread, search_range
from onebend.recording.clock.polynomial_features import Track, make_track
from onebend.recording.clock.span_moments import make_moments
from onebend.recording.signals import bandwidth
from onebend.records import Array, ClockOffset, ForceLog, ForceNoise, Markers, Remark

APART, MOST_FIRST = 0.15, 6  # s: estimates of the offset that are farther apart are each looked at closely


@dataclass(frozen=True)
class ClockSettings:
    """How the offset is searched."""

    margin: float = 2.0  # s, searched beyond the stated offset and its uncertainty
    corrections: tuple[float, ...] = (
        0.001,
        0.01,
    )  # prior sds, tried in turn, of the polynomials that correct the levers
    most_rows: int = 250  # of the log, after averaging
    most_frames: int = 4000  # of the film; where there are more, neighbours are averaged: some sixteen a row are left
    sharp_rows: int = 120  # of these, for the model by the spans' moments
    slowest: float = 5.0  # rows per second at least
    longest_gap: float = 0.25  # s, a marker missing longer is not interpolated
    steps: float = 0.3  # of the largest force: sd of a log's error that changes where the load begins, reverses, ends
    hold: float = 2.0  # s before (after) the film for which a beam at rest in its first (last) frames stays so


@dataclass(frozen=True)
class ClockFit:
    """The offset, and the noise of the log (None where it was not fitted)."""

    clock: ClockOffset
    noise: ForceNoise | None
    remarks: tuple[Remark, ...] = ()


def fit_clock(
    markers: Markers,
    log: ForceLog,
    stated: float,
    uncertainty: float,
    *,
    push_s: float | None = None,
    settings: ClockSettings = ClockSettings(),
) -> ClockFit:
    """The posterior of the offset between the two clocks.

    The prior takes `uncertainty` [s] as two sd of `stated`, with exponential tails beyond. Where `stated` is NaN,
    offsets that put half of the film or more inside the log are equally likely. The clock's `found` is False where the
    posterior sd is more than half of the prior's; the offset is then the stated one. An `uncertainty` of 0 says that
    `stated` is exact: it is taken with an sd of 0, and only the log's noise is fitted. `push_s` is the place of the
    push; with it, `log` must be in the beam's axes (its sign and bias do not matter).

    Assumes that the film and the log both show the push, that what bends the beam is the logged force, and that the
    beam moves slowly against its own oscillations for most of the film.
    """
    if uncertainty == 0.0 and np.isfinite(stated):
        exact = ClockOffset(offset=stated, sd=0.0, stated=stated, found=True)
        return ClockFit(exact, noise_at(markers, log, stated, push_s, settings))
    low, high, prior = search_range(markers.time, log.time, stated, uncertainty, settings.margin)
    spread = prior_spread(low, high, prior)
    doubt = min(spread, uncertainty) if uncertainty < ROUGHLY else spread if np.isfinite(uncertainty) else np.inf
    unsettled = ClockOffset(offset=stated, sd=doubt, stated=stated, found=False)
    rate = bandwidth(markers.time, displacements(markers))
    markers = averaged(markers, settings.most_frames)
    if not np.isfinite(rate) or high <= low:
        return ClockFit(unsettled, None, (Remark("note", "Nothing moves in the film: the clocks cannot be matched."),))
    rows = compared_rows(markers, log, rate, (low, high), settings)
    match = None if rows is None else matched(markers, rows, rate, push_s, (low, high), prior, settings)
    if match is None:
        return ClockFit(unsettled, None, (Remark("warning", TOO_LITTLE, about="clock"),))
    offset, sd, noise = match
    if not sd < 0.5 * spread:
        return ClockFit(unsettled, noise, (unsettled_remark(offset - stated, sd, uncertainty),))
    clock = ClockOffset(offset=offset, sd=sd, stated=stated, found=True)
    return ClockFit(clock, noise, remarks_on(clock, uncertainty, low, high))


def compared_rows(
    markers: Markers, log: ForceLog, rate: float, within: tuple[float, float], settings: ClockSettings
) -> BinnedLog | None:
    """The log's rows that the film may cover at offsets `within` [s]; None where they are too few, or all zero."""
    span = (markers.time[0] + within[0], markers.time[-1] + within[1])
    highest_rate = settings.most_rows / float(np.ptp(markers.time) + settings.hold)
    rows = binned(log, max(8 * rate, settings.slowest), span, highest_rate)
    return rows if len(rows.time) >= 10 and rows.largest > 0 else None


def noise_at(
    markers: Markers, log: ForceLog, offset: float, push_s: float | None, settings: ClockSettings
) -> ForceNoise | None:
    """The log's noise at a known offset [s]; None where film and log have too little in common."""
    rate = bandwidth(markers.time, displacements(markers))
    markers = averaged(markers, settings.most_frames)
    rows = compared_rows(markers, log, rate, (offset, offset), settings) if np.isfinite(rate) else None
    if rows is None:
        return None
    feature_tracks = [track for track in tracks(markers, push_s, settings) if track.covered.sum() >= 10]
    searches = [coarse_search(track, rows, np.array([offset]), np.zeros_like) for track in feature_tracks]
    searches = [search for search in searches if np.isfinite(search.log_posterior).all()]
    return max(searches, key=lambda search: float(search.log_posterior[0])).noise if searches else None


def matched(
    markers: Markers,
    rows: BinnedLog,
    rate: float,
    push_s: float | None,
    within: tuple[float, float],
    prior: Prior,
    settings: ClockSettings,
) -> tuple[float, float, ForceNoise] | None:
    """Offset [s] between `within`, its sd [s] and the log's noise; None where film and log have too little in common.

    A first search models the force by features of the tags; a second one by the moments of the push, if its place is
    known.
    """
    low, high = within
    feature_tracks = [track for track in tracks(markers, push_s, settings) if track.covered.sum() >= 10]
    if not feature_tracks:
        return None
    coarse = likely_offsets(feature_tracks[-1], rows, low, high, rate)
    searches = [coarse_search(track, rows, coarse, prior) for track in feature_tracks]
    moments = None
    if push_s is not None:
        moments = make_moments(markers, push_s=push_s, longest_gap=settings.longest_gap, hold=settings.hold)
    which = int(np.argmax([search.log_posterior.max() for search in searches]))
    stepped = coarse_search(tracks(markers, push_s, settings, settings.steps)[which], rows, coarse, prior)
    searches = [search for search in (*searches, stepped) if np.isfinite(search.log_posterior).any()]
    if not searches:
        return None
    best = max(searches, key=lambda search: float(search.log_posterior.max()))
    offset, sd = refined(best, rows, coarse, prior)
    if moments is not None:
        few = thinned(rows, max(4 * rate, settings.sharp_rows / (moments.track.duration + settings.hold)))
        firsts = apart([offset, *peaks(searches, coarse)], APART)[:MOST_FIRST]
        sharp = offset_from_moments(moments, few, likely_span(searches, coarse, offset, low, high), firsts, prior)
        if sharp is not None:
            return sharp
    ends = [(offset, sd) if search is best else refined(search, rows, coarse, prior) for search in searches]
    ends[-1] = ends[-1][0], float(np.hypot(ends[-1][1], STEP_DOUBT))
    return *averaged_over(searches, ends), best.noise


def averaged_over(searches: Sequence[OffsetScan], ends: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and sd [s] of the offset, over sets of features that the log's evidence does not tell apart; those whose
    peak has no finite sd are left out, and where none has one the sd is infinite."""
    mean, sd = np.transpose(ends)
    mass = np.array([np.logaddexp.reduce(search.log_posterior) for search in searches])
    kept = np.isfinite(sd)
    if not kept.any():
        return float(mean[int(np.argmax(mass))]), float("inf")
    share = np.exp(mass[kept] - np.logaddexp.reduce(mass[kept]))
    middle = float(share @ mean[kept])
    return middle, float(np.sqrt(share @ (sd[kept] ** 2 + (mean[kept] - middle) ** 2)))


def tracks(markers: Markers, push_s: float | None, settings: ClockSettings, steps: float = 0.0) -> list[Track]:
    """The sets of features: polynomials alone, and levers with small and with larger polynomials."""
    same = {"longest_gap": settings.longest_gap, "hold": settings.hold, "steps": steps}
    ways = [(None, 1.0)] + ([(push_s, scale) for scale in settings.corrections] if push_s is not None else [])
    made = [make_track(markers, push_s=push_place, polynomials=scale, **same) for push_place, scale in ways]
    return [track for track in made if track is not None]


def averaged(markers: Markers, most: int) -> Markers:
    """The markers in at most `most` frames, each the mean of equally many neighbours; missing where half of these
    are."""
    size = -(-len(markers.time) // most)
    if size == 1:
        return markers
    count = len(markers.time) // size

    def mean(values: Array) -> Array:
        blocks = values[: count * size].reshape(count, size, *values.shape[1:])
        seen = np.isfinite(blocks)
        known = np.sum(seen, axis=1)
        total = np.sum(np.where(seen, blocks, 0.0), axis=1)
        return np.where(2 * known > size, total / np.maximum(known, 1), np.nan)

    return replace(
        markers,
        time=mean(markers.time),
        xy=mean(markers.xy),
        angle=mean(markers.angle),
        covariance=mean(markers.covariance) / size,
        base_angle=mean(markers.base_angle),
        by_camera=None if markers.by_camera is None else mean(markers.by_camera),
    )


def displacements(markers: Markers) -> Array:
    """(T, 2m) m, every marker's x and y against their medians; markers never seen are left out."""
    flat = markers.xy.reshape(len(markers.time), -1)
    flat = flat[:, np.isfinite(flat).any(axis=0)]
    return np.asarray(flat - np.nanmedian(flat, axis=0)) if flat.size else np.zeros((len(markers.time), 1))
