"""Several recordings of one beam in one linear model: what they share, and what each has of its own.

The posterior's precision is bordered block diagonal: the own parameters of two recordings have no common data. Each
recording's own parameters are integrated out by themselves (Schur complement), the shared ones are solved for, and the
own ones follow. So work and memory go with the number of recordings. See Golub and Van Loan, Matrix Computations, 4.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import overload

import numpy as np
from scipy.linalg import solve_triangular

from onebend.learning.inference.block_root import BlockRoot, beside, unit_root
from onebend.learning.inference.fit_problem import Prior
from onebend.learning.inference.information_form import InformationForm, in_z, total
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.records import Array, IntArray
from onebend.workers import each, in_own_pages


@dataclass(frozen=True)
class JointInformation:
    """What tags and force logs of every recording say, to second order."""

    forms: tuple[InformationForm, ...]  # of each recording, over the shared parameters and its own
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording

    @cached_property
    def vector(self) -> Array:
        """(P,) b."""
        count = self.parts[0].stop
        shared = np.sum([f.vector[:count] for f in self.forms], axis=0)
        return np.concatenate([shared, *(f.vector[count:] for f in self.forms)])

    @property
    def constant(self) -> float:
        """c."""
        return sum(f.constant for f in self.forms)

    @property
    def log_noise(self) -> float:
        """Sum of the logs of the noise's sd."""
        return sum(f.log_noise for f in self.forms)

    def times(self, x: Array) -> Array:
        """(P, ...) `H x`."""
        count = self.parts[0].stop
        each = [f.matrix @ np.concatenate([x[:count], x[p]]) for f, p in zip(self.forms, self.parts[1:], strict=True)]
        return np.concatenate([np.sum([one[:count] for one in each], axis=0), *(one[count:] for one in each)])


@dataclass(frozen=True)
class Eliminated:
    """Parameters y, integrated out under their prior: given the others x, the precision of z of `y = m + L z` is
    `G G'`."""

    root: BlockRoot  # L
    factor: Array  # (n, n) G, lower triangular
    across: Array  # (n, k) `G^-1 L' H_yx`
    white: Array  # (n,) `G^-1 L' (b - H m)`
    left: InformationForm  # of x; its noise includes the volume of y

    def given(self, x: Array, white: Array | float) -> Array:
        """(n, ...) z at others x, for right sides `white` (n, ...)."""
        return _upper(self.factor, white - self.across @ x)


def eliminated(form: InformationForm, mean: Array, root: BlockRoot, kept: int, damping: float = 0.0) -> Eliminated:
    """All parameters of a form but the first `kept` integrated out; `damping` is added to the precision of z."""
    information, vector = form.matrix[kept:, kept:], form.vector[kept:]
    inside = root.around(information)
    inside[np.diag_indices(len(inside))] += 1.0 + damping
    factor = in_own_pages(np.asarray(np.linalg.cholesky(inside), dtype=float))
    cross = form.matrix[kept:, :kept]
    across = _lower(factor, root.transposed_times(cross))
    white = _lower(factor, root.transposed_times(vector - information @ mean))
    left = InformationForm(
        matrix=form.matrix[:kept, :kept] - across.T @ across,
        vector=form.vector[:kept] - cross.T @ mean - across.T @ white,
        constant=float(form.constant - 2.0 * vector @ mean + mean @ information @ mean - white @ white),
        log_noise=form.log_noise + float(np.sum(np.log(np.diag(factor)))),
    )
    return Eliminated(root, factor, across, white, left)


def marginal(form: InformationForm, mean: Array, root: BlockRoot, kept: IntArray) -> InformationForm:
    """What is said of the parameters `kept` (k,), all others integrated out under their prior of mean (n,) and root;
    its noise includes their volume."""
    others = np.setdiff1d(np.arange(len(mean)), kept)
    order = np.concatenate([kept, others])
    sorted_form = replace(form, matrix=form.matrix[np.ix_(order, order)], vector=form.vector[order])
    return eliminated(sorted_form, mean[others], root.take(others), len(kept)).left


@dataclass(frozen=True)
class Solved:
    """Data and prior together: with `x = m + L z`, z has the precision `I + L' H L`, plus a damping."""

    before: Prior
    own: tuple[Eliminated, ...]  # of each recording
    left: InformationForm  # of the shared parameters, those of each recording integrated out
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
        """The same with the shared parameters integrated out and each recording's own ones at their most probable: less
        the volumes of noise and own parameters."""
        mean, left = self.before.mean[self.before.parts[0]], self.left
        misfit = left.constant - 2.0 * left.vector @ mean + mean @ left.matrix @ mean - self.white @ self.white
        return float(-0.5 * misfit - np.sum(np.log(np.diag(self.factor))))

    def solve(self, v: Array) -> Array:
        """(P, ...) `A^-1 v`, A being the precision of z."""
        parts, root = self.before.parts, self.before.roots[0]
        white = [_lower(one.factor, v[part]) for one, part in zip(self.own, parts[1:], strict=True)]
        told = sum((one.across.T @ w for one, w in zip(self.own, white, strict=True)), np.zeros_like(v[parts[0]]))
        shared = _upper(self.factor, _lower(self.factor, v[parts[0]] - root.transposed_times(told)))
        x = root.times(shared)
        return np.concatenate([shared, *(one.given(x, w) for one, w in zip(self.own, white, strict=True))])

    def times_covariance(self, v: Array) -> Array:
        """(P, ...) `C v`, C being the covariance of the parameters."""
        return self.before.times(self.solve(self.before.transposed_times(v)))

    @cached_property
    def _of_shared(self) -> Array:
        """(n, n) covariance of the shared parameters."""
        half = _lower(self.factor, self.before.roots[0].dense().T)
        return half.T @ half

    def pair(self, number: int) -> Array:
        """(n, n) covariance of the shared parameters and one recording's own."""
        one, shared = self.own[number], self._of_shared
        onto = -one.root.times(_upper(one.factor, one.across))
        own = _lower(one.factor, one.root.dense().T)
        across = onto @ shared
        return np.block([[shared, across.T], [across, own.T @ own + across @ onto.T]])

    @property
    def covariance(self) -> JointCovariance:
        """Of the parameters."""
        return JointCovariance(len(self._of_shared), _Pairs(self), self.before.parts)


class _Pairs(Sequence[Array]):
    """`Solved.pair` of each recording, worked out where asked for: all of them take much memory. The last one is
    remembered."""

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
    left, root, mean = total([one.left for one in own]), before.roots[0], before.mean[shared]
    inside = root.around(left.matrix)
    inside[np.diag_indices(count)] += 1.0 + damping
    factor = np.asarray(np.linalg.cholesky(inside), dtype=float)
    white = _lower(factor, root.transposed_times(left.vector - left.matrix @ mean))
    return Solved(before, own, left, factor, white)


def own_in_z(form: InformationForm, before: Prior, number: int) -> InformationForm:
    """What one recording says, with z for its own parameters: what does not change with the damping is then worked out
    once."""
    part, shared = before.parts[1 + number], before.parts[0].stop
    mean = np.concatenate([np.zeros(shared), before.mean[part]])
    own = in_z(form, mean, beside(unit_root(shared), before.roots[1 + number]))
    return replace(own, matrix=in_own_pages(own.matrix))


def prior_in_own_z(before: Prior) -> Prior:
    """The prior, with z for the parameters that each recording has of its own."""
    shared, first = before.parts[0], before.roots[0]
    mean = np.concatenate([before.mean[shared], np.zeros(len(before.mean) - shared.stop)])
    return Prior(mean, before.parts, (first, *(unit_root(part.stop - part.start) for part in before.parts[1:])))


def coupled(data: JointInformation, before: Prior, own: Sequence[IntArray]) -> tuple[JointInformation, Prior]:
    """Data and prior of some of each recording's own parameters, and of the shared ones that couple them; all else is
    integrated out. `own` (m,) of each recording: where they stand in its part. One recording alone has no coupling.
    """
    shared = before.parts[0]
    count = shared.stop if len(own) > 1 else 0

    def told(form: InformationForm, part: slice, root: BlockRoot, mine: IntArray) -> InformationForm:
        mean = np.concatenate([before.mean[shared], before.mean[part]])
        return marginal(
            form, mean, beside(before.roots[0], root), np.concatenate([np.arange(count), shared.stop + mine])
        )

    forms = each(told, data.forms, before.parts[1:], before.roots[1:], own)
    means = [before.mean[part][mine] for part, mine in zip(before.parts[1:], own, strict=True)]
    roots = [root.take(mine) for root, mine in zip(before.roots[1:], own, strict=True)]
    ends = np.cumsum([count, *(len(mine) for mine in own)]).tolist()
    every = tuple(slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))
    all_roots = (before.roots[0].take(np.arange(count)), *roots)
    return JointInformation(forms, every), Prior(np.concatenate([before.mean[:count], *means]), every, all_roots)


def _lower(factor: Array, right: Array) -> Array:
    return np.asarray(solve_triangular(factor, right, lower=True, check_finite=False))


def _upper(factor: Array, right: Array) -> Array:
    return np.asarray(solve_triangular(factor, right, lower=True, trans="T", check_finite=False))
