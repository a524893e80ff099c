"""The posterior over key frames: parameters x and each key frame's force error e, jointly normal once linearised.

    -2 log p = sum_i |zeta_i - J_i x + A_i e_i|^2 / s^2  +  (x - x0)' P (x - x0)  +  e' C^-1 e + (marginalised) + logs

C is the force error's covariance over the key frames' times. One Cholesky factorisation solves for all unknowns. Log k
is eliminated last: this gives its information form with all else integrated out, before its prior is added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs, dtrtrs

from onebend.learning.normal import InformationForm
from onebend.learning.parameters import Layout
from onebend.live.key_frames import AT_REST, KeyFrames
from onebend.recording.force_noise import TimeSpans, covariance, fast_variance, slow_variance, with_one_more
from onebend.records import Array, ForceNoise

# Marginalised key frames are kept as square-root information (Bierman, Factorization Methods for Discrete Sequential
# Estimation, 1977): subtracting from an information matrix would lose its positive definiteness to rounding.


@dataclass
class Marginalised:
    """The marginalised frames, as they were linearised last."""

    rows: Array  # (n + 2, n + 3) upper triangular `[R | z]`: -2 log likelihood |R (x, e) - z|^2
    time: float  # s, of the slow force error e (2,); minus infinity while nothing is marginalised

    @property
    def form(self) -> InformationForm:
        """The same on all n + 2 of (x, e)."""
        root, z = self.rows[:, :-1], self.rows[:, -1]
        return InformationForm(root.T @ root, root.T @ z)

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
    keys: KeyFrames, marginalised: Marginalised, process: ForceNoise, marker: float, own: Callable[[Array], Array]
) -> None:
    """Marginalise the oldest key frame, under this force error and noise `marker` of the tags.

    `own`: the load's own time at given times.
    """
    begin, end, frames = (float(values[0]) for values in (keys.begin, keys.end, keys.frames))
    since = float(np.diff(own(np.array([marginalised.time, keys.centre[0]])))[0])
    slow, fast = slow_variance(process, end - marginalised.time, since), fast_variance(process, end - begin, frames)
    marginalised.add(likelihood_rows(keys, 0, marker, process.white), end, slow=slow, fast=fast)
    keys.drop(0)


def likelihood_rows(keys: KeyFrames, i: int, marker: float, white: float) -> Array:
    """(R, n + 3) rows `[J, -A | zeta]` of unit noise on x and the force error of frame i, at these sizes of noise; at
    rest two more, of the log itself."""
    root = np.repeat(np.sqrt(keys.weight[i]), 3)[:, None] / marker
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


_ROUNDING = 1e-11  # of the information: added to its diagonal against rounding


@dataclass(frozen=True)
class LiveHyperparameters:
    """The hyperparameters but those of log k's prior, which are drawn (`stiffness_hyperparameters.py`)."""

    marker: float  # noise of the tags over what their covariances say
    white: float  # N, force error of every frame
    coloured: float  # N, Ornstein-Uhlenbeck part
    memory: float  # s, its correlation time
    walk: float  # N per root second
    load: float  # error that comes with the load, over the size expected before the data


@dataclass(frozen=True)
class LivePrior:
    """The prior of the parameters."""

    layout: Layout
    mean: Array  # (n,)
    fixed: Array | None  # (p, p) precision of log k's coefficients; None: it follows from the variances of its parts
    scale: Array | float = 1.0  # (n - p,) factors on the sds of all other parameters, as the push has shown so far

    @cached_property
    def nuisance_sd(self) -> Array:
        """(n - p,) of all parameters but log k's coefficients; their means are zero."""
        return np.asarray(self.scale * np.concatenate([b.prior_sd for b in self.layout.blocks if b.start >= 0][1:]))

    @cached_property
    def nuisance_precision(self) -> Array:
        """(n - p,)."""
        return np.asarray(1.0 / self.nuisance_sd**2)

    def stiffness_prior(self, parts: Array) -> InformationForm:
        """The prior of log k's coefficients; `parts` (n,): variances of its parts."""
        precision, spline = self.fixed, self.layout.spline
        if precision is None:
            precision, _ = _inverse((spline.parts * parts) @ spline.parts.T)
        return InformationForm(precision, precision @ self.mean[: spline.count])


@dataclass(frozen=True)
class KeyFrameSums:
    """Sums of products over the key frames, at unit noise; slot 0 is that of the marginalised frames, if any."""

    spans: TimeSpans
    xx: Array  # (n, n)
    xe: Array  # (n, 2 slots)
    ee: Array  # (slots, 2, 2)
    bx: Array  # (n,)
    be: Array  # (slots, 2)
    c: float
    rows: float  # count of the numbers measured
    rest: Array  # (slots,) 1 where the log shows its error
    log: Array  # (slots, 2) N, the log there
    marginalised: Marginalised


@dataclass(frozen=True)
class KeyFramePosterior:
    """The normal posterior of the force errors e and the parameters x.

    The unknowns are in two parts: first e and the nuisances, then log k's coefficients. The Cholesky factor of their
    information is `[[factor, 0], [across', lower]]`.
    """

    x: Array  # (n,)
    e: Array  # (slots, 2) N
    spans: TimeSpans
    process: ForceNoise
    inverse: Array  # (slots, slots) of the force error's covariance
    factor: Array
    across: Array
    lower: Array
    right: Array  # information vector of the first part, solved with its factor
    stiffness_form: InformationForm  # of log k before its prior, all else integrated out
    minus_log: float  # -2 log evidence, but for what depends on the prior of log k

    def spread(self, errors: Array, j: Array) -> Array:
        """(R, R) covariance of R linear functions: rows `errors` (R, 2 slots) times e, plus `j` (R, n) times x."""
        p = len(self.lower)
        first, _ = dtrtrs(self.factor, np.concatenate([errors.T, j[:, p:].T]), lower=1)
        last, _ = dtrtrs(self.lower, j[:, :p].T - self.across.T @ first, lower=1)
        return np.asarray(first.T @ first + last.T @ last)

    def distance(self, error: Array, x: Array) -> float:
        """Distance in posterior sd from a point whose last K force errors are `error` (K, 2) and whose parameters are
        `x` (n,) away."""
        p, away = len(self.lower), np.zeros_like(self.e)
        away[len(away) - len(error) :] = self.e[len(away) - len(error) :] - error
        first = np.concatenate([away.ravel(), x[p:]])
        ahead = self.factor.T @ first + self.across @ x[:p]
        behind = self.lower.T @ x[:p]
        return float(np.sqrt(ahead @ ahead + behind @ behind))

    def with_stiffness(self, k: Array, covariance: Array) -> tuple[Array, Array]:
        """(n,) and (n, n): mean and covariance of all parameters where log k's have these, (p,) and (p, p)."""
        p, m = len(k), len(self.x) - len(k)
        root, across, right = self.factor[-m:, -m:], self.across[-m:], self.right[-m:]
        follow = -np.asarray(dtrtrs(root, across, lower=1, trans=1)[0])
        alone, _ = dpotri(root, lower=1)
        x, out = np.empty(p + m), np.empty((p + m, p + m))
        x[:p], x[p:] = k, dtrtrs(root, right - across @ k, lower=1, trans=1)[0]
        out[:p, :p] = covariance
        out[p:, :p] = follow @ covariance
        out[:p, p:] = out[p:, :p].T
        out[p:, p:] = _symmetric(alone) + out[p:, :p] @ follow.T
        return x, out

    def covariance(self) -> Array:
        """(n, n) of the parameters."""
        inverse, _ = dpotri(self.lower, lower=1)
        return self.with_stiffness(self.x[: len(self.lower)], _symmetric(inverse))[1]

    def effective_parameters(self, prior: LivePrior, stiffness_prior: InformationForm) -> float:
        """Effective number of parameters: how many the data determine, rather than the prior."""
        p, c = len(self.lower), self.covariance()
        held = float(np.sum(c[:p, :p] * stiffness_prior.matrix)) + float(prior.nuisance_precision @ np.diag(c)[p:])
        return len(self.x) - held

    def predicted_error(self, time: float, own: float) -> tuple[Array, Array, float]:
        """Force error of a frame to come: mean (2,), weights (slots,) on the known errors, and conditional variance."""
        with_others, alone = with_one_more(self.process, self.spans, time, own)
        rows = self.inverse @ with_others
        return rows @ self.e, rows, alone - float(rows @ with_others)


def gather(keys: KeyFrames, marginalised: Marginalised, own: Callable[[Array], Array] = np.zeros_like) -> KeyFrameSums:
    """Sums over the key frames with their robust weights; `own`: the load's own time at given times."""
    used = keys.used
    rows, weight = keys.rows[:used], keys.weight[:used]
    if np.any((weight != 1.0) & (weight != 0.0)):
        rows = np.repeat(np.sqrt(weight), 3, axis=1)[..., None] * rows
    flat = rows.reshape(-1, rows.shape[-1])
    every = flat.T @ flat  # (n + 3, n + 3)
    each = np.ascontiguousarray(rows[..., -3:-1].swapaxes(1, 2)) @ rows  # (K, 2, n + 3)
    xe, ee, be = -each[..., :-3], each[..., -3:-1], -each[..., -1]
    rest, spans = keys.rest[:used].astype(float), keys.spans(own(keys.centre))
    log = keys.force[:used] * rest[:, None]
    if np.isfinite(marginalised.time):
        spans = spans.after(marginalised.time, float(own(np.array([marginalised.time]))[0]))
        xe, ee, be, log = (np.concatenate([np.zeros((1, *v.shape[1:])), v]) for v in (xe, ee, be, log))
        rest = np.concatenate([[0.0], rest])
    count = 3.0 * float(np.count_nonzero(weight))
    xe = xe.reshape(-1, xe.shape[-1]).T
    return KeyFrameSums(
        spans, every[:-3, :-3], xe, ee, every[:-3, -1], be, float(every[-1, -1]), count, rest, log, marginalised
    )


def solve(
    sums: KeyFrameSums,
    prior: LivePrior,
    stiffness_prior: InformationForm,
    hyperparameters: LiveHyperparameters,
    process: ForceNoise,
) -> KeyFramePosterior:
    """The posterior under given scales; `of_k`: the prior of log k.

    Raises `numpy.linalg.LinAlgError` where a matrix is not positive definite.
    """
    p, slots = prior.layout.spline.count, len(sums.spans.begin)
    m, weight, known = len(sums.bx) - p, 1.0 / hyperparameters.marker**2, 2 * slots
    inverse, log_process, certain = np.zeros((0, 0)), 0.0, np.zeros(0)
    h = np.zeros((known + m, known + m), order="F")  # the lower triangle
    side = np.empty((known + m, p + 1), order="F")  # behind it the right side
    h[known:, known:], side[known:, :p], side[known:, p] = (
        weight * sums.xx[p:, p:],
        weight * sums.xx[p:, :p],
        weight * sums.bx[p:],
    )
    h.ravel(order="K")[known * (known + m + 1) :: known + m + 1] += prior.nuisance_precision
    information, right = weight * sums.xx[:p, :p], weight * sums.bx[:p]
    if slots:
        inverse, log_process = _inverse(covariance(process, sums.spans))
        certain = sums.rest * sums.spans.frames / (AT_REST * process.white) ** 2
        h[known:, :known], side[:known, :p] = weight * sums.xe[p:], weight * sums.xe[:p].T
        _force_part(h[:known, :known], inverse, weight * sums.ee, certain)
        side[:known, p] = (weight * sums.be + certain[:, None] * sums.log).ravel()
        _add_marginalised(sums.marginalised, known, (h, side[:, :p], side[:, p]), (information, right))
    h.ravel(order="K")[:: known + m + 1] *= 1.0 + _ROUNDING
    factor, info = dpotrf(h, lower=1, overwrite_a=1)
    if info:
        raise np.linalg.LinAlgError("the information is not positive definite")
    both, _ = dtrtrs(factor, side, lower=1, overwrite_b=1)
    across, ahead = both[:, :p], both[:, p]
    information.ravel()[:: p + 1] *= 1.0 + _ROUNDING
    stiffness_form = InformationForm(information - across.T @ across, right - across.T @ ahead)
    lower, info = dpotrf(stiffness_form.matrix + stiffness_prior.matrix, lower=1)
    if info:
        raise np.linalg.LinAlgError("the information on log k is not positive definite")
    of_all = stiffness_form.vector + stiffness_prior.vector
    k, _ = dpotrs(lower, of_all, lower=1)
    rest, _ = dtrtrs(factor, ahead - across @ k, lower=1, trans=1)
    total = weight * sums.c + float(certain @ np.sum(sums.log**2, axis=1)) - float(ahead @ ahead) - float(of_all @ k)
    logs = 2.0 * float(np.sum(np.log(np.diag(factor)))) + 2.0 * float(np.sum(np.log(np.diag(lower)))) + log_process
    logs += (
        log_process
        + 2.0 * sums.rows * np.log(hyperparameters.marker)
        - 2.0 * float(np.sum(np.log(certain[certain > 0.0])))
    )
    x = np.concatenate([k, rest[known:]])
    e = rest[:known].reshape(-1, 2)
    return KeyFramePosterior(
        x, e, sums.spans, process, inverse, factor, across, lower, ahead, stiffness_form, total + logs
    )


def _add_marginalised(
    marginalised: Marginalised, known: int, first: tuple[Array, Array, Array], of_stiffness: tuple[Array, Array]
) -> None:
    """Add the marginalised frames' information on the first two e, on log k and on the other parameters."""
    if not np.isfinite(marginalised.time):
        return
    (h, side, b), (matrix, vector), form = first, of_stiffness, marginalised.form
    p, n = len(vector), len(form.vector) - 2
    h[known:, known:] += form.matrix[p:n, p:n]
    h[known:, :2] += form.matrix[p:n, n:]
    h[:2, :2] += form.matrix[n:, n:]
    side[known:] += form.matrix[p:n, :p]
    side[:2] += form.matrix[n:, :p]
    b[known:] += form.vector[p:n]
    b[:2] += form.vector[n:]
    matrix += form.matrix[:p, :p]
    vector += form.vector[:p]


def _inverse(c: Array) -> tuple[Array, float]:
    factor, info = dpotrf(c, lower=1)
    if info:
        raise np.linalg.LinAlgError("a prior's covariance is not positive definite")
    inverse, _ = dpotri(factor, lower=1)
    return _symmetric(inverse), 2.0 * float(np.sum(np.log(np.diag(factor))))


def _symmetric(lower: Array) -> Array:
    out = lower + lower.T
    out.ravel()[:: len(out) + 1] *= 0.5
    return np.asarray(out)


def _force_part(out: Array, inverse: Array, ee: Array, certain: Array) -> None:
    """Fill the force errors' information: `C^-1` on each axis, and what each key frame says of its own."""
    out[0::2, 0::2] = out[1::2, 1::2] = inverse
    x = 2 * np.arange(len(inverse))
    out[x, x] += ee[:, 0, 0] + certain
    out[x + 1, x + 1] += ee[:, 1, 1] + certain
    out[x + 1, x] += ee[:, 1, 0]


# Noise of the tags, from the residuals of the key frames less what an error of each frame's force explains. Averages of
# frames show the error of averages, so errors that last count with their correlation time.

_BULK = 5.0  # sd: larger residuals are cut off there
_LEAST = 0.02  # over the tags' covariances: the smallest size
_GUESS_COUNTS = 60.0  # the first value weighs as much as so many residuals
_NO_FORCE = 1e-9  # 1/N^2: added, so that a force that moves no tag comes out as zero


def tag_residuals(keys: KeyFrames, solution: KeyFramePosterior) -> Array:
    """(K, 3 m) whitened residuals of the key frames at the solution."""
    used = keys.used
    e = solution.e[len(solution.e) - used :]
    return np.asarray(
        keys.rows_z[:used] - keys.rows_j[:used] @ solution.x + (keys.rows_a[:used] @ e[..., None])[..., 0]
    )


def force_in(residual: Array, a: Array) -> Array:
    """(K, 2) N: the force error of each frame that fits its residuals (K, R) best; `a` (K, R, 2): derivatives of the
    residuals with it."""
    turned = a.swapaxes(1, 2)
    gram, by = turned @ a, (turned @ residual[..., None])[..., 0]
    xx, yy, xy = gram[:, 0, 0] + _NO_FORCE, gram[:, 1, 1] + _NO_FORCE, gram[:, 0, 1]
    out = np.empty_like(by)
    out[:, 0], out[:, 1] = yy * by[:, 0] - xy * by[:, 1], xx * by[:, 1] - xy * by[:, 0]
    return out / (xx * yy - xy**2)[:, None]


def without_force(residual: Array, a: Array) -> Array:
    """Residuals (K, R) less what a force error of each frame explains; `a` (K, R, 2) as in `force_in`."""
    return np.asarray(residual - (a @ force_in(residual, a)[..., None])[..., 0])


def robust_weights(keys: KeyFrames, residual: Array, marker: float, bulk: float) -> Array:
    """(K, m) robust weights of the tags: 1 where the residual is within `bulk` sd, beyond it falling with its square.

    In the bulk all tags have the same weight: the averages of two frames would mix them unevenly otherwise.
    """
    distance = np.sqrt(np.sum(residual.reshape(len(residual), -1, 3) ** 2, axis=-1)) / marker
    visible = keys.information[: keys.used, :, 0, 0] > 0.0
    return np.asarray(visible * np.minimum(1.0, bulk / np.maximum(distance, 1e-300)) ** 2)


def tag_noise_size(keys: KeyFrames, residual: Array, spent: float, expected: float) -> float:
    """Size of the tags' noise over what their covariances say.

    `spent`: effective number of parameters; `expected`: the size before the data.
    """
    loaded = ~keys.rest[: keys.used]
    r = without_force(residual[loaded], keys.rows_a[: keys.used][loaded])
    numbers = float(np.count_nonzero(r)) - 2.0 * len(r)
    if numbers <= 0.0:
        return expected
    sizes = np.sort(np.abs(r[r != 0.0]))
    most = _BULK * float(sizes[len(sizes) // 2]) / 0.6745
    left_over = max(numbers - spent, 0.3 * numbers)
    mean_square = (float(np.sum(np.minimum(sizes, most) ** 2)) + _GUESS_COUNTS * expected**2) / (
        left_over + _GUESS_COUNTS
    )
    return max(float(np.sqrt(mean_square)), _LEAST)
