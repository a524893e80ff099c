"""Cross-sections: from shapes and materials along the beam to bending stiffness, mass, rotary inertia and rest shape.

A section is a set of parts, each a plane shape of one material. Bending is about the axis through the modulus-weighted
centroid (the neutral axis), across the plane of motion; y counts from an arbitrary reference line towards the beam's
left, z across. With area A, centroid y_c and second moment I about its own centroid, per part:

    EA = sum E A,   y_n = sum E A y_c / EA,   EI = sum E (I + A (y_c - y_n)^2)
    mu = sum rho A, iota = sum rho (I + A (y_c - y_n)^2),   curvature at rest = -sum E A (y_c - y_n) e / EI

(e: the strain that a part would have if it were free, as from heat, swelling or pre-stretch; Timoshenko 1925). Plane
sections stay plane and parts do not slip. Width is measured along z, thickness along y.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from onebend.beam.profiles.piecewise import Pieces, in_pieces
from onebend.beam.profiles.polyline import Polyline
from onebend.beam.profiles.stiffness import Profile, Scaled, Table, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array


@dataclass(frozen=True)
class Material:
    """What a part is made of."""

    modulus: float  # E, Pa
    density: float  # rho, kg/m^3
    free_strain: float = 0.0  # e

    def __post_init__(self) -> None:
        if not (self.modulus > 0.0 and self.density >= 0.0 and np.isfinite(self.free_strain)):
            raise MechanicsError(
                f"a material needs E > 0, rho >= 0 and a finite strain, got {self.modulus}, {self.density}, "
                f"{self.free_strain}"
            )


class SectionShape(Protocol):
    """A plane figure whose size follows profiles along the beam."""

    @property
    def sizes(self) -> tuple[Profile, ...]:
        """The profiles that it depends on [m]."""

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        """At places (S,): area [m^2], centroid y [m] in the shape's own axes, second moment about it [m^4]."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle centred on its own axes."""

    width: Profile
    thickness: Profile

    @property
    def sizes(self) -> tuple[Profile, ...]:
        return (self.width, self.thickness)

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        w, t = (_size(profile, s) for profile in self.sizes)
        return w * t, np.zeros_like(w), w * t**3 / 12.0


@dataclass(frozen=True)
class Circle:
    """A full circle."""

    diameter: Profile

    @property
    def sizes(self) -> tuple[Profile, ...]:
        return (self.diameter,)

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        d = _size(self.diameter, s)
        return 0.25 * np.pi * d**2, np.zeros_like(d), np.pi * d**4 / 64.0


@dataclass(frozen=True)
class Tube:
    """A circle with a concentric round hole."""

    outer: Profile  # diameter
    inner: Profile

    @property
    def sizes(self) -> tuple[Profile, ...]:
        return (self.outer, self.inner)

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        d, hole = _size(self.outer, s), np.asarray(self.inner(s), dtype=float)
        if not np.all((hole >= 0.0) & (hole < d)):
            raise MechanicsError("a tube's inner diameter must be at least 0 and less than the outer one")
        return 0.25 * np.pi * (d**2 - hole**2), np.zeros_like(d), np.pi * (d**4 - hole**4) / 64.0


@dataclass(frozen=True)
class Polygon:
    """A simple polygon of corners (y, z), stretched by `thickness` along y and by `width` along z.

    Either order of corners is taken. With corners in metres the two profiles are `Uniform(1.0)`.
    """

    corners: tuple[tuple[float, float], ...]
    width: Profile = field(default_factory=lambda: Uniform(1.0))
    thickness: Profile = field(default_factory=lambda: Uniform(1.0))

    def __post_init__(self) -> None:
        if len(self.corners) < 3 or not np.all(np.isfinite(np.asarray(self.corners))):
            raise MechanicsError("a polygon needs at least three finite corners")
        if polygon_moments(self.corners)[0] <= 0.0:
            raise MechanicsError("the polygon has no area")
        if _crosses_itself(np.asarray(self.corners, dtype=float)):
            raise MechanicsError("the polygon's sides cross: give its corners in order around it")

    @property
    def sizes(self) -> tuple[Profile, ...]:
        return (self.width, self.thickness)

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        area, centroid, second = polygon_moments(self.corners)
        w, t = (_size(profile, s) for profile in self.sizes)
        return area * w * t, centroid * t, second * w * t**3


@dataclass(frozen=True)
class SectionPart:
    """A shape of one material whose own axes stand at y = `offset` of the section."""

    shape: SectionShape
    material: Material
    offset: Profile = field(default_factory=lambda: Uniform(0.0))  # m


@dataclass(frozen=True)
class LaminateLayer:
    """A rectangular layer of a laminate."""

    width: Profile
    thickness: Profile
    material: Material


@dataclass(frozen=True)
class SectionProperties:
    """A section at places (S,)."""

    axial: Array  # EA, N
    neutral_axis: Array  # y_n, m, in the section's reference
    bending: Array  # EI, N m^2
    mass: Array  # mu, kg/m
    rotary: Array  # iota, kg m, about the neutral axis
    mass_offset: Array  # m, centre of mass from the neutral axis; motion by (7) assumes 0
    curvature: Array  # 1/m, at rest


@dataclass(frozen=True)
class SectionProfiles:
    """A section's properties as profiles of a beam of given length."""

    stiffness: Pieces  # k = EI / L, N m
    mass_per_length: Pieces  # mu, kg/m
    rotary_inertia: Pieces  # iota, kg m
    rest_curvature: Pieces  # q0 = L times the curvature, rad


def section(parts: tuple[SectionPart, ...], s: Array) -> SectionProperties:
    """Properties of a section of several parts at places `s` (S,).

    Raises:
        MechanicsError: no part, or a size that is not positive.
    """
    if not parts:
        raise MechanicsError("a section needs at least one part")
    places = np.atleast_1d(np.asarray(s, dtype=float))
    area, centre, second = (np.stack(column) for column in zip(*(p.shape.moments(places) for p in parts), strict=True))
    y = centre + np.stack([np.asarray(p.offset(places), dtype=float) for p in parts])
    made_of = [part.material for part in parts]
    modulus = np.array([[m.modulus] for m in made_of])
    density, strain = np.array([[m.density] for m in made_of]), np.array([[m.free_strain] for m in made_of])
    axial, mass = np.sum(modulus * area, axis=0), np.sum(density * area, axis=0)
    neutral = np.sum(modulus * area * y, axis=0) / axial
    about = second + area * (y - neutral) ** 2
    bending = np.sum(modulus * about, axis=0)
    static = np.sum(density * area * (y - neutral), axis=0)
    return SectionProperties(
        axial=axial,
        neutral_axis=neutral,
        bending=bending,
        mass=mass,
        rotary=np.sum(density * about, axis=0),
        mass_offset=np.divide(static, mass, out=np.zeros_like(mass), where=mass > 0.0),
        curvature=-np.sum(modulus * area * (y - neutral) * strain, axis=0) / bending,
    )


def laminate(layers: tuple[LaminateLayer, ...]) -> tuple[SectionPart, ...]:
    """Layers stacked upwards along y, the lowest face of the first at y = 0."""
    return tuple(
        SectionPart(
            Rectangle(layer.width, layer.thickness),
            layer.material,
            _Stacked(tuple(below.thickness for below in layers[:i]), layer.thickness),
        )
        for i, layer in enumerate(layers)
    )


def along(parts: tuple[SectionPart, ...], length: float) -> SectionProfiles:
    """Profiles of a beam of `length` m with this section, to 1e-12 of their largest values, with all jumps kept.

    Raises:
        MechanicsError: as `section`, or a size that jumps without saying so in its `jumps`.
    """
    if not length > 0.0:
        raise MechanicsError(f"a beam's length must be positive, got {length} m")
    sizes = [size for part in parts for size in (*part.shape.sizes, part.offset)]
    jumps = tuple(sorted({jump for size in sizes for jump in size.jumps}))
    breaks = tuple(sorted({place for size in sizes for place in _knots(size)}))
    return SectionProfiles(
        stiffness=in_pieces(lambda s: section(parts, s).bending / length, breaks, jumps=jumps),
        mass_per_length=in_pieces(lambda s: section(parts, s).mass, breaks, jumps=jumps),
        rotary_inertia=in_pieces(lambda s: section(parts, s).rotary, breaks, jumps=jumps),
        rest_curvature=in_pieces(lambda s: section(parts, s).curvature * length, breaks, jumps=jumps),
    )


def polygon_moments(corners: tuple[tuple[float, float], ...]) -> tuple[float, float, float]:
    """Area, centroid y, and second moment `int (y - y_c)^2 dA` of a simple polygon (y, z), by Green's theorem."""
    points = np.asarray(corners, dtype=float)
    middle = points.mean(axis=0)  # moments about a point nearby lose no digits
    y, z = (points - middle).T
    y1, z1 = np.roll(y, -1), np.roll(z, -1)
    cross = y * z1 - y1 * z
    area = 0.5 * np.sum(cross)
    if area == 0.0:
        return 0.0, float(middle[0]), 0.0
    centroid = np.sum((y + y1) * cross) / (6.0 * area)
    second = np.sum((y**2 + y * y1 + y1**2) * cross) / 12.0
    sign = np.sign(area)
    return float(abs(area)), float(middle[0] + centroid), float(sign * second - abs(area) * centroid**2)


@dataclass(frozen=True)
class _Stacked:
    """Half of one thickness above the sum of those below."""

    below: tuple[Profile, ...]
    own: Profile

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(0.5 * self.own(s) + sum((np.asarray(t(s)) for t in self.below), np.zeros(np.shape(s))))

    @property
    def jumps(self) -> tuple[float, ...]:
        return tuple(sorted({jump for profile in (*self.below, self.own) for jump in profile.jumps}))

    def as_dict(self) -> dict[str, object]:
        return {"kind": "stacked", "below": [t.as_dict() for t in self.below], "own": self.own.as_dict()}


def _knots(profile: Profile) -> tuple[float, ...]:
    """Where a profile is not smooth: its jumps, and knots where only a higher derivative jumps."""
    if isinstance(profile, Scaled):
        return _knots(profile.profile)
    if isinstance(profile, _Stacked):
        return tuple(sorted({knot for part in (*profile.below, profile.own) for knot in _knots(part)}))
    knots = profile.s if isinstance(profile, Table | Polyline) else profile.edges if isinstance(profile, Pieces) else ()
    return tuple(sorted({*profile.jumps, *(knot for knot in knots if 0.0 < knot < 1.0)}))


def _size(profile: Profile, s: Array) -> Array:
    values = np.asarray(profile(s), dtype=float)
    if not np.all(values > 0.0):
        bad = int(np.flatnonzero(~(values > 0.0))[0])
        raise MechanicsError(f"a section's size must be positive, got {values[bad]:.3g} m at s = {s[bad]:.3f}")
    return values


def _crosses_itself(points: Array) -> bool:
    """Whether two sides that are not neighbours meet in their insides."""

    def side(a: Array, b: Array, c: Array) -> float:
        return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))

    count = len(points)
    for i in range(count):
        a, b = points[i], points[(i + 1) % count]
        for j in range(i + 2, count - (i == 0)):
            c, d = points[j], points[(j + 1) % count]
            if side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0:
                return True
    return False
