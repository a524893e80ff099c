"""Filmed tags: noise of the stated size, errors that last, frames that are wrong, tags that are missing."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.lab.bench import TagNoise, filmed
from onebend.records import Array

STILL = np.zeros((20_000, 3, 3))


def seen(noise: TagNoise, seed: int = 0) -> tuple[Array, Array]:
    return filmed(noise, STILL, 0.05, np.random.default_rng(seed))


def test_white_noise_has_its_size_and_is_stated() -> None:
    pose, covariance = seen(TagNoise(white_xy=2e-5, white_angle=1e-3))
    sd = np.array([2e-5, 2e-5, 1e-3])
    np.testing.assert_allclose(np.std(pose, axis=0), np.tile(sd, (3, 1)), rtol=0.03)
    np.testing.assert_allclose(covariance[7, 1], np.diag(sd**2))
    assert abs(np.corrcoef(pose[1:, 0, 0], pose[:-1, 0, 0])[0, 1]) < 0.03


def test_slow_noise_lasts_and_tags_are_independent() -> None:
    pose, covariance = seen(TagNoise(white_xy=0.0, white_angle=0.0, slow_xy=1e-4, slow_angle=2e-3, slow_time=0.5))
    np.testing.assert_allclose(np.std(pose[..., 0], axis=0), 1e-4, rtol=0.1)
    assert np.corrcoef(pose[10:, 0, 2], pose[:-10, 0, 2])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.06)
    flat = pose.reshape(len(pose), -1)
    apart = np.corrcoef(flat.T) - np.eye(9)
    assert np.max(np.abs(apart)) < 0.1
    assert covariance[0, 0, 0, 0] == pytest.approx(1e-8)


def test_the_observer_may_be_wrong_by_a_factor() -> None:
    _, covariance = seen(TagNoise(white_xy=2e-5, stated=0.5))
    assert covariance[0, 0, 0, 0] == pytest.approx((0.5 * 2e-5) ** 2)


def test_outliers_and_missing_tags_have_their_share() -> None:
    pose, _ = seen(TagNoise(outliers=0.02, missing=0.1))
    assert np.mean(np.isnan(pose[..., 0])) == pytest.approx(0.1, abs=0.01)
    far = np.nanmean(np.linalg.norm(pose[..., :2], axis=-1) > 2e-4)
    assert far == pytest.approx(0.02 * 0.9, abs=0.004)
    np.testing.assert_array_equal(np.isnan(pose[..., 0]), np.isnan(pose[..., 2]))


def test_a_seed_repeats() -> None:
    np.testing.assert_array_equal(seen(TagNoise(), 5)[0], seen(TagNoise(), 5)[0])
