"""Few unknowns on many nodes: the same equilibria as with all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium, follow
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import LogSpline, Powers, Steps, Uniform
from onebend.records import PointMass

S = np.linspace(0.0, 1.0, 9)
RNG = np.random.default_rng(3)


def spline(count: int, spread: float) -> LogSpline:
    knots = (0.0, 0.0, 0.0, *np.linspace(0.0, 1.0, count - 2).tolist(), 1.0, 1.0, 1.0)
    return LogSpline(knots, tuple((np.log(0.02) + spread * RNG.standard_normal(count)).tolist()))


BEAM = Beam(0.15, spline(14, 0.3), Powers((0.3, -0.5)), 0.1, Uniform(0.1), masses=(PointMass(0.4, 0.004),))
FORCES = np.stack([0.4 * np.cos(np.linspace(0.0, 3.0, 6)), 0.5 * np.sin(np.linspace(0.0, 3.0, 6))], axis=-1)
CASES = {
    "forces": (BEAM, push(FORCES)),
    "weight, moment and a force within": (BEAM, push((0.1, 0.3), 0.7) + weight((1.0, -9.7)) + twist(0.01, 0.55)),
    "stretch and shear": (replace(BEAM, thickness=0.012), push(FORCES)),
    "twelve steps": (
        Beam(0.15, Steps(tuple(np.linspace(0.0, 1.0, 13)), tuple(0.02 * np.exp(0.3 * RNG.standard_normal(12))))),
        push(FORCES),
    ),
    "45 knots": (Beam(0.15, spline(47, 0.3)), push((0.1, 0.3))),
}


@pytest.mark.parametrize("name", list(CASES))
def test_same_as_with_all_unknowns(name: str) -> None:
    beam, loads = CASES[name]
    few = equilibrium(beam, loads)
    basis = next(one.basis for one in beam.memory.beams.values() if one.grid is few.problem.grid)
    assert basis is not None
    assert 2 * basis.modes.shape[1] <= few.q.shape[1]
    every = follow(few.problem)
    assert np.all(few.converged)
    assert np.all(few.stable)
    np.testing.assert_allclose(few.angle(S), every.angle(S), atol=1e-11)
    np.testing.assert_allclose(few.xy(S), every.xy(S), atol=1e-12 * beam.length)


def test_panels_between_loads_are_refined_where_knots_lie_in_them() -> None:
    """Loads and a mass make panels of less than half the beam: to halve 1 would change nothing."""
    beam, loads = CASES["weight, moment and a force within"]
    exact = equilibrium(beam, loads, resolution=Resolution(20, 1.0, at_knots=True))
    np.testing.assert_allclose(equilibrium(beam, loads).xy(S), exact.xy(S), atol=1e-9 * beam.length)
    bare = Beam(0.15, Powers((0.02, -0.0175)), mass_per_length=Uniform(0.1))  # no knots: panels are halved
    bare_exact = equilibrium(bare, loads, resolution=Resolution(16, 1.0 / 16.0))
    np.testing.assert_allclose(equilibrium(bare, loads).xy(S), bare_exact.xy(S), atol=1e-9 * bare.length)


def test_what_buckles_on_the_way_is_followed_with_all_unknowns() -> None:
    """A straight column under a thrust that it does not carry, beside forces that it does."""
    column = Beam(0.15, Steps(tuple(np.linspace(0.0, 1.0, 9)), (0.02, 0.03) * 4))
    loads: Loads = push(np.array([[0.0, 0.2], [-2.0, 0.0], [0.1, 0.3]]))
    few = equilibrium(column, loads)
    every = follow(few.problem)
    assert few.stable.tolist() == every.stable.tolist() == [True, False, True]
    np.testing.assert_allclose(few.buckled_at, every.buckled_at, rtol=1e-6)
    np.testing.assert_allclose(few.xy(S), every.xy(S), atol=1e-12)
