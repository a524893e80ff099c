"""The frame that comes from a live camera and force sensor: checked, written behind the key frames, and its tags
compared with what was expected of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from onebend.errors import LearningError
from onebend.learning.live.key_frame_posterior import KeyFramePosterior
from onebend.learning.live.key_frames import KeyFrames
from onebend.records import Array, BoolArray


@dataclass(frozen=True)
class CheckedFrame:
    """m tags and a force at one time."""

    time: float  # s
    measured: Array  # (m, 3) m, m, rad; 0 where not seen
    covariance: Array  # (m, 3, 3); the unit matrix where not seen
    root: Array  # (m, 3, 3) R with R' R its inverse; zero where not seen
    visible: BoolArray  # (m,)
    force: Array  # (2,) N, as logged
    push_s: float
    loaded: bool
    gravity: Array  # (2,) m/s^2


def checked_frame(
    tags: int,
    time: float,
    xy: ArrayLike,
    angle: ArrayLike,
    covariance: ArrayLike,
    force: ArrayLike,
    push_s: float,
    loaded: bool,
    gravity: ArrayLike,
) -> CheckedFrame:
    """A frame of `tags` tags. Raises `LearningError` where something does not fit or is not finite."""
    position = _array(xy, (tags, 2), "xy", time)
    turn = _array(angle, (tags,), "angle", time)
    spread = _array(covariance, (tags, 3, 3), "covariance", time)
    pushed, pulled = _array(force, (2,), "force", time), _array(gravity, (2,), "gravity", time)
    if not np.isfinite(time):
        raise LearningError(f"a frame's time must be a finite number, got {time}")
    if not (np.all(np.isfinite(pushed)) and np.all(np.isfinite(pulled))):
        raise LearningError(
            f"frame at {time:g} s: force and gravity must be finite, got {pushed.tolist()} N and {pulled.tolist()} "
            "m/s^2. Leave out frames whose force is not known"
        )
    if loaded and not 0.0 < push_s <= 1.0:
        raise LearningError(f"frame at {time:g} s: the force acts at s in (0, 1], got {push_s}")
    measured = np.concatenate([position, turn[:, None]], axis=1)
    if np.any(np.isinf(measured)):
        raise LearningError(f"frame at {time:g} s: a tag at infinity; give NaN where a tag is not seen")
    visible = np.asarray(np.all(np.isfinite(measured), axis=1) & np.all(np.isfinite(spread), axis=(1, 2)))
    spread = np.where(visible[:, None, None], spread, np.eye(3))
    try:
        lower = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"frame at {time:g} s: the covariance of a tag is not positive definite; give one sd squared of x, y [m^2] "
            "and angle [rad^2] on its diagonal"
        ) from error
    where = push_s if loaded else 1.0
    root = np.linalg.inv(lower) * visible[:, None, None]
    return CheckedFrame(
        time, np.where(visible[:, None], measured, 0.0), spread, root, visible, pushed, where, loaded, pulled
    )


def _array(values: ArrayLike, shape: tuple[int, ...], name: str, time: float) -> Array:
    out = np.asarray(values, dtype=float)
    if out.shape != shape:
        raise LearningError(f"frame at {time:g} s: {name} must have shape {shape}, got {out.shape}")
    return out


def write_frame(keys: KeyFrames, frame: CheckedFrame, rate: Array, terms: Array) -> int:
    """Write the frame behind the key frames in use; returns its index. `rate` (2,) N/s of its force, `terms` (TERMS,)
    of its allowances."""
    i = keys.used
    keys.begin[i] = keys.end[i] = frame.time
    keys.frames[i], keys.rest[i], keys.push_s[i] = 1.0, not frame.loaded, frame.push_s
    keys.force[i], keys.rate[i], keys.gravity[i], keys.terms[i] = frame.force, rate, frame.gravity, terms
    keys.measured[i], keys.weight[i] = frame.measured, frame.visible
    keys.root[i], keys.information[i] = frame.root, frame.root.swapaxes(1, 2) @ frame.root
    keys.used += 1
    return i


def expect_shape(keys: KeyFrames, i: int, error: Array) -> None:
    """First guess of the shape of frame i, the last one, under the force error (2,) [N] that is expected."""
    keys.error[i], keys.stale[i], keys.lost[i] = error, False, False
    keys.shape[i], keys.grid[i] = 0.0, 0.0
    if i > 0:
        pushed = (keys.force[i - 1 : i + 1] - keys.error[i - 1 : i + 1]) * ~keys.rest[i - 1 : i + 1, None]
        keys.q[i], keys.grid[i] = keys.q[i - 1] + keys.by_force[i - 1] @ (pushed[1] - pushed[0]), keys.grid[i - 1]


def surprise(
    keys: KeyFrames,
    frame: CheckedFrame,
    solution: KeyFramePosterior,
    x: Array,
    marker: float,
    expected: tuple[Array, float],
) -> tuple[Array, Array]:
    """Innovation (m, 3) of the last key frame at parameters x, and its distance (m,) in sd.

    `marker`: noise of the tags; `expected`: rows (slots,) of the frame's force error on the known ones, its variance.
    """
    i, tags, (rows, own) = keys.used - 1, len(frame.visible), expected
    j, a = keys.j[i].reshape(-1, len(x)), keys.a[i].reshape(-1, 2)
    innovation = keys.zeta[i] - keys.j[i] @ x + keys.a[i] @ keys.error[i]
    by_errors = -a[:, None, :] * rows[None, :, None]
    spread = solution.spread(by_errors.reshape(len(j), -1), j) + own * a @ a.T
    blocks = spread.reshape(tags, 3, tags, 3)[np.arange(tags), :, np.arange(tags)]
    solved = np.linalg.solve(blocks + marker**2 * frame.covariance, innovation[..., None])[..., 0]
    return innovation, np.sqrt(np.maximum(np.sum(innovation * solved, axis=1), 0.0))
