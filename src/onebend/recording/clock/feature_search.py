"""The clock offset from features of the tags: a search over the whole range, then around the highest peak."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import BinnedLog, thinned
from onebend.recording.clock.moment_posterior import Prior, moments_of
from onebend.recording.clock.polynomial_features import Track
from onebend.recording.force.noise import first_guess, fit_noise, log_evidence
from onebend.records import Array, ForceNoise

LONG = 12.0  # s: a longer range is searched roughly first
FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows per film in the rough search; log evidence below the best that is dropped
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are searched finely, and how far around each, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: residual of an offset on the rough, the fine grid
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
    noise = first_guess(rows.force, rows.width)
    log_ratio = np.full(len(offset), -np.inf)
    for size in (NEAR * rows.largest, 0.0):
        log_ratio = log_evidence_ratios(track, rows, offset, with_slow_noise(noise, size) if size else noise)
        if not np.isfinite(log_ratio).any():
            break
        design = rows.largest * track.mean(rows.time - offset[int(np.argmax(log_ratio + prior(offset)))], rows.width)
        use = np.isfinite(design).all(axis=(1, 2))
        noise = fit_noise(rows.time[use], design[use], rows.force[use], noise)
    return OffsetScan(track, noise, log_ratio + prior(offset))


def log_evidence_ratios(track: Track, rows: BinnedLog, offset: Array, noise: ForceNoise) -> Array:
    """Log evidence ratio of every offset; minus infinity where film and log overlap too little.

    Each offset lets the film cover other rows of the log, so evidences of different rows must be compared. The ratio
    is that of the evidence with the markers over the evidence without them, of the same rows. Without markers a
    changing force counts as a random walk, a constant force as noise: a film laid over a quiet part gains nothing.
    """
    log_ratio = np.full(len(offset), -np.inf)
    least = max(10.0, 0.25 * min(len(rows.time), track.duration / rows.width))
    walk_variance = rows.walk_variance(first_guess(rows.force, rows.width))
    reach = (track.time[0] - track.before - rows.width, track.time[-1] + track.after + rows.width)
    without: dict[bytes, float] = {}
    roots: dict[bytes, Array] = {}
    for i, shift in enumerate(offset):
        covered = np.arange(*np.searchsorted(rows.time, (reach[0] + shift, reach[1] + shift)))
        if len(covered) < least:
            continue
        design = rows.largest * track.mean(rows.time[covered] - shift, rows.width)
        known = np.isfinite(design).all(axis=(1, 2))
        use, design = covered[known], design[known]
        if len(use) < least:
            continue
        time, force, key = rows.time[use], rows.force[use], use.tobytes()
        if key not in roots:
            roots[key] = noise.root(time)
            walk = np.minimum(walk_variance[use][:, None], walk_variance[use]) - walk_variance[use][0]
            root = np.linalg.cholesky(noise.covariance(time) + walk)
            nothing = np.zeros((len(time), 2, 2)) + 10 * rows.largest * np.eye(2)
            without[key] = log_evidence(root, nothing, force)
        log_ratio[i] = log_evidence(roots[key], design, force) - without[key]
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
    root = search.noise.root(rows.time[use])
    return np.array([log_evidence(root, design[use], rows.force[use]) for design in designs])
