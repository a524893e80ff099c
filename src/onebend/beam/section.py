"""Cross-sections: profiles of a solid rectangular bar, the second moment of a measured section, and Young's modulus."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from onebend.beam.stiffness import Pieces, Polyline, Profile, Table, UncertainStiffness, half_width, in_pieces
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, SectionShapeName, StatedSection


@dataclass(frozen=True)
class SectionProfiles:
    """Profiles for a beam of given length."""

    stiffness: Pieces  # k = EI / L, N m
    mass_per_length: Pieces  # mu, kg/m
    rotary_inertia: Pieces  # iota, kg m


def rectangular_bar(
    width: Profile, thickness: Profile, *, length: float, modulus: float, density: float
) -> SectionProfiles:
    """Of a bar of `length` m and one material (E in Pa, density in kg/m^3), to 1e-12 of their largest values.

    `thickness` is in the plane of bending, `width` across it. Raises `MechanicsError`: a size that is not positive, or
    an unlisted jump of one.
    """
    if not length > 0.0:
        raise MechanicsError(f"a beam's length must be positive, got {length} m")

    def area(s: Array) -> Array:
        return _positive(width(s), s) * _positive(thickness(s), s)

    def second(s: Array) -> Array:
        return area(s) * np.asarray(thickness(s)) ** 2 / 12.0

    jumps = tuple(sorted({*width.jumps, *thickness.jumps}))
    breaks = tuple(sorted({*_knots(width), *_knots(thickness)}))
    return SectionProfiles(
        stiffness=in_pieces(lambda s: modulus * second(s) / length, breaks, jumps=jumps),
        mass_per_length=in_pieces(lambda s: density * area(s), breaks, jumps=jumps),
        rotary_inertia=in_pieces(lambda s: density * second(s), breaks, jumps=jumps),
    )


def _knots(profile: Profile) -> tuple[float, ...]:
    """Places inside the beam where a derivative of a size jumps."""
    knots = profile.s if isinstance(profile, Table | Polyline) else profile.edges if isinstance(profile, Pieces) else ()
    return tuple(knot for knot in knots if 0.0 < knot < 1.0)


def _positive(sizes: Array, s: Array) -> Array:
    values = np.asarray(sizes, dtype=float)
    if not np.all(values > 0.0):
        bad = int(np.flatnonzero(~(values > 0.0))[0])
        raise MechanicsError(f"a section's size must be positive, got {values[bad]:.3g} m at s = {s[bad]:.3f}")
    return values


# A measured cross-section along the beam. I = w h^3 / 12 of a rectangle (h in the plane of bending), pi d^4 / 64 of a
# circle, pi (d^4 - c^4) / 64 of a tube, 5 sqrt(3) / 144 d^4 of a regular hexagon (d across flats, any axis). Sizes are
# linear between places; where only I is known, its fourth root is.

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
    s = np.asarray(s, dtype=float)
    h = _positive(_along(section, section.thickness)(s), s)
    if section.shape == "circle":
        return np.asarray(np.pi * h**4 / 64.0)
    if section.shape == "tube" and section.inner is not None:
        hole = _along(section, section.inner)(s)
        if not np.all((hole >= 0.0) & (hole < h)):
            raise MechanicsError("a tube's inner diameter must be at least 0 and less than the outer one")
        return np.asarray(np.pi * (h**4 - hole**4) / 64.0)
    share = 5.0 * math.sqrt(3.0) / 144.0 if section.shape == "hexagon" else 1.0 / 12.0
    return np.asarray(share * _positive(_along(section, section.width)(s), s) * h**3)


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
