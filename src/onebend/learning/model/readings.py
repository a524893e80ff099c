"""How poses were read: errors that neighbouring points have in common, rulers that stand still, zeroed gauges.

As a rule a point is read by itself, from the clamp, and goes with its mark on the beam. Static poses know three other
ways. What a hand traces is off by much the same over some way along the curve. A ruler or a dial gauge stands at a
fixed x, and the beam slides along beneath it. And gauges are zeroed in one pose, from which their readings count.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.statics.equilibrium import Equilibrium
from onebend.learning.model.frames import whitening
from onebend.records import Array, BoolArray, Observations

STEEPEST = 0.05  # cosine of the beam's angle under a ruler, at least
_LOOKED_AT = np.linspace(0.0, 1.0, 201)
_HALF = 1.678346990016661  # where `(1 + a) exp(-a)` is a half
_SETTLE = 4  # steps of Newton's method from there


def pose_whitening(o: Observations, measured: Array, covariance: Array) -> Array:
    """What makes the errors of poses (F, m, 3) with covariances (F, m, 3, 3) independent, of sd one: (F, m, 3, 3), each
    point by itself; (F, 3 m, 3 m) where errors are alike over some way along the beam. Zero where a number is missing.

    There the errors of x and y are a process along the beam of once differentiable functions (Matern 3/2): a traced
    line has a direction everywhere. `error_length` l is the way over which their correlation falls to a half:
    `(1 + a) exp(-a)` at a distance d, with `a = 1.68 d / l`. Errors of angles are each its own.
    """
    if o.readings.error_length == 0.0:
        return whitening(measured, covariance)
    frames, m = measured.shape[:2]
    apart = o.length * np.abs(o.marker_s[:, None] - o.marker_s)
    share = _HALF * apart / o.readings.error_length
    alike = np.ones((m, m, 3)) * ((1.0 + share) * np.exp(-share))[..., None]
    alike[..., 2] = np.eye(m)
    there = np.isfinite(measured) & np.all(np.isfinite(covariance), axis=(-1, -2))[..., None]
    both = there[..., :, None] & there[..., None, :]
    values, vectors = np.linalg.eigh(np.where(both, covariance, np.eye(3)))
    root = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    whole = np.einsum("fiab,ijb,fjcb->fiajc", root, alike, root).reshape(frames, 3 * m, 3 * m)
    known = there.reshape(frames, 3 * m)
    pairs = known[:, :, None] & known[:, None, :]
    factors = np.linalg.inv(np.linalg.cholesky(np.where(pairs, whole, np.eye(3 * m))))
    return np.asarray(np.where(pairs, factors, 0.0))


def whitened(whiten: Array, poses: Array) -> Array:
    """(F, 3 m, n) of columns of poses (F, m, 3, n), by `pose_whitening`."""
    flat = poses.reshape(len(poses), -1, poses.shape[-1])
    if whiten.ndim == 3:
        return np.asarray(whiten @ flat)
    return np.asarray((whiten @ poses).reshape(flat.shape))


def unwhitened(whiten: Array, rows: Array) -> Array:
    """(F, m, 3) of rows (F, 3 m): back from `whitened`, zero where a number is missing."""
    known = np.any(whiten != 0.0, axis=-1)
    safe = whiten + ~known[..., None] * np.eye(whiten.shape[-1])
    away = np.linalg.solve(safe, rows.reshape(*known.shape, 1))[..., 0]
    return np.asarray(np.where(known, away, 0.0).reshape(len(rows), -1, 3))


def ruler_places(solved: Equilibrium, x: Array) -> tuple[Array, Array]:
    """Where beams pass under rulers at x (F, m) [m]: (F, m) s, the first from the clamp on, and (F, m) m farther out
    along the tangent where a beam does not reach its ruler."""
    there = solved.xy(_LOOKED_AT)[..., 0]
    reached = there[:, None, :] >= x[..., None]  # (F, m, S)
    after = np.maximum(np.argmax(reached, axis=-1), 1)
    ahead, behind = (np.take_along_axis(there, i, axis=1) for i in (after, after - 1))
    share = np.clip((x - behind) / np.where(ahead == behind, 1.0, ahead - behind), 0.0, 1.0)
    low, high = _LOOKED_AT[after - 1], _LOOKED_AT[after]
    s = low + share * (high - low)
    length = np.max(solved.problem.length)
    for _ in range(_SETTLE):
        s = np.clip(s + (x - solved.xy(s)[..., 0]) / (length * steepness(solved.angle(s))), low, high)
    tip = solved.angle(np.ones(1))
    over = (x - solved.xy(np.ones(1))[..., 0]) / steepness(tip)
    short = ~np.any(reached, axis=-1)
    return np.where(short, 1.0, s), np.where(short, over, 0.0)


def steepness(angle: Array) -> Array:
    """(...) cosine of the beam's angle where it passes under a ruler; none is read where the beam stands upright."""
    return np.maximum(np.cos(angle), STEEPEST)


def points_of(o: Observations, frames: BoolArray, solved: Equilibrium) -> Array:
    """(F, m, 2) m of what is read of shapes `solved` in these frames (T,): their marks, or what passes the rulers."""
    if o.readings.at == "mark":
        return solved.xy(o.marker_s)
    x = o.xy[frames][..., 0]
    asked = np.where(np.isfinite(x), x, 0.0)
    s, over = ruler_places(solved, asked)
    y = solved.xy(s)[..., 1] + over * np.sin(solved.angle(s))
    return np.stack([x, np.where(np.isfinite(x), y, np.nan)], axis=-1)


def from_the_clamp(o: Observations, frames: BoolArray, predicted: Array) -> Array:
    """(F, m, 2) m, readings of these frames (T,), counted from the clamp: those of zeroed gauges are put where the
    `predicted` (F, m, 2) pose of their zero was, or, where that is not among the frames, the shapes on the whole are.
    """
    read, zeroed = o.xy[frames], o.readings.bare
    if zeroed < 0:
        return read
    away = np.where(np.isfinite(read), predicted - read, np.nan)
    shift = away[int(np.sum(frames[:zeroed]))] if frames[zeroed] else _mean(away)
    return read + (shift if o.readings.at == "mark" else shift * np.array([0.0, 1.0]))


def _mean(values: Array) -> Array:
    """Over the first axis, of what is known there."""
    known = np.isfinite(values)
    count = np.sum(known, axis=0)
    total = np.sum(np.where(known, values, 0.0), axis=0)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def zeroed_coordinates(o: Observations) -> tuple[tuple[int, int], ...]:
    """(point, axis) of every reading that counts from a zero of its own."""
    if o.readings.bare < 0:
        return ()
    axes = (0, 1) if o.readings.at == "mark" else (1,)
    seen = np.any(np.isfinite(o.xy), axis=0)
    return tuple((i, c) for i in range(len(o.marker_s)) for c in axes if seen[i, c])
