"""Priors with bounds, and of effects that most benches lack, as normal priors with the same effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import multivariate_normal, norm, truncnorm

from onebend.learning.allowances import ANYTHING, POSITIVE, RARE, TOLERATED
from onebend.learning.parameters import Block
from onebend.learning.sites import first_site, is_shaped, moments, updated
from onebend.records import Array


def block(within: tuple[float, float] = ANYTHING, sizes: tuple[float, ...] = (1.0,)) -> Block:
    return Block("one", "bench", "1", ("one",), np.array([0.3]), within=within, sizes=sizes, start=0)


def through(site: tuple[Array, Array], measured: float | Array, noise: float) -> tuple[Array, Array]:
    """Mean and sd under a normal prior, of a measured value."""
    precision = 1.0 / site[1] ** 2 + 1.0 / noise**2
    return (site[0] / site[1] ** 2 + measured / noise**2) / precision, 1.0 / np.sqrt(precision)


def renewed(one: Block, site: tuple[Array, Array], measured: float, noise: float) -> tuple[Array, Array]:
    """The site after a measured value."""
    mean, sd = through(site, measured, noise)
    return updated(one, site, mean, np.diag(sd**2))


def exact(one: Block, measured: float, noise: float) -> tuple[float, float]:
    """The same under the prior itself, by sums over a fine grid."""
    x = np.concatenate([-np.geomspace(3.0, 1e-6, 60001), np.geomspace(1e-6, 3.0, 60001)])
    sizes = one.prior_sd[0] * np.array(one.sizes)
    inside = (x >= one.within[0]) & (x <= one.within[1])
    mass = norm.cdf(one.within[1] / sizes) - norm.cdf(one.within[0] / sizes)
    density = np.sum(norm.pdf(x[:, None] / sizes) / sizes / mass, axis=1) * inside * norm.pdf((x - measured) / noise)
    weight = density * np.gradient(x)
    mean = float(weight @ x / np.sum(weight))
    return mean, float(np.sqrt(weight @ (x - mean) ** 2 / np.sum(weight)))


@given(st.floats(-2.0, 2.0), st.floats(0.05, 2.0), st.floats(-3.0, 3.0), st.floats(0.05, 4.0))
def test_moments_between_bounds_are_those_of_the_truncated_normal(
    mean: float, sd: float, lower: float, width: float
) -> None:
    a, b = (lower - mean) / sd, (lower + width - mean) / sd
    if min(abs(a), abs(b)) > 6.0 and a * b > 0.0:
        return  # SciPy itself loses digits far out in a tail
    _, found, variance = moments(lower, lower + width, np.array([mean]), np.array([sd**2]))
    of = truncnorm(a, b, mean, sd)
    assert found[0] == pytest.approx(of.mean(), abs=1e-6)
    assert variance[0] == pytest.approx(of.var(), rel=1e-4, abs=1e-8)


@pytest.mark.parametrize("measured", [-0.4, -0.05, 0.0, 0.1, 0.5])
@pytest.mark.parametrize("noise", [0.02, 0.2, 1.0])
@pytest.mark.parametrize(
    "one",
    [
        *(block(POSITIVE), block(sizes=RARE), block(POSITIVE, RARE), block((-np.inf, 0.1)), block((-0.3, 0.2))),
        *(block((-1.0, np.inf), RARE), block(POSITIVE, (0.1, 1.0))),
    ],
)
def test_one_measured_parameter_has_the_exact_mean_and_sd(one: Block, measured: float, noise: float) -> None:
    """With one normal measurement, expectation propagation is exact after one update."""
    first = first_site(one)
    site = renewed(one, first, measured, noise)
    mean, sd = through(site, measured, noise)
    wanted = exact(one, measured, noise)
    assert mean[0] == pytest.approx(wanted[0], abs=2e-3)
    widest = one.prior_sd[0] * one.sizes[-1]
    most = min(wanted[1], 1.0 / np.hypot(1.0 / noise, 1.0 / widest))
    assert (0.6 if len(one.sizes) > 1 else 0.98) * most - 1e-3 < sd[0] < 1.02 * most + 1e-3
    if len(one.sizes) > 1:
        assert abs(site[0][0]) <= widest  # no force without a place to rest


@pytest.mark.parametrize("values", [(0.0, 0.01, -0.02), (0.4, 0.0, 0.02), (0.3, -0.5, 0.2)])
@pytest.mark.parametrize("onto", [np.eye(3), np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])])
@pytest.mark.parametrize("before", [0.05, 0.3, 2.0])
def test_one_size_of_all_follows_from_what_the_data_alone_say(
    values: tuple[float, ...], onto: Array, before: float
) -> None:
    """Against the evidence of each size by the density of the measurements, for data that tell all parameters or only
    their differences. The site before does not matter."""
    one = replace(block(sizes=TOLERATED), prior_sd=np.full(3, 0.3), labels=("a", "b", "c"), together=True)
    noise, data = 0.1, onto @ np.array(values)
    covariances = [noise**2 * np.eye(len(onto)) + (0.3 * size) ** 2 * onto @ onto.T for size in TOLERATED]
    evidence = np.array([multivariate_normal.pdf(data, cov=each) for each in covariances])
    wanted = 0.3 * np.sqrt(evidence @ np.square(TOLERATED) / np.sum(evidence))
    covariance: Array = np.asarray(np.linalg.inv(onto.T @ onto / noise**2 + np.eye(3) / before**2))
    site = updated(one, (np.zeros(3), np.full(3, before)), covariance @ onto.T @ data / noise**2, covariance)
    np.testing.assert_array_equal(site[0], 0.0)
    np.testing.assert_allclose(site[1], wanted, rtol=1e-6)


def test_a_sparse_parameter_shrinks_where_nothing_is_seen_and_stays_where_much_is() -> None:
    plain, sparse = block(), block(sizes=RARE)
    little, much = 0.02, 0.6
    for measured, shrinks in ((little, True), (much, False)):
        first = first_site(sparse)
        found = through(renewed(sparse, first, measured, 0.05), measured, 0.05)[0][0]
        usual = through((np.zeros(1), plain.prior_sd), measured, 0.05)[0][0]
        assert (found < 0.8 * usual) == shrinks
        assert found == pytest.approx(measured, rel=0.06) or shrinks


def test_only_priors_that_are_not_normal_have_sites() -> None:
    assert not is_shaped(block())
    assert is_shaped(block(POSITIVE))
    assert is_shaped(block(sizes=RARE))
