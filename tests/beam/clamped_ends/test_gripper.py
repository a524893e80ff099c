"""A moving clamp against problems that are the same in another frame, and against published frequencies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from onebend.beam.dynamics import Actions, AppliedForce, Gripper, body, mass_matrix, momentum
from onebend.beam.grid import Modes
from onebend.beam.integration import IntegrationSettings, Method, MotionState, simulate
from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.beam.vibration import settle
from onebend.errors import MechanicsError
from onebend.records import Array
from tests.beam.moving import soft_body

S = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
PULL = Actions(forces=(AppliedForce((0.0, 3.0 * 0.02 / 0.15)),))  # P L^2 / EI = 3
FINE = IntegrationSettings(Method(4), tolerance=1e-12)


def test_accelerated_gripper_is_gravity_the_other_way() -> None:
    of = soft_body()
    a = np.array([4.0, -7.0])
    driven = Gripper(lambda t: (*(0.5 * a * t**2), 0.0), lambda t: (*(a * t), 0.0))
    start = settle(of, PULL)
    moving = simulate(of, start, 0.1, 2.5e-4, Actions(gripper=driven), settings=FINE)
    still = simulate(of, start, 0.1, 2.5e-4, Actions(gravity=-a), settings=FINE)
    np.testing.assert_allclose(moving.theta, still.theta, atol=1e-6)
    away = moving.xy(S) - moving.base[:, None, :2]
    np.testing.assert_allclose(away, still.xy(S), atol=1e-7)


def test_gripper_at_constant_speed_changes_nothing() -> None:
    of = soft_body()
    start = settle(of, PULL)
    steady = Gripper(lambda t: (3.0 * t, -t, 0.0), lambda _: (3.0, -1.0, 0.0))
    moving = simulate(of, start, 0.1, 2.5e-4, Actions(gripper=steady), settings=FINE)
    np.testing.assert_allclose(moving.theta, simulate(of, start, 0.1, 2.5e-4, settings=FINE).theta, atol=1e-7)


def test_gripper_that_starts_at_once_is_a_beam_thrown_the_other_way() -> None:
    of, speed, at = soft_body(), 0.4, 0.05
    jolt = Gripper(
        lambda t: (0.0, speed * max(t - at, 0.0), 0.0), lambda t: (0.0, speed if t >= at else 0.0, 0.0), (at,)
    )
    moving = simulate(of, MotionState(np.zeros(4), np.zeros(4)), 0.15, 1e-3, Actions(gripper=jolt))
    extra = momentum(of, np.zeros(4), np.zeros(4), np.zeros(3), np.array([0.0, speed, 0.0]))
    thrown = MotionState(np.zeros(4), np.asarray(-np.linalg.solve(mass_matrix(of, np.zeros(4)), extra)))
    still = simulate(of, thrown, 0.1, 1e-3)
    np.testing.assert_allclose(moving.theta[-1], still.theta[-1], atol=1e-6)


def test_turned_gripper_turns_the_motion() -> None:
    of, turn = soft_body(), 0.7
    start = settle(of, PULL)
    turned = simulate(of, start, 0.1, 1e-3, Actions(gripper=Gripper(lambda _: (0, 0, turn), lambda _: (0, 0, 0))))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    plain = simulate(of, start, 0.1, 1e-3)
    np.testing.assert_allclose(turned.xy(S), plain.xy(S) @ rotation.T, atol=1e-9)
    np.testing.assert_allclose(turned.angle(S), plain.angle(S) + turn, atol=1e-8)


@pytest.mark.parametrize(("speed", "flap"), [(0.0, 3.5160), (3.0, 4.7973), (6.0, 7.3604), (12.0, 13.1702)])
def test_spinning_gripper_stiffens_the_beam(speed: float, flap: float) -> None:
    """Published: out-of-plane frequencies of a uniform cantilever turning at `speed` (Wright et al., J. Appl. Mech. 49,
    1982; in sqrt(EI / (mu L^4))); in the plane of turning omega^2 = flap^2 - speed^2."""
    of = body(Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0)), Modes(6))
    actions = Actions(gripper=Gripper(lambda t: (0.0, 0.0, speed * t), lambda _: (0.0, 0.0, speed)))
    duration, small = 2e-3, 1e-6  # shorter than half a period of the fastest mode: no frequency is mistaken

    def end(start: Array) -> Array:
        motion = simulate(
            of,
            MotionState(start[:6], start[6:]),
            duration,
            2.5e-4,
            actions,
            settings=IntegrationSettings(tolerance=1e-13),
        )
        return np.concatenate([motion.theta[-1], motion.rate[-1]])

    scale = small * np.append(np.ones(6), np.full(6, 1e3))
    monodromy = np.stack([end(e) - end(-e) for e in np.diag(scale)], axis=1) / (2.0 * scale)
    multipliers = np.linalg.eigvals(monodromy)
    np.testing.assert_allclose(np.abs(multipliers), 1.0, atol=1e-6)
    slowest = np.min(np.abs(np.angle(multipliers))) / duration
    assert slowest == pytest.approx(np.sqrt(flap**2 - speed**2), rel=2e-4)


def test_measured_gripper_poses_move_the_beam_as_the_function_does() -> None:
    of = soft_body()
    time = np.linspace(0.0, 0.3, 301)
    shake = np.stack([np.zeros(301), 0.01 * np.sin(20.0 * time), 0.1 * (1.0 - np.cos(20.0 * time))], axis=1)
    exact = Gripper(
        lambda t: (0.0, 0.01 * np.sin(20.0 * t), 0.1 * (1.0 - np.cos(20.0 * t))),
        lambda t: (0.0, 0.2 * np.cos(20.0 * t), 2.0 * np.sin(20.0 * t)),
    )
    start = MotionState(np.zeros(4), np.zeros(4))
    poses = CubicSpline(time, shake)
    measured = simulate(of, start, 0.3, 1e-3, Actions(gripper=Gripper(poses, poses.derivative())))
    np.testing.assert_allclose(measured.xy(S), simulate(of, start, 0.3, 1e-3, Actions(gripper=exact)).xy(S), atol=1e-6)
    assert np.ptp(measured.xy(S)[:, -1, 1]) > 0.02


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: Gripper(lambda t: (0.0, np.sin(t), 0.0), lambda t: (0.0, -np.cos(t), 0.0)),
            "not the derivative of its pose: at t = 0",
        ),
        (lambda: Gripper(lambda _: (0.0, 0.0), lambda _: (0.0, 0.0, 0.0)), "3 number"),
    ],
)
def test_what_is_no_motion_of_a_clamp_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        simulate(soft_body(), MotionState(np.zeros(4), np.zeros(4)), 1.0, 0.1, Actions(gripper=make()))
