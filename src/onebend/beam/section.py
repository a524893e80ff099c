"""Cross-sections: bending stiffness, mass, rotary inertia and rest shape from shapes and materials along the beam.

Bending is about the modulus-weighted centroid (neutral axis); y counts to the beam's left, z across. Per part, with
area A, centroid y_c and second moment I about it:

    EA = sum E A,   y_n = sum E A y_c / EA,   EI = sum E (I + A (y_c - y_n)^2)
    mu = sum rho A, iota = sum rho (I + A (y_c - y_n)^2),   curvature at rest = -sum E A (y_c - y_n) e / EI

e is the free strain of a part, as from heat or swelling (Timoshenko 1925). Parts do not slip. Width is along z,
thickness along y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, get_args

import numpy as np

from onebend.beam.stiffness import (
    Pieces,
    Polyline,
    Profile,
    Scaled,
    Table,
    UncertainStiffness,
    Uniform,
    half_width,
    in_pieces,
)
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, SectionShapeName, StatedSection


@dataclass(frozen=True)
class Material:
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
    @property
    def sizes(self) -> tuple[Profile, ...]:
        """In m."""

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        """At (S,): area [m^2], centroid y [m] in its own axes, second moment about the centroid [m^4]."""


class _Figure:
    @property
    def sizes(self) -> tuple[Profile, ...]:
        return tuple(getattr(self, size.name) for size in fields(self) if size.name != "corners")  # type: ignore[arg-type]


@dataclass(frozen=True)
class Rectangle(_Figure):
    """Centred."""

    width: Profile
    thickness: Profile

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        w, t = (_size(profile, s) for profile in self.sizes)
        return w * t, np.zeros_like(w), w * t**3 / 12.0


@dataclass(frozen=True)
class Circle(_Figure):
    diameter: Profile

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        d = _size(self.diameter, s)
        return 0.25 * np.pi * d**2, np.zeros_like(d), np.pi * d**4 / 64.0


@dataclass(frozen=True)
class Tube(_Figure):
    """A circle with a concentric hole."""

    outer: Profile  # diameter
    inner: Profile

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        d, hole = _size(self.outer, s), np.asarray(self.inner(s), dtype=float)
        if not np.all((hole >= 0.0) & (hole < d)):
            raise MechanicsError("a tube's inner diameter must be at least 0 and less than the outer one")
        return 0.25 * np.pi * (d**2 - hole**2), np.zeros_like(d), np.pi * (d**4 - hole**4) / 64.0


@dataclass(frozen=True)
class Polygon(_Figure):
    """A simple polygon of corners (y, z) in either order, scaled by `thickness` along y and `width` along z.

    With corners in metres the profiles are `Uniform(1.0)`.
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

    def moments(self, s: Array) -> tuple[Array, Array, Array]:
        area, centroid, second = polygon_moments(self.corners)
        w, t = (_size(profile, s) for profile in self.sizes)
        return area * w * t, centroid * t, second * w * t**3


@dataclass(frozen=True)
class SectionPart:
    shape: SectionShape
    material: Material
    offset: Profile = field(default_factory=lambda: Uniform(0.0))  # m


@dataclass(frozen=True)
class LaminateLayer:
    width: Profile
    thickness: Profile
    material: Material


@dataclass(frozen=True)
class SectionProperties:
    """At places (S,)."""

    axial: Array  # EA, N
    neutral_axis: Array  # y_n, m
    bending: Array  # EI, N m^2
    mass: Array  # mu, kg/m
    rotary: Array  # iota, kg m, about the neutral axis
    mass_offset: Array  # m, centre of mass from the neutral axis; motion by (7) assumes 0
    curvature: Array  # 1/m, at rest


@dataclass(frozen=True)
class SectionProfiles:
    """Profiles for a beam of given length."""

    stiffness: Pieces  # k = EI / L, N m
    mass_per_length: Pieces  # mu, kg/m
    rotary_inertia: Pieces  # iota, kg m
    rest_curvature: Pieces  # q0 = L times curvature, rad


def section(parts: tuple[SectionPart, ...], s: Array) -> SectionProperties:
    """Raises `MechanicsError`: no part, or a size that is not positive."""
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
    """Layers stacked along y, from y = 0 upwards."""
    return tuple(
        SectionPart(
            Rectangle(layer.width, layer.thickness),
            layer.material,
            _Stacked(tuple(below.thickness for below in layers[:i]), layer.thickness),
        )
        for i, layer in enumerate(layers)
    )


def along(parts: tuple[SectionPart, ...], length: float) -> SectionProfiles:
    """Profiles of a beam of `length` m, to 1e-12 of their largest values, with all jumps.

    Raises `MechanicsError`: as `section`, or an unlisted jump of a size.
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
    """Area, centroid y, and `int (y - y_c)^2 dA` of a simple polygon (y, z), by Green's theorem."""
    points = np.asarray(corners, dtype=float)
    middle = points.mean(axis=0)  # preserves digits
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
    """Half of one thickness plus those below."""

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


# A measured cross-section along the beam. I = w h^3 / 12 of a rectangle (h in the plane of bending), pi d^4 / 64 of a
# circle, pi (d^4 - c^4) / 64 of a tube, 5 sqrt(3) / 144 d^4 of a regular hexagon (d across flats, any axis). Sizes are
# linear between places; where only I is known, its fourth root is.

_SIDE = 1.0 / math.sqrt(3.0)  # side of a hexagon of unit width across flats
HEXAGON = ((0.5, -_SIDE / 2), (0.5, _SIDE / 2), (0.0, _SIDE), (-0.5, _SIDE / 2), (-0.5, -_SIDE / 2), (0.0, -_SIDE))
_SECTION_PLACES = np.linspace(0.0, 1.0, 401)
_SHARP = 10.0  # change of the slope of log I per unit of s that makes a corner a jump
_FLAT = 1e-9  # smallest step of log I
_MOST_JUMPS = 24


def second_moment(section: StatedSection, s: Array) -> tuple[Array, Array]:
    """(S,) I [m^4] and the sd of log I (0 if not stated); NaN outside the measured places.

    Raises `MechanicsError`: sizes that are not positive, or fewer than two places.
    """
    s = np.asarray(s, dtype=float)
    inside = (s >= section.s[0]) & (s <= section.s[-1])
    sd = np.linalg.norm(moment_errors(section, s), axis=-1)
    return np.where(inside, _moment(section, s), np.nan), np.where(inside, sd, np.nan)


def moment_errors(section: StatedSection, s: Array) -> Array:
    """(S, n) first-order change of log I for one sd of each stated error, common to all places; n = 0 without
    errors."""
    s = np.asarray(s, dtype=float)
    if section.shape == "second moment":
        return section.moment_sd * np.ones((*s.shape, 1)) if section.moment_sd > 0.0 else np.zeros((*s.shape, 0))
    if not section.sd > 0.0:
        return np.zeros((*s.shape, 0))
    h, w = (_along(section, size)(s) for size in (section.thickness, section.width))
    if section.shape == "rectangle":
        return section.sd * np.stack([3.0 / h, 1.0 / w], axis=-1)
    if section.shape == "tube" and section.inner is not None:
        hole = _along(section, section.inner)(s)
        return np.asarray(section.sd * 4.0 * np.stack([h**3, -(hole**3)], axis=-1) / (h**4 - hole**4)[..., None])
    return np.asarray(section.sd * (4.0 / h)[..., None])


def relative_moment(section: StatedSection) -> Polyline:
    """log I(s) less its mean, constant beyond the measured places; `jumps` are steps and sharp corners.

    Raises `MechanicsError`: as `second_moment`.
    """
    s, logs, steps = _log_moment(section)
    logs = logs - np.trapezoid(logs, s)
    return Polyline(tuple(s.tolist()), tuple(logs.tolist()), _jumps(section, steps, s, logs))


def mean_moment(section: StatedSection) -> float:
    """m^4, geometric mean of I."""
    s, logs, _ = _log_moment(section)
    return float(np.exp(np.trapezoid(logs, s)))


def _log_moment(section: StatedSection) -> tuple[Array, Array, Array]:
    """Dense places (S,), log I, and the steps, which stand twice."""
    s = np.union1d(np.clip(section.s, 0.0, 1.0), _SECTION_PLACES)
    steps = np.asarray(section.s)[1:][np.diff(section.s) == 0.0]
    logs = np.log(_moment(section, s))
    before = np.log(_moment(section, np.nextafter(steps, 0.0)))
    at = np.searchsorted(s, steps)
    return np.insert(s, at, steps), np.insert(logs, at, before), steps


def _jumps(section: StatedSection, steps: Array, s: Array, logs: Array) -> tuple[float, ...]:
    rows = np.unique(section.s[(section.s > 0.0) & (section.s < 1.0)])
    corners = np.setdiff1d(rows, steps)
    width = 1e-6
    line = Polyline(tuple(s.tolist()), tuple(logs.tolist()))
    bend = np.abs(line(corners + width) - 2.0 * line(corners) + line(corners - width)) / width
    sharp = corners[bend > _SHARP][np.argsort(-bend[bend > _SHARP])]
    steps = steps[np.abs(line(steps) - line(np.nextafter(steps, 0.0))) > _FLAT]
    return tuple(sorted([*steps.tolist(), *sharp[: max(_MOST_JUMPS - len(steps), 0)].tolist()]))


def _moment(section: StatedSection, s: Array) -> Array:
    """(S,) m^4, constant beyond the ends."""
    if section.moment is not None:
        if not np.all(section.moment > 0.0):
            raise MechanicsError("a section's second moment must be positive")
        return np.asarray(_along(section, section.moment**0.25)(s) ** 4)
    return _figure(section).moments(np.asarray(s, dtype=float))[2]


def _figure(section: StatedSection) -> SectionShape:
    thickness, width = _along(section, section.thickness), _along(section, section.width)
    if section.shape == "tube" and section.inner is not None:
        return Tube(thickness, _along(section, section.inner))
    if section.shape == "hexagon":
        return Polygon(HEXAGON, width, thickness)
    return Circle(thickness) if section.shape == "circle" else Rectangle(width, thickness)


def _along(section: StatedSection, size: Array) -> Polyline:
    return Polyline(tuple(np.asarray(section.s).tolist()), tuple(np.asarray(size).tolist()))


def section_as_dict(section: StatedSection) -> dict[str, Any]:
    """For JSON: `in_plane_m`, `across_m` (across the plane of bending), `inner_m` of a tube; or `I_m4` and `I_sd`
    (relative)."""
    out: dict[str, Any] = {"shape": section.shape, "s": section.s.tolist()}
    if section.moment is not None:
        sd = section.moment_sd if np.isfinite(section.moment_sd) else None
        return out | {"I_m4": section.moment.tolist(), "I_sd": sd}
    out |= {"in_plane_m": section.thickness.tolist(), "across_m": section.width.tolist()}
    out |= {} if section.inner is None else {"inner_m": section.inner.tolist()}
    return out | {"sd_m": section.sd if np.isfinite(section.sd) else None}


def section_from_dict(data: dict[str, Any]) -> StatedSection:
    """Inverse of `section_as_dict`. Raises `MechanicsError`."""
    shape, s = data["shape"], np.array(data["s"], dtype=float)
    if shape not in get_args(SectionShapeName) or s.ndim != 1:
        raise MechanicsError(f"a section is one of {', '.join(get_args(SectionShapeName))}, with places along the beam")
    by_moment = shape == "second moment"
    names = ("I_m4",) if by_moment else ("in_plane_m", "across_m", *(("inner_m",) if shape == "tube" else ()))
    sizes = [np.array(data[name], dtype=float) for name in names]
    if any(size.shape != s.shape for size in sizes):
        raise MechanicsError("a section has as many sizes as places")
    written = data["I_sd" if by_moment else "sd_m"]
    sd = math.nan if written is None else float(written)
    if by_moment:
        unknown = np.full(len(s), np.nan)
        section = StatedSection(shape, s, unknown, unknown, moment=sizes[0], moment_sd=sd)
    else:
        section = StatedSection(shape, s, sizes[0], sizes[1], sd, sizes[2] if shape == "tube" else None)
    if sd < 0.0 or not np.all(np.isfinite(second_moment(section, s)[0])):
        raise MechanicsError("a section holds numbers that are not finite, or an sd below zero")
    return section


# Young's modulus E(s) = k(s) L / I(s). Size errors enter to first order: `d log I = dw/w + 3 dh/h` of a rectangle,
# `4 dd/d` of a circle.

_MEAN_PLACES = np.linspace(0.0, 1.0, 201)  # s, for means along the beam


@dataclass(frozen=True)
class ModulusBand:
    """E and its band at places (S,); NaN outside the measured section."""

    s: Array
    modulus: Array  # E, Pa
    low: Array  # Pa; NaN where k(s) has no band
    high: Array  # Pa
    identified: BoolArray  # k(s) is identified, and the section known


@one_blas_thread
def modulus_band(
    stiffness: UncertainStiffness | Profile, length: float, section: StatedSection, s: Array, level: float = 0.95
) -> ModulusBand:
    """E of a beam of `length` m between quantiles that leave out `1 - level`.

    Errors of k(s), the force's scale and the sizes are independent, unless k(s) was learned as modulus times section:
    then E is that modulus (`UncertainStiffness.nominal`). Without a band of k(s), E has none.

    Raises `MechanicsError`: a length or size that is not positive.
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
    """Pa: geometric mean of E and its band; None unless k(s) was learned as modulus times section."""
    if section is None or not isinstance(stiffness, UncertainStiffness) or stiffness.nominal is None:
        return None
    nominal = stiffness.nominal
    row = np.mean(nominal.basis(_MEAN_PLACES), axis=0)
    middle = float(np.exp(row @ nominal.mean)) * length / mean_moment(section)
    wide = float(np.exp(half_width(np.hypot(np.sqrt(row @ nominal.covariance @ row), nominal.gain_sd), level)))
    return middle, middle / wide, middle * wide
