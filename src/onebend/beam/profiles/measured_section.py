"""A cross-section as it was measured along the beam: its second moment I(s), how sure that is, and its shape.

I = w h^3 / 12 of a rectangle (h in the plane of bending), pi d^4 / 64 of a circle, pi (d^4 - c^4) / 64 of a tube and
5 sqrt(3) / 144 d^4 of a regular hexagon (d across its flats, about any axis). Where only I is known, its fourth root
goes straight between the places, as the sizes of the others do.
"""

from __future__ import annotations

import math
from typing import Any, get_args

import numpy as np

from onebend.beam.profiles.polyline import Polyline
from onebend.beam.profiles.section import Circle, Polygon, Rectangle, SectionShape, Tube
from onebend.errors import MechanicsError
from onebend.records import Array, SectionShapeName, StatedSection

_SIDE = 1.0 / math.sqrt(3.0)  # of a hexagon that is one wide across its flats
HEXAGON = ((0.5, -_SIDE / 2), (0.5, _SIDE / 2), (0.0, _SIDE), (-0.5, _SIDE / 2), (-0.5, -_SIDE / 2), (0.0, -_SIDE))
_PLACES = np.linspace(0.0, 1.0, 401)
_SHARP = 10.0  # change of the slope of log I, per unit of s, from which on a corner counts as a jump
_FLAT = 1e-9  # of log I: a step that is smaller is none
_MOST_JUMPS = 24


def second_moment(section: StatedSection, s: Array) -> tuple[Array, Array]:
    """(S,) I [m^4] at places `s`, and one sd of its log; NaN outside the places where the section was measured.

    The sd is 0 where nobody says how exactly the sizes were measured.

    Raises:
        MechanicsError: sizes that are not positive, or fewer than two places.
    """
    s = np.asarray(s, dtype=float)
    inside = (s >= section.s[0]) & (s <= section.s[-1])
    sd = np.linalg.norm(moment_errors(section, s), axis=-1)
    return np.where(inside, _moment(section, s), np.nan), np.where(inside, sd, np.nan)


def moment_errors(section: StatedSection, s: Array) -> Array:
    """(S, n) what each stated error does to log I, to first order and for one sd: of each size on its own, alike at all
    places; n = 0 where the section counts as exact."""
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
    """log I(s) less its mean along the beam; beyond the places where the section was measured it stays as it is there.

    Its `jumps` are the section's steps, and its sharpest corners.

    Raises:
        MechanicsError: as `second_moment`.
    """
    s, logs, steps = _log_moment(section)
    logs = logs - np.trapezoid(logs, s)
    return Polyline(tuple(s.tolist()), tuple(logs.tolist()), _jumps(section, steps, s, logs))


def mean_moment(section: StatedSection) -> float:
    """m^4, the geometric mean of I along the beam: what `relative_moment` is relative to."""
    s, logs, _ = _log_moment(section)
    return float(np.exp(np.trapezoid(logs, s)))


def _log_moment(section: StatedSection) -> tuple[Array, Array, Array]:
    """Places (S,) close together, log I there, and the places of the steps, which stand twice among them."""
    s = np.union1d(np.clip(section.s, 0.0, 1.0), _PLACES)
    steps = np.asarray(section.s)[1:][np.diff(section.s) == 0.0]
    logs = np.log(_moment(section, s))
    before = np.log(_moment(section, np.nextafter(steps, 0.0)))
    at = np.searchsorted(s, steps)
    return np.insert(s, at, steps), np.insert(logs, at, before), steps


def _jumps(section: StatedSection, steps: Array, s: Array, logs: Array) -> tuple[float, ...]:
    """Places inside (0, 1) where log I jumps, or where its slope changes most."""
    rows = np.unique(section.s[(section.s > 0.0) & (section.s < 1.0)])
    corners = np.setdiff1d(rows, steps)
    width = 1e-6
    line = Polyline(tuple(s.tolist()), tuple(logs.tolist()))
    bend = np.abs(line(corners + width) - 2.0 * line(corners) + line(corners - width)) / width
    sharp = corners[bend > _SHARP][np.argsort(-bend[bend > _SHARP])]
    steps = steps[np.abs(line(steps) - line(np.nextafter(steps, 0.0))) > _FLAT]
    return tuple(sorted([*steps.tolist(), *sharp[: max(_MOST_JUMPS - len(steps), 0)].tolist()]))


def _moment(section: StatedSection, s: Array) -> Array:
    """(S,) m^4, beyond the first and the last place as there."""
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
    """For JSON: `in_plane_m` is the size in the plane of bending, `across_m` the one across it, `inner_m` the inner
    diameter of a tube; where only the second moment is known, `I_m4` and `I_sd` (a share) stand instead."""
    out: dict[str, Any] = {"shape": section.shape, "s": section.s.tolist()}
    if section.moment is not None:
        sd = section.moment_sd if np.isfinite(section.moment_sd) else None
        return out | {"I_m4": section.moment.tolist(), "I_sd": sd}
    out |= {"in_plane_m": section.thickness.tolist(), "across_m": section.width.tolist()}
    out |= {} if section.inner is None else {"inner_m": section.inner.tolist()}
    return out | {"sd_m": section.sd if np.isfinite(section.sd) else None}


def section_from_dict(data: dict[str, Any]) -> StatedSection:
    """From `section_as_dict`. Raises `MechanicsError` where it is no section."""
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
