"""Both ends held of a beam that stretches and shears: the wrench at the end strains it too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam import clamped_ends
from onebend.beam.clamped_ends import end_pose, hold_near, stands
from onebend.beam.continuation import equilibrium
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.sensitivity import of_force, of_moment, of_stiffness, respond
from onebend.beam.stiffness import Gaussians, Uniform
from onebend.records import Array
from tests.beam.held import hold, hold_along
from tests.beam.thickness import of_section_thickness

THICK = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)), mass_per_length=Uniform(0.1), thickness=0.02)
FINE = Resolution(16, 0.25)
S = np.array([0.3, 0.62, 0.9])
END = np.ones(1)
WRENCH = np.array([[-0.05, 0.4, -0.004], [0.1, -0.3, 0.006]])  # N, N, N m


def free(beam: Beam = THICK, extra: Loads = Loads()) -> tuple[Array, Array]:
    """Poses of the end and places of a beam whose end is free, under the wrench as a load."""
    solved = equilibrium(beam, push(WRENCH[:, :2]) + twist(WRENCH[:, 2]) + extra, resolution=FINE)
    return np.concatenate([solved.xy(END)[:, 0], solved.angle(END)], axis=1), solved.xy(S)


def test_held_where_a_wrench_would_bring_it_the_holder_gives_that_wrench() -> None:
    loads = weight((1.0, -9.0)) + push((0.0, 0.1), 0.4)
    goal, places = free(extra=loads)
    held = hold(THICK, goal, loads, resolution=FINE)
    assert np.all(held.solved.stable)
    np.testing.assert_allclose(held.wrench, WRENCH, atol=1e-6)
    np.testing.assert_allclose(held.solved.xy(S), places, atol=1e-8)
    np.testing.assert_allclose(end_pose(held.solved.problem, held.solved.q), goal, atol=1e-11)
    inextensible = hold(replace(THICK, thickness=None), goal, loads, resolution=FINE)
    assert np.max(np.abs(inextensible.wrench - WRENCH)) > 1e-3


def test_clamp_holder_and_loads_cancel() -> None:
    held = hold(THICK, (0.11, 0.05, 0.3), push((0.0, 0.2), 0.4), resolution=FINE)
    at = held.solved.xy(np.array([0.4]))[0, 0]
    fx, fy, moment = held.wrench[0]
    x, y, _ = end_pose(held.solved.problem, held.solved.q)[0]
    total = held.clamp_wrench[0] + [fx, fy, x * fy - y * fx + moment] + [0.0, 0.2, 0.2 * at[0]]
    np.testing.assert_allclose(total, 0.0, atol=1e-10)


def critical(thickness: float) -> tuple[float, float]:
    """Load of a column (EI = L = 1) with both ends clamped, P (1 + P/kGA - P/EA) = EI (2 pi / L)^2, and 1/EA."""
    stretch = thickness**2 / 12.0
    delta = stretch * (2.0 * 1.48 * 6.0 / 5.0) - stretch
    return (np.sqrt(1.0 + 16.0 * np.pi**2 * delta) - 1.0) / (2.0 * delta), stretch


@pytest.mark.parametrize("share", [0.9, 0.999, 1.001, 1.2])
def test_a_straight_column_between_clamps_stands_up_to_reissners_load(share: float) -> None:
    beam = Beam(1.0, Uniform(1.0), thickness=0.1)
    load, _ = critical(0.1)
    problem = make_problem(beam, push((0.0, 0.0)), FINE)
    straight = np.zeros((1, problem.weights.shape[-1]))
    assert stands(problem, straight, np.array([[-share * load, 0.0, 0.0]]))[0] == (share < 1.0)
    assert 4.0 * np.pi**2 / load > 1.05


def test_a_little_beyond_it_the_column_bows_under_that_load() -> None:
    load, stretch = critical(0.05)
    held = hold(Beam(1.0, Uniform(1.0), thickness=0.05), (1.0 - load * stretch - 1e-4, 0.0, 0.0))
    assert held.solved.stable[0]
    assert -held.wrench[0, 0] == pytest.approx(load, rel=1e-3)
    assert held.solved.xy(np.array([0.5]))[0, 0, 1] > 1e-3


def test_led_along_a_path_it_comes_where_it_is_held() -> None:
    goal = np.array([[0.13, 0.03, 0.4], [0.12, 0.05, 0.6], [0.10, 0.06, 0.9]])
    led = hold_along(THICK, goal, resolution=FINE)
    assert not np.any(led.jumped)
    np.testing.assert_allclose(led.wrench, hold(THICK, goal, resolution=FINE).wrench, atol=1e-8)
    np.testing.assert_allclose(end_pose(led.solved.problem, led.solved.q), goal, atol=1e-11)


def test_near_a_shape_and_its_derivatives_with_the_end_held() -> None:
    """dp = R dx + W dw with 0 = R1 dx + W1 dw, against differences of beams held at the same pose."""
    goal, _ = free()
    start = hold(replace(THICK, thickness=None), goal, resolution=FINE).solved.q

    def held(log_thickness: float, log_k: float) -> Array:
        beam = replace(
            THICK,
            thickness=0.02 * float(np.exp(log_thickness)),
            stiffness=Gaussians((0.0, 0.5, 1.0), 0.4, tuple(np.exp(log_k) * np.array([0.01, 0.03, 0.02]))),
        )
        solved, _ = hold_near(make_problem(beam, push(np.zeros((2, 2))), FINE), start, goal, fall=False)
        assert np.all(solved.converged)
        return solved.xy(S)

    solved, wrench = hold_near(make_problem(THICK, push(np.zeros((2, 2))), FINE), start, goal, fall=False)
    np.testing.assert_allclose(wrench, WRENCH, atol=1e-8)
    problem = solved.problem
    change = of_section_thickness(problem) + of_stiffness(solved, problem.k[:, None])
    poses = respond(solved, change + of_force(problem, END) + of_moment(problem, END)).poses(np.append(S, 1.0))
    exact = (
        poses[:, :-1, :2, :2]
        - poses[:, :-1, :2, 2:] @ np.linalg.solve(poses[:, -1, :, 2:], poses[:, -1, :, :2])[:, None]
    )
    h = 1e-4
    expected = np.stack([held(h, 0.0) - held(-h, 0.0), held(0.0, h) - held(0.0, -h)], axis=-1) / (2.0 * h)
    np.testing.assert_allclose(exact, expected, atol=1e-7 * np.max(np.abs(expected)) + 1e-11)
    assert np.max(np.abs(expected[..., 0])) > 1e-4


def test_from_far_it_falls_to_a_shape_that_stands() -> None:
    goal, places = free()
    problem = make_problem(THICK, push(np.zeros((2, 2))), FINE)
    start = np.random.default_rng(3).normal(size=(2, problem.weights.shape[-1])) * 3.0
    solved, wrench = hold_near(problem, start, goal, fall=True)
    assert np.all(solved.converged)
    np.testing.assert_allclose(end_pose(solved.problem, solved.q), goal, atol=1e-10)
    assert np.all(stands(problem, solved.q, wrench))
    assert places.shape == solved.xy(S).shape


def test_what_cannot_strain_to_its_section_has_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the strains cannot grow to their full size on a stable branch, neither search claims an equilibrium."""
    goal, _ = free()

    def stuck(_: object, q: Array, wrench: Array, __: Array) -> tuple[Array, Array, Array]:
        return q, wrench, np.zeros(len(q), dtype=bool)

    monkeypatch.setattr(clamped_ends, "let_strain", stuck)
    assert not np.any(hold(THICK, goal, resolution=FINE).solved.converged)
    problem = make_problem(THICK, push(np.zeros((2, 2))), FINE)
    start = np.random.default_rng(3).normal(size=(2, problem.weights.shape[-1])) * 3.0
    assert not np.any(hold_near(problem, start, goal, fall=True)[0].converged)
