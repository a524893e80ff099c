"""Force sensors do what they say: gain, lag, rounding, lost rows; noise of the stated size and correlation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.lab.bench import FRANKA, WRIST, ForceSensor, coloured, log_of, stages
from onebend.records import Array

TIME = np.arange(0.0, 200.0, 0.005)
NOTHING = np.zeros((len(TIME), 2))


def ramp(slope: float = 0.3) -> Array:
    return np.stack([slope * TIME, -0.5 * slope * TIME], axis=1)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_perfect_sensor_logs_the_force_on_its_own_clock() -> None:
    log = log_of(ForceSensor(rate=50.0), TIME, ramp(), rng(), offset=250.0)
    assert np.median(np.diff(log.time)) == pytest.approx(0.02)
    assert log.time[0] == 250.0
    np.testing.assert_allclose(log.force[:, 0], 0.3 * (log.time - 250.0), atol=1e-9)


def test_gain_and_lag_are_exact_on_a_ramp() -> None:
    log = log_of(ForceSensor(gain=1.2, lag=0.04), TIME, ramp(), rng())
    late = log.time > 1.0
    np.testing.assert_allclose(log.force[late, 1], -0.15 * 1.2 * (log.time[late] - 0.04), atol=1e-9)


def test_the_gain_of_each_log_is_drawn_with_its_sd() -> None:
    short = slice(0, 400)
    gains = [
        log_of(ForceSensor(gain_sd=0.1), TIME[short], ramp()[short], rng(seed)).force[300, 0] / ramp()[300, 0]
        for seed in range(300)
    ]
    assert np.mean(gains) == pytest.approx(1.0, abs=0.02)
    assert np.std(gains) == pytest.approx(0.1, rel=0.12)


def test_rounding_and_lost_rows() -> None:
    log = log_of(ForceSensor(quantum=0.01, drops=0.1), TIME, ramp(0.001), rng())
    np.testing.assert_allclose(log.force / 0.01, np.round(log.force / 0.01), atol=1e-9)
    assert len(log.time) / len(TIME) == pytest.approx(0.9, abs=0.01)
    assert np.all(np.diff(log.time) > 0.0)


def test_white_noise_is_white_and_of_its_size() -> None:
    force = log_of(ForceSensor(white_sd=0.02, bias=(0.3, -0.1)), TIME, NOTHING, rng()).force
    np.testing.assert_allclose(np.mean(force, axis=0), [0.3, -0.1], atol=5e-4)
    np.testing.assert_allclose(np.std(force, axis=0), 0.02, rtol=0.02)
    assert abs(np.corrcoef(force[1:, 0], force[:-1, 0])[0, 1]) < 0.02
    assert abs(np.corrcoef(force[:, 0], force[:, 1])[0, 1]) < 0.02


def test_coloured_noise_forgets_at_its_time_constant() -> None:
    force = coloured(200_000, 0.01, 0.3, rng())
    np.testing.assert_allclose(np.std(force, axis=0), 1.0, rtol=0.03)
    for lag in (10, 30, 60):
        expected = np.exp(-lag * 0.01 / 0.3)
        assert np.mean(force[lag:] * force[:-lag]) == pytest.approx(expected, abs=0.03)


def test_drift_grows_as_a_random_walk() -> None:
    sensor = ForceSensor(rate=20.0, drift=0.05)
    ends = [log_of(sensor, TIME[:2001], NOTHING[:2001], rng(seed)).force[[40, 160]] for seed in range(400)]
    variance = np.var(np.array(ends), axis=(0, 2))
    np.testing.assert_allclose(variance, 0.05**2 * np.array([2.05, 8.05]), rtol=0.15)


def test_the_error_of_reversal_stays_until_the_load_turns() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    size = np.interp(time, [0, 2, 4, 5, 7, 10], [0, 0, 1, 1, 0, 0])
    force = np.stack([size, np.zeros(len(time))], axis=1)
    assert np.unique(stages(force)).tolist() == [0, 1, 2]
    log = log_of(ForceSensor(reversal=0.2), time, force, rng(3))
    error = log.force - force
    plateaus = [error[(time > low) & (time < high)] for low, high in ((0, 2), (2.8, 4.9), (5.8, 10))]
    for plateau in plateaus:
        assert np.max(np.ptp(plateau, axis=0)) < 1e-3
    levels = np.array([plateau.mean(axis=0) for plateau in plateaus])
    assert np.all(np.abs(np.diff(levels, axis=0)) > 1e-3)
    drawn = [log_of(ForceSensor(reversal=0.2), time, force, rng(seed)).force[-1] for seed in range(300)]
    assert np.std(drawn) == pytest.approx(0.2, rel=0.1)


def test_small_wiggles_are_no_reversal() -> None:
    time = np.arange(0.0, 10.0, 0.01)
    force = np.stack([np.sin(0.15 * time) + 0.02 * np.sin(9.0 * time), np.zeros(len(time))], axis=1)
    assert int(np.max(stages(force))) == 1
    assert int(np.max(stages(0.0 * force))) == 0


@pytest.mark.parametrize("sensor", [FRANKA, WRIST])
def test_named_sensors_repeat_with_their_seed(sensor: ForceSensor) -> None:
    short = slice(0, 2000)
    first, again, other = (log_of(sensor, TIME[short], ramp()[short], rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.force, again.force)
    assert not np.array_equal(first.force[:100], other.force[:100])


@pytest.mark.parametrize(
    "wrong", [{"white_sd": -1.0}, {"rate": 0.0}, {"drops": 1.0}, {"lag": float("nan")}, {"coloured_time": 0.0}]
)
def test_sensors_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(RecordingError, match="sensor"):
        replace(ForceSensor(), **wrong)  # type: ignore[arg-type]


def test_a_force_that_does_not_fit_its_times_is_refused() -> None:
    with pytest.raises(RecordingError, match="rising times"):
        log_of(ForceSensor(), TIME[::-1], NOTHING, rng())
