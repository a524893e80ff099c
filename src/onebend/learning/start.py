"""Where the marker-space fit begins: its search is local, so the first beam must follow every recording roughly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.model import Beam
from onebend.beam.problem import pose
from onebend.beam.stiffness import Profile, Uniform
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.frames import distances, loads_of, usable_frames
from onebend.learning.outcome import Learned
from onebend.learning.validation import RESOLUTION
from onebend.records import BoolArray, Observations

_FRAMES = 40  # of each recording
_TRIED = np.geomspace(0.05, 200.0, 25)  # k in units of (largest load) x L


@one_blas_thread
def start_of(recordings: Sequence[Observations], learned: Learned | None) -> Profile:
    """The regression's k(s), or the best uniform beam's where that is nearer to the tags of all recordings.

    Raises:
        LearningError: a recording has no usable frame, or weight acts and no mass is given.
    """
    frames = [_some(o) for o in recordings]
    unit = max(_largest_load(o, some) for o, some in zip(recordings, frames, strict=True)) * recordings[0].length
    beams = [Beam(recordings[0].length, Uniform(float(unit * k)), mass_per_length=_mass(recordings)) for k in _TRIED]
    beams += [] if learned is None else [learned.beam]
    distances = [_distance(beam, recordings, frames) for beam in beams]  # infinite where a beam would snap through
    return beams[int(np.argmin(distances))].stiffness  # the stiffest hardly bends: one at least is finite


def _some(o: Observations) -> BoolArray:
    """A few of the usable frames, evenly spread."""
    usable = np.flatnonzero(usable_frames(o))
    if len(usable) == 0:
        raise LearningError(
            f"{o.name}: no frame has a load, a force and a tag, so nothing can be learned from it. Film a push (or a "
            "beam that its weight bends), with the tags in view, and let the force log cover it"
        )
    out = np.zeros(len(o.time), dtype=bool)
    out[usable[np.linspace(0, len(usable) - 1, min(_FRAMES, len(usable))).astype(int)]] = True
    return out


def _distance(beam: Beam, recordings: Sequence[Observations], frames: list[BoolArray]) -> float:
    """Root mean square distance of the beam's places under the tags from the tags; infinite without equilibrium."""
    total, count = 0.0, 0
    for o, some in zip(recordings, frames, strict=True):
        solved = follow(pose(beam, loads_of(o, some), RESOLUTION))
        if not np.all(solved.converged):
            return float("inf")
        squared = distances(o.xy[some] - solved.xy(o.marker_s)) ** 2
        total, count = total + float(np.nansum(squared)), count + int(np.sum(np.isfinite(squared)))
    return float(np.sqrt(total / count))


def _largest_load(o: Observations, some: BoolArray) -> float:
    """N, force and weight of the frames."""
    loads = np.linalg.norm(o.force[some], axis=1)
    if np.any(o.gravity != 0.0):
        loads = loads + np.nan_to_num(o.mass) * np.linalg.norm(o.gravity[some], axis=1)
    return max(float(np.max(loads)), 1e-6)


def _mass(recordings: Sequence[Observations]) -> Uniform:
    known = [o.mass for o in recordings if np.isfinite(o.mass)]
    return Uniform(known[0] / recordings[0].length if known else 0.0)
