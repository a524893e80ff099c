"""Relaxation of a standard linear solid: closed forms, the secant stiffness, and the shift of the rest curvature."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.allowances.relaxation import (
    USUAL_TIME,
    lagged,
    reached_share,
    remembered,
    rest_shift,
    secant_share,
    shift_derivatives,
)
from onebend.records import Array

TIME = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.4, 40))
WEIGHTS = np.array([0.2, 0.5, 0.3])
VALUES = np.array([0.15, 0.4])
TAU = USUAL_TIME * np.exp(0.4)


def push() -> Array:
    """(42, 3) rad: curvatures of a push out and back, and two frames at rest behind."""
    course = np.append(np.sin(np.pi * np.arange(40) / 39.0), [0.0, 0.0])
    uneven = 1.0 + 0.1 * np.cos(np.arange(42))
    return np.asarray((course * uneven)[:, None] * np.array([1.2, 0.7, -0.4]))


def test_step_and_hold_has_its_closed_form() -> None:
    held = lagged(TIME, np.full((40, 1), 0.7), 1.3)[:, 0]
    np.testing.assert_allclose(held, -0.7 * np.expm1(-(TIME - TIME[0]) / 1.3), atol=1e-14)


def test_a_steady_ramp_has_its_closed_form() -> None:
    t = TIME - TIME[0]
    np.testing.assert_allclose(lagged(TIME, t[:, None], 2.0)[:, 0], t + 2.0 * np.expm1(-t / 2.0), atol=1e-12)


def test_two_frames_of_one_instant_are_one() -> None:
    twice = np.array([0.0, 1.0, 1.0, 2.0])
    lag = lagged(twice, np.array([0.0, 1.0, 1.0, 1.0])[:, None], 1.5)
    np.testing.assert_allclose(lag[[0, 1, 3]], lagged(twice[[0, 1, 3]], np.array([[0.0], [1.0], [1.0]]), 1.5))
    np.testing.assert_allclose(lag[2], lag[1])


@pytest.mark.parametrize(("log_time", "reached"), [(-9.0, 1.0), (9.0, 0.0)])
def test_the_secant_stiffness_lies_between_the_instantaneous_and_the_relaxed(log_time: float, reached: float) -> None:
    found = secant_share(np.array([0.15, log_time]), TIME, push(), WEIGHTS)
    assert found == pytest.approx(1.0 - 0.15 * reached, abs=2e-3)


def test_a_time_beyond_all_measure_is_no_error() -> None:
    for log_time in (-1e4, 1e4):
        assert np.all(np.isfinite(rest_shift(np.array([0.15, log_time]), TIME, push(), WEIGHTS)))


def test_shift_and_secant_stiffness_give_the_moment_of_the_solid() -> None:
    """`k_i (q - a q_v) = k (q - shift)`."""
    q = push()
    shift = rest_shift(VALUES, TIME, q, WEIGHTS)[:40]
    moment = q[:40] - VALUES[0] * lagged(TIME, q[:40], TAU)
    np.testing.assert_allclose(secant_share(VALUES, TIME, q, WEIGHTS) * (q[:40] - shift), moment, atol=1e-13)


def test_the_shift_has_no_part_along_the_push() -> None:
    """What goes with the curvature is in the secant stiffness."""
    q = push()
    shift = rest_shift(VALUES, TIME, q, WEIGHTS)[:40]
    assert abs(np.sum(WEIGHTS * q[:40] * shift)) < 1e-12 * np.sum(WEIGHTS * q**2)
    assert np.max(np.abs(shift)) > 0.01


def test_nothing_shifts_where_nothing_relaxes_nor_in_the_frames_at_rest() -> None:
    assert np.all(rest_shift(np.array([0.0, 0.4]), TIME, push(), WEIGHTS) == 0.0)
    assert np.all(rest_shift(VALUES, TIME, push(), WEIGHTS)[40:] == 0.0)
    still = np.zeros((42, 3))
    assert reached_share(still[:40], still[:40], WEIGHTS) == 0.0
    assert np.all(rest_shift(VALUES, TIME, still, WEIGHTS) == 0.0)


def test_what_is_remembered_of_a_change_is_the_derivative_of_the_shift() -> None:
    q, h = push(), 1e-6
    change = np.random.default_rng(1).standard_normal((42, 3, 2))
    found = remembered(VALUES, TIME, q, WEIGHTS, change)
    for i in range(2):
        up, down = (rest_shift(VALUES, TIME, q + sign * h * change[..., i], WEIGHTS) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found[..., i], (up - down) / (2.0 * h), atol=1e-8)


def test_the_derivatives_with_share_and_time() -> None:
    q = push()
    found = shift_derivatives(np.array([0.0, 0.4]), TIME, q, WEIGHTS)
    lag = lagged(TIME, q[:40], TAU)
    np.testing.assert_allclose(found[:40, :, 0], lag - reached_share(lag, q[:40], WEIGHTS) * q[:40], atol=1e-6)
    assert np.all(found[..., 1] == 0.0)
    later = shift_derivatives(VALUES, TIME, q, WEIGHTS)[..., 1]
    up, down = (rest_shift(VALUES + np.array([0.0, h]), TIME, q, WEIGHTS) for h in (1e-5, -1e-5))
    np.testing.assert_allclose(later, (up - down) / 2e-5, atol=1e-6)
