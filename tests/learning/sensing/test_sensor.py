"""A force log with known mistakes, judged by a force that is known."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.sensing.sensor import SensorCheck, check_sensor
from onebend.records import Array

TIME = np.linspace(0.0, 8.0, 240)
OWN, COMMON = 1e-3, 0.01


def push(time: Array) -> Array:
    """(T, 2) N: it grows, turns and goes."""
    size, turn = 0.5 * np.sin(np.pi * np.clip((time - 1.0) / 6.0, 0.0, 1.0)) ** 2, 1.3 + 0.1 * time
    return np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)


def checked(seed: int, *, noise: float = 2e-3) -> SensorCheck:
    """Of a log of gain 1.08, turned by 0.03 rad, 40 ms late, with a bias and a drift."""
    rng = np.random.default_rng(seed)
    true = push(TIME)
    common = COMMON * true[..., None]  # a factor on all forces, which k(s) may have
    told = true + common[..., 0] * rng.standard_normal() + OWN * rng.standard_normal(true.shape)
    covariance = OWN**2 * np.eye(2) + common @ np.swapaxes(common, 1, 2)
    cos, sin = np.cos(0.03), np.sin(0.03)
    log = 1.08 * push(TIME - 0.04) @ np.array([[cos, -sin], [sin, cos]]).T
    log = log + [0.02, -0.01] + 0.004 * (TIME - 4.0)[:, None] * [1.0, -1.0] + noise * rng.standard_normal(true.shape)
    found = check_sensor(TIME, told, covariance, common, log, None)
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(3))
def test_gain_direction_delay_bias_and_drift_are_found_within_their_bands(seed: int) -> None:
    found = checked(seed)
    for value, true, least in (
        (found.gain, 1.08, 0.008),
        (found.direction, 0.03, 0.0),
        (found.delay, 0.04, 0.0),
    ):
        assert abs(value[0] - true) < 3.0 * value[1]
        assert value[1] >= least  # the common factor on the force is not hidden
    np.testing.assert_array_less(np.abs(found.bias[0] - [0.02, -0.01]), 3.0 * found.bias[1])
    np.testing.assert_array_less(np.abs(found.drift[0] - [0.004, -0.004]), 3.0 * found.drift[1])
    assert found.gain[1] < 0.05
    assert found.delay[1] < 0.02


def test_too_few_frames_judge_nothing() -> None:
    none = np.full((240, 2), np.nan)
    force, shared = push(TIME), np.zeros((240, 2, 1))
    assert check_sensor(TIME, force, np.tile(np.eye(2), (240, 1, 1)), shared, none, None) is None
