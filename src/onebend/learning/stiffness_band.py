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


def prior_part(problem: FitProblem, optimum: Optimum, s: Array) -> Array:
    """(S, S) the part of log k's covariance at `s` that comes from the prior, and not from errors of the data.

    The fit's log k is off by `C P^-1 (m - k)`, drawn towards the prior's mean m, plus what errors of the data do; C is
    the covariance, P the prior's. Over the beams that the prior expects, the first has the covariance `C P^-1 C`. A
    second recording of this beam, or of one like it, is off by the same. P is that of the mean sizes of the prior's
    parts; the part is never more than the covariance of the spline's coefficients.
    """
    layout = problem.layout
    p, fine = layout.spline.count, layout.spline.finer
    own = _symmetric(optimum.covariance.of_shared[:p, :p])
    values, vectors = np.linalg.eigh(own)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    inner = np.linalg.solve(layout.stiffness_root(optimum.hyperparameters.part_variances), root)
    share, turned = np.linalg.eigh(inner.T @ inner)
    drawn = layout.spline.on_finer @ root @ (turned * np.sqrt(np.clip(share, 0.0, 1.0)))
    covariance = drawn @ drawn.T + np.tensordot(optimum.jumps**2, layout.spline.unseen, 1)
    return UncertainStiffness(
        fine.knots, np.zeros(len(covariance)), _symmetric(covariance), shape=optimum.shape
    ).log_covariance(s)


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
