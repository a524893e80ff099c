"""What one frequency by itself says: the uniform beam that would swing so, and the mass of a beam that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from onebend.beam.model import Beam
from onebend.beam.motion.frequencies import natural_frequencies
from onebend.beam.profiles.stiffness import Scaled, Uniform
from onebend.learning.model.frames import mass_profile
from onebend.records import MeasuredFrequency, Observations, PointMass

_STIFF = 100.0  # times as stiff as a beam without weight: there weight changes the square of a frequency linearly
_LEAST = 0.05  # of the stiffness without weight: less would be a beam near buckling
_MASSES = (1e-9, 1e3)  # kg, within which one is looked for


def uniform_stiffness(o: Observations, measured: MeasuredFrequency, mode: int, mass: float = np.nan) -> float:
    """N m: k of the uniform beam whose `mode` (from 1) has this frequency, of the recording's mass or of `mass` kg.

    `f^2 = a k + b`, with b from the weight: exact for small weights, else good enough to begin with.
    """
    along, known = mass_profile(o), np.isfinite(mass)
    if not np.isfinite(o.stated.mass):
        along = Uniform((mass if known else 1.0) / o.length)
    elif known:
        along = Scaled(mass / o.stated.mass, along)
    points = [*o.stated.masses, PointMass(1.0, measured.tip_mass)]
    beam = Beam(o.length, Uniform(1.0), mass_per_length=along)
    by_k = float(natural_frequencies(beam, points=points, count=mode)[-1]) ** 2
    light = measured.frequency**2 / by_k
    if not np.any(measured.gravity):
        return light
    weight = float(np.linalg.norm(measured.gravity)) * (_total(beam) + sum(point.mass for point in points))
    stiff = _STIFF * max(light, weight * o.length)
    straight = replace(beam, stiffness=Uniform(stiff))
    found = float(natural_frequencies(straight, gravity=measured.gravity, points=points, count=mode)[-1]) ** 2
    return max(light - (found / by_k - stiff), _LEAST * light)


def _total(beam: Beam) -> float:
    """kg."""
    s = np.linspace(0.0, 1.0, 101)
    return beam.length * float(np.trapezoid(beam.mass_per_length(s), s))


def stiffness_level(recordings: Sequence[Observations]) -> float:
    """N m, median over all frequencies of a beam whose mass is known or guessed, and whose modes are known."""
    each = [uniform_stiffness(o, one, one.mode) for o in recordings for one in o.frequencies]
    return float(np.exp(np.median(np.log(each))))


def swinging_mass(recordings: Sequence[Observations], stiffness: float) -> float:
    """kg, of a uniform beam of this k [N m] that swings as its slowest frequency says; at least a trace."""
    o, slowest = min(
        ((o, one) for o in recordings for one in o.frequencies), key=lambda pair: (pair[1].mode, pair[1].frequency)
    )

    def too_stiff(log_mass: float) -> float:
        return float(np.log(uniform_stiffness(o, slowest, slowest.mode, float(np.exp(log_mass))) / stiffness))

    low, high = np.log(_MASSES)
    if too_stiff(low) >= 0.0:
        return _MASSES[0]
    return float(np.exp(brentq(too_stiff, low, high, xtol=1e-3))) if too_stiff(high) > 0.0 else _MASSES[1]
