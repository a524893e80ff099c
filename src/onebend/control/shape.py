"""Forces, or gripper poses, that bring a beam closest to a wanted shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam import clamped_ends, continuation, statics, stiffness
from onebend.beam.loads import Loads, push, weight
from onebend.beam.problem import Problem, Resolution, Rod, make_problem, refuse_section
from onebend.beam.setup import SetUp
from onebend.control.goals import TargetResiduals, Targets, check_metres, target_residuals
from onebend.control.loaded_beam import least_eigenvalue
from onebend.errors import ControlError
from onebend.options import NOT_NEGATIVE, option
from onebend.progress import one_blas_thread
from onebend.records import Array

# Actuators and their equilibria: a smooth surface with as many dimensions as controls,
#
#     g(q, u) = g0(q) - A(q)^T u = 0,
#
# u: forces of pushers (dead loads), force and moment of a grip; A: derivative of their places. With forces alone the
# surface is a graph over u while the beam is stable. With a grip it is not everywhere a graph over wrench or pose; so
# steps are taken in its tangent plane and corrected at right angles.

_LAST_UPDATE = 1e-11  # rad
_MOST_ITERATIONS = 12


@dataclass(frozen=True)
class Pusher:
    at_s: float = 1.0
    max_force: float = np.inf

    def __post_init__(self) -> None:
        if not 0.0 < self.at_s <= 1.0:
            raise ControlError(f"a push acts at s in (0, 1], got {self.at_s:g}")
        if not self.max_force > 0.0:
            raise ControlError(f"the largest force must be positive, got {self.max_force:g} N")


@dataclass(frozen=True)
class Grip:
    """Holds s = 1 at a position and an angle."""

    max_force: float = np.inf  # N
    max_moment: float = np.inf  # N m

    def __post_init__(self) -> None:
        if not (self.max_force > 0.0 and self.max_moment > 0.0):
            raise ControlError(f"a grip's limits must be positive, got {self.max_force:g} N, {self.max_moment:g} N m")


@dataclass(frozen=True)
class LoadBound:
    """`|u[columns]| <= most`."""

    columns: slice
    most: float
    name: str


@dataclass(frozen=True)
class Actuators:
    """Controls u: pushers' forces, then the grip's force and moment."""

    problem: Problem  # one frame, under weight; an edge at every push
    pushes: tuple[Pusher, ...]
    grip: Grip | None

    @property
    def count(self) -> int:
        return 2 * len(self.pushes) + (0 if self.grip is None else 3)

    @property
    def scale(self) -> Array:
        """(m,) N, N m: natural units, mean k over L and mean k."""
        stiff = self.mean_stiffness
        forces = np.full(2 * len(self.pushes) + (0 if self.grip is None else 2), stiff / float(self.problem.length))
        return forces if self.grip is None else np.append(forces, stiff)

    @cached_property
    def mean_stiffness(self) -> float:
        return float(np.sum(self.problem.weights * self.problem.k))

    @cached_property
    def beyond(self) -> Array:
        """(m, Q) 1 where a control acts beyond the node."""
        rows = [np.repeat((self.problem.grid.nodes < pusher.at_s)[None], 2, axis=0) for pusher in self.pushes]
        return np.concatenate([*rows, *([] if self.grip is None else [np.ones((3, len(self.problem.weights)))])])

    @property
    def bounds(self) -> tuple[LoadBound, ...]:
        every = [
            LoadBound(slice(2 * i, 2 * i + 2), pusher.max_force, f"force at s = {pusher.at_s:g}")
            for i, pusher in enumerate(self.pushes)
        ]
        if self.grip is not None:
            a = 2 * len(self.pushes)
            every.append(LoadBound(slice(a, a + 2), self.grip.max_force, "the gripper's force"))
            every.append(LoadBound(slice(a + 2, a + 3), self.grip.max_moment, "the gripper's moment"))
        return tuple(bound for bound in every if np.isfinite(bound.most))

    def loaded(self, u: Array) -> Problem:
        """With the controls u (T, m) as dead loads."""
        p, last = self.problem, self.count if self.grip is None else self.count - 1
        force = np.stack([u[:, i:last:2] @ self.beyond[i:last:2] for i in (0, 1)], axis=-1)
        moment = p.moment + (0.0 if self.grip is None else u[:, -1:])
        return replace(p, dead_force=p.dead_force + force, moment=np.broadcast_to(moment, force.shape[:2]))

    def solved(self, q: Array, u: Array) -> statics.Equilibrium:
        """Known equilibria q (T, Q) under u (T, m)."""
        return statics.found_near(self.loaded(u), q, np.ones(len(q), dtype=bool))


@dataclass(frozen=True)
class BeamState:
    actuators: Actuators
    q: Array  # (Q,)
    u: Array  # (m,)

    @cached_property
    def solved(self) -> statics.Equilibrium:
        """With the controls as dead loads; for stability see `margin`."""
        return self.actuators.solved(self.q[None], self.u[None])

    @cached_property
    def tangent(self) -> Array:
        """(Q, Q) `D T D`, D = 1 / sqrt(w k)."""
        return np.asarray(statics.scaled(self.solved.problem, statics.tangent(self.solved.problem, self.q[None]))[0])

    @cached_property
    def actions(self) -> Array:
        """(m, Q) `A D`, over the controls' units."""
        return np.asarray(actions(self.actuators, self.solved)[0] * self.unbend)

    @property
    def unbend(self) -> Array:
        """(Q,) D."""
        return self.actuators.problem.unbend

    @cached_property
    def plane(self) -> tuple[Array, Array]:
        """(Q, m) and (m, m): curvature [rad] and controls [N, N m] along the tangent plane, orthonormal in scaled
        units."""
        unit = self.actuators.scale / np.sqrt(self.actuators.mean_stiffness)
        rows = np.concatenate([self.tangent, -(self.actions.T * unit)], axis=1)
        basis = np.linalg.qr(rows.T, mode="complete")[0][:, len(self.q) :]
        root = np.sqrt(self.actuators.mean_stiffness)
        return root * self.unbend[:, None] * basis[: len(self.q)], self.actuators.scale[:, None] * basis[len(self.q) :]

    @cached_property
    def margin(self) -> float:
        """Smallest eigenvalue of the scaled tangent on changes that keep a gripped end.

        1 without loads, 0 at buckling. With the shape fixed, `1 / (1 - margin)` times the loads would buckle it.
        """
        return least_eigenvalue(self.tangent, None if self.actuators.grip is None else self.actions[-3:])

    @property
    def end(self) -> Array:
        """(3,) x, y [m], angle of s = 1."""
        return np.asarray(clamped_ends.end_pose(self.actuators.problem, self.q[None])[0])


def actions(actuators: Actuators, solved: statics.Equilibrium) -> Array:
    """(T, m, Q) A: positions of pushed places and pose of the gripped end, by the curvature."""
    problem, alpha = solved.problem, solved.alpha
    count = 2 * len(actuators.pushes)
    turning = np.empty((len(alpha), count, alpha.shape[1]))
    lw = problem.length * problem.weights * actuators.beyond[:count:2]
    turning[:, 0::2], turning[:, 1::2] = -lw * np.sin(alpha)[:, None], lw * np.cos(alpha)[:, None]
    rows = turning @ problem.to_nodes
    if actuators.grip is None:
        return np.asarray(rows)
    return np.asarray(np.concatenate([rows, clamped_ends.end_jacobian(problem, solved.q)], axis=1))


def resting_state(
    beam: Rod, pushes: tuple[Pusher, ...], grip: Grip | None, gravity: ArrayLike | None, resolution: Resolution
) -> BeamState:
    """Under weight alone.

    Raises `ControlError`: no actuator, or buckling under weight. Raises `MechanicsError`: a beam with a thickness.
    """
    if not pushes and grip is None:
        raise ControlError("no actuator on the beam: give a push or a grip")
    loads = sum((push((0.0, 0.0), pusher.at_s) for pusher in pushes), Loads())
    if gravity is not None:
        loads = loads + weight(gravity)
    refuse_section(beam, "the search for a shape")
    actuators = Actuators(make_problem(beam, loads, resolution), pushes, grip)
    solved = continuation.equilibrium(beam, loads, resolution=resolution)
    if not solved.stable[0]:
        raise ControlError("the beam buckles under its own weight; there is no stable shape at rest to start from")
    return BeamState(actuators, solved.q[0], np.zeros(actuators.count))


def next_state(state: BeamState, z: Array, trust: float) -> BeamState | None:
    """The equilibrium after a step z (m,) in the tangent plane; None if not within `trust` rad. Forces alone are then
    exact; with a grip the correction is perpendicular."""
    actuators, (dq, du) = state.actuators, state.plane
    q, u, count = state.q + dq @ z, state.u + du @ z, len(state.q)
    problem, unit, root = actuators.problem, actuators.scale, np.sqrt(actuators.mean_stiffness)
    begin = q
    sides = np.zeros((actuators.count, count + actuators.count))
    if actuators.grip is None:
        sides[:, count:] = np.eye(actuators.count)
    else:
        sides[:, :count], sides[:, count:] = (dq / (root * state.unbend[:, None])).T, (du / unit[:, None]).T
    for _ in range(_MOST_ITERATIONS):
        here = BeamState(actuators, q, u)
        out, matrix = statics.balance(here.solved.problem, q[None])
        scale = here.unbend
        top = np.concatenate([statics.scaled(here.solved.problem, matrix)[0], -here.actions.T * (unit / root)], axis=1)
        right = np.append(-out[0] * scale / root, np.zeros(actuators.count))
        try:
            step = np.linalg.solve(np.concatenate([top, sides]), right)
        except np.linalg.LinAlgError:
            return None
        change = root * scale * step[:count]
        q, u = q + change, u + unit * step[count:]
        if not np.max(np.abs(problem.to_nodes @ (q - begin))) < trust:
            return None
        if np.max(np.abs(problem.to_nodes @ change)) < _LAST_UPDATE:
            return BeamState(actuators, q, u)
    return None


_MOST_DUAL_ITERATIONS = 60
_BOUND_TOLERANCE = 1e-12  # of a bound
_LEAST_SHARE = 2e-3  # of a step
_FLAT_TO_NEWTON = 1e-11  # of the cost's largest curvature


def model_of(state: BeamState, residuals: TargetResiduals) -> tuple[Array, Array]:
    """Slope (m,) and Hessian (m, m) of half the sum of squares in the tangent plane, to second order along the surface.

    With the multipliers l, `T l = -r_q^T r` (and `A l = 0` with a grip, least squares), the Hessian of
    `|r|^2 / 2 + l . g` on the tangent plane.
    """
    dq, du = state.plane
    b, solved = state.actuators.problem.to_nodes, state.solved
    turned = b @ multipliers(state, residuals)
    across = statics.nodal_forces(solved.problem, solved.q).across
    flow, seen = b @ dq, residuals.jacobian[0] @ dq  # (Q, m) turns
    bent = flow.T @ ((residuals.curvature_term[0] + across[0] * turned)[:, None] * flow)
    coupled = du.T @ control_coupling(state.actuators, solved.alpha, turned[None])[0] @ flow
    return seen.T @ residuals.value[0], seen.T @ seen + bent + coupled + coupled.T


def multipliers(state: BeamState, residuals: TargetResiduals) -> Array:
    """(Q,) l of `model_of`, 1/(N m)."""
    rows, right = state.tangent, -(residuals.value[0] @ residuals.jacobian[0]) * state.unbend
    if state.actuators.grip is not None:
        unit = state.actuators.scale / np.sqrt(state.actuators.mean_stiffness)
        rows = np.concatenate([rows, -state.actions * unit[:, None]])
        right = np.append(right, np.zeros(state.actuators.count))
    return np.asarray(state.unbend * np.linalg.lstsq(rows, right, rcond=None)[0])


def control_coupling(actuators: Actuators, alpha: Array, turned: Array) -> Array:
    """(T, m, Q) derivative of `-u . A l` by controls and node angles; `turned` (T, Q) is B l."""
    problem, forces = actuators.problem, actuators.count - (0 if actuators.grip is None else 1)
    out = problem.length * problem.weights * actuators.beyond * turned[:, None]
    out[:, 0:forces:2] *= np.cos(alpha)[:, None]
    out[:, 1:forces:2] *= np.sin(alpha)[:, None]
    out[:, forces:] = 0.0
    return np.asarray(out)


def convex(hessian: Array, damping: float) -> Array:
    """Absolute eigenvalues plus `damping`."""
    values, vectors = np.linalg.eigh(hessian)
    size = np.maximum(np.abs(values), _FLAT_TO_NEWTON * np.max(np.abs(values)) + 1e-300) + damping
    return np.asarray((vectors * size) @ vectors.T)


def bounded_step(
    slope: Array, hessian: Array, u: Array, du: Array, bounds: tuple[LoadBound, ...]
) -> tuple[Array, Array]:
    """(m,) minimum of `slope . z + z H z / 2` with bounded `u + du z`; (n,) multipliers.

    Newton's method on the active bounds' multipliers; the reciprocal size of a bounded part is nearly linear in them.
    """
    prices = np.zeros(len(bounds))
    parts = [(u[bound.columns], du[bound.columns], bound.most) for bound in bounds]
    for _ in range(_MOST_DUAL_ITERATIONS):
        h, g = hessian.copy(), slope.copy()
        for value, (at, along, _) in zip(prices, parts, strict=True):
            h += value * along.T @ along
            g += value * along.T @ at
        z = np.asarray(-np.linalg.solve(h, g), dtype=float)
        ends = [at + along @ z for at, along, _ in parts]
        sizes = np.maximum([float(np.linalg.norm(y)) for y in ends], 1e-300)
        room = np.array([bound.most for bound in bounds]) / sizes - 1.0
        binding = (room < 0.0) | (prices > 0.0)
        if np.all(np.abs(room[binding]) < _BOUND_TOLERANCE):
            break
        pulls_back = np.array([along.T @ y for y, (_, along, _) in zip(ends, parts, strict=True)])[binding]
        steep = ((1.0 + room) / sizes**2)[binding]
        jacobian = steep[:, None] * (pulls_back @ np.linalg.solve(h, pulls_back.T))
        change = np.linalg.lstsq(jacobian, -room[binding], rcond=1e-14)[0]
        prices[binding] = np.maximum(prices[binding] + change, 0.0)
    loose, share = 1.0 + 2.0 * _BOUND_TOLERANCE, 1.0
    while share > _LEAST_SHARE and any(np.linalg.norm(at + share * by @ z) > loose * most for at, by, most in parts):
        share *= 0.9
    return np.asarray(z * share), prices


_LAST_STEP = 1e-9  # rad
_BELOW_ROUNDING = 1e-6  # rad: below, rounding of the cost hides progress
_EDGE_MARGIN = 1.1  # times the least margin
_STRIDE = 0.5  # rad, turn per step
_MOST_STEPS = 200
_LEAST_MARGIN = 1e-3  # see `BeamState.margin`
DAMPING = 1e-3  # of the first step, as a share of the cost's curvature
_FIRST_DAMPING = 1e-5  # the same, after a failed step
_RETURN_SHARE = 0.5  # of a step's turn


@dataclass(frozen=True)
class DescentResult:
    state: BeamState
    residuals: TargetResiduals
    multipliers: Array  # (n,) of `state.actuators.bounds`; positive if active
    converged: bool
    near_buckling: bool  # instability stopped the descent

    @property
    def cost(self) -> float:
        """Weighted squares, over L."""
        return float(self.residuals.cost[0])


def descend(start: BeamState, targets: Targets, arm: float, damping: float = DAMPING) -> DescentResult:
    """Newton's method with bounded turn; a step must lower the cost and be stable."""
    state, residuals = start, target_residuals(start.solved, targets, arm)
    bounds = start.actuators.bounds
    multipliers, barred, price = np.zeros(len(bounds)), False, 0.0
    for _ in range(_MOST_STEPS):
        slope, hessian = model_of(state, residuals)
        size = float(np.trace(np.abs(hessian))) + 1e-300
        z, multipliers = bounded_step(slope, convex(hessian, damping * size), state.u, state.plane[1], bounds)
        price = max(price, 2.0 * float(np.sum(multipliers * [bound.most**2 for bound in bounds])))
        z = z * min(1.0, _STRIDE / max(_turn(state, z), 0.5 * float(np.linalg.norm(z)), 1e-300))
        turn = _turn(state, z)
        if turn < _LAST_STEP and (damping < 1e-6 or np.linalg.norm(slope) < 1e-14):
            return DescentResult(state, residuals, multipliers, True, barred)
        after = next_state(state, z, turn * (1.0 + _RETURN_SHARE) + 1e-3)
        stable = after is not None and after.margin > _LEAST_MARGIN
        if after is not None and stable:
            new_residuals = target_residuals(after.solved, targets, arm)
            gain = _merit(state, residuals, price) - _merit(after, new_residuals, price)
            promised = -float(slope @ z + 0.5 * z @ hessian @ z)
            if gain > 1e-4 * abs(promised) or (
                turn < _BELOW_ROUNDING and gain > -1e-9 * _merit(state, residuals, price) - 1e-28
            ):
                state, residuals, barred = after, new_residuals, False
                damping *= 0.1 if gain > 0.5 * promised or turn < _BELOW_ROUNDING else 1.0
                damping = damping if damping > 1e-14 else 0.0
                continue
        barred = after is not None and not stable
        damping = max(8.0 * damping, _FIRST_DAMPING)
        if damping > 1e8 or (barred and state.margin < _EDGE_MARGIN * _LEAST_MARGIN):
            break
    return DescentResult(state, residuals, multipliers, False, barred)


def _turn(state: BeamState, z: Array) -> float:
    return float(np.max(np.abs(state.actuators.problem.to_nodes @ (state.plane[0] @ z))))


def _merit(state: BeamState, residuals: TargetResiduals, price: float) -> float:
    """Half the cost plus penalty."""
    beyond = [np.linalg.norm(state.u[bound.columns]) / bound.most - 1.0 for bound in state.actuators.bounds]
    return 0.5 * float(residuals.cost[0]) + price * float(np.sum(np.maximum(beyond, 0.0)))


@dataclass(frozen=True)
class ShapeSpread:
    """sds of the shape at N places, given the pushes' forces and the grip's pose."""

    xy: Array  # (N, 2) m
    angle: Array  # (N,) rad
    wrench: Array | None  # (3,) N, N, N m of the gripper, if any

    @property
    def rms(self) -> float:
        """m, over all places."""
        return float(np.sqrt(np.mean(np.sum(self.xy**2, axis=1))))


def spread(state: BeamState, targets: Targets, uncertain: stiffness.UncertainStiffness) -> ShapeSpread:
    """At N targets. With a grip a common factor of k changes the wrench and not the shape (without weight)."""
    problem, solved = state.actuators.problem, state.solved
    basis = uncertain.basis(problem.grid.nodes)
    strain = problem.weights * problem.k * (state.q - problem.q0)
    right = -(state.unbend * strain)[:, None] * np.column_stack([basis, np.ones(len(strain))])
    held = 0 if state.actuators.grip is None else 3
    count = len(strain)
    unit = state.actuators.scale[state.actuators.count - held :]
    rows = state.actions[state.actuators.count - held :]
    system = np.zeros((count + held, count + held))
    system[:count, :count], system[:count, count:], system[count:, :count] = state.tangent, -rows.T * unit, rows
    answer = np.linalg.solve(system, np.concatenate([right, np.zeros((held, right.shape[1]))]))
    dq = state.unbend[:, None] * answer[:count]
    moved = float(problem.length) * (1j * np.exp(1j * solved.alpha[0]) * targets.rows(problem)) @ problem.to_nodes @ dq
    covariance = np.zeros((right.shape[1], right.shape[1]))
    covariance[:-1, :-1], covariance[-1, -1] = uncertain.covariance, uncertain.gain_sd**2

    def sd(rows: Array) -> Array:
        return np.asarray(np.sqrt(np.maximum(np.einsum("np,pr,nr->n", rows, covariance, rows), 0.0)))

    wrench = sd(unit[:, None] * answer[count:]) if held else None
    turned = problem.grid.integral_to(targets.s) @ dq
    return ShapeSpread(np.stack([sd(moved.real), sd(moved.imag)], axis=-1), sd(turned), wrench)


_FINEST_PANEL = 1.0 / 16.0
_TARGETS_MET = 1e-9  # of L, RMS: no further start
_ACTIVE_BOUND = 1e-6  # share of a bound
_OPEN_FREEDOM = 1e-9  # of the cost's largest curvature
_MOST_STARTS = 6  # bent ones, if the targets are not met from rest
_RANDOM_LOAD_SIZE = 1.5  # of them, in mean k over L
NEAR_BUCKLING = 0.1  # margin, below which a warning says so


@dataclass(frozen=True)
class ShapeSettings:
    arm: float | None = option("--arm-m", None, within=NOT_NEGATIVE)
    resolution: Resolution = field(default_factory=lambda: Resolution(order=16, widest=0.5))


@dataclass(frozen=True)
class ShapeResult:
    targets: Targets
    state: BeamState
    xy_error: Array  # (N, 2) m: shape less target; NaN where free
    angle_error: Array  # (N,) rad
    rms: float  # m: weighted RMS, angles times the arm
    spread: ShapeSpread | None  # due to the band on k(s), if given
    limits: tuple[str, ...]  # active limits
    open_freedoms: int  # directions of the controls that do not change the cost
    converged: bool  # no closer stable shape nearby
    starts: int
    warnings: tuple[str, ...]
    setup: SetUp | None = None  # whose sensor shows the forces

    @property
    def forces(self) -> Array:
        """(a, 2) N: as the sensor of the set-up shows them, without one as they act on the beam."""
        if self.setup is None:
            return self.forces_on_beam
        shown = self.setup.shown(self.state.actuators.problem, self.state.solved, self.forces_on_beam[None])
        return np.asarray(shown[0])

    @property
    def forces_on_beam(self) -> Array:
        """(a, 2) N."""
        return np.asarray(self.state.u[: 2 * len(self.state.actuators.pushes)].reshape(-1, 2))

    @property
    def wrench(self) -> Array | None:
        """(3,) N, N, N m on the beam, if gripped."""
        return None if self.state.actuators.grip is None else self.state.u[-3:]

    @property
    def pose(self) -> Array:
        """(3,) m, m, rad: end, or gripper."""
        return self.state.end

    @property
    def margin(self) -> float:
        """Smallest eigenvalue of the tangent over that without loads; 0 at buckling."""
        return self.state.margin

    @property
    def load_left(self) -> float:
        """Factor on all loads at buckling, with the shape fixed; may be infinite."""
        return float(1.0 / (1.0 - self.margin)) if self.margin < 1.0 else np.inf

    def xy(self, s: ArrayLike) -> Array:
        """(S, 2) m at `s`."""
        return np.asarray(self.state.solved.xy(np.atleast_1d(np.asarray(s, dtype=float)))[0])

    def angle(self, s: ArrayLike) -> Array:
        """(S,) rad at `s`."""
        return np.asarray(self.state.solved.angle(np.atleast_1d(np.asarray(s, dtype=float)))[0])


@one_blas_thread
def shape(
    beam: Rod,
    targets: Targets,
    *,
    pushes: Sequence[Pusher] = (),
    grip: Grip | None = None,
    gravity: ArrayLike | None = None,
    uncertain: stiffness.UncertainStiffness | None = None,
    settings: ShapeSettings = ShapeSettings(),
) -> ShapeResult:
    """The stable shape under these actuators closest to the targets (weighted least squares): a local optimum.

    The search starts from rest, and from bent shapes if the targets are not met. `gravity`: (2,) m/s^2 in the beam's
    frame. `uncertain`: band of k(s), for the expected errors.

    Raises `ControlError`: no actuator, bad targets, or buckling under weight. Raises `MechanicsError`: k(s) not
    positive.
    """
    arm = float(beam.length) if settings.arm is None else settings.arm
    check_metres(targets.xy, float(beam.length))
    resting = resting_state(beam, tuple(pushes), grip, gravity, settings.resolution)
    result, tried = descend(resting, targets, arm), 1
    enough = _TARGETS_MET**2 * float(np.sum(targets.weight))
    for other in _bent(resting):
        if result.converged and result.cost < enough:
            break
        again, tried = descend(other, targets, arm), tried + 1
        result = again if again.cost < result.cost * (1.0 - 1e-6) else result
    resolution, actuators = settings.resolution, resting.actuators
    while not result.state.solved.resolved[0] and resolution.widest > _FINEST_PANEL:
        resolution = resolution.finer()
        state, finer = result.state, resting_state(beam, actuators.pushes, grip, gravity, resolution)
        rows = state.actuators.problem.grid.value_at(finer.actuators.problem.grid.nodes)
        begin = BeamState(finer.actuators, rows @ state.q, state.u)
        on_grid = next_state(begin, np.zeros(actuators.count), 0.05)
        if on_grid is None:
            break
        result = descend(on_grid, targets, arm)
    return _result(result, targets, tried, uncertain)


def _bent(resting: BeamState) -> list[BeamState]:
    actuators, rng, out = resting.actuators, np.random.default_rng(0), []
    for _ in range(_MOST_STARTS):
        u = _RANDOM_LOAD_SIZE * actuators.scale * rng.standard_normal(actuators.count)
        for bound in actuators.bounds:
            u[bound.columns] *= min(1.0, 0.9 * bound.most / float(np.linalg.norm(u[bound.columns])))
        solved = continuation.follow(actuators.loaded(u[None]))
        if solved.stable[0]:
            out.append(BeamState(actuators, solved.q[0], u))
    return out


def _result(
    result: DescentResult, targets: Targets, tried: int, uncertain: stiffness.UncertainStiffness | None
) -> ShapeResult:
    state = result.state
    values = np.abs(np.linalg.eigvalsh(model_of(state, result.residuals)[1]))
    limits = tuple(
        bound.name
        for bound, price in zip(state.actuators.bounds, result.multipliers, strict=True)
        if price > 0.0 and np.linalg.norm(state.u[bound.columns]) > (1.0 - _ACTIVE_BOUND) * bound.most
    )
    open_freedoms = int(np.sum(values < _OPEN_FREEDOM * np.max(values))) if not limits else 0
    return ShapeResult(
        targets=targets,
        state=state,
        xy_error=targets.places(state.solved)[0] - targets.xy,
        angle_error=state.solved.angle(targets.s)[0] - targets.angle,
        rms=float(state.actuators.problem.length) * float(np.sqrt(result.cost / np.sum(targets.weight))),
        spread=None if uncertain is None or result.near_buckling else spread(state, targets, uncertain),
        limits=(*limits, *(("stability",) if result.near_buckling else ())),
        open_freedoms=open_freedoms,
        converged=result.converged,
        starts=tried,
        warnings=_warnings(result, open_freedoms),
    )


def _warnings(result: DescentResult, open_freedoms: int) -> tuple[str, ...]:
    out, margin, count = [], result.state.margin, result.state.actuators.count
    if result.near_buckling:
        out.append("nearer to the targets the beam loses its stability; this is as close as it gets")
    elif not result.converged:
        out.append("the search ended before its optimum; what was found is stable, but may not be the closest")
    if margin < NEAR_BUCKLING:
        factor = 1.0 / (1.0 - margin)
        out.append(
            f"close to buckling: the tangent's smallest eigenvalue is {margin:.3f} of that without loads; "
            f"{factor:.3f} times these loads would buckle the beam"
        )
    if open_freedoms:
        out.append(
            f"the targets leave {open_freedoms} of {count} freedoms of the forces and the gripper open: others do as "
            "well; give more targets, or leave out a force or the gripper"
        )
    return tuple(out)
