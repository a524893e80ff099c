"""Equilibrium against the elastica, published finite-element cases, and the identities it must obey."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.continuation import ContinuationSettings, _predicted, _State, equilibrium, follow, refine
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.sensitivity import of_force, respond
from onebend.beam.statics import gradient, node_angles, tangent
from onebend.beam.stiffness import Gaussians, Profile, Steps, Table, Uniform
from onebend.errors import MechanicsError
from tests.beam.exact import elastica_tip

UNIT = Beam(1.0, Uniform(1.0))
SOFT = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)))
S = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
forces = st.tuples(st.floats(-0.4, 0.4), st.floats(0.05, 0.5))


@pytest.mark.parametrize("load", [0.2, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0])
@pytest.mark.parametrize("direction_deg", [10, 45, 90, 135, 170, 179, -60, -90, -150])
def test_elastica(load: float, direction_deg: float) -> None:
    direction = np.deg2rad(direction_deg)
    x, y, angle = elastica_tip(load, direction)
    shape = UNIT.equilibrium((load * np.cos(direction), load * np.sin(direction)))
    np.testing.assert_allclose(shape.xy(1.0), (x, y), atol=1e-10)
    assert shape.angle(1.0) == pytest.approx(angle, abs=1e-10)
    assert shape.stable


def square(first_mm: float, last_mm: float) -> Profile:
    """E I / L of a square steel section, L = 1 m, whose side runs linearly from first to last."""
    s = np.linspace(0.0, 1.0, 1001)
    side = 1e-3 * (first_mm + (last_mm - first_mm) * s)
    return Table(tuple(s.tolist()), tuple((210e9 * side**4 / 12.0).tolist()))


@pytest.mark.parametrize(
    ("stiffness", "rest", "force", "tip"),
    [
        (square(10, 10), 0.0, (-200.0, 200.0), (0.840615, 0.488158)),
        (square(10, 5), 0.0, (-100.0, 100.0), (0.821444, 0.468253)),
        (square(10, 10), np.pi / 4, (-200.0, 200.0), (0.574706, 0.701739)),
        (square(10, 5), np.pi / 4, (-100.0, 100.0), (0.576773, 0.659438)),
    ],
)
def test_published_abaqus_cases(
    stiffness: Profile, rest: float, force: tuple[float, float], tip: tuple[float, float]
) -> None:
    """Source: the tests of the VirtualBow project (their beams stretch and shear; ours does not)."""
    shape = Beam(1.0, stiffness, rest_curvature=Uniform(rest)).equilibrium(force)
    assert np.linalg.norm(shape.xy(1.0) - tip) < 1e-4


def test_roll_up_into_a_circle() -> None:
    solved = equilibrium(UNIT, twist(2.0 * np.pi))
    np.testing.assert_allclose(solved.xy(np.array([1.0]))[0], [[0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(solved.xy(np.array([0.5]))[0], [[0.0, 1.0 / np.pi]], atol=1e-12)


@pytest.mark.parametrize(
    ("q", "tip"),
    [
        (1.0, (0.9912, 0.1235)),
        (5.0, (0.8467, 0.4959)),
        (9.0, (0.6890, 0.6731)),
        (15.0, (0.5296, 0.7860)),
        (25.0, (0.3862, 0.8559)),
    ],
)
def test_uniform_dead_load(q: float, tip: tuple[float, float]) -> None:
    beam = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0))
    solved = equilibrium(beam, weight((0.0, q)))
    np.testing.assert_allclose(solved.xy(np.array([1.0]))[0, 0], tip, atol=6e-5)


def test_error_falls_with_the_fourth_order_for_two_nodes_a_panel() -> None:
    reference = equilibrium(UNIT, push((0.5, 3.0))).xy(np.array([1.0]))[0, 0]
    panels = np.array([8, 16, 32, 64])
    errors = []
    for count in panels:
        solved = follow(make_problem(UNIT, push((0.5, 3.0)), Resolution(order=2, widest=1.0 / count)))
        errors.append(np.linalg.norm(solved.xy(np.array([1.0]))[0, 0] - reference))
    slope = np.polyfit(np.log(panels), np.log(errors), 1)[0]
    assert slope == pytest.approx(-4.0, abs=0.1)


def test_error_falls_spectrally_with_the_nodes_of_one_panel() -> None:
    force = push((0.02, 0.2))
    reference = equilibrium(SOFT, force, resolution=Resolution(32)).xy(S)
    errors = [
        np.max(np.abs(follow(make_problem(SOFT, force, Resolution(order=n))).xy(S) - reference))
        for n in (4, 8, 12, 16, 20)
    ]
    assert np.all(np.diff(np.log(errors)) < -1.5)


@given(force=forces, at=st.floats(0.2, 1.0))
def test_moment_is_lever_arm_times_force(force: tuple[float, float], at: float) -> None:
    """`k (q - q0) = (r(s_a) - r(s)) x F` up to the push, nothing beyond (any k)."""
    solved = equilibrium(SOFT, push(force, at))
    nodes = solved.problem.grid.nodes
    arm = solved.xy(np.array([at]))[0, 0] - solved.xy(nodes)[0]
    moment = np.where(nodes < at, arm[:, 0] * force[1] - arm[:, 1] * force[0], 0.0)
    np.testing.assert_allclose(solved.moment()[0], moment, atol=1e-9)


@given(force=forces)
def test_mirror_symmetry(force: tuple[float, float]) -> None:
    up = SOFT.equilibrium(force).xy(S)
    down = SOFT.equilibrium((force[0], -force[1])).xy(S)
    np.testing.assert_allclose(down, up * [1.0, -1.0], atol=1e-12)


@given(force=forces, turn=st.floats(-3.0, 3.0))
def test_turning_the_room_turns_the_shape(force: tuple[float, float], turn: float) -> None:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = Beam(SOFT.length, SOFT.stiffness, clamp_angle=turn)
    np.testing.assert_allclose(
        turned.equilibrium(rotation @ force).xy(S), SOFT.equilibrium(force).xy(S) @ rotation.T, atol=1e-12
    )


@given(force=forces, scale=st.floats(0.1, 20.0), factor=st.floats(0.1, 50.0))
def test_scaling_laws(force: tuple[float, float], scale: float, factor: float) -> None:
    """x L the length and x c the stiffness need x c / L the force for the same shape."""
    assert isinstance(SOFT.stiffness, Gaussians)
    heights = tuple(factor * h for h in SOFT.stiffness.coefficients)
    other = Beam(scale * SOFT.length, Gaussians(SOFT.stiffness.centres, SOFT.stiffness.width, heights))
    np.testing.assert_allclose(
        other.equilibrium(np.multiply(force, factor / scale)).xy(S) / scale, SOFT.equilibrium(force).xy(S), atol=1e-12
    )


@given(a=st.floats(0.2, 0.9), b=st.floats(0.3, 1.0))
def test_maxwell_betti_reciprocity_of_small_loads(a: float, b: float) -> None:
    tiny = 1e-6
    at_b = SOFT.equilibrium((0.0, tiny), a).xy(b)[1]
    at_a = SOFT.equilibrium((0.0, tiny), b).xy(a)[1]
    assert at_b == pytest.approx(at_a, rel=1e-6)


def test_small_loads_superpose() -> None:
    tiny = 1e-7
    one, two = push((0.0, tiny), 0.5), push((0.0, -2.0 * tiny), 1.0)
    together = equilibrium(SOFT, one + two).xy(S)[..., 1]
    apart = equilibrium(SOFT, one).xy(S)[..., 1] + equilibrium(SOFT, two).xy(S)[..., 1]
    np.testing.assert_allclose(together, apart, rtol=1e-6)


def test_elastic_energy_is_the_work_of_slow_loading() -> None:
    factors = 0.5 * (np.polynomial.legendre.leggauss(24)[0] + 1.0)
    weights = 0.5 * np.polynomial.legendre.leggauss(24)[1]
    force = np.array([-0.1, 0.3])
    solved = equilibrium(SOFT, push(force[None] * factors[:, None]), resolution=Resolution(24))
    tip = respond(solved, of_force(solved.problem, np.array(1.0))).xy(np.array([1.0]))[:, 0]  # dr/dF along the path
    work = np.sum(weights * factors * np.einsum("c,tcd,d->t", force, tip, force))
    end = equilibrium(SOFT, push(force))
    energy = 0.5 * np.sum(end.problem.weights * end.problem.k * end.q[0] ** 2)
    assert work == pytest.approx(energy, rel=1e-9)


def test_tangent_is_the_derivative_of_the_gradient() -> None:
    problem = make_problem(SOFT, push((0.1, 0.3), 0.7) + twist(0.002, 0.4))
    q = 0.5 + np.sin(np.arange(problem.to_nodes.shape[-1]))[None]
    exact = tangent(problem, q)[0]
    for i in range(q.shape[1]):
        step = 1e-4 * np.eye(q.shape[1])[i]
        difference = (gradient(problem, q + step) - gradient(problem, q - step))[0] / 2e-4
        np.testing.assert_allclose(exact[:, i], difference, atol=1e-10)


def test_force_response_matches_differences() -> None:
    force, h = np.array([0.05, 0.2]), 1e-5
    solved = equilibrium(SOFT, push(force, 0.8))
    exact = respond(solved, of_force(solved.problem, np.array(0.8))).xy(S)[0]
    for c in range(2):
        step = h * np.eye(2)[c]
        difference = (SOFT.equilibrium(force + step, 0.8).xy(S) - SOFT.equilibrium(force - step, 0.8).xy(S)) / (2 * h)
        np.testing.assert_allclose(exact[:, :, c], difference, atol=1e-8)


def test_euler_load_is_found_and_the_straight_beam_called_unstable_beyond_it() -> None:
    below = equilibrium(UNIT, push((-2.46, 0.0)))
    beyond = equilibrium(UNIT, push((-3.0, 0.0)))
    assert below.stable[0]
    assert np.isnan(below.buckled_at[0])
    assert not beyond.stable[0]
    assert beyond.buckled_at[0] * 3.0 == pytest.approx(np.pi**2 / 4.0, abs=2e-3)


def test_every_frame_of_a_hard_batch_lands_on_the_stable_branch() -> None:
    rng = np.random.default_rng(7)
    force = 6.0 * rng.normal(size=(1000, 2))
    solved = equilibrium(UNIT, push(force), resolution=Resolution(16, 0.5))
    assert np.all(solved.converged)
    assert np.all(solved.stable)
    # The branch that grows from rest bends to the side of the force: same sign of tip angle and lateral force.
    assert np.all(np.sign(solved.angle(np.array([1.0]))[:, 0]) == np.sign(force[:, 1]))


def test_push_at_a_place_that_changes_from_frame_to_frame() -> None:
    force = np.array([[0.0, 0.1], [0.02, 0.2], [0.0, 0.3]])
    at = np.array([1.0, 0.8, 0.55])
    batch = SOFT.equilibrium(force, at).xy(S)
    for i in range(3):
        np.testing.assert_allclose(batch[i], SOFT.equilibrium(force[i], at[i]).xy(S), atol=1e-8)


def test_beyond_the_last_force_the_beam_keeps_its_rest_curvature() -> None:
    beam = Beam(0.15, SOFT.stiffness, rest_curvature=Uniform(0.4))
    solved = equilibrium(beam, push((0.0, 0.2), 0.6))
    beyond = solved.problem.grid.nodes > 0.6
    np.testing.assert_allclose(solved.q[0, beyond], 0.4, atol=1e-12)


def test_stiffness_with_a_step_is_exact_with_an_edge_at_the_step() -> None:
    """Two uniform pieces under a tip moment: two circular arcs."""
    beam = Beam(1.0, Steps((0.0, 0.37, 1.0), (2.0, 0.5)))
    shape = equilibrium(beam, twist(0.6))
    assert shape.angle(np.array([1.0]))[0, 0] == pytest.approx(0.6 * (0.37 / 2.0 + 0.63 / 0.5), abs=1e-12)


def test_refine_comes_back_from_a_disturbed_start() -> None:
    solved = equilibrium(SOFT, push((0.1, 0.3)))
    again = refine(solved.problem, solved.q + 0.05)
    assert again.converged[0]
    np.testing.assert_allclose(again.q, solved.q, atol=1e-9)


def test_refine_does_not_stay_on_an_unstable_branch() -> None:
    problem = make_problem(UNIT, push((-4.0, 0.05)), Resolution(16, 0.5))
    straight = np.zeros((1, problem.to_nodes.shape[-1]))
    solved = refine(problem, straight)
    assert solved.stable[0]
    assert node_angles(problem, solved.q)[0, -1] > 1.0


def test_batch_is_the_sum_of_its_frames() -> None:
    loads = push(np.array([[0.0, 0.1], [-0.1, 0.3]])) + weight((0.0, -9.81))
    beam = Beam(0.15, SOFT.stiffness, mass_per_length=Uniform(0.5))
    both = equilibrium(beam, loads).xy(S)
    for i in range(2):
        np.testing.assert_allclose(both[i], equilibrium(beam, loads.take(slice(i, i + 1))).xy(S)[0], atol=1e-10)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Beam(0.0, Uniform(1.0)), "length"),
        (lambda: Beam(1.0, Steps((0.0, 0.5, 1.0), (1.0, -0.1))).equilibrium((0.0, 1.0)), "not positive.*at s = 0.5"),
        (lambda: push((0.0, 1.0), 1.2), r"s in \[0, 1\]"),
        (lambda: push((0.0, np.nan)), "finite"),
        (lambda: push((0.0, 1.0, 0.0)), "two components"),
        (lambda: push(np.ones((3, 2))) + push(np.ones((2, 2))), "do not fit"),
    ],
)
def test_what_is_no_beam_or_load_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        make()


def test_no_load_leaves_the_rest_shape() -> None:
    nothing = Loads()
    solved = equilibrium(Beam(1.0, Uniform(1.0), rest_curvature=Uniform(1.0)), nothing)
    np.testing.assert_allclose(solved.angle(S)[0], S, atol=1e-14)


@pytest.mark.parametrize(
    "beam",
    [
        Beam(1.0, Steps((0.0, 0.4, 0.42, 1.0), (1.0, 0.02, 1.0))),
        Beam(1.0, Gaussians((0.0, 0.5, 1.0), 0.2, (0.6, 0.02, 0.6))),
        Beam(1.0, Uniform(1.0), rest_curvature=Uniform(2.5)),
    ],
    ids=["soft joint", "dip", "curved"],
)
def test_strides_land_where_tiny_load_steps_lead(beam: Beam) -> None:
    """Axial compression with lateral disturbances down to 1e-6: the side of buckling must not be lost in a stride."""
    rng = np.random.default_rng(5)
    force = rng.normal(size=(60, 2)) * 1.5
    force[:30, 0] = -np.abs(force[:30, 0]) * 3.0
    force[:30, 1] *= 10.0 ** rng.uniform(-6.0, -1.0, 30)
    problem = make_problem(beam, push(force), Resolution(10, 0.3))
    tiny = ContinuationSettings(max_turn=0.04, trust=0.01, min_step=1e-11, max_steps=6000, at_once=False)
    quick, slow = follow(problem), follow(problem, settings=tiny)
    assert np.all(quick.converged)
    assert np.all(quick.stable)
    np.testing.assert_allclose(node_angles(problem, quick.q), node_angles(problem, slow.q), atol=1e-7)


def test_what_a_beam_remembers_changes_no_number() -> None:
    stiffness = Table((0.0, 0.2, 0.5, 1.0), (0.02, 0.03, 0.015, 0.02))
    met, force = Beam(0.15, stiffness), (0.1, 0.3)
    for other in ((0.0, 0.6), (-0.2, 0.9)):
        met.equilibrium(other, 0.7)
        met.equilibrium(other)
    fresh = Beam(0.15, stiffness).equilibrium(force)
    assert np.array_equal(met.equilibrium(force).xy(S), fresh.xy(S))
    exact = equilibrium(met, push(force), resolution=Resolution(16, 1.0 / 40.0)).xy(S)[0]
    assert np.max(np.abs(fresh.xy(S) - exact)) < 1e-12
    assert pickle.loads(pickle.dumps(met)) == met


def test_a_cubic_that_is_none_is_left_out_of_the_prediction() -> None:
    """Its terms are divided by the last step, which may be as short as numbers are."""
    problem = make_problem(UNIT, push((0.0, 1.0), 1.0), Resolution())
    rest = np.zeros((2, problem.stiff.shape[-1]))
    state = _State(rest, 2)
    state.slope[:], state.turn[:] = 1.0, 1.0
    state.second[1], state.third[1] = np.inf, -np.inf
    found = _predicted(problem, state, np.arange(2), np.array([0.5, 0.5]))
    np.testing.assert_array_equal(found, 0.5 * np.ones_like(rest))
