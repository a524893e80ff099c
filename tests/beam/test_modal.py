"""The paper's modal equilibrium against the exact one."""

from __future__ import annotations

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.grid import Modes
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import Uniform
from tests.beam.modal import modal_equilibrium


def test_modal_equilibrium_approaches_the_exact_one_geometrically() -> None:
    problem = make_problem(Beam(1.0, Uniform(1.0)), push((0.3, 2.0)), Resolution(32))
    exact = follow(problem).q
    errors = []
    for n in (2, 4, 6, 8, 10):
        theta = modal_equilibrium(problem, Modes(n))
        errors.append(np.max(np.abs(theta @ Modes(n).curvature(problem.grid.nodes).T - exact)))
    ratio = np.diff(np.log(errors))
    assert np.all(ratio < -1.5)  # at least a factor 4.5 for every two modes
