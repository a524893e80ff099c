"""Noise of the tags in the live learner, from the residuals of the key frames.

As in the fit, what an error of each frame's force can explain is taken out first. A key frame that averages several
frames shows the error of averages, so errors that last from frame to frame count with their correlation time.
"""

from __future__ import annotations

import numpy as np

from onebend.learning.live.key_frame_posterior import KeyFramePosterior
from onebend.learning.live.key_frames import KeyFrames
from onebend.records import Array

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
