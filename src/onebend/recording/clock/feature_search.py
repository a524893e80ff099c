"""The clock offset from features of the tags: a search over the whole range, then around the highest peak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import BinnedLog, thinned
from onebend.recording.clock.moment_posterior import Prior, moments_of
from onebend.recording.clock.polynomial_features import Track
from onebend.recording.force.noise import LinearModel, first_guess, fit_noise, layout_of, linear_model, log_evidence
from onebend.recording.force.noise_factor import NoiseFactor, noise_factor
from onebend.records import Array, ForceNoise, IntArray

LONG = 12.0  # s: a longer range is searched roughly first
FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows per film in the rough search; log evidence below the best that is dropped
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are searched finely, and how far around each, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: residual of an offset on the rough, the fine grid
IMPROBABLE = 8.0  # log posterior below the highest peak at which another one is left: a share of 3e-4
LEAST = 0.2  # s, searched finely on either side of the first estimate at least


@dataclass(frozen=True)
class OffsetScan:
    """One set of features, with its log posterior at all offsets."""

    track: Track
    noise: ForceNoise
    log_posterior: Array  # over the coarse offsets


def likely_span(
    searches: list[OffsetScan], coarse: Array, first: float, low: float, high: float
) -> tuple[float, float]:
    """s, the lowest and the highest offset that need a finer search."""
    log_ratio = np.max([search.log_posterior - search.log_posterior.max() for search in searches], axis=0)
    good = coarse[log_ratio > -UNLIKELY]
    return max(low, min(float(good.min()), first - LEAST)), min(high, max(float(good.max()), first + LEAST))


def peaks(searches: Sequence[OffsetScan], coarse: Array) -> list[float]:
    """s, the offsets at which the posterior of a search has a maximum that may be the right one; the highest of each
    search first."""
    found: list[tuple[float, float]] = []
    for search in searches:
        p = np.concatenate([[-np.inf], search.log_posterior - search.log_posterior.max(), [-np.inf]])
        top = (p[1:-1] >= p[:-2]) & (p[1:-1] >= p[2:]) & (p[1:-1] > -IMPROBABLE)
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
    if high - low < LONG:
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
    """The log posterior over all offsets. The noise is fitted at the best offset, twice."""
    noise, laid = first_guess(rows.force, rows.width), laid_over(track, rows, offset)
    log_ratio = np.full(len(offset), -np.inf)
    for size in (NEAR * rows.largest, 0.0):
        log_ratio = evidence_ratios(laid, rows, with_slow_noise(noise, size) if size else noise)
        if not np.isfinite(log_ratio).any():
            break
        best = laid[int(np.argmax(log_ratio + prior(offset)))]
        assert best is not None  # its ratio is finite
        noise = fit_noise(rows.time[best.use], best.model, noise)
    return OffsetScan(track, noise, log_ratio + prior(offset))


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

    Each offset lets the film cover other rows of the log, so evidences of different rows must be compared. The ratio
    is that of the evidence with the markers over the evidence without them, of the same rows. Without markers a
    changing force counts as a random walk, a constant force as noise: a film laid over a quiet part gains nothing.
    """
    log_ratio = np.full(len(laid), -np.inf)
    walk_variance = rows.walk_variance(first_guess(rows.force, rows.width))
    of_rows: dict[bytes, tuple[NoiseFactor, float]] = {}
    for i, film in enumerate(laid):
        if film is None:
            continue
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
