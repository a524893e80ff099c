"""Shapes from forces and from a gripper's pose: what hands can hold is found again, and what they cannot is said."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Gaussians, UncertainStiffness, Uniform, equidistant
from onebend.control.goals import angles, curve, curve_of_length, points
from onebend.control.shape import Grip, Pusher, ShapeResult, shape
from onebend.errors import ControlError
from onebend.records import Array
from tests.beam.boundary import integrate

SOFT = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))
BENT = Beam(0.2, Uniform(0.03), rest_curvature=Uniform(0.4), mass_per_length=Uniform(0.1))
S = np.linspace(0.1, 1.0, 10)


def gripped(wrench: Array, places: Array, beam: Beam = SOFT) -> Array:
    """(S, 3) x, y, angle by an independent integration, from the wrench (3,) with which the beam pulls at its clamp."""
    start = np.append([0.0, 0.0, beam.clamp_angle], wrench)
    return integrate(beam, start, places=np.append(places[places < 1.0], 1.0))[:3].T


def test_gripper_pose_of_a_shape_from_an_independent_integration() -> None:
    for wrench in ([0.2, 0.3, -0.02], [-0.3, 0.1, 0.03], [0.1, -0.4, 0.05]):
        wanted = gripped(np.array(wrench), S)
        found = shape(SOFT, curve(S, wanted[:, :2]), grip=Grip())
        assert found.converged
        assert found.rms < 1e-9 * SOFT.length
        assert np.max(np.abs(found.xy_error)) < 1e-8 * SOFT.length
        np.testing.assert_allclose(found.pose, wanted[-1], atol=1e-8)
        assert found.wrench is not None
        np.testing.assert_allclose(found.wrench[:2], wrench[:2], rtol=1e-5)


def test_forces_of_a_shape_are_found_again_under_weight() -> None:
    gravity = np.array([0.0, -9.81])
    force = np.array([0.1, 0.4])
    wanted = BENT.equilibrium(force, 0.7, gravity=gravity)
    found = shape(BENT, curve(S, wanted.xy(S)), pushes=[Pusher(0.7)], gravity=gravity)
    np.testing.assert_allclose(found.forces[0], force, rtol=1e-7)
    assert found.wrench is None
    assert not found.limits


def test_angles_and_points_mix() -> None:
    wanted = SOFT.equilibrium([0.05, 0.3])
    found = shape(SOFT, points(1.0, wanted.xy(1.0)) + angles([0.5], [wanted.angle(0.5)]), pushes=[Pusher()])
    np.testing.assert_allclose(found.forces[0], [0.05, 0.3], rtol=1e-6)
    assert np.all(np.isnan(found.xy_error[1]))


def test_a_bound_holds_and_is_named() -> None:
    wanted = SOFT.equilibrium([0.0, 0.6])
    goal = points(1.0, wanted.xy(1.0))
    held = shape(SOFT, goal, pushes=[Pusher(1.0, max_force=0.4)])
    assert np.linalg.norm(held.forces[0]) == pytest.approx(0.4, rel=1e-9)
    assert held.limits == ("force at s = 1",)
    # No force of that size, in whichever direction, brings the tip closer.
    turns = np.linspace(0.0, 2.0 * np.pi, 721)
    every = SOFT.equilibrium(0.4 * np.stack([np.cos(turns), np.sin(turns)], axis=1), fall="left")
    away = np.linalg.norm(every.xy(1.0) - wanted.xy(1.0), axis=1)
    assert held.rms <= np.min(away) + 1e-9
    assert held.rms == pytest.approx(np.min(away), rel=1e-3)


def test_grip_keeps_its_bounds() -> None:
    wanted = gripped(np.array([0.3, 0.6, -0.03]), S)
    free = shape(SOFT, curve(S, wanted[:, :2]), grip=Grip())
    held = shape(SOFT, curve(S, wanted[:, :2]), grip=Grip(max_force=0.3))
    assert free.wrench is not None
    assert held.wrench is not None
    assert np.linalg.norm(free.wrench[:2]) > 0.5
    assert np.linalg.norm(held.wrench[:2]) == pytest.approx(0.3, rel=1e-7)
    assert held.limits == ("the gripper's force",)
    assert held.rms > free.rms


def test_out_of_reach_is_the_nearest_and_stationary() -> None:
    """The residual of an unreachable curve is at a minimum: no small change of the force lowers it."""
    bump = 0.005 * np.stack([S, 0.0 * S], axis=1)
    goal = curve(S, SOFT.equilibrium([0.05, 0.4]).xy(S) + bump)
    found = shape(SOFT, goal, pushes=[Pusher(1.0)])
    assert found.converged
    assert not found.limits
    assert found.rms > 1e-3

    def cost(force: Array) -> float:
        return float(np.sum(goal.weight * np.sum((SOFT.equilibrium(force).xy(S) - goal.xy) ** 2, axis=1)))

    here = cost(found.forces[0])
    for step in 1e-3 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]):
        assert cost(found.forces[0] + step) > here


@pytest.mark.slow
def test_where_stability_bars_the_way_is_said() -> None:
    """An S is nearest to a tip push that would buckle the beam."""
    found = shape(SOFT, curve(S, np.stack([0.15 * S, 0.05 * np.sin(2 * np.pi * S)], axis=1)), pushes=[Pusher(1.0)])
    assert found.limits == ("stability",)
    assert 0.0 < found.margin < 0.01
    uncertain = shape(SOFT, found.targets, pushes=[Pusher(1.0)], uncertain=band(0.02, 0.05))
    assert uncertain.spread is None  # a small change of k would buckle the beam: the first order says nothing


def test_near_buckling_is_warned_of() -> None:
    """A column's margin under an axial load P is 1 - P / P_Euler, in the limit."""
    euler = 2.4674 * 0.03 / 0.2
    straight = Beam(0.2, Uniform(0.03))
    wanted = straight.equilibrium([-0.97 * euler, 1e-3])
    found = shape(straight, curve(S, wanted.xy(S)), pushes=[Pusher()])
    assert found.margin == pytest.approx(0.03, abs=0.02)
    assert found.load_left == pytest.approx(1.0 / 0.97, rel=0.02)
    assert any("close to buckling" in one for one in found.warnings)


def band(gain: float, log_sd: float) -> UncertainStiffness:
    knots = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    return UncertainStiffness(knots, np.full(4, np.log(0.03)), log_sd**2 * np.eye(4), gain)


def test_spread_of_a_push_is_that_of_beams_drawn_from_the_band() -> None:
    known = band(0.01, 0.02)
    beam = Beam(0.2, known.profile)
    wanted = beam.equilibrium([0.05, 0.3])
    found = shape(beam, curve(S, wanted.xy(S)), pushes=[Pusher()], uncertain=known)
    loads, grid = push(found.forces[0]), Resolution(16, 0.5)
    drawn = [equilibrium(Beam(0.2, k), loads, resolution=grid).xy(S)[0] for k in known.draw(150, seed=0)]
    assert found.spread is not None
    np.testing.assert_allclose(found.spread.xy, np.std(drawn, axis=0), rtol=0.25, atol=1e-5)


def test_a_gripped_shape_does_not_know_the_scale_of_k() -> None:
    known = band(0.1, 0.0)
    beam = Beam(0.2, known.profile)
    found = shape(beam, curve(S, gripped(np.array([0.2, 0.3, -0.02]), S, beam)[:, :2]), grip=Grip(), uncertain=known)
    assert found.spread is not None
    assert found.wrench is not None
    assert found.spread.wrench is not None
    assert np.max(found.spread.xy) < 1e-9
    np.testing.assert_allclose(found.spread.wrench, 0.1 * np.abs(found.wrench), rtol=1e-6)


def test_open_freedoms_are_said() -> None:
    found = shape(SOFT, points(1.0, SOFT.equilibrium([0.0, 0.3]).xy(1.0)), grip=Grip())
    assert found.open_freedoms == 1
    assert found.rms < 1e-9
    assert any("1 of 3 freedoms" in one for one in found.warnings)


def test_a_drawn_curve_finds_its_own_places() -> None:
    s = np.linspace(0.0, 1.0, 201)
    wanted = SOFT.equilibrium([0.0, 0.3]).xy(s)
    found = shape(SOFT, curve_of_length(wanted, SOFT.length), pushes=[Pusher()])
    np.testing.assert_allclose(found.forces[0], [0.0, 0.3], atol=1e-3)
    with pytest.raises(ControlError, match="shorten the curve"):
        curve_of_length(2.0 * wanted, SOFT.length)


def test_what_cannot_be_asked() -> None:
    goal = points(1.0, [0.1, 0.05])
    with pytest.raises(ControlError, match="no actuator"):
        shape(SOFT, goal)
    with pytest.raises(ControlError, match="s in"):
        points(1.5, [0.1, 0.0])
    with pytest.raises(ControlError, match="neither"):
        points(1.0, [np.nan, np.nan])
    with pytest.raises(ControlError, match=r"\(100, 60\) m is 116.6 m .* in millimetres\?"):
        shape(SOFT, points(1.0, [100.0, 60.0]), pushes=[Pusher(1.0)])
    with pytest.raises(ControlError, match="positive"):
        Pusher(1.0, max_force=-1.0)


@pytest.mark.slow
def test_same_question_same_answer() -> None:
    goal = curve(S, np.stack([0.15 * S, 0.05 * S**2], axis=1))
    a, b = (shape(SOFT, goal, pushes=[Pusher(0.5, 0.5), Pusher(1.0, 0.5)]) for _ in range(2))
    assert isinstance(a, ShapeResult)
    assert np.array_equal(a.forces, b.forces)
