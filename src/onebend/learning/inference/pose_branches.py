"""The maximum where static poses may be in one of several equilibria: each in that which its points show.

While k(s) is far from what it will be, the equilibrium that a pose is in may not exist yet: no stable one is near its
points. Such poses wait; what fits the others brings theirs about. At every maximum all poses choose anew, until none
changes. A pose that is then still far from every stable equilibrium is left out of the fit, and named.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.inference.descent import MapEstimate
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.optimizer import OptimizerSettings, find_maximum
from onebend.learning.model.fit_data import FitData, fit_data
from onebend.learning.model.forward import Prediction, predict
from onebend.learning.pose_equilibria import pose_rms, unexplained
from onebend.progress import Progress, Silent
from onebend.records import BoolArray

_ROUNDS = 6  # of choosing, at most
_SAME = 1e-3  # of the length: poses whose tags are nearer are in one equilibrium


def find_on_branches(
    problem: FitProblem, estimate: MapEstimate, settings: OptimizerSettings, progress: Progress
) -> tuple[FitProblem, MapEstimate]:
    """The maximum a posteriori from an estimate to begin with, and the problem without the poses that were left out."""
    if all(recording.poses is None for recording in problem.recordings):
        return problem, find_maximum(problem, estimate, settings, progress)
    kept = [_explained(one) for one in estimate.predictions]
    for _ in range(_ROUNDS):
        begin = tuple(map(_part, estimate.predictions, kept))
        some = replace(problem, recordings=tuple(one.recording for one in begin))
        found = find_maximum(some, replace(estimate, predictions=begin, converged=False), settings, progress)
        again = tuple(map(_chosen_anew, problem.recordings, kept, found.predictions))
        estimate = replace(found, predictions=again)
        before, kept = kept, [_explained(one) for one in again]
        if all(map(_same, before, kept, found.predictions, again)):
            break
        progress = Silent()
    return some, found


def _part(every: Prediction, kept: BoolArray) -> Prediction:
    """Some frames (F,) of a recording of poses."""
    if np.all(kept):
        return every
    o, chosen = every.recording.observations, every.recording.frames.copy()
    chosen[np.flatnonzero(chosen)[~kept]] = False
    part = fit_data(o, every.recording.number, chosen, every.layout.spline)
    return predict(part, every.layout, every.x, None, every.own[kept])


def _chosen_anew(recording: FitData, kept: BoolArray, now: Prediction) -> Prediction:
    """Every pose in the equilibrium that its points show now; a film as it is."""
    if recording.poses is None:
        return now
    own = np.zeros_like(recording.force)
    own[kept] = now.own
    return predict(recording, now.layout, now.x, None, own)


def _explained(prediction: Prediction) -> BoolArray:
    """(F,) frames; of a film all."""
    recording = prediction.recording
    off = (recording.measured - prediction.pose)[..., :2]
    if recording.poses is None or len(off) == 1:
        return np.ones(len(off), dtype=bool)
    return ~unexplained(np.where(_is_free(recording), pose_rms(off), 0.0), recording.observations.length)


def _same(before: BoolArray, now: BoolArray, found: Prediction, again: Prediction) -> bool:
    """Whether no pose of a recording has changed, nor its equilibrium."""
    if not np.array_equal(before, now):
        return False
    change = np.abs(found.pose - again.pose[before])[_is_free(again.recording)[before], :, :2]
    return bool(np.max(change, initial=0.0) < _SAME * again.recording.observations.length)


def _is_free(recording: FitData) -> BoolArray:
    """(F,) frames whose end nobody holds."""
    free = np.ones(len(recording.measured), dtype=bool)
    if recording.ends is not None:
        free[recording.ends.frames] = False
    return free
