"""The surface of equilibria under hands: its tangents, the cost's exact second derivative on it, the margin."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.statics import gradient
from onebend.beam.stiffness import Uniform
from onebend.control.goals import angles, curve, target_residuals
from onebend.control.shape import BeamState, Grip, LoadBound, Pusher, bounded_step, model_of, next_state, resting_state
from onebend.records import Array
from tests.beam.held import hold
from tests.control.shape.test_shape import BENT, SOFT, S

GRID = Resolution(order=16, widest=0.5)
HANDS: list[tuple[tuple[Pusher, ...], Grip | None]] = [
    ((Pusher(0.6), Pusher(1.0)), None),
    ((), Grip()),
    ((Pusher(0.5),), Grip()),
]


def wandered(pushes: tuple[Pusher, ...], grip: Grip | None, seed: int) -> BeamState:
    """An equilibrium some random steps from rest."""
    state, rng = resting_state(BENT, pushes, grip, (0.0, -9.81), GRID), np.random.default_rng(seed)
    for _ in range(6):
        z = 0.4 * rng.standard_normal(state.actuators.count)
        after = next_state(state, z, 0.8)
        state = state if after is None or after.margin < 0.1 else after
    return state


@pytest.mark.parametrize(("pushes", "grip"), HANDS)
def test_steps_end_in_equilibrium_and_leave_along_the_plane(pushes: tuple[Pusher, ...], grip: Grip | None) -> None:
    state = wandered(pushes, grip, 0)
    assert np.max(np.abs(gradient(state.solved.problem, state.q[None]))) < 1e-12
    z = np.eye(state.actuators.count)[0]
    far, near = (next_state(state, h * z, 0.5) for h in (1e-3, 5e-4))
    assert far is not None
    assert near is not None
    dq, _ = state.plane
    away = [np.max(np.abs(one.q - state.q - dq @ (h * z))) for one, h in ((far, 1e-3), (near, 5e-4))]
    assert away[1] == pytest.approx(away[0] / 4.0, rel=0.05)  # what is left is of second order


@pytest.mark.parametrize(("pushes", "grip"), HANDS)
def test_slope_and_hessian_are_those_of_differences(pushes: tuple[Pusher, ...], grip: Grip | None) -> None:
    state, rng = wandered(pushes, grip, 1), np.random.default_rng(2)
    wanted = curve(S, 0.1 * rng.standard_normal((10, 2))) + angles(1.0, 0.3)

    def cost(z: Array) -> float:
        after = next_state(state, z, 0.5)
        assert after is not None
        return 0.5 * float(target_residuals(after.solved, wanted, 0.15).cost[0])

    h, found = 3e-4, model_of(state, target_residuals(state.solved, wanted, 0.15))
    step = h * np.eye(state.actuators.count)
    slope = [(cost(a) - cost(-a)) / (2 * h) for a in step]
    hessian = [[(cost(a + b) - cost(a - b) - cost(b - a) + cost(-a - b)) / (4 * h * h) for b in step] for a in step]
    np.testing.assert_allclose(found[0], slope, atol=1e-6)
    np.testing.assert_allclose(found[1], hessian, atol=1e-5)


def test_margin_of_a_column_is_what_eulers_load_leaves() -> None:
    """Clamped and free: P_Euler = pi^2 / 4 EI / L^2; the scaled tangent's smallest eigenvalue is 1 - P / P_Euler."""
    straight = Beam(0.2, Uniform(0.03))
    start = resting_state(straight, (Pusher(1.0),), None, None, GRID)
    for share in (0.0, 0.3, 0.9, 1.1):
        load = np.array([-share * np.pi**2 / 4.0 * 0.03 / 0.2, 0.0])
        assert BeamState(start.actuators, start.q, load).margin == pytest.approx(1.0 - share, abs=1e-9)


def test_margin_of_a_column_held_at_both_ends() -> None:
    """It buckles at 4 pi^2 EI / L^2: a straight beam's end moves along it only to second order, which bars nothing."""
    straight = Beam(0.2, Uniform(0.03))
    start = resting_state(straight, (), Grip(), None, GRID)
    for share in (0.3, 0.9, 1.1):
        load = np.array([-share * 4.0 * np.pi**2 * 0.03 / 0.2, 0.0, 0.0])
        assert BeamState(start.actuators, start.q, load).margin == pytest.approx(1.0 - share, abs=1e-6)


def test_gripped_shapes_are_those_of_the_mechanics() -> None:
    state = resting_state(SOFT, (), Grip(), None, GRID)
    for z in ([0.0, 0.3, 0.4], [0.2, -0.5, 0.3], [0.3, 0.1, 0.5]):
        after = next_state(state, np.array(z), 0.8)
        assert after is not None
        state = after
    held = hold(SOFT, state.end, resolution=GRID)
    np.testing.assert_allclose(held.solved.xy(S)[0], state.solved.xy(S)[0], atol=1e-10)
    np.testing.assert_allclose(held.wrench[0], state.u, rtol=1e-7, atol=1e-10)


def test_bounded_step_is_the_minimum_within_the_bounds() -> None:
    """Against many random points of two discs: none is lower; and on the bound the multipliers balance the slope."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    hessian, slope, u = root @ root.T + 0.1 * np.eye(4), 3.0 * rng.standard_normal(4), np.array([0.3, 0.0, 0.0, -0.2])
    bounds = (LoadBound(slice(0, 2), 0.5, "one"), LoadBound(slice(2, 4), 0.7, "other"))
    z, prices = bounded_step(slope, hessian, u, np.eye(4), bounds)
    sizes = np.linalg.norm((u + z).reshape(2, 2), axis=1)
    assert np.all(sizes <= np.array([0.5, 0.7]) * (1.0 + 1e-9))
    left = slope + hessian @ z + np.repeat(prices, 2) * (u + z)
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
    turn, size = rng.uniform(-np.pi, np.pi, (2, 5000)), np.sqrt(rng.uniform(0.0, 1.0, (2, 5000)))
    size *= np.array([[0.5], [0.7]])
    others = np.stack([f(turn[i]) * size[i] for i in (0, 1) for f in (np.cos, np.sin)], axis=1) - u
    values = others @ slope + 0.5 * np.einsum("ti,ij,tj->t", others, hessian, others)
    assert slope @ z + 0.5 * z @ hessian @ z <= np.min(values)
