"""Algorithm 1 of the paper to the letter: gradient iteration on the force of a modal beam, (23)-(25).

Per turn: `theta <- theta0 + K^-1 J(s_a)^T F` with J at the theta before (line 2), the point by the forward kinematics
(line 3), `F <- F + gamma J_F^+ (goal - point)` with `J_F = J(s_p) K^-1 J(s_a)^T` (lines 4, 5, (25)). K is that of (6),
not the tangent. The modes are the paper's span of powers, carried by Legendre polynomials (the iteration does not
depend on the basis). The paper leaves gamma and the tolerance open: ours are settings. So is the cutoff of the
pseudo-inverse: a straight beam does not feel a force along itself, J_F is all but singular next to it, and without a
cutoff the iteration runs away from rest at its second or third turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import make_grid
from onebend.beam.modal import Modes, jacobians, places, positions
from onebend.beam.model import Beam
from onebend.records import Array


@dataclass(frozen=True)
class PaperSettings:
    """What the paper leaves open in Algorithm 1."""

    n: int = 5  # curvature modes
    gamma: float = 0.3  # step
    cutoff: float = 0.01  # singular values of J_F below this share of the largest count as none in its pseudo-inverse
    tolerance: float = 1e-3  # m, epsilon; the paper reports errors of a millimetre or less
    most: int = 500  # turns


@dataclass(frozen=True)
class PaperForce:
    """Where Algorithm 1 ended."""

    force: Array  # (2,) N
    point: Array  # (2,) m, where the modal beam has the point
    iterations: int
    converged: bool  # the modal point is within the tolerance of the goal


def paper_force(
    beam: Beam, goal: Array, push_s: float, point_s: float, settings: PaperSettings = PaperSettings()
) -> PaperForce:
    """Algorithm 1 from no force, for a goal (2,) m. It ends unconverged where it has not settled or runs away."""
    modes = Modes(settings.n)
    grid = make_grid(beam.stiffness.jumps, order=30)
    phi, weights = modes.curvature(grid.nodes), grid.weights
    flexible = np.linalg.inv(phi.T @ ((weights * beam.stiffness(grid.nodes))[:, None] * phi))
    mass = phi.T @ (weights[:, None] * phi)
    rest = np.linalg.solve(mass, phi.T @ (weights * beam.rest_curvature(grid.nodes)))
    at = places(beam.length, modes, np.array([push_s, point_s]))
    theta, force, point = np.asarray(rest, dtype=float), np.zeros(2), np.full(2, np.nan)
    for turn in range(1, settings.most + 1):
        push = jacobians(at, theta[None], beam.clamp_angle)[0, 0]
        theta = np.asarray(rest + flexible @ (push.T @ force), dtype=float)
        point = positions(at, theta[None], beam.clamp_angle)[0, 1]
        away = goal - point
        if np.linalg.norm(away) <= settings.tolerance:
            return PaperForce(force, point, turn, True)
        both = jacobians(at, theta[None], beam.clamp_angle)[0]
        step = np.linalg.pinv(both[1] @ flexible @ both[0].T, rcond=settings.cutoff) @ away
        force = force + settings.gamma * step
        if not np.all(np.isfinite(force)) or np.max(np.abs(theta)) > 1e3:
            return PaperForce(np.nan_to_num(force), point, turn, False)
    return PaperForce(force, point, settings.most, False)
