"""The spread of a path that follows from the band on k(s), to first order; the actuators do as commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.control.path.follow import FollowedPath
from onebend.control.shape.actuators import BeamState
from onebend.control.shape.spread import spread
from onebend.records import Array

_MOMENTS = 25


@dataclass(frozen=True)
class PathSpread:
    """Standard deviations at M moments of a path."""

    time: Array  # (M,) s
    rms: Array  # (M,) m: of the targets' places, root of the mean square over them


@one_blas_thread
def path_spread(way: FollowedPath, uncertain: UncertainStiffness, *, moments: int = _MOMENTS) -> PathSpread:
    """The spread of a path at up to `moments` of its samples, evenly spaced, the first and the last among them."""
    chosen = np.unique(np.round(np.linspace(0, len(way.time) - 1, moments)).astype(int))
    stands = [BeamState(way.actuators, way.q[i], way.u[i]) for i in chosen]
    return PathSpread(
        way.time[chosen], np.array([spread(state, way.goals.targets.s, uncertain).rms for state in stands])
    )
