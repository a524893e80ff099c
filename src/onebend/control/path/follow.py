"""Goals in time to forces, or gripper poses, in time: at 1 kHz if asked, within limits on their rates.

The beam is taken as it stands under the forces of the moment (quasi-static). Shapes are sought one after the other at
knots along the path, each from the one before; between the knots they are interpolated and then corrected together.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from onebend.beam.clamped_ends.end_pose import end_pose
from onebend.beam.statics.rod import Rod
from onebend.blas import one_blas_thread
from onebend.control.goals.moving_goals import Goals
from onebend.control.goals.targets import check_metres, target_residuals, target_residuals_along
from onebend.control.path.batch_newton import PathSamples, settle
from onebend.control.path.first_pass import first_pass, knots_of
from onebend.control.path.timing import LimitedQuantities, RateLimits, refuse, stretched
from onebend.control.shape.actuators import Actuators, BeamState, Grip, Pusher
from onebend.control.shape.descent import DescentResult, DescentSettings, descend
from onebend.control.shape.newton_step import multipliers
from onebend.control.shape.shape import ShapeSettings
from onebend.errors import ControlError
from onebend.records import Array, IntArray

_LARGEST_TAIL = 1e-4  # share of the last Legendre coefficients, at the worst knot: positions are good to about 1e-6 L
_FINEST_PANEL = 1.0 / 16.0  # widest panel
_MOST_STRETCHES = 8  # of stretching
MOST_SAMPLES = 200_000
_MOMENTS_PER_SAMPLE = 4  # moments a sample, at which rates are looked at


@dataclass(frozen=True)
class PathSettings:
    """How a path is made."""

    rate: float = 1000.0  # Hz, samples of what comes out
    limits: RateLimits = field(default_factory=RateLimits)
    too_fast: Literal["stretch", "refuse"] = "stretch"
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
