"""The offset between two clocks by polynomials of the tags: a look over the whole range, then around the best peak."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import Rows, thinned
from onebend.recording.clock.moment_posterior import Prior, moments_of
from onebend.recording.clock.polynomial_features import Track
from onebend.recording.force.noise import first_guess, fit_noise, log_evidence
from onebend.records import Array, ForceNoise

LONG = 12.0  # s: offsets of a longer range are looked through roughly first
FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows a film; log chance below the best that is not looked at again
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are looked at again, and how far around them, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: what an offset of the first, second look may leave unexplained
LEAST = 0.2  # s, looked at closely on either side of the first estimate


@dataclass(frozen=True)
class Search:
    """One way to explain the log, tried at all offsets."""

    track: Track
    noise: ForceNoise
    chance: Array  # log posterior over the coarse offsets


def likely_span(searches: list[Search], coarse: Array, first: float, low: float, high: float) -> tuple[float, float]:
    """s, lowest and highest offset that is worth a closer look."""
    chance = np.max([search.chance - search.chance.max() for search in searches], axis=0)
    good = coarse[chance > -UNLIKELY]
    return max(low, min(float(good.min()), first - LEAST)), min(high, max(float(good.max()), first + LEAST))


def likely_offsets(track: Track, rows: Rows, low: float, high: float, rate: float) -> Array:
    """Offsets to try from `low` to `high` [s], dense; of a long range only those around what a first look finds."""
    most = min(0.05, 0.1 * (high - low))
    fine = np.arange(low, high + most, min(most, 0.25 / rate))
    if high - low < LONG:
        return fine
    look = np.arange(low, high, max(min(0.25, 0.25 / rate), 0.05))
    thin = thinned(rows, FIRST_LOOK / track.duration)
    chance = chances(track, thin, look, roughly(first_guess(thin.force, thin.width), FAR_OFF * rows.largest))
    best = np.argsort(-chance)[:MOST_LOOKS]
    good = look[best[chance[best] >= chance.max() - UNLIKELY]]
    return np.asarray(fine[np.abs(fine[:, None] - good).min(axis=1) < AROUND])


def roughly(noise: ForceNoise, size: float) -> ForceNoise:
    """`noise` with a coloured part of at least `size` [N]: what offsets that are a little off leave unexplained."""
    return replace(noise, coloured=max(noise.coloured, size), tau=max(noise.tau, 0.5))


def coarse_search(track: Track, rows: Rows, offset: Array, prior: Prior) -> Search:
    """The log posterior over all offsets, with the noise fitted at the best of them, twice."""
    noise = first_guess(rows.force, rows.width)
    chance = np.full(len(offset), -np.inf)
    for size in (NEAR * rows.largest, 0.0):
        chance = chances(track, rows, offset, roughly(noise, size) if size else noise)
        if not np.isfinite(chance).any():
            break
        design = rows.largest * track.mean(rows.time - offset[int(np.argmax(chance + prior(offset)))], rows.width)
        use = np.isfinite(design).all(axis=(1, 2))
        noise = fit_noise(rows.time[use], design[use], rows.force[use], noise)
    return Search(track, noise, chance + prior(offset))


def chances(track: Track, rows: Rows, offset: Array, noise: ForceNoise) -> Array:
    """Log evidence of every offset; minus infinity where film and log have too little in common.

    Each offset covers other rows with film, so they are compared by what the markers add to the rows they cover: the
    evidence with them over the evidence without, which takes a force that changes for a random walk and a force that
    stands still for noise. A film laid over a quiet stretch of the log gains nothing.
    """
    chance = np.full(len(offset), -np.inf)
    least = max(10.0, 0.25 * min(len(rows.time), track.duration / rows.width))
    moved = rows.moved(first_guess(rows.force, rows.width))
    reach = (track.time[0] - track.before - rows.width, track.time[-1] + track.after + rows.width)
    none: dict[bytes, float] = {}
    roots: dict[bytes, Array] = {}
    for i, each in enumerate(offset):
        near = np.arange(*np.searchsorted(rows.time, (reach[0] + each, reach[1] + each)))
        if len(near) < least:
            continue
        design = rows.largest * track.mean(rows.time[near] - each, rows.width)
        told = np.isfinite(design).all(axis=(1, 2))
        use, design = near[told], design[told]
        if len(use) < least:
            continue
        time, force, key = rows.time[use], rows.force[use], use.tobytes()
        if key not in roots:
            roots[key] = noise.root(time)
            walk = np.minimum(moved[use][:, None], moved[use]) - moved[use][0]
            root = np.linalg.cholesky(noise.covariance(time) + walk)
            nothing = np.zeros((len(time), 2, 2)) + 10 * rows.largest * np.eye(2)
            none[key] = log_evidence(root, nothing, force)
        chance[i] = log_evidence(roots[key], design, force) - none[key]
    return chance


def refined(search: Search, rows: Rows, coarse: Array, prior: Prior) -> tuple[float, float]:
    """Mean and sd of the posterior around its highest peak; other peaks widen the sd by their share."""
    centre = float(coarse[int(np.argmax(search.chance))])
    reach = max(3 * (coarse[1] - coarse[0]), min(0.1, 0.25 * float(np.ptp(coarse))))
    mean, sd = centre, float("inf")
    for _ in range(6):
        offset = np.linspace(centre - reach, centre + reach, 33)
        gain = fixed_rows(search, rows, offset)
        if gain is None:
            break
        mean, sd = moments_of(offset, gain + prior(offset))
        if 0.08 * reach < sd < 0.3 * reach and abs(mean - centre) < 0.5 * reach:
            break
        centre, reach = mean, min(max(4.5 * sd, 1e-3), 2 * reach)
    return mean, with_other_peaks(search, rows, coarse, mean, max(sd, 1e-3), reach)


def with_other_peaks(search: Search, rows: Rows, coarse: Array, mean: float, sd: float, reach: float) -> float:
    """`sd` of the peak at `mean` widened by the share of all that lies farther away than `reach`."""
    best = float(coarse[int(np.argmax(search.chance))])
    ends = fixed_rows(search, rows, np.array([best, mean]))
    away = np.abs(coarse - mean) > max(reach, 4 * sd)
    if ends is None or not away.any():
        return sd
    # The coarse offsets may straddle a sharp peak: its own height, then its mass as a normal distribution.
    peak = float(search.chance.max() + max(ends[1] - ends[0], 0.0))
    mass = np.exp(search.chance[away] - peak) * (coarse[1] - coarse[0])
    whole = float(mass.sum()) + sd * np.sqrt(2 * np.pi)
    return float(np.sqrt(sd**2 + mass @ (coarse[away] - mean) ** 2 / whole))


def fixed_rows(search: Search, rows: Rows, offset: Array) -> Array | None:
    """Log evidence at every `offset`, over the rows that all of them cover; None where these are too few."""
    designs = [rows.largest * search.track.mean(rows.time - each, rows.width) for each in offset]
    use = np.all([np.isfinite(design).all(axis=(1, 2)) for design in designs], axis=0)
    if use.sum() < 10:
        return None
    root = search.noise.root(rows.time[use])
    return np.array([log_evidence(root, design[use], rows.force[use]) for design in designs])
