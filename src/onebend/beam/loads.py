"""What may act on a beam: point forces and moments at any s, and weight. Batched over frames."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from onebend.errors import MechanicsError
from onebend.records import Array


@dataclass(frozen=True)
class Loads:
    """Dead loads on a beam, for a batch of T equilibria. A force is positive when it acts ON the beam.

    Make one with `push` or `Loads.none` and add others with `+`.
    """

    force: Array  # (T, a, 2) N, beam's frame
    force_s: Array  # (T, a) where each force acts
    moment: Array = field(default_factory=lambda: np.zeros((1, 0)))  # (T, b) N m about z
    moment_s: Array = field(default_factory=lambda: np.zeros((1, 0)))  # (T, b)
    gravity: Array = field(default_factory=lambda: np.zeros((1, 2)))  # (T, 2) m/s^2 in the beam's frame

    def __post_init__(self) -> None:
        for name, places in (("force_s", self.force_s), ("moment_s", self.moment_s)):
            if np.any(~((places >= 0.0) & (places <= 1.0))):
                raise MechanicsError(
                    f"loads act at s in [0, 1]; {name} holds {places[~((places >= 0) & (places <= 1))][0]}"
                )
        for name, values in (("force", self.force), ("moment", self.moment), ("gravity", self.gravity)):
            if not np.all(np.isfinite(values)):
                raise MechanicsError(f"{name} must be finite numbers; leave out the frames where it is unknown")

    @property
    def size(self) -> int:
        """T, the number of equilibria asked for."""
        return max(len(self.force), len(self.moment), len(self.gravity))

    def __add__(self, other: Loads) -> Loads:
        """Both loads together, in the same frames."""
        size = max(self.size, other.size)
        a, b = self.spread(size), other.spread(size)
        return Loads(
            force=np.concatenate([a.force, b.force], axis=1),
            force_s=np.concatenate([a.force_s, b.force_s], axis=1),
            moment=np.concatenate([a.moment, b.moment], axis=1),
            moment_s=np.concatenate([a.moment_s, b.moment_s], axis=1),
            gravity=a.gravity + b.gravity,
        )

    def spread(self, size: int) -> Loads:
        """The same loads with every batch axis `size` long."""

        def spread(x: Array) -> Array:
            if x.shape[0] not in (1, size):
                raise MechanicsError(f"loads for {x.shape[0]} frames do not fit {size} frames")
            return np.broadcast_to(x, (size, *x.shape[1:]))

        return Loads(*(spread(x) for x in (self.force, self.force_s, self.moment, self.moment_s, self.gravity)))

    def take(self, chosen: Array | slice) -> Loads:
        """The loads of some frames of the batch."""
        full = self.spread(self.size)
        parts = (full.force, full.force_s, full.moment, full.moment_s, full.gravity)
        return Loads(*(x[chosen] for x in parts))


def push(force: ArrayLike, at_s: ArrayLike = 1.0) -> Loads:
    """One point force: (2,) or (T, 2) N at one place or (T,) places."""
    f = np.atleast_2d(np.asarray(force, dtype=float))
    if f.shape[-1] != 2 or f.ndim != 2:
        raise MechanicsError(f"a force has two components, got an array of shape {np.shape(force)}")
    s = np.broadcast_to(np.asarray(at_s, dtype=float), f.shape[:1])
    return Loads(force=f[:, None, :], force_s=s[:, None])


def twist(moment: ArrayLike, at_s: ArrayLike = 1.0) -> Loads:
    """One point moment about z: a number or (T,) N m, at one place or (T,) places."""
    m = np.atleast_1d(np.asarray(moment, dtype=float))
    s = np.broadcast_to(np.asarray(at_s, dtype=float), m.shape)
    return Loads(np.zeros((1, 0, 2)), np.zeros((1, 0)), moment=m[:, None], moment_s=s[:, None])


def weight(gravity: ArrayLike) -> Loads:
    """The beam's own weight under gravity (2,) or (T, 2) m/s^2, in the beam's frame."""
    return Loads(np.zeros((1, 0, 2)), np.zeros((1, 0)), gravity=np.atleast_2d(np.asarray(gravity, dtype=float)))
