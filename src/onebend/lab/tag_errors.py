"""Errors of filmed tags: noise of their poses, frames that are wrong, tags that are missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.lab.sensors import coloured
from onebend.records import Array


@dataclass(frozen=True)
class TagNoise:
    """White noise plus noise that is correlated in time; what the observer states of it may be wrong."""

    white_xy: float = 2e-5  # m
    white_angle: float = 1e-3  # rad
    slow_xy: float = 0.0  # m, Ornstein-Uhlenbeck
    slow_angle: float = 0.0  # rad
    slow_time: float = 0.5  # s
    stated: float = 1.0  # the observer's sd over the true sd of one frame
    outliers: float = 0.0  # share of poses that are wrong by `outlier_xy`, `outlier_angle` (sd)
    outlier_xy: float = 2e-3  # m
    outlier_angle: float = 0.05  # rad
    missing: float = 0.0  # share of poses that are not seen


def filmed(noise: TagNoise, pose: Array, step: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Poses (T, m, 3) [m, m, rad] as seen every `step` [s], NaN where missing, and their covariance (T, m, 3, 3)."""
    count, tags = pose.shape[:2]
    white = np.array([noise.white_xy, noise.white_xy, noise.white_angle])
    slow = np.array([noise.slow_xy, noise.slow_xy, noise.slow_angle])
    far = np.array([noise.outlier_xy, noise.outlier_xy, noise.outlier_angle])
    measured = pose + white * rng.standard_normal(pose.shape)
    pairs = [coloured(count, step, noise.slow_time, rng) for _ in range((3 * tags + 1) // 2)]
    measured = measured + slow * np.concatenate(pairs, axis=1)[:, : 3 * tags].reshape(count, tags, 3)
    wrong = rng.random((count, tags)) < noise.outliers
    measured = measured + wrong[..., None] * far * rng.standard_normal(pose.shape)
    measured[rng.random((count, tags)) < noise.missing] = np.nan
    sd = noise.stated * np.sqrt(white**2 + slow**2)
    return measured, np.tile(np.diag(sd**2), (count, tags, 1, 1))
