"""The likelihood of a force log given the moments of the film's spans: a model of its mean, and of its noise.

The force that the tags' turns imply at a row is normal, with a large covariance along a straight beam. To it come the
sensor's noise and an error that changes with the load. The unknown parameters (compliances, place of the push, axes)
are held by two conditions: one force explains all turns of a frame, and the log follows that force."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from onebend.recording.clock_evidence import BinnedLog, Prior, mixed, moments_of
from onebend.recording.clock_features import FEWEST, LOAD_DOUBT, STILL, Moments, unit_forces
from onebend.recording.force_noise import TimeSpans, covariance, first_guess, likeliest_noise
from onebend.records import DIRECTION_SD, PLACE_SD, Array, BoolArray, ForceNoise, left_of

FREE_BIAS = 10.0  # of the largest force: prior sd of the log's bias
DEGREES_OF_FREEDOM = 4.0  # of Student's t: some tags are read wrongly
PARAMETER_BOUND = 6.0  # prior sd: the search keeps parameters within it
DIFFERENCE = 1e-4  # step of the parameters for derivatives
TYPICAL, LARGE = 0.01, 0.1  # of the largest force: jumps of the log's error when the load changes, usual and largest
STEP, MOST_OFFSETS = 0.02, 31  # of the first grid: s between offsets at least, and their largest number
REACH = 4.0  # sd: half-width of a refinement
TURNS = 2  # rounds of parameters, noise and jumps at one offset
SIZES = 20  # rounds of the size of the turns' noise
FIRST, FAST = 10, 3  # rounds of the parameters at one offset, and from there at another one

# Of the parameters (p,): a negative log likelihood, minus its gradient (p,), and its curvature (p, p)
FilmMisfit = Callable[[Array], tuple[float, Array, Array]]


@dataclass(frozen=True)
class MomentsAtRows:
    """Moments at N rows; steps rise from 0 to 1 over each change of the load."""

    turn: Array  # (N, k)
    lever: Array  # (N, 2 moments, k, 2)
    tangent: Array  # (N, 2)
    steps: Array  # (N, n)

    @property
    def known(self) -> BoolArray:
        """(N,) rows that the film covers."""
        return np.asarray(np.isfinite(self.turn).all(axis=1))

    def select(self, rows: BoolArray) -> MomentsAtRows:
        """Some of the rows."""
        return MomentsAtRows(self.turn[rows], self.lever[rows], self.tangent[rows], self.steps[rows])


def load_change_share(rows: MomentsAtRows) -> Array:
    """(N,) share of the changes of the load that lies between each row and the one before it."""
    return np.concatenate([[0.0], np.maximum(np.diff(rows.steps, axis=0), 0.0).sum(axis=1)])


def moments_at(moments: Moments, centre: Array, width: float) -> MomentsAtRows:
    """Moments averaged over `width` [s] around every `centre` (N,) [s, video clock]."""
    f = moments.track.mean(centre, width)
    return MomentsAtRows(
        f[..., 0],
        np.stack([f[..., 1:3], f[..., 3:5]], axis=1),
        moments.tangent.mean(centre, width),
        np.clip(moments.steps.mean(centre, width), 0.0, 1.0),
    )


def rough_compliance(rows: MomentsAtRows, force: Array) -> tuple[Array, float, Array]:
    """(k,) rad / (N m) mean compliance of every span, the log's sign, and its bias (2,) N with that sign.

    Least squares with stiffnesses that are not negative; convex, so that it has one minimum.
    """
    count, spans = rows.turn.shape
    lever = rows.lever[:, 0]
    part = unit_forces(lever, rows.turn)
    axes = np.tile(np.eye(2), (count, 1))
    design = np.hstack([part.reshape(2 * count, spans), axes, -axes])
    size = np.linalg.norm(design, axis=0)
    fits = {sign: nnls(design / size, sign * force.ravel()) for sign in (1.0, -1.0)}
    sign = min(fits, key=lambda candidate: float(fits[candidate][1]))
    stiffness = fits[sign][0] / size
    bias = stiffness[spans : spans + 2] - stiffness[spans + 2 :]
    # The stiffness at which the largest force makes the largest turns: a first regression may find none.
    needed = np.abs(force - np.median(force, axis=0)).max() * np.sqrt((lever**2).sum(axis=-1).max(axis=0))
    needed /= np.abs(rows.turn).max(axis=0)
    # Of the stiffness that the largest force implies: the least that the first regression may give.
    stiffness = np.maximum(stiffness[:spans], 0.1 * needed)
    return 1.0 / stiffness, sign, bias


@dataclass(frozen=True)
class ForceLogModel:
    """Mean of the log at N rows as a function of 3 k + 4 parameters z, standard normal before the data.

    z holds the logs of the spans' compliances (k), their slopes over half a span, relative to the mean (k), the push's
    place, the log's direction, its bias (2), and the spans' turns at rest (k). Leading axes of z are kept."""

    moments: Moments
    compliance: Array  # (k,) rad / (N m), at z = 0
    force: float  # N, largest

    def start(self, bias: Array) -> Array:
        """(3 k + 4,) parameters to begin with: zero, but for a bias (2,) [N] of the log."""
        k = len(self.compliance)
        z = np.zeros(3 * k + 4)
        z[2 * k + 2 : 2 * k + 4] = bias / (FREE_BIAS * self.force)
        return z

    def turns_per_force(self, rows: MomentsAtRows, z: Array) -> Array:
        """(2, N, k) rad / N: turns of the spans per unit force along x and y."""
        k = len(self.compliance)
        w = self.compliance * np.exp(z[..., None, :k])
        place, slope = PLACE_SD * z[..., 2 * k, None, None], z[..., None, k : 2 * k]
        lever = rows.lever
        return np.stack(
            [(lever[:, 0, :, c] + place * rows.tangent[:, c, None] + slope * lever[:, 1, :, c]) * w for c in (0, 1)]
        )

    def force_on_beam(self, rows: MomentsAtRows, z: Array) -> tuple[Array, Array]:
        """(N, 2) N and (N, 2, 2) N^2: mean and covariance of the force on the beam."""
        k = len(self.compliance)
        a = self.turns_per_force(rows, z)
        weighed = a / self.moments.noise**2
        rest = self.moments.noise / np.sqrt(STILL)
        size = np.sqrt(np.mean((rows.turn / self.moments.noise) ** 2, axis=1) + 1.0)
        size *= self.force / np.sqrt(np.mean((self.moments.largest / self.moments.noise) ** 2))
        xx, xy, yy = (np.einsum("...k,...k->...", weighed[i], a[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        xx, yy = xx + size**-2, yy + size**-2
        turn = rows.turn - rest * z[..., None, 2 * k + 4 :]
        x, y = np.einsum("c...k,...k->c...", weighed, turn)
        volume = xx * yy - xy**2
        force = np.stack([yy * x - xy * y, xx * y - xy * x], axis=-1)
        spread = np.stack([yy, -xy, -xy, xx], axis=-1)
        return force / volume[..., None], (spread / volume[..., None]).reshape(*volume.shape, 2, 2)

    def turn_residuals(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, k) residuals of the turns from those of one force per row, in sd of the turns' noise."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        rest = self.moments.noise / np.sqrt(STILL) * z[..., None, 2 * k + 4 :]
        explained = np.einsum("c...k,...c->...k", self.turns_per_force(rows, z), force)
        return np.asarray((rows.turn - rest - explained) / self.moments.noise)

    def mean(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, 2) N, the mean of the log."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        turned = DIRECTION_SD * z[..., 2 * k + 1, None, None] * left_of(force)
        return np.asarray(force + turned + FREE_BIAS * self.force * z[..., None, 2 * k + 2 : 2 * k + 4])


def jacobian(function: Callable[[Array], Array], z: Array, base: Array) -> Array:
    """(n, p) forward differences of `function` at z, where its n values are `base`; one call takes all steps of z."""
    moved = function(z + DIFFERENCE * np.eye(len(z)))
    return np.asarray(((moved - base) / DIFFERENCE).reshape(len(z), -1).T)


def log_covariance(noise: ForceNoise, rows: TimeSpans, spread: Array, jumps: Array) -> Array:
    """(2N, 2N) N^2 of the log about its mean; each row gives its two axes one after the other."""
    n = len(spread)
    walked = np.cumsum(jumps)
    per_axis = covariance(noise, rows) + np.minimum(walked[:, None], walked)
    blocks = np.zeros((n, 2, n, 2))
    blocks[:, 0, :, 0] = blocks[:, 1, :, 1] = per_axis
    index = np.arange(n)
    blocks[index, :, index, :] += spread
    return np.asarray(blocks.reshape(2 * n, 2 * n))


def film_misfit(model: ForceLogModel, film: MomentsAtRows, z: Array) -> tuple[float, Array, Array]:
    """The film's negative log likelihood of the parameters (Student's t per row), minus its gradient, its curvature."""
    base = model.turn_residuals(film, z)
    j = jacobian(lambda x: model.turn_residuals(film, x), z, base).reshape(*base.shape, len(z))
    free = base.shape[1]
    size = np.sum(base**2, axis=1) / DEGREES_OF_FREEDOM
    weight = (1.0 + free / DEGREES_OF_FREEDOM) / (1.0 + size)
    cost = 0.5 * (DEGREES_OF_FREEDOM + free) * float(np.sum(np.log1p(size)))
    return cost, -np.einsum("nip,ni,n->p", j, base, weight), np.einsum("nip,niq,n->pq", j, j, weight)


def quadratic_film_misfit(model: ForceLogModel, film: MomentsAtRows, z: Array) -> FilmMisfit:
    """The parabola that stands for `film_misfit` near z."""
    cost, slope, inner = film_misfit(model, film, z)

    def parabola(x: Array) -> tuple[float, Array, Array]:
        move = x - z
        bent = inner @ move
        return cost + float(move @ (0.5 * bent - slope)), slope - bent, inner

    return parabola


def laplace_evidence(
    model: ForceLogModel,
    rows: MomentsAtRows,
    misfit_at: FilmMisfit,
    force: Array,
    root: Array,
    z: Array,
    rounds: int,
) -> tuple[float, Array]:
    """Laplace's log evidence of `force` (N, 2) under noise of covariance root root', and the likeliest parameters."""

    def step(z: Array) -> tuple[float, Array, Array]:
        base = model.mean(rows, z)
        columns = np.column_stack([jacobian(lambda x: model.mean(rows, x), z, base), (force - base).ravel()])
        white = solve_triangular(root, columns, lower=True, check_finite=False)
        j, r = white[:, :-1], white[:, -1]
        cost, slope, inner = misfit_at(z)
        return cost + 0.5 * float(r @ r + z @ z), inner + np.eye(len(z)) + j.T @ j, slope + j.T @ r - z

    value, inner, slope = step(z)
    damping = 0.0
    for _ in range(rounds):
        move = np.linalg.solve(inner + damping * np.diag(np.diag(inner)), slope)
        if move @ slope < 0.01:
            break
        new = np.clip(z + np.clip(move, -1.0, 1.0), -PARAMETER_BOUND, PARAMETER_BOUND)
        cost = step(new)
        if cost[0] < value:
            z, (value, inner, slope), damping = new, cost, 0.1 * damping if damping > 1e-3 else 0.0
        else:
            damping = max(10.0 * damping, 0.1)
    return -value - 0.5 * float(np.linalg.slogdet(inner)[1]) - float(np.sum(np.log(np.diag(root)))), z


def residual_and_design(
    model: ForceLogModel, rows: MomentsAtRows, film: MomentsAtRows, force: Array, z: Array
) -> tuple[Array, Array]:
    """The log less its mean (2N,), and a root (2N, p) of the mean's covariance, by film and prior."""
    base = model.mean(rows, z)
    j = jacobian(lambda x: model.mean(rows, x), z, base)
    _, slope, inner = film_misfit(model, film, z)
    root = np.linalg.cholesky(inner + np.eye(len(z)))
    half = solve_triangular(root, j.T, lower=True).T
    return (force - base).ravel() - half @ solve_triangular(root, slope - z, lower=True), half


def fit_jumps(residual: Array, design: Array, others: Array, jumps: Array, typical: Array) -> Array:
    """(N,) N^2: variances of the jumps of the log's error before each row, by expectation and maximisation.

    Jumps are Cauchy distributed with variances of about `typical` (N,) N^2, first guess `jumps`, alike on both axes;
    `others` (2N, 2N) N^2 is the covariance of all else."""
    n = len(jumps)
    rows = np.kron(np.tril(np.ones((n, n))), np.eye(2))
    for _ in range(12):
        size = np.repeat(jumps, 2)
        root = np.linalg.cholesky(others + design @ design.T + (rows * size) @ rows.T)
        white = solve_triangular(root, np.column_stack([rows, residual]), lower=True, check_finite=False)
        mean = size * (white[:, :-1].T @ white[:, -1])
        spread = size - size**2 * np.sum(white[:, :-1] ** 2, axis=0)
        jumps = (typical + (mean**2 + spread).reshape(n, 2).sum(axis=1)) / 3.0 * (typical > 0.0)
    return np.asarray(jumps)


def fit_residual_noise(
    residual: Array, design: Array, rows: TimeSpans, spread: Array, start: ForceNoise, jumps: Array
) -> ForceNoise:
    """The likeliest noise of the log's `residual` (2N,) N, of which `design` (2N, p) N is the parameters' part."""

    def misfit(noise: ForceNoise, square: float) -> float:
        root = np.linalg.cholesky(log_covariance(noise, rows, spread, jumps))
        white = solve_triangular(root, np.column_stack([design, residual]), lower=True, check_finite=False)
        a, b = white[:, :-1], white[:, -1]
        inner = np.linalg.cholesky(np.eye(design.shape[1]) + a.T @ a)
        explained = solve_triangular(inner, a.T @ b, lower=True)
        fit = 0.5 * float(square + b @ b - explained @ explained)
        return fit + float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))))

    return likeliest_noise(start, misfit, 80)


@dataclass(frozen=True)
class CommonRows:
    """The rows that all offsets of a search cover, and their model."""

    moments: Moments
    time: Array  # (N,) s, log's clock
    width: float  # s
    force: Array  # (N, 2) N, with the sign of the force on the beam
    film: MomentsAtRows  # the whole film
    model: ForceLogModel

    @cached_property
    def rows(self) -> TimeSpans:
        return TimeSpans.at(self.time)

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

    From each estimate `first` [s] the noise is fitted there, then at the mean, until that settles. An error of the log
    at one offset is force at another one, so a search stays near where it began. Its evidence weights its end."""
    wide = span[1] - span[0]
    offsets = np.arange(span[0], span[1] + 1e-9, max(min(STEP, wide / FEWEST), wide / (MOST_OFFSETS - 1)))
    every = np.append(offsets, first)
    found = [one for begin in first if (one := _found_from(moments, rows, offsets, every, begin, prior)) is not None]
    if not found:
        return None
    evidence = np.array([one.log_evidence for one in found])
    mean, sd = mixed(evidence, np.array([one.mean for one in found]), np.array([one.sd for one in found]))
    return mean, sd, found[int(np.argmax(evidence))].noise


def _found_from(
    moments: Moments, rows: BinnedLog, offsets: Array, every: Array, first: float, prior: Prior
) -> _Found | None:
    """The search on the grid `offsets`, from one of them all."""
    shared, z = common_rows(moments, rows, every, first)
    if shared is None:
        return None
    best, shared = first, with_misfit(shared, fit_log_error(shared, first, z, 0.0).z)
    for _ in range(4):
        errors = likely_errors(shared, best, z)
        mean, sd, log_evidence = scan_closer(shared, offsets, errors, prior)
        previous, best, z = best, mean, errors[0].z
        if abs(best - previous) < max(0.002, sd):  # s, a change of the offset that ends them
            break
    # A jump at a wrong time shifts the offset, and a larger jump shifts it more.
    size = sum(error.probability * min(error.jump_sd / (LARGE * shared.model.force), 1.0) ** 2 for error in errors)
    # s, least sd that is claimed.
    return _Found(mean, float(np.hypot(max(sd, 0.001), np.sqrt(size) * LOAD_DOUBT)), log_evidence, errors[0].noise)


def scan_closer(
    shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior
) -> tuple[float, float, float]:
    """Mean and sd of the offset, on the grid `offsets` refined around its mean, and the log evidence."""
    span = float(offsets[0]), float(offsets[-1])
    log_density = log_posterior(shared, offsets, errors, prior)
    for _ in range(3):
        mean, sd = moments_of(offsets, log_density)
        spacing = np.diff(offsets)[np.abs(offsets[1:] - mean) <= REACH * sd]
        # sd: a grid as fine as that around the mean needs no refinement.
        if len(spacing) >= REACH and spacing.max() < 0.6 * sd:
            break
        # s, distance from the mean within which its spacing is read.
        reach = max(REACH * sd, 0.75 * float(np.max(np.diff(offsets)[np.abs(offsets[1:] - mean) <= 0.3])))
        # Offsets that each refinement of the grid adds.
        new = np.setdiff1d(np.linspace(max(mean - reach, span[0]), min(mean + reach, span[1]), 15), offsets)
        order = np.argsort(np.append(offsets, new))
        log_density = np.append(log_density, log_posterior(shared, new, errors, prior))[order]
        offsets = np.append(offsets, new)[order]
    most = float(log_density.max())
    weight = np.exp(log_density - most) @ np.gradient(offsets)
    return *moments_of(offsets, log_density), most + float(np.log(weight))


def with_misfit(shared: CommonRows, z: Array) -> CommonRows:
    """With as much noise of the turns as no one force explains: frame by frame, errors that last do not show."""
    square = np.sum(shared.model.turn_residuals(shared.film, z) ** 2, axis=1)
    spans, free, size = len(shared.moments.noise), DEGREES_OF_FREEDOM, 1.0
    for _ in range(SIZES):  # of Student's t
        size = float(np.mean((free + spans) * square / (free + square / size))) / max(spans - 2, 1)
    moments = replace(shared.moments, noise=max(math.sqrt(size), 1.0) * shared.moments.noise)
    return replace(shared, moments=moments, model=replace(shared.model, moments=moments))


def likely_errors(shared: CommonRows, offset: float, z: Array) -> list[LogError]:
    """The log's error without and with jumps where the load changes: the likelier first, without an unlikely one."""
    both = [fit_log_error(shared, offset, z, large) for large in (0.0, LARGE)]
    flat: Prior = np.zeros_like
    size = np.array([log_posterior(shared, np.array([offset]), [error], flat)[0] for error in both])
    share = np.exp(size - np.logaddexp.reduce(size))
    # Log probability below the best: a share of 3e-4.
    return [replace(both[i], probability=float(share[i])) for i in np.argsort(-size) if size[i] > size.max() - 8.0]


def common_rows(moments: Moments, rows: BinnedLog, offsets: Array, first: float) -> tuple[CommonRows | None, Array]:
    """The rows that all `offsets` cover, None where too few; and parameters to begin with."""
    use = np.all([moments_at(moments, rows.time - offset, rows.width).known for offset in offsets], axis=0)
    time, half = moments.track.time, 0.5 * rows.width
    film = moments_at(moments, np.arange(time[0] + half, time[-1] - half, rows.width), rows.width)
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
        root = np.linalg.cholesky(log_covariance(noise, shared.rows, spread, jumps))
        _, z = laplace_evidence(
            model, moments, lambda x: film_misfit(model, shared.film, x), shared.force, np.asarray(root), z, FIRST
        )
    spread = model.force_on_beam(moments, z)[1]
    residual, design = residual_and_design(model, moments, shared.film, shared.force, z)
    for _ in range(TURNS if large else 0):
        noise = fit_residual_noise(residual, design, shared.rows, spread, start, jumps)
        others = log_covariance(noise, shared.rows, spread, np.zeros_like(jumps))
        jumps = fit_jumps(residual, design, others, jumps, typical)
    known = (typical > 0.0) & (jumps > 0.0)
    size = jumps[known] / typical[known]
    log_prior = -0.5 * float(np.sum(np.log(size) + 1.0 / size - 1.0))  # of variances of Cauchy distributed jumps
    jump_sd = float(np.sqrt(np.maximum(jumps - typical, 0.0).sum()))
    noise = fit_residual_noise(residual, design, shared.rows, spread, start, jumps)
    return LogError(noise, jumps, z, log_prior, jump_sd)


def log_posterior(shared: CommonRows, offsets: Array, errors: Sequence[LogError], prior: Prior) -> Array:
    """Log posterior at `offsets` up to a constant, summed over the likely `errors` of the log."""
    log_density = np.full(len(offsets), -np.inf)
    for error in errors:
        misfit_at = quadratic_film_misfit(shared.model, shared.film, error.z)
        for i, offset in enumerate(offsets):
            moments = shared.rows_at(float(offset))
            spread = shared.model.force_on_beam(moments, error.z)[1]
            root = np.linalg.cholesky(log_covariance(error.noise, shared.rows, spread, error.jumps))
            value, _ = laplace_evidence(shared.model, moments, misfit_at, shared.force, np.asarray(root), error.z, FAST)
            log_density[i] = np.logaddexp(log_density[i], value + error.log_prior)
    return np.asarray(log_density + prior(offsets))
