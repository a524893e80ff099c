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

from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise
from onebend.learning.inference.information_form import InformationForm, total
from onebend.learning.inference.joint import JointInformation
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.force_error import ForceError
from onebend.learning.model.forward import Prediction, Slopes
from onebend.learning.model.parameters import Layout
from onebend.learning.model.readings import whitened
from onebend.records import Array
from onebend.workers import each, in_own_pages

_ROBUST = 6.0  # degrees of freedom of Student's t: weights of tags that fit badly
_REST_SHARE = 0.1  # of the coloured force noise: what the knots cannot follow in the rests


@dataclass(frozen=True)
class ResidualRows:
    """One recording at one point: whitened and robustly weighted, R = 3 m numbers a frame."""

    r: Array  # (F, R) residuals, the effect of each frame's own force included
    whitened: Slopes  # not weighted yet: the derivatives are most of what a fit keeps in memory
    known: Array  # (F, R) 1 where measured
    root_weight: Array  # (F, R)

    @property
    def slopes(self) -> Slopes:
        """The rows' derivatives, weighted: a copy."""
        weight, plain = self.root_weight[..., None], self.whitened
        return replace(plain, j=weight * plain.j, a=self.a, added=None if plain.added is None else weight * plain.added)

    def moved_by(self, step: Array) -> Array:
        """(F, R): what a step (C,) of the parameters does to the rows."""
        return np.asarray(self.root_weight * self.whitened.times(step))

    def onto_parameters(self, v: Array) -> Array:
        """(n, C) `v' J` of rows v (F, R, n)."""
        return self.whitened.transposed_times(self.root_weight[..., None] * v).T

    @cached_property
    def a(self) -> Array:
        """(F, R, 2) with the frame's force."""
        return np.asarray(self.root_weight[..., None] * self.whitened.a)

    @cached_property
    def gram(self) -> Array:
        """(F, 2, 2) `A' A`."""
        return np.asarray(np.swapaxes(self.a, 1, 2) @ self.a)

    def by_force(self, r: Array) -> Array:
        """(F, 2) `A' r` of residuals (F, R)."""
        return np.asarray(np.einsum("frd,fr->fd", self.a, r))


def residual_rows(now: Prediction, noise: RecordingNoise) -> ResidualRows:
    """Rows of one recording, tags weighted by Student's t on the residuals that their frame's force cannot explain."""
    return _weighted(unweighted_rows(now), noise)


def rows_by_force(now: Prediction, noise: RecordingNoise) -> ResidualRows:
    """`residual_rows` whose derivatives with the parameters are left out."""
    return _weighted(_unweighted(now, now.whitened_by_force), noise)


def unweighted_rows(now: Prediction) -> ResidualRows:
    """Rows of one recording, whitened alone."""
    return _unweighted(now, now.whitened_slopes)


def _unweighted(now: Prediction, slopes: Slopes) -> ResidualRows:
    known = np.any(now.recording.whiten != 0.0, axis=-1).astype(float).reshape(len(now.pose), -1)
    return ResidualRows(residuals(now) + explained_by(slopes.a, now.own), slopes, known, known)


def _weighted(plain: ResidualRows, noise: RecordingNoise) -> ResidualRows:
    known, frames = plain.known, len(plain.r)
    unexplained, _ = split_off_force(plain, plain.r, noise)
    squares = np.sum(unexplained.reshape(frames, -1, 3) ** 2, axis=-1) / noise.marker**2
    numbers = np.sum(known.reshape(frames, -1, 3), axis=-1)
    root = np.repeat(np.sqrt((_ROBUST + numbers) / (_ROBUST + squares)), 3, axis=1) * known
    return ResidualRows(root * plain.r, plain.whitened, known, root)


def residuals(now: Prediction) -> Array:
    """(F, 3 m) whitened measured minus predicted poses; zero where a tag was not seen."""
    data = now.recording
    difference = np.where(np.isfinite(data.measured), data.measured - now.pose, 0.0)
    return whitened(data.whiten, difference[..., None])[..., 0]


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
    follows from that on the force: `A' S^-1 = ((s/f)^2 + A' A)^-1 A' / f^2`. Where the material remembers, a force that
    lasts does somewhat more in its frame, and goes on in those after it.
    """
    mine, slopes, variance = layout.known_to(number), rows.slopes, noise.marker**2
    y = rows.r + rows.moved_by(x[mine])
    shrinkage, ay = force_shrinkage(rows, noise), rows.by_force(y)
    aj = np.swapaxes(rows.a, 1, 2) @ slopes.j  # (F, 2, D)
    by_j = shrinkage @ aj
    j, stacked = slopes.j.reshape(-1, aj.shape[-1]), (-1, aj.shape[-1])
    dense = (j.T @ j - aj.reshape(stacked).T @ by_j.reshape(stacked)) / variance
    by_push, of_push = by_j / noise.force**2, shrinkage @ rows.gram / noise.force**2
    if slopes.added is not None:
        more = np.swapaxes(slopes.added, 1, 2)
        both = more @ rows.a
        shared = both @ shrinkage / noise.force**2
        by_push += (more @ slopes.j - both @ by_j) / variance
        of_push += shared + np.swapaxes(shared, 1, 2)
        of_push += (more @ slopes.added - both @ shrinkage @ np.swapaxes(both, 1, 2)) / variance
    c = (np.sum(y**2) - np.sum(ay * np.einsum("fde,fe->fd", shrinkage, ay))) / variance
    spread = np.linalg.slogdet(np.eye(2) + (noise.force / noise.marker) ** 2 * rows.gram)[1]
    log_noise = float(np.sum(rows.known)) * np.log(noise.marker) + 0.5 * float(np.sum(spread))
    inside = _with_knots(slopes, dense, by_push, of_push)
    return InformationForm(inside, tag_score(rows, y, noise), float(c), log_noise)


def _with_knots(slopes: Slopes, dense: Array, by_push: Array, of_push: Array) -> Array:
    """(C, C) information on the parameters, from that on the columns of `slopes.j` (D, D), on these with each frame's
    lasting push (F, 2, D), and on that push (F, 2, 2)."""
    count, k, keys = slopes.others, slopes.weights.shape[1], slopes.keys
    own = slopes.onto_knots(by_push)  # (2 K, D)
    across = own + slopes.onto_knots(dense[count:].reshape(len(keys), 2, len(dense)), keys)
    pairs = slopes.weights[:, :, None] * (slopes.axes.T @ of_push @ slopes.axes).reshape(-1, 1, 4)
    by_axes = (slopes.weights.T @ pairs.reshape(len(pairs), 4 * k)).reshape(k, k, 2, 2)
    of_knots = by_axes.transpose(0, 2, 1, 3).reshape(2 * k, 2 * k)
    if len(keys):
        first, second = (slopes.onto_knots(m[:, count:].T.reshape(len(keys), 2, 2 * k), keys) for m in (across, own))
        of_knots = of_knots + first.T + second
    inside = np.empty((count + 2 * k, count + 2 * k))
    inside[:count, :count], inside[count:, count:] = dense[:count, :count], of_knots
    inside[count:, :count], inside[:count, count:] = across[:, :count], across[:, :count].T
    return inside


def tag_score(rows: ResidualRows, r: Array, noise: RecordingNoise) -> Array:
    """(C,) `J' S^-1 r` of weighted residuals r (F, R) of one recording, over the parameters that it knows."""
    slopes = rows.whitened
    unexplained, force = split_off_force(rows, r, noise)
    weighted = rows.root_weight * unexplained / noise.marker**2
    dense, by_push = weighted.ravel() @ slopes.j.reshape(-1, slopes.j.shape[-1]), force / noise.force**2
    if slopes.added is not None:
        by_push = by_push + np.einsum("frd,fr->fd", slopes.added, weighted)
    return slopes.with_knots(dense[:, None], by_push[..., None])[:, 0]


def rest_information(problem: FitProblem, number: int) -> InformationForm:
    """Log likelihood of one force log in the rests, where the true force is zero and the log is its own error; over the
    parameters that its recording knows."""
    layout, error = problem.layout, problem.recordings[number].error
    count = len(layout.known_to(number))
    information, b = np.zeros((count, count)), np.zeros(count)
    sd, values = _rest_sd(error), error.rest_values
    where = layout.columns("force", number)
    if where is None or len(values) == 0:
        return InformationForm(information, b)
    for axis in range(2):  # x and y in turn, alike
        information[where, where][axis::2, axis::2] = error.rest_gram / sd**2
    b[where] = (error.rest_weights.T @ values).ravel() / sd**2
    return InformationForm(information, b, float(np.sum(values**2)) / sd**2, values.size * float(np.log(sd)))


def rest_residuals(recording: FitData, layout: Layout, x: Array) -> Array:
    """(R, 2) of the force log in the rests at parameters x (P,), over its sd there."""
    error = recording.error
    expected = error.rest_weights @ layout.get(x, "force", recording.number).reshape(-1, 2)
    return np.asarray((error.rest_values - expected) / _rest_sd(error))


def rest_score(recording: FitData, layout: Layout, x: Array) -> Array:
    """(C,) minus half the gradient of the square of `rest_residuals`, over the parameters that the recording knows."""
    out, where = np.zeros(len(layout.known_to(recording.number))), layout.columns("force", recording.number)
    if where is not None:
        residuals = rest_residuals(recording, layout, x)
        out[where] = (recording.error.rest_weights.T @ residuals).ravel() / _rest_sd(recording.error)
    return out


def _rest_sd(error: ForceError) -> float:
    """N, of the log in the rests about its slow error."""
    return _REST_SHARE * error.size


def own_information(problem: FitProblem, number: int, x: Array) -> list[InformationForm]:
    """Log likelihood of what one recording says besides its tags, at parameters x (P,): its rests, and its natural
    frequencies, which depend on the beam alone."""
    known, out = problem.layout.known_to(number), [rest_information(problem, number)]
    for predicted in problem.predicted_frequencies(x, number):
        j = predicted.slopes[:, known] / predicted.data.sd[:, None]
        y = predicted.residuals + j @ x[known]
        log_noise = float(np.sum(np.log(predicted.data.sd)))
        out.append(InformationForm(j.T @ j, j.T @ y, float(y @ y), log_noise))
    return out


def recording_information(
    problem: FitProblem, number: int, rows: ResidualRows, x: Array, noise: RecordingNoise
) -> InformationForm:
    """Log likelihood of one recording's tags, rests and frequencies."""
    return total([tag_information(rows, problem.layout, number, x, noise), *own_information(problem, number, x)])


def data_information(
    problem: FitProblem, rows: Sequence[ResidualRows], x: Array, hyperparameters: Hyperparameters
) -> JointInformation:
    """Log likelihood of all tags, rests and frequencies."""

    def of(number: int, r: ResidualRows, noise: RecordingNoise) -> InformationForm:
        form = recording_information(problem, number, r, x, noise)
        return replace(form, matrix=in_own_pages(form.matrix))

    return JointInformation(each(of, range(len(rows)), rows, hyperparameters.noise), problem.layout.parts)


def force_shrinkage(rows: ResidualRows, noise: RecordingNoise) -> Array:
    """(F, 2, 2) `((s/f)^2 + A'A)^-1`: covariance of each frame's own force over `s^2`."""
    (xx, xy), (_, yy) = np.moveaxis((noise.marker / noise.force) ** 2 * np.eye(2) + rows.gram, 0, -1)
    return np.asarray(np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), -1, 0))
