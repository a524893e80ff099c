"""What the beam's own weight does in the fit, where somebody knows how the mass is spread: then one number is learned.

A bar of one material whose size in the plane of bending varies has `k ~ w^3` and mass per metre `mu ~ w`, so
`mu ~ k^(1/3)`; one whose size across the plane varies has `mu ~ k`; one whose two sizes go together (a round rod, a
cone) `mu ~ k^(1/2)`. k(s) then carries the mass with it: `mu = (mass / L) k^p / int k^p ds`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import Grid
from onebend.beam.profiles.stiffness import LogSpline, Profile, Uniform
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.nodal_beam import riding_beyond
from onebend.beam.statics.perturbation import Perturbation
from onebend.beam.statics.problem import Problem
from onebend.beam.statics.sensitivity import of_mass
from onebend.learning.allowances.allowance import Allowance
from onebend.records import Array, Observations

POWERS = {"even": 0.0, "width": 1.0 / 3.0, "thickness": 1.0, "both": 0.5}  # p of `mu ~ k^p`


@dataclass(frozen=True)
class OwnWeight:
    """The weight of one film's frames: F frames, Q nodes, the four parts of the mass (`parameters.layout`)."""

    gravity: Array  # (F, 2) m/s^2
    modes: Array  # (Q, 4) or (F, Q, 4) kg/m per unit of each part
    weights: Array  # (Q,) or (F, Q) of the nodes
    power: float | None  # of k, where the mass follows it; None: it does not, and what is written is no part of this

    def force(self, problem: Problem, k: Array, parts: Array) -> Array:
        """(F, Q, 2) N beyond each node."""
        return _beyond(problem, self.line(k, parts)[..., None], self.gravity)[..., 0]

    def line(self, k: Array, parts: Array) -> Array:
        """(Q,) or (F, Q) kg/m at the nodes, without what is written where the mass does not follow k."""
        if self.power is not None:
            parts = parts + np.eye(len(parts))[0]
        return np.asarray(self.line_by_mass(k) @ parts)

    def by_mass(self, problem: Problem, k: Array) -> Perturbation:
        """Derivatives with the four parts."""
        return of_mass(problem, self.line_by_mass(k), self.gravity)

    def by_stiffness(self, problem: Problem, k: Array, functions: Array, parts: Array) -> Array | None:
        """(F, Q, 2, p) N, derivatives with the coefficients of log k of `functions` (Q, p) or (F, Q, p)."""
        by_k = self.line_by_stiffness(k, functions, parts)
        return None if by_k is None else _beyond(problem, by_k, self.gravity)

    def line_by_stiffness(self, k: Array, functions: Array, parts: Array) -> Array | None:
        """(Q, p) or (F, Q, p) kg/m, derivatives as above; None where the mass does not follow k."""
        if not self.power:
            return None
        line = (1.0 + parts[0]) * self.line_by_mass(k)[..., 0]
        share = self.weights * line / np.sum(self.weights * line, axis=-1, keepdims=True)
        mean = np.sum(share[..., None] * functions, axis=-2, keepdims=True)
        return np.asarray(self.power * line[..., None] * (functions - mean))

    def line_by_mass(self, k: Array) -> Array:
        """(Q, 4) or (F, Q, 4) kg/m at the nodes per unit of each part."""
        if self.power is None:
            return self.modes
        share = k**self.power
        share = share / np.sum(self.weights * share, axis=-1, keepdims=True)
        modes = np.broadcast_to(self.modes, (*share.shape, self.modes.shape[-1])).copy()
        modes[..., 0] *= share
        return modes


def own_weight(o: Observations, grid: Grid, gravity: Array, even: Array, written: Profile) -> OwnWeight:
    """Of a recording whose mass is known or guessed; `even` (Q, 4) or (F, Q, 4): Legendre functions at the nodes."""
    modes = o.stated.mass / o.length * even
    if o.stated.mass_along in ("section", "table"):  # the whole of it is heavier or lighter
        modes = np.concatenate([np.asarray(written(grid.nodes))[..., None], modes[..., 1:]], axis=-1)
    return OwnWeight(gravity, modes, grid.weights, POWERS.get(o.stated.mass_along))


def gravity_direction(o: Observations, problem: Problem, gravity: Array, written: Profile) -> Allowance | None:
    """Gravity (F, 2) turned by one angle [rad] in all frames, to first order; None where nothing weighs, of static
    poses, and where the direction is exact. `written`: kg/m."""
    if o.static or not o.stated.gravity_sd > 0.0 or not np.any(gravity):
        return None
    nodes = problem.grid.nodes
    beyond = _beyond(problem, np.asarray(written(nodes))[..., None], gravity)[..., 0]
    beyond = beyond + riding_beyond(nodes, o.stated.masses)[..., None] * gravity[:, None, :]
    turned = np.stack([-beyond[..., 1], beyond[..., 0]], axis=-1)
    sd = np.array([o.stated.gravity_sd])
    return Allowance("gravity direction", "load", "rad", ("gravity's direction",), sd, turned[..., None])


def following(o: Observations, stiffness: UncertainStiffness, mass: float) -> Profile | None:
    """kg/m of `mass` [kg] where it follows k(s); None where it does not."""
    power = POWERS.get(o.stated.mass_along)
    if power is None:
        return None
    if power == 0.0:
        return Uniform(mass / o.length)
    s = np.linspace(0.0, 1.0, 2001)
    total = float(np.trapezoid(stiffness.profile(s) ** power, s))
    logs = power * stiffness.mean + np.log(mass / o.length / total)
    offset = stiffness.offset
    if offset is not None:
        offset = replace(offset, values=tuple(power * value for value in offset.values))
    return LogSpline(tuple(stiffness.knots.tolist()), tuple(logs.tolist()), stiffness.degree, offset)


def _beyond(problem: Problem, line: Array, gravity: Array) -> Array:
    force = of_mass(problem, line, gravity).force
    assert force is not None
    return force
