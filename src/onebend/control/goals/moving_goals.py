"""Goals that move: the same targets at one time after another, and smoothly in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, make_interp_spline

from onebend.control.goals.targets import Targets
from onebend.errors import ControlError
from onebend.records import Array

Between = Literal["smooth", "monotone", "linear"]


@dataclass(frozen=True)
class Goals:
    """Targets at N places whose values change over K times.

    `between`: "smooth" is a cubic spline (velocity and acceleration without jumps, the path may swing a little beyond
    its goals); "monotone" does not swing beyond (acceleration jumps at the goals); "linear" goes straight from goal to
    goal (velocity jumps). Only goals that slow down at the ends begin and end at rest.
    """

    time: Array  # (K,) s, rising
    targets: Targets  # places, weights, and what is wanted at the first time
    xy: Array  # (K, N, 2) m; NaN where of no concern, at all times alike
    angle: Array  # (K, N) rad
    between: Between = "smooth"

    def __post_init__(self) -> None:
        count, places = len(self.time), len(self.targets.s)
        if count < 2 or self.xy.shape != (count, places, 2) or self.angle.shape != (count, places):
            raise ControlError(f"a path needs two or more times with values for each of its {places} places")
        if not np.all(np.isfinite(self.time)) or not np.all(np.diff(self.time) > 0.0):
            at = int(np.argmin(np.diff(self.time))) + 1
            raise ControlError(f"the times of a path must rise; time {at + 1} is {self.time[at]:g} s")
        if np.any(np.isinf(self.xy)) or np.any(np.isinf(self.angle)):
            raise ControlError("positions and angles along a path must be finite, or NaN where of no concern")
        same = np.all(np.isfinite(self.xy) == self.targets.placed[:, None], axis=(1, 2))
        same &= np.all(np.isfinite(self.angle) == self.targets.turned, axis=1)
        if not np.all(same):
            raise ControlError(
                f"at {self.time[np.argmin(same)]:g} s other things are wanted than at the start; "
                "every place needs its position, or its angle, at all times or at none"
            )

    def along(self, time: Array) -> tuple[Array, Array]:
        """xy (T, N, 2) m and angle (T, N) rad at times (T,) s within the path's."""
        flat = np.concatenate([self.xy.reshape(len(self.time), -1), self.angle], axis=1)
        known = np.isfinite(flat[0])
        out = np.full((len(time), flat.shape[1]), np.nan)
        out[:, known] = _curve(self.time, flat[:, known], self.between)(np.clip(time, self.time[0], self.time[-1]))
        split = self.xy.shape[1] * 2
        return out[:, :split].reshape(len(time), -1, 2), out[:, split:]

    def at(self, time: float) -> Targets:
        """What is wanted at one time."""
        xy, angle = self.along(np.array([time]))
        return replace(self.targets, xy=xy[0], angle=angle[0])


def point_goals(time: ArrayLike, xy: ArrayLike, *, point_s: float = 1.0, between: Between = "smooth") -> Goals:
    """One point of the beam, at `point_s`, wanted at xy (K, 2) m at times (K,) s."""
    times, wanted = np.asarray(time, dtype=float), np.asarray(xy, dtype=float)
    if times.ndim != 1 or wanted.shape != (len(times), 2):
        raise ControlError(f"{len(times)} times need positions ({len(times)}, 2), got {wanted.shape}")
    first = Targets(np.array([point_s]), wanted[:1], np.array([np.nan]), np.ones(1))
    return Goals(times, first, wanted[:, None], np.full((len(times), 1), np.nan), between)


def _curve(time: Array, values: Array, between: Between) -> Callable[[Array], Array]:
    """The values (K, c) as functions of time; a spline through fewer than four goals is of a lower degree."""
    if between == "monotone":
        return PchipInterpolator(time, values)  # type: ignore[no-any-return]
    return make_interp_spline(time, values, k=min(3, len(time) - 1) if between == "smooth" else 1)  # type: ignore[no-any-return]
