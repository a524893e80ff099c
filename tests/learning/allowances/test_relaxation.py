"""Relaxation of a standard linear solid: closed forms, the secant stiffness, and the shift of the rest curvature."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.allowances import (
    TIMES,
    lags,
    memory,
    reached_part,
    remembered,
    rest_shift,
    secant_share,
    shift_derivatives,
)
from onebend.records import Array

TIME = np.cumsum(np.random.default_rng(0).uniform(0.05, 0.4, 40))
WEIGHTS = np.array([0.2, 0.5, 0.3])
SHARES = np.array([0.03, 0.15, -0.02])


def push() -> Array:
    """(42, 3) rad: curvatures of a push out and back, and two frames at rest behind."""
    course = np.append(np.sin(np.pi * np.arange(40) / 39.0), [0.0, 0.0])
    uneven = 1.0 + 0.1 * np.cos(np.arange(42))
    return np.asarray((course * uneven)[:, None] * np.array([1.2, 0.7, -0.4]))


def test_step_and_hold_has_its_closed_form() -> None:
    at_once = np.append(TIME[0], TIME)  # the first instant before the step, and behind it
    held = lags(at_once)[..., 1:] @ np.full(40, 0.7)
    np.testing.assert_allclose(held[:, 1:], -0.7 * np.expm1(-(TIME - TIME[0]) / TIMES[:, None]), atol=1e-14)


def test_what_weight_has_bent_for_long_relaxes_no_more() -> None:
    np.testing.assert_allclose(lags(TIME) @ np.full(40, 0.7), 0.7, atol=1e-14)
    held = np.tile([1.2, 0.7, -0.4], (40, 1))
    np.testing.assert_allclose(rest_shift(memory(SHARES, TIME), held, WEIGHTS), 0.0, atol=1e-12)


def test_a_steady_ramp_has_its_closed_form() -> None:
    t, tau = TIME - TIME[0], TIMES[:, None]
    np.testing.assert_allclose(lags(TIME) @ t, t + tau * np.expm1(-t / tau), atol=1e-12)


def test_two_frames_of_one_instant_are_one() -> None:
    twice = np.array([0.0, 1.0, 1.0, 2.0])
    lag = lags(twice) @ np.array([0.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(lag[:, [0, 1, 3]], lags(twice[[0, 1, 3]]) @ np.array([0.0, 1.0, 1.0]))
    np.testing.assert_allclose(lag[:, 2], lag[:, 1])


def test_the_memory_is_that_of_all_shares_together() -> None:
    q = push()[:40]
    np.testing.assert_allclose(
        memory(SHARES, TIME) @ q, sum(a * lag @ q for a, lag in zip(SHARES, lags(TIME), strict=True))
    )


@pytest.mark.parametrize(("pace", "reached"), [(1e4, 1.0), (1e-4, 0.0)])
def test_the_secant_stiffness_lies_between_the_instantaneous_and_the_relaxed(pace: float, reached: float) -> None:
    found = secant_share(memory(SHARES, pace * TIME), push(), WEIGHTS)
    assert found == pytest.approx(1.0 - 0.16 * reached, abs=2e-3)


def test_shift_and_secant_stiffness_give_the_moment_of_the_solid() -> None:
    """`k_i (q - v) = k (q - shift)`."""
    q, remembering = push(), memory(SHARES, TIME)
    shift = rest_shift(remembering, q, WEIGHTS)[:40]
    moment = q[:40] - remembering @ q[:40]
    np.testing.assert_allclose(secant_share(remembering, q, WEIGHTS) * (q[:40] - shift), moment, atol=1e-13)


def test_the_shift_has_no_part_along_the_push() -> None:
    """What goes with the curvature is in the secant stiffness."""
    q = push()
    shift = rest_shift(memory(SHARES, TIME), q, WEIGHTS)[:40]
    assert abs(np.sum(WEIGHTS * q[:40] * shift)) < 1e-12 * np.sum(WEIGHTS * q**2)
    assert np.max(np.abs(shift)) > 0.01


def test_nothing_shifts_where_nothing_relaxes_nor_in_the_frames_at_rest() -> None:
    assert np.all(rest_shift(memory(0.0 * SHARES, TIME), push(), WEIGHTS) == 0.0)
    assert np.all(rest_shift(memory(SHARES, TIME), push(), WEIGHTS)[40:] == 0.0)
    still = np.zeros((42, 3))
    assert reached_part(still[:40], still[:40], WEIGHTS) == 0.0
    assert np.all(rest_shift(memory(SHARES, TIME), still, WEIGHTS) == 0.0)


def test_what_is_remembered_of_a_change_is_the_derivative_of_the_shift() -> None:
    q, h, remembering = push(), 1e-6, memory(SHARES, TIME)
    change = np.random.default_rng(1).standard_normal((42, 3, 2))
    found = remembered(remembering, q, WEIGHTS, change)
    for i in range(2):
        up, down = (rest_shift(remembering, q + sign * h * change[..., i], WEIGHTS) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found[..., i], (up - down) / (2.0 * h), atol=1e-8)


def test_what_is_remembered_is_linear_in_the_change_and_by_the_textbook_sum() -> None:
    q, remembering = push(), memory(SHARES, TIME)
    change = np.random.default_rng(2).standard_normal((42, 3, 2))
    found, bent = remembered(remembering, q, WEIGHTS, change), q[:40]
    v, v_moved = remembering @ bent, np.einsum("st,tqp->sqp", remembering, change[:40])
    c, square = reached_part(v, bent, WEIGHTS), np.sum(WEIGHTS * bent**2)
    for p in range(2):
        one, late = change[:40, :, p], v_moved[:, :, p]
        by_c = np.sum(WEIGHTS * ((v - 2.0 * c * bent) * one + bent * late)) / square
        wanted = (late - c * one - by_c * bent) / (1.0 - c) + (v - c * bent) * by_c / (1.0 - c) ** 2
        np.testing.assert_allclose(found[:40, :, p], wanted, atol=1e-13)
    assert np.all(found[40:] == 0.0)


@pytest.mark.parametrize("shares", [SHARES, 0.0 * SHARES])
def test_the_derivatives_with_the_shares(shares: Array) -> None:
    q, h = push(), 1e-6
    found = shift_derivatives(shares, TIME, q, WEIGHTS)
    for j, step in enumerate(h * np.eye(len(shares))):
        up, down = (rest_shift(memory(shares + sign * step, TIME), q, WEIGHTS) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found[..., j], (up - down) / (2.0 * h), atol=1e-8)
