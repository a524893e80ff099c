"""Paths: goals in time become forces or poses in time, exact at every sample, within limits on their rates."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.control.goals import Between, Goals, angles, curve, points
from onebend.control.path import FollowedPath, PathSettings, RateLimits, follow_goals
from onebend.control.reach import reach
from onebend.control.shape import Grip, Pusher, shape
from onebend.errors import ControlError
from onebend.records import Array
from tests.control.path.moving_point import point_goals
from tests.control.shape.test_shape import SOFT, S, gripped

TIME = np.linspace(0.0, 2.0, 21)


def circle(size: float = 0.1) -> Goals:
    """The tip led along the places that a turning force would hold it at."""
    turn = np.pi * TIME
    force = np.stack([0.05 * np.cos(turn), 0.3 + size * np.sin(turn)], axis=1)
    return point_goals(TIME, SOFT.equilibrium(force).xy(1.0))


def shapes_in_time() -> Goals:
    """Three shapes that a gripper can hold, by independent integration."""
    shapes = np.array([gripped(np.array(w), S) for w in ([0.2, 0.3, -0.02], [0.1, 0.3, -0.03], [0.1, 0.4, -0.02])])
    return Goals(np.array([0.0, 1.0, 2.0]), curve(S, shapes[0, :, :2]), shapes[..., :2], np.full((3, 10), np.nan))


@pytest.fixture(scope="module")
def way() -> FollowedPath:
    return follow_goals(SOFT, circle(), pushes=(Pusher(),), settings=PathSettings(rate=200.0))


def test_every_sample_is_on_its_goal(way: FollowedPath) -> None:
    wanted, _ = way.goals.along(way.goal_time)
    assert len(way.time) == 401
    np.testing.assert_allclose(np.diff(way.time), 0.005)
    np.testing.assert_allclose(way.xy(1.0), wanted, atol=1e-10)
    again = SOFT.equilibrium(way.forces[::20, 0]).xy(1.0)
    np.testing.assert_allclose(again, wanted[::20, 0], atol=1e-8 * SOFT.length)
    assert way.stretch == 1.0
    assert not way.warnings


def test_forces_are_those_of_reach(way: FollowedPath) -> None:
    for i in (0, 130, 400):
        found = reach(SOFT, way.xy(1.0)[i, 0])
        assert found.converged
        np.testing.assert_allclose(way.forces[i, 0], found.force, rtol=1e-4, atol=1e-6)


def test_path_is_smooth(way: FollowedPath) -> None:
    """No sample stands out: third differences fall with the cube of the step."""
    coarse, fine = (np.max(np.abs(np.diff(way.forces[::n, 0], n=3, axis=0))) for n in (4, 2))
    assert fine < coarse / 5.0


def test_time_is_stretched_where_a_limit_wants_it_and_only_there(way: FollowedPath) -> None:
    limit = 0.2
    slow = follow_goals(
        SOFT, circle(), pushes=(Pusher(),), settings=PathSettings(rate=200.0, limits=RateLimits(force=limit))
    )
    rate = np.linalg.norm(np.diff(slow.forces[:, 0], axis=0), axis=1) * 200.0
    assert np.max(rate) <= limit * (1.0 + 1e-6)
    assert slow.stretch > 1.1
    pace = np.diff(slow.goal_time) * 200.0
    assert np.max(pace) <= 1.0 + 1e-9
    assert np.mean(pace > 0.999) > 0.1  # gone as asked where the limit allows it
    np.testing.assert_allclose(slow.xy(1.0), slow.goals.along(slow.goal_time)[0], atol=1e-10)
    np.testing.assert_allclose(slow.forces[[0, -1]], way.forces[[0, -1]], atol=1e-9)


def test_a_bound_on_the_force_holds_all_along() -> None:
    held = follow_goals(SOFT, circle(), pushes=(Pusher(1.0, max_force=0.35),), settings=PathSettings(rate=10.0))
    size = np.linalg.norm(held.forces[:, 0], axis=1)
    assert np.max(size) == pytest.approx(0.35, rel=1e-9)
    assert any("limit from" in one for one in held.warnings)
    assert np.all(held.miss[size < 0.349] < 1e-9)
    # Where it is held back, each sample is what the shape by itself would be.
    i = int(np.argmax(held.miss))
    alone = shape(SOFT, held.goals.at(float(held.goal_time[i])), pushes=[Pusher(1.0, max_force=0.35)])
    assert held.miss[i] == pytest.approx(alone.rms, rel=1e-5)


@pytest.mark.slow
def test_gripper_goes_through_the_shapes_within_its_speed() -> None:
    free = follow_goals(SOFT, shapes_in_time(), grip=Grip(), settings=PathSettings(rate=50.0))
    wanted = free.goals.xy
    for i, j in ((0, 0), (50, 1), (100, 2)):
        np.testing.assert_allclose(free.xy(S)[i], wanted[j], atol=1e-8)
    limits = RateLimits(speed=0.01, turning=0.2)
    slow = follow_goals(SOFT, shapes_in_time(), grip=Grip(), settings=PathSettings(rate=50.0, limits=limits))
    steps = np.diff(slow.poses, axis=0) * 50.0
    assert np.max(np.linalg.norm(steps[:, :2], axis=1)) <= 0.01 * (1.0 + 1e-6)
    assert np.max(np.abs(steps[:, 2])) <= 0.2 * (1.0 + 1e-6)
    assert slow.stretch > free.stretch


@pytest.mark.slow
def test_each_sample_is_the_closest_shape() -> None:
    """Between goals that no pose meets exactly, the batch finds the same optimum as the search alone."""
    way = follow_goals(SOFT, shapes_in_time(), grip=Grip(), settings=PathSettings(rate=20.0))
    i = int(np.argmax(way.miss))
    assert way.miss[i] > 1e-5
    alone = shape(SOFT, way.goals.at(float(way.goal_time[i])), grip=Grip())
    assert way.miss[i] == pytest.approx(alone.rms, rel=1e-6)
    np.testing.assert_allclose(way.poses[i], alone.pose, atol=1e-7)


def test_a_way_into_buckling_is_stopped_with_its_moment() -> None:
    start = SOFT.equilibrium([0.0, 0.05]).xy(1.0)
    goals = point_goals([0.0, 1.0], np.stack([start, start - [0.03, 0.0]]), between="linear")
    with pytest.raises(ControlError, match=r"at 0\.\d+ s"):
        follow_goals(SOFT, goals, pushes=(Pusher(),))


def test_open_freedoms_are_refused() -> None:
    with pytest.raises(ControlError, match="1 of 3 freedoms"):
        follow_goals(SOFT, circle(), grip=Grip())


@pytest.mark.parametrize("between", ["smooth", "monotone", "linear"])
def test_goals_are_met_at_their_times(between: Between) -> None:
    goals = point_goals([0.0, 0.5, 2.0], [[0.14, 0.0], [0.13, 0.05], [0.14, 0.02]], between=between)
    np.testing.assert_allclose(goals.along(goals.time)[0][:, 0], goals.xy[:, 0], atol=1e-15)


def test_what_is_no_path() -> None:
    def of(time: Array, xy: Array) -> Goals:
        return point_goals(time, xy)

    two = np.array([[0.14, 0.0], [0.13, 0.05]])
    with pytest.raises(ControlError, match="rise"):
        of(np.array([1.0, 1.0]), two)
    with pytest.raises(ControlError, match="two or more"):
        of(np.array([1.0]), two[:1])
    both = points(1.0, two[0]) + angles(0.5, 0.1)
    with pytest.raises(ControlError, match="other things"):
        Goals(np.array([0.0, 1.0]), both, np.array([both.xy, both.xy]), np.array([[np.nan, 0.1], [0.2, 0.1]]))
    with pytest.raises(ControlError, match="in millimetres"):
        follow_goals(SOFT, of(np.array([0.0, 1.0]), 1e3 * two), pushes=(Pusher(),))
    with pytest.raises(ControlError, match="rate of samples"):
        follow_goals(SOFT, circle(), pushes=(Pusher(),), settings=PathSettings(rate=0.0))
