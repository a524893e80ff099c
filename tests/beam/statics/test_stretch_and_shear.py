"""The rod of Simo and Reissner against closed forms, an independent integrator and its own identities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onebend.beam.loads import Loads, follow_push, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.profiles.stiffness import Gaussians, Powers, Steps, Uniform
from onebend.beam.statics.continuation import equilibrium, follow, refine
from onebend.beam.statics.equilibrium import Equilibrium, balance, gradient, potential
from onebend.beam.statics.problem import Problem, Resolution, make_problem, make_problems
from onebend.beam.statics.sensitivity import clamp_wrench, of_force, respond
from onebend.errors import MechanicsError
from onebend.records import Array
from tests.beam.extensible import PointForce, shoot

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
@settings(max_examples=25)
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
    problem = make_problem(beam, LOADS + follow_push((0.1, 0.1), 0.6), FINE)
    zeros = np.zeros(problem.weights.shape[-1])
    plain, zero = follow(problem), follow(replace(problem, stretch=zeros, shear=zeros))
    np.testing.assert_array_equal(plain.q, zero.q)
    np.testing.assert_array_equal(plain.xy(S), zero.xy(S))


@pytest.mark.parametrize("follower", [Loads(), follow_push((0.2, 0.3), 0.7)], ids=["dead", "follower"])
def test_tangent_is_the_gradients_derivative_and_symmetric_for_dead_loads(follower: Loads) -> None:
    problem = make_problem(replace(THICK, thickness=0.04), LOADS + follower, Resolution(8, 0.5))
    q = np.random.default_rng(1).normal(size=(1, problem.weights.shape[-1]))
    _, matrix = balance(problem, q)
    h = 1e-5
    slope = np.stack([(gradient(problem, q + h * e) - gradient(problem, q - h * e))[0] for e in np.eye(q.size)], axis=1)
    np.testing.assert_allclose(matrix[0], slope / (2.0 * h), atol=1e-8 * np.max(np.abs(matrix)))
    if not follower.follower.shape[1]:
        np.testing.assert_allclose(matrix[0], matrix[0].T, atol=1e-15)
        energy = [
            (potential(problem, q + h * e) - potential(problem, q - h * e))[0] / (2.0 * h) for e in np.eye(q.size)
        ]
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
@settings(max_examples=25)
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
    stretch, shear = solved.strains()
    u = solved.xy_by_s(solved.problem.grid.nodes)[0] / 0.15
    cos, sin = np.cos(solved.alpha[0]), np.sin(solved.alpha[0])
    np.testing.assert_allclose(u[:, 0] * cos + u[:, 1] * sin, 1.0 + stretch[0], atol=1e-12)
    np.testing.assert_allclose(u[:, 1] * cos - u[:, 0] * sin, shear[0], atol=1e-12)


def test_refine_and_follow_agree_and_frames_do_not_disturb_each_other() -> None:
    force = np.random.default_rng(2).normal(size=(30, 2)) * [0.2, 0.5]
    solved = follow(make_problem(THICK, push(force, 0.9), FINE))
    again = refine(solved.problem, solved.q + 0.02)
    np.testing.assert_allclose(again.q, solved.q, atol=1e-9)
    alone = follow(make_problem(THICK, push(force[7], 0.9), FINE))
    np.testing.assert_allclose(solved.q[7], alone.q[0], atol=1e-11)


def test_places_of_their_own_in_every_frame() -> None:
    """Quadrature of each frame's own panels gives the same mean of k, and the same shapes."""
    force, at = np.tile([0.1, 0.5], (3, 1)), np.array([0.5, 0.75, 1.0])
    together = equilibrium(THICK, push(force, at), resolution=FINE)
    for i, place in enumerate(at):
        alone = equilibrium(THICK, push(force[i], float(place)), resolution=FINE)
        np.testing.assert_allclose(together.xy(S)[i], alone.xy(S)[0], atol=1e-8)


def test_beams_of_one_batch_have_their_own_thickness() -> None:
    beams = [replace(THICK, thickness=h) for h in (0.01, 0.03)]
    together = follow(make_problems(beams, push((0.1, 0.5)), FINE))
    part = together.problem.take(np.array([1]))
    assert part.section is not None
    assert np.shape(part.section.thickness) == (1, 1)
    for i, beam in enumerate(beams):
        np.testing.assert_allclose(
            together.xy(S)[i], equilibrium(beam, push((0.1, 0.5)), resolution=FINE).xy(S)[0], atol=1e-13
        )
    with pytest.raises(MechanicsError, match="solve them apart"):
        make_problems([replace(THICK, thickness=None), THICK], push((0.1, 0.5)))
    with pytest.raises(MechanicsError, match="Poisson's ratio"):
        make_problems([replace(THICK, poisson=0.3), THICK], push((0.1, 0.5)))


def test_a_column_falls_to_an_equilibrium_of_lower_energy() -> None:
    problem = given_compliance(UNIT, push((-4.0, 0.0)), 0.01, 0.05)
    up, down, straight = follow(problem, fall="left"), follow(problem, fall="right"), follow(problem)
    assert up.fell[0]
    assert up.stable[0]
    assert not straight.stable[0]
    assert potential(problem, up.q)[0] < potential(problem, straight.q)[0]
    np.testing.assert_allclose(gradient(problem, up.q), 0.0, atol=1e-12)
    np.testing.assert_allclose(down.q, -up.q, atol=1e-9)


def test_the_branch_is_followed_by_its_slope_and_curvature_with_the_load() -> None:
    """The predictor knows that strains make the balance quadratic in the load: thick and thin beams cost the same."""
    load = push([(0.0, 0.4), (0.1, 0.6), (-0.1, 0.5)])
    thick = follow(make_problem(replace(THICK, thickness=0.03), load, FINE))
    thin = follow(make_problem(replace(THICK, thickness=None), load, FINE))
    assert thick.iterations <= thin.iterations


def test_a_beam_with_a_thickness_as_users_meet_it() -> None:
    """The paper's silicone: 12 x 30 mm, E 0.7 MPa, L 150 mm: EA 252 N, kGA 70 N."""
    k = 0.7e6 * 0.03 * 0.012**3 / 12.0 / 0.15
    beam = Beam(0.15, Uniform(k), thickness=0.012, poisson=0.5)
    tip, without = (
        beam.equilibrium((0.0, 0.005)).xy(1.0),
        replace(beam, thickness=None).equilibrium((0.0, 0.005)).xy(1.0),
    )
    assert tip[1] - without[1] == pytest.approx(0.005 * 0.15 / 70.0, rel=1e-2)
    assert beam.section is not None
    stretch, shear = beam.section.compliance(np.array([k]), np.ones(1), np.asarray(0.15))
    assert 1.0 / stretch[0] == pytest.approx(0.7e6 * 0.03 * 0.012, rel=1e-12)
    assert 1.0 / shear[0] == pytest.approx(70.0, rel=1e-12)
    assert Beam.from_dict(beam.as_dict()) == beam
    assert "thickness_m" not in replace(beam, thickness=None).as_dict()


@pytest.mark.parametrize(
    ("thickness", "poisson", "varies", "message"),
    [
        (-1e-3, 0.48, "width", "thickness must be positive"),
        (1e-3, 0.6, "width", "Poisson"),
        (1e-3, 0.48, "length", "'thickness' or 'width'"),
    ],
)
def test_what_no_section_has_is_refused(thickness: float, poisson: float, varies: str, message: str) -> None:
    with pytest.raises(MechanicsError, match=message):
        RectangularSection(thickness, poisson, varies)  # type: ignore[arg-type]


def test_compliance_from_two_sources_or_below_zero_is_refused() -> None:
    problem = make_problem(THICK, push((0.0, 0.1)))
    with pytest.raises(MechanicsError, match="not both"):
        follow(replace(problem, stretch=np.ones(16)))
    with pytest.raises(MechanicsError, match="0 or more"):
        follow(replace(problem, section=None, stretch=-np.ones(16)))


def test_thickness_of_steps_keeps_the_panels() -> None:
    beam = Beam(0.15, Steps((0.0, 0.37, 1.0), (0.03, 0.015)), thickness=0.02)
    found: Equilibrium = equilibrium(beam, push((0.05, 0.3)) + twist(0.002, 0.5))
    assert found.resolved[0]
    expected = shoot(beam, (PointForce(1.0, (0.05, 0.3)), PointForce(0.37, (0.0, 0.0))), (0.0, 0.0), TIP, 0.03)
    plain = equilibrium(beam, push((0.05, 0.3)))
    np.testing.assert_allclose(plain.xy(TIP)[0], expected[:, :2], atol=1e-8 * 0.15)
