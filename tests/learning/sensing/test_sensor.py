"""A force log with known mistakes, judged by a force that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.force_error import force_error
from onebend.learning.sensing.sensor import START, SensedForces, SensorCheck, _Check, check_sensor
from onebend.records import Array, CleanForce, ForceNoise, Observations
from tests.learning.bench import SOFT, forces, observed

TIME = np.linspace(0.0, 8.0, 121)
OWN, COMMON, PRIOR = 1e-3, 0.01, 0.6
NOISE = ForceNoise(white=0.0, coloured=2e-3, tau=0.2, walk=1e-3)
TURNED = 0.03


def push(time: Array) -> Array:
    """(T, 2) N: it grows, turns and goes."""
    size, turn = 0.5 * np.sin(np.pi * np.clip((time - 1.0) / 6.0, 0.0, 1.0)) ** 2, 1.3 + 0.1 * time
    return np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)


def recorded(log: Array) -> Observations:
    """A recording in which the log says this, with noise as its rests show it."""
    o = observed(SOFT, forces(len(TIME)))
    clean = CleanForce(TIME, log, None, np.full(2, 2e-3), np.zeros(2), np.zeros(2), 4.0, 0, NOISE)
    loaded = (TIME > 1.0) & (TIME < 7.0)
    return replace(o, time=TIME, force=log, loaded=loaded, source=replace(o.source, clean_force=clean))


def log_of(true: Array, *, gain: float = 1.08, bias: tuple[float, float] = (0.02, -0.01)) -> Array:
    """Turned by 0.03 rad, with a drift."""
    cos, sin = np.cos(TURNED), np.sin(TURNED)
    turned = gain * true @ np.array([[cos, -sin], [sin, cos]]).T
    return np.asarray(turned + bias + 0.004 * (TIME - 4.0)[:, None] * [1.0, -1.0])


def told_of(true: Array, covariance: Array, rng: np.random.Generator) -> SensedForces:
    """Means of posteriors, with a factor on all forces in common, which k(s) may have."""
    common = COMMON * true[..., None]
    before = PRIOR**-2 * np.eye(2)
    data = np.linalg.inv(covariance)
    after = np.linalg.inv(data + before)
    seen = true + common[..., 0] * rng.standard_normal()
    seen = seen + (np.linalg.cholesky(covariance) @ rng.standard_normal((*true.shape, 1)))[..., 0]
    gain = after @ data
    common = gain @ common
    whole = after + common @ np.swapaxes(common, 1, 2)
    return SensedForces(TIME, (gain @ seen[..., None])[..., 0], whole, common, PRIOR)


def checked(log: Array, told: SensedForces) -> SensorCheck:
    o = recorded(log)
    found = check_sensor(told, log, force_error(o, TIME), o.source.clean_force)
    assert found is not None
    return found


@pytest.mark.slow
def test_gain_direction_delay_bias_and_drift_are_found_within_their_bands() -> None:
    rng = np.random.default_rng(1)
    told = told_of(push(TIME), np.tile(OWN**2 * np.eye(2), (len(TIME), 1, 1)), rng)
    log = log_of(push(TIME - 0.04)) + 2e-3 * rng.standard_normal((len(TIME), 2))
    found = checked(log, told)
    for value, true, least in ((found.gain, 1.08, 0.008), (found.direction, TURNED, 0.0), (found.delay, 0.04, 0.0)):
        assert abs(value[0] - true) < 3.0 * value[1]
        assert value[1] >= least  # the common factor on the force is not hidden
    np.testing.assert_array_less(np.abs(found.bias[0] - [0.02, -0.01]), 3.0 * found.bias[1])
    np.testing.assert_array_less(np.abs(found.drift[0] - [0.004, -0.004]), 3.0 * found.drift[1])
    assert found.gain[1] < 0.05
    assert found.delay[1] < 0.02
    assert found.direction[1] < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_what_the_shape_does_not_tell_is_no_information_on_the_axes(seed: int) -> None:
    """One component is hardly told: its scatter must not count as a direction that is known."""
    rng = np.random.default_rng(seed)
    covariance = np.tile(np.diag([0.3**2, OWN**2]), (len(TIME), 1, 1))
    one = np.stack([0.0 * TIME, push(TIME)[:, 1]], axis=1)  # nothing along x: no turn can be seen
    found = checked(log_of(one), told_of(one, covariance, rng))
    assert found.direction[1] > 0.03
    assert abs(found.direction[0] - TURNED) < 2.5 * found.direction[1]


@pytest.mark.slow
def test_a_slow_error_of_the_log_widens_the_band_of_its_axes() -> None:
    """As large as it is: a wave of 0.03 N, of which the rests say nothing."""
    rng = np.random.default_rng(3)
    told = told_of(push(TIME), np.tile(OWN**2 * np.eye(2), (len(TIME), 1, 1)), rng)
    wave = 0.03 * np.sin(np.pi * np.clip((TIME - 1.0) / 6.0, 0.0, 1.0) * 3.0)[:, None] * [1.0, -0.5]
    good, bad = checked(log_of(push(TIME)), told), checked(log_of(push(TIME)) + wave, told)
    assert bad.direction[1] > 1.5 * good.direction[1]
    assert abs(bad.direction[0] - TURNED) < 2.5 * bad.direction[1]


@pytest.mark.slow
def test_what_is_unknown_of_the_clock_is_unknown_of_the_delay() -> None:
    """The log's error moved the clock that was found by it, too."""
    told = told_of(push(TIME), np.tile(OWN**2 * np.eye(2), (len(TIME), 1, 1)), np.random.default_rng(2))
    log = log_of(push(TIME))
    o = recorded(log)
    sure, unsure = (
        check_sensor(told, log, force_error(o, TIME), o.source.clean_force, clock_sd) for clock_sd in (0.0, 0.05)
    )
    assert sure is not None
    assert unsure is not None
    assert unsure.delay[1] == pytest.approx(np.hypot(sure.delay[1], 0.05))
    assert unsure.gain[1] >= sure.gain[1]
    assert unsure.direction[1] > 1.05 * sure.direction[1]


@pytest.mark.slow
def test_sizes_of_the_log_error_that_nobody_knows_widen_its_bands() -> None:
    """Of one push, with an error that came with the load: the sizes are averaged over."""
    told = told_of(push(TIME), np.tile(OWN**2 * np.eye(2), (len(TIME), 1, 1)), np.random.default_rng(5))
    error, log = force_error(recorded(log_of(push(TIME))), TIME), log_of(push(TIME))
    check = _Check(told, log, error, error.weights)
    sizes = check.chosen(START, np.zeros(4))
    check.see(START, sizes)
    x, alone = check.settled(START, sizes)
    _, spread = check.over_sizes(x, sizes)
    assert spread[1, 1] > 1.05 * alone[1, 1]


def test_too_few_frames_judge_nothing() -> None:
    told = told_of(push(TIME), np.tile(OWN**2 * np.eye(2), (len(TIME), 1, 1)), np.random.default_rng(0))
    o = recorded(push(TIME))
    assert check_sensor(told, np.full((len(TIME), 2), np.nan), force_error(o, TIME), None) is None


def test_the_prior_is_divided_out_of_what_is_told() -> None:
    """What is left is the measurement, its covariance, and what the errors in common do to it."""
    rng = np.random.default_rng(4)
    covariance = np.tile(np.array([[0.3, 0.1], [0.1, 0.2]]), (len(TIME), 1, 1))  # as large as the prior's
    before, data = PRIOR**-2 * np.eye(2), np.linalg.inv(covariance)
    seen, common = rng.normal(size=(len(TIME), 2)), rng.normal(size=(len(TIME), 2, 3))
    after: Array = np.asarray(np.linalg.inv(data + before), dtype=float)
    told = SensedForces(TIME, (after @ data @ seen[..., None])[..., 0], after, after @ data @ common, PRIOR)
    left = told.without_prior()
    np.testing.assert_allclose(left.force, seen, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(left.covariance, covariance, rtol=1e-9)
    np.testing.assert_allclose(left.common, common, rtol=1e-9, atol=1e-12)
