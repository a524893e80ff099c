"""Where a beam ends up that cannot stay: against the elastica beyond Euler's load, and against all equilibria.

A cantilever whose loads are all at its tip is an initial-value problem from there, with the tip's angle as its only
unknown. Scanning that angle gives all equilibria, by an integrator that knows nothing of the code under test.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from onebend.beam.continuation import Side, equilibrium, follow, let_fall
from onebend.beam.dynamics import Actions, AppliedForce, body
from onebend.beam.grid import Modes
from onebend.beam.integration import MotionState, simulate
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.statics import gradient, is_stable, potential, tangent
from onebend.beam.stiffness import Gaussians, Steps, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array

EULER = 0.25 * np.pi**2
UNIT = Beam(1.0, Uniform(1.0))
TIP = np.array([1.0])
FINE = Resolution(16, 0.25)


def buckled_tip(load: float) -> tuple[float, float, float]:
    """Tip (x, y) / L and angle of the column under an axial `load` = P L^2 / EI: K(m) = sqrt(load), Euler 1744."""
    omega = np.sqrt(load)
    m = float(brentq(lambda m: ellipk(m) - omega, 0.0, 1.0 - 1e-14, xtol=1e-17))
    return 2.0 * float(ellipe(m)) / omega - 1.0, 2.0 * np.sqrt(m) / omega, 2.0 * np.arcsin(np.sqrt(m))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("ratio", [1.001, 1.02, 1.3, 2.0, 4.0, 9.5])
def test_column_falls_to_the_elastica_on_either_side(ratio: float, side: Side) -> None:
    """9.5 times Euler's load is beyond the second and near the third load of the straight column, at 9 and 25."""
    mirror = 1.0 if side == "left" else -1.0
    x, y, angle = buckled_tip(ratio * EULER)
    shape = UNIT.equilibrium((-ratio * EULER, 0.0), fall=side)
    assert shape.stable
    assert shape.solved.fell[0]
    assert shape.solved.buckled_at[0] == pytest.approx(1.0 / ratio, abs=1e-7)
    np.testing.assert_allclose(shape.xy(1.0), (x, mirror * y), atol=1e-9)
    assert shape.angle(1.0) == pytest.approx(mirror * angle, abs=1e-9)


def test_a_hair_beyond_the_load_the_deflection_grows_with_the_root() -> None:
    """alpha_tip -> sqrt(8 (P / P_E - 1)): energies differ by less than their rounding there."""
    excess = np.array([1e-8, 1e-7, 1e-6, 1e-5])
    force = np.stack([-(1.0 + excess) * EULER, 0.0 * excess], axis=1)
    shape = UNIT.equilibrium(force, fall="left")
    np.testing.assert_allclose(shape.angle(1.0), np.sqrt(8.0 * excess), rtol=1e-2)


def test_without_it_the_straight_branch_is_kept_and_called_unstable() -> None:
    shape = UNIT.equilibrium((-2.0 * EULER, 0.0))
    assert not shape.stable
    assert not shape.solved.fell[0]
    np.testing.assert_allclose(shape.xy(1.0), (1.0, 0.0), atol=1e-12)


def test_frames_that_stand_are_left_alone() -> None:
    rng = np.random.default_rng(3)
    problem = make_problem(UNIT, push(np.vstack([2.0 * rng.normal(size=(40, 2)), [[-0.9 * EULER, 0.0]]])), FINE)
    plain, with_fall = follow(problem), follow(problem, fall="right")
    assert not np.any(with_fall.fell)
    np.testing.assert_array_equal(with_fall.q, plain.q)
    q, landed = let_fall(problem, plain.q)
    assert np.all(landed)
    np.testing.assert_allclose(q, plain.q, atol=1e-10)


def first_critical(beam: Beam, loads: Loads) -> float:
    """Share of the loads at which the straight beam's tangent, linear in them, becomes singular."""
    problem = make_problem(beam, loads, FINE)
    straight = np.zeros((1, problem.to_nodes.shape[-1]))
    unloaded = tangent(problem, straight, 0.0)[0]
    taken = unloaded - tangent(problem, straight, 1.0)[0]
    return float(1.0 / eigh(taken, unloaded, eigvals_only=True)[-1])


@settings(max_examples=12)
@given(
    dip=st.floats(0.05, 1.0),
    ratio=st.floats(1.05, 3.0),
    side=st.sampled_from(["left", "right"]),
)
def test_energy_falls_and_the_mirror_image_is_the_other_side(dip: float, ratio: float, side: Side) -> None:
    """A straight column of uneven stiffness under its own weight and a tip force along it."""
    stiffness = Gaussians((0.0, 0.5, 1.0), 0.3, (0.05, 0.05 * dip, 0.05))
    beam = Beam(0.3, stiffness, mass_per_length=Uniform(0.2))
    loads = push((-0.2, 0.0)) + weight((-9.81, 0.0))
    critical = first_critical(beam, loads)
    problem = make_problem(beam, loads, FINE).loaded(np.array([ratio * critical]))
    straight = follow(problem)
    q, landed = let_fall(problem, straight.q, side)
    other, _ = let_fall(problem, straight.q, "right" if side == "left" else "left")
    assert landed[0]
    assert not straight.stable[0]
    assert is_stable(problem, q)[0]
    assert potential(problem, q)[0] < potential(problem, straight.q)[0]
    assert np.sign(q[0, 0]) == (1.0 if side == "left" else -1.0)
    np.testing.assert_allclose(other, -q, atol=1e-8)
    np.testing.assert_allclose(gradient(problem, q), 0.0, atol=1e-12)
    followed = follow(problem, fall=side)
    assert followed.stable[0]
    np.testing.assert_allclose(followed.q, q, atol=1e-8)


def base_angle(rest: float, force: Array, tip: Array) -> Array:
    """(N,) angle at s = 0 of uniform beams (L = k = 1) whose tip is at angles `tip` (N,): zero at an equilibrium."""
    fx, fy = force

    def slopes(_: float, state: Array) -> Array:
        alpha, m = state.reshape(2, -1)
        return np.concatenate([rest + m, np.sin(alpha) * fx - np.cos(alpha) * fy])

    start = np.concatenate([tip, 0.0 * tip])
    run = solve_ivp(slopes, (1.0, 0.0), start, method="DOP853", rtol=1e-12, atol=1e-13)
    return np.asarray(run.y[: len(tip), -1])


def all_tips(rest: float, force: Array) -> Array:
    """Tip angles of all equilibria within two turns either way."""
    tips = np.linspace(-4.0 * np.pi, 4.0 * np.pi, 2001)
    ends = base_angle(rest, force, tips)
    roots = [
        brentq(lambda a: float(base_angle(rest, force, np.array([a]))[0]), tips[i], tips[i + 1], xtol=1e-13)
        for i in np.flatnonzero(ends[1:] * ends[:-1] < 0.0)
    ]
    return np.array(roots)


@pytest.mark.parametrize(
    ("rest", "force"),
    [
        (4.0, (5.49375643130341, -2.8775247551928818)),
        (5.0, (6.962931873770104, 2.080148715768616)),
    ],
)
def test_where_the_branch_ends_the_beam_snaps_to_an_equilibrium(rest: float, force: tuple[float, float]) -> None:
    beam = Beam(1.0, Uniform(1.0), rest_curvature=Uniform(rest))
    loads = push(force)
    plain = equilibrium(beam, loads, resolution=FINE)
    solved = equilibrium(beam, loads, resolution=FINE, fall="left")
    assert not plain.converged[0]
    assert plain.load_factor[0] < 1.0
    assert solved.converged[0]
    assert solved.stable[0]
    assert solved.fell[0]
    exact = all_tips(rest, np.array(force))
    away = np.abs(exact - solved.angle(TIP)[0, 0])
    assert len(exact) % 2 == 1
    assert np.min(away) < 1e-8
    assert potential(solved.problem, solved.q)[0] < potential(plain.problem, plain.q)[0]


def test_an_overdamped_beam_set_free_where_the_branch_ends_moves_to_the_same_shape() -> None:
    """The equation of motion, with damping that lets nothing swing, decides which equilibrium a snap leads to."""
    beam = Beam(1.0, Uniform(1.0), rest_curvature=Uniform(4.0), mass_per_length=Uniform(1e-3))
    force = np.array([5.49375643130341, -2.8775247551928818])
    ended = equilibrium(beam, push(force), resolution=FINE)
    solved = equilibrium(beam, push(force), resolution=FINE, fall="left")
    of = body(beam, Modes(10), damping=Uniform(1.0))
    nodes = ended.problem.grid.nodes
    weights = ended.problem.grid.weights
    phi = Modes(10).curvature(nodes)
    begin = np.linalg.solve(phi.T @ (weights[:, None] * phi), phi.T @ (weights * (ended.q[0] - 4.0)))
    run = simulate(of, MotionState(begin, np.zeros(10)), 60.0, 0.05, Actions(forces=(AppliedForce(tuple(force)),)))
    assert np.linalg.norm(ended.xy(TIP)[0, 0] - solved.xy(TIP)[0, 0]) > 0.2
    np.testing.assert_allclose(run.xy(TIP)[-1, 0], solved.xy(TIP)[0, 0], atol=1e-3)


def test_one_frame_does_not_disturb_another() -> None:
    force = np.array([[-3.0, 0.0], [0.0, 1.0], [-4.0, 1e-3], [-6.0, 0.0]])
    together = equilibrium(UNIT, push(force), resolution=FINE, fall="right")
    assert together.fell.tolist() == [True, False, False, True]
    for i, one in enumerate(force):
        alone = equilibrium(UNIT, push(one), resolution=FINE, fall="right")
        np.testing.assert_allclose(together.q[i], alone.q[0], atol=1e-9)


def test_a_jointed_column_with_panels_of_its_own_in_every_frame() -> None:
    beam = Beam(1.0, Steps((0.0, 0.45, 0.5, 1.0), (1.0, 0.1, 1.0)))
    at = np.array([0.7, 0.85, 1.0])
    force = np.tile([-8.0, 0.0], (3, 1))
    together = equilibrium(beam, push(force, at), resolution=FINE, fall="left")
    assert np.all(together.fell & together.stable)
    for i, place in enumerate(at):
        alone = beam.equilibrium(force[i], float(place), fall="left")
        np.testing.assert_allclose(together.xy(TIP)[i, 0], alone.xy(1.0), atol=1e-6)


def test_another_side_is_refused() -> None:
    with pytest.raises(MechanicsError, match=r"'left' or to its 'right'.*got 'up'"):
        UNIT.equilibrium((-3.0, 0.0), fall="up")  # type: ignore[arg-type]


def test_a_branch_that_ends_says_what_to_do() -> None:
    beam = Beam(1.0, Uniform(1.0), rest_curvature=Uniform(4.0))
    with pytest.raises(MechanicsError, match=r"snaps through.*a side to `fall` to"):
        beam.equilibrium((5.49375643130341, -2.8775247551928818))
