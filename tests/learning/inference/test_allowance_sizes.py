"""The size that the evidence chooses for an allowance, against the textbook's evidence of a linear model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from onebend.learning.fit_data import fit_data
from onebend.learning.hyperparameters import FACTORS, Evidence, choose_sizes, log_density_of
from onebend.learning.linear import FitProblem, Hyperparameters, RecordingNoise, data_information, residual_rows
from onebend.learning.normal import InformationForm
from onebend.learning.parameters import RHO, TAU, Spline, make_layout
from onebend.learning.prediction import predict
from tests.learning.bench import SOFT, forces, observed


def found(forms: list[InformationForm], couple: int) -> float:
    """The most probable factor."""
    return float(FACTORS[int(np.argmax(log_density_of(forms, couple)))])


@pytest.mark.parametrize(("seed", "size"), [(0, 0.1), (1, 1.0), (2, 7.0), (3, 0.0)])
def test_it_is_that_of_greatest_evidence(seed: int, size: float) -> None:
    """`y = X b + e`, all integrated out: y has the covariance `I + f^2 X X'`."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((25, 6))
    y = size * x @ rng.standard_normal(6) + rng.standard_normal(25)
    log_evidence = [multivariate_normal.logpdf(y, cov=np.eye(25) + f**2 * x @ x.T) for f in FACTORS]
    log_prior = np.log(FACTORS / (1.0 + FACTORS**2))  # half-Cauchy, of the log of the factor
    assert found([InformationForm(x.T @ x, x.T @ y)], 0) == FACTORS[int(np.argmax(log_evidence + log_prior))]


@pytest.mark.parametrize("size", [0.1, 1.0, 8.0])
def test_a_size_comes_back(size: float) -> None:
    rng = np.random.default_rng(5)
    information = np.diag(rng.uniform(1e3, 1e5, 60))
    told = size * rng.standard_normal(60) + rng.standard_normal(60) / np.sqrt(np.diag(information))
    assert abs(np.log(found([InformationForm(information, information @ told)], 0) / size)) < np.log(1.5)


def test_where_nothing_shows_it_is_as_small_as_can_be_seen() -> None:
    assert found([InformationForm(1e6 * np.eye(40), np.zeros(40))], 0) == FACTORS[0]


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_a_discrepancy_of_the_tags_is_found_at_its_size(size: float) -> None:
    made, spline = observed(SOFT, forces(60), noise=(5e-6, 1e-4)), Spline(8)
    one = fit_data(made, 0, np.ones(60, dtype=bool), spline, frozenset({"discrepancy"}))
    layout = make_layout(spline, [made], [len(one.error.knots)], [one.allowances])
    x, block = np.zeros(layout.size), layout.index["discrepancy", 0]
    x[layout.index["stiffness", -1].where] = np.log(0.02)
    drawn = size * block.prior_sd * np.random.default_rng(2).standard_normal(len(block.prior_sd))
    now = predict(one, layout, x, None)
    noise = np.random.default_rng(3).standard_normal(now.pose.shape) * np.array([5e-6, 5e-6, 1e-4])
    one = replace(one, measured=now.pose + one.allowances[0].basis @ drawn + noise)
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, (RecordingNoise(1.0, 1e-4),))
    problem = FitProblem((one,), layout, float(np.log(0.02)), expected)
    rows = [residual_rows(predict(one, layout, x, None), expected.noise[0])]
    sizes = choose_sizes(Evidence(problem, data_information(problem, rows, x, expected)), expected)
    assert set(sizes) == {"discrepancy"}
    assert abs(np.log(sizes["discrepancy"] / size)) < np.log(1.6)


def test_recordings_that_share_parameters_have_the_evidence_of_all_together() -> None:
    """`y_r = X_r b_r + Z_r c + e` of three recordings, c of covariance one."""
    rng, forms, whole = np.random.default_rng(8), [], np.eye(30)
    y = rng.standard_normal(30)
    shared, own = rng.standard_normal((30, 2)), rng.standard_normal((30, 4))
    whole = np.eye(30) + shared @ shared.T
    blocks = np.zeros((30, 30))
    for r in range(3):
        here = slice(10 * r, 10 * r + 10)
        j = np.concatenate([shared[here], own[here]], axis=1)
        forms.append(InformationForm(j.T @ j, j.T @ y[here]))
        blocks[here, here] = own[here] @ own[here].T
    dense = [multivariate_normal.logpdf(y, cov=whole + f**2 * blocks) for f in FACTORS]
    density = log_density_of(forms, 2) - (np.log(FACTORS) - np.log1p(FACTORS**2))
    np.testing.assert_allclose(density - density[0], np.array(dense) - dense[0], rtol=1e-8, atol=1e-8)
