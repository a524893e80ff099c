"""Robust scores of level and shape."""

from __future__ import annotations

import re

import numpy as np

from onebend.batch.outliers import FAR, scores
from onebend.batch.record import PLACES


def drawn(count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """log k of beams that differ by 5 % in level and by 2 % at the tip, known to 1 %."""
    rng = np.random.default_rng(3)
    level, tip = 0.05 * rng.standard_normal((count, 1)), 0.02 * rng.standard_normal((count, 1))
    return np.log(0.1) + level + tip * PLACES, np.full((count, len(PLACES)), 0.01)


def test_level_and_shape_that_stand_out_are_told_with_their_reason() -> None:
    log_k, sd = drawn()
    log_k[4] += np.log(2.0)
    log_k[7] += np.where(PLACES > 0.6, np.log(0.5), 0.0)
    found = scores(log_k, sd, ["g"] * len(log_k))
    assert re.match(r"k is (1\.9|2|2\.1) times", found.reasons[4])
    assert "shape of k(s)" in found.reasons[7]
    assert found.shape[7] > FAR
    assert [i for i, why in enumerate(found.reasons) if why] == [4, 7]


def test_groups_are_compared_apart_and_small_ones_not_at_all() -> None:
    log_k, sd = drawn()
    log_k[:10] += np.log(3.0)
    found = scores(log_k, sd, ["a"] * 10 + ["b"] * 7 + ["c"] * 3)
    assert not any(found.reasons)
    assert np.isnan(found.level[-3:]).all()
    assert np.isfinite(found.level[:-3]).all()


def test_a_wide_band_is_no_outlier() -> None:
    log_k, sd = drawn()
    log_k[4] += np.log(2.0)
    sd[4] = 0.5
    assert not any(scores(log_k, sd, ["g"] * len(log_k)).reasons)


def test_what_was_not_learned_has_no_score() -> None:
    log_k, sd = drawn()
    log_k[0] = sd[0] = np.nan
    found = scores(log_k, sd, ["g"] * len(log_k))
    assert np.isnan(found.level[0])
    assert np.isfinite(found.level[1:]).all()
