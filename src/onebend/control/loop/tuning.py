"""The fastest integral gain that keeps the margins for the model's k(s), and for k(s) softer and stiffer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.control.loop.margins import ComplexArray, Gains, SampledLoop, Timing, frequencies
from onebend.control.loop.plant import Plant
from onebend.errors import ControlError
from onebend.records import Array

_CORNERS = np.geomspace(1.0, 100.0, 13)  # rad/s, of the filter
_FASTEST, _SLOWEST = 20.0, 0.02  # 1/s, rates of the integral


@dataclass(frozen=True)
class RequiredMargins:
    """The margins that a loop must have at every stiffness it may meet."""

    gain: float = 2.0  # factor
    phase: float = np.deg2rad(40.0)  # rad
    k_error: float = 0.3  # share by which all of k(s) may be wrong, either way

    def __post_init__(self) -> None:
        if not (self.gain > 1.0 and 0.0 < self.phase < 0.5 * np.pi and 0.0 <= self.k_error < 1.0):
            raise ControlError(
                "wanted margins are a gain above 1, a phase between 0 and a right angle, and an error of k below 1, "
                f"got {self.gain:g}, {np.rad2deg(self.phase):g} deg and {self.k_error:g}"
            )


def tuned(plants: list[tuple[Plant, Array]], timing: Timing, wanted: RequiredMargins) -> Gains:
    """Gains for plants, each with the map (2, 2) [N/m] from error to force that is used there.

    For each corner the largest rate whose loci keep the margins, taken from the loci at rate 1; then the corner that
    allows the largest rate.
    """
    best = Gains(_SLOWEST, float(_CORNERS[0]))
    grid = frequencies(timing)
    for corner in _CORNERS:
        rate = min(
            _largest(SampledLoop(plant.stiffer(factor), inverse, Gains(1.0, float(corner)), timing).loci(grid), wanted)
            for plant, inverse in plants
            for factor in (1.0 - wanted.k_error, 1.0, 1.0 + wanted.k_error)
        )
        if rate > best.rate:
            best = Gains(rate, float(corner))
    return best


def _largest(loci: ComplexArray, wanted: RequiredMargins) -> float:
    """The largest factor on loci (R, 2) that begin at -90 degrees and keep both margins, at every resonance too."""
    lag, size = -np.unwrap(np.angle(loci), axis=0), np.abs(loci)
    unit = float(np.max(size, initial=1e-9, where=lag > np.pi - wanted.phase))
    real = float(np.max(size, initial=1e-9, where=lag > np.pi))
    return min(_FASTEST, 1.0 / unit, 1.0 / (wanted.gain * real))
