"""Forces that turn with the beam: against initial-value problems (the tip's wrench is known in the tip's frame)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import follow_push, push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Gaussians, Uniform
from onebend.records import Array

UNIT = Beam(1.0, Uniform(1.0))
UNEVEN = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)), rest_curvature=Uniform(0.3))
LEVEL = np.linspace(0.0, 1.0, 21)


def from_the_tip(beam: Beam, force: Array, places: Array) -> Array:
    """(S, 3) x, y, alpha seen from the tip's frame and moved to the clamp's: integrated backwards, nothing to solve."""

    def slopes(s: float, state: Array) -> Array:
        _, _, alpha, m = state
        cos, sin = np.cos(alpha), np.sin(alpha)
        bend = float(beam.rest_curvature(s)) + m / float(beam.stiffness(s))
        return beam.length * np.array([cos, sin, bend / beam.length, -(cos * force[1] - sin * force[0])])

    back = solve_ivp(slopes, (1.0, 0.0), np.zeros(4), method="DOP853", t_eval=places[::-1], rtol=1e-13, atol=1e-15).y[
        :3, ::-1
    ]
    turn = back[2, 0]
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.column_stack([(rotation @ (back[:2] - back[:2, :1])).T, back[2] - turn])


@pytest.mark.parametrize(
    ("beam", "force"),
    [
        (UNIT, (0.0, 3.0)),
        (UNIT, (-4.0, 6.0)),
        (UNIT, (1.0, -9.0)),
        (UNEVEN, (-0.3, 0.6)),
    ],
)
def test_follower_at_the_tip(beam: Beam, force: tuple[float, float]) -> None:
    solved = equilibrium(beam, follow_push(force))
    assert solved.converged[0]
    expected = from_the_tip(beam, np.array(force), LEVEL)
    np.testing.assert_allclose(solved.xy(LEVEL)[0] / beam.length, expected[:, :2] / beam.length, atol=1e-10)
    np.testing.assert_allclose(solved.angle(LEVEL)[0], expected[:, 2], atol=1e-10)


@pytest.mark.parametrize("load", [1.0, 2.4, 15.0, 40.0])
def test_becks_column_does_not_diverge(load: float) -> None:
    """Pushed along its own tip a column stays straight at any load: no equilibrium beside it (flutter is dynamics)."""
    solved = equilibrium(UNIT, follow_push((-load, 0.0)))
    assert solved.converged[0]
    assert solved.stable[0]
    assert np.isnan(solved.buckled_at[0])
    np.testing.assert_allclose(solved.q, 0.0, atol=1e-14)


def test_a_dead_force_along_the_same_line_does_buckle() -> None:
    assert not equilibrium(UNIT, push((-2.6, 0.0))).stable[0]


def test_mirror_symmetry_of_followers_in_mid_span() -> None:
    loads = follow_push(np.array([[-1.0, 5.0], [-1.0, -5.0]]), 0.6)
    solved = equilibrium(UNIT, loads, resolution=Resolution(16, 0.5))
    np.testing.assert_allclose(solved.q[1], -solved.q[0], atol=1e-12)
    beyond = solved.problem.grid.nodes > 0.6
    np.testing.assert_allclose(solved.q[:, beyond], 0.0, atol=1e-12)
