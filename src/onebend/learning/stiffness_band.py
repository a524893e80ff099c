"""k(s) and its band, from the parameters' posterior."""

from __future__ import annotations

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.inference.fit_problem import FitProblem, log_k_map
from onebend.learning.inference.optimizer import Optimum
from onebend.records import Array


def stiffness_of(problem: FitProblem, optimum: Optimum, gain_sd: float) -> UncertainStiffness:
    """k(s) and its band at an optimum, with what stiffens the beam under its tags, and with the unknown place of a step
    between two knots of the spline."""
    layout = problem.layout
    fine, (index, onto) = layout.spline.finer, log_k_map(problem)
    covariance = onto @ optimum.covariance[np.ix_(index, index)] @ onto.T
    covariance += np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    known = layout.known
    offset = None if known is None else known.offset
    nominal = None
    if offset is not None:
        on_finer, (log_k, spread) = layout.spline.on_finer, _without_section_errors(problem, optimum)
        of_modulus = _symmetric(on_finer @ spread @ on_finer.T)
        nominal = UncertainStiffness(fine.knots, on_finer @ log_k, of_modulus, gain_sd, offset=offset)
    return UncertainStiffness(
        fine.knots,
        onto @ optimum.x[index],
        _symmetric(covariance),
        gain_sd,
        shape=optimum.shape,
        offset=offset,
        nominal=nominal,
    )


def _without_section_errors(problem: FitProblem, optimum: Optimum) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of log k's coefficients less what the stated section is off by.

    That is `e = P S^-1 (c - l) + noise`, c being the coefficients with prior mean l and covariance S, P the part of S
    that comes from the section: what the data say of c is passed on to e, and what they leave open stays open.
    """
    layout = problem.layout
    p, off = layout.spline.count, layout.section_errors
    root = layout.stiffness_root(optimum.hyperparameters.part_variances)
    share = np.linalg.solve(root @ root.T, off).T  # P S^-1
    kept = np.eye(p) - share
    log_k, covariance = optimum.x[:p], optimum.covariance[:p, :p]
    mean = log_k - share @ (log_k - problem.level)
    return mean, kept @ covariance @ kept.T + off - share @ off


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
