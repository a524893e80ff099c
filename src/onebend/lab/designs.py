"""Designs of beams to cast: a width along the beam and a material, and what they make as a `Beam`.

A design is a flat bar, `depth` thick across the plane of bending and w(s) wide in it, so that
`EI = E depth w^3 / 12` and `k = EI / L`. The three named ones follow Section IV-B of the paper: widths of first, second
and third order, weakest at the base, in the middle and near the tip. The paper prints no sizes; these are our own.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import make_lsq_spline

from onebend.beam.model import Beam
from onebend.beam.profiles.section import Material, Rectangle, SectionPart, SectionProfiles, along
from onebend.beam.profiles.stiffness import Powers, Profile, Table, Uniform
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.errors import MechanicsError
from onebend.lab.materials import TYPICAL_DENSITY, ModulusEstimate, from_shore_a
from onebend.records import Array, Remark

PLACES = 2001  # where a width is checked
INTERVALS = 48  # of the spline of log k
SLENDER = 5.0  # a bar shorter than this many widths also shears


@dataclass(frozen=True)
class Design:
    """A bar of one material, clamped at s = 0."""

    name: str
    length: float  # L, m
    depth: float  # m, across the plane of bending
    width: Profile  # w(s), m, in the plane of bending
    modulus: float  # E, Pa
    modulus_log_sd: float  # sd of log E; 0 where E is taken as known
    density: float  # kg/m^3
    source: str = "given"  # where E comes from

    def __post_init__(self) -> None:
        sizes = {"length": self.length, "depth": self.depth, "modulus": self.modulus, "density": self.density}
        for what, size in sizes.items():
            if not (np.isfinite(size) and size > 0.0):
                raise MechanicsError(f"design {self.name!r}: its {what} must be a positive number, got {size}")
        if not (np.isfinite(self.modulus_log_sd) and self.modulus_log_sd >= 0.0):
            raise MechanicsError(f"design {self.name!r}: the sd of log E must be at least 0, got {self.modulus_log_sd}")
        s = np.linspace(0.0, 1.0, PLACES)
        width = np.asarray(self.width(s), dtype=float)
        if not np.all(np.isfinite(width) & (width > 0.0)):
            bad = int(np.flatnonzero(~(np.isfinite(width) & (width > 0.0)))[0])
            raise MechanicsError(
                f"design {self.name!r}: the width must be positive all along, but is {width[bad]:.4g} m at s = "
                f"{s[bad]:.3f}. Give a larger width there"
            )

    @cached_property
    def along(self) -> SectionProfiles:
        """k(s), mass and rotary inertia per metre."""
        material = Material(self.modulus, self.density)
        return along((SectionPart(Rectangle(Uniform(self.depth), self.width), material),), self.length)

    @property
    def mass(self) -> float:
        """kg, from clamp to tip."""
        x, w = np.polynomial.legendre.leggauss(16)
        edges = np.asarray(self.along.mass_per_length.edges)
        s = edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (x + 1.0)
        return float(self.length * np.sum(0.5 * np.diff(edges)[:, None] * w * self.along.mass_per_length(s)))

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Where the design leaves what a slender beam's mechanics cover."""
        widest = float(np.max(np.asarray(self.width(np.linspace(0.0, 1.0, PLACES)))))
        if self.length < SLENDER * widest:
            return (
                Remark(
                    "warning",
                    f"the beam is only {self.length / widest:.1f} widths long: it shears as well as bends, and is "
                    "softer than said here. Make it longer, or narrower.",
                    about="shear",
                ),
            )
        return ()

    def bending(self, s: Array | float) -> Array:
        """EI [N m^2] at `s`."""
        return np.asarray(self.modulus * self.depth * np.asarray(self.width(s)) ** 3 / 12.0)

    def beam(self) -> Beam:
        """The beam with its mass, straight at rest."""
        return Beam(self.length, self.along.stiffness, mass_per_length=self.along.mass_per_length)

    def uncertain(self) -> UncertainStiffness:
        """k(s) with the band that the modulus alone leaves: one common scale, the shape taken as cast."""
        kinks = np.asarray(self.along.stiffness.jumps)
        even = np.linspace(0.0, 1.0, INTERVALS + 1)[1:-1]
        inner = np.concatenate([even[~np.isin(even, kinks)], np.repeat(kinks, 3)])
        knots = np.concatenate([np.zeros(4), np.sort(inner), np.ones(4)])
        s = np.unique(np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(np.unique(knots))]))
        spline = make_lsq_spline(s, np.log(self.along.stiffness(s)), knots, k=3)
        count = len(spline.c)
        return UncertainStiffness(knots, np.asarray(spline.c), np.zeros((count, count)), self.modulus_log_sd)

    def of(self, stiffness: ModulusEstimate, density: float | None = None) -> Design:
        """The same shape cast of another material."""
        return replace(
            self,
            modulus=stiffness.modulus,
            modulus_log_sd=stiffness.log_sd,
            source=stiffness.source,
            density=self.density if density is None else density,
        )


def _named(name: str, width: tuple[float, ...]) -> Design:
    """A named design: 150 mm long, 30 mm deep, of a silicone of Shore A 30, the paper's hardness read on scale A."""
    by = from_shore_a(30.0)
    return Design(name, 0.15, 0.03, Powers(width), by.modulus, by.log_sd, TYPICAL_DENSITY, by.source)


DESIGNS = {
    design.name: design
    for design in (
        _named("uniform", (0.014,)),
        _named("linear", (0.010, 0.010)),
        _named("quadratic", (0.018, -0.032, 0.032)),  # 18, 10, 18 mm at s = 0, 0.5, 1
        _named("cubic", (0.014, 0.0405, -0.1035, 0.060)),  # widest (18.6 mm) at s = 0.25, narrowest (10.4) at 0.9
    )
}


def design_named(name: str) -> Design:
    """One of `DESIGNS`. Raises `MechanicsError` on an unknown name."""
    if name not in DESIGNS:
        near = difflib.get_close_matches(name, DESIGNS, n=1)
        hint = f"Did you mean {near[0]!r}? " if near else ""
        raise MechanicsError(
            f"no design is named {name!r}, and no such file exists. {hint}Named designs: {', '.join(DESIGNS)}. "
            "For your own: onebend design --new my-beam.toml"
        )
    return DESIGNS[name]


def width_table(s: tuple[float, ...], width: tuple[float, ...]) -> Table:
    """A width given at places that run from 0 to 1, monotone cubic between them.

    Raises:
        MechanicsError: places that do not rise from 0 to 1, or not one width a place.
    """
    if not s or s[0] != 0.0 or s[-1] != 1.0:
        raise MechanicsError(f"the places of a width must run from 0 to 1, got {list(s)}")
    return Table(s, width)
