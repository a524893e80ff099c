"""Warm equilibria against those from rest, their derivatives, and what happens where Newton strays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, Rod, pose
from onebend.beam.sensitivity import of_force, of_moment, respond
from onebend.beam.statics import gradient, is_stable
from onebend.beam.stiffness import Gaussians, Steps, Uniform
from onebend.beam.warm import WarmBeam
from onebend.errors import MechanicsError

UNIT = Beam(1.0, Uniform(1.0))
SOFT = Beam(
    0.15,
    Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)),
    rest_curvature=Uniform(0.2),
    clamp_angle=0.3,
    mass_per_length=Uniform(0.3),
)
MARKERS = (1.0 / 3.0, 2.0 / 3.0, 1.0)
S = np.array(MARKERS)
GRAVITY = (1.0, -9.0)


def walk(seed: int, steps: int, places: int) -> np.ndarray:
    """(steps, places, 2) N: forces that wander about a push to the left of the tip."""
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(steps, places, 2)), axis=0)
    return np.asarray(0.1 * np.sin(0.05 * path) + [0.0, 0.1])


@pytest.mark.parametrize("resolution", [Resolution(12), Resolution(16), Resolution(8, 0.25)])
@pytest.mark.parametrize("places", [(1.0,), (0.6,), (0.5, 1.0)])
def test_agrees_with_the_branch_from_rest_along_a_path(places: tuple[float, ...], resolution: Resolution) -> None:
    warm = WarmBeam(SOFT, at_s=places, gravity=GRAVITY, resolution=resolution)
    routes = []
    for force in walk(1, 40, len(places)):
        found = warm.solve(force)
        loads = weight(GRAVITY)
        for one, place in zip(force, places, strict=True):
            loads = loads + push(one, place)
        cold = equilibrium(SOFT, loads, resolution=resolution)
        np.testing.assert_allclose(found.xy, cold.xy(S)[0], rtol=0.0, atol=1e-9 * SOFT.length)
        np.testing.assert_allclose(found.angle, cold.angle(S)[0], rtol=0.0, atol=1e-9)
        routes.append(found.route)
    assert routes == ["warm"] * 40


def test_default_resolution_is_good_to_1e_7_of_the_length() -> None:
    warm = WarmBeam(SOFT, gravity=GRAVITY)
    for force in 1.5 * walk(2, 30, 1)[:, 0]:
        exact = equilibrium(SOFT, weight(GRAVITY) + push(force)).xy(S)[0]
        np.testing.assert_allclose(warm.solve(force).xy, exact, rtol=0.0, atol=1e-7 * SOFT.length)


@pytest.mark.parametrize(("size", "resolved"), [(1.0, True), (10.0, True), (100.0, False)])
def test_says_whether_the_nodes_carry_the_shape(size: float, resolved: bool) -> None:
    warm = WarmBeam(UNIT)
    force = size * np.array([-0.3, 1.0])
    error = np.max(np.abs(warm.solve(force).xy - equilibrium(UNIT, push(force)).xy(S)[0]))
    assert warm.resolved() == resolved
    assert (error < 1e-7) == resolved


def test_moment_and_jumps_of_stiffness_are_carried() -> None:
    beam = Beam(1.0, Steps((0.0, 0.37, 1.0), (2.0, 0.5)))
    warm = WarmBeam(beam, moment_at=0.8)
    for moment in np.linspace(0.0, 0.6, 20):
        found = warm.solve((0.0, 0.1), moment)
    cold = equilibrium(beam, push((0.0, 0.1)) + twist(0.6, 0.8))
    assert found.route == "warm"
    np.testing.assert_allclose(found.xy, cold.xy(S)[0], atol=1e-9)


def test_without_load_it_stands_in_its_rest_shape() -> None:
    found = WarmBeam(Beam(1.0, Uniform(2.0), rest_curvature=Uniform(1.0))).solve((0.0, 0.0))
    np.testing.assert_allclose(found.angle, S, atol=1e-14)
    np.testing.assert_allclose(found.xy, np.stack([np.sin(S), 1.0 - np.cos(S)], axis=1), atol=1e-12)


def test_small_steps_need_few_iterations() -> None:
    """A load that moves the tip by a hundredth of the length: predictor, and two Newton iterations."""
    warm = WarmBeam(UNIT)
    assert max(warm.solve((0.0, size)).iterations for size in np.arange(0.0, 1.0, 0.03)) <= 2


@given(force=st.tuples(st.floats(-0.5, 0.5), st.floats(-2.0, 2.0)))
def test_mirror_symmetry(force: tuple[float, float]) -> None:
    up, down = WarmBeam(UNIT), WarmBeam(UNIT)
    for share in (0.5, 1.0):
        one = up.solve(share * np.array(force))
        other = down.solve(share * np.array(force) * [1.0, -1.0])
    np.testing.assert_allclose(one.xy, other.xy * [1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(one.angle, -other.angle, atol=1e-12)


def test_path_there_and_back_ends_where_it_began() -> None:
    warm = WarmBeam(SOFT)
    path = walk(3, 50, 1)
    there = [warm.solve(force).xy for force in path]
    back = [warm.solve(force).xy for force in path[::-1]]
    np.testing.assert_allclose(there, back[::-1], atol=1e-10)


def test_jump_of_load_is_found_from_rest() -> None:
    warm = WarmBeam(UNIT)
    warm.solve((0.0, 0.5))
    found = warm.solve((-3.0, -5.0))
    assert found.route == "rest"
    np.testing.assert_allclose(found.xy, equilibrium(UNIT, push((-3.0, -5.0))).xy(S)[0], atol=1e-8)
    assert warm.solve((-3.0, -5.01)).route == "warm"


def test_bent_under_compression_it_stays_on_its_side_until_that_becomes_unstable() -> None:
    """Push the tip back beyond Euler's load, then turn the side load round: it stays bent up, then goes over."""
    warm = WarmBeam(UNIT)
    for axial in np.linspace(0.0, -4.0, 100):
        warm.solve((axial, 0.2))
    heights = []
    for across in np.linspace(0.2, -2.0, 221):
        found = warm.solve((-4.0, across))
        assert found.stable
        heights.append((across, found.xy[-1, 1], found.route))
    assert all(y > 0.0 for across, y, _ in heights if across > -0.05)
    assert heights[-1][1] < 0.0
    over = next(i for i, (_, y, _) in enumerate(heights) if y < 0.0)
    assert heights[over][2] == "rest"  # it did not creep through the straight, unstable shape
    assert all(route == "warm" for _, _, route in heights[:over] + heights[over + 1 :])


def test_every_shape_on_a_path_through_compression_is_a_stable_equilibrium() -> None:
    """Twice beyond Euler's load with the side load changing sign; balance and stability judged by `statics`."""
    problem = pose(UNIT, push((0.0, 0.0)))
    warm = WarmBeam(UNIT, markers=problem.grid.nodes.tolist())
    routes = set()
    for phase in np.linspace(0.0, 2.0 * np.pi, 200):
        force = np.array([-3.0 * np.sin(phase) ** 2, 0.3 * np.cos(phase) + 0.02])
        found = warm.solve(force)
        q = np.asarray(np.linalg.solve(problem.to_nodes, found.angle)[None], dtype=float)
        loaded = pose(UNIT, push(force))
        assert np.max(np.abs(gradient(loaded, q))) < 1e-10
        assert is_stable(loaded, q)[0]
        routes.add(found.route)
    assert routes == {"warm", "rest"}


def test_straight_beam_beyond_eulers_load_is_refused_and_then_recovers() -> None:
    warm = WarmBeam(UNIT)
    warm.solve((-2.0, 0.0))
    with pytest.raises(MechanicsError, match=r"unstable: the beam buckles at 8\d\.\d%"):
        warm.solve((-3.0, 0.0))
    with pytest.raises(MechanicsError, match="no shape"):
        warm.response()
    assert not warm.resolved()
    again = warm.solve((-2.0, 0.1))
    assert again.route == "rest"
    np.testing.assert_allclose(again.xy, UNIT.equilibrium((-2.0, 0.1)).xy(S), atol=1e-9)


@pytest.mark.parametrize("force", [(0.3, 0.5), (-0.5, 1.5), (0.0, -2.0)])
def test_response_agrees_with_sensitivity(force: tuple[float, float]) -> None:
    resolution = Resolution(12)
    warm = WarmBeam(UNIT, at_s=(0.5, 1.0), moment_at=0.7, resolution=resolution)
    both = np.array([force, force])
    warm.solve(both, 0.1)
    warm.solve(1.01 * both, 0.11)
    loads = push(1.01 * both[0], 0.5) + push(1.01 * both[1]) + twist(0.11, 0.7)
    cold = equilibrium(UNIT, loads, resolution=resolution)
    places = [of_force(cold.problem, np.array(s)) for s in (0.5, 1.0)]
    exact = respond(cold, places[0] + places[1] + of_moment(cold.problem, np.array(0.7)))
    found = warm.response()
    np.testing.assert_allclose(found.xy, exact.xy(S)[0], atol=1e-6)
    np.testing.assert_allclose(found.angle, exact.angle(S)[0], atol=1e-6)


def test_response_predicts_the_next_shape_to_second_order() -> None:
    warm = WarmBeam(SOFT, gravity=GRAVITY)
    here, slope = warm.solve((0.05, 0.1)), warm.response()
    errors = []
    for step in (1e-2, 1e-3):
        warm.solve((0.05, 0.1))
        there = warm.solve((0.05 + step, 0.1 - step))
        errors.append(np.max(np.abs(there.xy - here.xy - slope.xy @ [step, -step])))
    assert errors[1] / errors[0] == pytest.approx(1e-2, rel=0.2)


def test_refused_force_leaves_the_beam_as_it_stands() -> None:
    warm = WarmBeam(UNIT)
    before = warm.solve((0.1, 0.5))
    with pytest.raises(MechanicsError, match="finite"):
        warm.solve((0.1, np.nan))
    after = warm.solve((0.1, 0.5))
    assert after.route == "warm"
    np.testing.assert_allclose(after.xy, before.xy, atol=1e-14)


def test_results_are_not_overwritten_by_the_next_solve() -> None:
    warm = WarmBeam(UNIT)
    first = warm.solve((0.0, 0.5))
    kept = first.xy.copy()
    warm.solve((0.0, 0.6))
    np.testing.assert_array_equal(first.xy, kept)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: WarmBeam(Beam(1.0, Steps((0.0, 0.5, 1.0), (1.0, -0.1)))), "not positive.*at s = 0.5"),
        (lambda: WarmBeam(UNIT, at_s=(1.2,)), r"s in \[0, 1\]"),
        (lambda: WarmBeam(UNIT, markers=(0.5, 1.2)), r"markers are at s in \[0, 1\]"),
        (lambda: WarmBeam(UNIT, moment_at=-0.5), r"s in \[0, 1\]"),
        (lambda: WarmBeam(heavy(), gravity=(-9.81, 0.0)), "unstable"),
        (lambda: WarmBeam(UNIT).solve((0.0, np.inf)), "finite"),
        (lambda: WarmBeam(UNIT).solve((0.0, 1.0, 0.0)), r"shape \(1, 2\), got \(3,\)"),
        (lambda: WarmBeam(UNIT, at_s=(0.5, 1.0)).solve((0.0, 1.0)), r"2 places"),
        (lambda: WarmBeam(UNIT).solve((0.0, 1.0), 0.1), "moment_at"),
        (lambda: WarmBeam(UNIT, moment_at=1.0).solve((0.0, 1.0), np.nan), "finite"),
    ],
)
def test_what_cannot_be_solved_is_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(MechanicsError, match=words):
        make()


def heavy() -> Rod:
    """A beam that buckles under its weight when it stands upright."""
    return Beam(1.0, Uniform(1.0), mass_per_length=Uniform(2.0))
