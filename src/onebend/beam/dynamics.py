"""The equation of motion (7) in curvature coordinates, on Gauss panels.

The curvature is `q(s, t) = q0(s) + sum_i theta_i(t) phi_i(s)`. With `alpha = rest + A theta` at the nodes and the
velocity `v = L int u' alpha'`:

    T = 1/2 sum_ij H_ij cos(alpha_i - alpha_j) alpha'_i alpha'_j + 1/2 sum_i D_i alpha'_i^2
    H = L^3 R^T diag(w mu) R,   D = w L iota                                    (R integrates from the base to a node)

    B = A^T (H o cos(alpha_i - alpha_j) + diag D) A,   K = int k phi phi^T,   D_theta = int d phi phi^T
    C = A^T (H o sin(alpha_i - alpha_j)) diag(alpha') A,   G = -L^2 A^T (R^T (w mu) o u'.g)

The beam neither stretches nor shears and is linear-elastic with Kelvin-Voigt damping; centres of mass lie on r(s).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.grid import Grid, Modes, make_grid
from onebend.beam.problem import Resolution, Rod, refuse_section
from onebend.beam.stiffness import Profile, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, PointMass

_NONE = Uniform(0.0)


@dataclass(frozen=True)
class Body:
    """See `body`: n coordinates, Q nodes."""

    length: float  # L, m
    grid: Grid
    curvature: Array  # (Q, n): phi_i at the nodes
    to_angle: Array  # (Q, n): A
    rest_curvature: Array  # (Q,) rad: q0
    rest_angle: Array  # (Q,) rad: alpha at theta = 0
    clamp_angle: float  # rad
    carried: Array  # (Q, Q) kg m^2: H
    lever: Array  # (Q,) kg m
    rotary: Array  # (Q,) kg m^2: D
    mass: float  # kg
    stiffness: Array  # (n, n) N m: K
    damping: Array  # (n, n) N m s: D_theta

    @property
    def n(self) -> int:
        return int(self.to_angle.shape[1])

    def to_places(self, s: Array) -> Array:
        """(S, n)."""
        return np.asarray(self.grid.integral_to(np.asarray(s, dtype=float)) @ self.curvature)

    def angle(self, s: Array, theta: Array) -> Array:
        """(T, S) rad for states (T, n). Equation (3)."""
        rows = self.grid.integral_to(np.asarray(s, dtype=float))
        return np.asarray(self.clamp_angle + (self.rest_curvature + theta @ self.curvature.T) @ rows.T)

    def xy(self, s: Array, theta: Array) -> Array:
        """(T, S, 2) m for states (T, n). Equation (4)."""
        alpha = self.rest_angle + theta @ self.to_angle.T
        rows = self.length * self.grid.integral_to(np.asarray(s, dtype=float))
        return np.stack([np.cos(alpha) @ rows.T, np.sin(alpha) @ rows.T], axis=-1)


def body(
    beam: Rod,
    modes: Modes | None = None,
    *,
    rotary_inertia: Profile = _NONE,
    damping: Profile = _NONE,
    resolution: Resolution = Resolution(24),
    grid: Grid | None = None,
    points: Sequence[PointMass] = (),
) -> Body:
    """Tables of a beam in curvature modes, or in nodal curvatures if `modes` is None.

    Modes suit smooth k(s). Nodes resolve any k(s), with panels that end at its jumps and at point masses (the beam's
    and `points`). `rotary_inertia`: iota(s) = rho I, kg m. `damping`: d(s), N m s. `grid` replaces the grid made here.

    Raises `MechanicsError`: k or mu not positive, iota or d negative, a thickness, or a grid too coarse for the modes.
    """
    refuse_section(beam, "the equation of motion")
    profiles = (beam.stiffness, beam.rest_curvature, beam.mass_per_length, rotary_inertia, damping)
    riding = (*beam.masses, *points)
    jumps = (*(jump for profile in profiles for jump in profile.jumps), *(point.s for point in riding))
    if grid is None:
        grid = make_grid(jumps, order=resolution.order, widest=resolution.widest)
    if modes is not None and modes.n > grid.order:
        raise MechanicsError(f"{modes.n} modes need at least as many nodes a panel, got {grid.order}")
    nodes, weights = grid.nodes, grid.weights
    k, q0, mu, iota, d = (np.asarray(profile(nodes), dtype=float) for profile in profiles)
    _refuse(k > 0.0, "k(s)", k, nodes, "N m must be positive")
    _refuse(mu > 0.0, "mass per metre", mu, nodes, "kg/m must be positive: a beam without mass does not move by (7)")
    _refuse(iota >= 0.0, "rotary inertia", iota, nodes, "kg m cannot be negative")
    _refuse(d >= 0.0, "damping", d, nodes, "N m s cannot be negative")
    phi = np.eye(len(nodes)) if modes is None else modes.curvature(nodes)
    turned = beam.clamp_angle
    bare = body_of_nodes(grid, beam.length, k, mu, q0, clamp_angle=turned, rotary_inertia=iota, points=riding)
    return replace(
        bare,
        curvature=phi,
        to_angle=bare.to_angle @ phi,
        stiffness=phi.T @ ((weights * k)[:, None] * phi),
        damping=phi.T @ ((weights * d)[:, None] * phi),
    )


def body_of_nodes(
    grid: Grid,
    length: float,
    k: Array,
    mass_per_length: Array,
    rest_curvature: Array,
    *,
    clamp_angle: float = 0.0,
    rotary_inertia: Array | float = 0.0,
    points: Sequence[PointMass] = (),
) -> Body:
    """Undamped tables in nodal curvatures, from values (Q,).

    Raises `MechanicsError`: a point mass that is negative or off the beam.
    """
    weights, integral = grid.weights, grid.integral_to_nodes
    carried = length**3 * integral.T @ ((weights * mass_per_length)[:, None] * integral)
    lever = length**2 * integral.T @ (weights * mass_per_length)
    for point in points:
        if not (point.mass >= 0.0 and 0.0 <= point.s <= 1.0):
            raise MechanicsError(f"a point mass is 0 kg or more at s in [0, 1], got {point.mass} kg at {point.s}")
        row = length * grid.integral_to(np.array([point.s]))[0]
        carried, lever = carried + point.mass * np.outer(row, row), lever + point.mass * row
    return Body(
        length=length,
        grid=grid,
        curvature=np.eye(len(weights)),
        to_angle=integral,
        rest_curvature=rest_curvature,
        rest_angle=clamp_angle + integral @ rest_curvature,
        clamp_angle=clamp_angle,
        carried=carried,
        lever=lever,
        rotary=length * weights * rotary_inertia,
        mass=float(length * np.sum(weights * mass_per_length)) + sum(point.mass for point in points),
        stiffness=np.diag(weights * k),
        damping=np.zeros((len(weights), len(weights))),
    )


def mass_matrix(of: Body, theta: Array) -> Array:
    """(..., n, n) kg m^2, (7)."""
    alpha = of.rest_angle + np.asarray(theta, dtype=float) @ of.to_angle.T
    c, s = np.cos(alpha), np.sin(alpha)
    across = np.concatenate([c[..., None] * of.to_angle, s[..., None] * of.to_angle], axis=-1)  # (..., Q, 2 n)
    carried = of.carried @ across
    n = of.n
    out = np.swapaxes(across[..., :n], -1, -2) @ carried[..., :n]
    out += np.swapaxes(across[..., n:], -1, -2) @ carried[..., n:]
    return np.asarray(out + of.to_angle.T @ (of.rotary[:, None] * of.to_angle))


def _refuse(good: BoolArray, name: str, values: Array, nodes: Array, rule: str) -> None:
    if not np.all(good):
        bad = int(np.flatnonzero(~good)[0])
        raise MechanicsError(f"{name} = {values[bad]:.3g} at s = {nodes[bad]:.3f}: {rule}")


# Actions on a moving beam.

InTime = Callable[[float], ArrayLike]


@dataclass(frozen=True)
class AppliedForce:
    """At a fixed place: two numbers [N], or a function of time [s]."""

    value: ArrayLike | InTime
    at_s: float = 1.0
    breaks: tuple[float, ...] = ()  # s, times of jumps


@dataclass(frozen=True)
class Actions:
    forces: tuple[AppliedForce, ...] = ()
    gravity: ArrayLike = (0.0, 0.0)  # m/s^2

    def __post_init__(self) -> None:
        for force in self.forces:
            if not 0.0 <= force.at_s <= 1.0:
                raise MechanicsError(f"actions are at s in [0, 1], got s = {force.at_s}")
        if np.shape(self.gravity) != (2,) or not np.all(np.isfinite(np.asarray(self.gravity, dtype=float))):
            raise MechanicsError(f"gravity has two finite components [m/s^2], got {self.gravity}")

    @property
    def breaks(self) -> tuple[float, ...]:
        return tuple(sorted({time for force in self.forces for time in force.breaks}))

    @property
    def steady(self) -> bool:
        return not any(callable(force.value) for force in self.forces)


def acting(on: Body, actions: Actions, times: Array) -> Array:
    """(2, Q, R) N m at `times` (R,) s: x and y of the pull beyond each node with weight, times its lever.

    Raises `MechanicsError`: forces that are not finite.
    """
    pull = np.multiply.outer(np.asarray(actions.gravity, dtype=float), np.outer(on.lever, np.ones(len(times))))
    for force in actions.forces:
        lever = on.length * on.grid.integral_to(np.array([force.at_s]))[0]
        pull += np.multiply.outer(lever, _values(force.value, times)).transpose(2, 0, 1)
    return np.asarray(pull)


def _values(value: ArrayLike | InTime, times: Array) -> Array:
    raw = [value(float(t)) for t in times] if callable(value) else [value] * len(times)
    try:
        out = np.asarray(raw, dtype=float).reshape(len(times), 2)
    except (TypeError, ValueError) as error:
        raise MechanicsError(f"a force must be 2 numbers at every time: {error}") from error
    if not np.all(np.isfinite(out)):
        bad = times[np.flatnonzero(~np.all(np.isfinite(out), axis=1))[0]]
        raise MechanicsError(f"a force is not finite at t = {bad:.6g} s")
    return out
