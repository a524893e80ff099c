"""Bending stiffness k(s) [N m], and other profiles along the beam.

A profile is a frozen record that evaluates at `s` in [0, 1], lists its jumps, and converts to plain data. Profiles
linear in their coefficients also give their basis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.special import ndtri

from onebend.beam.grid import powers_to_legendre
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray


@runtime_checkable
class Profile(Protocol):
    def __call__(self, s: Array | float) -> Array:
        """Value at `s` of any shape."""

    @property
    def jumps(self) -> tuple[float, ...]:
        """Places inside (0, 1) where value or slope jumps."""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `profile_from_dict`."""


class _Kind:
    """Base of profiles: smooth by default, written as `kind` and fields."""

    kind: ClassVar[str]

    @property
    def jumps(self) -> tuple[float, ...]:
        return ()

    def as_dict(self) -> dict[str, Any]:
        return {"kind": self.kind} | _plain_fields(self)


def _plain_fields(record: Any) -> dict[str, Any]:

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        if isinstance(value, tuple):
            return list(value)
        return value.as_dict() if hasattr(value, "as_dict") else value

    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: plain(value) for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class Polyline(_Kind):
    """Linear between places, constant beyond. A place given twice is a step with the second value."""

    kind = "polyline"
    s: tuple[float, ...]
    values: tuple[float, ...]
    jumps: tuple[float, ...] = ()  # steps, and corners sharp enough to need a grid edge

    def __post_init__(self) -> None:
        if len(self.s) != len(self.values) or len(self.s) < 2:
            raise MechanicsError("a polyline needs at least two places, and one value a place")
        apart = np.diff(self.s)
        if np.any(apart < 0.0) or apart[0] == 0.0 or apart[-1] == 0.0 or np.any((apart[1:] + apart[:-1]) == 0.0):
            raise MechanicsError("a polyline's places must rise; one inside may stand twice, as a step")
        if not np.all(np.isfinite([*self.s, *self.values])) or not all(0.0 < jump < 1.0 for jump in self.jumps):
            raise MechanicsError("a polyline's numbers must be finite, and its jumps inside the beam")

    def __call__(self, s: Array | float) -> Array:
        places, values = np.asarray(self.s), np.asarray(self.values)
        inside = np.clip(np.asarray(s, dtype=float), places[0], places[-1])
        i = np.clip(np.searchsorted(places, inside, side="right") - 1, 0, len(places) - 2)
        share = (inside - places[i]) / (places[i + 1] - places[i])
        return np.asarray(values[i] + share * (values[i + 1] - values[i]))


# Piecewise polynomials resolve any piecewise smooth function to machine precision, as plain numbers.

_DEGREE = 15
_NARROWEST = 2.0**-12  # in s
_REMAINING = 1e-12  # of the largest value


@dataclass(frozen=True)
class Pieces(_Kind):
    """A Legendre series of the given degree on each piece between `edges`."""

    kind = "pieces"
    edges: tuple[float, ...]  # 0 to 1
    degree: int
    coefficients: tuple[float, ...]  # (P * (degree + 1),), piece after piece
    jumps: tuple[float, ...] = ()  # edges where value or slope jumps

    def __post_init__(self) -> None:
        if len(self.edges) < 2 or self.edges[0] != 0.0 or self.edges[-1] != 1.0 or np.any(np.diff(self.edges) <= 0.0):
            raise MechanicsError("the edges of pieces must rise from 0 to 1")
        if self.degree < 0 or len(self.coefficients) != (len(self.edges) - 1) * (self.degree + 1):
            raise MechanicsError(
                f"{len(self.edges) - 1} pieces of degree {self.degree} need "
                f"{(len(self.edges) - 1) * (self.degree + 1)} coefficients, got {len(self.coefficients)}"
            )
        if not set(self.jumps) <= set(self.edges[1:-1]):
            raise MechanicsError("pieces can jump at their inner edges only")

    def __call__(self, s: Array | float) -> Array:
        places, edges = np.asarray(s, dtype=float), np.asarray(self.edges)
        piece = np.searchsorted(edges[1:-1], places, side="right")
        x = 2.0 * (places - edges[piece]) / np.diff(edges)[piece] - 1.0
        series = np.asarray(self.coefficients).reshape(-1, self.degree + 1)
        values = np.sum(np.polynomial.legendre.legvander(x, self.degree) * series[piece], axis=-1)
        return np.asarray(values).reshape(places.shape)


def in_pieces(
    function: Callable[[Array], Array], breaks: tuple[float, ...] = (), *, jumps: tuple[float, ...] = ()
) -> Pieces:
    """A function of s as pieces, cut at `breaks` and `jumps`, halved to `_REMAINING`.

    Raises `MechanicsError`: values that are not finite, or an unlisted jump.
    """
    inner = sorted({b for b in (*breaks, *jumps) if 0.0 < b < 1.0})
    x = np.polynomial.legendre.leggauss(_DEGREE + 1)[0]
    to_series = np.linalg.inv(np.polynomial.legendre.legvander(x, _DEGREE))
    stops, edges, rows = [*inner, 1.0], [0.0], []
    scale = float(np.max(np.abs(function(np.linspace(0.0, 1.0, 101)))))
    while stops:
        a, b = edges[-1], stops[0]
        values = function(0.5 * (a + b) + 0.5 * (b - a) * x)
        if not np.all(np.isfinite(values)):
            raise MechanicsError(f"the profile is not finite between s = {a:.6g} and {b:.6g}")
        row = to_series @ values
        if np.max(np.abs(row[-2:])) <= _REMAINING * scale:
            edges.append(stops.pop(0))
            rows.append(row)
        elif b - a > _NARROWEST:
            stops.insert(0, 0.5 * (a + b))
        else:
            raise MechanicsError(f"the profile jumps near s = {a:.4f}: give that place as a break")
    return Pieces(tuple(edges), _DEGREE, tuple(np.concatenate(rows).tolist()), tuple(j for j in inner if j in jumps))


@dataclass(frozen=True)
class Uniform(_Kind):
    kind = "uniform"
    value: float

    def __call__(self, s: Array | float) -> Array:
        return np.full(np.shape(s), float(self.value))


@dataclass(frozen=True)
class Gaussians(_Kind):
    """`k(s) = sum_w gamma_w Pi_w(s)` with normalised Gaussians (15)."""

    kind = "gaussians"
    centres: tuple[float, ...]
    width: float  # sigma, in units of s
    coefficients: tuple[float, ...]  # N m

    def __post_init__(self) -> None:
        if not self.width > 0.0:
            raise MechanicsError(f"the Gaussians' width must be positive, got {self.width}")
        if len(self.centres) != len(self.coefficients):
            raise MechanicsError(f"{len(self.centres)} centres but {len(self.coefficients)} coefficients")

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(gaussian_basis(s, self.centres, self.width) @ np.asarray(self.coefficients))


@dataclass(frozen=True)
class Powers(_Kind):
    """`k(s) = sum_w gamma_w s^w` (12)."""

    kind = "powers"
    coefficients: tuple[float, ...]  # N m

    def __call__(self, s: Array | float) -> Array:
        return np.asarray(np.polynomial.polynomial.polyval(np.asarray(s, dtype=float), np.asarray(self.coefficients)))


@dataclass(frozen=True)
class Table(_Kind):
    """Monotone cubic between values at places, constant beyond."""

    kind = "table"
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


@dataclass(frozen=True)
class Steps(_Kind):
    """`values[i]` between `edges[i]` and `edges[i + 1]`; edges run from 0 to 1."""

    kind = "steps"
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


@dataclass(frozen=True)
class LogSpline(_Kind):
    """`log k(s)` as a B-spline, plus `offset`."""

    kind = "log-spline"
    knots: tuple[float, ...]  # with repeated ends, as for scipy's BSpline
    coefficients: tuple[float, ...]  # of log(k / (N m))
    degree: int = 3
    offset: Polyline | None = None  # known part of log k, from the section

    def __call__(self, s: Array | float) -> Array:
        s = np.asarray(s, dtype=float)
        return np.asarray(np.exp(self._spline(s) + (0.0 if self.offset is None else self.offset(s))))

    @cached_property
    def _spline(self) -> BSpline:
        return BSpline(np.asarray(self.knots), np.asarray(self.coefficients), self.degree)

    @property
    def jumps(self) -> tuple[float, ...]:
        return () if self.offset is None else self.offset.jumps


@dataclass(frozen=True)
class Scaled(_Kind):
    kind = "scaled"
    factor: float
    profile: Profile

    def __call__(self, s: Array | float) -> Array:
        return self.factor * self.profile(s)

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.profile.jumps


def knots_of(profile: Profile) -> tuple[float, ...]:
    """Places inside (0, 1) where a derivative jumps."""
    if isinstance(profile, Scaled):
        return knots_of(profile.profile)
    places = profile.s if isinstance(profile, Table) else profile.knots if isinstance(profile, LogSpline) else ()
    return tuple(sorted({float(place) for place in places if 0.0 < place < 1.0}))


def gaussian_basis(s: Array | float, centres: Array | tuple[float, ...], width: float) -> Array:
    """`s.shape + (m,)`: the Gaussians of (15), each of unit area over the real line."""
    z = (np.asarray(s, dtype=float)[..., None] - np.asarray(centres, dtype=float)) / width
    return np.asarray(np.exp(-0.5 * z**2) / (width * math.sqrt(2.0 * math.pi)))


def power_basis(s: Array | float, m: int) -> Array:
    """`s.shape + (m,)`: `s^0 .. s^(m-1)`."""
    return np.asarray(np.asarray(s, dtype=float)[..., None] ** np.arange(m))


def by_legendre(states: Array) -> Profile:
    """The profile with these Legendre coefficients."""
    if np.all(states[1:] == 0.0):
        return Uniform(float(states[0]))
    return Powers(tuple(np.linalg.solve(powers_to_legendre(len(states)), states).tolist()))


def equidistant(m: int) -> tuple[float, ...]:
    """Centres of m Gaussians from 0 to 1; the paper says only "equidistant"."""
    return tuple(float(c) for c in np.linspace(0.0, 1.0, m))


_FAMILIES = (Uniform, Gaussians, Powers, Table, Steps, LogSpline, Pieces, Polyline, Scaled)
_KINDS: dict[str, Callable[..., Profile]] = {family.kind: family for family in _FAMILIES}


def profile_from_dict(data: dict[str, Any]) -> Profile:
    """Inverse of `as_dict`. Raises `MechanicsError` for an unknown kind or a missing entry."""
    try:
        entries = {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
        inner = {key: profile_from_dict(value) for key, value in entries.items() if isinstance(value, dict)}
        return _KINDS[data["kind"]](**{key: value for key, value in (entries | inner).items() if key != "kind"})
    except (KeyError, TypeError) as error:
        raise MechanicsError(f"cannot make a profile of kind {data.get('kind')!r}: {error}") from error


# Stretch and shear of a solid rectangular section, from k(s) and one thickness. With EI = k L, I = A h^2 / 12, shear
# factor 5/6 (Timoshenko) and G = E / (2 (1 + nu)):
#
#     EA = 12 k L / h^2,   kGA = 5/6 EA / (2 (1 + nu)),   h(s) = h0 (k / mean k)^p
#
# p = 1/3 where the thickness varies, 0 where the width does.

POISSON = 0.48  # silicone, rubber: 0.45 to 0.5
SHEAR_FACTOR = 5.0 / 6.0  # of a rectangle


@dataclass(frozen=True)
class RectangularSection:
    """Thickness in the plane of bending, and the dimension that varies."""

    thickness: float | Array  # h0, m, where k is its mean: a number, or (T, 1) for T beams
    poisson: float = POISSON  # nu
    varies: Literal["thickness", "width"] = "thickness"
    share: float = 1.0  # factor on stretch and shear

    def __post_init__(self) -> None:
        if not np.all(np.asarray(self.thickness) > 0.0):
            raise MechanicsError(f"a section's thickness must be positive, got {np.min(self.thickness):.3g} m")
        if not -1.0 < self.poisson <= 0.5:
            raise MechanicsError(f"Poisson's ratio lies in (-1, 0.5], got {self.poisson:g}")
        if self.varies not in ("thickness", "width"):
            raise MechanicsError(f"k(s) varies with 'thickness' or 'width', got {self.varies!r}")

    def take(self, chosen: IntArray | BoolArray) -> RectangularSection:
        h = self.thickness
        return self if np.ndim(h) == 0 else replace(self, thickness=np.asarray(h)[chosen])

    @property
    def exponent(self) -> float:
        """p of `h = h0 (k / mean k)^p`."""
        return 1.0 / 3.0 if self.varies == "thickness" else 0.0

    def compliance(self, k: Array, weights: Array, length: Array) -> tuple[Array, Array]:
        """1/EA and 1/kGA [1/N] at nodes with quadrature `weights` (Q,) or (T, Q); `length` () or (T, 1) m."""
        squared = self.share * np.asarray(self.thickness) ** 2
        if self.exponent:
            squared = squared * np.cbrt(k / _mean(k, weights)) ** 2
        stretch = np.asarray(squared / (12.0 * length * k))
        return stretch, stretch * (2.0 * (1.0 + self.poisson) / SHEAR_FACTOR)

    def log_by_stiffness(self, k: Array, weights: Array, functions: Array) -> Array:
        """(Q, P) or (T, Q, P): d log(1/EA) = d log(1/kGA) for coefficients of functions added to k [N m],
        `(2 p - 1) dk / k - 2 p d(mean k) / mean k`."""
        out = (2.0 * self.exponent - 1.0) * functions / k[..., None]
        if self.exponent:
            mean = _mean(functions, weights[..., None], axis=-2) / _mean(k, weights)[..., None]
            out = out - 2.0 * self.exponent * mean
        return np.asarray(out)


def common_section(sections: Sequence[RectangularSection | None]) -> RectangularSection | None:
    """One section for a batch, with thickness (T, 1) where beams differ in it; None if no beam has one.

    Raises `MechanicsError`: only some have one, or they differ otherwise.
    """
    first, *others = sections
    if first is None or not others or all(other == first for other in others):
        if any(other is not None for other in others) and first is None:
            raise MechanicsError("some beams of the batch have a thickness, others none: solve them apart")
        return first
    if any(o is None or (o.poisson, o.varies) != (first.poisson, first.varies) for o in others):
        raise MechanicsError("beams of one batch share Poisson's ratio and what varies; solve the others apart")
    return replace(first, thickness=np.array([[o.thickness] for o in (first, *others) if o is not None]))


def _mean(values: Array, weights: Array, axis: int = -1) -> Array:
    return np.asarray(np.sum(weights * values, axis=axis, keepdims=True))


# Uncertain k(s): mean and covariance of the spline coefficients of log k(s), and the shape of bands that are not
# normal.

SHAPE_LEVELS = np.array([0.5, 0.8, 0.95])  # of the bands in `UncertainStiffness.shape`
SHAPE_PLACES = np.linspace(0.0, 1.0, 41)  # s
IDENTIFIED_SD = 0.2  # of log k: to within half of k (95 %)


def half_width_words(half: float) -> str:
    """ "± 7.4 %", or "a factor of 2.4" for wide bands."""
    share = 100.0 * float(np.expm1(half))
    if share >= 99.5:
        return f"a factor of {np.exp(half):.2g}"
    decimals = 0 if share >= 9.95 else 1 if share >= 0.995 else 2
    return f"± {share:.{decimals}f} %"


def half_width(sd: Array | float, level: float = 0.95) -> Array:
    """Half the distance between the normal quantiles at `level`."""
    return np.asarray(ndtri(0.5 + 0.5 * level) * sd)


@dataclass(frozen=True)
class Band:
    """k(s) and its band at places (S,)."""

    s: Array
    k: Array  # N m
    low: Array  # N m
    high: Array  # N m
    identified: BoolArray  # False where the prior sets the band, or k(s) is in doubt


@dataclass(frozen=True, repr=False)
class UncertainStiffness:
    """`log k(s) = o(s) + sum_i c_i B_i(s) + g`: known `offset` o, coefficients c, common log scale g of sd `gain_sd`.

    With a possible step log k is a mixture: its 50 % band is narrower than a normal's by `shape`. Draws are normal.
    """

    knots: Array  # with repeated ends, as for scipy's BSpline
    mean: Array  # (p,) of coefficients, log(N m)
    covariance: Array  # (p, p)
    gain_sd: float = 0.0  # from the force's gain
    degree: int = 3
    doubts: tuple[str, ...] = ()  # if any, no place counts as identified
    # (levels, S) widths of the bands over those of a normal, at SHAPE_LEVELS and SHAPE_PLACES; None: all 1
    shape: Array | None = None
    offset: Polyline | None = None  # of log k, from the stated section
    # `E(s) I(s) / L` with the stated I, if k(s) was learned as modulus times section: k(s) also includes the section's
    # errors
    nominal: UncertainStiffness | None = None

    def __post_init__(self) -> None:
        count = len(self.mean)
        if self.shape is not None and self.shape.shape != (len(SHAPE_LEVELS), len(SHAPE_PLACES)):
            raise MechanicsError(
                f"the bands' shape must be ({len(SHAPE_LEVELS)}, {len(SHAPE_PLACES)}), got {self.shape.shape}"
            )
        if self.covariance.shape != (count, count) or len(self.knots) != count + self.degree + 1:
            raise MechanicsError(
                f"{count} coefficients need a ({count}, {count}) covariance and {count + self.degree + 1} knots, "
                f"got {self.covariance.shape} and {len(self.knots)}"
            )

    def __repr__(self) -> str:
        s = np.linspace(0.0, 1.0, 201)
        (mean, _), width = self.log_at(s), half_width_words(float(np.median(self.half_width(s))))
        k, doubts = np.exp(mean), f", doubts: {'; '.join(self.doubts)}" if self.doubts else ""
        return f"UncertainStiffness(k={k.min():.3g} to {k.max():.3g} N m, {width} (95 %, median){doubts})"

    @property
    def profile(self) -> LogSpline:
        """The most probable k(s)."""
        return self.profile_of(self.mean)

    def log_at(self, s: Array) -> tuple[Array, Array]:
        """(S,) mean and sd of log k, without the common scale."""
        basis = self.basis(s)
        mean = basis @ self.mean + (0.0 if self.offset is None else self.offset(s))
        return mean, np.sqrt(np.sum((basis @ self.covariance) * basis, axis=1))

    @one_blas_thread
    def band(self, s: Array, level: float = 0.95) -> Band:
        """k(s) and its `level` band, with the common scale."""
        mean, sd = self.log_at(s)
        wide = self.half_width(s, level)
        return Band(s, np.exp(mean), np.exp(mean - wide), np.exp(mean + wide), (sd < IDENTIFIED_SD) & (not self.doubts))

    def best_known(self, s: Array) -> BoolArray:
        """(S,) where k is identified, else the best quarter; ignores doubts. For axes of pictures."""
        sd = self.log_at(s)[1]
        known = sd < IDENTIFIED_SD
        return np.asarray(known if np.any(known) else sd <= np.quantile(sd, 0.25))

    def half_width(self, s: Array, level: float = 0.95) -> Array:
        """(S,) half-width of the band of log k, with the common scale."""
        return half_width(np.hypot(self._widening(s, level) * self.log_at(s)[1], self.gain_sd), level)

    def log_covariance(self, s: Array, level: float = 0.95) -> Array:
        """(S, S) covariance of log k without the common scale, scaled to the band at `level`."""
        root = np.asarray(self._widening(s, level))[..., None] * self.basis(s)
        return np.asarray(root @ self.covariance @ root.T)

    def _widening(self, s: Array, level: float) -> Array | float:
        """(S,) width of the band over that of a normal."""
        if self.shape is None:
            return 1.0
        at_places = [np.interp(level, SHAPE_LEVELS, widths) for widths in self.shape.T]
        return np.asarray(np.interp(s, SHAPE_PLACES, at_places))

    def draw(self, count: int, *, seed: int) -> tuple[LogSpline, ...]:
        """Random k(s), reproducible by seed on every machine."""
        rng = np.random.default_rng(seed)
        values, vectors = np.linalg.eigh(self.covariance)
        # independent of sign and order of the vectors
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        drawn = self.mean + rng.standard_normal((count, len(self.mean))) @ root.T
        drawn += self.gain_sd * rng.standard_normal((count, 1))
        return tuple(self.profile_of(c) for c in drawn)

    def profile_of(self, coefficients: Array) -> LogSpline:
        """k(s) of these coefficients (p,)."""
        return LogSpline(tuple(self.knots.tolist()), tuple(coefficients.tolist()), self.degree, self.offset)

    def basis(self, s: Array) -> Array:
        """(S, p) values of the splines."""
        s = np.clip(np.asarray(s, dtype=float), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(s, self.knots, self.degree).toarray())

    def as_dict(self) -> dict[str, Any]:
        return _plain_fields(self)

    @staticmethod
    def from_dict(data: dict[str, Any]) -> UncertainStiffness:
        """Inverse of `as_dict`. Raises `MechanicsError` for wrong sizes or numbers that are not finite."""
        arrays = [np.asarray(data[key], dtype=float) for key in ("knots", "mean", "covariance")]
        shape = None if data.get("shape") is None else np.asarray(data["shape"], dtype=float)
        arrays += [] if shape is None else [shape]
        if not all(np.all(np.isfinite(array)) for array in arrays) or not float(data["gain_sd"]) >= 0.0:
            raise MechanicsError("an uncertain stiffness holds numbers that are not finite")
        doubts = tuple(map(str, data.get("doubts", ())))  # absent in older models, as is the shape
        gain_sd, degree = float(data["gain_sd"]), int(data["degree"])
        offset = profile_from_dict(data["offset"]) if "offset" in data else None
        if not (offset is None or isinstance(offset, Polyline)):
            raise MechanicsError("the offset of an uncertain stiffness is no polyline")
        nominal = UncertainStiffness.from_dict(data["nominal"]) if "nominal" in data else None
        return UncertainStiffness(arrays[0], arrays[1], arrays[2], gain_sd, degree, doubts, shape, offset, nominal)
