"""Limits on the rates of forces and of the gripper, and the time that a path needs to keep them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from onebend.errors import ControlError
from onebend.records import Array

_SLACK = 1.002  # a little slower than the limit asks, so that sampling anew does not break it again


@dataclass(frozen=True)
class RateLimits:
    """The largest rates; infinite where there is no limit."""

    force: float = np.inf  # N/s, of each push
    speed: float = np.inf  # m/s, of the gripper
    turning: float = np.inf  # rad/s, of the gripper

    def __post_init__(self) -> None:
        if not min(self.force, self.speed, self.turning) > 0.0:
            got = f"{self.force:g} N/s, {self.speed:g} m/s, {self.turning:g} rad/s"
            raise ControlError(f"limits on rates must be positive, got {got}")


@dataclass(frozen=True)
class LimitedQuantities:
    """Quantities at T moments of a path, each with the limit on its rate."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[Array, ...]  # each (T, d)
    most: tuple[float, ...]  # per second

    def excess(self, time: Array) -> Array:
        """(T - 1, n) rate over limit between one moment and the next."""
        step = np.diff(time)
        rates = [np.linalg.norm(np.diff(quantity, axis=0), axis=1) / step for quantity in self.values]
        return np.stack([rate / most for rate, most in zip(rates, self.most, strict=True)], axis=1)


def refuse(moving: LimitedQuantities, time: Array) -> None:
    """Raise `ControlError` with the first moment at which a limit is broken, and by how much."""
    excess = moving.excess(time)
    broken = np.flatnonzero(np.any(excess > 1.0 + 1e-9, axis=1))
    if broken.size:
        i = int(broken[0])
        j = int(np.argmax(excess[i]))
        raise ControlError(
            f"at {time[i]:.4g} s the rate of {moving.names[j]} is {excess[i, j] * moving.most[j]:.4g} "
            f"{moving.units[j]}, its limit {moving.most[j]:.4g}; the worst is {np.max(excess):.3g} times the limit. "
            "Give the path more time, or let it be stretched"
        )


def stretched(moving: LimitedQuantities, time: Array, smooth: int = 5) -> Array:
    """(T,) the moments moved apart where a limit is broken, and only there.

    The largest excess over `smooth` neighbours counts, so that finer moments in between keep the limits as well.
    """
    excess = np.max(moving.excess(time), axis=1)
    slower = np.where(excess > 1.0, _SLACK * excess, 1.0)
    slower = maximum_filter1d(slower, smooth, mode="nearest")
    return np.append(time[0], time[0] + np.cumsum(np.diff(time) * slower))
