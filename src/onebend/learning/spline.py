"""log k(s) as a cubic B-spline with a smoothness prior.

The prior says that the second derivative of log k is white noise of size `tau` (an integrated Wiener process), on top
of a broad prior for level and slope. `tau` is chosen by the evidence: rough data earn a rough k, and where nothing is
seen the band opens as the prior does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline

from onebend.records import Array

LEVEL_SD = 4.0  # of log k: a factor of 55 either way around the start
SLOPE_SD = 3.0  # of log k from clamp to tip: a factor of 20 either way
_DEGREE = 3


@dataclass(frozen=True)
class Spline:
    """`count` B-splines on equal intervals of [0, 1]."""

    count: int = 16

    @cached_property
    def knots(self) -> Array:
        """With the ends repeated."""
        inner = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        return np.concatenate([np.zeros(_DEGREE), inner, np.ones(_DEGREE)])

    def basis(self, s: Array) -> Array:
        """`s.shape + (count,)`."""
        flat = np.clip(np.ravel(s), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(flat, self.knots, _DEGREE).toarray().reshape(*np.shape(s), self.count))

    def precision(self, tau: float) -> Array:
        """(count, count) of the coefficients' prior."""
        return self._roughness / tau**2 + self._level_and_slope

    @cached_property
    def _roughness(self) -> Array:
        """`int b_i'' b_j'' ds`: linear pieces, exact with two Gauss points a piece."""
        x, w = np.polynomial.legendre.leggauss(2)
        edges = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        h = edges[1] - edges[0]
        nodes = (edges[:-1, None] + 0.5 * h * (x + 1.0)).ravel()
        second = np.stack([BSpline(self.knots, e, _DEGREE).derivative(2)(nodes) for e in np.eye(self.count)], axis=1)
        return np.asarray(second.T @ (np.tile(0.5 * h * w, len(edges) - 1)[:, None] * second))

    @cached_property
    def _level_and_slope(self) -> Array:
        """Broad prior of mean and least-squares slope of log k."""
        s = np.linspace(0.0, 1.0, 101)
        basis = self.basis(s)
        level = basis.mean(axis=0)
        slope = ((s - 0.5) @ basis) / np.sum((s - 0.5) ** 2)
        return np.asarray(np.outer(level, level) / LEVEL_SD**2 + np.outer(slope, slope) / SLOPE_SD**2)
