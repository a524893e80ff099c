"""Derivatives of a beam that stretches and shears against differences of fourth order, for every kind of parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium, follow
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.sensitivity import (
    Perturbation,
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
from onebend.beam.stiffness import Gaussians, Powers, RectangularSection, equidistant, gaussian_basis, power_basis
from onebend.records import Array
from tests.beam.thickness import of_section_thickness

Varies = Literal["thickness", "width"]
S = np.array([0.3, 0.62, 1.0])
CENTRES, WIDTH = equidistant(3), 0.4
HEIGHTS = np.array([0.01, 0.03, 0.02])
FINE = Resolution(order=24, widest=0.5)
GRAVITY = np.array([[2.0, -9.0]])
SCALE = np.array([1e-2, 1e-2, 1e-2, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 1e-3, 0.1])


def made(p: Array, loads: Loads, varies: Varies, at: float | Array = 0.8) -> Equilibrium:
    """A beam whose parameters are p: 3 heights, 2 of q0, clamp angle, 2 of mass, force, moment, log h0."""
    beam = Beam(
        0.15,
        Gaussians(CENTRES, WIDTH, tuple(HEIGHTS + p[:3])),
        rest_curvature=Powers((0.2 + p[3], 0.1 + p[4])),
        clamp_angle=0.1 + p[5],
        mass_per_length=Powers((0.3 + p[6], 0.2 + p[7])),
        thickness=0.03 * float(np.exp(p[11])),
        poisson=0.3,
        varies=varies,
    )
    extra = push(np.tile([p[8], 0.2 + p[9]], (np.size(at), 1)), at) + twist(0.001 + p[10], 0.5) + weight(GRAVITY)
    return equilibrium(beam, loads + extra, resolution=FINE)


def all_parameters(solved: Equilibrium, at: float | Array = 0.8) -> Perturbations:
    """In the order of p."""
    problem = solved.problem
    nodes = problem.grid.nodes
    return (
        of_stiffness(solved, gaussian_basis(nodes, CENTRES, WIDTH))
        + of_rest_curvature(problem, power_basis(nodes, 2))
        + of_clamp_angle(problem)
        + of_mass(problem, power_basis(nodes, 2), GRAVITY)
        + of_force(problem, np.asarray(at))
        + of_moment(problem, np.array(0.5))
        + of_section_thickness(problem)
    )


def differences(quantity: Callable[[Array], Array], count: int = len(SCALE)) -> Array:
    """Fourth-order central differences of a quantity of p, last axis over the parameters."""
    columns = []
    for i, scale in enumerate(SCALE[:count]):
        h = 2e-3 * scale
        f = [quantity(j * h * np.eye(len(SCALE))[i]) for j in (-2, -1, 1, 2)]
        columns.append((f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / (12.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("varies", ["thickness", "width"])
def test_positions_and_angles_for_all_parameters_at_once(varies: Varies) -> None:
    solved = made(np.zeros(len(SCALE)), Loads(), varies)
    exact = respond(solved, all_parameters(solved)).poses(S)

    def poses(p: Array) -> Array:
        here = made(p, Loads(), varies)
        return np.concatenate([here.xy(S), here.angle(S)[..., None]], axis=-1)

    expected = differences(poses)
    np.testing.assert_allclose(exact * SCALE, expected * SCALE, atol=1e-9 * np.max(np.abs(expected * SCALE)))
    assert np.all(np.max(np.abs(expected[..., 11:]), axis=(0, 1, 2)) > 1e-5)  # the thickness does matter


@pytest.mark.parametrize("at", [0.8, np.array([0.8, 0.7])], ids=["one grid", "a grid a frame"])
def test_solved_for_the_quantities_or_for_the_parameters(at: float | Array) -> None:
    """The adjoint way, taken where fewer quantities than parameters are asked for, against all of dq/dp."""
    frames = Loads(gravity=np.zeros((2, 2)))
    solved = made(np.zeros(len(SCALE)), frames, "thickness", at)
    parameters = all_parameters(solved, at)
    adjoint = respond(solved, parameters)
    poses = adjoint.poses(S[:2])
    direct = respond(solved, parameters).poses(np.append(S[:2], [0.8, 1.0]))  # as many as there are parameters
    tolerance = 1e-12 * np.max(np.abs(poses))
    np.testing.assert_allclose(poses, direct[:, :2], atol=tolerance)
    np.testing.assert_allclose(adjoint.xy(S[:2]), poses[:, :, :2], atol=tolerance)


def test_given_compliance_stays_as_k_changes() -> None:
    """With arrays of 1/EA and 1/kGA only the bending goes with k; each of the two has derivatives of its own."""
    beam = Beam(0.15, Gaussians(CENTRES, WIDTH, tuple(HEIGHTS)))
    problem = make_problem(beam, push((0.1, 0.3)), FINE)
    nodes = problem.grid.nodes
    shapes = np.stack([1.0 + nodes, 1.0 + nodes**2], axis=1) * 1e-3

    def here(p: Array) -> Equilibrium:
        heights = beam.stiffness(nodes) + gaussian_basis(nodes, CENTRES, WIDTH) @ (p[:3])
        size = 1.0 + p[3:5]
        return follow(replace(problem, k=heights, stretch=size[0] * shapes[:, 0], shear=size[1] * 10.0 * shapes[:, 1]))

    solved, none = here(np.zeros(len(SCALE))), np.zeros_like(nodes)
    by_stretch = Perturbation(None, None, None, np.zeros(1), ((shapes[:, 0], none), np.ones((len(nodes), 1))))
    by_shear = Perturbation(None, None, None, np.zeros(1), ((none, 10.0 * shapes[:, 1]), np.ones((1, len(nodes), 1))))
    parameters = of_stiffness(solved, gaussian_basis(nodes, CENTRES, WIDTH)) + by_stretch + by_shear
    expected = differences(lambda p: here(p).xy(S), 5)
    exact = respond(solved, parameters).xy(S)
    np.testing.assert_allclose(
        exact * SCALE[:5], expected * SCALE[:5], atol=1e-9 * np.max(np.abs(expected * SCALE[:5]))
    )


def test_first_effect_of_strain_on_a_rigid_beam() -> None:
    """The derivative with 1/kGA about the inextensible beam: what a fit that ignores shear leaves, to first order."""
    beam = Beam(0.15, Gaussians(CENTRES, WIDTH, tuple(HEIGHTS)))
    problem = make_problem(beam, push((0.1, 0.3)), FINE)
    solved, ones = follow(problem), np.ones(len(problem.grid.nodes))
    shear = Perturbation(None, None, None, np.zeros(1), ((0.0 * ones, ones), np.ones((len(ones), 1))))
    h = 1e-6
    moved = (follow(replace(problem, shear=h * ones)).xy(S) - solved.xy(S)) / h
    np.testing.assert_allclose(respond(solved, shear).xy(S)[..., 0], moved, rtol=1e-4)


def test_scaling_k_as_a_whole_scales_the_strain() -> None:
    """With k, EA and kGA times c and loads times c nothing moves: h0 stays, mean k goes along."""
    solved = made(np.zeros(len(SCALE)), Loads(), "thickness")
    problem = solved.problem
    other = replace(problem, k=3.0 * problem.k, dead_force=3.0 * problem.dead_force, moment=3.0 * problem.moment)
    np.testing.assert_allclose(follow(other).xy(S), solved.xy(S), atol=1e-13)
    by_scale = problem.section.log_by_stiffness(problem.k, problem.weights, problem.k[:, None])  # type: ignore[union-attr]
    np.testing.assert_allclose(by_scale, -1.0, atol=1e-13)


def test_thickness_may_differ_from_frame_to_frame() -> None:
    beam = Beam(0.15, Gaussians(CENTRES, WIDTH, tuple(HEIGHTS)))
    problem = make_problem(beam, push(np.tile([0.1, 0.3], (2, 1))), FINE)
    apart = partial(replace, problem)
    both = follow(apart(section=RectangularSection(np.array([[0.01], [0.03]]))))
    for i, h in enumerate((0.01, 0.03)):
        alone = follow(apart(section=RectangularSection(h)))
        np.testing.assert_allclose(both.xy(S)[i], alone.xy(S)[i], atol=1e-13)
        exact = respond(both, of_section_thickness(both.problem)).xy(S)[i]
        np.testing.assert_allclose(exact, respond(alone, of_section_thickness(alone.problem)).xy(S)[i], atol=1e-13)


def test_a_fit_of_log_k_and_log_thickness() -> None:
    """As a fit uses it: k = exp(basis c), the section follows k by itself, and both have exact derivatives."""
    carrier = make_problem(Beam(0.15, Gaussians(CENTRES, WIDTH, (1.0, 1.0, 1.0))), push([(0.1, 0.3), (0.0, 0.5)]), FINE)
    basis = gaussian_basis(carrier.grid.nodes, CENTRES, WIDTH)

    def predicted(p: Array) -> Equilibrium:
        k, h0 = np.exp(basis @ (p[:3] - 4.0)), 0.02 * float(np.exp(p[3]))
        return follow(replace(carrier, k=k, section=RectangularSection(h0)))

    solved = predicted(np.zeros(4))
    problem = solved.problem
    exact = respond(solved, of_stiffness(solved, problem.k[:, None] * basis) + of_section_thickness(problem)).poses(S)
    h = 1e-4
    for i in range(4):
        e = h * np.eye(4)[i]
        moved = (predicted(e).xy(S) - predicted(-e).xy(S)) / (2.0 * h)
        np.testing.assert_allclose(exact[:, :, :2, i], moved, atol=1e-6 * np.max(np.abs(moved)))
    held = of_stiffness(follow(replace(problem, section=None)), problem.k[:, None] * basis)
    assert held.compliance is None


def test_a_parameter_that_acts_in_several_ways_is_the_sum_of_them() -> None:
    """As log k of a beam whose mass follows k: it changes bending, strain and weight together."""
    solved = made(np.zeros(len(SCALE)), Loads(), "thickness")
    nodes = solved.problem.grid.nodes
    by_k = of_stiffness(solved, gaussian_basis(nodes, CENTRES, WIDTH))
    by_mass = of_mass(solved.problem, power_basis(nodes, 3), GRAVITY)
    together = replace(by_k, force=by_mass.force)
    exact = respond(solved, by_k).poses(S) + respond(solved, by_mass).poses(S)
    np.testing.assert_allclose(respond(solved, together).poses(S), exact, atol=1e-11 * np.max(np.abs(exact)))
    adjoint = respond(solved, together).xy(S[:1])
    np.testing.assert_allclose(adjoint, exact[:, :1, :2], atol=1e-11 * np.max(np.abs(exact)))
