"""Forces for goals: (23)-(25), bounds, branches, and what is said where there is no force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.reach_goals import goals, places_under
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Steps, Uniform
from onebend.control.loaded_beam import PushedBeam, trace
from onebend.control.reach import Reach, ReachSettings, reach
from onebend.errors import ControlError
from onebend.records import Array

K, LENGTH = 0.02, 0.15
BEAM = Beam(LENGTH, Uniform(K))
TAPERED = Beam(LENGTH, Powers((K, -0.9 * K)))


def shot(beam: Beam, found: Reach) -> Array:
    """(2,) m of the point by an initial-value problem from the clamp, with the clamp's moment of the solution."""
    xy = found.solved.xy(np.array([found.push_s]))[0, 0]
    moment = xy[0] * found.force[1] - xy[1] * found.force[0] + found.moment

    def slopes(s: float, state: Array) -> Array:
        x, y, alpha = state
        inner = moment - (x * found.force[1] - y * found.force[0])
        bend = inner / float(beam.stiffness(s)) if s < found.push_s else 0.0
        return np.array([beam.length * np.cos(alpha), beam.length * np.sin(alpha), bend])

    run = solve_ivp(slopes, (0.0, found.point_s), [0.0, 0.0, beam.clamp_angle], rtol=1e-10, atol=1e-13, max_step=0.01)
    return np.asarray(run.y[:2, -1])


@pytest.mark.parametrize("beam", [BEAM, TAPERED, Beam(LENGTH, Steps((0.0, 0.4, 1.0), (K, 0.3 * K)))])
@pytest.mark.parametrize(("push_s", "point_s"), [(1.0, 1.0), (1.0, 0.6), (0.7, 0.7), (0.7, 1.0)])
def test_force_is_found_again_from_where_it_puts_the_point(beam: Beam, push_s: float, point_s: float) -> None:
    force = np.array([-0.05, 0.22]) / push_s**2
    goal = beam.equilibrium(force, push_s).xy(point_s)
    found = reach(beam, goal, push_s=push_s, point_s=point_s)
    assert found.converged
    assert found.reason == "reached"
    assert found.stable
    np.testing.assert_allclose(found.force, force, rtol=1e-5)
    assert found.error < 1e-8
    if point_s <= push_s:
        np.testing.assert_allclose(shot(beam, found), goal, atol=1e-8)


def test_a_few_iterations_leave_nothing_but_rounding() -> None:
    found = reach(BEAM, (0.115, 0.0905))
    assert found.converged
    assert found.iterations <= 6
    np.testing.assert_allclose(BEAM.equilibrium(found.force).xy(1.0), (0.115, 0.0905), atol=1e-9)


def test_path_from_rest_is_one_branch_of_equilibria() -> None:
    found = reach(TAPERED, TAPERED.equilibrium((0.02, 0.15)).xy(0.8), point_s=0.8)
    assert np.all(found.path[0] == 0.0)
    assert len(found.path) >= found.settings.steps
    shapes = TAPERED.equilibrium(found.path[1:, :2])
    assert shapes.stable
    np.testing.assert_allclose(shapes.xy(0.8), found.path_points[1:], atol=1e-7)
    np.testing.assert_allclose(found.shapes(np.array([0.8]))[:, 0], found.path_points, atol=1e-9)
    np.testing.assert_allclose(found.path[-1, :2], found.force)


def test_jacobian_is_that_of_differences() -> None:
    on = PushedBeam(TAPERED, 0.8, 0.6)
    load = np.array([-0.05, 0.3, 0.004])
    at = trace(on, load).states[-1]
    step = 1e-5
    for i in range(3):
        ends = [on.pose(trace(on, load + sign * step * np.eye(3)[i], start=at).states[-1].q) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(on.response(at)[:, i], (ends[0] - ends[1]) / (2 * step), rtol=2e-5, atol=1e-7)


def test_random_reachable_goals_are_all_reached() -> None:
    iterations = []
    for one in goals(10, 20, seed=5):
        found = [reach(one.beam, goal, push_s=one.push_s, point_s=one.point_s) for goal in one.goals]
        iterations += [each.iterations for each in found]
        force = [each.force for each in found]
        there, stands = places_under(one.beam, np.array(force), one.push_s, one.point_s)
        assert np.all(stands)
        np.testing.assert_allclose(there, one.goals, atol=1e-6)
    assert len(iterations) > 180
    assert np.median(iterations) <= 6


def test_goal_beyond_the_length_says_what_can_be_had() -> None:
    found = reach(BEAM, (0.2, 0.0))
    assert not found.converged
    assert "200 mm from the clamp" in found.reason
    assert "nearest reachable point is (150, 0) mm" in found.reason
    np.testing.assert_allclose(found.nearest.point if found.nearest else 0.0, (0.15, 0.0), atol=1e-6)


def test_goal_in_millimetres_is_guessed() -> None:
    assert "in metres: is this in millimetres?" in reach(BEAM, (133.0, 63.0)).reason
    assert "metres" not in reach(BEAM, (0.2, 0.0)).reason


def test_point_that_is_at_its_goal_already_needs_no_force() -> None:
    found = reach(BEAM, (LENGTH, 0.0))
    assert found.converged
    np.testing.assert_array_equal(found.force, 0.0)
    assert reach(BEAM, (LENGTH, 0.0), settings=ReachSettings(max_force=0.1)).converged
    assert not reach(BEAM, (LENGTH + 1e-5, 0.0)).converged


def test_infinite_bounds_are_none() -> None:
    settings = ReachSettings(max_force=np.inf, max_curvature=np.inf)
    assert settings == ReachSettings()


def test_bound_on_force_is_kept_and_named() -> None:
    goal = BEAM.equilibrium((0.0, 0.4)).xy(1.0)
    free = reach(BEAM, goal)
    assert free.converged
    found = reach(BEAM, goal, settings=ReachSettings(max_force=0.3))
    assert not found.converged
    assert "it needs 0.4 N, and 0.3 N are allowed" in found.reason
    assert np.hypot(*found.force) <= 0.3 * (1.0 + 1e-9)
    near = found.nearest
    assert near is not None
    turns = np.linspace(1.8, 2.2, 201)
    edge = BEAM.equilibrium(0.3 * np.stack([np.cos(turns), np.sin(turns)], axis=-1)).xy(1.0)
    away = np.linalg.norm(edge - goal, axis=1)
    assert near.distance <= min(away) + 1e-9
    assert near.distance > 0.95 * min(away)


def test_bound_on_curvature_is_kept_and_named() -> None:
    goal = BEAM.equilibrium((0.0, 0.3)).xy(1.0)
    most = 0.7 * 0.3 * goal[0] / K / LENGTH * LENGTH / LENGTH
    found = reach(BEAM, goal, settings=ReachSettings(max_curvature=most))
    assert not found.converged
    assert "1/m are allowed" in found.reason
    assert np.max(np.abs(found.solved.q)) / LENGTH <= most


def test_an_angle_that_no_load_holds_is_not_said_to_be_a_place_out_of_reach() -> None:
    there = BEAM.equilibrium((-0.1, 0.2)).xy(1.0)  # its tangent is then at 0.79 rad
    upright = reach(BEAM, (*there, 0.4), settings=ReachSettings(moment=True))
    assert not upright.converged
    assert "at 22.92 deg by a force and a moment" in upright.reason
    assert "A force alone brings the point there: it needs 0.224 N at 116.6 deg" in upright.reason
    assert "nearest reachable point" not in upright.reason
    assert "onebend shape --grip" in upright.reason


def test_moment_holds_place_and_angle_or_makes_the_load_least() -> None:
    both = ReachSettings(moment=True)
    arc = np.array([np.sin(1.0), 1.0 - np.cos(1.0)]) * LENGTH
    posed = reach(BEAM, [*arc, 1.0], settings=both)  # a moment alone bends a uniform beam into an arc of a circle
    assert posed.converged
    np.testing.assert_allclose(posed.force, 0.0, atol=1e-6)
    assert posed.moment == pytest.approx(K, rel=1e-6)
    goal = BEAM.equilibrium((0.0, 0.2)).xy(1.0)
    least = reach(BEAM, goal, settings=both)
    assert least.converged
    size = np.hypot(np.hypot(*least.force), least.moment / LENGTH)
    assert size < 0.2
    on = PushedBeam(BEAM, 1.0, 1.0)  # least: the load is a combination of the rows of its Jacobian
    load, scaled = least.path[-1] / on.scale, least.pushed.response(least.states[-1])[:2] * on.scale
    np.testing.assert_allclose(load - np.linalg.pinv(scaled) @ (scaled @ load), 0.0, atol=1e-5)


def test_weight_is_carried_on_the_way() -> None:
    heavy = Beam(LENGTH, Uniform(K), mass_per_length=Uniform(0.3))
    down = ReachSettings(gravity=(0.0, -9.81))
    goal = heavy.equilibrium((0.05, 0.4), gravity=down.gravity).xy(1.0)
    found = reach(heavy, goal, settings=down)
    assert found.converged
    np.testing.assert_allclose(found.force, (0.05, 0.4), rtol=1e-5)
    np.testing.assert_allclose(found.path_points[0], heavy.equilibrium((0.0, 0.0), gravity=down.gravity).xy(1.0))


def test_paper_iteration_comes_to_within_a_millimetre_or_says_that_it_did_not() -> None:
    paper = ReachSettings(method="paper")
    goal = BEAM.equilibrium((0.0, 0.3)).xy(1.0)
    found = reach(BEAM, goal, settings=paper)
    assert found.converged
    assert found.error < 2e-3
    assert found.iterations > reach(BEAM, goal).iterations
    lost = reach(BEAM, (0.07, 0.04), settings=paper)
    assert not lost.converged
    assert "paper's iteration" in lost.reason


@pytest.mark.parametrize(
    ("goal", "options", "says"),
    [
        ((0.1, float("nan")), {}, r"goal is a place .* got \(0\.1, nan\)"),
        ((0.1, 0.0, 0.0, 0.0), {}, "goal is a place"),
        ((0.1, 0.0, 1.0), {}, "cannot hold a point at an angle"),
        ((0.1, 0.05), {"push_s": 0.0}, "push_s lies in"),
        ((0.1, 0.05), {"push_s": 1e-12}, "too near the clamp"),
        ((0.1, 0.05), {"point_s": 1.2}, "point_s lies in"),
    ],
)
def test_what_has_no_meaning_is_refused(goal: tuple[float, ...], options: dict[str, float], says: str) -> None:
    with pytest.raises(ControlError, match=says):
        reach(BEAM, goal, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "settings",
    [{"max_force": -1.0}, {"max_curvature": 0.0}, {"tolerance": 0.0},
     {"method": "paper", "moment": True}],
)  # fmt: skip
def test_settings_without_meaning_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ControlError):
        ReachSettings(**settings)  # type: ignore[arg-type]
