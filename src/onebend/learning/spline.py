"""log k(s) as a cubic B-spline with a smoothness prior.

The prior is a sum of three: a broad one for level and slope; a smooth part whose second derivative is white noise of
size `tau` (an integrated Wiener process); and steps, whose first derivative is white noise of size `rho` (a Wiener
process: glued pieces, joints). The evidence chooses both sizes: rough data earn a rough k, and where nothing is seen
the band opens as the prior does.
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
_PINNED = 0.01  # of the mean of the steps: the level has its own prior


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

    def precision(self, tau: float, rho: float) -> Array:
        """(count, count) of the coefficients' prior: a smooth part of roughness tau plus steps of size rho."""
        smooth = np.linalg.inv(self._bending / tau**2 + self._level_and_slope)
        steps = np.linalg.inv(self._slopes / rho**2 + np.outer(self._level, self._level) / _PINNED**2)
        return np.asarray(np.linalg.inv(smooth + steps))

    @cached_property
    def _bending(self) -> Array:
        """`int b_i'' b_j'' ds`."""
        return self._squares(2)

    @cached_property
    def _slopes(self) -> Array:
        """`int b_i' b_j' ds`."""
        return self._squares(1)

    def _squares(self, order: int) -> Array:
        """(count, count) integrals of products of derivatives: exact with four Gauss points a piece."""
        x, w = np.polynomial.legendre.leggauss(4)
        edges = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        h = edges[1] - edges[0]
        nodes = (edges[:-1, None] + 0.5 * h * (x + 1.0)).ravel()
        each = np.stack([BSpline(self.knots, e, _DEGREE).derivative(order)(nodes) for e in np.eye(self.count)], axis=1)
        return np.asarray(each.T @ (np.tile(0.5 * h * w, len(edges) - 1)[:, None] * each))

    @cached_property
    def _level(self) -> Array:
        """(count,) weights of the mean of log k."""
        return np.asarray(self.basis(np.linspace(0.0, 1.0, 101)).mean(axis=0))

    @cached_property
    def _level_and_slope(self) -> Array:
        """Broad prior of mean and least-squares slope of log k."""
        s = np.linspace(0.0, 1.0, 101)
        slope = ((s - 0.5) @ self.basis(s)) / np.sum((s - 0.5) ** 2)
        return np.asarray(np.outer(self._level, self._level) / LEVEL_SD**2 + np.outer(slope, slope) / SLOPE_SD**2)
