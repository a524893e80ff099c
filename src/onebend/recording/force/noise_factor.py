"""The covariance of a force sensor's noise, factored: a dense one of few rows, a band of many.

Row i of one axis is `x_i + w_i + e_i`: an Ornstein-Uhlenbeck process x and a random walk w, both Markov processes, and
white noise e. So the precision P of the states (x_0, w_0, x_1, w_1, ...) is a band, and by the matrix inversion lemma

    C^-1 = (1 - H (W P + H' H)^-1 H') / W

with W the variance of e and H the sum of the two states of a row: one banded Cholesky factor instead of a dense one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpotrf, dtbtrs, dtrtrs

from onebend.records import Array, ForceNoise

_NEGLIGIBLE = 1e-14  # of the white variance: a step of a process below it is taken for it
_FEW = 150  # rows, up to which the dense factor is the quicker one


@dataclass(frozen=True)
class NoiseFactor:
    """`C` (N, N) N^2, the covariance of the noise of one axis at N rows."""

    root: Array  # (N, N) N, its lower Cholesky factor; or that of W P + H' H as a band (3, 2 N)
    white: float  # W, N^2, of the band; NaN: `root` is the dense one
    log_root: float  # half of the log of the determinant of C

    def inner(self, columns: Array) -> Array:
        """(c, c): `columns' C^-1 columns` for `columns` (N, c)."""
        if np.isnan(self.white):
            half, _ = dtrtrs(self.root, columns, lower=1)
            return np.asarray(half.T @ half)
        summed = np.repeat(columns, 2, axis=0)
        summed[1] = 0.0  # the walk begins at zero
        half, _ = dtbtrs(self.root, summed, uplo="L")
        return np.asarray((columns.T @ columns - half.T @ half) / self.white)


def noise_factor(noise: ForceNoise, time: Array, walked: Array | None = None) -> NoiseFactor:
    """Of the covariance of `noise` at rising `time` (N,) [s]; with `walked` (N,) [N^2], the variance that a second walk
    has gathered so far, counted from the first row.

    Raises:
        numpy.linalg.LinAlgError: the covariance is not positive definite.
    """
    return dense_factor(noise, time, walked) if len(time) <= _FEW else banded_factor(noise, time, walked)


def dense_factor(noise: ForceNoise, time: Array, walked: Array | None = None) -> NoiseFactor:
    """As `noise_factor`, in a time that goes with the cube of the rows."""
    covariance = noise.covariance(time)
    if walked is not None:
        covariance += np.minimum(walked[:, None], walked) - walked[0]
    root, info = dpotrf(covariance, lower=1)
    _check(info)
    return NoiseFactor(np.asarray(root), np.nan, float(np.sum(np.log(np.diag(root)))))


def banded_factor(noise: ForceNoise, time: Array, walked: Array | None = None) -> NoiseFactor:
    """As `noise_factor`, in a time that goes with the rows."""
    n, gaps = len(time), np.diff(time)
    coloured, walk = noise.coloured**2, noise.walk**2
    white = noise.white**2 + 1e-12 * (coloured + walk * (time[-1] - time[0])) + float(np.finfo(float).tiny)
    of_x, of_w = np.full(n, coloured), np.ones(n)  # variances of the steps; w_0 is none
    of_x[1:] = -coloured * np.expm1(-2.0 * gaps / noise.tau)
    of_w[1:] = walk * gaps if walked is None else walk * gaps + np.diff(walked)
    of_x, of_w = np.maximum(of_x, _NEGLIGIBLE * white), np.maximum(of_w, _NEGLIGIBLE * white)
    decay, x, w = np.exp(-gaps / noise.tau), white / of_x, white / of_w
    w[0] = 1.0
    band = np.zeros((3, 2 * n))
    band[0, ::2] = 1.0 + x
    band[0, :-2:2] += decay**2 * x[1:]
    band[0, 1::2] = w
    band[0, 3::2] += 1.0
    band[0, 3:-2:2] += w[2:]
    band[1, 2::2] = 1.0
    band[2, :-2:2] = -decay * x[1:]
    band[2, 3:-2:2] = -w[2:]
    root, info = dpbtrf(band, lower=1)
    _check(info)
    steps = float(np.sum(np.log(of_x)) + np.sum(np.log(of_w[1:])))
    log_root = float(np.sum(np.log(root[0]))) + 0.5 * (steps - (n - 1) * np.log(white))
    return NoiseFactor(np.asarray(root), white, log_root)


def _check(info: int) -> None:
    if info:
        raise np.linalg.LinAlgError("the covariance of the force's noise is not positive definite")
