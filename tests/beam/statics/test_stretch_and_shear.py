"""The rod of Simo and Reissner against closed forms, an independent integrator and its own identities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.beam import continuation
from onebend.beam.continuation import by_load, equilibrium, follow
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, make_problem
from onebend.beam.sensitivity import of_force, respond
from onebend.beam.statics import Equilibrium, balance, gradient, potential, tangent
from onebend.beam.stiffness import Gaussians, Powers, Uniform
from onebend.records import Array
from tests.beam.extensible import PointForce, shoot
from tests.beam.wrench import clamp_wrench

THICK = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)), thickness=0.02)
UNIT = Beam(1.0, Uniform(1.0))  # EI = 1
FINE = Resolution(16, 0.25)
TIP = np.array([1.0])
S = np.array([0.3, 0.62, 1.0])


def given_compliance(beam: Beam, loads: Loads, stretch: float, shear: float, resolution: Resolution = FINE) -> Problem:
    """A problem of uniform 1/EA and 1/kGA [1/N]."""
    problem = make_problem(beam, loads, resolution)
    ones = np.ones(problem.weights.shape[-1])
    return replace(problem, stretch=stretch * ones, shear=shear * ones)


def strains(solved: Equilibrium) -> tuple[Array, Array]:
    """(T, Q) each: stretch N/EA and shear Q/kGA under all loads."""
    assert solved.problem.compliance is not None
    stretch, shear = (a * b for a, b in zip(solved.problem.compliance, solved.normal_and_shear, strict=True))
    return stretch, shear


def test_axial_pull_stretches_by_its_share_of_ea() -> None:
    solved = follow(given_compliance(UNIT, push((3.0, 0.0)), 1e-2, 5e-2))
    np.testing.assert_allclose(solved.xy(np.array([0.5, 1.0]))[0], [[0.515, 0.0], [1.03, 0.0]], atol=1e-14)


@pytest.mark.parametrize(("stretch", "shear"), [(0.0, 0.0), (0.02, 0.0), (0.0, 0.05), (0.02, 0.05)])
def test_small_deflection_is_timoshenkos(stretch: float, shear: float) -> None:
    """y = P L^3 / 3 EI + P L / kGA."""
    load = 1e-5
    tip = follow(given_compliance(UNIT, push((0.0, load)), stretch, shear)).xy(TIP)[0, 0]
    assert tip[1] / load == pytest.approx(1.0 / 3.0 + shear, rel=1e-8)


def test_uniform_weight_is_timoshenkos() -> None:
    """y = w L^4 / 8 EI + w L^2 / 2 kGA."""
    heavy = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1e-6))
    tip = follow(given_compliance(heavy, weight((0.0, 9.0)), 0.01, 0.05)).xy(TIP)[0, 0]
    assert tip[1] / 9e-6 == pytest.approx(1.0 / 8.0 + 0.05 / 2.0, rel=1e-8)


@pytest.mark.parametrize(("stretch", "shear"), [(0.03, 0.0), (0.0, 0.08), (0.03, 0.11), (0.08, 0.02)])
def test_column_buckles_at_reissners_load(stretch: float, shear: float) -> None:
    """P (1 + P/kGA - P/EA) = EI (pi / 2 L)^2, Reissner 1982; Euler's load differs by 7 to 24 % here."""
    euler, delta = 0.25 * np.pi**2, shear - stretch
    load = (np.sqrt(1.0 + 4.0 * delta * euler) - 1.0) / (2.0 * delta)
    solved = follow(given_compliance(UNIT, push((-1.2 * load, 0.0)), stretch, shear))
    assert solved.buckled_at[0] * 1.2 == pytest.approx(1.0, abs=1e-7)
    assert abs(load / euler - 1.0) > 0.06


@given(
    force=st.tuples(st.floats(-4.0, 2.0), st.floats(0.5, 6.0)), stretch=st.floats(0.0, 0.03), shear=st.floats(0.0, 0.05)
)
@settings(max_examples=12)
def test_first_integral_is_the_same_all_along(force: tuple[float, float], stretch: float, shear: float) -> None:
    """M^2 / 2 EI + N + N^2 / 2 EA + Q^2 / 2 kGA between loads of a uniform, straight beam."""
    solved = follow(given_compliance(UNIT, push(force), stretch, shear))
    alpha = solved.alpha[0]
    n = force[0] * np.cos(alpha) + force[1] * np.sin(alpha)
    q = force[1] * np.cos(alpha) - force[0] * np.sin(alpha)
    integral = 0.5 * solved.moment()[0] ** 2 + n + 0.5 * stretch * n**2 + 0.5 * shear * q**2
    np.testing.assert_allclose(integral, integral[0], atol=1e-9)


LOADS = push((0.15, 0.5)) + push((-0.2, 0.3), 0.8) + weight((2.0, -9.0))
FORCES = (PointForce(1.0, (0.15, 0.5)), PointForce(0.8, (-0.2, 0.3)))


@pytest.mark.parametrize("varies", ["thickness", "width"])
@pytest.mark.parametrize(("thickness", "poisson"), [(0.012, 0.48), (0.04, 0.3)])
def test_against_an_initial_value_solver(varies: str, thickness: float, poisson: float) -> None:
    """Uneven k, a tip force, a force at s = 0.8 and the weight: 1e-8 L."""
    beam = Beam(
        0.15,
        THICK.stiffness,
        Powers((0.2, 0.1)),
        0.1,
        Powers((0.3, 0.2)),
        thickness,
        poisson,
        varies,  # type: ignore[arg-type]
    )
    solved = equilibrium(beam, LOADS)
    places = np.array([0.2, 0.5, 0.75, 0.9, 1.0])
    expected = shoot(beam, FORCES, (2.0, -9.0), places, near=-clamp_wrench(solved)[0, 2])
    np.testing.assert_allclose(solved.xy(places)[0], expected[:, :2], atol=1e-8 * 0.15)
    np.testing.assert_allclose(solved.angle(places)[0], expected[:, 2], atol=1e-8)
    inextensible = equilibrium(replace(beam, thickness=None), LOADS)
    assert np.max(np.abs(inextensible.xy(places)[0] - expected[:, :2])) > 1e-4 * 0.15


def test_inextensible_is_the_limit_with_order_one() -> None:
    beam = replace(THICK, thickness=None)
    limit, problem = follow(make_problem(beam, LOADS, FINE)), make_problem(beam, LOADS, FINE)
    ones, sizes = np.ones(problem.weights.shape[-1]), np.array([1e-3, 1e-4, 1e-5, 1e-6])
    for stretch, shear in ((1.0, 0.0), (0.0, 1.0), (1.0, 3.0)):
        away = [
            np.max(
                np.abs(follow(replace(problem, stretch=e * stretch * ones, shear=e * shear * ones)).xy(S) - limit.xy(S))
            )
            for e in sizes
        ]
        assert np.polyfit(np.log(sizes), np.log(away), 1)[0] == pytest.approx(1.0, abs=0.02)


def test_zero_compliance_gives_the_same_bits() -> None:
    beam = replace(THICK, thickness=None)
    problem = make_problem(beam, LOADS, FINE)
    zeros = np.zeros(problem.weights.shape[-1])
    plain, zero = follow(problem), follow(replace(problem, stretch=zeros, shear=zeros))
    np.testing.assert_array_equal(plain.q, zero.q)
    np.testing.assert_array_equal(plain.xy(S), zero.xy(S))


def test_tangent_is_the_gradients_derivative_and_symmetric() -> None:
    problem = make_problem(replace(THICK, thickness=0.04), LOADS, Resolution(8, 0.5))
    q = np.random.default_rng(1).normal(size=(1, problem.weights.shape[-1]))
    _, matrix = balance(problem, q)
    h = 1e-5
    slope = np.stack([(gradient(problem, q + h * e) - gradient(problem, q - h * e))[0] for e in np.eye(q.size)], axis=1)
    np.testing.assert_allclose(matrix[0], slope / (2.0 * h), atol=1e-8 * np.max(np.abs(matrix)))
    np.testing.assert_allclose(matrix[0], matrix[0].T, atol=1e-15)
    energy = [(potential(problem, q + h * e) - potential(problem, q - h * e))[0] / (2.0 * h) for e in np.eye(q.size)]
    np.testing.assert_allclose(gradient(problem, q)[0], energy, atol=1e-8 * np.max(np.abs(energy)))


def test_half_the_work_on_the_strains_is_stored() -> None:
    """The potential of a pulled rod is -P^2 L / 2 EA beyond that of its rest length."""
    problem = given_compliance(UNIT, push((3.0, 0.0)), 1e-2, 0.0)
    still = np.zeros((1, problem.weights.shape[-1]))
    assert potential(problem, still)[0] == pytest.approx(-3.0 - 0.5 * 9.0 * 1e-2, rel=1e-13)


def test_moment_is_lever_arm_times_force_over_the_strained_shape() -> None:
    solved = equilibrium(THICK, push((0.1, 0.6), 0.8))
    nodes = solved.problem.grid.nodes
    arm = solved.xy(np.array([0.8]))[0, 0] - solved.xy(nodes)[0]
    moment = np.where(nodes < 0.8, arm[:, 0] * 0.6 - arm[:, 1] * 0.1, 0.0)
    np.testing.assert_allclose(solved.moment()[0], moment, atol=1e-11)


@given(a=st.floats(0.2, 0.9), b=st.floats(0.3, 1.0), force=st.tuples(st.floats(-0.3, 0.3), st.floats(0.1, 0.5)))
@settings(max_examples=12)
def test_maxwell_and_betti(a: float, b: float, force: tuple[float, float]) -> None:
    """What a force at a does at b, a force at b does at a, however far the beam is bent."""
    solved = equilibrium(THICK, push(force) + push((0.0, 0.0), a) + push((0.0, 0.0), b), resolution=FINE)
    problem = solved.problem
    at_b = respond(solved, of_force(problem, np.array(a))).xy(np.array([b]))[0, 0]
    at_a = respond(solved, of_force(problem, np.array(b))).xy(np.array([a]))[0, 0]
    np.testing.assert_allclose(at_b, at_a.T, atol=1e-11)


def test_clamp_wrench_balances_the_loads_on_the_strained_shape() -> None:
    beam = replace(THICK, mass_per_length=Powers((0.3, 0.2)))
    solved = equilibrium(beam, LOADS)
    nodes, weights = solved.problem.grid.nodes, solved.problem.grid.weights
    wrench, g = clamp_wrench(solved)[0], np.array([2.0, -9.0])
    mass = 0.15 * weights * np.asarray(beam.mass_per_length(nodes))
    places = np.concatenate([solved.xy(np.array([1.0, 0.8]))[0], solved.xy(nodes)[0]])
    force = np.concatenate([[(0.15, 0.5), (-0.2, 0.3)], mass[:, None] * g])
    np.testing.assert_allclose(wrench[:2], -np.sum(force, axis=0), atol=1e-12)
    assert wrench[2] == pytest.approx(-np.sum(places[:, 0] * force[:, 1] - places[:, 1] * force[:, 0]), rel=1e-9)


def test_error_falls_with_the_fourth_order_for_two_nodes_a_panel() -> None:
    def tip(resolution: Resolution) -> Array:
        return np.asarray(follow(make_problem(THICK, push((0.1, 0.5)), resolution)).xy(TIP)[0, 0])

    panels, reference = np.array([8, 16, 32, 64]), tip(Resolution(16, 0.125))
    errors = [np.linalg.norm(tip(Resolution(order=2, widest=1.0 / count)) - reference) for count in panels]
    assert np.polyfit(np.log(panels), np.log(errors), 1)[0] == pytest.approx(-4.0, abs=0.15)


def test_error_falls_spectrally_with_the_nodes_of_one_panel() -> None:
    reference = equilibrium(THICK, push((0.02, 0.4))).xy(S)
    errors = [
        np.max(np.abs(follow(make_problem(THICK, push((0.02, 0.4)), Resolution(order=n))).xy(S) - reference))
        for n in (4, 8, 12, 16)
    ]
    assert np.all(np.diff(np.log(errors)) < -1.5)


def test_positions_along_the_beam_go_with_the_strained_tangent() -> None:
    solved = equilibrium(THICK, LOADS)
    at, h = np.array([0.3, 0.6, 0.9]), 1e-5
    slope = (solved.xy(at + h) - solved.xy(at - h)) / (2.0 * h)
    np.testing.assert_allclose(solved.xy_by_s(at), slope, atol=1e-9)
    stretch, shear = strains(solved)
    u = solved.xy_by_s(solved.problem.grid.nodes)[0] / 0.15
    cos, sin = np.cos(solved.alpha[0]), np.sin(solved.alpha[0])
    np.testing.assert_allclose(u[:, 0] * cos + u[:, 1] * sin, 1.0 + stretch[0], atol=1e-12)
    np.testing.assert_allclose(u[:, 1] * cos - u[:, 0] * sin, shear[0], atol=1e-12)


def test_a_column_falls_to_an_equilibrium_of_lower_energy() -> None:
    problem = given_compliance(UNIT, push((-4.0, 0.0)), 0.01, 0.05)
    up, down, straight = follow(problem, fall="left"), follow(problem, fall="right"), follow(problem)
    assert up.fell[0]
    assert up.stable[0]
    assert not straight.stable[0]
    assert potential(problem, up.q)[0] < potential(problem, straight.q)[0]
    np.testing.assert_allclose(gradient(problem, up.q), 0.0, atol=1e-12)
    np.testing.assert_allclose(down.q, -up.q, atol=1e-9)


@pytest.mark.parametrize("thickness", [None, 0.06])
def test_the_branch_leaves_rest_by_its_taylor_series_of_third_order(thickness: float | None) -> None:
    """The predictor knows that strains make the balance quadratic in the load."""
    problem = make_problem(replace(THICK, thickness=thickness), push((-0.3, 0.6)) + twist(0.004, 0.5), FINE)
    rest = np.zeros((1, problem.weights.shape[-1]))
    state = continuation._State(rest, 1)
    continuation._look_ahead(problem, state, np.array([0]))
    shares = np.array([0.005, 0.01, 0.02])
    away = [
        np.max(
            np.abs(
                follow(problem.loaded(np.array([f]))).q
                - continuation._predicted(problem, state, np.array([0]), np.array([f]))
            )
        )
        for f in shares
    ]
    assert np.polyfit(np.log(shares), np.log(away), 1)[0] == pytest.approx(4.0, abs=0.1)


def test_the_slope_of_the_branch_with_the_load() -> None:
    """At a load: minus the tangent's inverse times this is how the shape goes with the load."""
    problem, factor, h = make_problem(replace(THICK, thickness=0.04), LOADS, FINE), np.array([0.6]), 1e-4
    q = follow(problem.loaded(factor)).q
    slope = np.linalg.solve(tangent(problem, q, factor), by_load(problem, q, factor)[..., None])[..., 0]
    moved = follow(problem.loaded(factor + h)).q - follow(problem.loaded(factor - h)).q
    np.testing.assert_allclose(slope, moved / (2.0 * h), atol=1e-7 * np.max(np.abs(slope)))


def test_where_a_branch_ends_places_are_those_of_the_load_reached() -> None:
    beam = Beam(1.0, Uniform(1.0), rest_curvature=Uniform(4.0))
    problem = given_compliance(beam, push((6.5, -3.4)), 0.005, 0.01)
    ended = follow(problem)
    assert not ended.converged[0]
    before = follow(problem.loaded(0.999999 * ended.load_factor))
    assert before.converged[0]
    np.testing.assert_allclose(ended.xy(TIP), before.xy(TIP), atol=5e-3)
    assert ended.load_factor[0] < 0.95
    np.testing.assert_allclose(ended.load_factor * strains(ended)[0], strains(before)[0], atol=5e-4)
