"""What the model is given: log k(s) of every recording with its covariance, its object, and the object's group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.records import Array, IntArray

JITTER = 1e-4  # sd of log k that a fit leaves at each place by itself: a hundredth of a percent


@dataclass(frozen=True)
class PopulationTrial:
    """R recordings of O objects in G groups, at S places."""

    s: Array  # (S,)
    log_k: Array  # (R, S) log(N m)
    covariance: Array  # (R, S, S) of a recording's fit, what it shares with others apart
    object_of: IntArray  # (R,) number of its object
    group_of: IntArray  # (O,) number of its group
    alike: Array  # (G, S, S) of what all fits of a group are off by alike, as by their prior
    common_sd: float = 0.0  # of log k: an error that all recordings share, as of the force sensor's scale

    @property
    def objects(self) -> int:
        """How many objects there are."""
        return len(self.group_of)

    @property
    def groups(self) -> int:
        """How many groups there are."""
        return int(self.group_of.max()) + 1

    @property
    def repeated(self) -> bool:
        """Whether any object was recorded more than once."""
        return len(self.object_of) > self.objects

    @property
    def noise(self) -> Array:
        """(R, S, S) the covariance, with a little at each place by itself, so that it has an inverse."""
        return np.asarray(self.covariance + JITTER**2 * np.eye(len(self.s)))
