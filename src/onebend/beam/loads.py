"""Loads on a beam, batched over frames: point forces and moments at any s, and weight.

Forces keep their direction in the beam's frame. Make loads with `push`, `twist` and `weight`, and add them with `+`.
Forces act ON the beam.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Loads:
    """Loads for T equilibria; arrays lead with T, or with 1 if equal in all frames."""

    force: Array = field(default_factory=partial(np.zeros, (1, 0, 2)))  # (T, a, 2) N, beam's frame
    force_s: Array = field(default_factory=partial(np.zeros, (1, 0)))  # (T, a)
    moment: Array = field(default_factory=partial(np.zeros, (1, 0)))  # (T, b) N m about z
    moment_s: Array = field(default_factory=partial(np.zeros, (1, 0)))  # (T, b)
    gravity: Array = field(default_factory=partial(np.zeros, (1, 2)))  # (T, 2) m/s^2 in the beam's frame

    def __post_init__(self) -> None:
        for item in fields(self):
            values = getattr(self, item.name)
            if values.size == 0:
                continue
            if not np.all(np.isfinite(values)):
                raise MechanicsError(f"{item.name} must be finite numbers; leave out the frames where it is unknown")
            outside = ~((values >= 0.0) & (values <= 1.0))
            if item.name.endswith("_s") and np.any(outside):
                raise MechanicsError(f"loads act at s in [0, 1]; {item.name} holds {values[outside][0]}")

    @cached_property
    def size(self) -> int:
        """T."""
        return max(len(getattr(self, item.name)) for item in fields(self))

    @cached_property
    def places(self) -> Array:
        """(T, a + b) places of all loads."""
        full = self.spread(self.size)
        return np.concatenate([full.force_s, full.moment_s], axis=1)

    def __add__(self, other: Loads) -> Loads:
        size = max(self.size, other.size)
        a, b = self.spread(size), other.spread(size)
        joined = {
            item.name: np.concatenate([getattr(a, item.name), getattr(b, item.name)], axis=1)
            for item in fields(self)
            if item.name != "gravity"
        }
        return Loads(**joined, gravity=a.gravity + b.gravity)

    def spread(self, size: int) -> Loads:
        """The loads with batch axes of length `size`."""

        def spread(x: Array) -> Array:
            if x.shape[0] not in (1, size):
                raise MechanicsError(f"loads for {x.shape[0]} frames do not fit {size} frames")
            return np.broadcast_to(x, (size, *x.shape[1:]))

        if all(len(getattr(self, item.name)) == size for item in fields(self)):
            return self
        return Loads(**{item.name: spread(getattr(self, item.name)) for item in fields(self)})

    def take(self, chosen: IntArray | BoolArray | slice) -> Loads:
        full = self.spread(self.size)
        return Loads(**{item.name: getattr(full, item.name)[chosen] for item in fields(self)})


def push(force: ArrayLike, at_s: ArrayLike = 1.0) -> Loads:
    """A point force: (2,) or (T, 2) N at `at_s`, a number or (T,)."""
    f = np.atleast_2d(np.asarray(force, dtype=float))
    if f.shape[-1] != 2 or f.ndim != 2:
        raise MechanicsError(f"a force has two components, got an array of shape {np.shape(force)}")
    s = np.broadcast_to(np.asarray(at_s, dtype=float), f.shape[:1])
    return Loads(force=f[:, None, :], force_s=s[:, None])


def twist(moment: ArrayLike, at_s: ArrayLike = 1.0) -> Loads:
    """A point moment about z: a number or (T,) N m."""
    m = np.atleast_1d(np.asarray(moment, dtype=float))
    s = np.broadcast_to(np.asarray(at_s, dtype=float), m.shape)
    return Loads(moment=m[:, None], moment_s=s[:, None])


def weight(gravity: ArrayLike) -> Loads:
    """The beam's weight under gravity (2,) or (T, 2) m/s^2 in the beam's frame."""
    return Loads(gravity=np.atleast_2d(np.asarray(gravity, dtype=float)))
