"""k(s) and its band, from the parameters' posterior."""

from __future__ import annotations

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.inference.fit_problem import FitProblem, log_k_map
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.parameters import Layout
from onebend.records import Array


def stiffness_of(problem: FitProblem, optimum: Optimum, gain_sd: float) -> UncertainStiffness:
    """k(s) and its band at an optimum, with what stiffens the beam under its tags, and with the unknown place of a step
    between two knots of the spline."""
    layout = problem.layout
    fine, (index, onto) = layout.spline.finer, log_k_map(problem)
    covariance = onto @ optimum.covariance.of_shared[np.ix_(index, index)] @ onto.T
    covariance += np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    known = layout.known
    offset = None if known is None else known.offset
    nominal = None
    if offset is not None:
        p, on_finer, variances = layout.spline.count, layout.spline.on_finer, optimum.hyperparameters.part_variances
        found = optimum.x[:p] - problem.level, optimum.covariance.of_shared[:p, :p]
        log_k, spread = without_section_errors(layout, variances, *found)
        of_modulus = _symmetric(on_finer @ spread @ on_finer.T)
        nominal = UncertainStiffness(fine.knots, on_finer @ (problem.level + log_k), of_modulus, gain_sd, offset=offset)
    return UncertainStiffness(
        fine.knots,
        onto @ optimum.x[index],
        _symmetric(covariance),
        gain_sd,
        shape=optimum.shape,
        offset=offset,
        nominal=nominal,
    )


def without_section_errors(layout: Layout, variances: Array, log_k: Array, covariance: Array) -> tuple[Array, Array]:
    """Mean (p,) and covariance (p, p) of log k's coefficients less what the stated section is off by, from those of the
    coefficients c, over the prior's mean; `variances` (n,) are of the prior's parts.

    Before the data c has covariance S, of which P comes from the section. So its share in c is `P S^-1 c`, give or take
    `P - P S^-1 P`: what the data say of c is passed on, and what they leave open stays open.
    """
    off, root = layout.section_errors, layout.stiffness_root(variances)
    share = np.linalg.solve(root @ root.T, off).T
    kept = np.eye(len(log_k)) - share
    return kept @ log_k, kept @ covariance @ kept.T + off - share @ off


def _symmetric(matrix: Array) -> Array:
    return 0.5 * (matrix + matrix.T)
