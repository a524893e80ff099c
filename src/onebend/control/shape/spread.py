"""The spread of a shape that follows from the band on k(s), to first order; the actuators do as commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.control.shape.actuators import BeamState
from onebend.records import Array


@dataclass(frozen=True)
class ShapeSpread:
    """Standard deviations of the shape at N places, given the forces of the pushes and the pose of the grip."""

    xy: Array  # (N, 2) m
    angle: Array  # (N,) rad
    wrench: Array | None  # (3,) N, N, N m: of what the gripper has to put on the beam; None without one

    @property
    def rms(self) -> float:
        """m, of the positions, over all places."""
        return float(np.sqrt(np.mean(np.sum(self.xy**2, axis=1))))


def spread(state: BeamState, s: Array, uncertain: UncertainStiffness) -> ShapeSpread:
    """The spread at places s (N,).

    A gripped end stays where it is, whatever k(s): a common factor of k then changes the wrench, and not the shape
    (without weight).
    """
    problem, solved = state.actuators.problem, state.solved
    basis = uncertain.basis(problem.grid.nodes)
    strain = problem.weights * problem.k * (state.q - problem.q0)
    right = -(state.unbend * strain)[:, None] * np.column_stack([basis, np.ones(len(strain))])
    held = 0 if state.actuators.grip is None else 3
    count = len(strain)
    # Controls in their units, curvature scaled: all entries are numbers about 1.
    unit = state.actuators.scale[state.actuators.count - held :]
    rows = state.actions[state.actuators.count - held :]
    system = np.zeros((count + held, count + held))
    system[:count, :count], system[:count, count:], system[count:, :count] = state.tangent, -rows.T * unit, rows
    answer = np.linalg.solve(system, np.concatenate([right, np.zeros((held, right.shape[1]))]))
    dq, alpha, to = state.unbend[:, None] * answer[:count], solved.alpha[0], problem.grid.integral_to(s)
    turned = problem.to_nodes @ dq
    x = float(problem.length) * to @ (-np.sin(alpha)[:, None] * turned)
    y = float(problem.length) * to @ (np.cos(alpha)[:, None] * turned)
    covariance = np.zeros((right.shape[1], right.shape[1]))
    covariance[:-1, :-1], covariance[-1, -1] = uncertain.covariance, uncertain.gain_sd**2

    def sd(rows: Array) -> Array:
        return np.asarray(np.sqrt(np.maximum(np.einsum("np,pr,nr->n", rows, covariance, rows), 0.0)))

    wrench = sd(unit[:, None] * answer[count:]) if held else None
    return ShapeSpread(np.stack([sd(x), sd(y)], axis=-1), sd(to @ dq), wrench)
