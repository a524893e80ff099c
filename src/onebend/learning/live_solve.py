"""The posterior over key frames: parameters x and each key frame's force error e, jointly normal once linearised.

    -2 log p = sum_i |zeta_i - J_i x + A_i e_i|^2 / s^2  +  (x - x0)' P (x - x0)  +  e' C^-1 e  +  the past  + logs

C is the force error's covariance over the key frames' times. The unknowns are few (some 35 + 2 a key frame), so all of
them are solved for at once, from Cholesky factors of matrices that are sums of squares: nothing is carried from frame
to frame that could lose its definiteness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs, dtrtrs

from onebend.learning.force_process import ForceProcess, Spans, covariance
from onebend.learning.key_frames import AT_REST, KeyFrames, Past
from onebend.learning.parameters import Layout
from onebend.learning.spline import Spline
from onebend.records import Array


@dataclass(frozen=True)
class LiveScales:
    """Sizes that the data choose."""

    marker: float  # noise of the tags over what their covariances say
    white: float  # N, force error of every frame
    coloured: float  # N, Ornstein-Uhlenbeck part
    memory: float  # s, its correlation time
    walk: float  # N per root second
    tau: float  # roughness of log k
    rho: float  # its steps


@dataclass(frozen=True)
class Start:
    """What is known of the parameters before the data."""

    at: Layout
    mean: Array  # (n,)
    fixed: Array | None  # (p, p) precision of log k's coefficients where it is known; None: by tau and rho

    @cached_property
    def _others(self) -> Array:
        """(n, n) of all parameters but log k's coefficients."""
        return np.diag(1.0 / np.concatenate([b.prior_sd for b in self.at.blocks if b.start >= 0]) ** 2)

    def precision(self, tau: float, rho: float) -> tuple[Array, float]:
        """(n, n), and the log determinant of the part that depends on tau and rho."""
        p = self.at.spline.count
        out = self._others.copy()
        part, log = _of_k(self.at.spline, tau, rho) if self.fixed is None else (self.fixed, 0.0)
        out[:p, :p] = part
        return out, log


@lru_cache(maxsize=8)
def _of_k(spline: Spline, tau: float, rho: float) -> tuple[Array, float]:
    """Precision of log k's coefficients, and its log determinant: the same from update to update but for the trials."""
    precision = spline.precision(tau, rho)
    return precision, float(np.linalg.slogdet(precision)[1])


@dataclass(frozen=True)
class Sums:
    """What the key frames say, at unit noise; slot 0 is the past's where there is one."""

    spans: Spans
    xx: Array  # (n, n)
    xe: Array  # (n, 2 slots)
    ee: Array  # (slots, 2, 2)
    bx: Array  # (n,)
    be: Array  # (slots, 2)
    c: float
    rows: float  # numbers measured
    rest: Array  # (slots,) 1 where the log shows its error
    log: Array  # (slots, 2) N, the log there
    past: Past


@dataclass(frozen=True)
class Solution:
    """The normal posterior of all e and x."""

    x: Array  # (n,)
    e: Array  # (slots, 2) N
    spans: Spans
    process: ForceProcess
    inverse: Array  # (slots, slots) of the force error's covariance, the lower triangle
    factor: Array  # lower Cholesky factor of the scaled information, the e before the x
    unit: Array  # (2 slots + n,) the scale: e, x = unit * scaled
    minus_log: float  # -2 log evidence, but for a constant

    def spread(self, rows: Array) -> Array:
        """(R, R) covariance of rows (R, 2 slots + n) times the unknowns."""
        half, _ = dtrtrs(self.factor, (rows * self.unit).T, lower=1)
        return np.asarray(half.T @ half)

    def covariance(self) -> Array:
        """(n, n) of the parameters."""
        n = len(self.x)
        inverse, _ = dpotri(self.factor[-n:, -n:], lower=1)
        return _symmetric(inverse) * np.outer(self.unit[-n:], self.unit[-n:])

    def error_at(self, time: float) -> tuple[Array, Array, float]:
        """Of a frame to come: mean force error (2,), its rows (slots,) on the known ones, and its own variance."""
        if len(self.spans.begin) == 0:
            alone = Spans(np.array([time]), np.array([time]), np.ones(1), np.zeros(1))
            return np.zeros(2), np.zeros(0), float(covariance(self.process, alone)[0, 0])
        every = covariance(self.process, self.spans.then(time))
        rows = _symmetric(self.inverse) @ every[:-1, -1]
        return rows @ self.e, rows, float(every[-1, -1] - rows @ every[:-1, -1])


def gather(keys: KeyFrames, past: Past) -> Sums:
    """Sums over the key frames, robust weights included."""
    used, n = keys.used, keys.j.shape[-1]
    root = np.repeat(np.sqrt(keys.weight[:used]), 3, axis=1)
    j, a, z = root[..., None] * keys.rows_j[:used], root[..., None] * keys.rows_a[:used], root * keys.rows_z[:used]
    flat = j.reshape(-1, n)
    across = np.swapaxes(a, 1, 2)
    rest, spans = keys.rest[:used].astype(float), keys.spans
    xe, ee, be = -(across @ j), across @ a, -(across @ z[..., None])[..., 0]  # (K, 2, n)
    log = keys.force[:used] * rest[:, None]
    if np.isfinite(past.time):
        spans = spans.after(past.time)
        xe, ee, be, log = (np.concatenate([np.zeros((1, *v.shape[1:])), v]) for v in (xe, ee, be, log))
        rest = np.append(0.0, rest)
    rows = 3.0 * float(np.sum((keys.information[:used, :, 0, 0] > 0.0) & (keys.weight[:used] > 0.0)))
    return Sums(
        spans,
        flat.T @ flat,
        xe.reshape(-1, n).T,
        ee,
        flat.T @ z.ravel(),
        be,
        float(np.vdot(z, z)),
        rows,
        rest,
        log,
        past,
    )


def solve(sums: Sums, start: Start, scales: LiveScales, process: ForceProcess) -> Solution:
    """The posterior under given scales. Raises `numpy.linalg.LinAlgError` where a matrix is not positive definite."""
    n, slots = len(sums.bx), len(sums.spans.begin)
    weight, known = 1.0 / scales.marker**2, 2 * slots
    precision, log_prior = start.precision(scales.tau, scales.rho)
    h, b = np.zeros((known + n, known + n), order="F"), np.zeros(known + n)  # of h the lower triangle
    h[known:, known:] = weight * sums.xx + precision
    b[known:] = weight * sums.bx + precision @ start.mean
    inverse, log_process, log_rest, misfit = np.zeros((0, 0)), 0.0, 0.0, 0.0
    if slots:
        inverse, log_process = _inverse(covariance(process, sums.spans))
        certain = sums.rest * sums.spans.frames / (AT_REST * process.white) ** 2
        h[known:, :known] = weight * sums.xe
        _force_part(h[:known, :known], inverse, weight * sums.ee, certain)
        b[:known] = (weight * sums.be + certain[:, None] * sums.log).ravel()
        log_rest = -2.0 * float(np.sum(np.log(certain[certain > 0.0])))
        misfit = float(np.sum(certain[:, None] * sums.log**2))
        if np.isfinite(sums.past.time):
            told, right = sums.past.information, sums.past.b
            h[known:, known:] += told[:n, :n]
            h[known:, :2] += told[:n, n:]
            h[:2, :2] += told[n:, n:]
            b[known:] += right[:n]
            b[:2] += right[n:]
    unit = 1.0 / np.sqrt(np.diag(h))
    h *= unit[:, None]
    h *= unit
    factor, info = dpotrf(h, lower=1, overwrite_a=1)
    if info:
        raise np.linalg.LinAlgError("the information is not positive definite")
    best, _ = dpotrs(factor, b * unit, lower=1)
    best = best * unit
    log_information = 2.0 * float(np.sum(np.log(np.diag(factor)) - np.log(unit)))
    total = weight * sums.c + misfit + float(start.mean @ precision @ start.mean) - float(b @ best)
    logs = log_information - log_prior + log_process + log_rest + 2.0 * sums.rows * np.log(scales.marker)
    e = best[:known].reshape(-1, 2)
    return Solution(best[known:], e, sums.spans, process, inverse, factor, unit, total + logs)


def _inverse(c: Array) -> tuple[Array, float]:
    """Of the force error's covariance, the lower triangle, and its log determinant for both axes."""
    factor, info = dpotrf(c, lower=1)
    if info:
        raise np.linalg.LinAlgError("the force error's covariance is not positive definite")
    inverse, _ = dpotri(factor, lower=1)
    return inverse, 4.0 * float(np.sum(np.log(np.diag(factor))))


def _symmetric(lower: Array) -> Array:
    """From the lower triangle, zero above it."""
    out = lower + lower.T
    out[np.diag_indices(len(out))] *= 0.5
    return np.asarray(out)


def _force_part(out: Array, inverse: Array, ee: Array, certain: Array) -> None:
    """Fill the force errors' information: `C^-1` on each axis, and what each key frame says of its own."""
    slots = len(inverse)
    out[0::2, 0::2] = out[1::2, 1::2] = inverse
    at = 2 * np.arange(slots)
    for i in range(2):
        for k in range(2):
            out[at + i, at + k] += ee[:, i, k]
        out[at + i, at + i] += certain


def robust_weights(keys: KeyFrames, solution: Solution, marker: float, bulk: float) -> Array:
    """(K, m) robust weights of the tags: 1 where what the solution leaves is within `bulk` sd, then as Student's fall.

    Flat in the bulk: tags of a frame must weigh alike there, or their averages would be of unlike frames.
    """
    used = keys.used
    e = solution.e[len(solution.e) - used :]
    left = keys.rows_z[:used] - keys.rows_j[:used] @ solution.x + (keys.rows_a[:used] @ e[..., None])[..., 0]
    distance = np.sqrt(np.sum(left.reshape(used, -1, 3) ** 2, axis=-1)) / marker
    seen = keys.information[:used, :, 0, 0] > 0.0
    return np.asarray(seen * np.minimum(1.0, bulk / np.maximum(distance, 1e-300)) ** 2)
