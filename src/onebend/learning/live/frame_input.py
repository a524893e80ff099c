"""One frame as it comes from a live camera and force sensor, checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from onebend.errors import LearningError
from onebend.records import Array, BoolArray


@dataclass(frozen=True)
class Frame:
    """m tags and a force at one time."""

    time: float  # s
    measured: Array  # (m, 3) m, m, rad; 0 where not seen
    covariance: Array  # (m, 3, 3); the unit matrix where not seen
    root: Array  # (m, 3, 3) R with R' R its inverse; zero where not seen
    seen: BoolArray  # (m,)
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
) -> Frame:
    """A frame of `tags` tags. Raises `LearningError` where something does not fit or is not finite."""
    place = _array(xy, (tags, 2), "xy", time)
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
    measured = np.concatenate([place, turn[:, None]], axis=1)
    if np.any(np.isinf(measured)):
        raise LearningError(f"frame at {time:g} s: a tag at infinity; give NaN where a tag is not seen")
    seen = np.asarray(np.all(np.isfinite(measured), axis=1) & np.all(np.isfinite(spread), axis=(1, 2)))
    spread = np.where(seen[:, None, None], spread, np.eye(3))
    try:
        lower = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"frame at {time:g} s: the covariance of a tag is not positive definite; give one sd squared of x, y [m^2] "
            "and angle [rad^2] on its diagonal"
        ) from error
    where = push_s if loaded else 1.0
    root = np.linalg.inv(lower) * seen[:, None, None]
    return Frame(time, np.where(seen[:, None], measured, 0.0), spread, root, seen, pushed, where, loaded, pulled)


def _array(values: ArrayLike, shape: tuple[int, ...], name: str, time: float) -> Array:
    out = np.asarray(values, dtype=float)
    if out.shape != shape:
        raise LearningError(f"frame at {time:g} s: {name} must have shape {shape}, got {out.shape}")
    return out
