"""What each frame by itself says of its force, all that the frames share being known.

With `f` the force of a frame, `e` (normal, of sd one) what is left unknown of all that the frames share, and the
frame's own noise `n`, of sd one: `told = weigh f + common e + n`, to first order. The prior of the force is not in it.
Noise that lasts over several frames is widened to white noise with as much of it in the mean of many frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import apply
from onebend.learning.model.frames import whitening
from onebend.learning.sensing.bench import Bench, problem_apart, problem_of, solve
from onebend.learning.sensing.estimate import CHUNK, Estimates, with_place
from onebend.learning.sensing.tags import tags_of
from onebend.records import Array, BoolArray, IntArray

_LONGEST = 0.25  # of the frames: so far apart noise is compared
_ALIKE = 0.05  # correlation of the noise below which it is none
_TOLD = 1e-3  # of the prior's sd over that of a frame: what tells less tells nothing
_FEWEST = 12  # frames from which the noise's memory is looked for


@dataclass(frozen=True)
class FrameForces:
    """Of F frames, rising in time; a frame that tells nothing has rows of zeros. The first row tells most."""

    time: Array  # (F,) s
    weigh: Array  # (F, 2, 2) 1/N
    told: Array  # (F, 2)
    common: Array  # (F, 2, r)
    widened: float  # of the variance of the frames' own noise, for its memory

    def take(self, rows: IntArray | slice) -> FrameForces:
        """Of some frames."""
        return FrameForces(self.time[rows], self.weigh[rows], self.told[rows], self.common[rows], self.widened)


def estimated(time: Array, found: Estimates, widened: float, prior_sd: float) -> FrameForces:
    """What `found` says, each frame's whole region (with what all share) taken for its noise, without the prior.

    With a posterior of variance `v` and mean `a` in one of its axes, the frame told `a / v`, with the information
    `1/v - 1/prior_sd^2`.
    """
    known: BoolArray = np.asarray(np.isfinite(found.force).all(axis=1))
    nothing = np.where(known[:, None, None], 0.0, prior_sd**2 * np.eye(2))
    whole = np.where(known[:, None, None], found.covariance[:, :2, :2], nothing)
    common = np.where(known[:, None, None], found.common[:, :2], 0.0)
    whole = whole + (widened - 1.0) * np.where(known[:, None, None], whole - common @ np.swapaxes(common, 1, 2), 0.0)
    values, ways = np.linalg.eigh(whole)
    size = np.sqrt(np.maximum(1.0 / values - prior_sd**-2, 0.0))
    size = np.where(prior_sd * size > _TOLD, size, 0.0)
    across = np.swapaxes(ways, 1, 2)
    scale = np.divide(1.0, values * size, out=np.zeros_like(size), where=size > 0.0)[..., None] * across
    told = apply(scale, np.nan_to_num(found.force[:, :2]))
    return FrameForces(time, size[..., None] * across, told, scale @ common, widened)


@dataclass(frozen=True)
class _Linear:
    """Residuals over the tags' noise and their derivatives; zero where nothing was measured."""

    residual: Array  # (F, 3 m)
    by_force: Array  # (F, 3 m, 2) 1/N
    by_other: Array  # (F, 3 m, k) of the frame's other unknowns, over their priors' sds
    other: Array  # (F, k) less their priors' means, over their sds
    by_shared: Array  # (F, 3 m, r)
    measured: BoolArray  # (F, 3 m)


def read(
    bench: Bench,
    frames: IntArray,
    load: Array,
    place: Array,
    prior_sd: Array,
    *,
    seek_place: bool,
    which: int = 0,
) -> FrameForces:
    """Of `frames` (F,), to first order about `load` (F, n) at `place` (F,) or (F, 2), NaN in frames that tell nothing;
    of the first force or, with `which` 1, of the second, the frame's other unknowns being integrated out.

    What a frame tells less of than the prior (`prior_sd` (n,)) is left out: it depends on how the beam is bent at rest
    and on the other component, which first order does not know, and many frames would make it sure.
    """
    known = np.flatnonzero(np.isfinite(load).all(axis=1))
    chunks = [known[i : i + CHUNK] for i in range(0, len(known), CHUNK)]
    parts = [_linear(bench, frames[rows], load[rows], place[rows], prior_sd, seek_place, which) for rows in chunks]
    count, ways, time = len(frames), bench.root.shape[1], bench.observations.time[frames]
    weigh, told, common = np.zeros((count, 2, 2)), np.zeros((count, 2)), np.zeros((count, 2, ways))
    if not parts:
        return FrameForces(time, weigh, told, common, 1.0)
    one = _Linear(*(np.concatenate(each) for each in zip(*(vars(part).values() for part in parts), strict=True)))
    one = _without_other(one)
    side, size, _ = np.linalg.svd(one.by_force, full_matrices=False)
    across = np.swapaxes(side, 1, 2)
    left = one.residual - apply(side, apply(across, one.residual))
    widened = _memory(left, one.measured, 2 + one.other.shape[1])
    side = np.where((prior_sd[2 * which] * size > 1.0)[..., None], across / np.sqrt(widened), 0.0)
    weigh[known] = side @ one.by_force
    told[known] = apply(side, one.residual) + apply(weigh[known], load[known, 2 * which : 2 * which + 2])
    common[known] = side @ one.by_shared
    return FrameForces(time, weigh, told, common, widened)


def _linear(
    bench: Bench, frames: IntArray, load: Array, place: Array, prior_sd: Array, seek_place: bool, which: int
) -> _Linear:
    o = bench.observations
    seen = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    whiten = whitening(seen, o.covariance[frames])
    problem = (problem_apart if seek_place else problem_of)(bench, frames, place)
    solved = solve(bench, problem, load, place, None)
    tags = tags_of(bench, frames, solved, load, place)
    stands = solved.converged

    def flat(of_tags: Array) -> Array:
        out = (whiten @ np.where(stands[:, None, None, None], of_tags, 0.0)).reshape(len(frames), -1, of_tags.shape[-1])
        return np.asarray(out)

    residual = flat(np.nan_to_num(seen - tags.pose)[..., None])[..., 0]
    sd, mean = with_place(prior_sd, seek_place)
    own, by_own = load, tags.by_load
    if seek_place:
        own, by_own = np.column_stack([load, place]), np.concatenate([by_own, o.length * tags.by_place], axis=-1)
    this = np.isin(np.arange(len(sd)), [2 * which, 2 * which + 1])
    measured = (np.any(whiten != 0.0, axis=-1) & stands[:, None, None]).reshape(len(frames), -1)
    other = ((own - mean) / sd)[:, ~this]
    by_own, by_shared = flat(by_own), flat(tags.by_shared @ bench.root)
    return _Linear(residual, by_own[..., this], (by_own * sd)[..., ~this], other, by_shared, measured)


def _without_other(one: _Linear) -> _Linear:
    """With each frame's other unknowns integrated out: their prior is noise."""
    if not one.other.shape[1]:
        return one
    residual = one.residual + apply(one.by_other, one.other)
    side, size, _ = np.linalg.svd(one.by_other, full_matrices=False)
    less = 1.0 - 1.0 / np.sqrt(1.0 + size**2)  # (I + W W^T)^(-1/2) = I - U less U^T

    def without(values: Array) -> Array:
        return np.asarray(values - side @ (less[..., None] * (np.swapaxes(side, 1, 2) @ values)))

    return replace(
        one,
        residual=without(residual[..., None])[..., 0],
        by_force=without(one.by_force),
        by_shared=without(one.by_shared),
    )


def _memory(left: Array, measured: BoolArray, unknowns: int) -> float:
    """Variance of the mean of many frames over that of as many with white noise as stated; 1 or more.

    From what is `left` (F, 3 m) of the tags beside each frame's `unknowns`: half the mean square of its differences
    over `n` frames is `V (1 - rho_n)`.
    """
    if len(left) < _FEWEST:
        return 1.0
    numbers = measured.sum(axis=1)
    free = np.maximum(numbers - float(unknowns), 0.0) / np.maximum(numbers, 1)
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
