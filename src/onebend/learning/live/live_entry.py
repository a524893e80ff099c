"""A frame that has just come: written behind the key frames, and its tags against what was expected of them."""

from __future__ import annotations

import numpy as np

from onebend.learning.live.frame_input import Frame
from onebend.learning.live.key_frame_posterior import Solution
from onebend.learning.live.key_frames import KeyFrames
from onebend.records import Array


def write_frame(keys: KeyFrames, frame: Frame, rate: Array) -> int:
    """Put the frame in the place behind the key frames in use, which is returned; `rate` (2,) N/s of its force."""
    i = keys.used
    keys.begin[i] = keys.end[i] = frame.time
    keys.frames[i], keys.rest[i], keys.push_s[i] = 1.0, not frame.loaded, frame.push_s
    keys.force[i], keys.rate[i], keys.gravity[i] = frame.force, rate, frame.gravity
    keys.measured[i], keys.weight[i] = frame.measured, frame.seen
    keys.root[i], keys.information[i] = frame.root, frame.root.swapaxes(1, 2) @ frame.root
    keys.used += 1
    return i


def expect_shape(keys: KeyFrames, i: int, error: Array) -> None:
    """Where to seek the shape of frame i, the last one, under the force error (2,) [N] that is expected of it."""
    keys.error[i], keys.stale[i], keys.lost[i] = error, False, False
    keys.q[i], keys.grid[i] = 0.0, 0.0
    if i > 0:
        pushed = (keys.force[i - 1 : i + 1] - keys.error[i - 1 : i + 1]) * ~keys.rest[i - 1 : i + 1, None]
        keys.q[i], keys.grid[i] = keys.q[i - 1] + keys.by_force[i - 1] @ (pushed[1] - pushed[0]), keys.grid[i - 1]


def surprise(
    keys: KeyFrames, frame: Frame, solution: Solution, x: Array, marker: float, expected: tuple[Array, float]
) -> tuple[Array, Array]:
    """Innovation (m, 3) of the last key frame at parameters x, and its distance (m,) in sd.

    `marker`: noise of the tags; `expected`: rows (slots,) of the frame's force error on the known ones, its variance.
    """
    i, tags, (rows, own) = keys.used - 1, len(frame.seen), expected
    j, a = keys.j[i].reshape(-1, len(x)), keys.a[i].reshape(-1, 2)
    innovation = keys.zeta[i] - keys.j[i] @ x + keys.a[i] @ keys.error[i]
    by_errors = -a[:, None, :] * rows[None, :, None]
    spread = solution.spread(by_errors.reshape(len(j), -1), j) + own * a @ a.T
    blocks = spread.reshape(tags, 3, tags, 3)[np.arange(tags), :, np.arange(tags)]
    solved = np.linalg.solve(blocks + marker**2 * frame.covariance, innovation[..., None])[..., 0]
    return innovation, np.sqrt(np.maximum(np.sum(innovation * solved, axis=1), 0.0))
