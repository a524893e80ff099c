"""The offset between film and log where the place of the push is known: its posterior from the spans' moments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import Rows
from onebend.recording.clock.likelihood import (
    Model,
    around,
    covariance,
    evidence,
    fitted_noise,
    found_jumps,
    nearly,
    rough_compliance,
    tied,
)
from onebend.recording.clock.span_moments import Moments, Seen, grown, seen_at
from onebend.recording.force.noise import first_guess
from onebend.records import Array, ForceNoise

TYPICAL, LARGE = 0.01, 0.1  # of the largest force: by how much a log's error changes with the load, mostly, at most
STEP, MOST = 0.02, 31  # s between offsets of the first look at least, and how many there are at most
FINE = 15  # offsets of each of the looks that follow, over as much as
REACH = 4.0  # sd to either side
TURNS = 2  # of parameters, noise and jumps at one offset
MOST_TURNS, SETTLED = 4, 2e-3  # of these with the offset; s, a change of it that they do not notice
FEWEST = 10  # rows
LOOKS, NEXT = 3, 0.3  # after the first look; s, offsets as near as this to the mean tell how fine they are
FINEST = 1e-3  # s, least sd that is claimed
STEP_DOUBT = 0.05  # s, one sd: when and how a log's error changes with the load nobody knows, where it does
UNLIKELY = 8.0  # log chance below the best: a part of 3e-4 of all
FIRST, FAST = 10, 3  # rounds of the parameters at one offset, and from there at another one


Prior = Callable[[Array], Array]  # log of the prior over offsets, less a constant


@dataclass(frozen=True)
class Shared:
    """What holds at all offsets of a search: the rows that all of them cover, and the model of these."""

    moments: Moments
    time: Array  # (N,) s, log's clock
    width: float  # s
    force: Array  # (N, 2) N, with the sign of the force on the beam
    film: Seen  # the whole film
    model: Model

    def seen(self, offset: float) -> Seen:
        return seen_at(self.moments, self.time - offset, self.width)


@dataclass(frozen=True)
class Explained:
    """The log's error and the likeliest parameters at one offset."""

    noise: ForceNoise
    jumps: Array  # (N,) N^2
    z: Array
    chance: float  # log prior of the jumps, against that of the likeliest ones
    jumped: float  # N, one sd of all jumps that are larger than most
    share: float = 1.0  # chance of this explanation


def sharpened(
    moments: Moments, rows: Rows, span: tuple[float, float], first: float, prior: Prior
) -> tuple[float, float, ForceNoise] | None:
    """Mean [s] and sd [s] of the offset over `span` [s], and the noise; None where film and log share too little.

    `first` [s]: an estimate of the offset. The noise is that at the likeliest offset: found at `first`, then again.
    """
    wide = span[1] - span[0]
    offsets = np.arange(span[0], span[1] + 1e-9, max(min(STEP, wide / FEWEST), wide / (MOST - 1)))
    shared, z = common(moments, rows, np.append(offsets, first), first)
    if shared is None:
        return None
    best = first
    for _ in range(MOST_TURNS):
        known = explanations(shared, best, z)
        mean, sd = looked_at(shared, offsets, known, prior)
        before, best, z = best, mean, known[0].z
        if abs(best - before) < max(SETTLED, sd):
            break
    # A jump that is taken to come at a wrong time moves the offset by the more the larger it is.
    size = sum(one.share * min(one.jumped / (LARGE * shared.model.force), 1.0) ** 2 for one in known)
    return mean, float(np.hypot(max(sd, FINEST), np.sqrt(size) * STEP_DOUBT)), known[0].noise


def looked_at(shared: Shared, offsets: Array, known: Sequence[Explained], prior: Prior) -> tuple[float, float]:
    """Mean and sd of the offset: over all `offsets`, then ever closer about the mean."""
    span = float(offsets[0]), float(offsets[-1])
    chance = posterior(shared, offsets, known, prior)
    for _ in range(LOOKS):
        mean, sd = moments_of(offsets, chance)
        reach = max(REACH * sd, 0.75 * float(np.max(np.diff(offsets)[np.abs(offsets[1:] - mean) <= NEXT])))
        new = np.setdiff1d(np.linspace(max(mean - reach, span[0]), min(mean + reach, span[1]), FINE), offsets)
        offsets, chance = np.append(offsets, new), np.append(chance, posterior(shared, new, known, prior))
        order = np.argsort(offsets)
        offsets, chance = offsets[order], chance[order]
    return moments_of(offsets, chance)


def explanations(shared: Shared, offset: float, z: Array) -> list[Explained]:
    """The log's error with jumps where the load changes, and without; the likelier one first, alone if it is far so."""
    both = [explained(shared, offset, z, large) for large in (0.0, LARGE)]
    flat: Prior = np.zeros_like
    size = np.array([posterior(shared, np.array([offset]), [each], flat)[0] for each in both])
    share = np.exp(size - np.logaddexp.reduce(size))
    return [replace(both[i], share=float(share[i])) for i in np.argsort(-size) if size[i] > size.max() - UNLIKELY]


def moments_of(offset: Array, chance: Array) -> tuple[float, float]:
    """Mean and sd of a distribution given by its log at rising points."""
    weight = np.exp(chance - chance.max()) * np.gradient(offset)
    weight /= weight.sum()
    mean = float(weight @ offset)
    return mean, float(np.sqrt(weight @ (offset - mean) ** 2))


def common(moments: Moments, rows: Rows, offsets: Array, first: float) -> tuple[Shared | None, Array]:
    """What holds at all `offsets`, and parameters to begin with."""
    use = np.all([seen_at(moments, rows.time - each, rows.width).told for each in offsets], axis=0)
    time = moments.track.time
    film = seen_at(moments, np.arange(time[0] + 0.5 * rows.width, time[-1] - 0.5 * rows.width, rows.width), rows.width)
    if use.sum() < FEWEST or film.told.sum() < FEWEST:
        return None, np.zeros(0)
    at, force = rows.time[use], rows.force[use]
    compliance, sign, bias = rough_compliance(seen_at(moments, at - first, rows.width), force)
    model = Model(moments, compliance, rows.largest)
    shared = Shared(moments, at, rows.width, sign * force, film.at(film.told), model)
    return shared, model.start(bias)


def explained(shared: Shared, offset: float, z: Array, large: float) -> Explained:
    """Parameters, noise and jumps at one offset, in turns, from guessed ones; `large` = 0: no jumps."""
    seen, model = shared.seen(offset), shared.model
    share, start = grown(seen), first_guess(shared.force, shared.width)
    noise, jumps, typical = start, (large * model.force) ** 2 * share, (TYPICAL * model.force) ** 2 * share
    for _ in range(TURNS):
        spread = model.told(seen, z)[1]
        root = np.linalg.cholesky(covariance(noise, shared.time, spread, jumps))
        _, z = evidence(model, seen, lambda x: tied(model, shared.film, x), shared.force, np.asarray(root), z, FIRST)
    spread = model.told(seen, z)[1]
    left, free = around(model, seen, shared.film, shared.force, z)
    for _ in range(TURNS if large else 0):
        noise = fitted_noise(left, free, shared.time, spread, start, jumps)
        rest = covariance(noise, shared.time, spread, np.zeros_like(jumps))
        jumps = found_jumps(left, free, rest, jumps, typical)
    size = jumps[(typical > 0.0) & (jumps > 0.0)] / typical[(typical > 0.0) & (jumps > 0.0)]
    chance = -0.5 * float(np.sum(np.log(size) + 1.0 / size - 1.0))  # of variances of Cauchy distributed jumps
    jumped = float(np.sqrt(np.maximum(jumps - typical, 0.0).sum()))
    return Explained(fitted_noise(left, free, shared.time, spread, start, jumps), jumps, z, chance, jumped)


def posterior(shared: Shared, offsets: Array, known: Sequence[Explained], prior: Prior) -> Array:
    """Log posterior at `offsets`, less a constant, over all that may explain the log's error."""
    out = np.full(len(offsets), -np.inf)
    for one in known:
        tie = nearly(shared.model, shared.film, one.z)
        for i, each in enumerate(offsets):
            seen = shared.seen(float(each))
            spread = shared.model.told(seen, one.z)[1]
            root = np.linalg.cholesky(covariance(one.noise, shared.time, spread, one.jumps))
            value, _ = evidence(shared.model, seen, tie, shared.force, np.asarray(root), one.z, FAST)
            out[i] = np.logaddexp(out[i], value + one.chance)
    return np.asarray(out + prior(offsets))
