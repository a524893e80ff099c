"""Both ends held: against a boundary-value solver, against free equilibria, and through snaps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from onebend.beam.clamped_ends import end_jacobian, end_pose
from onebend.beam.continuation import equilibrium
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.statics import gradient, potential
from onebend.beam.stiffness import Gaussians, Steps, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array
from tests.beam.boundary import shoot
from tests.beam.held import ClampedEquilibrium, hold, hold_along, let_down

UNIT = Beam(1.0, Uniform(1.0))
SOFT = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)))
HEAVY = Beam(0.15, SOFT.stiffness, Uniform(0.5), clamp_angle=0.2, mass_per_length=Uniform(1.0))
TIP = np.array([1.0])
LEVEL = np.linspace(0.0, 1.0, 201)


@pytest.mark.parametrize(
    ("beam", "goal", "point", "gravity"),
    [
        (UNIT, (0.7, 0.2, -0.6), (0.0, 0.0), (0.0, 0.0)),
        (UNIT, (0.6, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0)),
        (UNIT, (0.3, 0.5, 2.8), (0.0, 0.0), (0.0, 0.0)),
        (SOFT, (0.10, 0.05, 0.4), (0.05, -0.2), (0.0, 0.0)),
        (HEAVY, (0.12, 0.03, -0.5), (0.0, 0.0), (2.0, -9.0)),
        (HEAVY, (0.12, 0.03, -0.5), (-0.1, 0.3), (2.0, -9.0)),
    ],
    ids=["general", "on the axis", "hook", "force", "weight", "weight and force"],
)
def test_against_an_independent_boundary_value_solution(
    beam: Beam, goal: tuple[float, ...], point: tuple[float, ...], gravity: tuple[float, ...]
) -> None:
    held = hold(beam, goal, push(point, 0.5) + weight(gravity))
    assert held.solved.stable[0]
    at_clamp = -held.clamp_wrench[0]
    near = at_clamp + 0.02 * np.max(np.abs(at_clamp)) * np.array([1.0, -1.0, beam.length])
    path = shoot(beam, np.array(goal), near, point=np.array(point), gravity=np.array(gravity), places=LEVEL)
    np.testing.assert_allclose(held.solved.xy(LEVEL)[0] / beam.length, path[:2].T / beam.length, atol=1e-9)
    np.testing.assert_allclose(held.solved.angle(LEVEL)[0], path[2], atol=1e-9)
    scale = beam.stiffness(0.5) * np.array([1.0 / beam.length, 1.0 / beam.length, 1.0])
    np.testing.assert_allclose(held.wrench[0] / scale, path[3:, -1] / scale, atol=1e-8)


@pytest.mark.parametrize("beam", [UNIT, Beam(1.0, Steps((0.0, 0.4, 1.0), (2.0, 0.5)), Uniform(0.8))])
def test_free_equilibria_come_back_with_the_wrench_that_made_them(beam: Beam) -> None:
    rng = np.random.default_rng(3)
    force, moment = 2.0 * rng.normal(size=(60, 2)), rng.normal(size=60)
    free = equilibrium(beam, push(force) + twist(moment))
    assert np.all(free.converged)
    goal = np.concatenate([free.xy(TIP)[:, 0], free.angle(TIP)], axis=1)
    held = hold(beam, goal)
    assert np.all(held.solved.stable)
    np.testing.assert_allclose(held.wrench, np.column_stack([force, moment]), atol=1e-8)
    np.testing.assert_allclose(held.solved.xy(LEVEL), free.xy(LEVEL), atol=1e-10)


@given(x=st.floats(-0.09, 0.13), y=st.floats(-0.06, 0.06), angle=st.floats(-3.0, 3.0), lateral=st.floats(-0.2, 0.2))
@settings(max_examples=15)
def test_pose_equilibrium_and_balance(x: float, y: float, angle: float, lateral: float) -> None:
    held = hold(HEAVY, (x, y, angle), push((0.0, lateral), 0.4) + weight((0.0, -9.81)))
    solved = held.solved
    assert solved.stable[0]
    np.testing.assert_allclose(end_pose(solved.problem, solved.q), [[x, y, angle]], atol=1e-12)
    balance = gradient(solved.problem, solved.q)[0] - held.wrench[0] @ end_jacobian(solved.problem, solved.q)[0]
    size = np.max(solved.problem.weights * np.abs(solved.moment()[0]))
    np.testing.assert_allclose(balance, 0.0, atol=1e-9 * size)
    # All that acts on the beam cancels: clamp, holder, force and weight; moments about the clamp.
    at, centres = solved.xy(np.array([0.4]))[0, 0], solved.xy(solved.problem.grid.nodes)[0]
    weights = 9.81 * 0.15 * solved.problem.weights
    loads = np.array([0.0, lateral - 9.81 * 0.15, at[0] * lateral - weights @ centres[:, 0]])
    fx, fy, moment = held.wrench[0]
    holder = np.array([fx, fy, x * fy - y * fx + moment])
    np.testing.assert_allclose(held.clamp_wrench[0] + holder + loads, 0.0, atol=1e-9 * np.max(np.abs(held.wrench)))


def test_a_compressed_straight_beam_bows_to_its_left_always() -> None:
    goals = np.array([[x, 0.0, 0.0] for x in (0.9999, 0.99, 0.9, 0.5, 0.1)])
    held = hold(UNIT, goals)
    assert np.all(held.solved.stable)
    assert np.all(held.solved.xy(np.array([0.5]))[:, 0, 1] > 0.0)
    np.testing.assert_allclose(held.wrench[:, 1], 0.0, atol=1e-8)
    # Both ends clamped: Euler's fourth case, N = (2 pi)^2 k / L, in the limit of no bow.
    assert -held.wrench[0, 0] == pytest.approx(4.0 * np.pi**2, rel=1e-4)
    alone = hold(UNIT, goals[3], resolution=Resolution(16, 0.5))
    np.testing.assert_allclose(alone.wrench, held.wrench[3:4], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(("rest", "lift", "side"), [(-0.5, 0.0, 0.0), (0.0, -3.0, -1.0), (0.0, 3.0, 1.0)])
def test_of_several_equilibria_the_lowest_is_taken(rest: float, lift: float, side: float) -> None:
    """A beam compressed on its axis bows to where the force in its middle pushes it."""
    beam = Beam(1.0, Uniform(1.0), rest_curvature=Uniform(rest))
    held = hold(beam, (0.8, 0.0, rest), push((0.0, lift), 0.5))
    chosen = potential(held.solved.problem, held.solved.q)[0]
    bow = held.solved.xy(np.array([0.5]))[0, 0, 1]
    assert bow * side > 0.1 or (side == 0.0 and abs(bow) > 0.1)
    for middle in (0.15, -0.15):  # a neighbour on either side, let go: no lower equilibrium is found
        nodes = held.solved.problem.grid.nodes
        bowed = 30.0 * middle * (1.0 - 6.0 * nodes + 6.0 * nodes**2)[None] * 2.0
        other = let_down(held.solved.problem, bowed, np.array([[0.8, 0.0, rest]]))
        assert other is None or potential(held.solved.problem, other[0])[0] >= chosen - 1e-9


@pytest.mark.parametrize("turns", [1, -1, 2])
def test_a_full_circle_needs_only_a_moment(turns: int) -> None:
    held = hold(UNIT, (0.0, 0.0, 2.0 * np.pi * turns))
    np.testing.assert_allclose(held.wrench, [[0.0, 0.0, 2.0 * np.pi * turns]], atol=1e-8)


def test_an_s_is_point_symmetric() -> None:
    """Shifted sideways, both ends parallel: seen from either end the same, so both ends bear the same wrench."""
    held = hold(UNIT, (0.93, 0.3, 0.0))
    np.testing.assert_allclose(held.solved.xy(np.array([0.5]))[0, 0], [0.465, 0.15], atol=1e-9)
    np.testing.assert_allclose(held.clamp_wrench[0] * [-1.0, -1.0, 1.0], held.wrench[0], atol=1e-7)


@given(x=st.floats(-0.6, 0.9), y=st.floats(-0.4, 0.4), angle=st.floats(-3.0, 3.0), turn=st.floats(-3.0, 3.0))
@settings(max_examples=8)
def test_mirror_and_turned_room(x: float, y: float, angle: float, turn: float) -> None:
    chord = np.arctan2(y, x)
    assume(abs(angle) > 0.05 and abs(np.sin(chord - 0.5 * angle)) > 0.05)  # else two equilibria have the same energy
    held = hold(UNIT, (x, y, angle))
    mirrored = hold(UNIT, (x, -y, -angle))
    np.testing.assert_allclose(mirrored.wrench, held.wrench * [1.0, -1.0, -1.0], rtol=1e-7, atol=1e-7)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = hold(Beam(1.0, UNIT.stiffness, clamp_angle=turn), (*(rotation @ [x, y]), angle + turn))
    np.testing.assert_allclose(turned.wrench[0, :2], rotation @ held.wrench[0, :2], rtol=1e-7, atol=1e-7)
    assert turned.wrench[0, 2] == pytest.approx(held.wrench[0, 2], rel=1e-7, abs=1e-7)


@pytest.mark.slow
def test_every_pose_of_a_hard_batch_is_held_stably() -> None:
    rng = np.random.default_rng(1)
    reach, direction, angle = 0.9 * np.sqrt(rng.random(100)), rng.uniform(-np.pi, np.pi, 100), rng.uniform(-4, 4, 100)
    goal = np.column_stack([reach * np.cos(direction), reach * np.sin(direction), angle])
    held = hold(UNIT, goal, resolution=Resolution(16, 0.25))
    assert np.all(held.solved.stable)
    np.testing.assert_allclose(end_pose(held.solved.problem, held.solved.q), goal, atol=1e-12)


def test_refinement_says_whether_it_was_enough() -> None:
    assert np.all(hold(UNIT, (0.7, 0.2, -0.6)).solved.resolved)
    assert not np.any(hold(UNIT, (-0.995, 0.0, np.pi)).solved.resolved)  # a hairpin at the clamp, radius below L/100


def snap_path(last: float, count: int) -> Array:
    """A bow to the left, whose far end is turned to the left until the bow snaps to the right."""
    angle = np.linspace(0.0, last, count)
    return np.column_stack([np.full(count, 0.9), np.zeros(count), angle])


def fold_of_the_bow() -> float:
    """The largest end angle of the left bow with its end at (0.9, 0): as a function of the end's moment it has a top.

    Moments at angles short of it, by shooting; the top by the polynomial through them.
    """
    angles = np.array([0.0, 0.45, 0.50, 0.53, 0.55, 0.56, 0.5639])
    path = np.column_stack([np.full(7, 0.9), np.zeros(7), angles])
    near = -hold_along(UNIT, path).clamp_wrench
    moments = [shoot(UNIT, p, 1.001 * w, places=TIP)[5, -1] for p, w in zip(path[1:], near[1:], strict=True)]
    around = np.polynomial.Polynomial.fit(moments, angles[1:], 5)
    return float(np.max(around(np.linspace(0.0, 1.5, 10001))))


@pytest.mark.slow
def test_a_bow_snaps_over_where_its_branch_folds() -> None:
    fold = fold_of_the_bow()
    assert 0.5 < fold < 0.6
    for count in (8, 31):
        path = snap_path(1.0, count)
        held = hold_along(UNIT, path)
        assert np.all(held.solved.stable)
        assert np.flatnonzero(held.jumped).tolist() == [np.searchsorted(path[:, 2], fold)]
        at = int(np.argmax(held.jumped))
        energy = potential(held.solved.problem, held.solved.q)
        assert energy[at] < 0.5 * energy[at - 1]
        middle = held.solved.xy(np.array([0.5]))[:, 0, 1]
        assert middle[at - 1] > 0.1 > -0.1 > middle[at]


@pytest.mark.slow
def test_a_snapped_bow_stays_over_on_the_way_back() -> None:
    there = snap_path(0.8, 17)
    held = hold_along(UNIT, np.concatenate([there, there[::-1]]))
    assert np.sum(held.jumped) == 1
    first, last = held.solved.xy(LEVEL)[[0, -1]]
    np.testing.assert_allclose(last, first * [1.0, -1.0], atol=1e-6)


def test_along_a_smooth_path_nothing_jumps_and_work_is_energy() -> None:
    """The holder's work, `int F dx + M d alpha` along the path, is the energy stored."""
    x, w = np.polynomial.legendre.leggauss(24)
    share = np.concatenate([[0.0], 0.5 * (x + 1.0), [1.0]])
    start, motion = np.array([0.9, 0.1, 0.2]), np.array([-0.3, 0.3, 1.2])
    held = hold_along(UNIT, start + share[:, None] * motion)
    assert not np.any(held.jumped)
    assert np.all(held.solved.stable)
    energy = potential(held.solved.problem, held.solved.q)
    assert 0.5 * w @ (held.wrench[1:-1] @ motion) == pytest.approx(energy[-1] - energy[0], rel=1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: hold(UNIT, (1.0, 0.0, 0.0)), "1 m long at rest"),
        (lambda: hold(UNIT, [(0.5, 0.0, 0.0), (0.8, 0.8, 0.0)]), "pose 1"),
        (lambda: hold(UNIT, (0.5, 0.0)), "three finite numbers"),
        (lambda: hold(UNIT, (0.5, np.nan, 0.0)), "three finite numbers"),
        (lambda: hold_along(UNIT, np.array([[0.5, 0.0, 0.0]] * 2), push(np.ones((2, 2)))), "one set of loads"),
    ],
)
def test_what_cannot_be_held_is_refused(make: Callable[[], ClampedEquilibrium], words: str) -> None:
    with pytest.raises(MechanicsError, match=words):
        make()


def test_hold_gives_one_set_of_loads_to_many_poses_and_many_loads_to_one_pose() -> None:
    many = hold(UNIT, (0.8, 0.1, 0.0), push(np.array([[0.0, 1.0], [0.0, 2.0]]), 0.5))
    assert many.wrench.shape == (2, 3)
    one = hold(UNIT, [(0.8, 0.1, 0.0)] * 2, push((0.0, 2.0), 0.5))
    np.testing.assert_allclose(one.wrench, many.wrench[[1, 1]], rtol=1e-9)


def test_letting_down_gives_up_where_there_is_nothing_to_stand_on() -> None:
    problem = make_problem(UNIT, Loads(), Resolution())
    assert let_down(problem, np.zeros((1, 16)), np.array([[2.0, 0.0, 0.0]])) is None
