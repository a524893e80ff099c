"""What each frame by itself says of its force, all that the frames share being known.

With `f` the force of a frame, `e` (normal, of sd one) what is left unknown of all that the frames share, and the
frame's own noise `n`, of sd one: `told = weigh f + common e + n`, to first order. The prior of the force is not in it.
Noise that lasts over several frames is widened to white noise with as much of it in the mean of many frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import apply
from onebend.learning.model.frames import whitening
from onebend.learning.sensing.bench import Bench, problem_apart, problem_of, solve
from onebend.learning.sensing.estimate import CHUNK, PLACE_PRIOR
from onebend.learning.sensing.tags import tags_of
from onebend.records import Array, BoolArray, IntArray

_LONGEST = 0.25  # of the frames: so far apart noise is compared
_ALIKE = 0.05  # correlation of the noise below which it is none
_FEWEST = 12  # frames from which the noise's memory is looked for


@dataclass(frozen=True)
class Readings:
    """Of F frames, rising in time; a frame that tells nothing has rows of zeros. The first row tells most."""

    time: Array  # (F,) s
    weigh: Array  # (F, 2, 2) 1/N
    told: Array  # (F, 2)
    common: Array  # (F, 2, r)
    widened: float  # of the variance of the frames' own noise, for its memory

    def take(self, rows: IntArray | slice) -> Readings:
        """Of some frames."""
        return Readings(self.time[rows], self.weigh[rows], self.told[rows], self.common[rows], self.widened)


@dataclass(frozen=True)
class _Linear:
    """Residuals over the tags' noise and their derivatives; zero where nothing was measured."""

    residual: Array  # (F, 3 m)
    by_force: Array  # (F, 3 m, 2) 1/N
    by_place: Array  # (F, 3 m) 1/s
    by_shared: Array  # (F, 3 m, r)
    measured: BoolArray  # (F, 3 m)


def read(bench: Bench, frames: IntArray, force: Array, place: Array, prior_sd: float, *, seek_place: bool) -> Readings:
    """Of `frames` (F,), to first order about `force` (F, 2) N at `place` (F,), NaN in frames that tell nothing.

    What a frame tells less of than the prior (`prior_sd` N) is left out: it depends on how the beam is bent at rest
    and on the other component, which first order does not know, and many frames would make it sure.
    """
    known = np.flatnonzero(np.isfinite(force).all(axis=1) & np.isfinite(place))
    chunks = [known[i : i + CHUNK] for i in range(0, len(known), CHUNK)]
    parts = [_linear(bench, frames[rows], force[rows], place[rows], seek_place) for rows in chunks]
    count, ways, time = len(frames), bench.root.shape[1], bench.observations.time[frames]
    weigh, told, common = np.zeros((count, 2, 2)), np.zeros((count, 2)), np.zeros((count, 2, ways))
    if not parts:
        return Readings(time, weigh, told, common, 1.0)
    one = _Linear(*(np.concatenate(each) for each in zip(*(vars(part).values() for part in parts), strict=True)))
    if seek_place:
        one = _without_place(one, place[known])
    side, size, _ = np.linalg.svd(one.by_force, full_matrices=False)
    across = np.swapaxes(side, 1, 2)
    left = one.residual - apply(side, apply(across, one.residual))
    widened = _memory(left, one.measured, seek_place)
    side = np.where((prior_sd * size > 1.0)[..., None], across / np.sqrt(widened), 0.0)
    weigh[known] = side @ one.by_force
    told[known] = apply(side, one.residual) + apply(weigh[known], force[known])
    common[known] = side @ one.by_shared
    return Readings(time, weigh, told, common, widened)


def _linear(bench: Bench, frames: IntArray, force: Array, place: Array, seek_place: bool) -> _Linear:
    o = bench.observations
    seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    whiten = whitening(seen, o.covariance[frames])
    problem = (problem_apart if seek_place else problem_of)(bench, frames, place)
    solved = solve(bench, problem, force, place, None)
    tags = tags_of(bench, frames, solved, force, place)
    stands = solved.converged

    def flat(of_tags: Array) -> Array:
        out = (whiten @ np.where(stands[:, None, None, None], of_tags, 0.0)).reshape(len(frames), -1, of_tags.shape[-1])
        return np.asarray(out)

    residual = flat(np.nan_to_num(seen - tags.pose)[..., None])[..., 0]
    by_place = flat(o.length * tags.by_place[..., None])[..., 0]
    measured = (np.any(whiten != 0.0, axis=-1) & stands[:, None, None]).reshape(len(frames), -1)
    return _Linear(residual, flat(tags.by_force), by_place, flat(tags.by_shared @ bench.root), measured)


def _without_place(one: _Linear, place: Array) -> _Linear:
    """Each frame's own place integrated out."""
    mean, sd = PLACE_PRIOR
    way = sd * one.by_place
    residual = one.residual + one.by_place * (place - mean)[:, None]
    size = np.sum(way**2, axis=1)
    # (I + w w^T)^(-1/2) = I - w w^T (1 - (1 + |w|^2)^(-1/2)) / |w|^2
    less = np.divide(1.0 - 1.0 / np.sqrt(1.0 + size), size, out=np.zeros_like(size), where=size > 0.0)

    def without(values: Array) -> Array:
        return np.asarray(values - (less[:, None] * way)[..., None] * (way[:, None] @ values))

    residual = without(residual[..., None])[..., 0]
    return _Linear(residual, without(one.by_force), way, without(one.by_shared), one.measured)


def _memory(left: Array, measured: BoolArray, seek_place: bool) -> float:
    """Variance of the mean of many frames over that of as many with white noise as stated; 1 or more.

    From what is `left` (F, 3 m) of the tags beside the force: half the mean square of its differences over `n` frames
    is `V (1 - rho_n)`.
    """
    if len(left) < _FEWEST:
        return 1.0
    numbers = measured.sum(axis=1)
    free = np.maximum(numbers - (3.0 if seek_place else 2.0), 0.0) / np.maximum(numbers, 1)
    halves = []
    for n in range(1, int(_LONGEST * len(left)) + 1):
        both = measured[n:] & measured[:-n]
        expected = float(np.sum(both * (0.5 * (free[n:] + free[:-n]))[:, None]))
        squares = float(np.sum(np.where(both, left[n:] - left[:-n], 0.0) ** 2))
        halves.append(0.5 * squares / expected if expected > 0.0 else 0.0)
    whole = float(np.mean(halves[len(halves) // 2 :]))
    if whole <= 0.0:
        return 1.0
    alike = 1.0 - np.array(halves) / whole
    ends = np.flatnonzero(alike < _ALIKE)
    return float(max(whole * (1.0 + 2.0 * np.sum(alike[: ends[0] if ends.size else len(alike)])), 1.0))
