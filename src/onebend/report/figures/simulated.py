"""Which frames a picture shows, and the beam simulated for them."""

from __future__ import annotations

import numpy as np

from onebend.beam.model import Beam
from onebend.errors import MechanicsError
from onebend.learning.outcome import Comparison
from onebend.learning.validation import solved_frames
from onebend.recording.kept_frames import roundest
from onebend.records import Array, BoolArray, Observations

LARGE = 0.99  # of the largest force: so large is as good to look at


def largest_push(comparison: Comparison) -> int:
    """Index of the frame with the largest force among those where most markers were seen."""
    return int(np.argmax(_sizes(comparison)))


def push_to_show(comparison: Comparison) -> int:
    """Index of a frame whose force is the same to a percent, and that is likely to be kept."""
    size = _sizes(comparison)
    large = np.flatnonzero(size >= min(LARGE * size.max(), size.max()))
    return int(large[roundest(comparison.frame[large])])


def _sizes(comparison: Comparison) -> Array:
    """(T,) N, of the forces; -1 where not most markers were seen."""
    seen = np.isfinite(comparison.measured[..., 0]).sum(axis=1)
    size = np.linalg.norm(comparison.force, axis=1)
    return np.asarray(np.where((seen == seen.max()) & np.isfinite(size), size, -1.0))


def spread_of_pushes(comparison: Comparison, count: int) -> list[int]:
    """Frames with about 0, 1/(count-1), ..., 1 times the largest force, up to the largest."""
    size = np.nan_to_num(np.linalg.norm(comparison.force, axis=1))
    last = largest_push(comparison)
    rising = size[: last + 1]
    wanted = np.linspace(0.0, size[last], count)
    return sorted({int(np.argmin(np.abs(rising - value))) for value in wanted})


def same_frame(comparison: Comparison, other: Comparison, t: int) -> int:
    """Index in `one` of the frame t of `other`, the nearest where it has not that very frame."""
    return int(np.argmin(np.abs(comparison.time - other.time[t])))


def centreline(
    beam: Beam, comparison: Comparison, observations: Observations, t: int, places: int = 121
) -> Array | None:
    """(places, 2) m, the beam simulated under the measured loads of the comparison's frame t; None if it cannot be."""
    here: BoolArray = np.asarray(observations.frame == comparison.frame[t])
    if not np.any(here):
        return None
    try:
        solved = next(solved_frames(beam, observations, here))
    except MechanicsError:
        return None
    return solved.xy(np.linspace(0.0, 1.0, places))[0] if solved.converged[0] else None
