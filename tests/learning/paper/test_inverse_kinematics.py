"""Inverse kinematics: states come back, missing tags are borne, the covariance is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.grid import Modes, angles, places, positions
from onebend.errors import LearningError
from onebend.learning.paper import solve_states
from tests.learning.bench import MARKERS, SOFT, forces, observed


def of_states(theta: np.ndarray, **changes: object):  # type: ignore[no-untyped-def]
    at = places(SOFT.length, Modes(theta.shape[1]), MARKERS)
    made = observed(SOFT, np.zeros((len(theta), 2)), xy=positions(at, theta), angle=angles(at, theta))
    return replace(made, **changes)  # type: ignore[arg-type]


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6), st.integers(1, 6))
def test_forward_then_inverse_is_the_identity(values: list[float], n: int) -> None:
    """Up to n = 6: near a straight beam the three x coordinates say nothing to first order, six numbers remain."""
    theta = np.array([values[:n]]) / (1.0 + np.arange(n))
    states = solve_states(of_states(theta), n)
    assert states.converged.all()
    np.testing.assert_allclose(states.theta, theta, atol=1e-6)


@pytest.mark.parametrize("n", [7, 8, 9])
def test_markers_of_a_bent_beam_are_met_with_as_many_states_as_data(n: int) -> None:
    theta = np.array([1.5, 0.6, -0.3, 0.1, 0.05, -0.02, 0.01, 0.005, -0.002])[None, :n]
    made = of_states(theta)
    states = solve_states(made, n)
    at = places(SOFT.length, Modes(n), MARKERS)
    np.testing.assert_allclose(positions(at, states.theta), made.xy, atol=1e-8)
    np.testing.assert_allclose(angles(at, states.theta), made.angle, atol=1e-6)


def test_positions_alone_determine_as_many_states_as_coordinates() -> None:
    theta = np.array([[1.2, 0.3, -0.1, 0.05]])
    np.testing.assert_allclose(solve_states(of_states(theta), 4, with_angles=False).theta, theta, atol=1e-6)


def test_a_hidden_tag_leaves_the_frame_usable() -> None:
    theta = np.tile([[0.8, 0.3, -0.1]], (3, 1))
    made = of_states(theta)
    xy, angle = made.xy.copy(), made.angle.copy()
    xy[1, 0], angle[1, 0] = np.nan, np.nan
    xy[2], angle[2] = np.nan, np.nan
    states = solve_states(replace(made, xy=xy, angle=angle), 3)
    np.testing.assert_allclose(states.theta[:2], theta[:2], atol=1e-6)
    assert np.isnan(states.theta[2]).all()
    assert states.converged.tolist() == [True, True, False]
    assert states.data.tolist() == [9.0, 6.0, 0.0]


def test_the_least_curved_shape_is_taken_where_data_leave_it_open() -> None:
    made = of_states(np.array([[0.6, 0.0, 0.0]]))
    angle, xy = np.full_like(made.angle, np.nan), np.full_like(made.xy, np.nan)
    angle[:, 2], xy[:, 2] = made.angle[:, 2], made.xy[:, 2]
    states = solve_states(replace(made, xy=xy, angle=angle), 6)
    np.testing.assert_allclose(states.theta, [[0.6, 0, 0, 0, 0, 0]], atol=1e-4)


def test_covariance_is_the_scatter_over_many_noisy_frames() -> None:
    theta = np.tile([[1.0, 0.4, 0.1]], (4000, 1))
    at = places(SOFT.length, Modes(3), MARKERS)
    made = observed(
        SOFT, np.zeros((4000, 2)), xy=positions(at, theta), angle=angles(at, theta), noise=(3e-5, 2e-3), seed=3
    )
    states = solve_states(made, 3)
    scatter = np.cov(states.theta.T)
    np.testing.assert_allclose(np.diag(scatter), np.diag(states.covariance.mean(axis=0)), rtol=0.1)


def test_more_modes_than_data_are_refused() -> None:
    with pytest.raises(LearningError, match="at most 9"):
        solve_states(observed(SOFT, forces(5)), 10)
    with pytest.raises(LearningError, match="at most 6"):
        solve_states(observed(SOFT, forces(5)), 7, with_angles=False)
