"""Young's modulus from bending stiffness and a measured cross-section: E(s) = k(s) L / I(s).

I = w h^3 / 12 of a rectangle (h in the plane of bending) and pi d^4 / 64 of a circle. An error of the sizes enters to
first order: `d log I = dw/w + 3 dh/h`, or `4 dd/d`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from onebend.beam.profiles.section import Circle, Rectangle
from onebend.beam.profiles.stiffness import Profile, Table
from onebend.beam.profiles.uncertain import UncertainStiffness, half_width
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, SectionShapeName, StatedSection


@dataclass(frozen=True)
class ModulusBand:
    """Young's modulus and how sure it is, at places s (S,); NaN where the section was not measured."""

    s: Array
    modulus: Array  # E, Pa
    low: Array  # Pa; NaN where k(s) has no band
    high: Array  # Pa
    identified: BoolArray  # as of k(s), and the section is known there


def second_moment(section: StatedSection, s: Array) -> tuple[Array, Array]:
    """(S,) I [m^4] at places `s`, and one sd of its log; NaN outside the places where the section was measured.

    The sd is 0 where nobody says how exactly the sizes were measured.

    Raises:
        MechanicsError: sizes that are not positive, or fewer than two places.
    """
    s = np.asarray(s, dtype=float)
    thickness, width = (Table(tuple(section.s), tuple(size)) for size in (section.thickness, section.width))
    shape = Circle(thickness) if section.shape == "circle" else Rectangle(width, thickness)
    inside = (s >= section.s[0]) & (s <= section.s[-1])
    moment = np.where(inside, shape.moments(s)[2], np.nan)
    sd = section.sd if np.isfinite(section.sd) else 0.0
    relative = 4.0 * sd / thickness(s) if section.shape == "circle" else sd * np.hypot(1 / width(s), 3 / thickness(s))
    return moment, np.where(inside, relative, np.nan)


@one_blas_thread
def modulus_band(
    stiffness: UncertainStiffness | Profile, length: float, section: StatedSection, s: Array, level: float = 0.95
) -> ModulusBand:
    """Young's modulus of a beam of `length` m between the quantiles that leave out `1 - level`, half on either side.

    The errors of k(s), the force's common scale among them, and of the sizes are independent. Of a k(s) without a band
    E has none, and no place counts as identified.

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
    band = stiffness.band(s, level)
    modulus = band.k * length / moment
    wide = np.exp(np.hypot(stiffness.half_width(s, level), half_width(sd, level)))
    return ModulusBand(s, modulus, modulus / wide, modulus * wide, band.identified & np.isfinite(moment))


def section_as_dict(section: StatedSection) -> dict[str, Any]:
    """For JSON: `in_plane_m` is the size in the plane of bending, `across_m` the one across it."""
    sizes = {"in_plane_m": section.thickness.tolist(), "across_m": section.width.tolist()}
    sd = section.sd if np.isfinite(section.sd) else None
    return {"shape": section.shape, "s": section.s.tolist(), **sizes, "sd_m": sd}


def section_from_dict(data: dict[str, Any]) -> StatedSection:
    """From `section_as_dict`. Raises `MechanicsError` where it is no section."""
    s, thickness, width = (np.array(data[key], dtype=float) for key in ("s", "in_plane_m", "across_m"))
    sd = np.nan if data["sd_m"] is None else float(data["sd_m"])
    if data["shape"] not in get_args(SectionShapeName) or s.ndim != 1 or not s.shape == thickness.shape == width.shape:
        raise MechanicsError("a section is a rectangle or a circle with as many sizes as places")
    section = StatedSection(data["shape"], s, thickness, width, sd)
    if sd < 0.0 or not np.all(np.isfinite(second_moment(section, s)[0])):
        raise MechanicsError("a section holds numbers that are not finite, or an sd below zero")
    return section
