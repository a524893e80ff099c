"""Equilibrium within n curvature modes (8)-(11): the paper's own model, kept to compare with the exact one.

Galerkin's projection of the exact problem onto the modes: `Phi^T g(Phi theta) = 0` with tangent `Phi^T T Phi`.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import Modes
from onebend.beam.problem import Problem
from onebend.beam.statics import gradient, tangent
from onebend.errors import MechanicsError
from onebend.records import Array


def modal_equilibrium(problem: Problem, modes: Modes, *, load_steps: int = 20, tolerance: float = 1e-12) -> Array:
    """(T, n) states of the equilibria within the modes, the rest curvature outside them kept as it is.

    The load grows in equal steps, each solved by Newton's method from the one before.

    Raises:
        MechanicsError: no convergence within the modes.
    """
    phi = modes.curvature(problem.grid.nodes)
    theta = np.zeros((problem.size, modes.n))
    for factor in np.linspace(0.0, 1.0, load_steps + 1)[1:]:
        for _ in range(30):
            q = problem.q0 + theta @ phi.T
            reduced = phi.T @ tangent(problem, q, factor) @ phi
            step = np.linalg.solve(reduced, -(gradient(problem, q, factor) @ phi)[..., None])[..., 0]
            theta += step
            if np.max(np.abs(step)) < tolerance * (1.0 + np.max(np.abs(theta))):
                break
        else:
            raise MechanicsError(f"no equilibrium within {modes.n} modes at {factor:.0%} of the load")
    return theta
