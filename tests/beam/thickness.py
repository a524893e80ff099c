"""The thickness of a section as one more parameter."""

from __future__ import annotations

import numpy as np

from onebend.beam.problem import Problem
from onebend.beam.sensitivity import Perturbation


def of_section_thickness(problem: Problem) -> Perturbation:
    """log h0 of the section; 1/EA and 1/kGA follow its square."""
    assert problem.compliance is not None
    functions = np.full((problem.to_nodes.shape[-1], 1), 2.0)
    return Perturbation(None, None, None, np.zeros(1), (problem.compliance, functions))
