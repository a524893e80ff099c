"""log k(s) as a cubic B-spline with a smoothness prior.

The prior is a sum of four: a broad one for level and slope; a smooth part whose second derivative is white noise of
size `tau` (an integrated Wiener process); steps from each coefficient to the next (glued pieces); and bumps that are
three or four coefficients wide (joints, nodes of a stem). Where all steps are taken to be alike they are a random walk
of size `rho`, without bumps; where each has a size of its own, see `stiffness_prior.py`. Rough data earn a rough k,
and where nothing is seen the band opens as the prior does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import null_space

from onebend.records import Array

LEVEL_SD = 4.0  # of log k: a factor of 55 either way around the start
SLOPE_SD = 3.0  # of log k from clamp to tip: a factor of 20 either way
TAU, RHO = 8.0, 0.3  # roughness and steps of log k that are expected, where all steps are taken to be alike
SPREAD = 1.2  # one sd of their logs: a factor of ten either way
_DEGREE = 3
_BUMP = 1.5 / 8.0 * np.array([1.0, 4.0, 6.0, 4.0, 1.0])  # a cubic B-spline on intervals twice as long, of height one
_WITHIN = 20  # places of a step between two coefficients that are averaged over


@dataclass(frozen=True)
class Spline:
    """`count` B-splines on equal intervals of [0, 1]."""

    count: int

    @cached_property
    def knots(self) -> Array:
        """With the ends repeated."""
        inner = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        return np.concatenate([np.zeros(_DEGREE), inner, np.ones(_DEGREE)])

    def basis(self, s: Array) -> Array:
        """`s.shape + (count,)`."""
        flat = np.clip(np.ravel(s), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(flat, self.knots, _DEGREE).toarray().reshape(*np.shape(s), self.count))

    def nearest(self, function: Callable[[Array], Array]) -> Array:
        """(count, ...) coefficients of the least squares nearest to a function of places s (S,), (S, ...)."""
        s = np.linspace(0.0, 1.0, 8 * self.count)
        return np.asarray(np.linalg.lstsq(self.basis(s), function(s), rcond=None)[0])

    def precision(self, tau: float, rho: float) -> Array:
        """(count, count) of the coefficients' prior: a smooth part of roughness tau plus steps of size rho."""
        return self.precision_of(self.variances(tau, rho))

    def precision_of(self, variances: Array) -> Array:
        """(count, count) of the coefficients' prior, from the variances (n,) of its parts."""
        return np.asarray(np.linalg.inv((self.parts * variances) @ self.parts.T))

    def variances(self, tau: float | Array, rho: float | Array) -> Array:
        """`tau.shape + (n,)` of the parts: level, slope, the smooth part's `count - 2`, `count - 1` steps, no bumps."""
        out = np.zeros((*np.shape(tau), 3 * self.count - 1))
        out[..., 0], out[..., 1] = LEVEL_SD**2, SLOPE_SD**2
        out[..., 2 : self.count] = np.square(tau)[..., None]
        out[..., self.count : 2 * self.count - 1] = np.square(rho)[..., None] * self.gaps
        return out

    @cached_property
    def gaps(self) -> Array:
        """(count - 1,) distances of the places of the coefficients."""
        return np.diff(self._places)

    @cached_property
    def parts(self) -> Array:
        """(count, n) coefficients of the independent parts that log k is the sum of."""
        s = np.linspace(0.0, 1.0, 101)
        basis = self.basis(s)
        level, slope = basis.mean(axis=0), ((s - 0.5) @ basis) / np.sum((s - 0.5) ** 2)
        both = np.stack([level, slope])
        line = np.stack([np.ones(self.count), self._places - 0.5], axis=1)
        bent = null_space(both)
        values, vectors = np.linalg.eigh(bent.T @ self._bending @ bent)
        steps = np.tril(np.ones((self.count, self.count)), -1)[:, :-1]
        wide = len(_BUMP) // 2
        bumps = sum(height * np.eye(self.count, k=i - wide) for i, height in enumerate(_BUMP))
        local = np.concatenate([steps, bumps], axis=1)
        return np.concatenate(
            [line @ np.linalg.inv(both @ line), bent @ vectors / np.sqrt(values), local - level @ local], axis=1
        )

    @cached_property
    def share(self) -> Array:
        """(2 count - 1,) of the beam that each step and each bump stands for."""
        return np.concatenate([self.gaps, np.full(self.count, 1.0 / self.count)])

    @cached_property
    def finer(self) -> Spline:
        """The splines on intervals half as long."""
        return Spline(2 * (self.count - _DEGREE) + _DEGREE)

    @cached_property
    def on_finer(self) -> Array:
        """(count of the finer, count): the same functions by the finer ones' coefficients."""
        return self.finer.nearest(self.basis)

    @cached_property
    def unseen(self) -> Array:
        """(count - 1, f, f) covariance, by the f finer ones, of what the spline shows as a slope from one coefficient
        to the next and is a step of size 1 that may be anywhere between them."""
        at = self.finer._places
        whole = self.basis(at)
        out = []
        for i in range(self.count - 1):
            where = np.linspace(self._places[i], self._places[i + 1], 2 * _WITHIN + 1)[1::2]
            away = (at > where[:, None]) - whole[:, i + 1 :].sum(axis=1)
            out.append(away.T @ away / _WITHIN)
        return np.stack(out)

    @cached_property
    def _places(self) -> Array:
        """(count,) where the coefficients act (Greville)."""
        return np.array([np.mean(self.knots[i + 1 : i + 1 + _DEGREE]) for i in range(self.count)])

    @cached_property
    def _bending(self) -> Array:
        """(count, count) `int b_i'' b_j'' ds`: exact with four Gauss points a piece."""
        x, w = np.polynomial.legendre.leggauss(4)
        edges = np.linspace(0.0, 1.0, self.count - _DEGREE + 1)
        h = edges[1] - edges[0]
        nodes = (edges[:-1, None] + 0.5 * h * (x + 1.0)).ravel()
        each = np.stack([BSpline(self.knots, e, _DEGREE).derivative(2)(nodes) for e in np.eye(self.count)], axis=1)
        return np.asarray(each.T @ (np.tile(0.5 * h * w, len(edges) - 1)[:, None] * each))
