"""The force log beside the film, judged by the force that the shape tells: gain, direction, bias, drift and delay.

The log is taken to be `(1 + g) R(d) F(t - tau) + b + c (t - t0)`, F being the force that the shape tells, whose errors
are `S_t e` in common to all frames, e normal of sd one, and one of each frame. Gauss-Newton for the seven numbers and e
together; what is left of the log, with its correlation from frame to frame, is the noise of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from onebend.records import Array, CleanForce

_ROUNDS = 12
_FEWEST = 12  # frames
_WINDOW = 9  # frames, for the slope of the force in time
_DIRECTION_SD = 0.05  # rad, of the log's axes before the film: by hand and eye
_LEAST = 1e-4  # of the largest force: the least noise of a log
START = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # a log that is right


@dataclass(frozen=True)
class SensorCheck:
    """What a force log makes of the force on the beam; values with one sd each."""

    gain: tuple[float, float]  # 1: right
    direction: tuple[float, float]  # rad, by which the log's axes are turned against the beam's, as they are stated
    delay: tuple[float, float]  # s, of the log behind the film, on the clock that was found
    bias: tuple[Array, Array]  # (2,) N each, beam's frame; in the middle of the film, with what was taken off as zero
    drift: tuple[Array, Array]  # (2,) N/s each, likewise
    noise: float  # N, RMS of what is left of the log in each component
    frames: int


def check_sensor(
    time: Array, force: Array, covariance: Array, common: Array, logged: Array, clean: CleanForce | None
) -> SensorCheck | None:
    """Of the log (T, 2) [N] at the frames' `time` (T,) [s], by the `force` (T, 2) [N] that the shape tells, its
    `covariance` (T, 2, 2), and `common` (T, 2, r), what one sd of each error in common does to it; None where too few
    frames have both."""
    good = np.isfinite(force).all(axis=1) & np.isfinite(logged).all(axis=1)
    if np.sum(good) < _FEWEST:
        return None
    time, force, covariance, common, logged = (x[good] for x in (time, force, covariance, common, logged))
    middle = 0.5 * (time[0] + time[-1])
    rate = savgol_filter(force, _WINDOW, 2, deriv=1, delta=float(np.median(np.diff(time))), axis=0)
    own = covariance - common @ np.swapaxes(common, 1, 2)
    x, shared = START.copy(), np.zeros(common.shape[-1])
    largest = float(np.max(np.abs(logged)))
    loose = np.full(len(x), 1e-12)
    loose[1] = _DIRECTION_SD**-2
    noise, likeness = 0.05 * largest, 0.0
    spread = np.eye(len(x))
    for _ in range(_ROUNDS):
        cos, sin = np.cos(x[1]), np.sin(x[1])
        turn, turned = np.array([[cos, -sin], [sin, cos]]), np.array([[-sin, -cos], [cos, -sin]])
        seen = force - common @ shared
        moved = seen - x[2] * rate
        later = (time - middle)[:, None]
        away = logged - (x[0] * moved @ turn.T + x[3:5] + later * x[5:7])
        slopes = np.zeros((len(time), 2, len(x)))
        slopes[..., 0], slopes[..., 1] = moved @ turn.T, x[0] * moved @ turned.T
        slopes[..., 2] = -x[0] * rate @ turn.T
        slopes[:, [0, 1], [3, 4]] = 1.0
        slopes[:, [0, 1], [5, 6]] = later
        by = np.concatenate([slopes, -x[0] * turn @ common], axis=-1)
        weight = np.linalg.inv(x[0] ** 2 * turn @ own @ turn.T + noise**2 * np.eye(2))
        weight = weight * (1.0 - likeness) / (1.0 + likeness)
        normal = np.einsum("tcn,tcd,tdk->nk", by, weight, by)
        normal += np.diag(np.concatenate([loose, np.ones(len(shared))]))
        right = np.einsum("tcn,tcd,td->n", by, weight, away) - np.concatenate([loose * (x - START), shared])
        step = np.linalg.solve(normal, right)
        x, shared = x + step[: len(x)], shared + step[len(x) :]
        spread = np.linalg.inv(normal)[: len(x), : len(x)]
        noise, likeness = _noise_of(away - by @ step, own, largest)
    sd = np.sqrt(np.diag(spread))
    zero, slope = (np.zeros(2), np.zeros(2)) if clean is None else (clean.tare, np.nan_to_num(clean.drift))
    return SensorCheck(
        gain=(float(x[0]), float(sd[0])),
        direction=(float(x[1]), float(sd[1])),
        delay=(float(x[2]), float(sd[2])),
        bias=(x[3:5] + zero, sd[3:5]),
        drift=(x[5:7] + slope, sd[5:7]),
        noise=noise,
        frames=len(time),
    )


def _noise_of(left: Array, own: Array, largest: float) -> tuple[float, float]:
    """N of each component, beyond the frames' own errors where these are small, and the likeness of neighbours."""
    weak = np.trace(own, axis1=1, axis2=2)
    sure = weak <= np.quantile(weak, 0.5)
    values, vectors = np.linalg.eigh(own)
    best = np.einsum("tc,tc->t", vectors[..., 0], left)
    squares = best[sure] ** 2 - values[sure, 0]
    noise = np.sqrt(max(float(np.mean(squares)), (_LEAST * largest) ** 2))
    centred = left - left.mean(axis=0)
    scale = np.sqrt(np.maximum(np.mean(centred**2, axis=0), np.finfo(float).tiny))
    alike = np.mean(centred[1:] * centred[:-1] / scale**2)
    return float(noise), float(np.clip(alike, 0.0, 0.98))
