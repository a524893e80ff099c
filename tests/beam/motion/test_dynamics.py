"""The matrices of the equation of motion against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.dynamics import body, mass_matrix
from onebend.beam.grid import Modes, jacobians, make_grid, places, positions
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Steps, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array
from tests.beam.moving import (
    ODD,
    SOFT,
    THICK,
    coriolis_matrix,
    elastic_energy,
    force_jacobian,
    gravity_vector,
    kinetic_energy,
    odd_body,
    soft_body,
    weight_energy,
)

N = 4
BODY = odd_body(N)
GRAVITY = np.array([3.0, -9.0])
states = st.lists(st.floats(-2.0, 2.0), min_size=N, max_size=N).map(np.array)


def slopes(of: object, theta: Array, h: float = 1e-3) -> Array:
    """(..., n) derivative of a function of the states by differences of fourth order."""
    assert callable(of)
    steps = h * np.eye(len(theta))
    parts = [
        (8.0 * (of(theta + e) - of(theta - e)) - of(theta + 2 * e) + of(theta - 2 * e)) / (12.0 * h) for e in steps
    ]
    return np.stack(parts, axis=-1)


@given(states)
def test_mass_matrix_is_the_integral_of_its_definition(theta: Array) -> None:
    """B = L int mu J^T J + L int iota a a^T, with the Jacobians of the kinematics on a finer grid."""
    beam = Beam(ODD.length, ODD.stiffness, mass_per_length=ODD.mass_per_length)  # straight: what kinematics knows
    grid = make_grid(beam.mass_per_length.jumps, order=30)
    at = places(beam.length, Modes(N), grid.nodes)
    jacobian = jacobians(at, theta[None])[0]
    line = beam.length * grid.weights * beam.mass_per_length(grid.nodes)
    expected = np.einsum("q,qci,qcj->ij", line, jacobian, jacobian)
    expected += at.to_places.T @ ((beam.length * grid.weights * THICK(grid.nodes))[:, None] * at.to_places)
    found = mass_matrix(body(beam, Modes(N), rotary_inertia=THICK), theta)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.max(expected))


@given(states, states)
def test_mass_matrix_is_the_second_derivative_of_the_kinetic_energy(theta: Array, rate: Array) -> None:
    np.testing.assert_allclose(
        slopes(lambda r: slopes(lambda v: kinetic_energy(BODY, theta, v), r), rate),
        mass_matrix(BODY, theta),
        atol=1e-12,
    )


@given(states)
def test_mass_matrix_is_positive_definite(theta: Array) -> None:
    assert np.linalg.eigvalsh(mass_matrix(BODY, theta))[0] > 0.0


@given(states, states)
def test_coriolis_matrix_is_made_of_christoffel_symbols(theta: Array, rate: Array) -> None:
    slope = slopes(lambda x: mass_matrix(BODY, x), theta)  # [i, j, k] = d B_ij / d theta_k
    christoffel = 0.5 * (slope + np.swapaxes(slope, 1, 2) - np.moveaxis(slope, 2, 0))
    np.testing.assert_allclose(coriolis_matrix(BODY, theta, rate), christoffel @ rate, atol=1e-12)


@given(states, states)
def test_rate_of_mass_matrix_less_twice_coriolis_is_skew(theta: Array, rate: Array) -> None:
    change = slopes(lambda x: mass_matrix(BODY, x), theta) @ rate
    skew = change - 2.0 * coriolis_matrix(BODY, theta, rate)
    np.testing.assert_allclose(skew, -skew.T, atol=1e-12)


@given(states, states)
def test_coriolis_force_is_the_integral_of_its_definition(theta: Array, rate: Array) -> None:
    """C theta' = L int mu J^T (dJ/dt theta'), on a straight beam whose Jacobians the kinematics gives."""
    of = soft_body(N)
    grid = make_grid(order=30)
    at = places(SOFT.length, Modes(N), grid.nodes)
    h = 1e-3
    near = jacobians(at, (theta + h * rate)[None]) - jacobians(at, (theta - h * rate)[None])
    far = jacobians(at, (theta + 2 * h * rate)[None]) - jacobians(at, (theta - 2 * h * rate)[None])
    change = (8.0 * near - far)[0] / (12.0 * h) @ rate
    expected = np.einsum("q,qci,qc->i", SOFT.length * 0.1 * grid.weights, jacobians(at, theta[None])[0], change)
    np.testing.assert_allclose(coriolis_matrix(of, theta, rate) @ rate, expected, atol=1e-11)


@given(states)
def test_gravity_and_stiffness_are_derivatives_of_their_energies(theta: Array) -> None:
    np.testing.assert_allclose(
        gravity_vector(BODY, theta, GRAVITY), slopes(lambda x: weight_energy(BODY, x, GRAVITY), theta), atol=1e-12
    )
    np.testing.assert_allclose(BODY.stiffness @ theta, slopes(lambda x: elastic_energy(BODY, x), theta), atol=1e-12)


@given(states, st.floats(0.05, 1.0))
def test_force_jacobian_is_the_derivative_of_the_position(theta: Array, at_s: float) -> None:
    found = slopes(lambda x: BODY.xy(np.array([at_s]), x[None])[0, 0], theta)
    np.testing.assert_allclose(force_jacobian(BODY, theta, at_s), found, atol=1e-11)


@given(states, states)
def test_kinetic_energy_is_that_of_the_moving_points(theta: Array, rate: Array) -> None:
    """Half the integral of mu |v|^2, v by differences of positions in time."""
    of, h = body(ODD, Modes(N)), 1e-3
    r = of.xy(of.grid.nodes, theta + np.outer(h * np.array([-2.0, -1.0, 1.0, 2.0]), rate))
    v = (8.0 * (r[2] - r[1]) - (r[3] - r[0])) / (12.0 * h)
    line = of.length * of.grid.weights * ODD.mass_per_length(of.grid.nodes)
    exact = 0.5 * np.sum(line * np.sum(v**2, axis=1))
    assert kinetic_energy(of, theta, rate) == pytest.approx(exact, rel=1e-8, abs=1e-10)


def test_positions_agree_with_the_kinematics() -> None:
    theta = np.array([[1.0, -0.5, 0.3, 0.2], [0.0, 0.4, 0.0, -1.0]])
    s = np.array([0.2, 0.7, 1.0])
    np.testing.assert_allclose(
        soft_body(N).xy(s, theta), positions(places(SOFT.length, Modes(N), s), theta), atol=1e-14
    )
    assert soft_body(N).angle(s, theta).shape == (2, 3)


def test_matrices_of_a_batch_are_those_of_its_members() -> None:
    rng = np.random.default_rng(1)
    theta, rate = rng.normal(size=(2, 5, N))
    for i in range(5):
        np.testing.assert_allclose(mass_matrix(BODY, theta)[i], mass_matrix(BODY, theta[i]), atol=1e-15)
        np.testing.assert_allclose(
            coriolis_matrix(BODY, theta, rate)[i], coriolis_matrix(BODY, theta[i], rate[i]), atol=1e-15
        )
        np.testing.assert_allclose(
            gravity_vector(BODY, theta, GRAVITY)[i], gravity_vector(BODY, theta[i], GRAVITY), atol=1e-15
        )


def test_nodes_as_coordinates_hold_a_stiffness_with_jumps() -> None:
    beam = Beam(1.0, Steps((0.0, 0.4, 1.0), (2.0, 0.5)), mass_per_length=Uniform(1.0))
    of = body(beam, resolution=Resolution(8))
    assert of.n == 16
    assert of.grid.edges.tolist() == [0.0, 0.4, 1.0]
    np.testing.assert_allclose(np.sum(of.stiffness), 0.4 * 2.0 + 0.6 * 0.5)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: body(Beam(1.0, Uniform(-1.0), mass_per_length=Uniform(1.0)), Modes(3)), r"k\(s\) = -1 at s = 0"),
        (lambda: body(Beam(1.0, Uniform(1.0)), Modes(3)), "mass per metre = 0"),
        (lambda: body(SOFT, Modes(3), rotary_inertia=Uniform(-1.0)), "rotary inertia"),
        (lambda: body(SOFT, Modes(3), damping=Uniform(np.nan)), "damping = nan"),
        (lambda: body(SOFT, Modes(9), resolution=Resolution(8)), "at least as many nodes"),
    ],
)
def test_what_cannot_move_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        make()
