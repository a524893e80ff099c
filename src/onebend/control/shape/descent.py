"""Descent over stable equilibria to the one closest to the targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.control.goals.targets import TargetResiduals, Targets, target_residuals
from onebend.control.shape.actuators import BeamState, next_state
from onebend.control.shape.newton_step import bounded_step, convex, model_of
from onebend.records import Array

_LAST_STEP = 1e-9  # rad, of the last step
_BELOW_ROUNDING = 1e-6  # rad: below, the cost's own rounding hides whether a step helps
_EDGE_MARGIN = 1.1  # times the least margin: where steps on are barred, the search ends
_FIRST_DAMPING = 1e-5  # share of the cost's curvature, after a step that failed
_RETURN_SHARE = 0.5  # share of a step's turn that the way back to the surface may add


@dataclass(frozen=True)
class DescentSettings:
    """Settings of the descent. Angles in radians."""

    stride: float = 0.5  # the largest turn of a step
    most: int = 200  # steps
    damping: float = 1e-3  # of the first step, as a share of the cost's curvature
    least_margin: float = 1e-3  # of stability, see `grip.Stand.margin`


@dataclass(frozen=True)
class DescentResult:
    """Where a search ended."""

    state: BeamState
    residuals: TargetResiduals
    multipliers: Array  # (n,) of the bounds in `state.actuators.bounds`; positive where one holds the shape back
    converged: bool
    near_buckling: bool  # instability stopped the descent
    steps: int

    @property
    def cost(self) -> float:
        """Sum of the weighted squares, lengths over L."""
        return float(self.residuals.cost[0])


def descend(start: BeamState, targets: Targets, arm: float, settings: DescentSettings) -> DescentResult:
    """Newton's method with a bound on the turn; a step counts if the cost falls and the beam is stable there."""
    state, residuals = start, target_residuals(start.solved, targets, arm)
    bounds, damping = start.actuators.bounds, settings.damping
    multipliers, barred, price = np.zeros(len(bounds)), False, 0.0
    for step in range(settings.most):
        model = model_of(state, residuals)
        size = float(np.trace(np.abs(model.hessian))) + 1e-300
        z, multipliers = bounded_step(
            model.slope, convex(model.hessian, damping * size), state.u, state.plane[1], bounds
        )
        price = max(price, 2.0 * float(np.sum(multipliers * [bound.most**2 for bound in bounds])))
        z = z * min(1.0, settings.stride / max(_turn(state, z), 0.5 * float(np.linalg.norm(z)), 1e-300))
        turn = _turn(state, z)
        if turn < _LAST_STEP and (damping < 1e-6 or np.linalg.norm(model.slope) < 1e-14):
            return DescentResult(state, residuals, multipliers, True, barred, step)
        after = next_state(state, z, turn * (1.0 + _RETURN_SHARE) + 1e-3)
        stable = after is not None and after.margin > settings.least_margin
        if after is not None and stable:
            new_residuals = target_residuals(after.solved, targets, arm)
            gain = _merit(state, residuals, price) - _merit(after, new_residuals, price)
            promised = -float(model.slope @ z + 0.5 * z @ model.hessian @ z)
            if gain > 1e-4 * abs(promised) or (
                turn < _BELOW_ROUNDING and gain > -1e-9 * _merit(state, residuals, price) - 1e-28
            ):
                state, residuals, barred = after, new_residuals, False
                damping *= 0.1 if gain > 0.5 * promised or turn < _BELOW_ROUNDING else 1.0
                damping = damping if damping > 1e-14 else 0.0
                continue
        barred = after is not None and not stable
        damping = max(8.0 * damping, _FIRST_DAMPING)
        if damping > 1e8 or (barred and state.margin < _EDGE_MARGIN * settings.least_margin):
            return DescentResult(state, residuals, multipliers, False, barred, step)
    return DescentResult(state, residuals, multipliers, False, barred, settings.most)


def _turn(state: BeamState, z: Array) -> float:
    """rad, the largest turn of a node."""
    return float(np.max(np.abs(state.actuators.problem.to_nodes @ (state.plane[0] @ z))))


def _merit(state: BeamState, residuals: TargetResiduals, price: float) -> float:
    """Half the cost, and what lies beyond the bounds at its price."""
    beyond = [np.linalg.norm(state.u[bound.columns]) / bound.most - 1.0 for bound in state.actuators.bounds]
    return 0.5 * float(residuals.cost[0]) + price * float(np.sum(np.maximum(beyond, 0.0)))
