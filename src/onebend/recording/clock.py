"""The offset between the film's clock and the force log's, with its posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from onebend.recording.clock_likelihood import (
    STEP_DOUBT,
    BinnedLog,
    Prior,
    Track,
    binned,
    make_moments,
    make_track,
    mixed,
    moments_of,
    offset_from_moments,
    thinned,
)
from onebend.recording.force_noise import (
    LinearModel,
    NoiseFactor,
    first_guess,
    fit_noise,
    layout_of,
    linear_model,
    log_evidence,
    noise_factor,
)
from onebend.recording.signals import bandwidth, low_pass, outliers, step
from onebend.records import Array, ClockOffset, ForceLog, ForceNoise, IntArray, Markers, Remark

ROUGHLY = 0.1  # s: a start stated to this uncertainty or less was measured, and is trusted


def search_range(
    film: Array, log: Array, stated: float, uncertainty: float, margin: float
) -> tuple[float, float, Prior]:
    """The lowest and highest offset to try [s], and the log prior of offsets. `uncertainty` must be above 0."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(stated) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    uncertainty = max(uncertainty, 1e-6)  # s, a smaller uncertainty counts as this
    reach = reach_of(uncertainty, margin)
    # s, added to the prior's sd of a start with an uncertainty of `ROUGHLY` or more.
    scale = uncertainty / 2 + 0.05 * min(1.0, (uncertainty / ROUGHLY) ** 2)

    def prior(offset: Array) -> Array:
        distance = np.abs(offset - stated) / scale
        return np.asarray(-np.where(distance < 2, 0.5 * distance**2, 2 * distance - 2))

    return max(first, stated - reach), min(last, stated + reach), prior


def reach_of(uncertainty: float, margin: float) -> float:
    """s, how far from the stated offset is searched: `margin` [s] beyond its uncertainty, less where that is small."""
    return uncertainty + min(margin, 20.0 * uncertainty)  # times a small uncertainty: how far beyond it is searched


def prior_spread(low: float, high: float, prior: Prior) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return moments_of(offset, prior(offset))[1]


FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows per film in the rough search; log evidence below the best that is dropped
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are searched finely, and how far around each, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: residual of an offset on the rough, the fine grid
LEAST = 0.2  # s, searched finely on either side of the first estimate at least


@dataclass(frozen=True)
class OffsetScan:
    """One set of features, with its log posterior at all offsets."""

    track: Track
    log_posterior: Array  # over the coarse offsets
    noise_at_best: Callable[[], ForceNoise]  # is fitted

    @cached_property
    def noise(self) -> ForceNoise:
        """The likeliest at the best offset."""
        return self.noise_at_best()


def likely_span(
    searches: list[OffsetScan], coarse: Array, first: float, low: float, high: float
) -> tuple[float, float]:
    """s, the lowest and the highest offset that need a finer search."""
    log_ratio = np.max([search.log_posterior - search.log_posterior.max() for search in searches], axis=0)
    good = coarse[log_ratio > -UNLIKELY]
    return max(low, min(float(good.min()), first - LEAST)), min(high, max(float(good.max()), first + LEAST))


def peaks(searches: Sequence[OffsetScan], coarse: Array) -> list[float]:
    """s, the offsets at which a search's posterior has a maximum; the highest of each search first."""
    found: list[tuple[float, float]] = []
    for search in searches:
        p = np.concatenate([[-np.inf], search.log_posterior - search.log_posterior.max(), [-np.inf]])
        # Log posterior below the highest peak at which another one is left: a share of 3e-4.
        top = (p[1:-1] >= p[:-2]) & (p[1:-1] >= p[2:]) & (p[1:-1] > -8.0)
        found += zip((-p[1:-1][top]).tolist(), coarse[top].tolist(), strict=True)
    return [offset for _, offset in sorted(found, key=lambda one: one[0])]


def apart(offsets: Sequence[float], distance: float) -> list[float]:
    """Those of the offsets [s] that are farther than a distance from all before them."""
    kept: list[float] = []
    for one in offsets:
        if all(abs(one - other) > distance for other in kept):
            kept.append(one)
    return kept


def likely_offsets(track: Track, rows: BinnedLog, low: float, high: float, rate: float) -> Array:
    """A fine grid of offsets from `low` to `high` [s]; of a long range only those near the peaks of a rough search."""
    spacing = min(0.05, 0.1 * (high - low))
    fine = np.arange(low, high + spacing, min(spacing, 0.25 / rate))
    if high - low < 12.0:  # s: a longer range is searched roughly first
        return fine
    rough = np.arange(low, high, max(min(0.25, 0.25 / rate), 0.05))
    few_rows = thinned(rows, FIRST_LOOK / track.duration)
    log_ratio = log_evidence_ratios(
        track, few_rows, rough, with_slow_noise(first_guess(few_rows.force, few_rows.width), FAR_OFF * rows.largest)
    )
    best = np.argsort(-log_ratio)[:MOST_LOOKS]
    likely = rough[best[log_ratio[best] >= log_ratio.max() - UNLIKELY]]
    return np.asarray(fine[np.abs(fine[:, None] - likely).min(axis=1) < AROUND])


def with_slow_noise(noise: ForceNoise, size: float) -> ForceNoise:
    """`noise` with a coloured part of at least `size` [N]: the residual of an offset between grid points."""
    return replace(noise, coloured=max(noise.coloured, size), tau=max(noise.tau, 0.5))


def coarse_search(track: Track, rows: BinnedLog, offset: Array, prior: Prior) -> OffsetScan:
    """The log posterior over all offsets, under the noise that is likeliest at the best one of a first look."""
    laid = laid_over(track, rows, offset)

    def fitted(log_posterior: Array, start: ForceNoise) -> ForceNoise:
        best = laid[int(np.argmax(log_posterior))]
        return start if best is None else fit_noise(rows.time[best.use], best.model, start)

    def searched(noise: ForceNoise) -> Array:
        return evidence_ratios(laid, rows, noise) + prior(offset)

    start = first_guess(rows.force, rows.width)
    noise = fitted(searched(with_slow_noise(start, NEAR * rows.largest)), start)
    log_posterior = searched(noise)
    return OffsetScan(track, log_posterior, lambda: fitted(log_posterior, noise))


@dataclass(frozen=True)
class LaidOver:
    """The film over the log at one offset."""

    use: IntArray  # (n,) rows of the log that it covers
    model: LinearModel  # of them


def laid_over(track: Track, rows: BinnedLog, offset: Array) -> list[LaidOver | None]:
    """The film over the log at every offset; None where they have too little in common."""
    least = max(10.0, 0.25 * min(len(rows.time), track.duration / rows.width))
    reach = (track.time[0] - track.before - rows.width, track.time[-1] + track.after + rows.width)
    layout, out = layout_of(track.integral.derivative()(track.time)), list[LaidOver | None]()
    for shift in offset:
        covered = np.arange(*np.searchsorted(rows.time, (reach[0] + shift, reach[1] + shift)))
        design = rows.largest * track.mean(rows.time[covered] - shift, rows.width)
        known = np.isfinite(design).all(axis=(1, 2))
        use = covered[known]
        out.append(LaidOver(use, linear_model(design[known], rows.force[use], layout)) if len(use) >= least else None)
    return out


def log_evidence_ratios(track: Track, rows: BinnedLog, offset: Array, noise: ForceNoise) -> Array:
    """Log evidence ratio of every offset; minus infinity where film and log overlap too little."""
    return evidence_ratios(laid_over(track, rows, offset), rows, noise)


def evidence_ratios(laid: Sequence[LaidOver | None], rows: BinnedLog, noise: ForceNoise) -> Array:
    """Log evidence ratio of every offset; minus infinity where film and log overlap too little.

    Each offset covers other rows of the log. So the evidence with the markers is divided by that without them, of the
    same rows. Without markers a changing force counts as a random walk, a constant one as noise."""
    log_ratio = np.full(len(laid), -np.inf)
    walk_variance = rows.walk_variance(first_guess(rows.force, rows.width))
    of_rows: dict[bytes, tuple[NoiseFactor, float]] = {}
    for i, film in ((i, film) for i, film in enumerate(laid) if film is not None):
        if (key := film.use.tobytes()) not in of_rows:
            time = rows.time[film.use]
            nothing = np.zeros((len(time), 2, 2)) + 10 * rows.largest * np.eye(2)
            walks = noise_factor(noise, time, walk_variance[film.use])
            without = log_evidence(walks, linear_model(nothing, rows.force[film.use]))
            of_rows[key] = noise_factor(noise, time), without
        factor, without = of_rows[key]
        log_ratio[i] = log_evidence(factor, film.model) - without
    return log_ratio


def refined(search: OffsetScan, rows: BinnedLog, coarse: Array, prior: Prior) -> tuple[float, float]:
    """Mean and sd of the posterior around its highest peak. Other peaks widen the sd by their probability."""
    centre = float(coarse[int(np.argmax(search.log_posterior))])
    reach = max(3 * (coarse[1] - coarse[0]), min(0.1, 0.25 * float(np.ptp(coarse))))
    mean, sd = centre, float("inf")
    for _ in range(6):
        offset = np.linspace(centre - reach, centre + reach, 33)
        gain = evidence_over_same_rows(search, rows, offset)
        if gain is None:
            break
        mean, sd = moments_of(offset, gain + prior(offset))
        if 0.08 * reach < sd < 0.3 * reach and abs(mean - centre) < 0.5 * reach:
            break
        centre, reach = mean, min(max(4.5 * sd, 1e-3), 2 * reach)
    return mean, with_other_peaks(search, rows, coarse, mean, max(sd, 1e-3), reach)


def with_other_peaks(search: OffsetScan, rows: BinnedLog, coarse: Array, mean: float, sd: float, reach: float) -> float:
    """`sd` of the peak at `mean`, widened by the probability of offsets farther away than `reach`."""
    best = float(coarse[int(np.argmax(search.log_posterior))])
    ends = evidence_over_same_rows(search, rows, np.array([best, mean]))
    outside = np.abs(coarse - mean) > max(reach, 4 * sd)
    if ends is None or not outside.any():
        return sd
    # The coarse offsets may straddle a sharp peak: its own height, then its mass as a normal distribution.
    peak = float(search.log_posterior.max() + max(ends[1] - ends[0], 0.0))
    mass = np.exp(search.log_posterior[outside] - peak) * (coarse[1] - coarse[0])
    total = float(mass.sum()) + sd * np.sqrt(2 * np.pi)
    return float(np.sqrt(sd**2 + mass @ (coarse[outside] - mean) ** 2 / total))


def evidence_over_same_rows(search: OffsetScan, rows: BinnedLog, offset: Array) -> Array | None:
    """Log evidence at every `offset` over the rows that all of them cover; None where these are too few."""
    designs = [rows.largest * search.track.mean(rows.time - shift, rows.width) for shift in offset]
    use = np.all([np.isfinite(design).all(axis=(1, 2)) for design in designs], axis=0)
    if use.sum() < 10:
        return None
    factor, layout = noise_factor(search.noise, rows.time[use]), layout_of(designs[0][use])
    return np.array([log_evidence(factor, linear_model(design[use], rows.force[use], layout)) for design in designs])


AS_WRITTEN = "start_s is used as it is written"
TOO_LITTLE = (
    f"Film and log share too little force and motion to match the clocks; {AS_WRITTEN}. Push further, or measure "
    "start_s."
)


def unsettled_remark(shift: float, sd: float, uncertainty: float) -> Remark:
    """The remark where the offset stays uncertain (`sd` [s]); `shift` [s]: the best offset less the stated one."""
    if uncertainty < ROUGHLY and abs(shift) > uncertainty + 3.0 * sd:  # sd of the data beyond the uncertainty
        text = f"The data would have the film start {shift:+.3f} s from start_s, more than its uncertainty"
        text += f"; {AS_WRITTEN}. If it may be wrong, give a larger start_uncertainty_s."
        return Remark("warning", text, about="clock")
    if uncertainty < ROUGHLY:
        return Remark("note", f"The data tell the clocks' offset no better than start_uncertainty_s; {AS_WRITTEN}.")
    text = f"The clocks could not be matched from the data (one sd {sd:.2g} s); {AS_WRITTEN}. Check it."
    return Remark("warning", text, about="clock")


def remarks_on(clock: ClockOffset, uncertainty: float, low: float, high: float) -> tuple[Remark, ...]:
    """Warnings and notes on an offset that was found."""
    remarks = []
    if min(clock.offset - low, high - clock.offset) < 2 * clock.sd:
        text = "The clock offset found lies at the edge of the range searched; give a better start_s in [video]."
        remarks.append(Remark("warning", text, about="clock"))
    elif abs(clock.offset - clock.stated) > uncertainty + 2 * clock.sd:
        text = f"The film starts {clock.offset - clock.stated:+.2f} s from start_s, more than its uncertainty. Correct "
        remarks.append(Remark("warning", f"{text}start_s.", about="clock"))
    if clock.sd > 0.1:
        text = f"The clocks are matched to {clock.sd:.2f} s (one sd) only: the push is slow or weak."
        remarks.append(Remark("note", text))
    return tuple(remarks)


# For every offset the log is modelled by features of the markers with unknown coefficients, plus the sensor's noise.
# The evidence of the log is the likelihood of the offset. Three choices matter:
# - The log's rows stay fixed and the markers are shifted: other rows would have other noise.
# - Coefficients are integrated out under a prior, not fitted: a free function of the displacement fits any offset.
# - The noise has coloured and random-walk parts, whose sizes come from the same data. A push whose force rises at F'
#   [N/s] during T under a noise of spectral density S determines the offset to about sqrt(S / (F'^2 T)), and no method
#   does better.

APART, MOST_FIRST = 0.15, 6  # s: estimates of the offset that are farther apart are each looked at closely


@dataclass(frozen=True)
class ClockSettings:
    """How the offset is searched."""

    margin: float = 2.0  # s, searched beyond the stated offset and its uncertainty
    corrections: tuple[float, ...] = (0.001, 0.01)  # prior sds, tried in turn, of what corrects the levers
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

    The prior takes `uncertainty` [s] as two sd of `stated`, with exponential tails; where `stated` is NaN, all offsets
    that put half of the film inside the log are equally likely. `found` is False where the posterior sd is more than
    half of the prior's. An `uncertainty` of 0 says that `stated` is exact. With the place of the push `push_s`, `log`
    must be in the beam's axes (its sign and bias do not matter). The beam must move slowly against its own
    oscillations."""
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
    """The log's rows that the film may cover at offsets `within` [s]; None where they are too few, or nothing moves."""
    if not np.isfinite(rate):
        return None
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
    rows = compared_rows(markers, log, rate, (offset, offset), settings)
    if rows is None:
        return None
    searches = [
        coarse_search(one, rows, np.array([offset]), np.zeros_like) for one in tracks(markers, push_s, settings)
    ]
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

    The first search models the force by features of the tags, the second by the moments of a push at a known place."""
    low, high = within
    feature_tracks = tracks(markers, push_s, settings)
    if not feature_tracks:
        return None
    coarse = likely_offsets(feature_tracks[-1], rows, low, high, rate)
    searches = [coarse_search(track, rows, coarse, prior) for track in feature_tracks]
    moments = None
    if push_s is not None:
        moments = make_moments(markers, push_s=push_s, longest_gap=settings.longest_gap, hold=settings.hold)
    which = int(np.argmax([search.log_posterior.max() for search in searches]))
    searches.append(coarse_search(tracks(markers, push_s, settings, settings.steps)[which], rows, coarse, prior))
    searches = [search for search in searches if np.isfinite(search.log_posterior).any()]
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
    """Mean and sd [s] of the offset over sets of features, weighted by their evidence, if their sd is finite."""
    mean, sd = np.transpose(ends)
    mass = np.array([np.logaddexp.reduce(search.log_posterior) for search in searches])
    kept = np.isfinite(sd)
    if not kept.any():
        return float(mean[int(np.argmax(mass))]), float("inf")
    return mixed(mass[kept], mean[kept], sd[kept])


def tracks(markers: Markers, push_s: float | None, settings: ClockSettings, steps: float = 0.0) -> list[Track]:
    """The sets of features: polynomials alone, and levers with small and with larger polynomials."""
    same = {"longest_gap": settings.longest_gap, "hold": settings.hold, "steps": steps}
    ways = [(None, 1.0)] + ([(push_s, scale) for scale in settings.corrections] if push_s is not None else [])
    made = [make_track(markers, push_s=push_place, polynomials=scale, **same) for push_place, scale in ways]
    return [track for track in made if track is not None and track.covered.sum() >= FEWEST]


def averaged(markers: Markers, most: int) -> Markers:
    """The markers in at most `most` frames, each the mean of equally many neighbours; missing where half are."""
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


# A slow sensor's filter delays and lowers peaks: k(s) comes out too small, and the offset takes up the delay. But the
# log goes on falling when the tags stand still. So it is compared with features that went through such a filter.

QUICK = (0.0, 0.2)  # s: a sensor as quick as that hardly changes k(s)
SLOW = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # s
REACH, MARGIN = 1.0, 0.1  # offsets compared: from this many lags before the one found, and s on either side
LAGS_APART, OF_LAG = 0.05, 0.1  # s between them, or this share of the lag where that is more
FEWEST = 10  # frames, and rows of the log


@dataclass(frozen=True)
class SensorLag:
    """A first-order lag of the force sensor."""

    tau: float  # s
    evidence: float  # its log, over that of a quick sensor


def slow_sensor(
    markers: Markers, log: ForceLog, clock: ClockOffset, *, push_s: float | None, settings: ClockSettings
) -> SensorLag | None:
    """The lag of the sensor that wrote `log`, where it is certain; arguments as of `fit_clock`, which found `clock`."""
    rate = bandwidth(markers.time, displacements(markers))
    markers = averaged(markers, settings.most_frames)
    within = (clock.offset - REACH * SLOW[-1] - MARGIN, clock.offset + MARGIN)
    rows = compared_rows(markers, log, rate, within, settings) if clock.found else None
    feature_tracks = tracks(markers, push_s, settings)
    if rows is None or not feature_tracks:
        return None
    return find_lag(feature_tracks[-1], rows, clock.offset, np.zeros_like)


def find_lag(track: Track, rows: BinnedLog, offset: float, prior: Prior) -> SensorLag | None:
    """The lag of the sensor that wrote the log's `rows`, where it is certain. `offset` [s] is the clock's as found."""
    rested = resting(track)
    slow = [lag for lag in SLOW if lag <= 0.25 * track.duration]  # of the film: a longer lag leaves no push to see

    @cache
    def at(i: int) -> float:
        return evidence(rested, rows, offset, slow[i], prior)

    best = next((i for i in range(1, len(slow), 2) if at(i) > 0.0), None)
    if best is None:
        return None
    while (higher := max(range(max(best - 1, 0), min(best + 2, len(slow))), key=at)) != best:
        best = higher
    # Log evidence of a slow sensor over a quick one; other errors that last reach half of that.
    if best + 1 >= len(slow) or not at(best) > 30.0:
        return None  # at the end of the range it is something else
    fine = np.geomspace((*QUICK[-1:], *slow)[best], slow[best + 1], 9)
    logs = np.array([evidence(rested, rows, offset, lag, prior, within=float(fine[-1])) for lag in fine])
    weight = np.exp(logs - np.max(logs))
    return SensorLag(tau=float(weight @ fine / np.sum(weight)), evidence=float(np.max(logs)))


def evidence(track: Track, rows: BinnedLog, offset: float, tau: float, prior: Prior, *, within: float = 0.0) -> float:
    """Log evidence of the log under a lag `tau` [s] over that under a quick sensor, each at its likeliest offset.

    The rows are those that every offset covers, up to a lag of `within` [s]; minus infinity where they are too few.
    Where it is negative over a sensor without a lag, other quick ones are not tried."""
    apart, reach = max(LAGS_APART, OF_LAG * tau), REACH * max(tau, within)
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
    """The log without its sensor's lag `tau` [s]: `F + tau F'`, low-passed at `cutoff` [Hz] against noise."""
    bad = outliers(log.force, spacing=step(log.time))
    known = [np.interp(log.time, log.time[~bad], column[~bad]) for column in log.force.T]
    smooth = low_pass(log.time, np.stack(known, axis=1), cutoff, longest_gap=max(0.1, 3.0 * step(log.time)))
    return replace(log, force=smooth + tau * np.gradient(smooth, log.time, axis=0))


def lagging(track: Track, tau: float) -> Track:
    """The features behind a first-order filter of time constant `tau` [s], at rest before the film."""
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
