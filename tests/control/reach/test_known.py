"""Goals one step from an equilibrium that is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reach_goals import goals, places_under
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Powers, Uniform
from onebend.control.loaded_beam import LoadedState, prepared
from onebend.control.reach import ReachSettings, known_equilibria, reach

BEAM = Beam(0.15, Powers((0.02, -0.012)), Uniform(0.2), mass_per_length=Uniform(0.1))
FINE = Resolution(16, 0.125)


def test_known_equilibria_are_those_of_the_statics_with_its_derivatives() -> None:
    gravity = (0.0, -9.81)
    pushed = prepared(BEAM, 0.8, 0.6, gravity, Resolution())
    known = known_equilibria(pushed)
    assert np.all(known.force[0] == 0.0)
    shapes = BEAM.equilibrium(known.force, 0.8, gravity=gravity)
    np.testing.assert_allclose(known.places, shapes.xy(0.6), atol=1e-9)
    for i in range(0, len(known.force), 9):
        response = pushed.response(LoadedState(known.q[i], np.append(known.force[i], 0.0)))[:2, :2]
        np.testing.assert_allclose(known.force_by_place[i] @ response, np.eye(2), atol=1e-5)


@pytest.mark.slow
def test_nearly_all_goals_are_one_step_away_and_right() -> None:
    one_step, count = 0, 0
    for one in goals(8, 6, seed=21):
        found = [reach(one.beam, goal, push_s=one.push_s, point_s=one.point_s) for goal in one.goals]
        force = np.array([each.force for each in found])
        there, stands = places_under(one.beam, force, one.push_s, one.point_s, FINE)
        assert np.all(stands)
        assert np.max(np.linalg.norm(there - one.goals, axis=1)) < 1e-6
        one_step, count = one_step + sum(each.known for each in found), count + len(found)
    assert one_step > 0.8 * count


@pytest.mark.slow
def test_what_was_reached_before_changes_no_number() -> None:
    goal, met = (0.11, 0.09), replace(BEAM)
    for other in ((0.13, 0.05), (0.1, -0.08)):
        reach(met, other)
    fresh, again = reach(replace(BEAM), goal), reach(met, goal)
    assert again.known
    assert np.array_equal(again.force, fresh.force)


def test_its_way_from_rest_is_a_force_that_grows() -> None:
    found = reach(BEAM, (0.11, 0.09))
    assert found.known
    share = found.path[:, :2] @ found.force / (found.force @ found.force)
    np.testing.assert_allclose(found.path[:, :2], share[:, None] * found.force, atol=1e-12)
    assert np.all(np.diff(share) > 0.0)
    np.testing.assert_allclose(found.path_points[-1], (0.11, 0.09), atol=1e-9)


def test_a_bound_holds_though_a_known_equilibrium_is_near() -> None:
    free = reach(BEAM, (0.11, 0.09))
    bounded = reach(BEAM, (0.11, 0.09), settings=ReachSettings(max_force=0.9 * float(np.hypot(*free.force))))
    assert not bounded.converged
    assert "allowed" in bounded.reason or "no force of up to" in bounded.reason
