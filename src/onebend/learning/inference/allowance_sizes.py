"""How large an allowance is whose size nobody knows: the evidence chooses it (automatic relevance determination)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances.allowance import Sizes
from onebend.learning.inference.fit_problem import Hyperparameters, prior
from onebend.learning.inference.hyperparameters import Evidence
from onebend.learning.inference.linear_gaussian import marginal
from onebend.records import Array

FACTORS = np.exp(np.linspace(np.log(0.02), np.log(10.0), 120))  # that are tried


def choose_sizes(evidence: Evidence, start: Hyperparameters) -> Sizes:
    """The factor of greatest evidence for every allowance that is `sized`, one after the other, under a half-Cauchy
    prior of scale one."""
    layout, sizes = evidence.problem.layout, dict(start.sizes)
    names = {a.name for recording in evidence.problem.recordings for a in recording.allowances if a.sized}
    for name in sorted(names):
        blocks = [b for b in layout.blocks if b.name == name and b.start >= 0]
        mine = np.concatenate([np.arange(b.where.start, b.where.stop) for b in blocks])
        sd = np.concatenate([b.prior_sd for b in blocks])
        others = np.setdiff1d(np.arange(layout.size), mine)
        told = marginal(evidence.data, prior(evidence.problem, replace(start, sizes=sizes)), mine, others)
        sizes[name] = most_probable(sd[:, None] * told.matrix * sd, sd * told.vector)
    return sizes


def most_probable(information: Array, b: Array) -> float:
    """The factor f of greatest posterior density of its log, for coefficients of covariance `f^2 I` beforehand.

    With all else integrated out, `2 log p = -log det(I + f^2 H) + f^2 b' (I + f^2 H)^-1 b`.
    """
    values, vectors = np.linalg.eigh(information)
    values, squares = np.maximum(values, 0.0), (vectors.T @ b) ** 2
    variance = FACTORS[:, None] ** 2
    log_density = 0.5 * np.sum(variance * squares / (1.0 + variance * values) - np.log1p(variance * values), axis=1)
    half_cauchy = np.log(FACTORS) - np.log1p(FACTORS**2)  # of the log of the factor
    return float(FACTORS[int(np.argmax(log_density + half_cauchy))])
