"""What a clamp puts on a beam: a balance of all forces, which the statics itself does not need."""

from __future__ import annotations

import numpy as np

from onebend.beam.statics import Equilibrium
from onebend.records import Array


def clamp_wrench(solved: Equilibrium) -> Array:
    """(T, 3) N, N, N m: wrench of the clamp on the beam."""
    problem, base = solved.problem, solved.problem.grid.value_at(np.zeros(1))[0]
    moment = np.sum(solved.forces.across, axis=-1) + problem.moment @ base
    return -np.concatenate([np.einsum("q,tqc->tc", base, problem.dead_force), moment[:, None]], axis=1)
