"""The linearised model of the marker-space fit: what tags and force logs say about the parameters.

At a point x every recording gives whitened residuals r, derivatives J with the parameters and A with each frame's
force. The covariance S of a frame is that of its tags plus the effect of the fast part of its force error:
`s^2 (I + (f/s)^2 A A^T)`. The log likelihood is then quadratic, with information `H = J^T S^-1 J` and
`b = J^T S^-1 (r + J x)`. Priors are Gaussian, so at fixed hyperparameters the maximum and the evidence (marginal
likelihood) of the linearised model have closed forms (`hyperparameters.py`).

All derivatives are taken at the force less each frame's own fast error f, and `r` is the residual there plus `A f`. At
the force as logged they would be correlated with its noise, and noise in a regressor biases the stiffness upwards
(errors in variables, attenuation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, Prior, RecordingNoise
from onebend.learning.inference.information_form import InformationForm, total
from onebend.learning.model.forward import Prediction, Slopes
from onebend.learning.model.parameters import Layout
from onebend.records import Array, IntArray

_ROBUST = 6.0  # degrees of freedom of Student's t: weights of tags that fit badly
_REST_SHARE = 0.1  # of the coloured force noise: what the knots cannot follow in the rests


@dataclass(frozen=True)
class ResidualRows:
    """One recording at one point: whitened and robustly weighted, R = 3 m numbers a frame."""

    r: Array  # (F, R) residuals, the effect of each frame's own force included
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


def residual_rows(now: Prediction, noise: RecordingNoise) -> ResidualRows:
    """Rows of one recording, tags weighted by Student's t on the residuals that their frame's force cannot explain."""
    plain = unweighted_rows(now)
    known, frames = plain.known, len(plain.r)
    unexplained, _ = split_off_force(plain, plain.r, noise)
    squares = np.sum(unexplained.reshape(frames, -1, 3) ** 2, axis=-1) / noise.marker**2
    numbers = np.sum(known.reshape(frames, -1, 3), axis=-1)
    root = np.repeat(np.sqrt((_ROBUST + numbers) / (_ROBUST + squares)), 3, axis=1) * known
    weights, slopes = root[..., None], plain.slopes
    weighted = replace(slopes, j=weights * slopes.j, a=weights * slopes.a)
    return ResidualRows(root * plain.r, weighted, known, root)


def unweighted_rows(now: Prediction) -> ResidualRows:
    """Rows of one recording, whitened alone."""
    whiten, slopes, frames = now.recording.whiten, now.slopes, len(now.pose)
    known = np.any(whiten != 0.0, axis=-1).astype(float).reshape(frames, -1)
    j, a = (np.asarray((whiten @ one).reshape(*known.shape, -1)) for one in (slopes.j, slopes.a))
    return ResidualRows(residuals(now) + explained_by(a, now.own), replace(slopes, j=j, a=a), known, known)


def residuals(now: Prediction) -> Array:
    """(F, 3 m) whitened measured minus predicted poses; zero where a tag was not seen."""
    data = now.recording
    difference = np.where(np.isfinite(data.measured), data.measured - now.pose, 0.0)
    return np.asarray(np.einsum("fmab,fmb->fma", data.whiten, difference).reshape(len(difference), -1))


def explained_by(a: Array, own: Array) -> Array:
    """(F, R) effect of the frames' own forces (F, 2) [N] on the rows, to first order."""
    return np.asarray(np.einsum("frd,fd->fr", a, own))


def split_off_force(rows: ResidualRows, r: Array, noise: RecordingNoise) -> tuple[Array, Array]:
    """Residuals (F, R) less the effect of the frames' own force errors, and these errors (F, 2) N."""
    force = np.einsum("fdc,fc->fd", force_shrinkage(rows, noise), rows.by_force(r))
    return r - explained_by(rows.a, force), force


def misfit(rows: ResidualRows, r: Array, noise: RecordingNoise) -> float:
    """`r' S^-1 r` of weighted residuals (F, R)."""
    unexplained, _ = split_off_force(rows, r, noise)
    return float(np.sum(r * unexplained)) / noise.marker**2


def tag_information(
    rows: ResidualRows, layout: Layout, number: int, x: Array, noise: RecordingNoise
) -> InformationForm:
    """Log likelihood of one recording's tags at given noise, all but the frames' own forces as parameters.

    The slow error of the log moves a frame's tags as the frame's own force does, so the information on its knots
    follows from that on the force: `A' S^-1 = ((s/f)^2 + A' A)^-1 A' / f^2`.
    """
    mine, slopes = layout.known_to(number), rows.slopes
    (frames, k), variance = slopes.weights.shape, noise.marker**2
    y = rows.r + slopes.times(x[mine])
    shrinkage, ay = force_shrinkage(rows, noise), rows.by_force(y)
    aj = np.swapaxes(rows.a, 1, 2) @ slopes.j  # (F, 2, C - 2 K)
    j, count = slopes.j.reshape(-1, aj.shape[-1]), aj.shape[-1]
    lowered = shrinkage @ np.concatenate([aj, rows.gram @ slopes.axes], axis=-1)
    by_j, by_log = np.split(lowered, [count], axis=-1)
    inside = np.zeros((len(mine), len(mine)))
    inside[:count, :count] = (j.T @ j - aj.reshape(-1, count).T @ by_j.reshape(-1, count)) / variance
    onto = -slopes.axes.T / noise.force**2
    across = (slopes.weights.T @ (onto @ by_j).reshape(frames, -1)).reshape(2 * k, count)
    inside[count:, :count], inside[:count, count:] = across, across.T
    pairs = (slopes.weights[:, :, None] * (-onto @ by_log).reshape(frames, 1, 4)).reshape(frames, 4 * k)
    knots = (slopes.weights.T @ pairs).reshape(k, k, 2, 2)
    inside[count:, count:] = knots.transpose(0, 2, 1, 3).reshape(2 * k, 2 * k)
    c = (np.sum(y**2) - np.sum(ay * np.einsum("fde,fe->fd", shrinkage, ay))) / variance
    spread = np.linalg.slogdet(np.eye(2) + (noise.force / noise.marker) ** 2 * rows.gram)[1]
    log_noise = float(np.sum(rows.known)) * np.log(noise.marker) + 0.5 * float(np.sum(spread))
    information = np.zeros((layout.size, layout.size))
    information[np.ix_(mine, mine)] = inside
    return InformationForm(information, tag_score(rows, layout, number, y, noise), float(c), log_noise)


def tag_score(rows: ResidualRows, layout: Layout, number: int, r: Array, noise: RecordingNoise) -> Array:
    """(P,) `J' S^-1 r` of weighted residuals r (F, R) of one recording."""
    slopes, out = rows.slopes, np.zeros(layout.size)
    unexplained, force = split_off_force(rows, r, noise)
    of_tags = slopes.j.reshape(-1, slopes.j.shape[-1]).T @ unexplained.ravel() / noise.marker**2
    of_knots = -slopes.weights.T @ (force @ slopes.axes) / noise.force**2
    out[layout.known_to(number)] = np.concatenate([of_tags, of_knots.ravel()])
    return out


def rest_information(problem: FitProblem) -> InformationForm:
    """Log likelihood of the force logs in the rests, where the true force is zero and the log is its own error."""
    size = problem.layout.size
    information, b, c, log_noise = np.zeros((size, size)), np.zeros(size), 0.0, 0.0
    for recording in problem.recordings:
        sd = _REST_SHARE * recording.error.size
        block, values = problem.layout.index["force", recording.number], recording.error.rest_values
        if block.start < 0 or len(values) == 0:
            continue
        weights = np.kron(recording.error.rest_weights, np.eye(2)) / sd
        information[block.where, block.where] = weights.T @ weights
        b[block.where] = weights.T @ values.ravel() / sd
        c += float(np.sum(values**2)) / sd**2
        log_noise += values.size * float(np.log(sd))
    return InformationForm(information, b, c, log_noise)


def frequency_information(problem: FitProblem, x: Array) -> InformationForm:
    """Log likelihood of the measured natural frequencies, which depend on the beam alone."""
    size = problem.layout.size
    parts = [InformationForm(np.zeros((size, size)), np.zeros(size))]
    for predicted in problem.predicted_frequencies(x):
        j = predicted.slopes / predicted.data.sd[:, None]
        y = predicted.residuals + j @ x
        log_noise = float(np.sum(np.log(predicted.data.sd)))
        parts.append(InformationForm(j.T @ j, j.T @ y, float(y @ y), log_noise))
    return total(parts)


def data_information(
    problem: FitProblem, rows: Sequence[ResidualRows], x: Array, hyperparameters: Hyperparameters
) -> InformationForm:
    """Log likelihood of all tags, rests and frequencies."""
    every = zip(problem.recordings, rows, hyperparameters.noise, strict=True)
    tags = [tag_information(r, problem.layout, recording.number, x, noise) for recording, r, noise in every]
    return total([*tags, rest_information(problem), frequency_information(problem, x)])


def force_shrinkage(rows: ResidualRows, noise: RecordingNoise) -> Array:
    """(F, 2, 2) `((s/f)^2 + A'A)^-1`: covariance of each frame's own force over `s^2`."""
    (xx, xy), (_, yy) = np.moveaxis((noise.marker / noise.force) ** 2 * np.eye(2) + rows.gram, 0, -1)
    return np.asarray(np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), -1, 0))


@dataclass(frozen=True)
class LinearPosterior:
    """The posterior of the linearised model."""

    mean: Array  # (P,)
    root: Array  # (P, P): the covariance is `root' root`
    log_evidence: float  # but for a constant

    @property
    def covariance(self) -> Array:
        """(P, P)."""
        return np.asarray(self.root.T @ self.root)


def posterior_of(data: InformationForm, before: Prior) -> LinearPosterior:
    """Data and prior together: with `x = m + L z`, z has the precision `I + L' H L = G G'`."""
    factor = whitened_factor(data.matrix, before.root)
    white = _solved(factor, before.root.T @ (data.vector - data.matrix @ before.mean))
    root = _solved(factor, before.root.T)
    misfit = data.constant - 2.0 * data.vector @ before.mean + before.mean @ data.matrix @ before.mean - white @ white
    log_det = 2.0 * float(np.sum(np.log(np.diag(factor))))
    return LinearPosterior(before.mean + root.T @ white, root, float(-0.5 * (log_det + misfit) - data.log_noise))


def marginal(data: InformationForm, before: Prior, kept: IntArray, others: IntArray) -> InformationForm:
    """What the data say of the `kept` parameters, the `others` integrated out under their prior (independent of that of
    the kept); its noise term includes the volume of the others."""
    mean, root = before.mean[others], before.root[np.ix_(others, others)]
    information = data.matrix[np.ix_(others, others)]
    factor = whitened_factor(information, root)
    cross = _solved(factor, root.T @ data.matrix[np.ix_(others, kept)])
    white = _solved(factor, root.T @ (data.vector[others] - information @ mean))
    return InformationForm(
        matrix=data.matrix[np.ix_(kept, kept)] - cross.T @ cross,
        vector=data.vector[kept] - data.matrix[np.ix_(kept, others)] @ mean - cross.T @ white,
        constant=float(data.constant - 2.0 * data.vector[others] @ mean + mean @ information @ mean - white @ white),
        log_noise=data.log_noise + float(np.sum(np.log(np.diag(factor)))),
    )


def whitened_factor(information: Array, root: Array) -> Array:
    """(n, n) lower Cholesky factor of `I + L' H L`."""
    return np.asarray(np.linalg.cholesky(root.T @ information @ root + np.eye(len(root))))


def _solved(factor: Array, right: Array) -> Array:
    return np.asarray(solve_triangular(factor, right, lower=True, check_finite=False))
