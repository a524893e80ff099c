"""Which frames of a recording can be learned from, and what acts on the beam in them."""

from __future__ import annotations

import numpy as np

from onebend.beam.loads import Loads, push, weight
from onebend.errors import LearningError
from onebend.records import Array, BoolArray, Observations


def usable_frames(observations: Observations) -> BoolArray:
    """(T,) frames under load whose force is known and that show at least one tag."""
    seen = np.any(np.all(np.isfinite(observations.xy), axis=-1), axis=1)
    forced = np.all(np.isfinite(observations.force), axis=1) & np.isfinite(push_places(observations))
    weighed = np.any(observations.gravity != 0.0, axis=1)
    return np.asarray(seen & forced & (observations.loaded | weighed))


def push_places(observations: Observations) -> Array:
    """(T,) where the force acts; the tip in frames without any force, where the place does not matter."""
    forceless = np.all(observations.force == 0.0, axis=1)
    return np.where(forceless & np.isnan(observations.push_s), 1.0, observations.push_s)


def loads_of(observations: Observations, frames: BoolArray) -> Loads:
    """The measured loads in those frames. Raises `LearningError` where the weight counts and no mass is given."""
    gravity = observations.gravity[frames]
    loads = push(observations.force[frames], push_places(observations)[frames])
    if np.any(gravity != 0.0):
        if not np.isfinite(observations.mass):
            raise LearningError(f"{observations.name}: gravity acts in the plane, so beam.mass_kg must be given")
        loads = loads + weight(gravity)
    return loads
