"""The force on the beam, felt while the loop runs: what is asked of the robot is put right by it.

A robot that is asked for a force gives another one: its own estimate of the force is off, and its hand has friction.
The force felt in a frame is compared with the force that was wanted at the moment it shows, behind two filters as the
position is, at half its rate. Where the camera sees the point, its position alone corrects the force, and how much more
is felt than wanted is remembered. Where it does not, an offset is added to what is asked for, so that as much is felt
as then or, where the point never was seen, as is wanted. With C the covariance of what is felt and `sd^2 I` that of how
far the robot is off, `K = sd^2 (sd^2 I + C)^-1` of the difference is believed.

A force that was told by the model from the beam's shape is the force under which the model has this shape. Where all of
k(s) is wrong by a factor it is wrong by that factor, and so is the force that the model wants for a goal: the beam
still comes to the goal, which with the true force it does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from onebend.control.loop.margins import Gains
from onebend.records import Array

# Of the position's rate and corner: inertia counts as force, in the direction in which little force bends the beam too.
_SLOWER = 0.5
_MOST_OFF = 3.0  # sds: a robot is not farther off than this; what is felt beyond is not the robot


class Felt(Protocol):
    """A force and how exactly it is known, as `learning.sensing.online.LiveForce` has them."""

    @property
    def force(self) -> Array:
        """(2,) N on the beam, in its frame; NaN where nothing is known."""

    @property
    def covariance(self) -> Array:
        """(2, 2) N^2."""


@dataclass(frozen=True)
class FeltForce:
    """A force and how exactly it is known."""

    force: Array  # (2,) N
    covariance: Array  # (2, 2) N^2


@dataclass(frozen=True)
class Offset:
    """What is added to the force that is asked for, and what it goes on from."""

    force: Array = field(default_factory=lambda: np.zeros(2))  # (2,) N
    more: Array = field(default_factory=lambda: np.zeros(2))  # (2,) N felt than wanted, when the point was seen last
    correction: Array = field(default_factory=lambda: np.zeros(2))  # (2,) N, the integral at the moment of exposure
    filtered: Array = field(default_factory=lambda: np.zeros((2, 2)))  # (2, 2) N more, behind the first filter and both
    frame_at: float = 0.0  # s: when the last frame that told a force arrived


@dataclass(frozen=True)
class FeltFrame:
    """A frame that told a force."""

    felt: Felt
    wanted: Array  # (2,) N on the beam at the moment of exposure, by the feedforward
    correction: Array  # (2,) N, the integral of the position now
    seen: bool  # whether it showed the point as well
    time: float  # s, when it arrived
    late: float  # s, from exposure to then


def felt_in(offset: Offset, frame: FeltFrame, gains: Gains, *, fps: float, sd: float) -> Offset:
    """After a frame; `sd` N of how far the robot's force is off."""
    told = np.asarray(frame.felt.force, dtype=float)
    passed = min(frame.time - offset.frame_at, 1.0 / fps)
    if not (passed > 0.0 and np.isfinite(told).all()):
        return offset
    then = frame.correction + np.exp(-passed / max(frame.late, 1e-9)) * (offset.correction - frame.correction)
    keep = np.exp(-_SLOWER * gains.corner * passed)
    once = keep * offset.filtered[0] + (1.0 - keep) * (told - frame.wanted - then)
    twice = keep * offset.filtered[1] + (1.0 - keep) * once
    filtered = np.stack([once, twice])
    if frame.seen:
        return Offset(offset.force, twice, then, filtered, frame.time)
    believed = believed_share(np.asarray(frame.felt.covariance, dtype=float), sd)
    step = believed @ (offset.more - twice) - (np.eye(2) - believed) @ offset.force
    force = offset.force + _SLOWER * gains.rate * passed * step
    size = float(np.linalg.norm(force))
    return Offset(force * min(1.0, _MOST_OFF * sd / max(size, 1e-300)), offset.more, then, filtered, frame.time)


def believed_share(covariance: Array, sd: float) -> Array:
    """(2, 2) of a difference that is believed: `sd^2 (sd^2 I + C)^-1`."""
    return np.asarray(sd**2 * np.linalg.inv(sd**2 * np.eye(2) + covariance))


@dataclass(frozen=True)
class Exposure:
    """What there is to be seen in a frame of a simulated loop."""

    time: float  # s
    force: Array  # (2,) N on the beam
    pose: Callable[[Array], Array]  # of places (m,): (m, 3) m, m, rad, the beam there


class ForceSense(Protocol):
    """What tells a simulated loop the force in a frame."""

    def __call__(self, seen: Exposure) -> Felt | None:
        """None: nothing."""


class LoggedForce:
    """A force sensor: off by `bias` (2,) N, with noise of sd `noise` N; `sd` N is how exactly it is said to be."""

    def __init__(self, bias: Array, *, noise: float = 0.0, sd: float = 0.0, seed: int = 0) -> None:
        self._bias, self._noise, self._rng = np.asarray(bias, dtype=float), noise, np.random.default_rng(seed)
        self._covariance = sd**2 * np.eye(2)

    def __call__(self, seen: Exposure) -> FeltForce:
        """The force of this frame."""
        told = seen.force + self._bias + self._noise * self._rng.standard_normal(2)
        return FeltForce(told, self._covariance)
