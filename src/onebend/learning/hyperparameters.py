"""Hyperparameters: noise of tags and force, and the sizes in the prior of log k.

The noise of a recording comes from its residuals by expectation-maximisation. The sizes of the force error maximise the
evidence of the linearised model under log-normal priors; the covariance of the parameters is averaged over them by a
cubature of degree three. The sizes in the prior of log k are drawn from their posterior (`normal.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import minimize

from onebend.learning import linear
from onebend.learning.allowances import Sizes
from onebend.learning.fit_data import FitData
from onebend.learning.force_error import ForceError
from onebend.learning.normal import (
    BlockRoot,
    Draws,
    InformationForm,
    JointCovariance,
    StiffnessMixture,
    beside,
    in_own_pages,
    in_z,
    mean_part_variances,
    normal_mixture,
    stiffness_mixture,
    unit_root,
)
from onebend.learning.parameters import Block
from onebend.learning.sites import first_site, is_shaped, updated
from onebend.progress import each
from onebend.recording.signals import correlation_time
from onebend.records import Array, IntArray

CHOSEN = ("coloured", "memory", "walk", "load", "white")  # the sizes of the force error; the last of key frames alone
# One sd of the logs of all but the last: factors of two in size and two and a half in correlation time of the coloured
# noise, and of three in the walk and in the load's error.
SPREAD = np.array([0.7, 0.9, 1.1, 1.2])
_TELL_SIZES = 10  # recordings, evenly chosen, that the sizes of the force error are estimated from
_NOTHING: IntArray = np.zeros(0, dtype=np.int64)
_FARTHEST = 4.0  # sd of their logs from what is expected
_GUESS_COUNTS = 3.0  # numbers that the guessed noise of readings counts for
_CENTRE_SHARE = 0.25  # weight of the central node of the cubature
_CURVATURE_STEP = 0.3  # sd of their logs, of the differences that give the evidence's curvature
_ON_THE_WAY = Draws(chains=12, burn=15, kept=25)  # 300: a mean to 6 % of the spread, were they independent
_AT_THE_END = Draws(chains=4, burn=20, kept=60)  # for each of the nodes of the cubature: 240
_LEAST_NOISE = 0.02  # of the tags' stated sd: below it the solver's error (1e-8 L) would be fitted


@dataclass(frozen=True)
class Evidence:
    """The marginal likelihood of the linearised model as a function of the hyperparameters."""

    problem: linear.FitProblem
    data: linear.JointInformation  # of tags and rests
    spread: Array = field(default_factory=SPREAD.copy)  # (d,) see `SPREAD`; that of the first d sizes

    def posterior(self, hyperparameters: linear.Hyperparameters) -> linear.Solved:
        """Of all parameters, at these hyperparameters."""
        return linear.solved(self.data, linear.prior(self.problem, hyperparameters))

    def stiffness_form(self, posterior: linear.Solved, weight: float = 1.0) -> InformationForm:
        """Likelihood of log k, all else integrated out at the hyperparameters of a posterior."""
        p, before = self.problem.layout.spline.count, posterior.before
        others = np.arange(p, before.parts[0].stop)
        if not len(others):
            return replace(posterior.left, weight=weight)
        left = linear.eliminated(posterior.left, before.mean[others], before.roots[0].take(others), p).left
        return replace(left, weight=weight)

    def hyperparameters_at(self, start: linear.Hyperparameters, z: Array) -> linear.Hyperparameters:
        """Sizes of the force error z (d,) sd from what was expected, all else as at `start`."""
        sizes: dict[str, Any] = dict(zip(CHOSEN, self.sizes_at(start, z), strict=True))
        return replace(start, **sizes)

    def sizes_at(self, start: linear.Hyperparameters, z: Array) -> tuple[float, ...]:
        """In the order of `CHOSEN`."""
        sizes = self._expected * np.exp(self.spread * np.clip(z, -_FARTHEST, _FARTHEST))
        return *sizes.tolist(), *start.of_force[len(z) :]

    def cost(self, start: linear.Hyperparameters) -> Callable[[Array], float]:
        """Minus log posterior of z. All but the force's error and the shared parameters is integrated out once; of many
        recordings only some are used, the others are taken at `start`."""
        before, problem = linear.prior(self.problem, start), self.problem
        asked = set(np.linspace(0, len(problem.recordings) - 1, _TELL_SIZES).astype(int).tolist())
        own = [self._force_error(number) if number in asked else _NOTHING for number in range(len(problem.recordings))]
        data, some = linear.coupled(self.data, before, own)
        errors = [r.error if len(mine) else None for r, mine in zip(problem.recordings, own, strict=True)]

        def of(z: Array) -> float:
            roots = each(partial(error_root, sizes=self.sizes_at(start, z)), errors)
            try:
                log_evidence = linear.solved(data, replace(some, roots=(some.roots[0], *roots))).log_evidence
            except np.linalg.LinAlgError:
                return 1e12
            return 0.5 * float(z @ z) - log_evidence

        return of

    def _force_error(self, number: int) -> IntArray:
        """(2 K,) where the force's error stands among a recording's own parameters."""
        layout = self.problem.layout
        block = layout.index["force", number]
        count = len(block.prior_sd) if block.start >= 0 else 0
        start = block.start - layout.parts[1 + number].start
        return np.arange(start, start + count)

    def place(self, hyperparameters: linear.Hyperparameters) -> Array:
        """(d,) sd of the force error's sizes from what was expected."""
        sizes = np.array(hyperparameters.of_force[: len(self.spread)])
        return np.asarray(np.log(sizes / self._expected) / self.spread)

    @cached_property
    def _expected(self) -> Array:
        """(d,)."""
        return np.array(self.problem.expected.of_force[: len(self.spread)])


def error_root(error: ForceError | None, sizes: tuple[float, ...]) -> BlockRoot:
    """Of the error's coefficients, x and y in turn, at these factors on the expected sizes."""
    if error is None:
        return BlockRoot(np.zeros(0))
    of_axis = error.root(*sizes)
    count = 2 * len(of_axis)
    return BlockRoot(np.ones(count), tuple((slice(axis, count, 2), of_axis) for axis in range(2)))


def choose_hyperparameters(evidence: Evidence, start: linear.Hyperparameters) -> linear.Hyperparameters:
    """Sizes of the force error of greatest evidence, and the mean prior of log k under them."""
    return with_stiffness_prior(evidence, likeliest(evidence, start))


def likeliest(evidence: Evidence, start: linear.Hyperparameters) -> linear.Hyperparameters:
    """Sizes of the force error of greatest evidence."""
    begin = evidence.place(start)
    bounds = [(-_FARTHEST, _FARTHEST)] * len(begin)
    options = {"maxfun": 60, "eps": 1e-3, "ftol": 1e-4, "gtol": 0.15}
    result = minimize(evidence.cost(start), begin, method="L-BFGS-B", bounds=bounds, options=options)
    return evidence.hyperparameters_at(start, result.x)


def with_stiffness_prior(evidence: Evidence, hyperparameters: linear.Hyperparameters) -> linear.Hyperparameters:
    """The hyperparameters with the mean prior of log k under them; where its shape is stated, it stays as it is."""
    problem = evidence.problem
    if problem.layout.known is not None:
        return hyperparameters
    form = evidence.stiffness_form(evidence.posterior(hyperparameters))
    variances, chains = mean_part_variances(
        problem.layout.spline, form, problem.level, _ON_THE_WAY, hyperparameters.chains
    )
    return replace(hyperparameters, part_variances=variances, chains=chains)


def at_nodes(
    evidence: Evidence, hyperparameters: linear.Hyperparameters, sizes: Sequence[Sizes]
) -> Iterator[tuple[linear.Solved, float]]:
    """Posteriors at the nodes of a cubature over the hyperparameters, and their weights, which sum to one; `sizes` are
    equally probable."""
    nodes, weights = _cubature(evidence, hyperparameters)
    for (share, node), one_size in product(zip(weights.tolist(), nodes, strict=True), sizes):
        yield evidence.posterior(replace(node, sizes=one_size)), share / len(sizes)


def averaged_stiffness(
    evidence: Evidence, nodes: Iterable[tuple[linear.Solved, float]], draws: Draws, chains: Array | None = None
) -> StiffnessMixture:
    """log k, averaged over the hyperparameters; `nodes` as of `at_nodes`, `chains` as of `Hyperparameters`."""
    layout, p = evidence.problem.layout, evidence.problem.layout.spline.count
    if layout.known is None and evidence.problem.stiffness is None:
        forms = [evidence.stiffness_form(posterior, weight) for posterior, weight in nodes]
        return stiffness_mixture(layout.spline, forms, evidence.problem.level, draws, chains)
    normals = [(weight, one.mean[:p], one.of_shared[:p, :p]) for one, weight in nodes]
    weights, means, spreads = (np.array(part) for part in zip(*normals, strict=True))
    away = means - weights @ means
    spread = np.tensordot(weights, spreads, 1) + (weights * away.T) @ away
    return normal_mixture(weights @ means, 0.5 * (spread + spread.T))


def averaged_posterior(
    evidence: Evidence, hyperparameters: linear.Hyperparameters, sizes: Sequence[Sizes], draws: Draws = _AT_THE_END
) -> tuple[StiffnessMixture, JointCovariance]:
    """log k and the covariance of all parameters, averaged over the hyperparameters; `sizes` as of `at_nodes`."""
    layout, best = evidence.problem.layout, evidence.posterior(hyperparameters).mean
    known = [layout.known_to(number) for number in range(len(evidence.problem.recordings))]
    pairs = [in_own_pages(np.zeros((len(i), len(i)))) for i in known]

    def add(pair: Array, number: int, index: IntArray, posterior: linear.Solved, weight: float) -> None:
        away = (posterior.mean - best)[index]
        pair += weight * (posterior.pair(number) + np.outer(away, away))

    def added() -> Iterator[tuple[linear.Solved, float]]:  # one by one: all of them take much memory
        for posterior, weight in at_nodes(evidence, hyperparameters, sizes):
            each(partial(add, posterior=posterior, weight=weight), pairs, range(len(known)), known)
            yield posterior, weight

    stiffness = averaged_stiffness(evidence, added(), draws, hyperparameters.chains)
    for pair in pairs:  # in its place, likewise
        pair[:] = _with_stiffness(pair, stiffness.covariance)
    return stiffness, JointCovariance(layout.shared, tuple(pairs), layout.parts)


def _with_stiffness(covariance: Array, of_log_k: Array) -> Array:
    """A covariance (n, n) with another one of log k's coefficients (p, p), which come first; the rest by regression."""
    p = len(of_log_k)
    regression = np.linalg.solve(covariance[:p, :p], covariance[:p]).T  # of all parameters on those of log k
    out = covariance + regression @ (of_log_k - covariance[:p, :p]) @ regression.T
    return np.asarray(0.5 * (out + out.T))


def _cubature(
    evidence: Evidence, hyperparameters: linear.Hyperparameters
) -> tuple[list[linear.Hyperparameters], Array]:
    """Nodes over the sizes of the force error, and weights as the evidence says: exact to degree three."""
    middle, cost = evidence.place(hyperparameters), evidence.cost(hyperparameters)
    lowest = cost(middle)
    points, log_shares = cubature(middle, _hessian(cost, middle, lowest, _CURVATURE_STEP))
    weights = shares_of(log_shares - np.array([lowest, *(cost(z) for z in points[1:])]))
    return [evidence.hyperparameters_at(hyperparameters, z) for z in points], weights


def cubature(middle: Array, curvature: Array) -> tuple[Array, Array]:
    """(2 d + 1, d) nodes around the `middle` of a cost with this curvature (d, d), and the logs of their weights over
    `exp(-cost)`."""
    values, vectors = np.linalg.eigh(curvature)
    sd = 1.0 / np.sqrt(np.maximum(values, 0.5))  # the prior alone has curvature one
    n = len(middle)
    radius = np.sqrt(n / (1.0 - _CENTRE_SHARE))
    offsets = radius * np.concatenate([np.zeros((1, n)), (vectors * sd).T, -(vectors * sd).T])
    normal = 0.5 * radius**2 * np.concatenate([[0.0], np.ones(2 * n)])
    shares = np.array([_CENTRE_SHARE, *[(1.0 - _CENTRE_SHARE) / (2 * n)] * (2 * n)])
    return middle + offsets, np.log(shares) + normal


def shares_of(logs: Array) -> Array:
    """Weights that sum to one, from their logs up to a constant."""
    weights = np.exp(logs - np.max(logs))
    return np.asarray(weights / np.sum(weights))


def _hessian(cost: Callable[[Array], float], middle: Array, there: float, h: float) -> Array:
    """Second derivatives by central differences; `there` is the cost in the middle."""
    n, e = len(middle), h * np.eye(len(middle))
    out = np.zeros((n, n))
    for i in range(n):
        out[i, i] = (cost(middle + 2.0 * e[i]) - 2.0 * there + cost(middle - 2.0 * e[i])) / (4.0 * h**2)
        for j in range(i):
            pairs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            terms = [a * b * cost(middle + a * e[i] + b * e[j]) for a, b in pairs]
            out[i, j] = out[j, i] = sum(terms) / (4.0 * h**2)
    return out


def expected_recording_noise(data: FitData) -> linear.RecordingNoise:
    """The noise before any residual is known."""
    if data.observations.static:
        return linear.RecordingNoise(1.0, _load_sd(data))
    return linear.RecordingNoise(1.5, 0.5 * data.error.size)


def new_noise(
    data: FitData, rows: linear.ResidualRows, before: linear.RecordingNoise, spent: float
) -> linear.RecordingNoise:
    """The noise from the residuals.

    Static poses have stated sds of their loads. A guessed sd of their points counts as a few numbers; a stated one is a
    lower bound.
    """
    if not data.observations.static:
        return updated_noise(rows, before, spent, np.setdiff1d(np.arange(data.measured.shape[1]), data.tags))
    unexplained, _ = linear.split_off_force(rows, rows.r, before)
    numbers = float(np.sum(rows.known))
    free = max(numbers - spent, 0.3 * numbers)
    marker = float(np.sqrt((np.sum(rows.r * unexplained) + _GUESS_COUNTS) / (free + _GUESS_COUNTS)))
    return linear.RecordingNoise(max(marker, 1.0) if data.observations.sd_known else marker, _load_sd(data))


def _load_sd(data: FitData) -> float:
    """N, of a weighed load; next to nothing where it is known exactly."""
    return max(float(np.max(data.observations.force_sd)), 1e-9)


def updated_noise(
    rows: linear.ResidualRows, before: linear.RecordingNoise, spent: float, points: IntArray = _NOTHING
) -> linear.RecordingNoise:
    """Noise of a recording from its residuals, by expectation-maximisation over the frames' own force errors; that of
    an outline's `points` among the markers has a size of its own where there are tags, and is at least as stated.

    `spent`: effective number of parameters (trace of the tags' information times the covariance).
    """
    numbers = float(np.sum(rows.known))
    share = max(1.0 - spent / max(numbers, 1.0), 0.3)
    traced = np.isin(np.arange(rows.r.shape[1]) // 3, points)
    kinds = [one for one in (~traced, traced) if one.any()]
    noise, by_force = before, rows.by_force(rows.r)
    for _ in range(30):
        shrinkage = linear.force_shrinkage(rows, noise)
        force = np.einsum("fde,fe->fd", shrinkage, by_force)
        moments = noise.marker**2 * shrinkage + force[:, :, None] * force[:, None]  # (F, 2, 2) of each frame's force
        left = (rows.r - linear.explained_by(rows.a, force)) ** 2
        left = left + noise.marker**2 * np.einsum("frd,fde,fre->fr", rows.a, shrinkage, rows.a)
        sizes = [np.sqrt(np.sum(left[:, one]) / (share * max(float(np.sum(rows.known[:, one])), 1.0))) for one in kinds]
        own = np.mean(np.trace(moments, axis1=1, axis2=2)) / 2.0
        noise = replace(before, marker=float(max(sizes[0], _LEAST_NOISE)), force=float(np.sqrt(own)))
    unexplained, force = linear.split_off_force(rows, rows.r, noise)
    times = [correlation_time(unexplained[:, one]) for one in kinds]
    marker, *outline = [size * float(np.sqrt(time)) for size, time in zip(sizes, times, strict=True)]
    marker = max(marker, 1.0 if traced.all() else _LEAST_NOISE)
    shares = (max(before.outline * one, 1.0) / marker for one in outline)
    return linear.RecordingNoise(marker, noise.force * float(np.sqrt(correlation_time(force))), *shares)


_SITE_ROUNDS = 4  # of sites and posterior


def with_sites(evidence: Evidence, start: linear.Hyperparameters) -> linear.Hyperparameters:
    """The hyperparameters with the sites of the parameters whose priors are not normal."""
    layout = evidence.problem.layout
    wanted = [block for block in layout.blocks if is_shaped(block)]
    for _ in range(_SITE_ROUNDS):
        posterior, sites = evidence.posterior(start), dict(start.sites)
        pairs = [posterior.pair(number) for number in range(len(evidence.problem.recordings))]
        for block in wanted:
            key, size = (block.name, block.recording), start.sizes.get(block.name, 1.0)
            columns = layout.columns(*key)
            covariance = pairs[max(block.recording, 0)][columns, columns]
            before = sites.get(key) or first_site(block, size)
            sites[key] = updated(block, before, posterior.mean[block.where], covariance, size)
        start = replace(start, sites=sites)
    return start


FACTORS = np.exp(np.linspace(np.log(0.02), np.log(10.0), 120))  # that are tried


def choose_sizes(evidence: Evidence, start: linear.Hyperparameters) -> Sizes:
    """The factor of greatest evidence for each `sized` allowance in turn (automatic relevance determination)."""
    sizes = dict(start.sizes)
    names = {a.name for data in evidence.problem.recordings for a in data.allowances if a.sized}
    for name in sorted(names):
        log_density = size_density(evidence, replace(start, sizes=sizes), name)
        sizes[name] = float(FACTORS[int(np.argmax(log_density))])
    return sizes


def size_density(evidence: Evidence, start: linear.Hyperparameters, name: str) -> Array:
    """(FACTORS,) log posterior density of the log of one allowance's factor, up to a constant, all else at `start`."""
    layout, before = evidence.problem.layout, linear.prior(evidence.problem, start)
    where = [_stands(inside, name, part.start) for inside, part in zip(layout.free_blocks, layout.parts, strict=True)]
    sd = [np.concatenate([np.zeros(0), *(b.prior_sd for b in own if b.name == name)]) for own in layout.free_blocks]
    if len(where[0]):
        form = linear.marginal(
            linear.solved(evidence.data, before).left, before.mean[layout.parts[0]], before.roots[0], where[0]
        )
        return log_density_of([_scaled(form, 0, sd[0])], 0)
    data, some = linear.coupled(evidence.data, before, where[1:])
    couple, root = some.parts[0].stop, some.roots[0]
    forms = []
    for form, s in zip(data.forms, sd[1:], strict=True):
        mean = np.concatenate([some.mean[:couple], np.zeros(len(s))])
        forms.append(_scaled(in_z(form, mean, beside(root, unit_root(len(s)))), couple, s))
    return log_density_of(forms, couple)


def likely_sizes(evidence: Evidence, start: linear.Hyperparameters, name: str, count: int) -> Array:
    """(count,) factors on one allowance that are about equally probable: middles of parts of its posterior."""
    log_density = size_density(evidence, start, name)
    share = np.exp(log_density - np.max(log_density))
    below = (np.cumsum(share) - 0.5 * share) / np.sum(share)
    return np.asarray(np.exp(np.interp((np.arange(count) + 0.5) / count, below, np.log(FACTORS))))


def _stands(blocks: Sequence[Block], name: str, start: int) -> IntArray:
    """(n,) indices of the blocks of a name in a part of the parameters that begins at `start`."""
    indices = [i - start for b in blocks if b.name == name for i in range(b.where.start, b.where.stop)]
    return np.array(indices, dtype=np.int64)


def _scaled(form: InformationForm, kept: int, sd: Array) -> InformationForm:
    """A form in units of sd (n,) of all but its first parameters."""
    scale = np.concatenate([np.ones(kept), sd])
    return InformationForm(scale[:, None] * form.matrix * scale, scale * form.vector)


def log_density_of(forms: Sequence[InformationForm], couple: int) -> Array:
    """(FACTORS,) log posterior density of the log of a factor f, for coefficients b of prior covariance `f^2 I`.

    Each form is over `couple` shared parameters of covariance one, and own coefficients. With all integrated out,
    `2 log p = sum (f^2 b' (I + f^2 H)^-1 b - log det(I + f^2 H)) + c' (I + S)^-1 c - log det(I + S)`,
    H and b of each form's own coefficients, S and c what is left of the shared ones.
    """
    variance = FACTORS[:, None] ** 2
    log_density = np.log(FACTORS) - np.log1p(FACTORS**2)  # half-Cauchy, of the log of the factor
    left, right = np.tile(np.eye(couple), (len(FACTORS), 1, 1)), np.zeros((len(FACTORS), couple))
    for form in forms:
        values, vectors = np.linalg.eigh(form.matrix[couple:, couple:])
        values = np.maximum(values, 0.0)
        across, b = vectors.T @ form.matrix[couple:, :couple], vectors.T @ form.vector[couple:]
        weights = variance / (1.0 + variance * values)  # (factors, n)
        log_density += 0.5 * (weights @ b**2 - np.sum(np.log1p(variance * values), axis=1))
        if couple:
            left += form.matrix[:couple, :couple] - across.T @ (weights[..., None] * across)
            right += form.vector[:couple] - (weights * b) @ across
    if couple:
        root = np.linalg.cholesky(left)
        white = np.linalg.solve(root, right[..., None])[..., 0]
        log_density += 0.5 * np.sum(white**2, axis=1) - np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return np.asarray(log_density)
