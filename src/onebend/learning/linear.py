"""The linearised model of the marker-space fit: information of tags and force logs on the parameters.

At a point x every recording has whitened residuals r, derivatives J with the parameters and A with each frame's force.
The covariance S of a frame is that of its tags plus the effect of the fast part of its force error:
`s^2 (I + (f/s)^2 A A^T)`. The log likelihood is quadratic, with information `H = J^T S^-1 J` and `b = J^T S^-1 (r + J
x)`. Priors are Gaussian, so the maximum and the evidence of the linearised model have closed forms
(`hyperparameters.py`).

All derivatives are taken at the force less each frame's own fast error f, and `r` is the residual there plus `A f`. At
the force as logged they would be correlated with its noise, which biases the stiffness upwards (errors in variables).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import overload

import numpy as np
from scipy.linalg import solve_triangular

from onebend.learning import normal
from onebend.learning.allowances import Sizes, patch_functions
from onebend.learning.fit_data import FitData
from onebend.learning.frames import whitened
from onebend.learning.frequencies import FrequencyData, PredictedFrequencies, predicted_frequencies
from onebend.learning.parameters import Block, Layout
from onebend.learning.prediction import Prediction, Slopes
from onebend.learning.sites import Sites, first_site, is_shaped
from onebend.progress import each
from onebend.records import Array, IntArray, tags_among


@dataclass(frozen=True)
class RecordingNoise:
    """Noise of one recording's frames, correlation in time included."""

    marker: float  # over what the tags' covariances say
    force: float  # N, the force error that is faster than its knots
    outline: float = 1.0  # that of an outline's points, over what their covariances say, over `marker`

    def shares(self, data: FitData) -> Array:
        """(R,) weights of a frame's whitened numbers by whose they are: 1 of tags."""
        points = np.ones(data.measured.shape[1], dtype=bool)
        points[data.tags] = False
        return np.repeat(np.where(points, 1.0 / self.outline, 1.0), 3)


@dataclass(frozen=True)
class Hyperparameters:
    """Sizes of priors and noise, which the data choose."""

    part_variances: Array  # (n,) variances of the parts of log k, see `Layout.stiffness_parts`
    coloured: float  # sd of the force error's coloured part, over what was expected
    memory: float  # its correlation time, likewise
    walk: float  # the random walk of the force error, likewise
    load: float  # sd of the force error that comes with the load, likewise
    noise: tuple[RecordingNoise, ...]
    sizes: Sizes = field(default_factory=dict)  # of allowances whose size the evidence chooses; 1 where not named
    sites: Sites = field(default_factory=dict)  # of parameters whose priors are not normal; their moments where absent
    white: float = 1.0  # of the force error's white part, likewise; the data choose it of key frames alone
    chains: Array | None = None  # where the sampler's chains stand, see `normal.mean_part_variances`

    @property
    def of_force(self) -> tuple[float, float, float, float, float]:
        """Factors on the expected force error: see `ForceError.root`."""
        return self.coloured, self.memory, self.walk, self.load, self.white


@dataclass(frozen=True)
class FitProblem:
    """One or several recordings of one beam, and the prior of the parameters."""

    recordings: tuple[FitData, ...]
    layout: Layout
    level: float  # prior mean of log k
    expected: Hyperparameters
    frequencies: tuple[FrequencyData, ...] = ()  # of those recordings that have measured ones
    stiffness: tuple[Array, Array] | None = None  # (p,) mean and (p, p) lower root of log k's prior; None: it has sizes

    def predicted_frequencies(self, x: Array, number: int | None = None) -> tuple[PredictedFrequencies, ...]:
        """Those of each such recording, or of the one with this number, at parameters x."""
        wanted = (data for data in self.frequencies if number in (None, data.number))
        return tuple(predicted_frequencies(data, self.layout, x) for data in wanted)

    def swings(self, x: Array) -> bool:
        """Whether the beam stands, and so swings, in every posture in which its frequencies were measured."""
        return all(np.isfinite(one.log).all() for one in self.predicted_frequencies(x))


@dataclass(frozen=True)
class Prior:
    """The prior of the parameters: `x = mean + L z` with z of covariance one.

    The fit is computed in z, so the prior covariance is never inverted and may be singular. Shared parameters and those
    of each recording are independent.
    """

    mean: Array  # (P,)
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording
    roots: tuple[normal.BlockRoot, ...]  # L of each part

    def times(self, z: Array) -> Array:
        """(P, ...) `L z`."""
        return np.concatenate([root.times(z[part]) for part, root in zip(self.parts, self.roots, strict=True)])

    def transposed_times(self, v: Array) -> Array:
        """(P, ...) `L' v`."""
        pairs = zip(self.parts, self.roots, strict=True)
        return np.concatenate([root.transposed_times(v[part]) for part, root in pairs])

    def whiten(self, x: Array) -> Array:
        """(P,) z of parameters x."""
        away = x - self.mean
        return np.concatenate([root.solve(away[part]) for part, root in zip(self.parts, self.roots, strict=True)])


def prior(problem: FitProblem, hyperparameters: Hyperparameters, log_k: Array | None = None) -> Prior:
    """The prior at given hyperparameters; `log_k` (p,): mean of log k's coefficients, where it is not one level."""
    layout, h = problem.layout, hyperparameters
    mean, sd = np.zeros(layout.size), np.ones(layout.size)

    def root_of(part: slice, inside: Sequence[Block]) -> normal.BlockRoot:
        blocks: list[tuple[slice, Array]] = []
        for block in inside:
            where, start, stop = block.where, block.where.start - part.start, block.where.stop - part.start
            if block.name == "stiffness":
                level, root = problem.stiffness or (problem.level, layout.stiffness_root(h.part_variances))
                blocks.append((slice(start, stop), root))
                mean[where] = level if log_k is None else log_k
            elif block.name == "force":  # x and y in turn, alike
                error = problem.recordings[block.recording].error
                mean[where], of_axis = error.mean.ravel(), error.root(*h.of_force)
                blocks += [(slice(start + axis, stop, 2), of_axis) for axis in range(2)]
            elif is_shaped(block):
                site = h.sites.get((block.name, block.recording))
                mean[where], sd[where] = site or first_site(block, h.sizes.get(block.name, 1.0))
            else:
                sd[where] = block.prior_sd * h.sizes.get(block.name, 1.0)
        return normal.BlockRoot(sd[part], tuple(blocks))

    return Prior(mean, layout.parts, each(root_of, layout.parts, layout.free_blocks))


def log_k_map(problem: FitProblem) -> tuple[IntArray, Array]:
    """Indices (n,) of the parameters of log k, and (f, n) their map to the finer spline's coefficients."""
    layout = problem.layout
    where, fine = layout.index["stiffness", -1].where, layout.spline.finer
    index: list[IntArray] = [np.arange(where.start, where.stop)]
    onto: list[Array] = [layout.spline.on_finer]
    under_tags, o = layout.index.get(("patches", -1)), problem.recordings[0].observations
    if under_tags is not None and under_tags.start >= 0:
        index.append(np.arange(under_tags.where.start, under_tags.where.stop))
        tag_s = o.marker_s[tags_among(o)]
        onto.append(fine.nearest(lambda s: patch_functions(tag_s, o.length, o.stated.tag_size, s)))
    return np.concatenate(index), np.concatenate(onto, axis=1)


# Several recordings: the posterior's precision is bordered block diagonal. Own parameters of each recording are
# integrated out (Schur complement), the shared ones are solved for. See Golub and Van Loan, Matrix Computations, 4.5.


@dataclass(frozen=True)
class JointInformation:
    """Log likelihood of every recording, to second order."""

    forms: tuple[normal.InformationForm, ...]  # of each recording, over the shared parameters and its own
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording

    @cached_property
    def vector(self) -> Array:
        """(P,) b."""
        count = self.parts[0].stop
        shared = np.sum([f.vector[:count] for f in self.forms], axis=0)
        return np.concatenate([shared, *(f.vector[count:] for f in self.forms)])

    def times(self, x: Array) -> Array:
        """(P, ...) `H x`."""
        count = self.parts[0].stop
        each = [f.matrix @ np.concatenate([x[:count], x[p]]) for f, p in zip(self.forms, self.parts[1:], strict=True)]
        return np.concatenate([np.sum([one[:count] for one in each], axis=0), *(one[count:] for one in each)])


@dataclass(frozen=True)
class Eliminated:
    """Parameters `y = m + L z`, integrated out: given the others x, the precision of z is `G G'`."""

    root: normal.BlockRoot  # L
    factor: Array  # (n, n) G, lower triangular
    across: Array  # (n, k) `G^-1 L' H_yx`
    white: Array  # (n,) `G^-1 L' (b - H m)`
    left: normal.InformationForm  # of x; its noise includes the volume of y

    def given(self, x: Array, white: Array | float) -> Array:
        """(n, ...) z at others x, for right sides `white` (n, ...)."""
        return _upper(self.factor, white - self.across @ x)

    def joint(self, others: Array) -> Array:
        """(k + n, k + n) covariance of the others, (k, k) `others`, and of y."""
        onto = -self.root.times(_upper(self.factor, self.across))
        own, across = normal.solved_lower(self.factor, self.root.dense().T), onto @ others
        return np.block([[others, across.T], [across, own.T @ own + across @ onto.T]])


def eliminated(
    form: normal.InformationForm, mean: Array, root: normal.BlockRoot, kept: int, damping: float = 0.0
) -> Eliminated:
    """All parameters of a form but the first `kept` integrated out; `damping` is added to the precision of z."""
    information, vector = form.matrix[kept:, kept:], form.vector[kept:]
    inside = root.around(information)
    inside[np.diag_indices(len(inside))] += 1.0 + damping
    factor = normal.in_own_pages(np.asarray(np.linalg.cholesky(inside), dtype=float))
    cross = form.matrix[kept:, :kept]
    across = normal.solved_lower(factor, root.transposed_times(cross))
    white = normal.solved_lower(factor, root.transposed_times(vector - information @ mean))
    left = normal.InformationForm(
        matrix=form.matrix[:kept, :kept] - across.T @ across,
        vector=form.vector[:kept] - cross.T @ mean - across.T @ white,
        constant=float(form.constant - 2.0 * vector @ mean + mean @ information @ mean - white @ white),
        log_noise=form.log_noise + float(np.sum(np.log(np.diag(factor)))),
    )
    return Eliminated(root, factor, across, white, left)


def marginal(
    form: normal.InformationForm, mean: Array, root: normal.BlockRoot, kept: IntArray
) -> normal.InformationForm:
    """Information on the parameters `kept` (k,), the others integrated out under their prior, mean (n,) and root."""
    others = np.setdiff1d(np.arange(len(mean)), kept)
    order = np.concatenate([kept, others])
    sorted_form = replace(form, matrix=form.matrix[np.ix_(order, order)], vector=form.vector[order])
    return eliminated(sorted_form, mean[others], root.take(others), len(kept)).left


@dataclass(frozen=True)
class Solved:
    """Data and prior together: with `x = m + L z`, z has the precision `I + L' H L`, plus a damping."""

    before: Prior
    own: tuple[Eliminated, ...]  # of each recording
    left: normal.InformationForm  # of the shared parameters, those of each recording integrated out
    factor: Array  # (n, n) lower triangular: of the precision of the shared z
    white: Array  # (n,)

    @cached_property
    def z(self) -> Array:
        """(P,) mean."""
        shared = _upper(self.factor, self.white)
        x = self.before.mean[self.before.parts[0]] + self.before.roots[0].times(shared)
        return np.concatenate([shared, *(one.given(x, one.white) for one in self.own)])

    @cached_property
    def mean(self) -> Array:
        """(P,) of the parameters."""
        return self.before.mean + self.before.times(self.z)

    @property
    def log_evidence(self) -> float:
        """But for a constant; of no meaning with a damping."""
        return self.log_evidence_of_shared - self.left.log_noise

    @property
    def log_evidence_of_shared(self) -> float:
        """Shared parameters integrated out, own ones at their maximum; without the log volumes."""
        mean, left = self.before.mean[self.before.parts[0]], self.left
        misfit = left.constant - 2.0 * left.vector @ mean + mean @ left.matrix @ mean - self.white @ self.white
        return float(-0.5 * misfit - np.sum(np.log(np.diag(self.factor))))

    def _whitened(self, v: Array) -> list[Array]:
        """`G^-1 v`, part by part, the shared parameters last; `G G' = A`, the precision of z."""
        parts, root = self.before.parts, self.before.roots[0]
        white = [normal.solved_lower(one.factor, v[part]) for one, part in zip(self.own, parts[1:], strict=True)]
        known = sum((one.across.T @ w for one, w in zip(self.own, white, strict=True)), np.zeros_like(v[parts[0]]))
        return [*white, normal.solved_lower(self.factor, v[parts[0]] - root.transposed_times(known))]

    def solve(self, v: Array) -> Array:
        """(P, ...) `A^-1 v`, A being the precision of z."""
        *white, last = self._whitened(v)
        shared = _upper(self.factor, last)
        x = self.before.roots[0].times(shared)
        return np.concatenate([shared, *(one.given(x, w) for one, w in zip(self.own, white, strict=True))])

    def spread(self, rows: Array) -> Array:
        """(R, R) covariance of R linear functions of the parameters, rows (R, P)."""
        half = np.concatenate(self._whitened(self.before.transposed_times(rows.T)))
        return half.T @ half

    def times_covariance(self, v: Array) -> Array:
        """(P, ...) `C v`, C being the covariance of the parameters."""
        return self.before.times(self.solve(self.before.transposed_times(v)))

    @cached_property
    def of_shared(self) -> Array:
        """(n, n) covariance of the shared parameters."""
        half = normal.solved_lower(self.factor, self.before.roots[0].dense().T)
        return half.T @ half

    def pair(self, number: int) -> Array:
        """(n, n) covariance of the shared parameters and one recording's own."""
        return self.own[number].joint(self.of_shared)

    @property
    def covariance(self) -> normal.JointCovariance:
        """Of the parameters."""
        return normal.JointCovariance(len(self.of_shared), _Pairs(self), self.before.parts)


class _Pairs(Sequence[Array]):
    """`Solved.pair` of each recording, computed on demand to save memory; the last one is cached."""

    def __init__(self, posterior: Solved) -> None:
        self._posterior = posterior
        self._last: tuple[int, Array] | None = None

    def __len__(self) -> int:
        return len(self._posterior.own)

    @overload
    def __getitem__(self, number: int) -> Array: ...
    @overload
    def __getitem__(self, number: slice) -> Sequence[Array]: ...
    def __getitem__(self, number: int | slice) -> Array | Sequence[Array]:
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(len(self)))]
        if not 0 <= number < len(self):
            raise IndexError(number)
        last = self._last
        if last is None or last[0] != number:
            last = self._last = number, self._posterior.pair(number)
        return last[1]


def solved(data: JointInformation, before: Prior, damping: float = 0.0) -> Solved:
    """The posterior of the linearised model; `damping` is added to the precision of z."""
    shared, count = before.parts[0], before.parts[0].stop
    means = [before.mean[part] for part in before.parts[1:]]
    own = each(partial(eliminated, kept=count, damping=damping), data.forms, means, before.roots[1:])
    left, root, mean = normal.total([one.left for one in own]), before.roots[0], before.mean[shared]
    inside = root.around(left.matrix)
    inside[np.diag_indices(count)] += 1.0 + damping
    factor = np.asarray(np.linalg.cholesky(inside), dtype=float)
    white = normal.solved_lower(factor, root.transposed_times(left.vector - left.matrix @ mean))
    return Solved(before, own, left, factor, white)


def own_in_z(form: normal.InformationForm, before: Prior, number: int) -> normal.InformationForm:
    """The information of one recording, with z for its own parameters: independent of the damping."""
    part, shared = before.parts[1 + number], before.parts[0].stop
    mean = np.concatenate([np.zeros(shared), before.mean[part]])
    own = normal.in_z(form, mean, normal.beside(normal.unit_root(shared), before.roots[1 + number]))
    return replace(own, matrix=normal.in_own_pages(own.matrix))


def prior_in_own_z(before: Prior) -> Prior:
    """The prior, with z for the parameters that each recording has of its own."""
    shared, first = before.parts[0], before.roots[0]
    mean = np.concatenate([before.mean[shared], np.zeros(len(before.mean) - shared.stop)])
    return Prior(mean, before.parts, (first, *(normal.unit_root(part.stop - part.start) for part in before.parts[1:])))


def coupled(data: JointInformation, before: Prior, own: Sequence[IntArray]) -> tuple[JointInformation, Prior]:
    """Data and prior of some own parameters of each recording and of the shared ones; all else is integrated out.

    `own` (m,): indices in the part of each recording. The shared ones are integrated out, too, for one recording.
    """
    shared = before.parts[0]
    count = shared.stop if len(own) > 1 else 0

    def of(form: normal.InformationForm, part: slice, root: normal.BlockRoot, mine: IntArray) -> normal.InformationForm:
        mean = np.concatenate([before.mean[shared], before.mean[part]])
        return marginal(
            form, mean, normal.beside(before.roots[0], root), np.concatenate([np.arange(count), shared.stop + mine])
        )

    forms = each(of, data.forms, before.parts[1:], before.roots[1:], own)
    means = [before.mean[part][mine] for part, mine in zip(before.parts[1:], own, strict=True)]
    roots = [root.take(mine) for root, mine in zip(before.roots[1:], own, strict=True)]
    ends = np.cumsum([count, *(len(mine) for mine in own)]).tolist()
    every = tuple(slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    all_roots = (before.roots[0].take(np.arange(count)), *roots)
    return JointInformation(forms, every), Prior(np.concatenate([before.mean[:count], *means]), every, all_roots)


def _upper(factor: Array, right: Array) -> Array:
    return normal.solved_lower(factor, right, across=True)


_ROBUST = 6.0  # degrees of freedom of Student's t: weights of tags that fit badly


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


def residual_rows(now: Prediction, noise: RecordingNoise, slopes: Slopes | None = None) -> ResidualRows:
    """Rows of one recording, weighted by Student's t on the residuals less the effect of their frame's force.

    The beam at rest is a mean of many frames and no outlier: it counts in full. Otherwise a search that begins far from
    it may end where the rest is missed and an error of all forces explains the push.

    `slopes`: derivatives to use instead of `whitened_slopes`.
    """
    plain, share = unweighted_rows(now, slopes), noise.shares(now.data)
    plain = replace(plain, r=share * plain.r, root_weight=share * plain.root_weight)
    known, frames = plain.known, len(plain.r)
    unexplained, _ = split_off_force(plain, plain.r, noise)
    squares = np.sum(unexplained.reshape(frames, -1, 3) ** 2, axis=-1) / noise.marker**2
    numbers = np.sum(known.reshape(frames, -1, 3), axis=-1)
    weight = np.where(now.data.resting[:, None], 1.0, (_ROBUST + numbers) / (_ROBUST + squares))
    root = np.repeat(np.sqrt(weight), 3, axis=1)
    return replace(plain, r=root * plain.r, root_weight=root * plain.root_weight)


def unweighted_rows(now: Prediction, slopes: Slopes | None = None) -> ResidualRows:
    """Rows of one recording, only whitened."""
    slopes = now.whitened_slopes if slopes is None else slopes
    known = np.any(now.data.whiten != 0.0, axis=-1).astype(float).reshape(len(now.pose), -1)
    return ResidualRows(residuals(now) + explained_by(slopes.a, now.own), slopes, known, known)


def residuals(now: Prediction) -> Array:
    """(F, 3 m) whitened measured minus predicted poses; zero where a tag was not seen."""
    data = now.data
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
) -> normal.InformationForm:
    """Log likelihood of one recording's tags at given noise, the frames' own forces integrated out.

    The information on the knots of the slow force error follows from that on the force:
    `A' S^-1 = ((s/f)^2 + A' A)^-1 A' / f^2`. Memory of the material adds to the effect of a lasting force.
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
    return normal.InformationForm(inside, tag_score(rows, y, noise), float(c), log_noise)


def _with_knots(slopes: Slopes, dense: Array, by_push: Array, of_push: Array) -> Array:
    """(C, C) information on the parameters from that on the columns of `slopes.j` (D, D) and each frame's push."""
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
    """(C,) `J' S^-1 r` of weighted residuals r (F, R) of one recording."""
    slopes = rows.whitened
    unexplained, force = split_off_force(rows, r, noise)
    weighted = rows.root_weight * unexplained / noise.marker**2
    dense, by_push = weighted.ravel() @ slopes.j.reshape(-1, slopes.j.shape[-1]), force / noise.force**2
    if slopes.added is not None:
        by_push = by_push + np.einsum("frd,fr->fd", slopes.added, weighted)
    return slopes.with_knots(dense[:, None], by_push[..., None])[:, 0]


@dataclass(frozen=True)
class BesideTags:
    """What a recording says beside its tags: numbers over their sds, by its parameters x (C,)."""

    r: Array  # (N,) residuals
    j: Array  # (N, C) derivatives of what is expected
    log_noise: float

    def information(self, x: Array) -> normal.InformationForm:
        """Log likelihood, to first order about x."""
        y = self.r + self.j @ x
        return normal.InformationForm(self.j.T @ self.j, self.j.T @ y, float(y @ y), self.log_noise)


def beside_tags(problem: FitProblem, number: int, x: Array) -> BesideTags:
    """The force log in the rests, where the true force is zero, the tool in the film, and the natural frequencies, at
    parameters x (P,)."""
    data, layout = problem.recordings[number], problem.layout
    mine, where, error = layout.known_to(number), layout.columns("force", number), data.error
    r, j, sds = [], [], []
    if where is not None:
        onto = np.zeros((error.rest_values.size, len(mine)))
        onto[:, where] = np.kron(error.rest_weights, np.eye(2)) / error.rest_sd  # x and y in turn
        j, r = [onto], [error.rest_values.ravel() / error.rest_sd - onto @ x[mine]]
        sds = [np.full(error.rest_values.size, error.rest_sd)]
    rows, away = tool_rows(data, layout)
    j, r = [*j, rows], [*r, away - rows @ x[mine]]
    for predicted in problem.predicted_frequencies(x, number):
        sd = predicted.data.sd
        j, r, sds = [*j, predicted.slopes[:, mine] / sd[:, None]], [*r, predicted.residuals], [*sds, sd]
    return BesideTags(np.concatenate(r), np.concatenate(j), float(sum(np.sum(np.log(sd)) for sd in sds)))


def tool_rows(data: FitData, layout: Layout) -> tuple[Array, Array]:
    """(P, C) of the place of the push with the parameters, and (P,) where the film shows the tool, over their sds."""
    tool, count = data.observations.tool, len(layout.known_to(data.number))
    if tool is None or layout.columns("place", data.number) is None:
        return np.zeros((0, count)), np.zeros(0)
    time, length = data.observations.time[data.frames], data.observations.length
    rows = np.zeros((len(tool.time), count))
    rows[:, layout.columns("place", data.number)] = 1.0 / length
    for one in data.entering("place"):
        where = layout.columns(one.name, data.number)
        if where is not None:
            basis = one.basis[: len(time)].T / length
            rows[:, where] = np.stack([np.interp(tool.time, time, of_one) for of_one in basis], axis=1)
    away = tool.s - np.interp(tool.time, time, data.push_s[: len(time)])
    white = solve_triangular(tool.root, np.column_stack([rows, away]), lower=True)
    return white[:, :-1], white[:, -1]


def recording_information(
    layout: Layout, number: int, rows: ResidualRows, beside: BesideTags, x: Array, noise: RecordingNoise
) -> normal.InformationForm:
    """Log likelihood of one recording's tags, and of what it says `beside` them at parameters x (P,)."""
    others = beside.information(x[layout.known_to(number)])
    return normal.total([tag_information(rows, layout, number, x, noise), others])


def data_information(
    problem: FitProblem, rows: Sequence[ResidualRows], x: Array, hyperparameters: Hyperparameters
) -> JointInformation:
    """Log likelihood of all tags, rests and frequencies."""

    def of(number: int, r: ResidualRows, noise: RecordingNoise) -> normal.InformationForm:
        form = recording_information(problem.layout, number, r, beside_tags(problem, number, x), x, noise)
        return replace(form, matrix=normal.in_own_pages(form.matrix))

    return JointInformation(each(of, range(len(rows)), rows, hyperparameters.noise), problem.layout.parts)


def force_shrinkage(rows: ResidualRows, noise: RecordingNoise) -> Array:
    """(F, 2, 2) `((s/f)^2 + A'A)^-1`: covariance of each frame's own force over `s^2`."""
    (xx, xy), (_, yy) = np.moveaxis((noise.marker / noise.force) ** 2 * np.eye(2) + rows.gram, 0, -1)
    return np.asarray(np.moveaxis(np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy**2), -1, 0))
