"""Goals in time to forces or gripper poses in time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import maximum_filter1d

from onebend.beam.clamped_ends import end_pose, stands
from onebend.beam.grid import transposed
from onebend.beam.model import Beam
from onebend.beam.problem import Rod
from onebend.beam.setup import SetUp
from onebend.beam.statics import balance, is_stable, nodal_forces, scaled, solve_batch
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.goals import Goals, Targets, check_metres, target_residuals, target_residuals_along
from onebend.control.loaded_beam import ReachSettings
from onebend.control.reach import reach, reach_in_setup
from onebend.control.shape import (
    DAMPING,
    NEAR_BUCKLING,
    Actuators,
    BeamState,
    Grip,
    Pusher,
    ShapeResult,
    ShapeSettings,
    actions,
    control_coupling,
    descend,
    multipliers,
    shape,
    spread,
)
from onebend.errors import ControlError, MechanicsError
from onebend.options import POSITIVE, option
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray

_LAST_STEP = 1e-10  # rad
_MOST_ITERATIONS = 6
_LARGEST_TURN = 0.05  # rad, from the start
_BATCH = 128  # frames per batch, to fit the cache


@dataclass(frozen=True)
class PathSamples:
    """T equilibria under the same actuators, with multipliers."""

    q: Array  # (T, Q) rad
    u: Array  # (T, m) N, N m
    multipliers: Array  # (T, Q)


def settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    """The closest stable shapes to targets xy (T, N, 2), angle (T, N), from `near`, and whether they were found.
    Newton's method on the optimality conditions, without bounds."""
    q, u, prices = near.q.copy(), near.u.copy(), near.multipliers.copy()
    settled, b = np.zeros(len(q), dtype=bool), actuators.problem.to_nodes
    for first in range(0, len(q), _BATCH):
        batch = np.arange(first, min(first + _BATCH, len(q)))
        for _ in range(_MOST_ITERATIONS):
            todo = batch[~settled[batch]]
            if todo.size == 0:
                break
            dq, du, prices[todo] = _step(
                actuators, PathSamples(q[todo], u[todo], prices[todo]), targets, xy[todo], angle[todo], arm
            )
            q[todo], u[todo] = q[todo] + dq, u[todo] + du
            settled[todo] = np.max(np.abs(dq @ b.T), axis=1) < _LAST_STEP
        found = batch[settled[batch] & (np.max(np.abs((q[batch] - near.q[batch]) @ b.T), axis=1) < _LARGEST_TURN)]
        settled[batch] = False
        settled[found] = stable(actuators, q[found], u[found])
    return PathSamples(q, u, prices), settled


def stable(actuators: Actuators, q: Array, u: Array) -> BoolArray:
    """(T,) stability under dead pushes and a fixed grip."""
    if actuators.grip is None or len(q) == 0:
        return is_stable(actuators.loaded(u), q)
    bare = u.copy()
    bare[:, -3:] = 0.0
    return stands(actuators.loaded(bare), q, u[:, -3:])


def _step(
    actuators: Actuators, samples: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[Array, Array, Array]:
    """Newton's step of q and u, and multipliers, scaled to about 1.

    With multipliers l of equilibrium: `r_q^T r + T l = 0`, `A l = 0`, `g = 0`; the matrix is symmetric, with exact
    second derivatives.
    """
    solved, b = actuators.solved(samples.q, samples.u), actuators.problem.to_nodes
    problem, count, controls = solved.problem, samples.q.shape[1], actuators.count
    residuals = target_residuals_along(solved, targets, xy, angle, arm)
    out, matrix = balance(problem, samples.q)
    stiff, root = scaled(problem, matrix), np.sqrt(actuators.mean_stiffness)
    unbend, unit = problem.unbend, actuators.scale / root
    turned = samples.multipliers @ b.T
    bent = residuals.curvature_term + nodal_forces(problem, samples.q).across * turned
    rows = residuals.jacobian * unbend
    second = transposed(rows) @ rows + scaled(problem, transposed(b) @ (bent[..., None] * b))
    coupled = unit[:, None] * (control_coupling(actuators, solved.alpha, turned) @ b) * unbend
    acting = unit[:, None] * actions(actuators, solved) * unbend
    a, z = count + controls, np.s_[:]
    system = np.zeros((len(samples.q), a + count, a + count))
    system[z, :count, :count], system[z, count:a, :count] = second, coupled
    system[z, :count, count:a] = transposed(coupled)
    system[z, :count, a:], system[z, a:, :count] = stiff, stiff
    system[z, count:a, a:], system[z, a:, count:a] = -acting, -transposed(acting)
    right = np.zeros((len(samples.q), a + count))
    right[:, :count] = -np.einsum("trq,tr->tq", rows, residuals.value) / root
    right[:, a:] = -out * unbend / root
    answer = solve_batch(system, right)
    return root * unbend * answer[:, :count], actuators.scale * answer[:, count:a], root * unbend * answer[:, a:]


_KNOT_SPACING = 0.02  # of L, between knots
_FEWEST_KNOTS = 12


def knots_of(goals: Goals, length: float) -> Array:
    """(K,) s: close enough to lead from shape to shape."""
    time = np.union1d(np.linspace(goals.time[0], goals.time[-1], 200), goals.time)
    xy, angle = goals.along(time)
    way = np.nan_to_num(np.linalg.norm(np.diff(xy, axis=0), axis=2) / length).max(axis=1)
    turn = np.nan_to_num(np.abs(np.diff(angle, axis=0))).max(axis=1)
    done = np.append(0.0, np.cumsum(np.maximum(way, turn)))
    # Plain time adds knots where the goals rest.
    done = done / max(done[-1], 1e-12) + 0.25 * (time - time[0]) / (time[-1] - time[0])
    count = max(_FEWEST_KNOTS, int(np.ceil(np.sum(np.maximum(way, turn)) / _KNOT_SPACING)) + 1)
    return np.asarray(np.interp(np.linspace(0.0, done[-1], count), done, time))


# Goals of one point under one force, which can hold it only within a thin region. A straight path may leave it; so the
# force is interpolated, and the point follows.

_GOALS_PER_STEP = 24
_SAME_PLACE = 1e-5  # of L
_PASSES = 4  # of a tag's offset, which turns with the beam: each leaves a hundredth of the error


@one_blas_thread
def by_force(
    beam: Beam,
    goals: Goals,
    *,
    push_s: float = 1.0,
    max_force: float | None = None,
    gravity: tuple[float, float] = (0.0, 0.0),
    learned: tuple[Beam, UncertainStiffness, SetUp] | None = None,
) -> Goals:
    """The goals with more between them, all within reach of a force at `push_s`.

    `learned`: beam, band and set-up that the ideal `beam` stands for. A goal that no force meets, or only a great one,
    is then moved to where `reach_in_setup` leads the point, within its likely error, and `warnings` says so.

    Raises `ControlError`: several points or an angle, a goal out of reach, or a jump on the way.
    """
    if len(goals.targets.s) != 1 or not bool(goals.targets.placed[0]) or bool(goals.targets.turned[0]):
        raise ControlError("a single force leads one point, without an angle; lead more with a grip or more forces")
    settings = ReachSettings(max_force=max_force, gravity=gravity)
    forces, exact = np.empty((len(goals.time), 2)), np.ones(len(goals.time), dtype=bool)
    for i, (at, goal) in enumerate(zip(goals.time, goals.xy[:, 0], strict=True)):
        try:
            forces[i], exact[i] = _force_for(beam, goals.targets, goal, push_s, settings, learned)
        except ControlError as error:
            raise ControlError(f"the goal at {at:.4g} s: {error}") from error
    time = np.unique(np.concatenate([np.linspace(*ends, _GOALS_PER_STEP + 1) for ends in pairwise(goals.time)]))
    try:
        led = PchipInterpolator(goals.time, forces)(time)
        shape = beam.equilibrium(led, push_s, gravity=gravity if any(gravity) else None)
    except MechanicsError as error:
        raise ControlError(f"on the way from goal to goal {error}") from error
    xy = goals.targets.places(shape.solved)
    off = np.linalg.norm(xy[np.searchsorted(time, goals.time), 0] - goals.xy[:, 0], axis=1)
    if np.max(exact * off) > _SAME_PLACE * beam.length:
        at = goals.time[int(np.argmax(exact * off))]
        raise ControlError(f"the goal at {at:.4g} s lies on another branch of shapes: the beam would jump on its way")
    moved = (
        f"{np.sum(~exact)} of {len(off)} goals are out of reach, but within their likely error: the point stays up to "
    )
    words = () if exact.all() else (f"{moved}{1e3 * np.max(off):.3g} mm away, at {goals.time[np.argmax(off)]:.4g} s",)
    return replace(goals, time=time, xy=xy, angle=np.full((len(time), 1), np.nan), warnings=words)


def _force_for(
    beam: Beam,
    targets: Targets,
    goal: Array,
    push_s: float,
    settings: ReachSettings,
    learned: tuple[Beam, UncertainStiffness, SetUp] | None,
) -> tuple[Array, bool]:
    """(2,) N on the beam for the one point of the targets, and whether it meets the goal on this beam."""
    (point_s,), (tag,), [(along, across)], angle = targets.s.tolist(), targets.tag.tolist(), targets.offset, 0.0
    for _ in range(_PASSES if along or across else 1):
        cos, sin = np.cos(angle), np.sin(angle)
        axis = goal - np.array([cos * along - sin * across, sin * along + cos * across])
        result = reach(beam, axis, push_s=push_s, point_s=point_s, settings=settings)
        angle = result.reached[2]
    if learned is not None and (not result.converged or learned[-1].beyond(result.force)):
        which = tag if tag >= 0 else None
        near = reach_in_setup(*learned, goal, push_s=push_s, point_s=point_s, tag=which, settings=settings)
        return near.on_beam, False
    if not result.converged:
        raise ControlError(result.reason)
    return result.force, True


_SLACK = 1.002  # margin for resampling


@dataclass(frozen=True)
class RateLimits:
    """Largest rates; infinite: none."""

    force: float = option("--max-force-rate-N-per-s", np.inf, within=POSITIVE)
    speed: float = option("--max-speed-m-per-s", np.inf, within=POSITIVE)
    turning: float = option("--max-turn-rate-deg-per-s", np.inf, within=POSITIVE, scale=np.pi / 180.0)

    def __post_init__(self) -> None:
        if not min(self.force, self.speed, self.turning) > 0.0:
            got = f"{self.force:g} N/s, {self.speed:g} m/s, {self.turning:g} rad/s"
            raise ControlError(f"limits on rates must be positive, got {got}")


_Limited = tuple[Array, float]  # (T, d) a quantity at T moments, and the limit on its rate per second


def _excess(moving: list[_Limited], time: Array) -> Array:
    """(T - 1, n) rate over limit."""
    step = np.diff(time)
    return np.stack([np.linalg.norm(np.diff(values, axis=0), axis=1) / step / most for values, most in moving], axis=1)


_NEIGHBOURS = 5  # samples that are slowed down together


def _stretched(moving: list[_Limited], time: Array) -> Array:
    """(T,) moments moved apart where a limit is exceeded, by the largest excess over `_NEIGHBOURS`."""
    if not moving:
        return time
    excess = np.max(_excess(moving, time), axis=1)
    slower = maximum_filter1d(np.where(excess > 1.0, _SLACK * excess, 1.0), _NEIGHBOURS, mode="nearest")
    return np.append(time[0], time[0] + np.cumsum(np.diff(time) * slower))


# The beam is quasi-static. Shapes are solved in turn at knots, interpolated, and corrected together.

_LARGEST_TAIL = 1e-4  # share of the last Legendre coefficients at the worst knot: positions to about 1e-6 L
_FINEST_PANEL = 1.0 / 16.0
_MOST_STRETCHES = 8
MOST_SAMPLES = 200_000
_MOMENTS_PER_SAMPLE = 4  # for rates


@dataclass(frozen=True)
class PathSettings:
    rate: float = option("--rate-Hz", 1000.0, within=(1e-6, 1e6))
    limits: RateLimits = field(default_factory=RateLimits)
    shape: ShapeSettings = field(default_factory=ShapeSettings)


@dataclass(frozen=True)
class FollowedPath:
    """T samples of the controls, and the distance from the goals."""

    time: Array  # (T,) s, evenly spaced from 0
    goal_time: Array  # (T,) s, of the goals; differs from `time` if stretched
    goals: Goals
    actuators: Actuators
    q: Array  # (T, Q) rad
    u: Array  # (T, m) N, N m: pushes, then the gripper's wrench
    miss: Array  # (T,) m: weighted RMS distance
    margin: Array  # (K,) at knots
    margin_time: Array  # (K,) s
    warnings: tuple[str, ...]
    setup: SetUp | None = None  # whose sensor shows the forces

    @cached_property
    def forces(self) -> Array:
        """(T, a, 2) N: as the sensor of the set-up shows them, without one as they act on the beam."""
        if self.setup is None:
            return self.forces_on_beam
        solved = self.actuators.solved(self.q, self.u)
        return self.setup.shown(self.actuators.problem, solved, self.forces_on_beam)

    @property
    def forces_on_beam(self) -> Array:
        """(T, a, 2) N."""
        return np.asarray(self.u[:, : 2 * len(self.actuators.pushes)].reshape(len(self.time), -1, 2))

    @property
    def poses(self) -> Array:
        """(T, 3) m, m, rad: of s = 1, or the gripper, counting full turns."""
        return end_pose(self.actuators.problem, self.q)

    @property
    def wrench(self) -> Array | None:
        """(T, 3) N, N, N m on the beam, if gripped."""
        return None if self.actuators.grip is None else self.u[:, -3:]

    @property
    def stretch(self) -> float:
        """Duration over that of the goals."""
        return float(self.time[-1] / (self.goals.time[-1] - self.goals.time[0]))

    def xy(self, s: ArrayLike) -> Array:
        """(T, S, 2) m at `s`."""
        return self.actuators.solved(self.q, self.u).xy(np.atleast_1d(np.asarray(s, dtype=float)))


@one_blas_thread
def follow_goals(
    beam: Rod,
    goals: Goals,
    *,
    pushes: tuple[Pusher, ...] = (),
    grip: Grip | None = None,
    gravity: ArrayLike | None = None,
    settings: PathSettings = PathSettings(),
) -> FollowedPath:
    """The controls that follow the goals as closely as possible, from the first goal on.

    Raises `ControlError` with the time: goals that do not determine the actuators, no stable way, or too many
    samples. Raises `MechanicsError`: k(s) not positive.
    """
    if not settings.rate > 0.0:
        raise ControlError(f"a rate of samples must be positive, got {settings.rate:g} Hz")
    _even(goals.time[-1] - goals.time[0], settings.rate)  # checked before the work
    check_metres(goals.xy, float(beam.length))
    knots = knots_of(goals, float(beam.length))
    resolution = settings.shape.resolution
    while True:
        search = replace(settings.shape, resolution=resolution)
        first = shape(beam, goals.at(knots[0]), pushes=pushes, grip=grip, gravity=gravity, settings=search)
        path = _first_pass(goals, knots, first, settings)
        tail = max(float(state.solved.problem.grid.legendre_tail(state.q)) for state in path.states)
        if tail < _LARGEST_TAIL or resolution.widest <= _FINEST_PANEL:
            return path.sampled()
        resolution = resolution.finer()


def _first_pass(goals: Goals, knots: Array, first: ShapeResult, settings: PathSettings) -> _KnottedPath:
    """Shapes at the knots, each from the one before."""
    if first.open_freedoms:
        raise ControlError(
            f"the goals leave {first.open_freedoms} of {first.state.actuators.count} freedoms of the forces and the "
            "gripper open, so that there is no one path; want more of the beam (angle_rad, more points), or leave out "
            "a force or the gripper"
        )
    state, damping = first.state, DAMPING
    arm = float(state.actuators.problem.length) if settings.shape.arm is None else settings.shape.arm
    states, at_bound = [], []
    for time in knots.tolist():
        result = descend(state, goals.at(time), arm, damping)
        state, damping = result.state, 0.0
        states.append(state)
        at_bound.append(bool(np.any(result.multipliers > 0.0)))
        if result.near_buckling:
            raise ControlError(
                f"at {time:.4g} s the beam is about to buckle (margin {state.margin:.3g}) on its way to the goal; "
                "lead it another way, or give it a grip"
            )
        if not result.converged:
            raise ControlError(f"at {time:.4g} s no stable shape closest to the goal was found; give goals before it")
    return _KnottedPath(goals, knots, tuple(states), np.array(at_bound), arm, settings)


@dataclass(frozen=True)
class _KnottedPath:
    """Goals, and the closest shapes at knots."""

    goals: Goals
    knots: Array  # (K,) s
    states: tuple[BeamState, ...]
    at_bound: BoolArray  # (K,)
    arm: float  # m
    settings: PathSettings

    @property
    def actuators(self) -> Actuators:
        return self.states[0].actuators

    def sampled(self) -> FollowedPath:
        """Samples at the requested rate, stretched for limits."""
        rate, goals, actuators = self.settings.rate, self.goals, self.actuators
        duration, near = goals.time[-1] - goals.time[0], self._between
        goal_time = goals.time[0] + np.minimum(_even(duration, rate), duration)
        for trial in range(_MOST_STRETCHES + 1):
            frames = self._corrected(self._split(near(goal_time)), goal_time)
            time, moving = np.arange(len(goal_time)) / rate, self._moving(frames)
            if trial == _MOST_STRETCHES:
                raise ControlError(
                    "the limits on rates could not be kept by stretching the path; are they far too low?"
                )
            if not moving or np.max(_excess(moving, time)) <= 1.0 + 1e-9:
                break
            goal_time, near = self._slower(moving, frames, time, goal_time, everywhere=trial > 1)
        xy, angle = goals.along(goal_time)
        residuals = target_residuals_along(actuators.solved(frames.q, frames.u), goals.targets, xy, angle, self.arm)
        miss = float(actuators.problem.length) * np.sqrt(residuals.cost / np.sum(goals.targets.weight))
        margin = np.array([state.margin for state in self.states])
        warnings = self._warnings(miss, goal_time, margin, frames)
        return FollowedPath(time, goal_time, goals, actuators, frames.q, frames.u, miss, margin, self.knots, warnings)

    def _slower(
        self, moving: list[_Limited], frames: PathSamples, time: Array, goal_time: Array, *, everywhere: bool
    ) -> tuple[Array, CubicSpline]:
        """Slower times of the goals that keep the limits, and the samples as a spline; with `everywhere` not only where
        a limit is exceeded."""
        inside = np.append(True, np.diff(goal_time) > 0.0)
        near = CubicSpline(goal_time[inside], np.concatenate([frames.q, frames.u, frames.multipliers], axis=1)[inside])
        if everywhere:
            fine, law = goal_time[inside], time[inside] * float(np.max(_excess(moving, time))) * 1.001
        else:
            fine = np.linspace(goal_time[0], goal_time[-1], _MOMENTS_PER_SAMPLE * len(goal_time))
            law = np.interp(fine, goal_time[inside], time[inside])
            law = _stretched(self._moving(self._split(near(fine))), law)
        return np.interp(_even(law[-1], self.settings.rate), law, fine), near

    @cached_property
    def _between(self) -> CubicSpline:
        rows = []
        for time, state in zip(self.knots.tolist(), self.states, strict=True):
            residuals = target_residuals(state.solved, self.goals.at(time), self.arm)
            rows.append(np.concatenate([state.q, state.u, multipliers(state, residuals)]))
        return CubicSpline(self.knots, np.array(rows))

    def _split(self, values: Array) -> PathSamples:
        count = len(self.actuators.problem.weights)
        return PathSamples(*np.split(values, [count, count + self.actuators.count], axis=1))

    def _corrected(self, start: PathSamples, goal_time: Array) -> PathSamples:
        """The closest shapes at the samples; one by one at bounds or where the batch failed."""
        actuators, knots = self.actuators, self.knots
        xy, angle = self.goals.along(goal_time)
        frames, ok = settle(actuators, start, self.goals.targets, xy, angle, self.arm)
        after = np.clip(np.searchsorted(knots, goal_time), 1, len(knots) - 1)
        held = self.at_bound[after] | self.at_bound[after - 1]
        for bound in actuators.bounds:
            held |= np.linalg.norm(frames.u[:, bound.columns], axis=1) > bound.most
        for i in np.flatnonzero(~ok | held):
            before = BeamState(actuators, frames.q[i - 1], frames.u[i - 1])
            begin = self.states[after[i] - 1] if i == 0 else before
            result = descend(begin, self.goals.at(float(goal_time[i])), self.arm, damping=0.0)
            if not result.converged:
                found = "no stable shape closest to the goal was found on the way from the last one"
                raise ControlError(f"at {goal_time[i]:.4g} s {found}")
            frames.q[i], frames.u[i] = result.state.q, result.state.u
        return frames

    def _moving(self, frames: PathSamples) -> list[_Limited]:
        """Quantities with a finite limit."""
        limits = self.settings.limits
        every = [(frames.u[:, 2 * i : 2 * i + 2], limits.force) for i in range(len(self.actuators.pushes))]
        if self.actuators.grip is not None:
            poses = end_pose(self.actuators.problem, frames.q)
            every += [(poses[:, :2], limits.speed), (poses[:, 2:], limits.turning)]
        return [one for one in every if np.isfinite(one[1])]

    def _warnings(self, miss: Array, goal_time: Array, margin: Array, frames: PathSamples) -> tuple[str, ...]:
        out, knots = [*self.goals.warnings], self.knots
        if np.max(miss) > 1e-6 * float(self.actuators.problem.length):
            worst, most = goal_time[np.argmax(miss)], 1e3 * np.max(miss)
            out.append(f"the goals cannot all be met: at worst {most:.3g} mm are missing, at {worst:.4g} s")
        if np.min(margin) < NEAR_BUCKLING:
            out.append(
                f"close to buckling at {knots[np.argmin(margin)]:.4g} s: the tangent's smallest eigenvalue is "
                f"{np.min(margin):.3f} of that without loads"
            )
        for bound in self.actuators.bounds:
            at_limit = np.linalg.norm(frames.u[:, bound.columns], axis=1) > (1.0 - 1e-6) * bound.most
            if np.any(at_limit):
                out.append(f"{bound.name} is at its limit from {goal_time[np.argmax(at_limit)]:.4g} s")
        return tuple(out)


def _even(duration: float, rate: float) -> Array:
    """Moments at the rate up to the first at or after the duration. Raises `ControlError` if too many."""
    if not duration * rate <= MOST_SAMPLES:
        raise ControlError(
            f"the path takes {duration:.4g} s, {duration * rate:.3g} samples at {rate:g} Hz; at most {MOST_SAMPLES} "
            "are made. Take a lower rate of samples, larger limits on rates, or fewer goals"
        )
    return np.arange(int(np.ceil(duration * rate - 1e-9)) + 1) / rate


# The spread of a path due to the band on k(s), to first order.

_MOMENTS = 25


@dataclass(frozen=True)
class PathSpread:
    """sds at M moments."""

    time: Array  # (M,) s
    rms: Array  # (M,) m: RMS over the targets' places


@one_blas_thread
def path_spread(way: FollowedPath, uncertain: UncertainStiffness) -> PathSpread:
    """At up to `_MOMENTS` evenly spaced samples, with the first and last."""
    chosen = np.unique(np.round(np.linspace(0, len(way.time) - 1, _MOMENTS)).astype(int))
    states = (BeamState(way.actuators, way.q[i], way.u[i]) for i in chosen)
    return PathSpread(way.time[chosen], np.array([spread(one, way.goals.targets, uncertain).rms for one in states]))
