"""The hierarchical model: exact where the spreads are known, and as an independent sampler finds it where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from onebend.many.population import (
    LEAST_SD,
    LENGTHS,
    MOST_SD,
    PopulationTrial,
    Spreads,
    covariance,
    differences,
    fit,
    group_means,
    log_prior,
    means,
    objects_of,
    quantile,
    shape_correlation,
    shares,
    shrunken,
    weighted_quantiles,
)
from onebend.records import Array
from tests.many.made_trials import Truth, made

ONE = Spreads(np.array([0.1]), np.array([0.05]), np.array([0.25]), np.array([0.7]))


def dense(trial: PopulationTrial, spreads: Spreads) -> tuple[Array, Array]:
    """The covariance of all recordings about their groups' means as one matrix, and whose mean each value is about."""
    size, scatter = len(trial.s), covariance(spreads, trial.s)[0]
    same = trial.object_of[:, None] == trial.object_of
    lasting = spreads.lasting[0]
    whole = np.kron(lasting * same + (1.0 - lasting) * np.eye(len(same)), scatter)
    for i, noise in enumerate(trial.noise):
        rows = slice(i * size, (i + 1) * size)
        whole[rows, rows] += noise
    whose = trial.group_of[trial.object_of]
    return np.asarray(whole), np.asarray(np.kron(np.eye(trial.groups)[whose], np.eye(size)), dtype=float)


def test_means_and_evidence_are_those_of_dense_algebra() -> None:
    trial = made(Truth(sizes=(2, 3), recordings=2, places=6, lasting=0.7), 1).trial
    objects = objects_of(trial, ONE)
    found = means(objects.mean, objects.covariance + 0.7 * covariance(ONE, trial.s)[:, None], trial.group_of)
    whole, design = dense(trial, ONE)
    inner = np.linalg.inv(whole)
    expected = np.linalg.inv(design.T @ inner @ design)
    best = expected @ design.T @ inner @ trial.log_k.ravel()
    assert np.allclose(found.mean[0].ravel(), best, atol=1e-8)
    for i in range(2):
        rows = slice(6 * i, 6 * i + 6)
        assert np.allclose(found.covariance[0, i], expected[rows, rows], rtol=1e-5, atol=1e-10)
    off = trial.log_k.ravel() - design @ best
    likelihood = multivariate_normal.logpdf(off, cov=whole, allow_singular=False)
    flat = 0.5 * (np.linalg.slogdet(expected)[1] + 12 * np.log(2.0 * np.pi))
    evidence = objects.log_evidence.sum() + found.log_evidence.sum()
    assert evidence == pytest.approx(likelihood + flat, rel=1e-6)


def test_an_object_is_drawn_as_dense_algebra_says() -> None:
    trial = made(Truth(sizes=(4,), places=6), 2).trial
    known = fit(trial)
    one = Spreads(known.spreads.level_sd[:1], known.spreads.shape_sd[:1], known.spreads.length[:1], np.ones(1))
    found = shrunken(
        replace(known, spreads=one, weight=np.ones(1), mean=known.mean[:1], covariance=known.covariance[:1])
    )
    scatter, size = covariance(one, trial.s)[0], 6
    prior = np.kron(np.eye(4), scatter) + 1e6 * np.kron(np.ones((4, 4)), np.eye(size))
    noise = np.zeros_like(prior)
    for i, own in enumerate(trial.noise):
        noise[i * size : (i + 1) * size, i * size : (i + 1) * size] = own
    gain = np.linalg.solve(prior + noise, prior).T
    assert np.allclose(found.mean.ravel(), gain @ trial.log_k.ravel(), atol=1e-4)
    rest = (prior - gain @ prior)[:size, :size]
    assert np.allclose(np.diagonal(found.covariance[0]), np.diagonal(rest), rtol=1e-2, atol=1e-8)


def sampled(trial: PopulationTrial, steps: int, seed: int) -> tuple[Array, Array]:
    """Draws of the group's mean and of both log sd by Gibbs steps for mean and objects, Metropolis for the spreads."""
    rng, size, count = np.random.default_rng(seed), len(trial.s), trial.objects
    inner = np.linalg.inv(trial.noise)
    mean, logs, length = trial.log_k.mean(axis=0), np.log([0.1, 0.05]), 1
    shapes = [shape_correlation(trial.s, one) for one in LENGTHS]

    def scatter_of(logs: Array, length: int) -> Array:
        return np.asarray(np.exp(2 * logs[0]) + np.exp(2 * logs[1]) * shapes[length])

    def density(logs: Array, length: int, mean: Array) -> float:
        """Of recordings given mean and spreads, the objects integrated out, and the prior."""
        if not all(np.log(LEAST_SD) < one < np.log(MOST_SD) for one in logs):
            return -np.inf
        spread = scatter_of(logs, length)
        one = Spreads(*(np.array([x]) for x in (*np.exp(logs), LENGTHS[length], 1.0)))
        off = trial.log_k - mean
        whole = trial.noise + spread
        value = -0.5 * np.sum(np.linalg.slogdet(whole)[1])
        value -= 0.5 * np.sum(off * np.linalg.solve(whole, off[:, :, None])[:, :, 0])
        return float(value + log_prior(one, trial)[0])

    objects, kept_means, kept_logs = trial.log_k.copy(), [], []
    now = density(logs, length, mean)
    for step in range(steps):
        proposal, other = logs + rng.normal(0.0, 0.5, 2), int(rng.integers(len(LENGTHS)))
        then = density(proposal, other, mean)
        if np.log(rng.random()) < then - now:
            logs, length, now = proposal, other, then
        prior = np.linalg.inv(scatter_of(logs, length) + 1e-10 * np.eye(size))
        for i in range(count):
            precision = inner[i] + prior
            root = np.linalg.cholesky(np.linalg.inv(precision))
            centre = np.linalg.solve(precision, inner[i] @ trial.log_k[i] + prior @ mean)
            objects[i] = centre + root @ rng.standard_normal(size)
        root = np.linalg.cholesky(np.linalg.inv(count * prior))
        mean = objects.mean(axis=0) + root @ rng.standard_normal(size)
        now = density(logs, length, mean)
        if step > steps // 10:
            kept_means.append(mean)
            kept_logs.append(logs)
    return np.array(kept_means), np.array(kept_logs)


@pytest.mark.slow
def test_an_independent_sampler_finds_the_same() -> None:
    trial = made(Truth(sizes=(6,), places=4, noise=0.05), 3).trial
    found = fit(trial)
    drawn, logs = sampled(trial, 30_000, seed=4)
    sd = np.sqrt(np.diagonal(found.covariance[:, 0], axis1=1, axis2=2))
    spread = drawn.std(axis=0)
    assert np.all(np.abs(found.weight @ found.mean[:, 0] - drawn.mean(axis=0)) < 0.1 * spread)
    for share in (0.025, 0.5, 0.975):
        off = quantile(found.weight, found.mean[:, 0], sd, share) - np.quantile(drawn, share, axis=0)
        assert np.all(np.abs(off) < 0.15 * spread), share
    for values, log in ((found.spreads.level_sd, logs[:, 0]), (found.spreads.shape_sd, logs[:, 1])):
        [middle] = weighted_quantiles(np.log(values), found.weight, (0.5,))
        assert middle == pytest.approx(np.median(log), abs=0.25 * log.std())


def test_quantiles_of_a_mixture() -> None:
    weight, mean, sd = np.array([0.3, 0.7]), np.array([[0.0], [2.0]]), np.array([[1.0], [0.2]])
    rng = np.random.default_rng(0)
    drawn = np.where(rng.random(400_000) < 0.3, rng.normal(0.0, 1.0, 400_000), rng.normal(2.0, 0.2, 400_000))
    for share in (0.025, 0.2, 0.975):
        assert quantile(weight, mean, sd, share)[0] == pytest.approx(np.quantile(drawn, share), abs=0.02)


def test_where_fits_are_sure_the_band_is_students() -> None:
    """One place alone would be t with n - 1 degrees of freedom; a level that varies alone is nearly that."""
    truth = Truth(sizes=(6,), places=5, noise=1e-4, level_sd=0.1, shape_sd=1e-6)
    one = made(truth, 5)
    band = group_means(fit(one.trial))
    level = one.trial.log_k.mean(axis=1)
    half = 2.5706 * level.std(ddof=1) / np.sqrt(6)
    assert 0.5 * (band.high - band.low)[0].mean() == pytest.approx(half, rel=0.05)


def test_spreads_and_shares_come_back() -> None:
    truth = Truth(sizes=(4,) * 10, recordings=2, places=5, lasting=0.6, between=0.6, level_sd=0.2, shape_sd=0.1)
    found = shares(fit(made(truth, 6).trial))
    assert found.repeatability.low < 0.6 < found.repeatability.high
    assert found.between.low < 0.6 / (0.6 + 0.4 * 0.6) < found.between.high
    assert found.level_sd.low < 0.2 * np.sqrt(0.6) < found.level_sd.high
    assert found.between.high - found.between.low < 0.6


def test_what_all_share_widens_means_but_not_ratios() -> None:
    trial = made(Truth(places=5), 7).trial
    alone, shared = fit(trial), fit(replace(trial, common_sd=0.2))
    narrow, wide = group_means(alone), group_means(shared)
    assert np.all(wide.high - wide.low > np.maximum(narrow.high - narrow.low, 2.0 * 1.95 * 0.2))
    assert np.allclose(differences(alone, [(0, 1)]).high, differences(shared, [(0, 1)]).high)
    off = fit(replace(trial, alike=np.full((2, 5, 5), 0.04)))
    assert np.allclose(group_means(off).high, wide.high)
    assert np.all(differences(off, [(0, 1)]).high > differences(alone, [(0, 1)]).high + 0.2)
    trio = shares(alone)
    assert np.isnan(trio.between.value)
    assert np.isnan(trio.repeatability.value)
