"""The posterior over key frames: parameters x and each key frame's force error e, jointly normal once linearised.

    -2 log p = sum_i |zeta_i - J_i x + A_i e_i|^2 / s^2  +  (x - x0)' P (x - x0)  +  e' C^-1 e + (marginalised) + logs

C is the force error's covariance over the key frames' times. This is the linear model of the fit (`learning.linear`),
with a force error at each key frame in place of knots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.learning import linear
from onebend.learning.force_error import SpannedError, sized
from onebend.learning.hyperparameters import Evidence, cubature, error_root, shares_of
from onebend.learning.normal import BlockRoot, InformationForm, solved_lower
from onebend.live.key_frames import AT_REST, KeyFrames
from onebend.recording.force_noise import TimeSpans, fast_variance, slow_variance, with_one_more
from onebend.records import Array, ForceNoise

# Marginalised key frames are kept as square-root information (Bierman, Factorization Methods for Discrete Sequential
# Estimation, 1977): subtracting from an information matrix would lose its positive definiteness to rounding.


_LITTLE = 0.02  # weight of a node that is left out
_STEP = 1e-4  # sd of their logs, of the differences that give the derivatives with the sizes of the force's error


@dataclass
class Marginalised:
    """The marginalised frames, as they were linearised last."""

    rows: Array  # (n + 2, n + 3) upper triangular `[R | z]`: -2 log likelihood |R (x, e) - z|^2
    time: float  # s, of the slow force error e (2,); minus infinity while nothing is marginalised

    def add(self, new_rows: Array, time: float, *, slow: float, fast: float) -> None:
        """Add one frame's rows (R, n + 3) on x and its own force error; the slow error moves to that frame's time.

        `slow`: N^2, variance of the slow error's change since the last; `fast`: N^2, of the rest of the frame's error.
        """
        before = with_error_change(self.rows, slow) if np.isfinite(self.time) else self.rows
        both = np.concatenate([before, with_error_change(new_rows, fast)])
        self.rows, self.time = _triangle(both)[: len(self.rows)], time


def nothing_marginalised(parameters: int) -> Marginalised:
    """The start: no frame is marginalised."""
    return Marginalised(np.zeros((parameters + 2, parameters + 3)), -np.inf)


def marginalise_oldest(
    keys: KeyFrames, marginalised: Marginalised, process: ForceNoise, sizes: Array, own: Callable[[Array], Array]
) -> None:
    """Marginalise the oldest key frame, under this force error and noise of these `sizes` (m,) of the markers.

    `own`: the load's own time at given times.
    """
    begin, end, frames = (float(values[0]) for values in (keys.begin, keys.end, keys.frames))
    since = float(np.diff(own(np.array([marginalised.time, keys.centre[0]])))[0])
    slow, fast = slow_variance(process, end - marginalised.time, since), fast_variance(process, end - begin, frames)
    marginalised.add(likelihood_rows(keys, 0, sizes, process.white), end, slow=slow, fast=fast)
    keys.drop(0)


def likelihood_rows(keys: KeyFrames, i: int, sizes: Array, white: float) -> Array:
    """(R, n + 3) rows `[J, -A | zeta]` of unit noise on x and the force error of frame i, at these sizes of noise; at
    rest two more, of the log itself."""
    root = np.repeat(np.sqrt(keys.weight[i]) / sizes, 3)[:, None]
    rows = root * keys.rows[i]
    rows[:, -3:-1] *= -1.0
    if not keys.rest[i]:
        return np.asarray(rows)
    certain = np.sqrt(keys.frames[i]) / (AT_REST * white)
    log = np.zeros((2, rows.shape[1]))
    log[:, -3:-1], log[:, -1] = certain * np.eye(2), certain * keys.force[i]
    return np.concatenate([rows, log])


def with_error_change(rows: Array, variance: float) -> Array:
    """At most R rows on (x, c) with the information of `rows` (R, n + 3) on (x, e), e = c + d, where d (2,), normal
    with this variance [N^2], is integrated out."""
    if variance <= 0.0:
        return rows
    wide = np.zeros((len(rows) + 2, rows.shape[1] + 2))  # d before the others: its rows come out on top
    wide[:2, :2] = np.eye(2) / np.sqrt(variance)
    wide[2:, :2], wide[2:, 2:] = rows[:, -3:-1], rows
    return _triangle(wide)[2:, 2:]


def _triangle(rows: Array) -> Array:
    """R of the QR decomposition: at most as many rows as columns, zero below the diagonal."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclass(frozen=True)
class KeyFrameModel:
    """The linear model over the key frames: log k (p), the force's error at the slots, which are the last frame that
    was marginalised, if any, and the key frames, and all other parameters (n - p)."""

    form: InformationForm  # of all, in this order
    other_mean: Array  # (n - p,) of the others before the data
    other_sd: Array  # (n - p,)
    others: linear.Eliminated  # the others, integrated out
    evidence: Evidence  # of log k and the force's error

    @property
    def error(self) -> SpannedError:
        """The force's error before the data."""
        error = self.evidence.problem.recordings[0].error
        assert isinstance(error, SpannedError)
        return error

    def posterior(self, hyperparameters: linear.Hyperparameters) -> KeyFramePosterior:
        """Raises `numpy.linalg.LinAlgError` where a matrix is not positive definite."""
        return KeyFramePosterior(self, hyperparameters, self.evidence.posterior(hyperparameters))


@dataclass(frozen=True)
class KeyFramePosterior:
    """The normal posterior of the n parameters and of the force's error."""

    model: KeyFrameModel
    hyperparameters: linear.Hyperparameters
    solved: linear.Solved  # of log k and the force's error

    @cached_property
    def x(self) -> Array:
        """(n,)."""
        return self.given_stiffness(self.solved.mean[: self.count])

    @property
    def count(self) -> int:
        """p."""
        return int(self.solved.before.parts[0].stop)

    @property
    def e(self) -> Array:
        """(slots, 2) N."""
        return self.solved.mean[self.count :].reshape(-1, 2)

    @property
    def process(self) -> ForceNoise:
        """The force's error."""
        return sized(self.model.error.noise, *self.hyperparameters.of_force)

    @cached_property
    def stiffness_form(self) -> InformationForm:
        """Of log k before its prior, all else integrated out."""
        return self.solved.left

    def given_stiffness(self, k: Array) -> Array:
        """(n,) most probable parameters where log k's coefficients are (p,)."""
        (errors,), others = self.solved.own, self.model.others
        e = errors.root.times(errors.given(k, errors.white))
        z = others.given(np.concatenate([k, e]), others.white)
        return np.concatenate([k, self.model.other_mean + others.root.times(z)])

    def covariance(self, of_stiffness: Array) -> Array:
        """(n, n) of the parameters where log k's coefficients have the covariance (p, p)."""
        whole, p = self.model.others.joint(self.solved.own[0].joint(of_stiffness)), self.count
        kept = np.append(np.arange(p), np.arange(len(whole) - len(self.model.other_sd), len(whole)))
        return whole[np.ix_(kept, kept)]

    def spread(self, rows: Array) -> Array:
        """(R, R) covariance of R linear functions of log k, the force's error and all others, rows (R, P)."""
        others, known = self.model.others, len(self.solved.mean)
        white = solved_lower(others.factor, others.root.transposed_times(rows[:, known:].T))
        return white.T @ white + self.solved.spread(rows[:, :known] - white.T @ others.across)

    def likelier(self, start: linear.Hyperparameters, stride: float) -> linear.Hyperparameters:
        """The hyperparameters `start` with sizes of the force's error of more evidence, at most `stride` sd away: one
        step of Fisher's scoring."""
        slope, curvature = self.of_sizes(self.model.evidence)
        step = np.clip(-np.linalg.solve(curvature, slope), -stride, stride)
        return self.model.evidence.hyperparameters_at(start, self.model.evidence.place(self.hyperparameters) + step)

    def at_nodes(self, count: int) -> Iterator[tuple[linear.Solved, float]]:
        """As `learning.hyperparameters.at_nodes`, over the first `count` sizes of the force's error."""
        if not len(self.e):
            return iter([(self.solved, 1.0)])
        evidence, before = self.model.evidence, self.solved.before
        evidence = replace(evidence, spread=evidence.spread[:count])
        points, log_shares = cubature(evidence.place(self.hyperparameters), self.of_sizes(evidence)[1])
        roots = ((before.roots[0], self._error_root(evidence, z)) for z in points[1:])
        nodes = [self.solved, *(linear.solved(evidence.data, replace(before, roots=pair)) for pair in roots)]
        costs = [0.5 * float(z @ z) - node.log_evidence for z, node in zip(points, nodes, strict=True)]
        shares = shares_of(log_shares - np.array(costs))
        shares = shares * (shares > _LITTLE)
        pairs = zip(nodes, (shares / np.sum(shares)).tolist(), strict=True)
        return ((node, share) for node, share in pairs if share)

    def _error_root(self, evidence: Evidence, z: Array) -> BlockRoot:
        return error_root(self.model.error, evidence.sizes_at(self.hyperparameters, z))

    def of_sizes(self, evidence: Evidence) -> tuple[Array, Array]:
        """(d,) slope of `evidence.cost` with the sizes z of the force's error, and (d, d) its curvature as expected.

        With `C = L L'` the prior covariance, m and V the posterior mean and covariance, `w = L^-1 m`, `M = 1 - L^-1 V
        L^-T` and `D = L^-1 dC/dz L^-T` they are `z - (w' D w - tr(M D)) / 2` and `1 + tr(M D_i M D_j) / 2`.
        """
        z, p = evidence.place(self.hyperparameters), self.count
        own, count, size = self._error_root(evidence, z), len(self.e), len(z)
        lower = own.blocks[0][1]
        order = np.arange(2 * count).reshape(count, 2).T.ravel()  # x, then y
        unknown = own.solve(own.solve(self.solved.pair(0)[p:, p:]).T)
        told = (np.eye(2 * count) - unknown[np.ix_(order, order)]).reshape(4 * count, count)
        roots = (self._error_root(evidence, one).blocks[0][1] for one in z + _STEP * np.eye(size))
        changes = [(y @ y.T - np.eye(count)) / _STEP for y in (solved_lower(lower, root) for root in roots)]
        halves = [(told @ change).reshape(2 * count, 2 * count) for change in changes]
        w = solved_lower(lower, self.e)
        slope = [np.vdot(w, d @ w) - np.trace(half) for d, half in zip(changes, halves, strict=True)]
        curvature = [[np.vdot(a, b.T) for b in halves] for a in halves]
        return z - 0.5 * np.array(slope), np.eye(size) + 0.5 * np.array(curvature)

    @property
    def effective_parameters(self) -> float:
        """Effective number of parameters: how many the data determine, rather than the prior."""
        each = np.sum(self.model.others.joint(self.solved.pair(0)) * self.model.form.matrix, axis=1)
        return float(np.sum(each) - np.sum(each[self.count : len(self.solved.mean)]))

    def predicted_error(self, time: float, own: float) -> tuple[Array, Array, float]:
        """Force error of a frame to come: mean (2,), weights (slots,) on the known errors, and conditional variance."""
        spans = self.model.error.spans
        if not len(spans.begin):
            return np.zeros(2), np.zeros(0), 0.0
        with_others, alone = with_one_more(self.process, spans, time, own)
        root = self.solved.before.roots[1].blocks[0][1]  # of the covariance of the known errors, on each axis
        rows = solved_lower(root, solved_lower(root, with_others), across=True)
        return rows @ self.e, rows, alone - float(rows @ with_others)


def spans_of(keys: KeyFrames, marginalised: Marginalised, own: Callable[[Array], Array] = np.zeros_like) -> TimeSpans:
    """Of the key frames, behind the one marginalised last, if any is; `own`: the load's own time at given times."""
    spans = keys.spans(own(keys.centre))
    if not np.isfinite(marginalised.time):
        return spans
    return spans.after(marginalised.time, float(own(np.array([marginalised.time]))[0]))


def information(keys: KeyFrames, marginalised: Marginalised, p: int, *, sizes: Array, white: float) -> InformationForm:
    """Log likelihood of the key frames, with their robust weights, and of those marginalised, over the first p
    parameters, the force errors and the other parameters; `sizes` (m,) of the markers' noise; `white` N, the log's."""
    used, n, first = keys.used, keys.rows.shape[-1] - 3, 2 * int(np.isfinite(marginalised.time))
    start, behind = p + first, p + first + 2 * used
    rows = np.repeat(np.sqrt(keys.weight[:used]) / sizes, 3, axis=1)[..., None] * keys.rows[:used]
    flat = rows.reshape(-1, n + 3)
    every, each = flat.T @ flat, np.ascontiguousarray(rows[..., -3:-1].swapaxes(1, 2)) @ rows
    size, middle = n + first + 2 * used, slice(start, behind)
    own = np.append(np.arange(p), np.arange(behind, size))
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    matrix[np.ix_(own, own)], vector[own] = every[:n, :n], every[:n, -1]
    across, vector[middle] = -each[..., :n].reshape(-1, n), -each[..., -1].ravel()
    matrix[middle, own], matrix[own, middle] = across, across.T
    certain = keys.rest[:used] * keys.frames[:used] / (AT_REST * white) ** 2
    here = start + 2 * np.arange(used)
    for c in range(2):
        matrix[here + c, here], matrix[here + c, here + 1] = each[:, c, n], each[:, c, n + 1]
        matrix[here + c, here + c] += certain
        vector[here + c] += certain * keys.force[:used, c]
    if first:
        root, known = marginalised.rows[:, :-1], marginalised.rows[:, -1]
        old = np.append(own, [p, p + 1])
        matrix[np.ix_(old, old)] += root.T @ root
        vector[old] += root.T @ known
    return InformationForm(matrix, vector)


def model_of(
    form: InformationForm, before: tuple[Array, Array], problem: linear.FitProblem, spread: Array
) -> KeyFrameModel:
    """The model of a form as `information` gives it, with the `problem` of log k and the force's error; `before` means
    and sds (n - p,) of the others before the data, `spread` as in `Evidence`."""
    layout = problem.layout
    others = linear.eliminated(form, before[0], BlockRoot(before[1]), layout.size)
    evidence = Evidence(problem, linear.JointInformation((others.left,), layout.parts), spread)
    return KeyFrameModel(form, *before, others, evidence)
