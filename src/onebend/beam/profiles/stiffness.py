"""Families of the bending stiffness distribution k(s) [N m], and profiles along the beam in general.

A profile is a frozen record that evaluates at any `s` in [0, 1], names the places where it jumps, and can be written
as plain data and read back. What is linear in its coefficients also gives its basis, for regression.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator

from onebend.beam.profiles.piecewise import Pieces
from onebend.beam.profiles.polyline import Polyline
from onebend.errors import MechanicsError
from onebend.records import Array


@runtime_checkable
class Profile(Protocol):
    """A quantity along the beam."""

    def __call__(self, s: Array | float) -> Array:
        """Value at `s` (any shape, in [0, 1])."""

    @property
    def jumps(self) -> tuple[float, ...]:
        """Places strictly inside (0, 1) where the profile or its slope is not continuous."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data from which `profile_from_dict` makes an equal profile."""


@dataclass(frozen=True)
class Uniform:
    """The same value everywhere."""

    value: float

    def __call__(self, s: Array | float) -> Array:
        return np.full(np.shape(s), float(self.value))

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "uniform", "value": self.value}


@dataclass(frozen=True)
class Gaussians:
    """`k(s) = sum_w gamma_w Pi_w(s)` with the paper's normalised Gaussians (15) at fixed centres."""

    centres: tuple[float, ...]
    width: float  # sigma of (15), in units of s
    coefficients: tuple[float, ...]  # gamma, N m

    def __post_init__(self) -> None:
        if not self.width > 0.0:
            raise MechanicsError(f"the Gaussians' width must be positive, got {self.width}")
        if len(self.centres) != len(self.coefficients):
            raise MechanicsError(f"{len(self.centres)} centres but {len(self.coefficients)} coefficients")

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(gaussian_basis(s, self.centres, self.width) @ np.asarray(self.coefficients))

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": "gaussians",
            "centres": list(self.centres),
            "width": self.width,
            "coefficients": list(self.coefficients),
        }


@dataclass(frozen=True)
class Powers:
    """`k(s) = sum_w gamma_w s^w`, the paper's polynomial family (12)."""

    coefficients: tuple[float, ...]  # gamma, N m, of s^0, s^1, ...

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(s, dtype=float), np.asarray(self.coefficients)))

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "powers", "coefficients": list(self.coefficients)}


@dataclass(frozen=True)
class Table:
    """Values at given places: monotone cubic between them, constant beyond. For measured or computed profiles."""

    s: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.s) != len(self.values) or len(self.s) < 2:
            raise MechanicsError("a table needs at least two places, and one value a place")
        if np.any(np.diff(self.s) <= 0.0):
            raise MechanicsError("a table's places must rise")

    def __call__(self, s: Array | float) -> Array:
        inside = np.clip(np.asarray(s, dtype=float), self.s[0], self.s[-1])
        return np.asarray(self._interpolator(inside))

    @cached_property
    def _interpolator(self) -> PchipInterpolator:
        return PchipInterpolator(self.s, self.values)

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "table", "s": list(self.s), "values": list(self.values)}


@dataclass(frozen=True)
class Steps:
    """Constant pieces: `values[i]` between `edges[i]` and `edges[i + 1]`; edges run from 0 to 1."""

    edges: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.edges) != len(self.values) + 1 or self.edges[0] != 0.0 or self.edges[-1] != 1.0:
            raise MechanicsError("steps need edges from 0 to 1, one more than values")
        if np.any(np.diff(self.edges) <= 0.0):
            raise MechanicsError("the edges of steps must rise")

    def __call__(self, s: Array | float) -> Array:
        piece = np.searchsorted(self.edges[1:-1], np.asarray(s, dtype=float), side="right")
        return np.asarray(self.values, dtype=float)[piece]

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.edges[1:-1]

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "steps", "edges": list(self.edges), "values": list(self.values)}


@dataclass(frozen=True)
class LogSpline:
    """`log k(s)` as a B-spline, positive whatever the coefficients; beside a known part of log k where there is one."""

    knots: tuple[float, ...]  # with the ends repeated, as scipy's BSpline takes them
    coefficients: tuple[float, ...]  # of log(k / (N m))
    degree: int = 3
    offset: Polyline | None = None  # of log k, known beforehand: that of the section's second moment

    def __call__(self, s: Array | float) -> Array:
        s = np.asarray(s, dtype=float)
        return np.asarray(np.exp(self._spline(s) + (0.0 if self.offset is None else self.offset(s))))

    @cached_property
    def _spline(self) -> BSpline:
        return BSpline(np.asarray(self.knots), np.asarray(self.coefficients), self.degree)

    @property
    def jumps(self) -> tuple[float, ...]:
        return () if self.offset is None else self.offset.jumps

    def as_dict(self) -> dict[str, Any]:
        return {
            "kind": "log-spline",
            "knots": list(self.knots),
            "coefficients": list(self.coefficients),
            "degree": self.degree,
            **({} if self.offset is None else {"offset": self.offset.as_dict()}),
        }


@dataclass(frozen=True)
class Scaled:
    """Another profile times a constant, e.g. E times the second moment of area over L."""

    factor: float
    profile: Profile

    def __call__(self, s: Array | float) -> Array:
        return self.factor * self.profile(s)

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.profile.jumps

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "scaled", "factor": self.factor, "profile": self.profile.as_dict()}


def knots_of(profile: Profile) -> tuple[float, ...]:
    """Places strictly inside (0, 1) where a derivative jumps: a spline's knots, a table's places."""
    if isinstance(profile, Scaled):
        return knots_of(profile.profile)
    places = profile.s if isinstance(profile, Table) else profile.knots if isinstance(profile, LogSpline) else ()
    return tuple(sorted({float(place) for place in places if 0.0 < place < 1.0}))


def gaussian_basis(s: Array | float, centres: Array | tuple[float, ...], width: float) -> Array:
    """The Gaussians of (15) at `s`: shape `s.shape + (m,)`, unit 1 (each has unit area over the real line)."""
    z = (np.asarray(s, dtype=float)[..., None] - np.asarray(centres, dtype=float)) / width
    return np.asarray(np.exp(-0.5 * z**2) / (width * math.sqrt(2.0 * math.pi)))


def power_basis(s: Array | float, m: int) -> Array:
    """`s^0 .. s^(m-1)` at `s`: shape `s.shape + (m,)`."""
    return np.asarray(np.asarray(s, dtype=float)[..., None] ** np.arange(m))


def equidistant(m: int) -> tuple[float, ...]:
    """Centres of m Gaussians, the first at 0 and the last at 1 (the paper says equidistant, no more)."""
    return tuple(float(c) for c in np.linspace(0.0, 1.0, m))


_KINDS: dict[str, Callable[..., Profile]] = {
    "uniform": Uniform,
    "gaussians": Gaussians,
    "powers": Powers,
    "table": Table,
    "steps": Steps,
    "log-spline": LogSpline,
    "pieces": Pieces,
    "polyline": Polyline,
}


def profile_from_dict(data: dict[str, Any]) -> Profile:
    """The profile that `as_dict` wrote. Raises `MechanicsError` on an unknown kind or missing entry."""
    entries = {key: tuple(value) if isinstance(value, list) else value for key, value in data.items() if key != "kind"}
    try:
        if data["kind"] == "scaled":
            return Scaled(float(data["factor"]), profile_from_dict(data["profile"]))
        if "offset" in entries:
            entries["offset"] = profile_from_dict(data["offset"])
        return _KINDS[data["kind"]](**entries)
    except (KeyError, TypeError) as error:
        raise MechanicsError(f"cannot make a profile of kind {data.get('kind')!r}: {error}") from error
