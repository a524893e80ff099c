"""The posterior of the clock offset from the moments of the push about the spans, where its place is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock.binned_log import BinnedLog
from onebend.recording.clock.likelihood import (
    ForceLogModel,
    covariance,
    film_misfit,
    fit_jumps,
    fit_residual_noise,
    laplace_evidence,
    quadratic_film_misfit,
    residual_and_design,
    rough_compliance,
)
from onebend.recording.clock.span_moments import Moments, MomentsAtRows, load_change_share, moments_at
from onebend.recording.force.noise import first_guess
from onebend.records import Array, ForceNoise

TYPICAL, LARGE = 0.01, 0.1  # of the largest force: jumps of the log's error when the load changes, usual and largest
STEP, MOST_OFFSETS = 0.02, 31  # of the first grid: s between offsets at least, and their largest number
FINE = 15  # offsets that each refinement of the grid adds
REACH = 4.0  # sd: half-width of a refinement
RESOLVED = 0.6  # sd: a grid as fine as that around the mean needs no refinement
TURNS = 2  # rounds of parameters, noise and jumps at one offset
MOST_TURNS, SETTLED = 4, 2e-3  # rounds of these and the offset; s, a change of the offset that ends them
FEWEST = 10  # rows
REFINEMENTS, NEXT = 3, 0.3  # of the grid; s, distance from the mean within which its spacing is read
FINEST = 1e-3  # s, least sd that is claimed
STEP_DOUBT = 0.05  # s, sd of the offset from not knowing when the log's error changes with the load
UNLIKELY = 8.0  # log probability below the best: a share of 3e-4
FIRST, FAST = 10, 3  # rounds of the parameters at one offset, and from there at another one


Prior = Callable[[Array], Array]  # log of the prior over offsets, less a constant


@dataclass(frozen=True)
class CommonRows:
    """The rows that all offsets of a search cover, and their model."""

    moments: Moments
    time: Array  # (N,) s, log's clock
    width: float  # s
    force: Array  # (N, 2) N, with the sign of the force on the beam
    film: MomentsAtRows  # the whole film
    model: ForceLogModel

    def rows_at(self, offset: float) -> MomentsAtRows:
        return moments_at(self.moments, self.time - offset, self.width)


@dataclass(frozen=True)
class LogError:
    """The log's error (noise and jumps) and the likeliest parameters, at one offset."""

    noise: ForceNoise
    jumps: Array  # (N,) N^2
    z: Array
    log_prior: float  # of the jumps, relative to the likeliest ones
    jump_sd: float  # N, one sd of the sum of the jumps, beyond usual ones
    probability: float = 1.0  # of this error, among the likely ones


@dataclass(frozen=True)
class _Found:
    """Where the search from one estimate ended."""

    mean: float  # s
    sd: float  # s
    log_evidence: float
    noise: ForceNoise


def offset_from_moments(
    moments: Moments, rows: BinnedLog, span: tuple[float, float], first: Sequence[float], prior: Prior
) -> tuple[float, float, ForceNoise] | None:
    """Mean [s] and sd [s] of the offset within `span` [s], and the noise; None where film and log share too little.

    `first` [s] are estimates of the offset. From each the noise is fitted there, then at the mean, until that settles:
    what is an error of the log at one offset is force at another one, so that a search stays near where it began. The
    ends of the searches count by their evidence.
    """
    wide = span[1] - span[0]
    offsets = np.arange(span[0], span[1] + 1e-9, max(min(STEP, wide / FEWEST), wide / (MOST_OFFSETS - 1)))
    every = np.append(offsets, first)
    found = [one for begin in first if (one := _found_from(moments, rows, offsets, every, begin, prior)) is not None]
    if not found:
        return None
    size = np.array([one.log_evidence for one in found])
    share = np.exp(size - np.logaddexp.reduce(size))
    mean = float(share @ [one.mean for one in found])
    sd = float(np.sqrt(share @ [one.sd**2 + (one.mean - mean) ** 2 for one in found]))
    return mean, sd, found[int(np.argmax(share))].noise


def _found_from(
    moments: Moments, rows: BinnedLog, offsets: Array, every: Array, first: float, prior: Prior
) -> _Found | None:
    """The search on the grid `offsets`, from one of them all."""
    shared, z = common_rows(moments, rows, every, first)
    if shared is None:
        return None
    best = first
    for _ in range(MOST_TURNS):
        errors = likely_errors(shared, best, z)
        mean, sd, log_evidence = scan_closer(shared, offsets, errors, prior)
        previous, best, z = best, mean, errors[0].z
        if abs(best - previous) < max(SETTLED, sd):
            break
    # A jump at a wrong time shifts the offset, and a larger jump shifts it more.
    size = sum(error.probability * min(error.jump_sd / (LARGE * shared.model.force), 1.0) ** 2 for error in errors)
    return _Found(mean, float(np.hypot(max(sd, FINEST), np.sqrt(size) * STEP_DOUBT)), log_evidence, errors[0].noise)


def scan_closer(
    shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior
) -> tuple[float, float, float]:
    """Mean and sd of the offset, on the grid `offsets` refined around its mean, and the log evidence."""
    span = float(offsets[0]), float(offsets[-1])
    log_density = log_posterior(shared, offsets, errors, prior)
    for _ in range(REFINEMENTS):
        mean, sd = moments_of(offsets, log_density)
        spacing = np.diff(offsets)[np.abs(offsets[1:] - mean) <= REACH * sd]
        if len(spacing) >= REACH and spacing.max() < RESOLVED * sd:
            break
        reach = max(REACH * sd, 0.75 * float(np.max(np.diff(offsets)[np.abs(offsets[1:] - mean) <= NEXT])))
        new = np.setdiff1d(np.linspace(max(mean - reach, span[0]), min(mean + reach, span[1]), FINE), offsets)
        offsets, log_density = (
            np.append(offsets, new),
            np.append(log_density, log_posterior(shared, new, errors, prior)),
        )
        order = np.argsort(offsets)
        offsets, log_density = offsets[order], log_density[order]
    most = float(log_density.max())
    weight = np.exp(log_density - most) @ np.gradient(offsets)
    return *moments_of(offsets, log_density), most + float(np.log(weight))


def likely_errors(shared: CommonRows, offset: float, z: Array) -> list[LogError]:
    """The log's error without and with jumps where the load changes: the likelier first, without an unlikely one."""
    both = [fit_log_error(shared, offset, z, large) for large in (0.0, LARGE)]
    flat: Prior = np.zeros_like
    size = np.array([log_posterior(shared, np.array([offset]), [error], flat)[0] for error in both])
    share = np.exp(size - np.logaddexp.reduce(size))
    return [replace(both[i], probability=float(share[i])) for i in np.argsort(-size) if size[i] > size.max() - UNLIKELY]


def moments_of(offset: Array, log_density: Array) -> tuple[float, float]:
    """Mean and sd of a density given by its log at rising points."""
    weight = np.exp(log_density - log_density.max()) * np.gradient(offset)
    weight /= weight.sum()
    mean = float(weight @ offset)
    return mean, float(np.sqrt(weight @ (offset - mean) ** 2))


def common_rows(moments: Moments, rows: BinnedLog, offsets: Array, first: float) -> tuple[CommonRows | None, Array]:
    """The rows that all `offsets` cover, None where too few; and parameters to begin with."""
    use = np.all([moments_at(moments, rows.time - offset, rows.width).known for offset in offsets], axis=0)
    time = moments.track.time
    film = moments_at(
        moments, np.arange(time[0] + 0.5 * rows.width, time[-1] - 0.5 * rows.width, rows.width), rows.width
    )
    if use.sum() < FEWEST or film.known.sum() < FEWEST:
        return None, np.zeros(0)
    time_used, force = rows.time[use], rows.force[use]
    compliance, sign, bias = rough_compliance(moments_at(moments, time_used - first, rows.width), force)
    model = ForceLogModel(moments, compliance, rows.largest)
    shared = CommonRows(moments, time_used, rows.width, sign * force, film.select(film.known), model)
    return shared, model.start(bias)


def fit_log_error(shared: CommonRows, offset: float, z: Array, large: float) -> LogError:
    """Parameters, noise and jumps at one offset, each fitted in turn from a guess. `large` = 0: without jumps."""
    moments, model = shared.rows_at(offset), shared.model
    share, start = load_change_share(moments), first_guess(shared.force, shared.width)
    noise, jumps, typical = start, (large * model.force) ** 2 * share, (TYPICAL * model.force) ** 2 * share
    for _ in range(TURNS):
        spread = model.force_on_beam(moments, z)[1]
        root = np.linalg.cholesky(covariance(noise, shared.time, spread, jumps))
        _, z = laplace_evidence(
            model, moments, lambda x: film_misfit(model, shared.film, x), shared.force, np.asarray(root), z, FIRST
        )
    spread = model.force_on_beam(moments, z)[1]
    residual, design = residual_and_design(model, moments, shared.film, shared.force, z)
    for _ in range(TURNS if large else 0):
        noise = fit_residual_noise(residual, design, shared.time, spread, start, jumps)
        others = covariance(noise, shared.time, spread, np.zeros_like(jumps))
        jumps = fit_jumps(residual, design, others, jumps, typical)
    size = jumps[(typical > 0.0) & (jumps > 0.0)] / typical[(typical > 0.0) & (jumps > 0.0)]
    log_prior = -0.5 * float(np.sum(np.log(size) + 1.0 / size - 1.0))  # of variances of Cauchy distributed jumps
    jump_sd = float(np.sqrt(np.maximum(jumps - typical, 0.0).sum()))
    return LogError(
        fit_residual_noise(residual, design, shared.time, spread, start, jumps), jumps, z, log_prior, jump_sd
    )


def log_posterior(shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior) -> Array:
    """Log posterior at `offsets` up to a constant, summed over the likely `errors` of the log."""
    log_density = np.full(len(offsets), -np.inf)
    for error in errors:
        misfit_at = quadratic_film_misfit(shared.model, shared.film, error.z)
        for i, offset in enumerate(offsets):
            moments = shared.rows_at(float(offset))
            spread = shared.model.force_on_beam(moments, error.z)[1]
            root = np.linalg.cholesky(covariance(error.noise, shared.time, spread, error.jumps))
            value, _ = laplace_evidence(shared.model, moments, misfit_at, shared.force, np.asarray(root), error.z, FAST)
            log_density[i] = np.logaddexp(log_density[i], value + error.log_prior)
    return np.asarray(log_density + prior(offsets))
