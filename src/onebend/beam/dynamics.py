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

    def angle(self, s: Array, theta: Array, base_angle: Array | float = 0.0) -> Array:
        """(T, S) rad for states (T, n), base turned by `base_angle` () or (T,). Equation (3)."""
        rows = self.grid.integral_to(np.asarray(s, dtype=float))
        turned = np.asarray(base_angle, dtype=float)[..., None]
        return np.asarray(self.clamp_angle + turned + (self.rest_curvature + theta @ self.curvature.T) @ rows.T)

    def xy(self, s: Array, theta: Array, base: Array | None = None) -> Array:
        """(T, S, 2) m for states (T, n), base poses (T, 3) of (x, y, turn), default 0. Equation (4)."""
        pose = np.zeros(3) if base is None else np.asarray(base, dtype=float)
        alpha = self.rest_angle + pose[..., 2:] + theta @ self.to_angle.T
        rows = self.length * self.grid.integral_to(np.asarray(s, dtype=float))
        return np.stack(
            [pose[..., 0:1] + np.cos(alpha) @ rows.T, pose[..., 1:2] + np.sin(alpha) @ rows.T],
            axis=-1,
        )


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
    c, s = _directions(of, theta)
    across = np.concatenate([c[..., None] * of.to_angle, s[..., None] * of.to_angle], axis=-1)  # (..., Q, 2 n)
    carried = of.carried @ across
    n = of.n
    out = np.swapaxes(across[..., :n], -1, -2) @ carried[..., :n]
    out += np.swapaxes(across[..., n:], -1, -2) @ carried[..., n:]
    return np.asarray(out + of.to_angle.T @ (of.rotary[:, None] * of.to_angle))


def kinetic_energy(
    of: Body, theta: Array, rate: Array, base: Array | None = None, base_rate: Array | None = None
) -> Array:
    """(...,) J for states and rates (..., n), gripper poses and rates (..., 3)."""
    pose, moving = _pose(base), _pose(base_rate)
    turning = rate @ of.to_angle.T + moving[..., 2:]
    c, s = _directions(of, theta, pose[..., 2:])
    ct, st = c * turning, s * turning
    carried = np.sum(ct * (ct @ of.carried) + st * (st @ of.carried) + of.rotary * turning**2, axis=-1)
    with_base = moving[..., 1] * (ct @ of.lever) - moving[..., 0] * (st @ of.lever)
    return np.asarray(0.5 * carried + with_base + 0.5 * of.mass * np.sum(moving[..., :2] ** 2, axis=-1))


def elastic_energy(of: Body, theta: Array) -> Array:
    """(...,) J: `1/2 int k (q - q0)^2`."""
    return np.asarray(0.5 * np.sum(theta * (theta @ of.stiffness), axis=-1))


def weight_energy(of: Body, theta: Array, gravity: Array, base: Array | None = None) -> Array:
    """(...,) J under gravity (2,) m/s^2, 0 at the origin; gripper at `base` (..., 3)."""
    pose = _pose(base)
    c, s = _directions(of, theta, pose[..., 2:])
    return np.asarray(-(gravity[0] * c + gravity[1] * s) @ of.lever - of.mass * (pose[..., :2] @ gravity))


def momentum(of: Body, theta: Array, rate: Array, base: Array | None = None, base_rate: Array | None = None) -> Array:
    """(..., n) kg m^2/s: derivative of the kinetic energy by the rate."""
    pose, moving = _pose(base), _pose(base_rate)
    turning = rate @ of.to_angle.T + moving[..., 2:]
    c, s = _directions(of, theta, pose[..., 2:])
    y = (c * turning) @ of.carried + moving[..., 1:2] * of.lever
    x = moving[..., 0:1] * of.lever - (s * turning) @ of.carried
    return np.asarray((c * y - s * x + of.rotary * turning) @ of.to_angle)


def _directions(of: Body, theta: Array, turn: Array | float = 0.0) -> tuple[Array, Array]:
    alpha = of.rest_angle + turn + np.asarray(theta, dtype=float) @ of.to_angle.T
    return np.cos(alpha), np.sin(alpha)


def _pose(given: Array | None) -> Array:
    return np.zeros(3) if given is None else np.asarray(given, dtype=float)


def _refuse(good: BoolArray, name: str, values: Array, nodes: Array, rule: str) -> None:
    if not np.all(good):
        bad = int(np.flatnonzero(~good)[0])
        raise MechanicsError(f"{name} = {values[bad]:.3g} at s = {nodes[bad]:.3f}: {rule}")


# Actions on a moving beam, in one fixed frame: the beam's while the gripper's pose is zero. A moving gripper enters
# through the velocity of every point; add no inertial forces.

InTime = Callable[[float], ArrayLike]


@dataclass(frozen=True)
class AppliedForce:
    """At a fixed place: two numbers [N], or a function of time [s]."""

    value: ArrayLike | InTime
    at_s: float = 1.0
    breaks: tuple[float, ...] = ()  # s, times of jumps


@dataclass(frozen=True)
class AppliedMoment(AppliedForce):
    """At a fixed place: a number [N m], or a function of time [s]."""


@dataclass(frozen=True)
class Gripper:
    """A moving clamp: `pose(t)` = (x [m], y [m], turn [rad]) and its derivative `rate(t)`.

    The turn adds to the clamp angle. The velocity may jump at `breaks`, the pose may not.
    """

    pose: InTime
    rate: InTime
    breaks: tuple[float, ...] = ()


@dataclass(frozen=True)
class Actions:
    forces: tuple[AppliedForce, ...] = ()
    moments: tuple[AppliedMoment, ...] = ()
    gravity: ArrayLike = (0.0, 0.0)  # m/s^2
    gripper: Gripper | None = None

    def __post_init__(self) -> None:
        for action in self._loads:
            if not 0.0 <= action.at_s <= 1.0:
                raise MechanicsError(f"actions are at s in [0, 1], got s = {action.at_s}")
        if np.shape(self.gravity) != (2,) or not np.all(np.isfinite(np.asarray(self.gravity, dtype=float))):
            raise MechanicsError(f"gravity has two finite components [m/s^2], got {self.gravity}")

    @property
    def _loads(self) -> tuple[AppliedForce, ...]:
        return (*self.forces, *self.moments)

    @property
    def breaks(self) -> tuple[float, ...]:
        gripper = self.gripper.breaks if self.gripper is not None else ()
        return tuple(sorted({*gripper, *(time for action in self._loads for time in action.breaks)}))

    @property
    def steady(self) -> bool:
        return self.gripper is None and not any(callable(action.value) for action in self._loads)


@dataclass(frozen=True)
class TabulatedActions:
    """At R times."""

    pull: Array  # (2, Q, R) N m: pull beyond each node with weight, times its lever; x and y
    forced: Array  # (2, Q, R) N m: the same of forces alone
    force: Array  # (R, 2) N: sum of the forces
    couple: Array  # (n, R) N m: of the moments
    moment: Array  # (R,) N m: sum of the moments
    base: Array  # (R, 3) m, m, rad
    base_rate: Array  # (R, 3)


def acting(on: Body, actions: Actions, times: Array) -> TabulatedActions:
    """At `times` (R,) s. Raises `MechanicsError` for values that are not finite."""
    count = len(times)
    weight = np.multiply.outer(np.asarray(actions.gravity, dtype=float), np.outer(on.lever, np.ones(count)))
    forced, total = np.zeros_like(weight), np.zeros((count, 2))
    for force in actions.forces:
        values = _values(force.value, times, 2, "a force")
        lever = on.length * on.grid.integral_to(np.array([force.at_s]))[0]
        forced += np.multiply.outer(lever, values).transpose(2, 0, 1)
        total += values
    couple, moment = np.zeros((on.n, count)), np.zeros(count)
    for twist in actions.moments:
        about_z = _values(twist.value, times, 1, "a moment")[:, 0]
        couple += on.to_places(np.array([twist.at_s]))[0][:, None] * about_z
        moment += about_z
    base = base_rate = np.zeros((count, 3))
    if actions.gripper is not None:
        base = _values(actions.gripper.pose, times, 3, "the gripper's pose")
        base_rate = _values(actions.gripper.rate, times, 3, "the gripper's rate")
    return TabulatedActions(weight + forced, forced, total, couple, moment, base, base_rate)


def power(on: Body, theta: Array, rate: Array, now: TabulatedActions) -> Array:
    """(R,) W: of forces and moments at states and rates (n, R), with the gripper's motion."""
    turn, spin = now.base[:, 2], now.base_rate[:, 2]
    alpha = on.rest_angle[:, None] + turn + on.to_angle @ theta
    turning = on.to_angle @ rate + spin
    along = np.sum(turning * (np.cos(alpha) * now.forced[1] - np.sin(alpha) * now.forced[0]), axis=0)
    carried = np.sum(now.force * now.base_rate[:, :2], axis=1) + now.moment * spin
    return np.asarray(along + carried + np.sum(now.couple * rate, axis=0))


def check_gripper(gripper: Gripper, first: float, last: float, step: float) -> None:
    """Compares the gripper's rate with differences of its pose.

    Raises `MechanicsError`: they differ by more than steps of `step` s can follow.
    """
    times = first + (last - first) * np.array([0.07, 0.23, 0.41, 0.59, 0.77, 0.93])
    near = 0.01 * min(step, last - first)
    before, after = (_values(gripper.pose, times + d, 3, "the gripper's pose") for d in (-near, near))
    moves, said = (after - before) / (2.0 * near), _values(gripper.rate, times, 3, "the gripper's rate")
    allowed = 1e-3 * np.max(np.abs(moves)) + 1e-12 * (1.0 + np.max(np.abs(after))) / near
    wrong = np.max(np.abs(moves - said), axis=1) > allowed
    if np.any(wrong):
        i = int(np.flatnonzero(wrong)[0])
        raise MechanicsError(
            f"the gripper's rate is not the derivative of its pose: at t = {times[i]:.6g} s it moves by "
            f"{np.array2string(moves[i], precision=4)} a second, and rate says {np.array2string(said[i], precision=4)}"
        )


def _values(value: ArrayLike | InTime, times: Array, size: int, name: str) -> Array:
    raw = [value(float(t)) for t in times] if callable(value) else [value] * len(times)
    try:
        out = np.asarray(raw, dtype=float).reshape(len(times), size)
    except (TypeError, ValueError) as error:
        raise MechanicsError(f"{name} must be {size} number(s) at every time: {error}") from error
    if not np.all(np.isfinite(out)):
        bad = times[np.flatnonzero(~np.all(np.isfinite(out), axis=1))[0]]
        raise MechanicsError(f"{name} is not finite at t = {bad:.6g} s")
    return out
