"""The fastest integral that keeps its margins, for the model's k(s) and for k(s) softer and stiffer by what is allowed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.control.margins import ComplexArray, Gains, Loop, Timing, frequencies
from onebend.control.plant import Plant
from onebend.records import Array

_CORNERS = np.geomspace(1.0, 100.0, 13)  # rad/s, of the filter
_RATES = np.geomspace(20.0, 0.02, 140)  # 1/s, fastest first


@dataclass(frozen=True)
class Wanted:
    """The margins that a loop must have at every stiffness it may meet."""

    gain: float = 2.0  # factor
    phase: float = np.deg2rad(45.0)  # rad
    k_error: float = 0.3  # share by which all of k(s) may be wrong, either way


def tuned(plants: list[tuple[Plant, Array]], timing: Timing, wanted: Wanted) -> Gains:
    """Gains for plants, each with the map (2, 2) [N/m] from error to force that is used there.

    For each corner the largest rate whose loci keep the margins, taken from the loci at rate 1; then the corner that
    allows the largest rate.
    """
    best = Gains(float(_RATES[-1]), float(_CORNERS[0]))
    grid = frequencies(timing)
    for corner in _CORNERS:
        curves = [
            Loop(plant.stiffer(factor), inverse, Gains(1.0, float(corner)), timing).loci(grid)
            for plant, inverse in plants
            for factor in (1.0 - wanted.k_error, 1.0, 1.0 + wanted.k_error)
        ]
        rate = next((r for r in _RATES if all(_keeps(r * curve, wanted) for curve in curves)), 0.0)
        if rate > best.rate:
            best = Gains(float(rate), float(corner))
    return best


def slower(gains: Gains, share: float) -> Gains:
    """The same filter, the integral at `share` of its rate."""
    return replace(gains, rate=share * gains.rate)


def _keeps(loci: ComplexArray, wanted: Wanted) -> bool:
    """Whether loci (R, 2) that start at -90 degrees keep away from -1: no longer than 1/gain beyond the phase margin.

    Stricter than the two margins apart: between the crossings, too, a locus as long as 1/gain stays out of the sector.
    """
    long = np.abs(loci) > 1.0 / wanted.gain
    behind = np.unwrap(np.angle(loci), axis=0) < -np.pi + wanted.phase
    return not bool(np.any(long & behind))
