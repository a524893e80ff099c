"""The zero of a force log, the noise that remains beside it, and the rests that it is read from."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.recording.force import (
    MARGIN,
    Zero,
    clean_force,
    long_enough,
    release,
    remaining_sd,
    shrunk,
    zero_of,
)
from onebend.records import Array, ForceLog, ForceNoise

TIME = np.arange(0.0, 20.0, 0.01)
RESTS = ((-np.inf, 5.0), (12.0, 18.0))
NOISE = ForceNoise(white=0.01, coloured=0.04, tau=0.3, walk=0.02, spacing=0.01)
SLOW = np.stack([0.1 * TIME, -0.2 * TIME], axis=1)  # N, a drift


def zero(noise: ForceNoise | None = NOISE) -> Zero:
    return zero_of(TIME, SLOW, RESTS, noise)


def test_the_zero_is_the_mean_over_the_part_of_a_rest_that_is_nearest_to_contact() -> None:
    np.testing.assert_allclose(zero().time, [3.5, 13.5], atol=0.01)
    np.testing.assert_allclose(zero().value, [[0.35, -0.7], [1.35, -2.7]], atol=3e-3)
    np.testing.assert_allclose(zero().at(np.array([0.0, 8.5])), [[0.35, -0.7], [0.85, -1.7]], atol=3e-3)


def test_the_zeros_sd_is_that_of_a_mean_over_its_span() -> None:
    exact = np.sqrt(2.0 * NOISE.tau / 3.0 * NOISE.coloured**2 + NOISE.walk**2 * 3.0 / 3.0)
    assert zero().sd == pytest.approx(exact, rel=1e-3)


def wander_of(zero_time: Array, times: Array) -> float:
    """N^2, mean over `times` of the variance of a random walk of NOISE, the straight line through its values at
    `zero_time` taken off."""
    rng = np.random.default_rng(0)
    walk = NOISE.walk * np.cumsum(np.sqrt(0.1) * rng.standard_normal((2000, 200)), axis=1)
    rows = np.arange(200) * 0.1
    value, ends = walk[:, np.searchsorted(rows, times)], walk[:, np.searchsorted(rows, zero_time)]
    share = (times - zero_time[0]) / np.ptp(zero_time) if len(zero_time) > 1 else np.zeros(len(times))
    return float(np.mean((value - (1.0 - share) * ends[:, :1] - share * ends[:, -1:]) ** 2))


def test_drift_beside_the_zero_is_a_bridge_between_two_rests() -> None:
    z = zero()
    sd = remaining_sd(TIME, z.at(TIME), RESTS, z, 5.0, NOISE)
    wander = sd**2 - NOISE.passed(5.0) ** 2 - z.sd**2
    np.testing.assert_allclose(wander, NOISE.walk**2 * 10.0 / 6.0, rtol=1e-2)
    np.testing.assert_allclose(wander, wander_of(z.time, np.linspace(3.5, 13.5, 41)), rtol=0.1)


def test_drift_after_one_rest_runs_free() -> None:
    one = Zero(np.array([2.0]), np.zeros((1, 2)), 0.03)
    sd = remaining_sd(TIME, np.zeros((len(TIME), 2)), RESTS[:1], one, 5.0, NOISE)
    wander = sd**2 - NOISE.passed(5.0) ** 2 - 0.03**2
    np.testing.assert_allclose(wander, wander_of(one.time, np.linspace(2.0, 19.9, 41)), rtol=0.15)


def test_scatter_at_rest_that_is_larger_than_the_noise_counts() -> None:
    z = zero()
    shaken = z.at(TIME) + 0.5 * np.where(np.arange(len(TIME)) % 2, 1.0, -1.0)[:, None]
    assert np.all(remaining_sd(TIME, shaken, RESTS, z, 5.0, NOISE) > 0.5)
    np.testing.assert_allclose(remaining_sd(TIME, shaken, RESTS, z, 5.0, None), 0.5, rtol=1e-6)
    none = Zero(np.zeros(0), np.zeros((0, 2)), np.nan)
    assert np.all(np.isnan(remaining_sd(TIME, shaken, (), none, 5.0, NOISE)))


def test_the_white_part_of_the_noise_is_read_from_the_log() -> None:
    rng = np.random.default_rng(1)
    force = np.sin(TIME)[:, None] + 0.002 * rng.standard_normal((len(TIME), 2))
    clean = clean_force(ForceLog(TIME, force), RESTS, cutoff=2.0, noise=NOISE)
    assert clean.noise is not None
    assert clean.noise.white == pytest.approx(0.002, rel=0.1)
    assert clean.noise.spacing == pytest.approx(0.01)
    assert clean.noise.coloured == NOISE.coloured


def test_a_rest_is_shorter_by_the_margin_where_it_borders_on_contact() -> None:
    assert MARGIN == 0.1  # s: the tool touches before markers show it
    time = np.arange(0.0, 3.0, 0.1)
    np.testing.assert_allclose(shrunk(time, 0, 10), (-np.inf, 0.8))
    np.testing.assert_allclose(shrunk(time, 20, 30), (2.1, np.inf))
    np.testing.assert_allclose(shrunk(time, 10, 20), (1.1, 1.8))


def test_short_rests_are_none() -> None:
    time, mask = np.arange(0.0, 2.0, 0.1), np.zeros(20, dtype=bool)
    mask[2:5] = mask[10:14] = True
    expected = np.zeros(20, dtype=bool)
    expected[10:14] = True
    np.testing.assert_array_equal(long_enough(mask, time), expected)


@pytest.mark.parametrize(("left", "at"), [(0.1, np.inf), (0.01, 10.05)])
def test_a_force_that_stays_is_no_release(left: float, at: float) -> None:
    size = np.where((TIME > 5.0) & (TIME <= 10.0), 1.0, np.where(TIME > 10.0, left, 0.0))
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(TIME), 2))
    log = ForceLog(TIME, np.stack([size, np.zeros(len(TIME))], axis=1) + noise)
    assert release(log, np.array([0.0, 4.0])) == pytest.approx(at, abs=0.06)
