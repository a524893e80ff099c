# ruff: noqa: RUF009  (key() returns a dataclass field, which is what a default may be)
"""What `recording.toml` may say of the beam itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from onebend.recording.toml.schema import key, number, one_of, text
from onebend.records import CURVATURE_SD, MassAlong, Rest, StiffnessAlong

LONGEST = 50.0  # m: a beam of 150 mm that was written in millimetres is longer
HEAVIEST = 1000.0  # kg


@dataclass(frozen=True)
class MassEntry:
    """[[beam.masses]]: something small that rides on the beam."""

    s: float = key(
        "s", number(least=0, most=1), "its place along the beam, 0 at the clamp, 1 at the tip", example="0.5"
    )
    mass: float = key("mass_kg", number(above=0, most=HEAVIEST), "its mass, kg", example="0.004")


@dataclass(frozen=True)
class BeamEntry:
    """[beam]: what is known of the beam."""

    length: float = key(
        "length_m", number(above=0, most=LONGEST), "the beam's length from clamp to tip, m", example="0.15"
    )
    mass: float = key(
        "mass_kg", number(above=0, most=HEAVIEST), "the beam's mass, kg", example="0.075", default=math.nan
    )
    mass_sd: float = key(
        "mass_sd_kg",
        number(least=0, most=HEAVIEST),
        "how exactly that mass is known (one standard deviation), kg; 0: exact",
        example="0.0001",
        default=math.nan,
    )
    mass_file: Path | None = key(
        "mass_file",
        text,
        "a table with columns s and kg_per_m: the mass per metre, where it is not even",
        example='"mass.csv"',
        default=None,
    )
    stiffness_along: StiffnessAlong = key(
        "stiffness_along",
        one_of("unknown", "even", "section"),
        'what is known of how k varies: "even" where it is one number (one section and material), as the "section" '
        'varies (one modulus times its I), or "unknown"',
        example='"even"',
        default="unknown",
    )
    modulus_varies: float = key(
        "modulus_varies",
        number(least=0, most=2.0),
        "how far the modulus may vary slowly along such a beam (one standard deviation, 0.1 = 10 %); 0: not at all",
        example="0.1",
        default=0.0,
    )
    mass_along: MassAlong = key(
        "mass_along",
        one_of("unknown", "even", "width", "thickness", "both", "section", "table"),
        'what is known of how the mass is spread: "even", as the beam\'s "width", "thickness" or "both" vary, as the '
        'area of its "section" (with mass_kg), as the "table" in mass_file, or "unknown"',
        example='"even"',
        default="unknown",
    )
    width: float = key(
        "width_m",
        number(above=0, most=LONGEST),
        "the beam's size across the bending axis (in the plane of bending), m",
        example="0.02",
        default=math.nan,
    )
    thickness: float = key(
        "thickness_m",
        number(above=0, most=LONGEST),
        "the beam's size along the bending axis, m",
        example="0.03",
        default=math.nan,
    )
    diameter: float = key(
        "diameter_m",
        number(above=0, most=LONGEST),
        "the diameter of a round beam, in place of the two, m",
        example="0.012",
        default=math.nan,
    )
    inner_diameter: float = key(
        "inner_diameter_m",
        number(above=0, most=LONGEST),
        "the inner diameter of a tube, beside diameter_m, m",
        example="0.010",
        default=math.nan,
    )
    across_flats: float = key(
        "across_flats_m",
        number(above=0, most=LONGEST),
        "the width of a hexagonal beam across its flats, in place of the others, m",
        example="0.006",
        default=math.nan,
    )
    section_file: Path | None = key(
        "section_file",
        text,
        "a table with columns s and width_m, thickness_m, diameter_m, inner_diameter_m or across_flats_m: the sizes "
        "that vary along the beam; or s and I_m4, the section's second moment",
        example='"section.csv"',
        default=None,
    )
    section_sd: float = key(
        "section_sd_m",
        number(least=0, most=LONGEST),
        "how far off these sizes may be (one standard deviation), m; 0: exact",
        example="0.0001",
        default=math.nan,
    )
    moment_sd: float = key(
        "I_sd",
        number(least=0, most=2.0),
        "how far off I_m4 may be, alike at all places (one standard deviation, 0.05 = 5 %); 0: exact",
        example="0.05",
        default=math.nan,
    )
    rest: Rest = key(
        "rest",
        one_of("straight", "unknown"),
        'its shape with no force on it: "unknown" where it may be curved; "straight" states that it is not',
        example='"unknown"',
        default="unknown",
    )
    curvature_sd: float = key(
        "rest_curvature_sd_deg",
        number(least=0, scale=math.pi / 180),
        'how far it may be turned from clamp to tip by its own curvature, where rest = "unknown" (one standard '
        "deviation), degrees; 0: straight",
        example="8.6",
        default=CURVATURE_SD,
    )  # rad
    rest_change_sd: float = key(
        "rest_change_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how far this turn may change from one recording of the beam to the next, as where it takes a set (one "
        "standard deviation), degrees; 0: all have one shape at rest",
        example="2.0",
        default=0.0,
    )  # rad
    masses: tuple[MassEntry, ...] = ()
