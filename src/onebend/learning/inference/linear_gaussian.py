"""The marker-space fit's linear algebra: what data and priors say about the parameters, and the evidence for scales.

At a point x every film gives whitened residuals r, derivatives J with the parameters and A with each frame's force. A
frame's covariance is its tags' own plus what the fast part of its force error does: `s^2 (I + (f/s)^2 A A^T)`. The
data's say is a quadratic: information `H` and `b = J^T S^-1 (r + J x)`. Priors are Gaussian, so for fixed scales the
maximum and the evidence (marginal likelihood) of the linearised model follow in closed form (`hyperparameters.py`).

All derivatives are taken at the force with each frame's own, fast error f taken off, and `r` is what is left there plus
`A f`. Taken at the force as logged they would go with its noise, and noise in what bends a beam makes it look stiffer
(errors in variables, attenuation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.learning.model.fit_data import Film
from onebend.learning.model.forward import Prediction, Slopes
from onebend.learning.model.parameters import Layout
from onebend.records import Array

_ROBUST = 6.0  # degrees of freedom of Student's t: weights of tags that fit badly
_REST_SHARE = 0.1  # of the coloured force noise: what the knots cannot follow in the rests


@dataclass(frozen=True)
class FilmNoise:
    """Noise of one film's frames, correlation in time included."""

    marker: float  # over what the tags' covariances say
    force: float  # N, the force error that is faster than its knots


@dataclass(frozen=True)
class Scales:
    """Sizes that the data choose."""

    parts: Array  # (n,) variances of the parts of log k, see `Spline.parts`
    coloured: float  # of the sd that was expected of the force error's coloured part
    memory: float  # of its correlation time
    walk: float  # of the random walk that was expected
    load: float  # of the sd that was expected of the force error that comes with the load
    films: tuple[FilmNoise, ...]
    chains: Array | None = None  # where the draws of log k's sizes stand, see `roughness.drawn_parts`


@dataclass(frozen=True)
class Rows:
    """One film at one point: whitened and robustly weighted, R = 3 m numbers a frame."""

    r: Array  # (F, R) residuals, what each frame's own force explains not taken off
    slopes: Slopes
    known: Array  # (F, R) 1 where measured
    root_weight: Array  # (F, R)

    @property
    def a(self) -> Array:
        """(F, R, 2) with the frame's force."""
        return self.slopes.a

    @cached_property
    def gram(self) -> Array:
        """(F, 2, 2) `A' A`."""
        return np.asarray(np.swapaxes(self.a, 1, 2) @ self.a)

    def by_force(self, r: Array) -> Array:
        """(F, 2) `A' r` of residuals (F, R)."""
        return np.asarray(np.einsum("frd,fr->fd", self.a, r))


@dataclass(frozen=True)
class Quadratic:
    """What data say to second order: `-2 log p = x' H x - 2 b' x + c`."""

    information: Array  # (P, P)
    b: Array  # (P,)
    c: float
    log_noise: float  # sum of the logs of the noise's sd: the rest of -log p


def rows_of(now: Prediction, noise: FilmNoise) -> Rows:
    """Residuals and derivatives of one film, tags weighted by Student's t on what its force cannot explain."""
    plain = unweighted(now)
    known, frames = plain.known, len(plain.r)
    across, _ = split(plain, plain.r, noise)
    squares = np.sum(across.reshape(frames, -1, 3) ** 2, axis=-1) / noise.marker**2
    numbers = np.sum(known.reshape(frames, -1, 3), axis=-1)
    root = np.repeat(np.sqrt((_ROBUST + numbers) / (_ROBUST + squares)), 3, axis=1) * known
    weights, slopes = root[..., None], plain.slopes
    return Rows(root * plain.r, replace(slopes, j=weights * slopes.j, a=weights * slopes.a), known, root)


def unweighted(now: Prediction) -> Rows:
    """Residuals and derivatives of one film, whitened alone."""
    whiten, slopes, frames = now.seen.whiten, now.slopes, len(now.pose)
    known = np.any(whiten != 0.0, axis=-1).astype(float).reshape(frames, -1)
    j, a = (np.asarray((whiten @ one).reshape(*known.shape, -1)) for one in (slopes.j, slopes.a))
    return Rows(residuals(now) + explained_by(a, now.own), replace(slopes, j=j, a=a), known, known)


def residuals(now: Prediction) -> Array:
    """(F, 3 m) whitened measured minus predicted poses; zero where a tag was not seen."""
    seen = now.seen
    away = np.where(np.isfinite(seen.measured), seen.measured - now.pose, 0.0)
    return np.asarray(np.einsum("fmab,fmb->fma", seen.whiten, away).reshape(len(away), -1))


def explained_by(a: Array, own: Array) -> Array:
    """(F, R) what the frames' own forces (F, 2) [N] do to the rows, to first order."""
    return np.asarray(np.einsum("frd,fd->fr", a, own))


def split(rows: Rows, r: Array, noise: FilmNoise) -> tuple[Array, Array]:
    """Residuals (F, R) less what the frames' own force errors explain, and these errors (F, 2) N."""
    force = np.einsum("fdc,fc->fd", shrink(rows, noise), rows.by_force(r))
    return r - explained_by(rows.a, force), force


def misfit(rows: Rows, r: Array, noise: FilmNoise) -> float:
    """`r' S^-1 r` of weighted residuals (F, R)."""
    across, _ = split(rows, r, noise)
    return float(np.sum(r * across)) / noise.marker**2


def quadratic(rows: Rows, at: Layout, number: int, x: Array, noise: FilmNoise) -> Quadratic:
    """A film's say under given noise.

    The log's slow error moves a frame's tags as the frame's own force does, so all that is said of its knots is what
    is said of the force: `A' S^-1 = ((s/f)^2 + A' A)^-1 A' / f^2`.
    """
    mine, slopes = at.known_to(number), rows.slopes
    (frames, k), variance = slopes.weights.shape, noise.marker**2
    y = rows.r + slopes.times(x[mine])
    less, ay = shrink(rows, noise), rows.by_force(y)
    aj = np.swapaxes(rows.a, 1, 2) @ slopes.j  # (F, 2, C - 2 K)
    j, flat, count = slopes.j.reshape(-1, aj.shape[-1]), y.ravel(), aj.shape[-1]
    lowered = less @ np.concatenate([aj, rows.gram @ slopes.axes, ay[..., None]], axis=-1)
    by_j, by_log, by_y = np.split(lowered, [count, count + 2], axis=-1)
    inside = np.zeros((len(mine), len(mine)))
    inside[:count, :count] = (j.T @ j - aj.reshape(-1, count).T @ by_j.reshape(-1, count)) / variance
    onto = -slopes.axes.T / noise.force**2
    of_force = (onto @ np.concatenate([by_j, by_y], axis=-1)).reshape(frames, -1)
    across = (slopes.weights.T @ of_force).reshape(2 * k, count + 1)  # (2 K, C - 2 K + 1)
    inside[count:, :count], inside[:count, count:] = across[:, :count], across[:, :count].T
    pairs = (slopes.weights[:, :, None] * (-onto @ by_log).reshape(frames, 1, 4)).reshape(frames, 4 * k)
    knots = (slopes.weights.T @ pairs).reshape(k, k, 2, 2)
    inside[count:, count:] = knots.transpose(0, 2, 1, 3).reshape(2 * k, 2 * k)
    b = np.concatenate([(j.T @ flat - by_j.reshape(-1, count).T @ ay.ravel()) / variance, across[:, count]])
    c = (flat @ flat - np.sum(ay * by_y[..., 0])) / variance
    spread = np.linalg.slogdet(np.eye(2) + (noise.force / noise.marker) ** 2 * rows.gram)[1]
    log_noise = float(np.sum(rows.known)) * np.log(noise.marker) + 0.5 * float(np.sum(spread))
    information, right = np.zeros((at.size, at.size)), np.zeros(at.size)
    information[np.ix_(mine, mine)], right[mine] = inside, b
    return Quadratic(information, right, float(c), log_noise)


def rest_quadratic(films: list[Film], at: Layout) -> Quadratic:
    """The force logs in the rests, where they show their own error."""
    information, b, c, log_noise = np.zeros((at.size, at.size)), np.zeros(at.size), 0.0, 0.0
    for seen in films:
        sd = _REST_SHARE * seen.error.size
        block, values = at.index["force", seen.number], seen.error.rest_values
        if block.start < 0 or len(values) == 0:
            continue
        weights = np.kron(seen.error.rest_weights, np.eye(2)) / sd
        information[block.where, block.where] = weights.T @ weights
        b[block.where] = weights.T @ values.ravel() / sd
        c += float(np.sum(values**2)) / sd**2
        log_noise += values.size * float(np.log(sd))
    return Quadratic(information, b, c, log_noise)


def together(parts: list[Quadratic]) -> Quadratic:
    """The sum of what several sources say."""
    return Quadratic(
        np.sum([p.information for p in parts], axis=0),
        np.sum([p.b for p in parts], axis=0),
        sum(p.c for p in parts),
        sum(p.log_noise for p in parts),
    )


def prior(films: list[Film], at: Layout, level: float | Array, scales: Scales) -> tuple[Array, Array, float]:
    """Precision (P, P) and mean (P,) of the parameters before the data, and the precision's log determinant.

    `level`: mean of log k's coefficients, one for all or one each.
    """
    precision, mean, log_det = np.zeros((at.size, at.size)), np.zeros(at.size), 0.0
    for block in at.blocks:
        if block.start < 0:
            continue
        where = block.where
        if block.name == "stiffness":
            precision[where, where] = at.spline.precision_of(scales.parts) + at.evenness
            mean[where] = level
            log_det += float(np.linalg.slogdet(precision[where, where])[1])
        elif block.name == "force":  # x and y in turn, alike
            error = films[block.recording].error
            covariance = error.covariance(scales.coloured, scales.memory, scales.walk, scales.load)
            mean[where] = error.mean.ravel()
            inverse = np.linalg.inv(covariance)
            for axis in range(2):
                alike = slice(where.start + axis, where.stop, 2)
                precision[alike, alike] = inverse
            log_det -= 2.0 * float(np.linalg.slogdet(covariance)[1])
        else:
            precision[where, where] = np.diag(1.0 / block.prior_sd**2)
            log_det -= 2.0 * float(np.sum(np.log(block.prior_sd)))
    return precision, mean, log_det


def shrink(rows: Rows, noise: FilmNoise) -> Array:
    """(F, 2, 2) `((s/f)^2 + A'A)^-1`."""
    (xx, xy), (_, yy) = np.moveaxis((noise.marker / noise.force) ** 2 * np.eye(2) + rows.gram, 0, -1)
    return np.asarray(np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), -1, 0))
