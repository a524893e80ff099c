"""Forces, or a gripper's pose, that bring a beam as close as it can be to a wanted shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.problem import Resolution
from onebend.beam.statics.rod import Rod
from onebend.blas import one_blas_thread
from onebend.control.goals.targets import Targets, check_metres, target_residuals
from onebend.control.shape.actuators import BeamState, Grip, Pusher, resting_state, state_on_grid
from onebend.control.shape.descent import DescentResult, DescentSettings, descend
from onebend.control.shape.newton_step import model_of
from onebend.control.shape.spread import ShapeSpread, spread
from onebend.records import Array

_FINEST_PANEL = 1.0 / 16.0  # widest panel at the end of refinement
_TARGETS_MET = 1e-9  # of the beam's length, rms: targets are met, no further start is tried
_ACTIVE_BOUND = 1e-6  # share of a bound within which it is active
_FLAT_CURVATURE = 1e-9  # share of the largest curvature of the cost below which a freedom is open
_RANDOM_LOAD_SIZE = 1.5  # size of the further starts' controls, in units of mean k over L


@dataclass(frozen=True)
class ShapeSettings:
    """Settings of the search for a shape."""

    arm: float | None = None  # m: an error of one radian counts as one of so many metres; None: the beam's length
    starts: int = 6  # where the first search, from rest, does not meet the targets: further ones, from bent shapes
    seed: int = 0  # of those shapes
    warn_margin: float = 0.1  # of stability, below which is warned
    descent: DescentSettings = field(default_factory=DescentSettings)
    # To begin with; it is refined at the end.
    resolution: Resolution = field(default_factory=lambda: Resolution(order=16, widest=0.5))


@dataclass(frozen=True)
class ShapeResult:
    """The closest shape that was found, and the loads that hold it."""

    targets: Targets
    state: BeamState
    xy_error: Array  # (N, 2) m: where the shape is less where it is wanted; NaN where of no concern
    angle_error: Array  # (N,) rad
    rms: float  # m: root of the weighted mean square, angles times the arm: as close as physics and the limits allow
    spread: ShapeSpread | None  # what the band on k(s) makes of the shape; None where no band was given
    limits: tuple[str, ...]  # the limits that hold the shape back
    open_freedoms: int  # directions in which the controls may change without a change of the sum of squares
    converged: bool  # no stable shape nearby is closer
    starts: int  # searches made
    warnings: tuple[str, ...]

    @property
    def forces(self) -> Array:
        """(a, 2) N: the pushes' forces on the beam."""
        return np.asarray(self.state.u[: 2 * len(self.state.actuators.pushes)].reshape(-1, 2))

    @property
    def wrench(self) -> Array | None:
        """(3,) N, N, N m: what the gripper puts on the beam; None without one."""
        return None if self.state.actuators.grip is None else self.state.u[-3:]

    @property
    def pose(self) -> Array:
        """(3,) m, m, rad: the end s = 1; with a grip, where the gripper is to be."""
        return self.state.end

    @property
    def margin(self) -> float:
        """Smallest eigenvalue of the tangent over that without loads: 1 far from buckling, 0 where it buckles."""
        return self.state.margin

    @property
    def load_left(self) -> float:
        """By what factor all loads could grow, the shape as it is, before the beam buckles; infinite if by any."""
        return float(1.0 / (1.0 - self.margin)) if self.margin < 1.0 else np.inf

    def xy(self, s: ArrayLike) -> Array:
        """(S, 2) m, positions at `s`."""
        return np.asarray(self.state.solved.xy(np.atleast_1d(np.asarray(s, dtype=float)))[0])

    def angle(self, s: ArrayLike) -> Array:
        """(S,) rad, the tangent's angle at `s`."""
        return np.asarray(self.state.solved.angle(np.atleast_1d(np.asarray(s, dtype=float)))[0])


@one_blas_thread
def shape(
    beam: Rod,
    targets: Targets,
    *,
    pushes: Sequence[Pusher] = (),
    grip: Grip | None = None,
    gravity: ArrayLike | None = None,
    uncertain: UncertainStiffness | None = None,
    start: BeamState | None = None,
    settings: ShapeSettings = ShapeSettings(),
) -> ShapeResult:
    """The stable shape under these actuators that is closest to the targets, weighted least squares.

    The search visits stable equilibria only. It starts from rest, or from `start` (`ShapeResult.state` of an earlier
    shape under the same actuators); where it does not meet the targets it starts again from other bent shapes, and the
    best result is taken. The result is a local optimum, found with exact second derivatives; it need not be global.

    Args:
        beam: length, stiffness, rest curvature, clamp's angle, mass.
        targets: what is wanted, see `targets`.
        pushes: actuators that push at one place each.
        grip: an actuator that holds the end.
        gravity: (2,) m/s^2 in the beam's frame.
        uncertain: k(s) with its band, for the errors to expect.

    Raises:
        ControlError: no actuator, bad targets, or a beam that buckles under its own weight.
        MechanicsError: k(s) not positive.
    """
    arm = float(beam.length) if settings.arm is None else settings.arm
    check_metres(targets.xy, float(beam.length))
    resting = resting_state(beam, tuple(pushes), grip, gravity, settings.resolution)
    begin = resting if start is None else start
    result = descend(begin, targets, arm, settings.descent)
    tried = 1
    enough = _TARGETS_MET**2 * float(np.sum(targets.weight))
    for other in _bent(resting, settings) if start is None else ():
        if result.converged and result.cost < enough:
            break
        again, tried = descend(other, targets, arm, settings.descent), tried + 1
        result = again if again.cost < result.cost * (1.0 - 1e-6) else result
    result = _resolved(result, beam, gravity, targets, arm, settings)
    return _result(result, targets, arm, tried, uncertain, settings)


def _bent(resting: BeamState, settings: ShapeSettings) -> list[BeamState]:
    """Stable shapes under controls drawn at random, within the bounds."""
    actuators, rng, out = resting.actuators, np.random.default_rng(settings.seed), []
    for _ in range(settings.starts):
        u = _RANDOM_LOAD_SIZE * actuators.scale * rng.standard_normal(actuators.count)
        for bound in actuators.bounds:
            u[bound.columns] *= min(1.0, 0.9 * bound.most / float(np.linalg.norm(u[bound.columns])))
        solved = follow(actuators.loaded(u[None]))
        if solved.stable[0]:
            out.append(BeamState(actuators, solved.q[0], u))
    return out


def _resolved(
    result: DescentResult, beam: Rod, gravity: ArrayLike | None, targets: Targets, arm: float, settings: ShapeSettings
) -> DescentResult:
    """The same on a grid that carries the curvature, as far as `_FINEST_PANEL` goes."""
    resolution = settings.resolution
    while not result.state.solved.resolved[0] and resolution.widest > _FINEST_PANEL:
        resolution = resolution.finer()
        start = state_on_grid(result.state, beam, gravity, resolution)
        if start is None:
            break
        result = descend(start, targets, arm, settings.descent)
    return result


def _result(
    result: DescentResult,
    targets: Targets,
    arm: float,
    tried: int,
    uncertain: UncertainStiffness | None,
    settings: ShapeSettings,
) -> ShapeResult:
    state = result.state
    residuals = target_residuals(state.solved, targets, arm)
    values = np.abs(np.linalg.eigvalsh(model_of(state, residuals).hessian))
    limits = tuple(
        bound.name
        for bound, price in zip(state.actuators.bounds, result.multipliers, strict=True)
        if price > 0.0 and np.linalg.norm(state.u[bound.columns]) > (1.0 - _ACTIVE_BOUND) * bound.most
    )
    open_freedoms = int(np.sum(values < _FLAT_CURVATURE * np.max(values))) if not limits else 0
    return ShapeResult(
        targets=targets,
        state=state,
        xy_error=state.solved.xy(targets.s)[0] - targets.xy,
        angle_error=state.solved.angle(targets.s)[0] - targets.angle,
        rms=float(state.actuators.problem.length) * float(np.sqrt(result.cost / np.sum(targets.weight))),
        spread=None if uncertain is None else spread(state, targets.s, uncertain),
        limits=(*limits, *(("stability",) if result.near_buckling else ())),
        open_freedoms=open_freedoms,
        converged=result.converged,
        starts=tried,
        warnings=_warnings(result, open_freedoms, settings),
    )


def _warnings(result: DescentResult, open_freedoms: int, settings: ShapeSettings) -> tuple[str, ...]:
    out, margin, count = [], result.state.margin, result.state.actuators.count
    if result.near_buckling:
        out.append("nearer to the targets the beam loses its stability; this is as close as it gets")
    elif not result.converged:
        out.append("the search ended before its optimum; what was found is stable, but may not be the closest")
    if margin < settings.warn_margin:
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
