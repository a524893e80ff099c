"""Every stable equilibrium of a free end: their number, their stability, and what an independent chain finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from onebend.beam.continuation import follow, stable_equilibria
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, make_problem
from onebend.beam.statics import gradient, is_convex, is_stable
from onebend.beam.stiffness import Table, Uniform
from onebend.records import Array
from tests.beam.turned_chain import Cable, Chain

G = 9.81
FINE = Resolution(order=6, widest=0.125)
CABLE = Cable(0.5, lambda s: 0.015 + 0.0 * s, 0.04, 0.02)
BEAM = Beam(0.5, Uniform(0.03), mass_per_length=Uniform(0.04))


def down(degrees: Array) -> Array:
    """(N, 2) of gravity in the frame of a base turned by these angles."""
    fall = -0.5 * np.pi - np.radians(degrees)
    return np.stack([np.cos(fall), np.sin(fall)], axis=-1)


def on_base(degrees: Array, beam: Beam = BEAM, tip: float = 0.02) -> Problem:
    return make_problem(beam, weight(G * down(degrees)) + push(tip * G * down(degrees)), FINE)


def counts(problem: Problem) -> list[int]:
    q, frame = stable_equilibria(problem)
    part = problem.take(frame)
    assert np.all(is_stable(part, q))
    assert np.max(np.abs(gradient(part, q)), initial=0.0) < 1e-10
    return [int(np.sum(frame == i)) for i in range(problem.size)]


def test_a_column_has_one_stable_shape_below_eulers_load_and_two_above() -> None:
    euler = 0.25 * np.pi**2  # k / L, of a clamped and a free end
    loads = push(-euler * np.array([[0.2, 0.0], [0.99, 0.0], [1.01, 0.0], [3.0, 0.0]]))
    assert counts(make_problem(Beam(1.0, Uniform(1.0)), loads, FINE)) == [1, 1, 2, 2]
    q, frame = stable_equilibria(make_problem(Beam(1.0, Uniform(1.0)), loads, FINE))
    left, right = q[frame == 3]
    np.testing.assert_allclose(left, -right, atol=1e-9)


def test_the_number_changes_where_an_independent_chain_falls() -> None:
    """The chain, turned upwards, falls from its branch between two angles; turned back, at the mirror image."""
    chain, angles = Chain(CABLE, 400), np.arange(0.0, 121.0, 1.0)
    tip = chain.turned(angles.tolist())[:, -1] - np.radians(angles)
    fold = int(np.argmax(np.abs(np.diff(tip))))
    assert abs(tip[fold + 1] - tip[fold]) > 1.0
    before, after = angles[fold], angles[fold + 1]
    assert counts(on_base(np.array([before, after, 180 - before, 180 - after, 90.0, 20.0]))) == [2, 1, 2, 1, 2, 1]


def test_they_are_those_of_an_independent_integration_from_the_tip() -> None:
    """Runge-Kutta instead of Gauss's method, and Jacobi's condition (no conjugate point) instead of Cholesky."""
    degrees = np.array([75.0])
    fall, stiff = down(degrees)[0], 0.03

    def rates(s: float, state: Array) -> Array:
        alpha, moment, turn, more = state.reshape(4, -1)
        pull = 0.5 * G * (0.04 * 0.5 * (1.0 - s) + 0.02)
        across = pull * (fall[1] * np.cos(alpha) - fall[0] * np.sin(alpha))
        along = pull * (fall[0] * np.cos(alpha) + fall[1] * np.sin(alpha))
        return np.concatenate([moment / stiff, -across, more / stiff, along * turn])

    ends = np.linspace(-np.pi, np.pi, 2001)
    start = np.concatenate([ends, 0 * ends, np.ones_like(ends), 0 * ends])
    marched = solve_ivp(rates, (1.0, 0.0), start, rtol=1e-9, atol=1e-10, t_eval=np.linspace(1.0, 0.0, 41))
    base, turn = marched.y.reshape(4, len(ends), -1)[[0, 2]]
    level = np.floor(base[:, -1] / (2 * np.pi))
    rises = (level[1:] > level[:-1]) & np.all(turn[1:] > 0.0, axis=1)
    q, _ = stable_equilibria(on_base(degrees))
    grid = on_base(degrees).grid
    tips = np.sort(np.mod(q @ grid.weights + np.pi, 2 * np.pi) - np.pi)
    np.testing.assert_allclose(tips, np.sort(ends[1:][rises]), atol=4e-3)  # the spacing of the samples


@pytest.mark.parametrize("more", ["moment", "bent at rest", "thick", "two places"])
def test_the_one_that_grows_from_rest_is_among_them(more: str) -> None:
    degrees, tip = np.array([-90.0, 0.0, 40.0, 150.0]), np.ones(4)
    beam = Beam(0.5, Table((0.0, 0.5, 1.0), (0.04, 0.02, 0.03)), mass_per_length=Uniform(0.04))
    loads: Loads = weight(G * down(degrees))
    if more == "moment":
        loads = loads + twist(0.01 * tip, 0.7)
    elif more == "bent at rest":
        beam = replace(beam, rest_curvature=Uniform(0.8))
    elif more == "thick":
        beam = replace(beam, thickness=0.05)
    else:
        loads = loads + push(0.03 * G * down(degrees), np.array([0.3, 0.5, 0.9, 1.0]))
    problem = make_problem(beam, loads, FINE)
    grown, (q, frame) = follow(problem), stable_equilibria(problem)
    assert grown.converged.all()
    for i in range(4):
        assert np.min(np.max(np.abs(q[frame == i] - grown.q[i]), axis=1)) < 1e-7


def test_a_turned_bench_is_the_same_bench() -> None:
    problem = on_base(np.array([80.0, 100.0]))
    turn = 0.7
    cos, sin = np.cos(turn), np.sin(turn)
    force = problem.dead_force @ np.array([[cos, sin], [-sin, cos]])
    turned = replace(problem, dead_force=force, alpha0=problem.alpha0 + turn)
    np.testing.assert_allclose(stable_equilibria(problem)[0], stable_equilibria(turned)[0], atol=1e-9)


def test_where_the_energy_is_convex_there_is_one() -> None:
    """The bound holds up to two of the 2.47 k / L that buckle a column, whichever way the force points."""
    beam, ways = Beam(1.0, Uniform(1.0)), np.radians(np.arange(0.0, 360.0, 30.0))
    unit = np.stack([np.cos(ways), np.sin(ways)], axis=-1)
    below, above = (make_problem(beam, push(size * unit), FINE) for size in (1.99, 2.2))
    assert is_convex(below).all()
    assert not is_convex(above).any()
    assert counts(below) == [1] * len(ways)
    assert stable_equilibria(below.take(np.zeros(len(ways), dtype=bool)))[0].shape == (0, 48)
    thick = make_problem(replace(beam, thickness=0.1), push(unit), FINE)
    assert not is_convex(thick).any()
