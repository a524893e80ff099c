"""Bandwidth, outliers, gaps and the low-pass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.recording.signals import at_times, bandwidth, bridged, low_pass, outliers, runs


def noise(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize("fps", [25.0, 60.0, 240.0])
def test_bandwidth_is_that_of_the_motion_at_any_frame_rate(fps: float) -> None:
    time = np.arange(0.0, 10.0, 1 / fps)
    clean = np.exp(-0.5 * ((time - 5.0) / 0.4) ** 2)[:, None]  # velocity spectrum f^2 exp(-(2 pi f 0.4)^2)
    f = np.linspace(0.0, 5.0, 5001)
    power = np.cumsum(f**2 * np.exp(-((2 * np.pi * f * 0.4) ** 2)))
    expected = f[np.searchsorted(power, 0.999 * power[-1])]
    found = bandwidth(time, clean + 1e-3 * noise(clean.shape))
    assert found == pytest.approx(expected, abs=0.25)  # the window spreads by two bins of 0.1 Hz


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_bandwidth(seed: int) -> None:
    assert np.isnan(bandwidth(np.arange(300) / 30, noise((300, 6), seed)))


def test_a_fast_swing_after_a_slow_push_counts() -> None:
    time = np.arange(0.0, 8.0, 1 / 30)
    swing = np.where(time > 4, np.exp(-(time - 4)) * np.cos(2 * np.pi * 6 * (time - 4)), np.minimum(time / 3, 1.0))
    assert 5.5 < bandwidth(time, swing[:, None] + 1e-3 * noise((len(time), 1))) < 13.0


def test_outliers_are_found_and_steps_are_not() -> None:
    values = 0.03 * noise((2000, 2))
    values[1000:] += 0.5  # a release
    values[[300, 700], [0, 1]] += 0.4
    values[1200, 1] -= 0.5
    found = np.flatnonzero(outliers(values))
    assert set(found) == {300, 700, 1200}


@pytest.mark.parametrize("rate", [2.0, 5.0, 10.0, 50.0, 500.0])
def test_the_peak_of_a_push_is_no_outlier_at_any_rate(rate: float) -> None:
    time = np.arange(0.0, 14.0, 1.0 / rate)
    push = np.sin(np.pi * np.clip((time - 3.0) / 8.0, 0.0, 1.0)) ** 2
    for seed in range(10):
        values = np.outer(push, [0.9, -0.4]) + 0.02 * noise((len(time), 2), seed)
        assert outliers(values, spacing=1.0 / rate).mean() < 0.02
    if rate >= 10.0:
        values[len(time) // 3, 0] += 1.0
        assert outliers(values, spacing=1.0 / rate)[len(time) // 3]


def test_a_clean_signal_has_no_outliers() -> None:
    assert not outliers(np.sin(np.linspace(0, 6, 500))[:, None]).any()
    assert not outliers(np.zeros((500, 2))).any()


@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_low_pass_keeps_slow_and_its_time_and_takes_fast(jitter: float) -> None:
    rate = 500.0
    time = (np.arange(5000) + jitter * np.random.default_rng(0).uniform(-0.5, 0.5, 5000)) / rate
    slow = np.sin(2 * np.pi * 0.3 * time)
    smooth = low_pass(time, (slow + np.sin(2 * np.pi * 30 * time))[:, None], 3.0, longest_gap=0.1)[:, 0]
    inner = slice(500, -500)
    assert np.abs(smooth - slow)[inner].max() < 2e-3
    at_cutoff = low_pass(time, np.sin(2 * np.pi * 3.0 * time)[:, None], 3.0, longest_gap=0.1)[inner, 0]
    assert np.abs(at_cutoff).max() == pytest.approx(0.75, abs=0.02)  # half, and half of the rest


def test_low_pass_does_not_reach_across_a_long_gap() -> None:
    time = np.concatenate([np.arange(0.0, 2.0, 0.01), np.arange(13.0, 15.0, 0.01)])
    values = np.where(time < 7.0, 0.0, 1.0)[:, None]
    assert np.allclose(low_pass(time, values, 1.0, longest_gap=0.5), values, atol=1e-9)


def test_low_pass_keeps_the_slope_at_both_ends() -> None:
    time = np.arange(0.3, 2.5, 0.01)  # of a push that has begun before and ends later
    slow = np.sin(time)
    wrong = low_pass(time, slow[:, None] + 1e-3 * noise((len(time), 1)), 2.0, longest_gap=0.1)[:, 0] - slow
    assert np.abs(wrong).max() < 4e-3  # with level ends it is off by 0.04
    assert np.abs(np.gradient(wrong, time)).max() < 0.05  # and by 0.9


@pytest.mark.parametrize("gap", [0.5, 1.0, 3.0])
def test_low_pass_keeps_what_runs_on_beyond_a_gap(gap: float) -> None:
    time = np.arange(0.0, 12.0, 0.001)
    time = time[(time < 5.0) | (time > 5.0 + gap)]
    slow = np.stack([0.1 * time, np.sin(2 * np.pi * 0.05 * time)], axis=1)
    wrong = np.abs(low_pass(time, slow + 0.03 * noise(slow.shape), 0.6, longest_gap=0.2) - slow)
    inner = (time > 1.5) & (time < 10.5)
    assert wrong[inner].max() < 0.012  # filtered apart, the ends of the two sides are off by 0.03
    assert wrong[inner & (np.abs(time - 5.0 - gap / 2) > gap / 2 + 1.0)].max() < 0.006


def test_a_marker_hidden_for_long_is_not_fast() -> None:
    time = np.arange(0.0, 10.0, 1 / 30)
    clean = np.exp(-0.5 * ((time - 5.0) / 1.0) ** 2)[:, None] * np.ones(3)
    seen = clean + 1e-3 * noise(clean.shape)
    whole = bandwidth(time, seen)
    seen[(time > 4.0) & (time < 7.0), 1] = np.nan
    seen[time > 6.2, 2] = np.nan
    assert bandwidth(time, seen) == pytest.approx(whole, rel=0.35)  # straight bridges make it eight times as much


def test_without_a_cutoff_nothing_changes() -> None:
    values = noise((50, 2))
    assert np.array_equal(low_pass(np.arange(50.0), values, np.inf, longest_gap=1.0), values)


def test_gaps_and_outside_are_unknown() -> None:
    time = np.array([0.0, 1.0, 2.0, 5.0, 6.0])
    found = at_times(time, time[:, None], np.array([-0.1, 0.5, 2.0, 3.0, 5.0, 6.0, 6.1]), longest_gap=1.5)[:, 0]
    assert np.array_equal(found, [np.nan, 0.5, 2.0, np.nan, 5.0, 6.0, np.nan], equal_nan=True)


def test_bridged_fills_only_what_is_missing() -> None:
    values = np.array([[0.0, np.nan], [np.nan, np.nan], [2.0, 1.0]])
    assert np.array_equal(bridged(np.arange(3.0), values), [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]])


@given(st.lists(st.booleans(), max_size=30))
def test_runs_tell_the_mask(mask: list[bool]) -> None:
    found = runs(np.array(mask, dtype=bool))
    again = np.zeros(len(mask), dtype=bool)
    for start, stop in found:
        assert not again[max(start - 1, 0) : stop].any()  # apart from one another
        again[start:stop] = True
    assert np.array_equal(again, mask)
