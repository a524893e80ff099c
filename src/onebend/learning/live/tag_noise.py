"""Noise of the tags in the live learner, from what the present estimate leaves of the key frames.

Less all that an error of each one's force could explain: as in the fit, what the log's noise does is not the tags'. An
average of frames says how far off averages are: what lasts from frame to frame counts with its correlation time.
"""

from __future__ import annotations

import numpy as np

from onebend.learning.live.key_frame_posterior import KeyFramePosterior
from onebend.learning.live.key_frames import KeyFrames
from onebend.records import Array

_BULK = 5.0  # sd: beyond, a tag was read wrong
_LEAST = 0.02  # of what the tags' covariances say
_GUESS_COUNTS = 60.0  # numbers that the size it begins with counts like
_NO_FORCE = 1e-9  # 1/N^2: what a force of which the tags tell nothing is said to move them by


def tag_residuals(keys: KeyFrames, solution: KeyFramePosterior) -> Array:
    """(K, 3 m) whitened: what the solution leaves of the key frames."""
    used = keys.used
    e = solution.e[len(solution.e) - used :]
    return np.asarray(
        keys.rows_z[:used] - keys.rows_j[:used] @ solution.x + (keys.rows_a[:used] @ e[..., None])[..., 0]
    )


def force_in(residual: Array, a: Array) -> Array:
    """(K, 2) N: the force of each frame that explains most of its residuals (K, R); `a` (K, R, 2) m/N or 1/N: how it
    moves the tags."""
    turned = a.swapaxes(1, 2)
    gram, by = turned @ a, (turned @ residual[..., None])[..., 0]
    xx, yy, xy = gram[:, 0, 0] + _NO_FORCE, gram[:, 1, 1] + _NO_FORCE, gram[:, 0, 1]
    out = np.empty_like(by)
    out[:, 0], out[:, 1] = yy * by[:, 0] - xy * by[:, 1], xx * by[:, 1] - xy * by[:, 0]
    return out / (xx * yy - xy**2)[:, None]


def without_force(residual: Array, a: Array) -> Array:
    """Residuals (K, R) less what a force of each frame could explain; `a` (K, R, 2) as in `force_in`."""
    return np.asarray(residual - (a @ force_in(residual, a)[..., None])[..., 0])


def robust_weights(keys: KeyFrames, residual: Array, marker: float, bulk: float) -> Array:
    """(K, m) robust weights of the tags: 1 where what the solution leaves is within `bulk` sd, then as Student's fall.

    Flat in the bulk: tags of a frame must weigh alike there, or their averages would be of unlike frames.
    """
    distance = np.sqrt(np.sum(residual.reshape(len(residual), -1, 3) ** 2, axis=-1)) / marker
    visible = keys.information[: keys.used, :, 0, 0] > 0.0
    return np.asarray(visible * np.minimum(1.0, bulk / np.maximum(distance, 1e-300)) ** 2)


def tag_noise_size(keys: KeyFrames, residual: Array, spent: float, expected: float) -> float:
    """Size of the tags' noise over what their covariances say.

    `spent`: parameters that the tags settled; `expected`: the size before the data.
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
