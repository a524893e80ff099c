"""Robust scores of level and shape."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.special import ndtri

from onebend.many.batch import FALSE_ALARMS, limit_of, scores

PLACES = np.linspace(0.0, 1.0, 21)


def known(count: int, sd: float) -> np.ndarray:
    """Covariances of fits that know log k everywhere alike, each place by itself and all together."""
    one = sd**2 * (0.5 + 0.5 * np.eye(len(PLACES)))
    return np.tile(one, (count, 1, 1))


def drawn(count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """log k of beams that differ by 5 % in level and by 2 % at the tip, known to 1 %."""
    normal = ndtri((np.arange(count) + 0.5) / count)[:, None]  # as normal as twenty numbers can be
    level, tip = 0.05 * normal[::-1], 0.02 * np.roll(normal, 7, axis=0)
    return np.log(0.1) + level + tip * PLACES, known(count, 0.01)


def test_level_and_shape_that_stand_out_are_told_with_their_reason() -> None:
    log_k, covariance = drawn()
    log_k[4] += np.log(2.0)
    log_k[7] += np.where(PLACES > 0.6, np.log(0.5), 0.0)
    found = scores(log_k, covariance, ["g"] * len(log_k))
    assert re.match(r"k is (1\.9|2|2\.1) times", found.reasons[4])
    assert "shape of k(s)" in found.reasons[7]
    assert found.shape[7] > limit_of(len(log_k))
    assert [i for i, why in enumerate(found.reasons) if why] == [4, 7]


@pytest.mark.parametrize("count", [5, 17, 100, 1200])
def test_few_groups_in_which_nothing_differs_name_one(count: int) -> None:
    rng, groups = np.random.default_rng(count), 100_000 // (count + 50) + 60
    level, shape = 0, 0
    for _ in range(groups):
        one, slope = rng.standard_normal((2, count, 1))
        found = scores(0.1 * one + 0.05 * slope * (PLACES - 0.5), known(count, 1e-9), ["g"] * count)
        level += bool(np.any(np.abs(found.level) > limit_of(count)))
        shape += bool(np.any(found.shape > limit_of(count)))
    far = 4.0 * np.sqrt(FALSE_ALARMS / groups)
    for alarms in (level / groups, shape / groups):
        assert FALSE_ALARMS - far < alarms < FALSE_ALARMS + far


def test_groups_are_compared_apart_and_small_ones_not_at_all() -> None:
    log_k, covariance = drawn()
    log_k[::2] += np.log(3.0)
    found = scores(log_k, covariance, ["a", "b"] * 8 + ["c"] * 4)
    assert not any(found.reasons)
    assert np.isnan(found.level[-4:]).all()
    assert np.isfinite(found.level[:-4]).all()


def test_a_wide_band_is_no_outlier() -> None:
    log_k, covariance = drawn()
    log_k[4] += np.log(2.0)
    covariance[4] *= 2500.0
    assert not any(scores(log_k, covariance, ["g"] * len(log_k)).reasons)


def test_where_nobody_knows_k_it_does_not_count() -> None:
    log_k, covariance = drawn()
    tip = PLACES > 0.8
    covariance[:, tip] *= 30.0
    covariance[:, :, tip] *= 30.0
    rng = np.random.default_rng(0)
    log_k[:, tip] += 0.3 * rng.standard_normal((len(log_k), 1))
    log_k[4] += np.log(1.4)
    assert [i for i, why in enumerate(scores(log_k, covariance, ["g"] * len(log_k)).reasons) if why] == [4]


def test_what_was_not_learned_has_no_score() -> None:
    log_k, covariance = drawn()
    log_k[0], covariance[0] = np.nan, np.nan
    found = scores(log_k, covariance, ["g"] * len(log_k))
    assert np.isnan(found.level[0])
    assert np.isfinite(found.level[1:]).all()
