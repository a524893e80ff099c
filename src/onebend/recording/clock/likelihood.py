"""The likelihood of a force log given the markers: a model of its mean, and of its noise.

The turns of the tags have noise, so the force that they imply at a row is normal, with a mean and a covariance
(`span_moments.py`). The covariance is large along a straight beam, where the turns say little. A row of the log is
then normal about this mean. To the covariance come the noise of the sensor (`noise.py`) and an error that changes with
the load. The unknown parameters (compliances, place of the push, axes) are held by two conditions: one force
explains all turns of a frame, and the log follows that force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize, nnls

from onebend.recording.clock.polynomial_features import RIDGE
from onebend.recording.clock.span_moments import STILL, Moments, MomentsAtRows
from onebend.records import DIRECTION_SD, PLACE_SD, Array, ForceNoise

SLOPE = 1.0  # prior sd of the slope of a span's compliance over half the span, relative to its mean
FREE_SCALE = 1.0  # prior sd of the log of a span's compliance about a first regression
FREE = 10.0  # of the largest force: prior sd of the log's bias
SOFTEST = 0.1  # of the stiffness that the largest force implies: the least that the first regression may give
DEGREES_OF_FREEDOM = 4.0  # of Student's t: some tags are read wrongly
PARAMETER_BOUND = 6.0  # prior sd: the search keeps parameters within it
ROUNDS = 12  # of expectation and maximisation
DIFFERENCE = 1e-4  # step of the parameters for derivatives

# Of the parameters (p,): a negative log likelihood, minus its gradient (p,), and its curvature (p, p)
FilmMisfit = Callable[[Array], tuple[float, Array, Array]]


def rough_compliance(rows: MomentsAtRows, force: Array) -> tuple[Array, float, Array]:
    """(k,) rad / (N m) mean compliance of every span, the log's sign, and its bias (2,) N with that sign.

    Least squares with stiffnesses that are not negative; convex, so that it has one minimum.
    """
    count, spans = rows.turn.shape
    lever = rows.lever[:, 0]
    ridge = RIDGE * float((lever**2).sum(axis=-1).max())
    inner = np.einsum("nka,nkb->nab", lever, lever) + ridge * np.eye(2)
    part = np.linalg.solve(inner, lever.transpose(0, 2, 1)) * rows.turn[:, None, :]
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
    stiffness = np.maximum(stiffness[:spans], SOFTEST * needed)
    return 1.0 / stiffness, sign, bias


@dataclass(frozen=True)
class ForceLogModel:
    """Mean of the log at N rows as a function of 3 k + 4 parameters z, standard normal before the data.

    z holds the logs of the spans' compliances (k), their slopes (k), the push's place, the log's direction, its bias
    (2), and the spans' turns at rest (k). z may have leading axes; the results then have them too.
    """

    moments: Moments
    compliance: Array  # (k,) rad / (N m), at z = 0
    force: float  # N, largest

    def start(self, bias: Array) -> Array:
        """(3 k + 4,) parameters to begin with: zero, but for a bias (2,) [N] of the log."""
        k = len(self.compliance)
        z = np.zeros(3 * k + 4)
        z[2 * k + 2 : 2 * k + 4] = bias / (FREE * self.force)
        return z

    def turns_per_force(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, k, 2) rad / N: turns of the spans per unit force."""
        k = len(self.compliance)
        w = self.compliance * np.exp(FREE_SCALE * z[..., :k])
        lever = rows.lever[:, 0] + PLACE_SD * z[..., 2 * k, None, None, None] * rows.tangent[:, None, :]
        return np.asarray((lever + SLOPE * z[..., None, k : 2 * k, None] * rows.lever[:, 1]) * w[..., None, :, None])

    def force_on_beam(self, rows: MomentsAtRows, z: Array) -> tuple[Array, Array]:
        """(N, 2) N and (N, 2, 2) N^2: mean and covariance of the force on the beam."""
        k = len(self.compliance)
        a = self.turns_per_force(rows, z)
        weight = 1.0 / self.moments.noise**2
        rest = self.moments.noise / np.sqrt(STILL)
        size = np.sqrt(np.mean((rows.turn / self.moments.noise) ** 2, axis=1) + 1.0)
        size *= self.force / np.sqrt(np.mean((self.moments.largest / self.moments.noise) ** 2))
        weighed = a * weight[:, None]
        inner = np.swapaxes(weighed, -1, -2) @ a + np.eye(2) / size[:, None, None] ** 2
        (xx, xy), (_, yy) = np.moveaxis(inner, (-2, -1), (0, 1))
        spread = np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), (0, 1), (-2, -1))
        turn = rows.turn - rest * z[..., None, 2 * k + 4 :]
        pulled = np.einsum("...kc,...k->...c", weighed, turn)
        return np.einsum("...cd,...d->...c", spread, pulled), spread

    def turn_residuals(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, k) residuals of the turns from those of one force per row, in sd of the turns' noise."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        rest = self.moments.noise / np.sqrt(STILL) * z[..., None, 2 * k + 4 :]
        explained = np.einsum("...kc,...c->...k", self.turns_per_force(rows, z), force)
        return np.asarray((rows.turn - rest - explained) / self.moments.noise)

    def mean(self, rows: MomentsAtRows, z: Array) -> Array:
        """(N, 2) N, the mean of the log."""
        k = len(self.compliance)
        force, _ = self.force_on_beam(rows, z)
        turned = DIRECTION_SD * z[..., 2 * k + 1, None, None] * np.stack([-force[..., 1], force[..., 0]], axis=-1)
        return np.asarray(force + turned + FREE * self.force * z[..., None, 2 * k + 2 : 2 * k + 4])


def jacobian(function: Callable[[Array], Array], z: Array, base: Array) -> Array:
    """(n, p) forward differences of `function` at z, where its n values are `base`; one call takes all steps of z."""
    moved = function(z + DIFFERENCE * np.eye(len(z)))
    return np.asarray(((moved - base) / DIFFERENCE).reshape(len(z), -1).T)


def covariance(noise: ForceNoise, time: Array, spread: Array, jumps: Array) -> Array:
    """(2N, 2N) N^2 of the log about its mean; each row gives its two axes one after the other."""
    n = len(time)
    walked = np.cumsum(jumps)
    per_axis = noise.covariance(time) + np.minimum(walked[:, None], walked)
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
    """The log less its mean (2N,), and a root (2N, p) of the covariance that the parameters give that mean.

    Both are of the normal distribution that the film and the prior leave the parameters."""
    base = model.mean(rows, z)
    j = jacobian(lambda x: model.mean(rows, x), z, base)
    _, slope, inner = film_misfit(model, film, z)
    root = np.linalg.cholesky(inner + np.eye(len(z)))
    half = solve_triangular(root, j.T, lower=True).T
    return (force - base).ravel() - half @ solve_triangular(root, slope - z, lower=True), half


def fit_jumps(residual: Array, design: Array, others: Array, jumps: Array, typical: Array) -> Array:
    """(N,) N^2: variances of the jumps of the log's error before each row, by expectation and maximisation.

    Jumps are Cauchy distributed with variances of about `typical` (N,) N^2; both axes share one variance. `jumps` is
    the guess to begin with, `others` (2N, 2N) N^2 the covariance of all else.
    """
    n = len(jumps)
    rows = np.kron(np.tril(np.ones((n, n))), np.eye(2))
    for _ in range(ROUNDS):
        size = np.repeat(jumps, 2)
        root = np.linalg.cholesky(others + design @ design.T + (rows * size) @ rows.T)
        white = solve_triangular(root, np.column_stack([rows, residual]), lower=True, check_finite=False)
        mean = size * (white[:, :-1].T @ white[:, -1])
        spread = size - size**2 * np.sum(white[:, :-1] ** 2, axis=0)
        jumps = (typical + (mean**2 + spread).reshape(n, 2).sum(axis=1)) / 3.0 * (typical > 0.0)
    return np.asarray(jumps)


def fit_residual_noise(
    residual: Array, design: Array, time: Array, spread: Array, start: ForceNoise, jumps: Array
) -> ForceNoise:
    """The likeliest noise of the `residual` (2N,) N of the log.

    `design` (2N, p) N times standard normal numbers is the part of the residual that comes from the parameters. As in
    `noise.fit_noise`, a weak prior about `start` bounds the sizes."""
    scale = np.log(np.array([5.0, 5.0, 2.5, 5.0]))
    centre = np.log(np.array([start.white, start.coloured, start.tau, start.walk]))

    def sized(x: Array) -> ForceNoise:
        white, coloured, tau, walk = np.exp(centre + scale * x).tolist()
        return replace(start, white=white, coloured=coloured, tau=tau, walk=walk)

    def negative_log_posterior(x: Array) -> float:
        root = np.linalg.cholesky(covariance(sized(x), time, spread, jumps))
        white = solve_triangular(root, np.column_stack([design, residual]), lower=True, check_finite=False)
        a, b = white[:, :-1], white[:, -1]
        inner = np.linalg.cholesky(np.eye(design.shape[1]) + a.T @ a)
        explained = solve_triangular(inner, a.T @ b, lower=True)
        fit = 0.5 * float(x @ x + b @ b - explained @ explained)
        return fit + float(np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner))))

    simplex = np.vstack([np.zeros(4), 0.4 * np.eye(4)])
    options = {"maxfev": 80, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    optimum = minimize(negative_log_posterior, np.zeros(4), method="Nelder-Mead", options=options)
    return sized(optimum.x)
