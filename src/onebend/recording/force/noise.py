"""The noise of a force sensor, white, coloured and a random walk; its sizes from the data.

The error of a force estimate from joint torques changes slowly, with friction, temperature and filters. The model has
three parts, equal and independent on the two axes: white noise, an Ornstein-Uhlenbeck process (exponential
correlation) and a random walk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from onebend.recording.signals import MAD_TO_SD
from onebend.records import Array, ForceNoise


def log_evidence(root: Array, design: Array, values: Array) -> float:
    """Log probability of `values` (N, a) = `design` (N, a, p) @ standard normal coefficients + noise, less a constant.

    The coefficients are shared by the a axes and integrated out (Bayesian linear model; the p x p form of the matrix
    inversion lemma); the noise of the axes is independent; `root` (N, N) is the Cholesky factor of each
    one's covariance.
    """
    n, axes, p = design.shape
    white = solve_triangular(root, np.hstack([design.reshape(n, -1), values]), lower=True, check_finite=False)
    x = white[:, : axes * p].reshape(n * axes, p)
    y = white[:, axes * p :].reshape(n * axes)
    inner = np.linalg.cholesky(np.eye(p) + x.T @ x)
    explained = solve_triangular(inner, x.T @ y, lower=True, check_finite=False)
    spread = axes * np.sum(np.log(np.diag(root))) + np.sum(np.log(np.diag(inner)))
    return float(-0.5 * (y @ y - explained @ explained) - spread)


def first_guess(values: Array, spacing: float) -> ForceNoise:
    """A noise of plausible size for `values` (N, a) sampled every `spacing` [s]."""
    jumps = np.diff(values, n=2, axis=0)
    white = float(np.median(np.abs(jumps))) * MAD_TO_SD / np.sqrt(6) if len(jumps) else 0.0
    size = max(white, 1e-3 * float(np.ptp(values, axis=0).max(initial=0.0)), np.finfo(float).tiny ** 0.25)
    return ForceNoise(white=size, coloured=size, tau=max(0.2, spacing), walk=0.5 * size, spacing=spacing)


def fit_noise(time: Array, design: Array, values: Array, start: ForceNoise) -> ForceNoise:
    """The likeliest noise of `values` (N, a) around anything `design` (N, a, p) can follow.

    A weak prior bounds the sizes: one sd is a factor of five about `start`, of the correlation time a factor of 2.5.
    """
    spread = np.log(np.array([5.0, 5.0, 2.5, 5.0]))
    centre = np.log(np.array([start.white, start.coloured, start.tau, start.walk]))

    def negative_log_posterior(z: Array) -> float:
        noise = _sized(start, centre + spread * z)
        return 0.5 * float(z @ z) - log_evidence(noise.root(time), design, values)

    simplex = np.vstack([np.zeros(4), 0.4 * np.eye(4)])
    options = {"maxfev": 120, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    optimum = minimize(negative_log_posterior, np.zeros(4), method="Nelder-Mead", options=options)
    return _sized(start, centre + spread * optimum.x)


def _sized(start: ForceNoise, logs: Array) -> ForceNoise:
    """`start` with white, coloured, tau and walk of these logarithms."""
    white, coloured, tau, walk = np.exp(logs).tolist()
    return replace(start, white=white, coloured=coloured, tau=tau, walk=walk)
