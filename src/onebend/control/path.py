"""Goals in time to forces, or poses of a gripper, in time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import maximum_filter1d

from onebend.beam.clamped_ends import end_pose, stands
from onebend.beam.grid import transposed
from onebend.beam.model import Beam
from onebend.beam.problem import Rod
from onebend.beam.statics import balance, is_stable, nodal_forces, scaled, solve_batch
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.goals import Goals, Targets, check_metres, target_residuals, target_residuals_along
from onebend.control.loaded_beam import ReachSettings
from onebend.control.reach import reach
from onebend.control.shape import (
    Actuators,
    BeamState,
    DescentResult,
    DescentSettings,
    Grip,
    Pusher,
    ShapeSettings,
    actions,
    control_coupling,
    descend,
    multipliers,
    resting_state,
    shape,
    spread,
)
from onebend.errors import ControlError, MechanicsError
from onebend.options import POSITIVE, option
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray

# Many shapes along a path at once: Newton's method on the conditions of the optimum, from shapes close by.
#
# With the multipliers l of equilibrium the conditions of the closest shape are `r_q^T r + T l = 0`, `A l = 0` and
# `g = 0`; Newton's matrix holds the exact second derivatives, and is symmetric.

_LAST_STEP = 1e-10  # rad, of the last step
_MOST_ITERATIONS = 6  # Newton iterations
_LARGEST_TURN = 0.05  # rad, from the shape to start from
_BATCH = 128  # frames solved together: what stays in the cache


@dataclass(frozen=True)
class PathSamples:
    """T equilibria under the same actuators, and their multipliers."""

    q: Array  # (T, Q) rad
    u: Array  # (T, m) N, N m
    multipliers: Array  # (T, Q)

    def take(self, chosen: slice | BoolArray) -> PathSamples:
        """Some of them."""
        return PathSamples(self.q[chosen], self.u[chosen], self.multipliers[chosen])


def settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    """The closest stable shapes to targets xy (T, N, 2), angle (T, N), from ones `near`; True where found there.

    Bounds on forces are not looked at.
    """
    out = PathSamples(near.q.copy(), near.u.copy(), near.multipliers.copy())
    converged = np.zeros(len(near.q), dtype=bool)
    for i in range(0, len(converged), _BATCH):
        part = slice(i, i + _BATCH)
        here, ok = _settle(actuators, near.take(part), targets, xy[part], angle[part], arm)
        out.q[part], out.u[part], out.multipliers[part], converged[part] = here.q, here.u, here.multipliers, ok
    return out, converged


def _settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    q, u, prices = near.q.copy(), near.u.copy(), near.multipliers.copy()
    settled, b = np.zeros(len(q), dtype=bool), actuators.problem.to_nodes
    for _ in range(_MOST_ITERATIONS):
        todo = np.flatnonzero(~settled)
        if todo.size == 0:
            break
        dq, du, new = _step(actuators, PathSamples(q[todo], u[todo], prices[todo]), targets, xy[todo], angle[todo], arm)
        q[todo], u[todo], prices[todo] = q[todo] + dq, u[todo] + du, new
        settled[todo] = np.max(np.abs(dq @ b.T), axis=1) < _LAST_STEP
    settled &= np.max(np.abs((q - near.q) @ b.T), axis=1) < _LARGEST_TURN
    settled[settled] &= stable(actuators, q[settled], u[settled])
    return PathSamples(q, u, prices), settled


def stable(actuators: Actuators, q: Array, u: Array) -> BoolArray:
    """(T,) whether the shapes stand: pushes are dead loads, a gripped end stays where it is."""
    if len(q) == 0:
        return np.zeros(0, dtype=bool)
    if actuators.grip is None:
        return is_stable(actuators.loaded(u), q)
    bare = u.copy()
    bare[:, -3:] = 0.0
    return stands(actuators.loaded(bare), q, u[:, -3:])


def _step(
    actuators: Actuators, samples: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[Array, Array, Array]:
    """Newton's step of q and u, and the new multipliers; curvature and controls in units that make numbers about 1."""
    solved, b = actuators.solved(samples.q, samples.u), actuators.problem.to_nodes
    problem, count, controls = solved.problem, samples.q.shape[1], actuators.count
    residuals = target_residuals_along(solved, targets, xy, angle, arm)
    out, matrix = balance(problem, samples.q)
    stiff, root = scaled(problem, matrix), np.sqrt(actuators.mean_stiffness)
    unbend, unit = 1.0 / np.sqrt(problem.weights * problem.k), actuators.scale / root
    turned = samples.multipliers @ b.T
    bent = residuals.curvature_term + nodal_forces(problem, samples.q).across * turned
    rows = residuals.jacobian * unbend
    second = transposed(rows) @ rows + scaled(problem, transposed(b) @ (bent[..., None] * b))
    coupled = unit[:, None] * (control_coupling(actuators, solved.alpha, turned) @ b) * unbend
    acting = unit[:, None] * actions(actuators, solved) * unbend
    a, z = count + controls, np.s_[:]
    system = np.zeros((len(samples.q), a + count, a + count))
    system[z, :count, :count], system[z, :count, count:a], system[z, count:a, :count] = (
        second,
        transposed(coupled),
        coupled,
    )
    system[z, :count, a:], system[z, a:, :count] = stiff, stiff
    system[z, count:a, a:], system[z, a:, count:a] = -acting, -transposed(acting)
    right = np.zeros((len(samples.q), a + count))
    right[:, :count] = -np.einsum("trq,tr->tq", rows, residuals.value) / root
    right[:, a:] = -out * unbend / root
    answer = solve_batch(system, right)
    return root * unbend * answer[:, :count], actuators.scale * answer[:, count:a], root * unbend * answer[:, a:]


# A path's first pass: shapes at knots along it, each found from the one before.

_KNOT_SPACING = 0.02  # of L: the way of a target from knot to knot
_FEWEST_KNOTS = 12  # knots


def knots_of(goals: Goals, length: float) -> Array:
    """(K,) s: close enough for the shape at one to lead to that at the next."""
    time = np.union1d(np.linspace(goals.time[0], goals.time[-1], 200), goals.time)
    xy, angle = goals.along(time)
    way = np.nan_to_num(np.linalg.norm(np.diff(xy, axis=0), axis=2) / length).max(axis=1)
    turn = np.nan_to_num(np.abs(np.diff(angle, axis=0))).max(axis=1)
    done = np.append(0.0, np.cumsum(np.maximum(way, turn)))
    # Where the goals rest there is no way to go: a little of plain time keeps knots there as well.
    done = done / max(done[-1], 1e-12) + 0.25 * (time - time[0]) / (time[-1] - time[0])
    count = max(_FEWEST_KNOTS, int(np.ceil(np.sum(np.maximum(way, turn)) / _KNOT_SPACING)) + 1)
    return np.asarray(np.interp(np.linspace(0.0, done[-1], count), done, time))


def first_pass(
    beam: Rod,
    goals: Goals,
    knots: Array,
    arm: float,
    pushes: tuple[Pusher, ...],
    grip: Grip | None,
    gravity: ArrayLike | None,
    settings: ShapeSettings,
) -> list[DescentResult]:
    """The shapes at the knots: the first from rest, each other one from that before."""
    first = shape(beam, goals.at(knots[0]), pushes=pushes, grip=grip, gravity=gravity, settings=settings)
    if first.open_freedoms:
        raise ControlError(
            f"the goals leave {first.open_freedoms} of {first.state.actuators.count} freedoms of the forces and the "
            "gripper open, so that there is no one path; want more of the beam (angle_rad, more points), or leave out "
            "a force or the gripper"
        )
    resting = resting_state(beam, pushes, grip, gravity, settings.resolution)
    grid = first.state.actuators.problem.grid
    state = BeamState(
        resting.actuators, grid.value_at(resting.actuators.problem.grid.nodes) @ first.state.q, first.state.u
    )
    results = [descend(state, goals.at(knots[0]), arm, settings.descent)]
    warm = replace(settings.descent, damping=0.0)
    for before, time in pairwise(knots):
        _check(results[-1], float(before))
        results.append(descend(results[-1].state, goals.at(float(time)), arm, warm))
    _check(results[-1], float(knots[-1]))
    return results


def _check(result: DescentResult, time: float) -> None:
    if result.near_buckling:
        raise ControlError(
            f"at {time:.4g} s the beam is about to buckle (margin {result.state.margin:.3g}) on its way to the goal; "
            "lead it another way, or give it a grip"
        )
    if not result.converged:
        raise ControlError(f"at {time:.4g} s no stable shape closest to the goal was found; give more goals before it")


# Goals of one point under a single force, joined by a path on which the force exists everywhere.
#
# One force can hold a point only within a thin region, where the beam is stable; a straight path from goal to goal
# may leave it. So the force is interpolated from goal to goal, and the point follows.

_GOALS_PER_STEP = 24  # goals from goal to goal
_SAME_PLACE = 1e-5  # of L


@one_blas_thread
def by_force(
    beam: Beam,
    goals: Goals,
    *,
    push_s: float = 1.0,
    max_force: float | None = None,
    gravity: tuple[float, float] = (0.0, 0.0),
) -> Goals:
    """The same goals at the same times, and more between them, all within reach of a force at `push_s`.

    Raises:
        ControlError: goals of more than one point or of an angle, a goal out of reach (with its time), or a force that
            goes from goal to goal through a place where the beam would jump.
    """
    if len(goals.targets.s) != 1 or not bool(goals.targets.placed[0]) or bool(goals.targets.turned[0]):
        raise ControlError("a single force leads one point, without an angle; lead more with a grip or more forces")
    point_s = float(goals.targets.s[0])
    settings = ReachSettings(max_force=max_force, gravity=gravity)
    forces = np.array([_force(beam, goals, k, push_s, point_s, settings) for k in range(len(goals.time))])
    time = np.unique(
        np.concatenate(
            [np.linspace(*ends, _GOALS_PER_STEP + 1) for ends in zip(goals.time, goals.time[1:], strict=False)]
        )
    )
    try:
        forces = PchipInterpolator(goals.time, forces)(time)
        shape = beam.equilibrium(forces, push_s, gravity=gravity if any(gravity) else None)
    except MechanicsError as error:
        raise ControlError(f"on the way from goal to goal {error}") from error
    xy = shape.xy(np.array([point_s]))
    met = np.linalg.norm(xy[np.searchsorted(time, goals.time), 0] - goals.xy[:, 0], axis=1)
    if np.max(met) > _SAME_PLACE * beam.length:
        at = goals.time[int(np.argmax(met))]
        raise ControlError(f"the goal at {at:.4g} s lies on another branch of shapes: the beam would jump on its way")
    return replace(goals, time=time, xy=xy, angle=np.full((len(time), 1), np.nan))


def _force(beam: Beam, goals: Goals, k: int, push_s: float, point_s: float, settings: ReachSettings) -> Array:
    result = reach(beam, goals.xy[k, 0], push_s=push_s, point_s=point_s, settings=settings)
    if not result.converged:
        raise ControlError(f"the goal at {goals.time[k]:.4g} s: {result.reason}")
    return np.asarray(result.force)


# Limits on the rates of forces and of the gripper, and the time that a path needs to keep them.

_SLACK = 1.002  # a little slower than the limit asks, so that sampling anew does not break it again


@dataclass(frozen=True)
class RateLimits:
    """The largest rates; infinite where there is no limit."""

    force: float = option("--max-force-rate-N-per-s", np.inf, "Of every push.", metavar="N/S", within=POSITIVE)
    speed: float = option("--max-speed-m-per-s", np.inf, "Of the gripper.", metavar="M/S", within=POSITIVE)
    turning: float = option(
        "--max-turn-rate-deg-per-s", np.inf, "Of the gripper.", metavar="DEG/S", within=POSITIVE, scale=np.pi / 180.0
    )

    def __post_init__(self) -> None:
        if not min(self.force, self.speed, self.turning) > 0.0:
            got = f"{self.force:g} N/s, {self.speed:g} m/s, {self.turning:g} rad/s"
            raise ControlError(f"limits on rates must be positive, got {got}")


@dataclass(frozen=True)
class LimitedQuantities:
    """Quantities at T moments of a path, each with the limit on its rate."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[Array, ...]  # each (T, d)
    most: tuple[float, ...]  # per second

    def excess(self, time: Array) -> Array:
        """(T - 1, n) rate over limit between one moment and the next."""
        step = np.diff(time)
        rates = [np.linalg.norm(np.diff(quantity, axis=0), axis=1) / step for quantity in self.values]
        return np.stack([rate / most for rate, most in zip(rates, self.most, strict=True)], axis=1)


def refuse(moving: LimitedQuantities, time: Array) -> None:
    """Raise `ControlError` with the first moment at which a limit is broken, and by how much."""
    excess = moving.excess(time)
    broken = np.flatnonzero(np.any(excess > 1.0 + 1e-9, axis=1))
    if broken.size:
        i = int(broken[0])
        j = int(np.argmax(excess[i]))
        raise ControlError(
            f"at {time[i]:.4g} s the rate of {moving.names[j]} is {excess[i, j] * moving.most[j]:.4g} "
            f"{moving.units[j]}, its limit {moving.most[j]:.4g}; the worst is {np.max(excess):.3g} times the limit. "
            "Give the path more time, or let it be stretched"
        )


def stretched(moving: LimitedQuantities, time: Array, smooth: int = 5) -> Array:
    """(T,) the moments moved apart where a limit is broken, and only there.

    The largest excess over `smooth` neighbours counts, so that finer moments in between keep the limits as well.
    """
    excess = np.max(moving.excess(time), axis=1)
    slower = np.where(excess > 1.0, _SLACK * excess, 1.0)
    slower = maximum_filter1d(slower, smooth, mode="nearest")
    return np.append(time[0], time[0] + np.cumsum(np.diff(time) * slower))


# Goals in time to forces, or gripper poses, in time: at 1 kHz if asked, within limits on their rates.
#
# The beam is taken as it stands under the forces of the moment (quasi-static). Shapes are sought one after the other
# at knots along the path, each from the one before; between the knots they are interpolated and then corrected
# together.

_LARGEST_TAIL = 1e-4  # share of the last Legendre coefficients, at the worst knot: positions are good to about 1e-6 L
_FINEST_PANEL = 1.0 / 16.0  # widest panel
_MOST_STRETCHES = 8  # of stretching
MOST_SAMPLES = 200_000
_MOMENTS_PER_SAMPLE = 4  # moments a sample, at which rates are looked at


@dataclass(frozen=True)
class PathSettings:
    """How a path is made."""

    rate: float = option("--rate-Hz", 1000.0, "Samples of the path.", metavar="HZ", within=(1e-6, 1e6))
    limits: RateLimits = field(default_factory=RateLimits)
    too_fast: Literal["stretch", "refuse"] = option(
        "--too-fast", "stretch", "Where a limit on a rate is broken: take more time there, or say when and stop."
    )
    shape: ShapeSettings = field(default_factory=ShapeSettings)


@dataclass(frozen=True)
class FollowedPath:
    """T samples of the controls, and how close the beam comes to its goals."""

    time: Array  # (T,) s, from 0 on, evenly spaced
    goal_time: Array  # (T,) s, the time of the goals that each sample serves; other than `time` where stretched
    goals: Goals
    actuators: Actuators
    q: Array  # (T, Q) rad
    u: Array  # (T, m) N, N m: the pushes' forces in turn, then the gripper's wrench
    miss: Array  # (T,) m: root of the weighted mean square distance from the goals
    margin: Array  # (K,) of stability, at knots
    margin_time: Array  # (K,) s, of the goals
    warnings: tuple[str, ...]

    @property
    def forces(self) -> Array:
        """(T, a, 2) N."""
        return np.asarray(self.u[:, : 2 * len(self.actuators.pushes)].reshape(len(self.time), -1, 2))

    @property
    def poses(self) -> Array:
        """(T, 3) m, m, rad: of the end s = 1; with a grip, of the gripper. The angle counts full turns."""
        return end_pose(self.actuators.problem, self.q)

    @property
    def wrench(self) -> Array | None:
        """(T, 3) N, N, N m that the gripper puts on the beam; None without one."""
        return None if self.actuators.grip is None else self.u[:, -3:]

    @property
    def stretch(self) -> float:
        """Duration over that of the goals."""
        return float(self.time[-1] / (self.goals.time[-1] - self.goals.time[0]))

    def xy(self, s: ArrayLike) -> Array:
        """(T, S, 2) m, the beam's positions at `s`."""
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
    """The controls with which the beam follows the goals as closely as it can at every moment.

    The first sample serves the first goal: how the beam comes there is not part of the path.

    Raises:
        ControlError: goals that leave a freedom of the actuators open, no stable way from one goal to the next, or a
            broken limit on a rate where `too_fast` is "refuse"; each says at what time. Too many samples.
        MechanicsError: k(s) not positive.
    """
    if not settings.rate > 0.0:
        raise ControlError(f"a rate of samples must be positive, got {settings.rate:g} Hz")
    _even(goals.time[-1] - goals.time[0], settings.rate)  # too many samples are said before the work
    check_metres(goals.xy, float(beam.length))
    knots = knots_of(goals, float(beam.length))
    arm = float(beam.length) if settings.shape.arm is None else settings.shape.arm
    resolution = settings.shape.resolution
    while True:
        trying = replace(settings.shape, resolution=resolution)
        results = first_pass(beam, goals, knots, arm, pushes, grip, gravity, trying)
        tail = max(
            float(knot_result.state.solved.problem.grid.legendre_tail(knot_result.state.q)) for knot_result in results
        )
        if tail < _LARGEST_TAIL or resolution.widest <= _FINEST_PANEL:
            break
        resolution = resolution.finer()
    return _sampled(results, goals, knots, arm, settings)


def _sampled(
    results: list[DescentResult], goals: Goals, knots: Array, arm: float, settings: PathSettings
) -> FollowedPath:
    """Samples at the asked rate, the time stretched where a limit wants it."""
    actuators, near = results[0].state.actuators, _between(results, goals, knots, arm)
    duration = goals.time[-1] - goals.time[0]
    goal_time = goals.time[0] + np.minimum(_even(duration, settings.rate), duration)
    frames = _corrected(actuators, _split(near(goal_time), actuators), results, goals, knots, goal_time, arm, settings)
    for trial in range(_MOST_STRETCHES):
        time = np.arange(len(goal_time)) / settings.rate
        moving = _moving(actuators, frames, settings.limits)
        if not moving.names or np.max(moving.excess(time)) <= 1.0 + 1e-9:
            break
        if settings.too_fast == "refuse":
            refuse(moving, time)
        goal_time, near = _slower(moving, actuators, frames, time, goal_time, settings, everywhere=trial > 1)
        frames = _corrected(
            actuators, _split(near(goal_time), actuators), results, goals, knots, goal_time, arm, settings
        )
    else:
        raise ControlError("the limits on rates could not be kept by stretching the path; are they far too low?")
    xy, angle = goals.along(goal_time)
    residuals = target_residuals_along(actuators.solved(frames.q, frames.u), goals.targets, xy, angle, arm)
    length = float(actuators.problem.length)
    miss = length * np.sqrt(residuals.cost / np.sum(goals.targets.weight))
    margin = np.array([knot_result.state.margin for knot_result in results])
    warnings = _warnings(miss, goal_time, margin, knots, actuators, frames, settings, length)
    return FollowedPath(time, goal_time, goals, actuators, frames.q, frames.u, miss, margin, knots, warnings)


def _slower(
    moving: LimitedQuantities,
    actuators: Actuators,
    frames: PathSamples,
    time: Array,
    goal_time: Array,
    settings: PathSettings,
    *,
    everywhere: bool,
) -> tuple[Array, CubicSpline]:
    """Other times of the goals for the samples, so that the limits are kept; and the samples so far as a spline.

    Slower only where a limit wants it, or `everywhere`, where that was tried and kinks of the path still break one.
    """
    inside = np.append(True, np.diff(goal_time) > 0.0)
    values = np.concatenate([frames.q, frames.u, frames.multipliers], axis=1)[inside]
    near = CubicSpline(goal_time[inside], values)
    if everywhere:
        fine, law = goal_time[inside], time[inside] * float(np.max(moving.excess(time))) * 1.001
    else:
        fine = np.linspace(goal_time[0], goal_time[-1], _MOMENTS_PER_SAMPLE * len(goal_time))
        law = np.interp(fine, goal_time[inside], time[inside])
        law = stretched(_moving(actuators, _split(near(fine), actuators), settings.limits), law)
    return np.interp(_even(law[-1], settings.rate), law, fine), near


def _even(duration: float, rate: float) -> Array:
    """Moments at the rate, from 0 to the first at or after the duration; a `ControlError` where they are too many."""
    if not duration * rate <= MOST_SAMPLES:
        raise ControlError(
            f"the path takes {duration:.4g} s, {duration * rate:.3g} samples at {rate:g} Hz; at most {MOST_SAMPLES} "
            "are made. Take a lower rate of samples, larger limits on rates, or fewer goals"
        )
    return np.arange(int(np.ceil(duration * rate - 1e-9)) + 1) / rate


def _between(results: list[DescentResult], goals: Goals, knots: Array, arm: float) -> CubicSpline:
    """Shapes, controls and multipliers between the knots."""
    rows = []
    for time, knot_result in zip(knots, results, strict=True):
        residuals = target_residuals(knot_result.state.solved, goals.at(float(time)), arm)
        rows.append(
            np.concatenate([knot_result.state.q, knot_result.state.u, multipliers(knot_result.state, residuals)])
        )
    return CubicSpline(knots, np.array(rows))


def _split(values: Array, actuators: Actuators) -> PathSamples:
    """Interpolated values as what they stand for."""
    count = len(actuators.problem.weights)
    return PathSamples(
        values[:, :count], values[:, count : count + actuators.count], values[:, count + actuators.count :]
    )


def _corrected(
    actuators: Actuators,
    start: PathSamples,
    results: list[DescentResult],
    goals: Goals,
    knots: Array,
    goal_time: Array,
    arm: float,
    settings: PathSettings,
) -> PathSamples:
    """The closest shapes at the samples; one by one where a bound holds or the batch did not find them."""
    xy, angle = goals.along(goal_time)
    frames, ok = settle(actuators, start, goals.targets, xy, angle, arm)
    at_bound = np.array([bool(np.any(knot_result.multipliers > 0.0)) for knot_result in results])
    after = np.clip(np.searchsorted(knots, goal_time), 1, len(knots) - 1)
    held = at_bound[after] | at_bound[after - 1]
    for bound in actuators.bounds:
        held |= np.linalg.norm(frames.u[:, bound.columns], axis=1) > bound.most
    warm = replace(settings.shape.descent, damping=0.0)
    for i in np.flatnonzero(~ok | held):
        frames.q[i], frames.u[i] = _alone(results, after, frames, int(i), goals, float(goal_time[i]), arm, warm)
    return frames


def _alone(
    results: list[DescentResult],
    after: IntArray,
    frames: PathSamples,
    i: int,
    goals: Goals,
    time: float,
    arm: float,
    warm: DescentSettings,
) -> tuple[Array, Array]:
    """One sample, from the one before it."""
    first = results[after[i] - 1].state
    begin = first if i == 0 else BeamState(first.actuators, frames.q[i - 1], frames.u[i - 1])
    result = descend(begin, goals.at(time), arm, warm)
    if not result.converged:
        raise ControlError(
            f"at {time:.4g} s no stable shape closest to the goal was found on the way from the last one"
        )
    return result.state.q, result.state.u


def _moving(actuators: Actuators, frames: PathSamples, limits: RateLimits) -> LimitedQuantities:
    """What has a finite limit."""
    rows: list[tuple[str, str, Array, float]] = [
        (f"the force at s = {pusher.at_s:g}", "N/s", frames.u[:, 2 * i : 2 * i + 2], limits.force)
        for i, pusher in enumerate(actuators.pushes)
    ]
    if actuators.grip is not None:
        poses = end_pose(actuators.problem, frames.q)
        rows.append(("the gripper's place", "m/s", poses[:, :2], limits.speed))
        rows.append(("the gripper's angle", "rad/s", poses[:, 2:], limits.turning))
    rows = [row for row in rows if np.isfinite(row[3])]
    names, units, values, most = (tuple(row[i] for row in rows) for i in range(4))
    return LimitedQuantities(names, units, values, most)  # type: ignore[arg-type]


def _warnings(
    miss: Array,
    goal_time: Array,
    margin: Array,
    knots: Array,
    actuators: Actuators,
    frames: PathSamples,
    settings: PathSettings,
    length: float,
) -> tuple[str, ...]:
    out = []
    if np.max(miss) > 1e-6 * length:
        worst = goal_time[np.argmax(miss)]
        out.append(f"the goals cannot all be met: at worst {1e3 * np.max(miss):.3g} mm are missing, at {worst:.4g} s")
    if np.min(margin) < settings.shape.warn_margin:
        out.append(
            f"close to buckling at {knots[np.argmin(margin)]:.4g} s: the tangent's smallest eigenvalue is "
            f"{np.min(margin):.3f} of that without loads"
        )
    for bound in actuators.bounds:
        size = np.linalg.norm(frames.u[:, bound.columns], axis=1)
        if np.max(size) > (1.0 - 1e-6) * bound.most:
            out.append(
                f"{bound.name} is at its limit from {goal_time[np.argmax(size > (1.0 - 1e-6) * bound.most)]:.4g} s"
            )
    return tuple(out)


# The spread of a path that follows from the band on k(s), to first order; the actuators do as commanded.

_MOMENTS = 25


@dataclass(frozen=True)
class PathSpread:
    """Standard deviations at M moments of a path."""

    time: Array  # (M,) s
    rms: Array  # (M,) m: of the targets' places, root of the mean square over them


@one_blas_thread
def path_spread(way: FollowedPath, uncertain: UncertainStiffness, *, moments: int = _MOMENTS) -> PathSpread:
    """The spread of a path at up to `moments` of its samples, evenly spaced, the first and the last among them."""
    chosen = np.unique(np.round(np.linspace(0, len(way.time) - 1, moments)).astype(int))
    stands = [BeamState(way.actuators, way.q[i], way.u[i]) for i in chosen]
    return PathSpread(
        way.time[chosen], np.array([spread(state, way.goals.targets.s, uncertain).rms for state in stands])
    )
