"""scikit-learn's own checks, and its tools at work on recordings."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import LeaveOneOut, cross_val_score
from sklearn.utils.estimator_checks import parametrize_with_checks

from examples.estimators import StiffnessDistribution, StiffnessRegression, regression_rows
from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform, equidistant, gaussian_basis
from onebend.errors import LearningError
from onebend.learning.paper import RegressionSettings, regress
from onebend.records import Observations, StatedSection
from tests.learning.bench import SOFT, forces, in_family, observed
from tests.made_up import with_stated

pytestmark = pytest.mark.usefixtures("no_other_places")

NOISE = (2e-5, 5e-4)


@parametrize_with_checks([StiffnessRegression(), StiffnessRegression(positive=True)])  # type: ignore[untyped-decorator]
def test_the_regression_keeps_scikit_learns_rules(estimator: StiffnessRegression, check: object) -> None:
    check(estimator)  # type: ignore[operator]


def test_the_rows_give_the_papers_own_answer() -> None:
    made = in_family(SOFT, forces(), 5)
    found = StiffnessRegression().fit(*regression_rows(made, 5, 3))
    paper = regress(made, RegressionSettings(method="paper", n=5, m=3))
    np.testing.assert_allclose(found.coef_, paper.trials[paper.chosen].coefficients, rtol=1e-9)
    s = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(gaussian_basis(s, equidistant(3), 0.5) @ found.coef_, SOFT.stiffness(s), rtol=1e-4)


def test_positive_heights_and_weights() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 3))
    y = x @ [1.0, -0.5, 2.0]
    assert (StiffnessRegression(positive=True).fit(x, y).coef_ >= 0.0).all()
    y[:30] += 5.0
    weight = np.r_[np.zeros(30), np.ones(30)]
    np.testing.assert_allclose(StiffnessRegression().fit(x, y, weight).coef_, [1.0, -0.5, 2.0], rtol=1e-10)
    assert StiffnessRegression().fit(np.c_[x, x[:, 0]], y).condition_ > 1e12


@pytest.fixture(scope="module")
def pushes() -> list[Observations]:
    return [observed(SOFT, forces(25), at_s=at, noise=NOISE, seed=i) for i, at in enumerate((1.0, 0.8, 0.9))]


@pytest.mark.slow
def test_k_of_s_comes_with_its_sd(pushes: list[Observations]) -> None:
    estimator = StiffnessDistribution(functions=12)
    with pytest.raises(NotFittedError):
        estimator.predict([0.5])
    found = estimator.fit(pushes[:2])
    s = np.linspace(0.05, 0.8, 9)
    k, sd = found.predict(s[:, None], return_std=True)
    np.testing.assert_array_equal(found.predict(s), k)
    band = found.posterior_.stiffness
    np.testing.assert_allclose(np.log1p((sd / k) ** 2), band.log_at(s)[1] ** 2 + band.gain_sd**2)
    assert np.max(np.abs(k / SOFT.stiffness(s) - 1.0) * k / sd) < 2.0
    assert np.max(sd / k) < 0.06
    assert -found.score(pushes) < 2e-4
    copy = clone(found)
    assert copy.get_params() == {"functions": 12, "most_frames": 500, "gain_sd": 0.0}
    assert not hasattr(copy, "posterior_")


@pytest.mark.slow
def test_the_modulus_of_a_beam_that_goes_with_its_section() -> None:
    k, size = 0.02, np.full(2, 0.005)
    section = StatedSection("circle", np.array([0.0, 1.0]), size, size)
    push = observed(Beam(0.15, Uniform(k)), forces(12), noise=NOISE)
    found = StiffnessDistribution(functions=8).fit([with_stated(push, stiffness_along="section", section=section)])
    assert found.modulus_ is not None
    _, low, high = found.modulus_
    assert low < k * 0.15 / (np.pi / 64.0 * 0.005**4) < high
    assert StiffnessDistribution(functions=8).fit([push]).modulus_ is None


@pytest.mark.slow
def test_cross_validation_leaves_whole_recordings_out(pushes: list[Observations]) -> None:
    scores = cross_val_score(StiffnessDistribution(functions=8), pushes[:2], cv=LeaveOneOut())
    assert scores.shape == (2,)
    assert np.all((scores < 0.0) & (scores > -1e-3))


@pytest.mark.slow
def test_a_wider_gain_widens_the_sd(pushes: list[Observations]) -> None:
    one, other = (StiffnessDistribution(8, gain_sd=sd).fit(pushes[:1]).predict([0.3], True)[1][0] for sd in (0.0, 0.1))
    assert other > 1.5 * one


def test_what_is_no_recording_is_refused(pushes: list[Observations]) -> None:
    with pytest.raises(LearningError, match="list of Observations"):
        StiffnessDistribution().fit(np.zeros((3, 2)))  # type: ignore[arg-type]
    with pytest.raises(LearningError, match="between 0"):
        StiffnessDistribution(8).fit(pushes[:1]).predict([1.2])
