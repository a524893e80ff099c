"""Positions from states against circles and straight beams; Jacobians against complex steps."""

from __future__ import annotations

import numpy as np
from hypothesis import given, strategies as st

from onebend.beam.grid import Modes, angles, jacobians, places, positions

S = np.array([0.0, 0.3, 0.71, 1.0])


@given(bend=st.floats(-6.0, 6.0).filter(lambda b: abs(b) > 1e-3), length=st.floats(0.01, 3.0))
def test_constant_curvature_is_a_circle(bend: float, length: float) -> None:
    at = places(length, Modes(1), S)
    radius = length / bend
    circle = np.stack([radius * np.sin(bend * S), radius * (1.0 - np.cos(bend * S))], axis=1)
    np.testing.assert_allclose(positions(at, np.array([[bend]]))[0], circle, atol=1e-12 * length)
    np.testing.assert_allclose(angles(at, np.array([[bend]]))[0], bend * S, atol=1e-14)


def test_zero_curvature_is_a_straight_beam_at_the_clamp_angle() -> None:
    at = places(0.15, Modes(4), S)
    straight = positions(at, np.zeros((1, 4)), alpha0=0.5)[0]
    np.testing.assert_allclose(straight, 0.15 * S[:, None] * [np.cos(0.5), np.sin(0.5)], atol=1e-16)


@given(st.lists(st.floats(-2.0, 2.0), min_size=5, max_size=5))
def test_jacobian_matches_central_differences_of_fourth_order(states: list[float]) -> None:
    at = places(0.15, Modes(5), S)
    theta = np.array([states])
    exact = jacobians(at, theta)[0]
    h = 1e-3
    for i in range(5):
        step = h * np.eye(5)[i]
        near = positions(at, theta + step) - positions(at, theta - step)
        far = positions(at, theta + 2 * step) - positions(at, theta - 2 * step)
        np.testing.assert_allclose(exact[:, :, i], (8.0 * near[0] - far[0]) / (12.0 * h), atol=1e-12)
