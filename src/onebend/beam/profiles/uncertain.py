"""A stiffness distribution that is not known exactly: log k(s) as a spline, its coefficients' mean and covariance.

Where its bands differ from a normal's, their shape is known too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.special import ndtri

from onebend.beam.profiles.polyline import Polyline
from onebend.beam.profiles.stiffness import LogSpline, profile_from_dict
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray

SHAPE_LEVELS = np.array([0.5, 0.8, 0.95])  # of the bands that `UncertainStiffness.shape` holds
SHAPE_PLACES = np.linspace(0.0, 1.0, 41)  # s
IDENTIFIED_SD = 0.2  # of log k: beyond, k is not known to within half of itself either way (95 %)


def half_width_words(half: float) -> str:
    """Half a band of log k as people read it: "± 7.4 %", or "a factor of 2.4" where k may be twice as large."""
    share = 100.0 * float(np.expm1(half))
    if share >= 99.5:
        return f"a factor of {np.exp(half):.2g}"
    decimals = 0 if share >= 9.95 else 1 if share >= 0.995 else 2
    return f"± {share:.{decimals}f} %"


def half_width(sd: Array | float, level: float = 0.95) -> Array:
    """Half the width of the band between the quantiles of a normal of this sd that leave out `1 - level`."""
    return np.asarray(ndtri(0.5 + 0.5 * level) * sd)


@dataclass(frozen=True)
class Band:
    """k(s) and how sure it is, at places s (S,)."""

    s: Array
    k: Array  # N m
    low: Array  # N m
    high: Array  # N m
    identified: BoolArray  # False where the prior rather than the data sets the band, or k(s) is in doubt as a whole


@dataclass(frozen=True)
class UncertainStiffness:
    """`log k(s) = o(s) + sum_i c_i B_i(s) + g`: an `offset` o that is known, coefficients c, and one common log scale
    g, normal of sd `gain_sd`.

    Where k may have a step or not, log k is a mixture: its 50 % band is narrower than a normal's of the same sd.
    `shape` tells by how much; draws are normal.
    """

    knots: Array  # with the ends repeated, as scipy's BSpline takes them
    mean: Array  # (p,) of the coefficients, log(N m)
    covariance: Array  # (p, p)
    gain_sd: float = 0.0  # what an uncertain force gain does to all of k alike
    degree: int = 3
    doubts: tuple[str, ...] = ()  # why none of it is to be relied on: then no place counts as identified
    # (levels, S) widths of the bands of SHAPE_LEVELS at SHAPE_PLACES over those of a normal; None: all one
    shape: Array | None = None
    offset: Polyline | None = None  # of log k, where the section's shape is stated; None: zero
    # `E(s) I(s) / L` with I as stated, where k(s) was learned as a stated section's shape times a modulus: k(s) itself
    # also holds what that section is off by
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

    @property
    def profile(self) -> LogSpline:
        """The most probable k(s)."""
        return self._with(self.mean)

    def log_at(self, s: Array) -> tuple[Array, Array]:
        """(S,) mean and sd of log k at `s`, the common scale apart."""
        basis = self.basis(s)
        mean = basis @ self.mean + (0.0 if self.offset is None else self.offset(s))
        return mean, np.sqrt(np.sum((basis @ self.covariance) * basis, axis=1))

    @one_blas_thread
    def band(self, s: Array, level: float = 0.95) -> Band:
        """k(s) between the quantiles that leave out `1 - level`, half on either side; the common scale included."""
        mean, sd = self.log_at(s)
        wide = self.half_width(s, level)
        return Band(s, np.exp(mean), np.exp(mean - wide), np.exp(mean + wide), (sd < IDENTIFIED_SD) & (not self.doubts))

    def best_known(self, s: Array) -> BoolArray:
        """(S,) where the data tell k; where they tell it nowhere, the quarter of the places where they tell most.

        Doubts do not count: this is what the axes of a picture go by, that nothing else may stretch them.
        """
        sd = self.log_at(s)[1]
        known = sd < IDENTIFIED_SD
        return np.asarray(known if np.any(known) else sd <= np.quantile(sd, 0.25))

    def half_width(self, s: Array, level: float = 0.95) -> Array:
        """(S,) half the width of the band of log k, the common scale included: `k exp(+- this)` is the band of k."""
        return half_width(np.hypot(self._widening(s, level) * self.log_at(s)[1], self.gain_sd), level)

    def log_covariance(self, s: Array, level: float = 0.95) -> Array:
        """(S, S) covariance of log k at `s`, the common scale apart: of normals whose band at `level` is `band`'s."""
        root = np.asarray(self._widening(s, level))[..., None] * self.basis(s)
        return np.asarray(root @ self.covariance @ root.T)

    def _widening(self, s: Array, level: float) -> Array | float:
        """(S,) width of a band over that of a normal; beyond SHAPE_LEVELS as at the nearest of them."""
        if self.shape is None:
            return 1.0
        at_places = [np.interp(level, SHAPE_LEVELS, widths) for widths in self.shape.T]
        return np.asarray(np.interp(s, SHAPE_PLACES, at_places))

    def draw(self, count: int, *, seed: int) -> tuple[LogSpline, ...]:
        """Stiffness distributions as probable as this one says; a seed gives the same ones on every machine."""
        rng = np.random.default_rng(seed)
        values, vectors = np.linalg.eigh(self.covariance)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T  # the symmetric one: no sign or order is free
        drawn = self.mean + rng.standard_normal((count, len(self.mean))) @ root.T
        drawn += self.gain_sd * rng.standard_normal((count, 1))
        return tuple(self._with(c) for c in drawn)

    def _with(self, coefficients: Array) -> LogSpline:
        return LogSpline(tuple(self.knots.tolist()), tuple(coefficients.tolist()), self.degree, self.offset)

    def basis(self, s: Array) -> Array:
        """(S, p) the splines' values at `s`."""
        s = np.clip(np.asarray(s, dtype=float), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(s, self.knots, self.degree).toarray())

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "knots": self.knots.tolist(),
            "mean": self.mean.tolist(),
            "covariance": self.covariance.tolist(),
            "gain_sd": self.gain_sd,
            "degree": self.degree,
            "doubts": list(self.doubts),
            "shape": None if self.shape is None else self.shape.tolist(),
            **({} if self.offset is None else {"offset": self.offset.as_dict()}),
            **({} if self.nominal is None else {"nominal": self.nominal.as_dict()}),
        }

    @staticmethod
    def from_dict(data: dict[str, Any]) -> UncertainStiffness:
        """From `as_dict`. Raises `MechanicsError` where sizes do not fit or a number is not finite."""
        arrays = [np.asarray(data[key], dtype=float) for key in ("knots", "mean", "covariance")]
        shape = None if data.get("shape") is None else np.asarray(data["shape"], dtype=float)
        arrays += [] if shape is None else [shape]
        if not all(np.all(np.isfinite(array)) for array in arrays) or not float(data["gain_sd"]) >= 0.0:
            raise MechanicsError("an uncertain stiffness holds numbers that are not finite")
        doubts = tuple(map(str, data.get("doubts", ())))  # absent in models of before, as the shape
        gain_sd, degree = float(data["gain_sd"]), int(data["degree"])
        offset = profile_from_dict(data["offset"]) if "offset" in data else None
        if not (offset is None or isinstance(offset, Polyline)):
            raise MechanicsError("the offset of an uncertain stiffness is no polyline")
        nominal = UncertainStiffness.from_dict(data["nominal"]) if "nominal" in data else None
        return UncertainStiffness(arrays[0], arrays[1], arrays[2], gain_sd, degree, doubts, shape, offset, nominal)
