"""What the data leave open of the hyperparameters: nodes, weights, and the posterior averaged over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from onebend.learning.hyperparameters import Evidence, _cubature, averaged_posterior
from onebend.learning.linear import Hyperparameters, RecordingNoise, residual_rows
from onebend.learning.prediction import predict
from onebend.records import Array
from tests.learning.inference.test_hyperparameters import evidence_of

MIDDLE = np.array([0.3, -0.2, 0.1, 0.5])
HESSIAN = np.array([[3.0, 0.5, 0.0, 0.2], [0.5, 2.0, -0.3, 0.0], [0.0, -0.3, 1.5, 0.1], [0.2, 0.0, 0.1, 4.0]])
START = Hyperparameters(np.ones(1), 1.0, 1.0, 1.0, 1.0, ())


class NormalEvidence:
    """A cost that is a parabola around MIDDLE, and hyperparameters that are their own place."""

    def place(self, _: Hyperparameters) -> Array:
        return MIDDLE

    def cost(self, _: Hyperparameters) -> Callable[[Array], float]:
        return lambda z: 7.0 + 0.5 * float((z - MIDDLE) @ HESSIAN @ (z - MIDDLE))

    def hyperparameters_at(self, start: Hyperparameters, z: Array) -> Hyperparameters:
        return replace(start, part_variances=z)


def test_nodes_have_mean_and_covariance_of_a_normal_density() -> None:
    nodes, weights = _cubature(cast(Evidence, NormalEvidence()), START)
    z = np.stack([node.part_variances for node in nodes])
    assert np.sum(weights) == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ z, MIDDLE, atol=1e-9)
    away = z - MIDDLE
    np.testing.assert_allclose((weights * away.T) @ away, np.linalg.inv(HESSIAN), rtol=1e-6, atol=1e-9)


def given_log_k(covariance: Array, p: int) -> Array:
    """Covariance of the other parameters where log k is known."""
    across = covariance[p:, :p]
    return np.asarray(covariance[p:, p:] - across @ np.linalg.solve(covariance[:p, :p], across.T))


def test_the_posterior_is_averaged_by_the_law_of_total_covariance() -> None:
    evidence, expected = evidence_of(1)
    p = evidence.problem.layout.spline.count
    nodes, weights = _cubature(evidence, expected)
    assert np.max(weights) < 0.9
    each = [evidence.posterior(node) for node in nodes]
    middle = evidence.posterior(expected).mean
    total = sum(
        w * (one.covariance.pairs[0] + np.outer(one.mean - middle, one.mean - middle))
        for w, one in zip(weights, each, strict=True)
    )
    stiffness, averaged = averaged_posterior(evidence, expected, [{}])
    (covariance,) = averaged.pairs
    np.testing.assert_allclose(covariance[:p, :p], stiffness.covariance, rtol=1e-6, atol=1e-9)
    exact = given_log_k(np.asarray(total), p)
    scale = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(
        given_log_k(covariance, p) / np.outer(scale, scale), exact / np.outer(scale, scale), atol=1e-5
    )


def test_a_tag_far_off_counts_by_students_t() -> None:
    evidence, _ = evidence_of(1)
    recording = evidence.problem.recordings[0]
    x = np.zeros(evidence.problem.layout.size)
    x[:8] = np.log(0.02)
    now = predict(recording, evidence.problem.layout, x, None)
    pose = recording.measured.copy()
    pose[2, 1, 0] += 30 * 2e-5
    pose[3, 0, 2] -= 8 * 1e-3
    pose[-1, 1, 1] += 20 * 2e-5  # at rest, a mean of many frames: no outlier
    now = replace(now, pose=pose)
    rows = residual_rows(now, RecordingNoise(2.0, 1e-12))
    squares = np.zeros(pose.shape[:2])
    squares[2, 1], squares[3, 0] = (30 / 2.0) ** 2, (8 / 2.0) ** 2
    weight = (6.0 + 3.0) / (6.0 + squares)  # six degrees of freedom, three numbers
    weight[-1] = 1.0
    np.testing.assert_allclose(
        rows.root_weight.reshape(*squares.shape, 3) ** 2, weight[..., None] * np.ones(3), rtol=1e-6
    )
