"""k(s) and its band, from the parameters' posterior."""

from __future__ import annotations

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.inference.fit_problem import FitProblem, log_k_map
from onebend.learning.inference.optimizer import Optimum


def stiffness_of(problem: FitProblem, optimum: Optimum, gain_sd: float) -> UncertainStiffness:
    """k(s) and its band at an optimum, with what stiffens the beam under its tags, and with the unknown place of a step
    between two knots of the spline."""
    layout = problem.layout
    fine, (index, onto) = layout.spline.finer, log_k_map(problem)
    covariance = onto @ optimum.covariance.of_shared[np.ix_(index, index)] @ onto.T
    covariance += np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    covariance = 0.5 * (covariance + covariance.T)
    return UncertainStiffness(fine.knots, onto @ optimum.x[index], covariance, gain_sd, shape=optimum.shape)
