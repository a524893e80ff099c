"""Young's modulus from bending stiffness and a measured cross-section: E(s) = k(s) L / I(s).

An error of the sizes enters to first order: `d log I = dw/w + 3 dh/h` of a rectangle, `4 dd/d` of a circle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.profiles.measured_section import mean_moment, second_moment
from onebend.beam.profiles.stiffness import Profile
from onebend.beam.profiles.uncertain import UncertainStiffness, half_width
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, StatedSection

_PLACES = np.linspace(0.0, 1.0, 201)  # s, of a mean along the beam


@dataclass(frozen=True)
class ModulusBand:
    """Young's modulus and how sure it is, at places s (S,); NaN where the section was not measured."""

    s: Array
    modulus: Array  # E, Pa
    low: Array  # Pa; NaN where k(s) has no band
    high: Array  # Pa
    identified: BoolArray  # as of k(s), and the section is known there


@one_blas_thread
def modulus_band(
    stiffness: UncertainStiffness | Profile, length: float, section: StatedSection, s: Array, level: float = 0.95
) -> ModulusBand:
    """Young's modulus of a beam of `length` m between the quantiles that leave out `1 - level`, half on either side.

    The errors of k(s), the force's common scale among them, and of the sizes are independent; where k(s) was learned as
    the section's shape times a modulus they are not, and E is that modulus (`UncertainStiffness.nominal`). Of a k(s)
    without a band E has none, and no place counts as identified.

    Raises:
        MechanicsError: a length or a size that is not positive.
    """
    if not length > 0.0:
        raise MechanicsError(f"a beam's length must be positive, got {length} m")
    s = np.asarray(s, dtype=float)
    moment, sd = second_moment(section, s)
    unknown = np.full(s.shape, np.nan)
    if not isinstance(stiffness, UncertainStiffness):
        return ModulusBand(s, np.asarray(stiffness(s)) * length / moment, unknown, unknown, np.zeros(s.shape, bool))
    if stiffness.nominal is not None:
        stiffness, sd = replace(stiffness.nominal, doubts=stiffness.doubts), np.zeros(s.shape)
    band = stiffness.band(s, level)
    modulus = band.k * length / moment
    wide = np.exp(np.hypot(stiffness.half_width(s, level), half_width(sd, level)))
    return ModulusBand(s, modulus, modulus / wide, modulus * wide, band.identified & np.isfinite(moment))


def one_modulus(
    stiffness: UncertainStiffness | Profile, length: float, section: StatedSection | None, level: float = 0.95
) -> tuple[float, float, float] | None:
    """Pa: E as one number, its geometric mean along the beam, and its band; None where k(s) was not learned as the
    section's shape times a modulus."""
    if section is None or not isinstance(stiffness, UncertainStiffness) or stiffness.nominal is None:
        return None
    nominal = stiffness.nominal
    row = np.mean(nominal.basis(_PLACES), axis=0)
    middle = float(np.exp(row @ nominal.mean)) * length / mean_moment(section)
    wide = float(np.exp(half_width(np.hypot(np.sqrt(row @ nominal.covariance @ row), nominal.gain_sd), level)))
    return middle, middle / wide, middle * wide
