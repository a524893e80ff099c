"""The posterior, the evidence and what is integrated out, against dense normal densities with explicit inverses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from onebend.learning.inference.fit_problem import Prior
from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.linear_gaussian import marginal, posterior_of
from onebend.records import Array

RNG = np.random.default_rng(5)
J, NOISE = RNG.standard_normal((9, 5)), np.diag(RNG.uniform(0.5, 2.0, 9))  # nine numbers y = J x + noise
Y, MEAN = RNG.standard_normal(9), RNG.standard_normal(5)


def data_of(j: Array, y: Array) -> InformationForm:
    weighted = j.T @ np.linalg.inv(NOISE)
    log_noise = 0.5 * float(np.linalg.slogdet(NOISE)[1])
    return InformationForm(weighted @ j, weighted @ y, float(y @ np.linalg.inv(NOISE) @ y), log_noise)


def prior_of(split: int = 0) -> Prior:
    """The first `split` parameters are independent of the rest."""
    root = np.tril(RNG.standard_normal((5, 5))) + 2.0 * np.eye(5)
    root[split:, :split] = 0.0
    return Prior(MEAN, root)


def test_posterior_and_evidence_are_those_of_dense_algebra() -> None:
    before = prior_of()
    covariance = before.root @ before.root.T
    found = posterior_of(data_of(J, Y), before)
    precision = np.linalg.inv(covariance) + J.T @ np.linalg.inv(NOISE) @ J
    right = np.linalg.inv(covariance) @ MEAN + J.T @ np.linalg.inv(NOISE) @ Y
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.mean, np.linalg.solve(precision, right), rtol=1e-9)
    evidence = multivariate_normal(J @ MEAN, NOISE + J @ covariance @ J.T).logpdf(Y) + 4.5 * np.log(2.0 * np.pi)
    assert found.log_evidence == pytest.approx(evidence, rel=1e-9)


def test_what_is_integrated_out_is_noise() -> None:
    """`y = J1 x1 + (J2 x2 + noise)`: x2 under its prior makes the noise larger and correlated."""
    before, kept, others = prior_of(split=2), np.arange(2), np.arange(2, 5)
    found = marginal(data_of(J, Y), before, kept, others)
    root = before.root[2:, 2:]
    noise, y = NOISE + J[:, 2:] @ root @ root.T @ J[:, 2:].T, Y - J[:, 2:] @ MEAN[2:]
    np.testing.assert_allclose(found.matrix, J[:, :2].T @ np.linalg.solve(noise, J[:, :2]), rtol=1e-9)
    np.testing.assert_allclose(found.vector, J[:, :2].T @ np.linalg.solve(noise, y), rtol=1e-9)
    assert found.constant == pytest.approx(y @ np.linalg.solve(noise, y), rel=1e-9)
    assert found.log_noise == pytest.approx(0.5 * np.linalg.slogdet(noise)[1], rel=1e-9)
