"""The forces of all frames of a recording: some frames together first, which tell what all share, then the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from onebend.learning.model.frames import moved_by
from onebend.learning.sensing.bench import Bench
from onebend.learning.sensing.estimate import Estimates, estimate
from onebend.learning.sensing.joint import Misfit, together
from onebend.records import Array, BoolArray, IntArray

LEVEL = 0.95
TOUCH = float(chi2.ppf(LEVEL, 2))
_TOGETHER = 24  # frames that are taken together: so far apart that the tags' errors are each one's own
MOVED = 0.2  # of the largest displacement of the tags: frames that move less tell the bench nothing
_ODD = 5.0  # times the usual squared residual: such a frame has a wrong tag, and tells the bench nothing either
_SCAN = np.linspace(0.2, 1.0, 9)  # places where the search for the contact begins
_AS_WELL = float(chi2.ppf(LEVEL, 1))  # of the objective: two places explain a frame about as well
_APART = 0.1  # of the beam: closer places are one


@dataclass(frozen=True)
class Searched:
    """Forces of F frames, and the bench as the frames together show it."""

    bench: Bench
    found: Estimates
    other_place: Array  # (F,) s that explains a frame about as well; NaN where there is none
    misfit: Misfit | None  # None: no frame shows a force


def search(bench: Bench, frames: IntArray, place: Array | None, prior_sd: Array) -> Searched:
    """Of `frames` (F,), rising; `place` (F,) where the force acts, None: it is sought."""
    some = _together(bench, frames)
    begin, other = first(bench, frames[some], None if place is None else place[some], prior_sd)
    good = touches(begin) & (begin.chi2 < _ODD * max(float(np.nanmedian(begin.chi2)), 1.0))
    if not good.any():
        found, other = first(bench, frames, place, prior_sd)
        return Searched(bench, found, other, None)
    some, other = some[good], other[good]
    shown, joint, fit = together(bench, frames[some], begin.take(good), prior_sd, seek_place=place is None)
    rest = np.setdiff1d(np.arange(len(frames)), some)
    if not rest.size:
        return Searched(shown, joint, other, fit)
    near = np.argmin(np.abs(rest[:, None] - some), axis=1)
    if place is None:
        left = estimate(
            shown, frames[rest], joint.place[near], prior_sd, seek_place=True, force=joint.force[near], restarts=1
        )
    else:
        left = estimate(shown, frames[rest], place[rest], prior_sd, seek_place=False)
    order = np.argsort(np.concatenate([some, rest]))
    others = np.concatenate([other, other[near]])[order]
    return Searched(shown, joint.then(left).take(order), others, fit)


def touches(found: Estimates) -> BoolArray:
    """(F,) whether no load at all lies outside the 95 % region."""
    n = found.force.shape[1]
    known: BoolArray = np.asarray(np.isfinite(found.force).all(axis=1))
    out: BoolArray = np.zeros(len(known), dtype=np.bool_)
    solved = np.linalg.solve(found.covariance[known, :n, :n], found.force[known][..., None])[..., 0]
    out[known] = np.einsum("tc,tc->t", found.force[known], solved) > chi2.ppf(LEVEL, n)
    return out


def _together(bench: Bench, frames: IntArray) -> IntArray:
    """Which of the frames tell the bench: evenly spread among those in which the tags moved."""
    moved = np.nan_to_num(moved_by(bench.observations)[frames])
    rows = np.flatnonzero(moved >= MOVED * np.max(moved))
    return np.asarray(rows[np.linspace(0, len(rows) - 1, min(_TOGETHER, len(rows))).astype(int)])


def first(bench: Bench, frames: IntArray, place: Array | None, prior_sd: Array) -> tuple[Estimates, Array]:
    """Each frame by itself, and another place that does about as well."""
    if place is not None:
        return estimate(bench, frames, place, prior_sd, seek_place=False), np.full(len(frames), np.nan)
    return _at_unknown_place(bench, frames, prior_sd)


def _at_unknown_place(bench: Bench, frames: IntArray, prior_sd: Array) -> tuple[Estimates, Array]:
    """From the place of a scan that explains a frame best; and (F,) another that does about as well, NaN: none."""
    scan = [estimate(bench, frames, np.full(len(frames), s), prior_sd, seek_place=False, restarts=0) for s in _SCAN]
    objective = np.stack([one.objective for one in scan])  # (places, F)
    best, every = np.argmin(objective, axis=0), np.arange(len(frames))
    force = np.nan_to_num(np.stack([one.force for one in scan])[best, every])
    found = estimate(bench, frames, _SCAN[best], prior_sd, seek_place=True, force=force)
    padded = np.pad(objective, ((1, 1), (0, 0)), constant_values=np.inf)
    valley = (objective <= padded[:-2]) & (objective <= padded[2:])
    far = np.abs(_SCAN[:, None] - found.place) > np.maximum(_APART, 2.0 * np.sqrt(found.covariance[:, -1, -1]))
    rivals = np.where(valley & far, objective, np.inf)
    second = np.argmin(rivals, axis=0)
    as_well = rivals[second, every] < found.objective + _AS_WELL
    return found, np.where(as_well, _SCAN[second], np.nan)
