"""Derivatives against differences of fourth order, for every kind of parameter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.sensitivity import (
    Perturbations,
    of_clamp_angle,
    of_force,
    of_mass,
    of_moment,
    of_rest_curvature,
    of_stiffness,
    respond,
)
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Gaussians, Powers, Table, Uniform, equidistant, gaussian_basis, power_basis
from onebend.records import Array
from tests.beam.wrench import clamp_wrench

S = np.array([0.3, 0.62, 1.0])
CENTRES, WIDTH = equidistant(3), 0.4
HEIGHTS = np.array([0.01, 0.03, 0.02])
FINE = Resolution(order=24, widest=0.5)
GRAVITY = np.array([[2.0, -9.0]])


def made(p: Array, loads: Loads) -> Equilibrium:
    """A beam whose parameters are p: 3 heights, 2 of q0, clamp angle, 2 of mass, force x and y, moment."""
    beam = Beam(
        0.15,
        Gaussians(CENTRES, WIDTH, tuple(HEIGHTS + p[:3])),
        rest_curvature=Powers((0.2 + p[3], 0.1 + p[4])),
        clamp_angle=0.1 + p[5],
        mass_per_length=Powers((0.3 + p[6], 0.2 + p[7])),
    )
    extra = push((p[8], 0.2 + p[9]), 0.8) + twist(0.001 + p[10], 0.5) + weight(GRAVITY)
    return equilibrium(beam, loads + extra, resolution=FINE)


def all_changes(solved: Equilibrium) -> Perturbations:
    """In the order of p."""
    nodes = solved.problem.grid.nodes
    return (
        of_stiffness(solved, gaussian_basis(nodes, CENTRES, WIDTH))
        + of_rest_curvature(solved.problem, power_basis(nodes, 2))
        + of_clamp_angle(solved.problem)
        + of_mass(solved.problem, power_basis(nodes, 2), GRAVITY)
        + of_force(solved.problem, np.array(0.8))
        + of_moment(solved.problem, np.array(0.5))
    )


SCALE = np.array([1e-2, 1e-2, 1e-2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 1e-3])


def differences(quantity: Callable[[Equilibrium], Array], loads: Loads) -> Array:
    """Fourth-order central differences, last axis over the parameters."""
    columns = []
    for i, scale in enumerate(SCALE):
        h = 2e-3 * scale
        at = [quantity(made(j * h * np.eye(len(SCALE))[i], loads)) for j in (-2, -1, 1, 2)]
        columns.append((at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * h))
    return np.stack(columns, axis=-1)


def test_positions_and_angles_for_all_parameters_at_once() -> None:
    solved = made(np.zeros(len(SCALE)), Loads())
    response = respond(solved, all_changes(solved))
    for exact, quantity in (
        (response.xy(S), lambda e: e.xy(S)),
        (response.poses(S)[:, :, 2], lambda e: e.angle(S)),
    ):
        expected = differences(quantity, Loads())
        np.testing.assert_allclose(
            exact * SCALE, expected * SCALE, atol=1e-9 * np.max(np.abs(expected * SCALE)) + 1e-12
        )


@pytest.mark.parametrize("at", [0.8, np.array([0.8, 0.7])], ids=["one grid", "a grid a frame"])
def test_solved_for_the_quantities_or_for_the_parameters(at: float | Array) -> None:
    """The adjoint way, taken where fewer quantities than parameters are asked for, against all of dq/dp."""
    beam = Beam(0.15, Gaussians(CENTRES, WIDTH, tuple(HEIGHTS)), Powers((0.2, 0.1)), 0.1, Powers((0.3, 0.2)))
    solved = equilibrium(beam, push([(0.0, 0.2), (0.1, 0.2)], at) + weight(GRAVITY), resolution=FINE)
    nodes = solved.problem.grid.nodes
    change = (
        of_stiffness(solved, gaussian_basis(nodes, CENTRES, WIDTH))
        + (of_clamp_angle(solved.problem) + of_mass(solved.problem, power_basis(nodes, 3), GRAVITY))
        + of_force(solved.problem, np.array(at))
    )
    adjoint, direct = respond(solved, change), respond(solved, change)
    assert direct.q.shape == (2, nodes.shape[-1], 9)
    seen = adjoint.poses(S[:2])
    whole = direct.poses(np.append(S[:2], 1.0))[:, :2]  # as many quantities as there are parameters
    np.testing.assert_allclose(seen, whole, atol=1e-12 * np.max(np.abs(seen)))
    np.testing.assert_allclose(adjoint.xy(S[:2]), seen[:, :, :2], atol=1e-12 * np.max(np.abs(seen)))
    by_hand = solved.problem.grid.integral_to(S[:2]) @ direct.q + change.clamp
    np.testing.assert_allclose(seen[:, :, 2], by_hand, atol=1e-12 * np.max(np.abs(by_hand)))


def test_clamp_wrench_balances_the_loads() -> None:
    solved = made(np.zeros(len(SCALE)), Loads())
    force = push((0.0, 0.2), 0.8)
    mass = Table((0.0, 1.0), (0.3, 0.5))
    total_weight = 0.15 * (0.3 + 0.1) * GRAVITY[0]
    wrench = clamp_wrench(solved)[0]
    np.testing.assert_allclose(wrench[:2], -(force.force[0, 0] + total_weight), atol=1e-12)
    nodes, weights = solved.problem.grid.nodes, solved.problem.grid.weights
    at, centres = solved.xy(np.array([0.8]))[0, 0], solved.xy(nodes)[0]
    from_weight = 0.15 * np.sum(weights * mass(nodes) * (centres[:, 0] * GRAVITY[0, 1] - centres[:, 1] * GRAVITY[0, 0]))
    assert wrench[2] == pytest.approx(-(at[0] * 0.2 + 0.001 + from_weight), rel=1e-9)


def test_singular_tangent_gives_nan_not_a_number() -> None:
    """At Euler's load the straight beam's response to a lateral force is infinite."""
    beam = Beam(1.0, Uniform(1.0))
    solved = equilibrium(beam, push((-(np.pi**2) / 4.0, 0.0)), resolution=FINE)
    response = respond(solved, of_force(solved.problem, np.array(1.0))).xy(np.array([1.0]))
    assert np.isnan(response[0, 0, 1, 1]) or abs(response[0, 0, 1, 1]) > 1e6
