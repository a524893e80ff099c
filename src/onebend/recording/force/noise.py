"""The noise of a force sensor, white, coloured and a random walk; its sizes from the data.

The error of a force estimate from joint torques changes slowly, with friction, temperature and filters. The model has
three parts, equal and independent on the two axes: white noise, an Ornstein-Uhlenbeck process (exponential
correlation) and a random walk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.optimize import minimize

from onebend.recording.force.noise_factor import NoiseFactor, noise_factor
from onebend.recording.signals import MAD_TO_SD
from onebend.records import Array, ForceNoise, IntArray


@dataclass(frozen=True)
class LinearModel:
    """`values` (N, a) = `design` (N, a, p) @ standard normal coefficients + noise; each column stands but once: many
    are of one axis alone, and the same for every axis."""

    columns: Array  # (N, c)
    coefficients: int  # p
    of_axis: tuple[tuple[IntArray, IntArray], ...]  # (q + 1,) of each axis: its coefficients, and p; its columns


@dataclass(frozen=True)
class ColumnLayout:
    """Which columns of a design (N, a, p) are not zero, and which of them differ."""

    axis: IntArray  # (d,) of those that differ
    coefficient: IntArray  # (d,)
    of_axis: tuple[tuple[IntArray, IntArray], ...]  # (q,) of each axis: its coefficients; which of the d they are


def layout_of(design: Array) -> ColumnLayout:
    """Of `design` (N, a, p)."""
    number: dict[bytes, int] = {}
    first: list[tuple[int, int]] = []
    of_axis = []
    for a in range(design.shape[1]):
        used = np.flatnonzero(np.any(design[:, a], axis=0))
        for i in used.tolist():
            if number.setdefault(design[:, a, i].tobytes(), len(first)) == len(first):
                first.append((a, i))
        of_axis.append((used, np.array([number[design[:, a, i].tobytes()] for i in used], dtype=np.int64)))
    axis, coefficient = np.array(first, dtype=np.int64).reshape(-1, 2).T
    return ColumnLayout(axis, coefficient, tuple(of_axis))


def linear_model(design: Array, values: Array, layout: ColumnLayout | None = None) -> LinearModel:
    """Of `design` (N, a, p) and `values` (N, a); `layout`: of designs of which this one is a part."""
    layout = layout or layout_of(design)
    differing, p = len(layout.axis), design.shape[2]
    of_axis = tuple(
        (np.append(used, p), np.append(at, differing + axis)) for axis, (used, at) in enumerate(layout.of_axis)
    )
    return LinearModel(np.concatenate([design[:, layout.axis, layout.coefficient], values], axis=1), p, of_axis)


def log_evidence(factor: NoiseFactor, model: LinearModel) -> float:
    """Log probability of the model's values, less a constant.

    The coefficients are shared by the axes and integrated out (Bayesian linear model; the p x p form of the matrix
    inversion lemma); the noise of the axes is independent, each one's covariance is that of `factor`.
    """
    products = factor.inner(model.columns)
    p = model.coefficients
    inner = np.eye(p + 1)
    for rows, at in model.of_axis:
        inner[rows[:, None], rows] += products[at[:, None], at]
    square = float(inner[p, p]) - 1.0
    root, _ = dpotrf(inner[:p, :p], lower=1)
    explained, _ = dtrtrs(root, inner[:p, p], lower=1)
    spread = len(model.of_axis) * factor.log_root + float(np.sum(np.log(np.diag(root))))
    return float(-0.5 * (square - explained @ explained) - spread)


def first_guess(values: Array, spacing: float) -> ForceNoise:
    """A noise of plausible size for `values` (N, a) sampled every `spacing` [s]."""
    jumps = np.diff(values, n=2, axis=0)
    white = float(np.median(np.abs(jumps))) * MAD_TO_SD / np.sqrt(6) if len(jumps) else 0.0
    size = max(white, 1e-3 * float(np.ptp(values, axis=0).max(initial=0.0)), np.finfo(float).tiny ** 0.25)
    return ForceNoise(white=size, coloured=size, tau=max(0.2, spacing), walk=0.5 * size, spacing=spacing)


def fit_noise(time: Array, model: LinearModel, start: ForceNoise) -> ForceNoise:
    """The likeliest noise of the model's values at `time` (N,) around anything that its columns can follow.

    A weak prior bounds the sizes: one sd is a factor of five about `start`, of the correlation time a factor of 2.5.
    """
    spread = np.log(np.array([5.0, 5.0, 2.5, 5.0]))
    centre = np.log(np.array([start.white, start.coloured, start.tau, start.walk]))

    def negative_log_posterior(z: Array) -> float:
        noise = _sized(start, centre + spread * z)
        return 0.5 * float(z @ z) - log_evidence(noise_factor(noise, time), model)

    simplex = np.vstack([np.zeros(4), 0.4 * np.eye(4)])
    options = {"maxfev": 120, "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    optimum = minimize(negative_log_posterior, np.zeros(4), method="Nelder-Mead", options=options)
    return _sized(start, centre + spread * optimum.x)


def _sized(start: ForceNoise, logs: Array) -> ForceNoise:
    """`start` with white, coloured, tau and walk of these logarithms."""
    white, coloured, tau, walk = np.exp(logs).tolist()
    return replace(start, white=white, coloured=coloured, tau=tau, walk=walk)
