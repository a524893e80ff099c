"""Normal densities by their information matrix and vector, joint covariances, and the posterior of log k by MCMC."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotrs, dtrtrs
from scipy.special import ndtri

from onebend.beam.stiffness import SHAPE_LEVELS, SHAPE_PLACES
from onebend.learning.parameters import Spline
from onebend.records import Array, IntArray

_WORTH_PAGES = 1 << 19  # bytes: a smaller array stays where it is


def in_own_pages(array: Array) -> Array:
    """A large array copied to memory pages of its own, which are returned when it is freed.

    Long-lived arrays on the heap keep it from shrinking: with a hundred recordings by a third of the memory.
    """
    if array.nbytes < _WORTH_PAGES:
        return array
    rows = array.T if array.flags.f_contiguous else array
    out = np.frombuffer(_pages(array.nbytes), dtype=array.dtype).reshape(rows.shape)
    out[...] = rows
    return out.T if array.flags.f_contiguous else out


def _pages(count: int) -> mmap.mmap:
    """So many bytes, of this process alone."""
    if hasattr(mmap, "MAP_PRIVATE"):
        return mmap.mmap(-1, count, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return mmap.mmap(-1, count)


@dataclass(frozen=True)
class BlockRoot:
    """(n, n) lower triangular L: diagonal but for some blocks."""

    sd: Array  # (n,) the diagonal; of no meaning where a block stands
    blocks: tuple[tuple[IntArray | slice, Array], ...] = ()  # which rows and columns, and (m, m) lower triangular

    @cached_property
    def unit(self) -> bool:
        """Whether L is the identity."""
        return not self.blocks and bool(np.all(self.sd == 1.0))

    def times(self, z: Array) -> Array:
        """(n, ...) `L z`."""
        out = (self.sd * z.T).T
        for rows, root in self.blocks:
            out[rows] = root @ z[rows]
        return out

    def transposed_times(self, v: Array) -> Array:
        """(n, ...) `L' v`; v itself where L is the identity."""
        if self.unit:
            return v
        out = (self.sd * v.T).T
        for rows, root in self.blocks:
            out[rows] = root.T @ v[rows]
        return out

    def solve(self, x: Array) -> Array:
        """(n, ...) `L^-1 x`."""
        out = np.array((x.T / self.sd).T)
        for rows, root in self.blocks:
            out[rows] = solved_lower(root, x[rows])
        return out

    def around(self, matrix: Array) -> Array:
        """(n, n) `L' M L`, a new array."""
        if self.unit:
            return matrix.copy()
        half = np.ascontiguousarray(self.transposed_times(matrix).T)  # rows in one piece are read faster
        return self.transposed_times(half).T

    def take(self, index: IntArray) -> BlockRoot:
        """The root of some parameters (m,), of a block all or none."""
        place = np.full(len(self.sd), -1)
        place[index] = np.arange(len(index))
        blocks = ((place[rows], root) for rows, root in self.blocks)
        return BlockRoot(self.sd[index], tuple((_rows(i), root) for i, root in blocks if np.all(i >= 0)))

    def dense(self) -> Array:
        """(n, n) L."""
        return self.times(np.eye(len(self.sd)))


def solved_lower(factor: Array, right: Array, *, across: bool = False) -> Array:
    """(n, ...) `G^-1 r` of a lower factor G (n, n), or `G'^-1 r` with `across`; without the overhead of SciPy's."""
    return np.asarray(dtrtrs(factor.T, right, lower=0, trans=not across)[0]) if right.size else right


def _rows(where: IntArray) -> IntArray | slice:
    """Evenly spaced rows (m,) as a slice, which reads them in place."""
    if len(where) < 2:
        return where
    first, last, step = int(where[0]), int(where[-1]), int(where[1] - where[0])
    return slice(first, last + 1, step) if step > 0 and np.all(np.diff(where) == step) else where


def beside(first: BlockRoot, second: BlockRoot) -> BlockRoot:
    """The root of two independent groups of parameters together."""
    place = len(first.sd) + np.arange(len(second.sd))
    later = tuple((_rows(place[rows]), root) for rows, root in second.blocks)
    return BlockRoot(np.concatenate([first.sd, second.sd]), (*first.blocks, *later))


def unit_root(count: int) -> BlockRoot:
    """The root of parameters (n,) that are their own z."""
    return BlockRoot(np.ones(count))


@dataclass(frozen=True)
class InformationForm:
    """A density of n parameters: `-2 log p = x' H x - 2 b' x + c + 2 log_noise`, up to a constant."""

    matrix: Array  # (n, n) H
    vector: Array  # (n,) b
    constant: float = 0.0  # c
    log_noise: float = 0.0  # sum of the logs of the noise's sd
    weight: float = 1.0  # of this density in a mixture; the weights sum to one


def total(parts: Sequence[InformationForm]) -> InformationForm:
    """The log likelihood of independent data together."""
    first, *others = parts
    return InformationForm(
        sum((p.matrix for p in others), first.matrix),
        sum((p.vector for p in others), first.vector),
        sum(p.constant for p in parts),
        sum(p.log_noise for p in parts),
    )


def in_z(form: InformationForm, mean: Array, root: BlockRoot) -> InformationForm:
    """The same of z, where the parameters are `mean + L z` with a root L."""
    gap = form.vector - form.matrix @ mean
    constant = form.constant - float((form.vector + gap) @ mean)
    return replace(form, matrix=root.around(form.matrix), vector=root.transposed_times(gap), constant=constant)


_LEAST_EIGENVALUE = 1e-9  # of the largest eigenvalue of correlations: directions below are fixed


@dataclass(frozen=True)
class Conditioning:
    """Numbers k conditioned on parameters b."""

    explained: Array  # (S,) part of the variance of k
    change: Array  # (S,) of k, where b goes by `away`
    chi_squared: float  # of `away`


@dataclass(frozen=True)
class JointCovariance:
    """(P, P) covariance of all parameters, by recording.

    Given the shared parameters, the own ones of two recordings are independent: exact at fixed hyperparameters.
    """

    shared: int  # parameters that all recordings share; they come first
    pairs: Sequence[Array]  # (n, n) of each recording: of the shared parameters and its own
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording

    @property
    def diagonal(self) -> Array:
        """(P,)."""
        n = self.shared
        return np.concatenate([np.diag(self.of_shared), *(np.diag(pair)[n:] for pair in self.pairs)])

    @property
    def of_shared(self) -> Array:
        """(n, n) of the shared parameters."""
        return self.pairs[0][: self.shared, : self.shared]

    def among(self, where: slice) -> Array:
        """(n, n) of parameters that stand in one part."""
        pair, inside = self._place(where)
        return self.pairs[pair][inside, inside]

    def shared_with(self, where: slice) -> Array:
        """(n, m) of the shared parameters with some that stand in one part."""
        pair, inside = self._place(where)
        return self.pairs[pair][: self.shared, inside]

    def with_shared(self, index: IntArray | slice) -> Array:
        """(P, n) of all parameters with some of the shared ones."""
        own = [pair[self.shared :, : self.shared][:, index] for pair in self.pairs]
        return np.concatenate([self.of_shared[:, index], *own])

    def of_functionals(self, rows: Sequence[tuple[slice, Array]]) -> Array:
        """(N, N) of linear functions of parameters: (r, n) weights of those that stand in one slice, N rows in all."""
        counts = [len(weights) for _, weights in rows]
        first = np.concatenate([[0], np.cumsum(counts)])
        places = [self._place(where) for where, _ in rows]
        is_shared = [where.stop <= self.shared for where, _ in rows]
        with_shared = [
            w @ self.pairs[p][inside, : self.shared] for (p, inside), (_, w) in zip(places, rows, strict=True)
        ]
        whole = np.concatenate(with_shared)
        out = whole @ _inverse(self.of_shared) @ whole.T
        for number, pair in enumerate(self.pairs):
            here = [i for i, (p, _) in enumerate(places) if p == number or is_shared[i]]
            index = np.concatenate([np.arange(first[i], first[i + 1]) for i in here])
            wide = np.zeros((len(index), len(pair)))
            start = 0
            for i in here:
                wide[start : start + counts[i], places[i][1]] = rows[i][1]
                start += counts[i]
            out[np.ix_(index, index)] = wide @ pair @ wide.T
        return out

    def conditioned(self, weights: Array, index: Sequence[IntArray], away: Sequence[Array]) -> Conditioning:
        """Numbers k, linear in the shared parameters by `weights` (S, n), if parameters b were known.

        `index` of b in each part. With several recordings the inverse covariance of b is by Woodbury's identity.
        """
        n = self.shared
        if len(self.pairs) == 1:
            inside, whole = np.concatenate([index[0], index[1] + n]), np.concatenate(away)
            pair = self.pairs[0]
            across, inverse = weights @ pair[:n, inside], _inverse(pair[np.ix_(inside, inside)])
            regression = across @ inverse
            explained = np.einsum("si,si->s", regression, across)
            return Conditioning(explained, regression @ whole, float(whole @ inverse @ whole))
        information, right, square, precision = np.zeros((n, n)), np.zeros(n), 0.0, _inverse(self.of_shared)
        for pair, i, by in zip(self.pairs, index[1:], away[1:], strict=True):
            onto = pair[n + i, :n] @ precision
            inverse = _inverse(pair[np.ix_(n + i, n + i)] - onto @ pair[:n, n + i])
            information += onto.T @ inverse @ onto
            right += onto.T @ inverse @ by
            square += float(by @ inverse @ by)
        kept = self.of_shared @ np.linalg.inv(np.eye(n) + information @ self.of_shared)  # (C^-1 + M)^-1
        moved, square = kept @ right, square - float(right @ kept @ right)
        inverse, left = _inverse(kept[np.ix_(index[0], index[0])]), away[0] - moved[index[0]]
        moved = moved + kept[:, index[0]] @ inverse @ left
        kept = kept - kept[:, index[0]] @ inverse @ kept[index[0]]
        explained = np.einsum("sn,nm,sm->s", weights, self.of_shared - kept, weights)
        return Conditioning(explained, weights @ moved, square + float(left @ inverse @ left))

    def _place(self, where: slice) -> tuple[int, slice]:
        """In which pair, and where in it."""
        if where.stop <= self.shared:
            return 0, where
        for number, part in enumerate(self.parts[1:]):
            if part.start <= where.start and where.stop <= part.stop:
                shift = part.start - self.shared
                return number, slice(where.start - shift, where.stop - shift)
        raise ValueError(f"{where} is in more than one of {self.parts}")


def _inverse(covariance: Array) -> Array:
    """(n, n) pseudo-inverse, whatever the units."""
    if not len(covariance):
        return covariance
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(
        np.linalg.pinv(covariance / np.outer(sd, sd), rcond=_LEAST_EIGENVALUE, hermitian=True) / np.outer(sd, sd)
    )


# Posterior of log k with unknown sizes in its prior. Given the size of the smooth part (`tau`), of steps and bumps
# (`rho`) and of each single one, log k is normal. `tau` and `rho` are drawn by Metropolis steps with log k integrated
# out, the own size of every step and bump by Gibbs steps (Student's t with one degree of freedom; its scale goes with
# the distance). Mean, covariance and quantiles are those of the mixture of normals. Chains run side by side; the seed
# is fixed.

TAU, RHO = 2.0, 0.2  # expected roughness of log k; steps and bumps of it per unit of s
SPREAD = np.array([1.6, 2.0])  # one sd of their logs: even beams have next to no steps, pieced ones large ones
JUMP = 1.0  # of log k: a single step or bump is hardly ever larger than two of these
_LEAST_INFORMATION = 1e-4  # information of a direction of log k below which the data are uninformative
_STEP_DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])  # a step of tau, of rho, of both
_WIDE_SHARE = 0.3  # share of wide proposals
_STRATA = (np.arange(15) + 0.5) / 15.0  # of a normal that a mixture is made of
_BINS = 8000  # of a mixture, from its smallest stratum to its largest


_PLAIN = np.ones((len(SHAPE_LEVELS), len(SHAPE_PLACES)))


@dataclass(frozen=True)
class StiffnessMixture:
    """log k's coefficients, its scales averaged over."""

    mean: Array  # (p,)
    covariance: Array  # (p, p)
    steps: Array  # (p - 1,) means of the steps
    shape: Array  # (levels, S) how wide its bands are over those of a normal, see `UncertainStiffness`


def normal_mixture(mean: Array, covariance: Array) -> StiffnessMixture:
    """log k's coefficients where the sizes in their prior are known: mean (p,), covariance (P, P) with theirs first."""
    p = len(mean)
    return StiffnessMixture(mean, covariance[:p, :p], np.zeros(p - 1), _PLAIN)


@dataclass(frozen=True)
class _Chains:
    """Where B chains stand."""

    logs: Array  # (B, 2) of tau and rho
    own: Array  # (B, 2 p - 1) variance of every step and bump beside the others
    variance: Array  # (B, n) of the parts
    root: Array  # (B, r, r) Cholesky factors of the data's covariance
    value: Array  # (B,) log density of the sizes, log k integrated out

    @property
    def stand(self) -> Array:
        """(B, 2 p + 1) the sizes, from which other chains can go on."""
        return np.concatenate([self.logs, self.own], axis=1)


def part_variances(spline: Spline, logs: Array, own: Array) -> tuple[Array, Array]:
    """(B, n) of the parts of log k at sizes (B, 2) and (B, 2 p - 1), and how far each step and bump is over JUMP."""
    out = spline.variances(*np.exp(logs.T))
    free = (np.exp(logs[:, 1:]) * spline.share) ** 2 * own
    capped = free / JUMP**2
    out[:, spline.local] = free / (1.0 + capped)
    return out, capped


def drawn_sizes(spline: Spline, logs: Array, local: Array, rng: np.random.Generator) -> Array:
    """(B, 2 p - 1) own variances of steps and bumps, given these (B, 2 p - 1) and tau and rho."""
    scale = np.exp(logs[:, 1:]) * spline.share
    return np.asarray((0.5 + 0.5 * (local / scale) ** 2) / rng.standard_exponential(local.shape))


class Target:
    """The density that the chains draw from."""

    def __init__(self, spline: Spline, rows: Array, seen: Array, share: Array) -> None:
        """B chains: the information on log k less its level as `rows` (B, r, p) of unit noise and what they showed,
        `seen` (B, r); `share` (B,) of each chain in the posterior."""
        self.spline, self.weights, self.seen, self.share = spline, spline.parts, seen, share
        self.on_parts = rows @ self.weights  # (B, r, n)
        smooth, self.local = self.on_parts[..., 2 : spline.count], spline.local  # steps and bumps
        fixed = np.r_[:2, self.local.stop : self.weights.shape[1]]  # parts of known sizes
        known = self.on_parts[..., fixed]
        self.known = (known * spline.variances(TAU, RHO)[fixed]) @ np.swapaxes(known, 1, 2) + np.eye(seen.shape[1])
        self.smooth = smooth @ np.swapaxes(smooth, 1, 2)
        self.on_local = np.ascontiguousarray(self.on_parts[..., self.local])

    def at(self, logs: Array, own: Array) -> _Chains:
        """The chains with these sizes."""
        variance, capped = part_variances(self.spline, logs, own)
        local = (self.on_local * variance[:, None, self.local]) @ np.swapaxes(self.on_local, 1, 2)
        spread = self.known + np.exp(2.0 * logs[:, :1, None]) * self.smooth + local
        root = np.asarray(np.linalg.cholesky(spread), dtype=float)
        white = _each(dtrtrs, root, self.seen)
        value = -np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1) - 0.5 * np.sum(white**2, axis=1)
        value -= 0.5 * np.sum(np.log1p(capped), axis=1)
        value -= 0.5 * np.sum(((logs - np.log([TAU, RHO])) / SPREAD) ** 2, axis=1)
        return _Chains(logs, own, variance, root, value)

    def moved(self, now: _Chains, rng: np.random.Generator) -> _Chains:
        """One step of every chain."""
        count = len(now.logs)
        stride = np.where(rng.random((count, 1)) < _WIDE_SHARE, 1.5, 0.5) * SPREAD
        ways = _STEP_DIRECTIONS[rng.integers(0, 3, count)]
        tried = self.at(now.logs + ways * stride * rng.standard_normal((count, 2)), now.own)
        taken = np.log(rng.random(count)) < tried.value - now.value
        logs = np.where(taken[:, None], tried.logs, now.logs)
        variance = np.where(taken[:, None], tried.variance, now.variance)
        root = np.where(taken[:, None, None], tried.root, now.root)
        drawn = self._drawn(variance, root, rng)
        return self.at(logs, drawn_sizes(self.spline, logs, drawn, rng))

    def _drawn(self, variance: Array, root: Array, rng: np.random.Generator) -> Array:
        """(B, 2 p - 1) steps and bumps from their posterior at these sizes (Matheron's rule)."""
        drawn = np.sqrt(variance) * rng.standard_normal(variance.shape)
        missed = self.seen - (self.on_parts @ drawn[..., None])[..., 0] - rng.standard_normal(self.seen.shape)
        local = np.einsum("brn,br->bn", self.on_local, _each(dpotrs, root, missed))
        return np.asarray(drawn[:, self.local] + variance[:, self.local] * local)


def target_of(spline: Spline, forms: Sequence[InformationForm], level: float, each: int) -> Target:
    """Of log k around `level`, `each` chains for every form, by its directions with information."""
    e, u = np.linalg.eigh(np.stack([form.matrix for form in forms]))
    root, turned = np.sqrt(np.maximum(e, _LEAST_INFORMATION)), np.swapaxes(u, 1, 2)
    rows = root[..., None] * turned
    seen = (turned @ np.stack([form.vector for form in forms])[..., None])[..., 0] / root - level * rows.sum(axis=-1)
    told = max(int(np.max(np.sum(e > _LEAST_INFORMATION, axis=1))), 1)
    on_log_k, shown = (np.repeat(one[:, -told:], each, axis=0) for one in (rows, seen))
    return Target(spline, on_log_k, shown, np.repeat([form.weight for form in forms], each) / each)


def _each(solver: Callable[..., Any], roots: Array, right: Array) -> Array:
    """Solve with lower factors (B, r, r) for (B, r) or (B, r, n), by LAPACK without overhead."""
    return np.stack([solver(root, one, lower=1)[0] for root, one in zip(roots, right, strict=True)])


@dataclass(frozen=True)
class Draws:
    """How many draws: `chains` for each form, `kept` of each after `burn`."""

    chains: int
    burn: int
    kept: int
    shaped: bool = True  # False: bands are taken to be as wide as those of a normal of the same sd


def mean_part_variances(
    spline: Spline, form: InformationForm, level: float, draws: Draws, start: Array | None = None
) -> tuple[Array, Array]:
    """(n,) mean variances of the parts of log k, and (B, 2 p + 1) where the chains stand.

    A sharp joint is found late by chains that begin anywhere; they begin where others ended (`start`) if given.
    """
    chains = list(drawn_chains(target_of(spline, [form], level, draws.chains), draws, start))
    return np.mean([one.variance.mean(axis=0) for one in chains], axis=0), chains[-1].stand


def stiffness_mixture(
    spline: Spline, forms: Sequence[InformationForm], level: float, draws: Draws, start: Array | None = None
) -> StiffnessMixture:
    """Posterior of log k around `level`; `start` as for `mean_part_variances`."""
    target = target_of(spline, forms, level, draws.chains)
    chains = list(drawn_chains(target, draws, start))
    mean, covariance, steps, normals = moments_of(target, chains, draws.shaped)
    weight = np.tile(target.share, draws.kept) / draws.kept
    shape = _PLAIN if normals is None else _shape(normals[0], normals[1], weight)
    return StiffnessMixture(mean + level, covariance, steps, shape)


def moments_of(target: Target, draws: Sequence[_Chains], shaped: bool) -> tuple[Array, Array, Array, Array | None]:
    """Mean (p,) and covariance (p, p) of log k less its level, the mean steps (p - 1,), and where its bands are to be
    `shaped` means and sds (2, N, S) of the normals that the mixture is made of, at `SHAPE_PLACES`."""
    p = target.spline.count
    mean, second, marginals = np.zeros(p), np.zeros((p, p)), []
    parts, variance = np.zeros((2, target.weights.shape[1]))
    basis = target.spline.basis(SHAPE_PLACES)  # (S, p)
    squares = (basis @ target.weights).T ** 2  # (n, S)
    for now in draws:
        of_parts = now.variance * np.einsum("brn,br->bn", target.on_parts, _each(dpotrs, now.root, target.seen))
        means = of_parts @ target.weights.T
        away = _each(dtrtrs, now.root, (target.on_parts * now.variance[:, None]) @ target.weights.T)  # (B, r, p)
        weighted = np.sqrt(target.share)[:, None, None] * away
        second += (means.T * target.share) @ means - np.tensordot(weighted, weighted, ((0, 1), (0, 1)))
        mean += target.share @ means
        parts += target.share @ of_parts
        variance += target.share @ now.variance
        if not shaped:
            continue
        left = now.variance @ squares - np.sum((away @ basis.T) ** 2, axis=1)
        marginals.append(np.stack([means @ basis.T, np.sqrt(np.maximum(left, 0.0))]))
    second += (target.weights * variance) @ target.weights.T
    mean, second, parts = mean / len(draws), second / len(draws), parts / len(draws)
    covariance = second - np.outer(mean, mean)
    normals = np.concatenate(marginals, axis=1) if shaped else None
    return mean, 0.5 * (covariance + covariance.T), parts[p : 2 * p - 1], normals


def drawn_chains(
    target: Target, draws: Draws, start: Array | None, rng: np.random.Generator | None = None
) -> Iterator[_Chains]:
    """The kept draws; every run is the same."""
    rng, count = rng or np.random.default_rng(0), len(target.share)
    if start is None:  # draws from the prior
        logs = np.log([TAU, RHO]) + 0.7 * SPREAD * rng.standard_normal((count, 2))
        start = np.concatenate([logs, np.ones((count, 2 * target.spline.count - 1))], axis=1)
    begin = start[np.arange(count) % len(start)]
    now = target.at(begin[:, :2], begin[:, 2:])
    for i in range(draws.burn + draws.kept):
        now = target.moved(now, rng)
        if i >= draws.burn:
            yield now


def _shape(means: Array, sds: Array, weight: Array) -> Array:
    """(levels, S) widths of mixtures of normals (N, S), weights (N,), over those of a normal of the same sd."""
    middle = weight @ means
    sd = np.sqrt(weight @ (sds**2 + (means - middle) ** 2))
    values = (means.T[:, None] + sds.T[:, None] * ndtri(_STRATA)[:, None]).reshape(means.shape[1], -1)
    weights = np.tile(weight / len(_STRATA), len(_STRATA))
    asked = 0.5 + 0.5 * np.stack([-SHAPE_LEVELS, SHAPE_LEVELS])
    ends = []
    for one in values:
        share, edges = np.histogram(one, _BINS, weights=weights)  # sorting them all would take four times as long
        ends.append(np.interp(asked, np.append(0.0, np.cumsum(share)), edges))
    low, high = np.stack(ends, axis=-1)
    return np.asarray((high - low) / (2.0 * ndtri(asked[1])[:, None] * sd))
