"""Goals in time to forces, or poses of a gripper, in time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
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

    def take(self, chosen: IntArray) -> PathSamples:
        """Some of them."""
        return PathSamples(self.q[chosen], self.u[chosen], self.multipliers[chosen])


def settle(
    actuators: Actuators, near: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[PathSamples, BoolArray]:
    """The closest stable shapes to targets xy (T, N, 2), angle (T, N), from ones `near`; True where found there.

    Newton's method on the conditions of the optimum. Bounds on forces are not looked at.
    """
    q, u, prices = near.q.copy(), near.u.copy(), near.multipliers.copy()
    settled, b, out = np.zeros(len(q), dtype=bool), actuators.problem.to_nodes, PathSamples(q, u, prices)
    for first in range(0, len(q), _BATCH):
        batch = np.arange(first, min(first + _BATCH, len(q)))
        for _ in range(_MOST_ITERATIONS):
            todo = batch[~settled[batch]]
            if todo.size == 0:
                break
            dq, du, prices[todo] = _step(actuators, out.take(todo), targets, xy[todo], angle[todo], arm)
            q[todo], u[todo] = q[todo] + dq, u[todo] + du
            settled[todo] = np.max(np.abs(dq @ b.T), axis=1) < _LAST_STEP
        found = batch[settled[batch] & (np.max(np.abs((q[batch] - near.q[batch]) @ b.T), axis=1) < _LARGEST_TURN)]
        settled[batch] = False
        settled[found] = stable(actuators, q[found], u[found])
    return out, settled


def stable(actuators: Actuators, q: Array, u: Array) -> BoolArray:
    """(T,) whether the shapes stand: pushes are dead loads, a gripped end stays where it is."""
    if actuators.grip is None or len(q) == 0:
        return is_stable(actuators.loaded(u), q)
    bare = u.copy()
    bare[:, -3:] = 0.0
    return stands(actuators.loaded(bare), q, u[:, -3:])


def _step(
    actuators: Actuators, samples: PathSamples, targets: Targets, xy: Array, angle: Array, arm: float
) -> tuple[Array, Array, Array]:
    """Newton's step of q and u, and the new multipliers; curvature and controls in units that make numbers about 1.

    With the multipliers l of equilibrium the conditions are `r_q^T r + T l = 0`, `A l = 0` and `g = 0`. Newton's matrix
    holds the exact second derivatives, and is symmetric.
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

    Raises `ControlError`: goals of more than one point or of an angle, a goal out of reach (with its time), or a force
    that goes from goal to goal through a place where the beam would jump.
    """
    if len(goals.targets.s) != 1 or not bool(goals.targets.placed[0]) or bool(goals.targets.turned[0]):
        raise ControlError("a single force leads one point, without an angle; lead more with a grip or more forces")
    point_s = float(goals.targets.s[0])
    settings = ReachSettings(max_force=max_force, gravity=gravity)
    forces = []
    for at, goal in zip(goals.time, goals.xy[:, 0], strict=True):
        result = reach(beam, goal, push_s=push_s, point_s=point_s, settings=settings)
        if not result.converged:
            raise ControlError(f"the goal at {at:.4g} s: {result.reason}")
        forces.append(result.force)
    time = np.unique(np.concatenate([np.linspace(*ends, _GOALS_PER_STEP + 1) for ends in pairwise(goals.time)]))
    try:
        led = PchipInterpolator(goals.time, np.array(forces))(time)
        shape = beam.equilibrium(led, push_s, gravity=gravity if any(gravity) else None)
    except MechanicsError as error:
        raise ControlError(f"on the way from goal to goal {error}") from error
    xy = shape.xy(np.array([point_s]))
    met = np.linalg.norm(xy[np.searchsorted(time, goals.time), 0] - goals.xy[:, 0], axis=1)
    if np.max(met) > _SAME_PLACE * beam.length:
        at = goals.time[int(np.argmax(met))]
        raise ControlError(f"the goal at {at:.4g} s lies on another branch of shapes: the beam would jump on its way")
    return replace(goals, time=time, xy=xy, angle=np.full((len(time), 1), np.nan))


_SLACK = 1.002  # a little slower than the limit asks, so that sampling anew does not break it again


@dataclass(frozen=True)
class RateLimits:
    """The largest rates; infinite where there is no limit."""

    force: float = option("--max-force-rate-N-per-s", np.inf, "Limit for every push.", metavar="N/S", within=POSITIVE)
    speed: float = option("--max-speed-m-per-s", np.inf, "Limit for the gripper.", metavar="M/S", within=POSITIVE)
    turning: float = option(
        "--max-turn-rate-deg-per-s",
        np.inf,
        "Limit for the gripper.",
        metavar="DEG/S",
        within=POSITIVE,
        scale=np.pi / 180.0,
    )

    def __post_init__(self) -> None:
        if not min(self.force, self.speed, self.turning) > 0.0:
            got = f"{self.force:g} N/s, {self.speed:g} m/s, {self.turning:g} rad/s"
            raise ControlError(f"limits on rates must be positive, got {got}")


@dataclass(frozen=True)
class _Limited:
    """A quantity at T moments of a path, and the limit on its rate."""

    name: str
    unit: str
    values: Array  # (T, d)
    most: float  # per second


def _excess(moving: list[_Limited], time: Array) -> Array:
    """(T - 1, n) rate over limit of each quantity between one moment and the next."""
    step = np.diff(time)
    return np.stack([np.linalg.norm(np.diff(one.values, axis=0), axis=1) / step / one.most for one in moving], axis=1)


def _refuse(moving: list[_Limited], time: Array) -> None:
    """Raise `ControlError` with the first moment at which a limit is broken, and by how much."""
    excess = _excess(moving, time)
    broken = np.flatnonzero(np.any(excess > 1.0 + 1e-9, axis=1))
    if broken.size:
        i = int(broken[0])
        j = int(np.argmax(excess[i]))
        raise ControlError(
            f"at {time[i]:.4g} s the rate of {moving[j].name} is {excess[i, j] * moving[j].most:.4g} "
            f"{moving[j].unit}, its limit {moving[j].most:.4g}; the worst is {np.max(excess):.3g} times the limit. "
            "Give the path more time, or let it be stretched"
        )


def _stretched(moving: list[_Limited], time: Array, smooth: int = 5) -> Array:
    """(T,) the moments moved apart where a limit is broken, and only there.

    The largest excess over `smooth` neighbours counts, so that finer moments in between keep the limits as well.
    """
    if not moving:
        return time
    excess = np.max(_excess(moving, time), axis=1)
    slower = maximum_filter1d(np.where(excess > 1.0, _SLACK * excess, 1.0), smooth, mode="nearest")
    return np.append(time[0], time[0] + np.cumsum(np.diff(time) * slower))


# Goals in time to forces, or gripper poses, in time. The beam is taken as it stands under the forces of the moment
# (quasi-static). Shapes are sought one after the other at knots along the path; between the knots they are interpolated
# and then corrected together.

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
        "--too-fast", "stretch", "Where a rate limit is exceeded: take more time, or stop with an error."
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

    Raises `ControlError`: goals that leave a freedom of the actuators open, no stable way from one goal to the next, or
    a broken limit on a rate where `too_fast` is "refuse"; each says at what time. Too many samples; `MechanicsError`:
    k(s) not positive.
    """
    if not settings.rate > 0.0:
        raise ControlError(f"a rate of samples must be positive, got {settings.rate:g} Hz")
    _even(goals.time[-1] - goals.time[0], settings.rate)  # too many samples are said before the work
    check_metres(goals.xy, float(beam.length))
    knots = knots_of(goals, float(beam.length))
    resolution = settings.shape.resolution
    while True:
        search = replace(settings.shape, resolution=resolution)
        path = _first_pass(beam, goals, knots, pushes, grip, gravity, replace(settings, shape=search))
        tail = max(float(state.solved.problem.grid.legendre_tail(state.q)) for state in path.states)
        if tail < _LARGEST_TAIL or resolution.widest <= _FINEST_PANEL:
            return path.sampled()
        resolution = resolution.finer()


def _first_pass(
    beam: Rod,
    goals: Goals,
    knots: Array,
    pushes: tuple[Pusher, ...],
    grip: Grip | None,
    gravity: ArrayLike | None,
    settings: PathSettings,
) -> _KnottedPath:
    """The shapes at the knots: the first from rest, each other one from that before."""
    first = shape(beam, goals.at(knots[0]), pushes=pushes, grip=grip, gravity=gravity, settings=settings.shape)
    if first.open_freedoms:
        raise ControlError(
            f"the goals leave {first.open_freedoms} of {first.state.actuators.count} freedoms of the forces and the "
            "gripper open, so that there is no one path; want more of the beam (angle_rad, more points), or leave out "
            "a force or the gripper"
        )
    actuators = resting_state(beam, pushes, grip, gravity, settings.shape.resolution).actuators
    rows = first.state.actuators.problem.grid.value_at(actuators.problem.grid.nodes)
    arm = float(beam.length) if settings.shape.arm is None else settings.shape.arm
    state, descent = BeamState(actuators, rows @ first.state.q, first.state.u), settings.shape.descent
    results = []
    for time in knots.tolist():
        results.append(descend(state, goals.at(time), arm, descent))
        _check(results[-1], time)
        state, descent = results[-1].state, replace(descent, damping=0.0)
    return _KnottedPath(goals, knots, tuple(results), arm, settings)


@dataclass(frozen=True)
class _KnottedPath:
    """The goals, and the shapes closest to them at knots in time."""

    goals: Goals
    knots: Array  # (K,) s
    results: tuple[DescentResult, ...]
    arm: float  # m
    settings: PathSettings

    @property
    def states(self) -> list[BeamState]:
        return [result.state for result in self.results]

    @property
    def actuators(self) -> Actuators:
        return self.results[0].state.actuators

    def sampled(self) -> FollowedPath:
        """Samples at the asked rate, the time stretched where a limit wants it."""
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
            if self.settings.too_fast == "refuse":
                _refuse(moving, time)
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
        """Other times of the goals for the samples, so that the limits are kept; and the samples so far as a spline.

        Slower only where a limit wants it, or `everywhere`, where that was tried and kinks of the path still break one.
        """
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
        """Shapes, controls and multipliers between the knots."""
        rows = []
        for time, state in zip(self.knots.tolist(), self.states, strict=True):
            residuals = target_residuals(state.solved, self.goals.at(time), self.arm)
            rows.append(np.concatenate([state.q, state.u, multipliers(state, residuals)]))
        return CubicSpline(self.knots, np.array(rows))

    def _split(self, values: Array) -> PathSamples:
        """Interpolated values as the shapes, controls and multipliers that they stand for."""
        count = len(self.actuators.problem.weights)
        return PathSamples(*np.split(values, [count, count + self.actuators.count], axis=1))

    def _corrected(self, start: PathSamples, goal_time: Array) -> PathSamples:
        """The closest shapes at the samples; one by one where a bound holds or the batch did not find them."""
        actuators, knots = self.actuators, self.knots
        xy, angle = self.goals.along(goal_time)
        frames, ok = settle(actuators, start, self.goals.targets, xy, angle, self.arm)
        at_bound = np.array([bool(np.any(result.multipliers > 0.0)) for result in self.results])
        after = np.clip(np.searchsorted(knots, goal_time), 1, len(knots) - 1)
        held = at_bound[after] | at_bound[after - 1]
        for bound in actuators.bounds:
            held |= np.linalg.norm(frames.u[:, bound.columns], axis=1) > bound.most
        warm = replace(self.settings.shape.descent, damping=0.0)
        for i in np.flatnonzero(~ok | held):
            before = BeamState(actuators, frames.q[i - 1], frames.u[i - 1])
            begin = self.states[after[i] - 1] if i == 0 else before
            result = descend(begin, self.goals.at(float(goal_time[i])), self.arm, warm)
            if not result.converged:
                found = "no stable shape closest to the goal was found on the way from the last one"
                raise ControlError(f"at {goal_time[i]:.4g} s {found}")
            frames.q[i], frames.u[i] = result.state.q, result.state.u
        return frames

    def _moving(self, frames: PathSamples) -> list[_Limited]:
        """The quantities that have a finite limit."""
        limits, every = self.settings.limits, []
        for i, pusher in enumerate(self.actuators.pushes):
            force = frames.u[:, 2 * i : 2 * i + 2]
            every.append(_Limited(f"the force at s = {pusher.at_s:g}", "N/s", force, limits.force))
        if self.actuators.grip is not None:
            poses = end_pose(self.actuators.problem, frames.q)
            every.append(_Limited("the gripper's place", "m/s", poses[:, :2], limits.speed))
            every.append(_Limited("the gripper's angle", "rad/s", poses[:, 2:], limits.turning))
        return [one for one in every if np.isfinite(one.most)]

    def _warnings(self, miss: Array, goal_time: Array, margin: Array, frames: PathSamples) -> tuple[str, ...]:
        out, knots = [], self.knots
        if np.max(miss) > 1e-6 * float(self.actuators.problem.length):
            worst, most = goal_time[np.argmax(miss)], 1e3 * np.max(miss)
            out.append(f"the goals cannot all be met: at worst {most:.3g} mm are missing, at {worst:.4g} s")
        if np.min(margin) < self.settings.shape.warn_margin:
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
    """Moments at the rate, from 0 to the first at or after the duration; a `ControlError` where they are too many."""
    if not duration * rate <= MOST_SAMPLES:
        raise ControlError(
            f"the path takes {duration:.4g} s, {duration * rate:.3g} samples at {rate:g} Hz; at most {MOST_SAMPLES} "
            "are made. Take a lower rate of samples, larger limits on rates, or fewer goals"
        )
    return np.arange(int(np.ceil(duration * rate - 1e-9)) + 1) / rate


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
    states = (BeamState(way.actuators, way.q[i], way.u[i]) for i in chosen)
    return PathSpread(way.time[chosen], np.array([spread(one, way.goals.targets.s, uncertain).rms for one in states]))
