"""Noise of a recording from its residuals: its size, and how long it lasts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from onebend.learning.hyperparameters import updated_noise
from onebend.learning.linear import RecordingNoise, ResidualRows
from onebend.learning.prediction import Slopes
from onebend.recording.signals import correlation_time
from onebend.records import Array

FRAMES = 6000
BEFORE = RecordingNoise(1.5, 0.05)


def autoregressive(rho: float, channels: int, seed: int = 0) -> Array:
    """(F, channels) of sd 1 whose correlation at a lag of n frames is rho^n."""
    white = np.random.default_rng(seed).standard_normal((FRAMES + 200, channels))
    return np.asarray(lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white, axis=0)[200:])


def rows_of(r: Array, a: Array | None = None) -> ResidualRows:
    """Residuals (F, R) without any parameter; `a` (F, R, 2) what each frame's force does to them."""
    a = np.zeros((*r.shape, 2)) if a is None else a
    slopes = Slopes(np.zeros((*r.shape, 0)), a, np.eye(2), np.zeros((len(r), 0)))
    return ResidualRows(r, slopes, np.ones_like(r), np.ones_like(r))


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 0.9])
def test_correlation_time_is_that_of_the_process(rho: float) -> None:
    exact = (1.0 + rho) / (1.0 - rho)
    assert correlation_time(autoregressive(rho, 6)) == pytest.approx(exact, rel=0.1)


def test_negative_correlation_makes_no_time_shorter_than_a_frame() -> None:
    assert correlation_time(autoregressive(-0.8, 6)) == 1.0


def test_correlation_time_of_a_step_takes_lags_up_to_an_eighth_of_the_frames() -> None:
    step = np.repeat([-1.0, 1.0], 40)[:, None]
    exact = 1.0 + 2.0 * sum(1.0 - 3.0 * lag / 80.0 for lag in range(1, 10))
    assert correlation_time(step) == pytest.approx(exact, rel=1e-12)


def test_a_few_wild_residuals_do_not_hide_the_correlation() -> None:
    r, rng = autoregressive(0.8, 6), np.random.default_rng(1)
    wild = rng.random(r.shape) < 0.01
    r[wild] = 20.0 * rng.choice([-1.0, 1.0], int(np.sum(wild)))
    assert correlation_time(r) == pytest.approx(9.0, rel=0.2)


def test_every_channel_counts_by_its_own_size() -> None:
    slow, fast = autoregressive(0.8, 3), 100.0 * autoregressive(0.0, 3, seed=1)
    assert correlation_time(np.concatenate([slow, fast], axis=1)) == pytest.approx(5.0, rel=0.1)


def test_the_noise_of_slow_residuals_is_larger_by_the_root_of_their_time() -> None:
    noise = updated_noise(rows_of(1.5 * autoregressive(0.8, 9)), BEFORE, 0.0)
    assert noise.marker == pytest.approx(1.5 * 3.0, rel=0.05)


def test_the_frames_own_forces_are_told_from_the_tags_noise() -> None:
    rng = np.random.default_rng(2)
    own, a = 0.1 * autoregressive(0.8, 2), 100.0 * rng.standard_normal((FRAMES, 9, 2))
    tags = rng.standard_normal((FRAMES, 9))
    noise = updated_noise(rows_of(np.einsum("frd,fd->fr", a, own) + tags, a), BEFORE, 0.0)
    assert noise.marker == pytest.approx(1.0, rel=0.03)
    assert noise.force == pytest.approx(0.1 * 3.0, rel=0.1)


def test_parameters_that_were_learned_leave_fewer_numbers_for_the_noise() -> None:
    rows = rows_of(autoregressive(0.0, 9))
    none, half, all_ = (updated_noise(rows, BEFORE, share * 9 * FRAMES).marker for share in (0.0, 0.5, 1.0))
    assert half == pytest.approx(np.sqrt(2.0) * none, rel=1e-9)
    assert all_ == pytest.approx(none / np.sqrt(0.3), rel=1e-9)


def test_the_noise_is_never_taken_as_nothing() -> None:
    assert updated_noise(rows_of(np.zeros((50, 9))), BEFORE, 0.0).marker == pytest.approx(0.02)
