"""Targets of a shape: points, angles or a whole curve, each with a weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.statics.equilibrium import Equilibrium
from onebend.errors import ControlError
from onebend.records import Array, BoolArray

BEYOND = 2.0  # times the length, from the clamp: a target there must be a mistake
METRES = "Positions are in metres: is this in millimetres?"


@dataclass(frozen=True)
class Targets:
    """Wanted positions and angles at N places; NaN where a position or an angle is of no concern.

    What is minimised is `sum_i weight_i (|r(s_i) - xy_i|^2 + arm^2 (alpha(s_i) - angle_i)^2)`, the arm of an angle
    being the beam's length unless `shape.ShapeSettings` says otherwise.
    """

    s: Array  # (N,)
    xy: Array  # (N, 2) m, in the beam's frame
    angle: Array  # (N,) rad, full turns count
    weight: Array  # (N,) 1

    def __post_init__(self) -> None:
        count = len(self.s)
        if count == 0 or self.xy.shape != (count, 2) or self.angle.shape != (count,) or self.weight.shape != (count,):
            raise ControlError(f"targets need at least one place, and a value for each; got {count} places")
        if not np.all((self.s >= 0.0) & (self.s <= 1.0)):
            raise ControlError(f"targets are at s in [0, 1], got {self.s[~((self.s >= 0) & (self.s <= 1))][0]}")
        if not np.all(np.isfinite(self.weight) & (self.weight > 0.0)):
            raise ControlError("a target's weight must be a positive number; leave out what does not count")
        if np.any(np.isinf(self.xy)) or np.any(np.isinf(self.angle)):
            raise ControlError("a target's position and angle must be finite, or NaN where of no concern")
        if np.any(np.isnan(self.xy[:, 0]) != np.isnan(self.xy[:, 1])):
            raise ControlError("a target has both x and y, or neither")
        if np.any(np.isnan(self.xy[:, 0]) & np.isnan(self.angle)):
            raise ControlError("a target has neither a position nor an angle; leave it out")

    @property
    def placed(self) -> BoolArray:
        """(N,) whether a position is wanted."""
        return np.asarray(np.isfinite(self.xy[:, 0]))

    @property
    def turned(self) -> BoolArray:
        """(N,) whether an angle is wanted."""
        return np.asarray(np.isfinite(self.angle))

    def __add__(self, other: Targets) -> Targets:
        """Both together."""
        return Targets(
            np.concatenate([self.s, other.s]),
            np.concatenate([self.xy, other.xy]),
            np.concatenate([self.angle, other.angle]),
            np.concatenate([self.weight, other.weight]),
        )


def numbers(values: ArrayLike) -> str:
    """Plain numbers in brackets, as a message shows them."""
    return f"({', '.join(f'{one:g}' for one in np.ravel(np.asarray(values, dtype=float)))})"


def check_metres(xy: Array, length: float) -> None:
    """Raises `ControlError` where positions (N, 2) lie so far from the clamp that they cannot be meant in metres."""
    away = np.nan_to_num(np.linalg.norm(xy, axis=-1)).ravel()
    if away.size and np.max(away) > BEYOND * length:
        worst = np.reshape(xy, (-1, 2))[int(np.argmax(away))]
        where = f"the position {numbers(worst)} m is {np.max(away):.4g} m from the clamp"
        raise ControlError(f"{where}, the beam {length:.4g} m long. {METRES}")


def points(s: ArrayLike, xy: ArrayLike, *, weight: ArrayLike = 1.0) -> Targets:
    """Wanted positions xy (N, 2) or (2,) m at places s (N,) or a number."""
    places = np.atleast_1d(np.asarray(s, dtype=float))
    wanted = np.atleast_2d(np.asarray(xy, dtype=float))
    if wanted.shape != (len(places), 2):
        raise ControlError(f"{len(places)} places need positions of shape ({len(places)}, 2), got {np.shape(xy)}")
    return Targets(places, wanted, np.full(len(places), np.nan), _spread(weight, len(places)))


def angles(s: ArrayLike, angle: ArrayLike, *, weight: ArrayLike = 1.0) -> Targets:
    """Wanted angles of the tangent (N,) or a number [rad] at places s (N,) or a number."""
    places = np.atleast_1d(np.asarray(s, dtype=float))
    wanted = np.atleast_1d(np.asarray(angle, dtype=float))
    if wanted.shape != places.shape:
        raise ControlError(f"{len(places)} places need as many angles, got {len(wanted)}")
    return Targets(places, np.full((len(places), 2), np.nan), wanted, _spread(weight, len(places)))


def curve(s: ArrayLike, xy: ArrayLike) -> Targets:
    """A whole curve as points xy (N, 2) m at rising places s (N,), weighted by the stretch of s that each stands for.

    The sum of squares is then the integral over the curve, however unevenly its points are spread.
    """
    places = np.asarray(s, dtype=float)
    if places.ndim != 1 or len(places) < 2 or not np.all(np.diff(places) > 0.0):
        raise ControlError("a curve needs two or more points at rising s")
    step = np.diff(places)
    return points(places, xy, weight=0.5 * (np.append(step, 0.0) + np.append(0.0, step)))


def curve_of_length(xy: ArrayLike, length: float) -> Targets:
    """A curve drawn from the clamp on as points (N, 2) m, without their s: it is their distance along the curve over L.

    Raises `ControlError` where the curve is longer than the beam (`length`, m), by more than 1e-6 of it.
    """
    drawn = np.asarray(xy, dtype=float)
    if drawn.ndim != 2 or drawn.shape[1] != 2 or len(drawn) < 2 or not np.all(np.isfinite(drawn)):
        raise ControlError(f"a curve is two or more points (N, 2), finite; got an array of shape {np.shape(xy)}")
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(drawn, axis=0), axis=1))) / length
    if s[-1] > 1.0 + 1e-6:
        raise ControlError(f"the curve is {s[-1] * length:.6g} m long, the beam {length:.6g} m; shorten the curve")
    return curve(np.minimum(s, 1.0), drawn)


def _spread(weight: ArrayLike, count: int) -> Array:
    return np.array(np.broadcast_to(np.asarray(weight, dtype=float), (count,)))


@dataclass(frozen=True)
class TargetResiduals:
    """Weighted residuals of T shapes against their targets, and derivatives by the curvature at the nodes; over L."""

    value: Array  # (T, R) weighted
    jacobian: Array  # (T, R, Q) derivative of `value`
    curvature_term: Array  # (T, Q): `sum_i value_i d2 value_i / dq2 = B^T diag(curvature_term) B`

    @property
    def cost(self) -> Array:
        """(T,) sum of the weighted squares."""
        return np.asarray(np.sum(self.value**2, axis=-1))


def target_residuals(solved: Equilibrium, targets: Targets, arm: float) -> TargetResiduals:
    """Weighted residuals of one shape; `arm` [m] turns angle errors into lengths."""
    return target_residuals_along(solved, targets, targets.xy[None], targets.angle[None], arm)


def target_residuals_along(
    solved: Equilibrium, targets: Targets, xy: Array, angle: Array, arm: float
) -> TargetResiduals:
    """The same for T shapes with targets xy (T, N, 2) and angle (T, N); places and weights are those of `targets`."""
    problem, length = solved.problem, float(solved.problem.length)
    to, alpha = problem.grid.integral_to(targets.s), solved.alpha
    cos, sin = np.cos(alpha), np.sin(alpha)
    placed, turned, root = targets.placed, targets.turned, np.sqrt(targets.weight)
    at = root[placed, None] * to[placed]  # (n, Q)
    wanted = root[placed, None] * xy[:, placed] / length
    off_x, off_y = cos @ at.T - wanted[..., 0], sin @ at.T - wanted[..., 1]
    b = problem.to_nodes
    x, y = -(sin[:, None] * at) @ b, (cos[:, None] * at) @ b
    lever = root[turned] * arm / length
    twisted = lever * (solved.angle(targets.s)[:, turned] - angle[:, turned])
    turning = np.broadcast_to(lever[:, None] * to[turned], (len(alpha), len(lever), to.shape[1]))
    return TargetResiduals(
        np.concatenate([off_x, off_y, twisted], axis=1),
        np.concatenate([x, y, turning], axis=1),
        -((off_x @ at) * cos + (off_y @ at) * sin),
    )
