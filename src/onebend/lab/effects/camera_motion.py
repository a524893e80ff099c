"""A camera that does not stand still: a tripod that shakes in a band of frequencies, and drifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.lab.effects.real_bench import RealBench
from onebend.records import Array

WAVES = 24  # of a shake, on each axis


@dataclass(frozen=True)
class CameraMotion:
    """Shift of the picture: waves of one amplitude, and a drift that is even in time. Without waves it stands still."""

    frequency: Array  # (W, 2) Hz
    phase: Array  # (W, 2) rad
    amplitude: float  # px, of each wave
    rate: Array  # (2,) px/s

    @property
    def still(self) -> bool:
        """Whether it does not move."""
        return self.amplitude == 0.0 and not np.any(self.rate)

    def shift(self, time: Array) -> Array:
        """(T, 2) px at `time` (T,) [s], from where the camera stood at 0 s but for the shake."""
        waves = np.sin(2.0 * np.pi * time[:, None, None] * self.frequency + self.phase)
        return np.asarray(self.amplitude * waves.sum(axis=1) + time[:, None] * self.rate)


def camera_motion(effects: RealBench, until: float, rng: np.random.Generator) -> CameraMotion:
    """A motion of the sizes of `effects` over a film of `until` [s]; its direction and its waves are drawn."""
    low, high = effects.shake_band
    turn = rng.uniform(0.0, 2.0 * np.pi)
    return CameraMotion(
        frequency=rng.uniform(low, high, (WAVES, 2)),
        phase=rng.uniform(0.0, 2.0 * np.pi, (WAVES, 2)),
        amplitude=effects.shake * float(np.sqrt(2.0 / WAVES)),
        rate=effects.drift / until * np.array([np.cos(turn), np.sin(turn)]),
    )
