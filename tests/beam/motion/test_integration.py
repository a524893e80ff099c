"""Motion in time: order, conservation, damping, and problems whose answer is known another way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium
from onebend.beam.dynamics import Actions, AppliedForce, Body, body
from onebend.beam.grid import Modes
from onebend.beam.integration import IntegrationSettings, Method, Motion, MotionState, converged, simulate
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Scaled, Steps, Uniform
from onebend.beam.vibration import settle, vibration_of
from onebend.errors import MechanicsError
from onebend.records import Array
from tests.beam.moving import ODD, SOFT, by_the_matrices, energy_of, odd_body, soft_body

S = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
PULL = Actions(forces=(AppliedForce((0.0, 3.0 * 0.02 / 0.15)),))  # P L^2 / EI = 3
FINE = IntegrationSettings(Method(4), tolerance=1e-12)
WEIGHT = Actions(gravity=(2.0, -9.0))


def released(n: int = 4) -> tuple[Body, MotionState, float]:
    of = soft_body(n)
    period = 1.0 / float(vibration_of(of, settle(of)).frequency[0])
    return of, settle(of, PULL), period


def drift(motion: Motion, period: float) -> tuple[float, float]:
    """Energy, as shares of it: the whole span of its oscillation, and the fitted trend over 1000 periods."""
    energy = energy_of(motion) / energy_of(motion)[0] - 1.0
    return float(np.ptp(energy)), float(np.polyfit(motion.time / period, energy, 1)[0] * 1000.0)


@pytest.mark.parametrize(
    ("method", "steps"),
    [
        (Method(1), (250, 500, 1000)),
        (Method(2), (100, 200, 400)),
        (Method(3), (60, 100, 160)),
        (Method(4), (40, 60, 90)),
        (Method(2, "radau"), (200, 400, 800)),
        (Method(3, "radau"), (80, 140, 240)),
    ],
)
def test_error_falls_with_the_stated_order(method: Method, steps: tuple[int, ...]) -> None:
    of = soft_body(2)
    start = MotionState(np.array([1.0, -0.3]), np.array([2.0, 4.0]))
    duration = 0.1
    exact = simulate(of, start, duration, duration / 400, settings=IntegrationSettings(Method(5), tolerance=1e-13)).xy(
        1.0
    )[-1]
    errors = [
        np.linalg.norm(
            simulate(of, start, duration, duration / n, settings=IntegrationSettings(method, tolerance=1e-13)).xy(1.0)[
                -1
            ]
            - exact
        )
        for n in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert -slope == pytest.approx(method.order, abs=0.35)


@pytest.mark.parametrize("family", ["gauss", "radau"])
def test_motion_agrees_with_the_printed_equation(family: str) -> None:
    """Everything at once: k(s), jump of mass, rotary inertia, natural curvature, clamp angle, damping, all actions."""
    of = odd_body(3)
    actions = Actions(
        forces=(AppliedForce(lambda t: (0.1 * np.sin(40.0 * t), 0.2), 0.7), AppliedForce((0.0, -0.1))),
        gravity=(2.0, -9.0),
    )
    start = MotionState(np.array([0.3, -0.4, 0.2]), np.array([3.0, 1.0, -2.0]), time=0.02)
    method = Method(4, family)  # type: ignore[arg-type]
    found = simulate(of, start, 0.06, 5e-4, actions, settings=IntegrationSettings(method, tolerance=1e-12))
    expected = by_the_matrices(of, start, 0.06, actions)
    np.testing.assert_allclose(found.theta[-1], expected[: of.n], atol=2e-8)
    np.testing.assert_allclose(found.rate[-1], expected[of.n :], rtol=1e-6, atol=1e-5)


def test_energy_is_kept_within_a_bounded_oscillation() -> None:
    of, start, period = released()
    motion = simulate(of, start, 25.0 * period, period / 200.0, settings=IntegrationSettings(Method(4)))
    span, trend = drift(motion, period)
    assert span < 1e-6
    assert abs(trend) < 2e-6  # 25 periods tell the trend no better than the oscillation allows


@pytest.mark.slow
def test_energy_over_a_thousand_periods() -> None:
    of, start, period = released(6)
    motion = simulate(of, start, 1000.0 * period, period / 200.0, settings=IntegrationSettings(Method(4)))
    span, trend = drift(motion, period)
    assert span < 1e-6
    assert abs(trend) < 1e-8


def test_larger_steps_than_the_fastest_modes_do_not_blow_up() -> None:
    of = soft_body(10)
    frequency = vibration_of(of, settle(of), count=10).frequency
    start = settle(of, Actions(forces=(AppliedForce((0.0, 0.05)),)))
    step = 0.05 / frequency[0]
    assert step * frequency[-1] > 50.0  # periods of the fastest mode in a step
    keeps = simulate(of, start, 400 * step, step)
    kept = energy_of(keeps)
    assert np.max(np.abs(kept / kept[0] - 1.0)) < 1e-3
    left = energy_of(simulate(of, start, 400 * step, step, settings=IntegrationSettings(Method(3, "radau"))))
    assert np.all(np.diff(left) < 1e-9 * left[0])
    assert left[-1] > 0.9 * left[0]


def test_running_backwards_comes_back_to_the_start() -> None:
    of = odd_body()
    of = replace(of, damping=np.zeros_like(of.damping))
    start = MotionState(np.array([0.5, -0.4, 0.2, 0.1]), np.array([3.0, 1.0, -2.0, 4.0]))
    there = simulate(of, start, 0.2, 1e-3, WEIGHT, settings=IntegrationSettings(tolerance=1e-12))
    back = simulate(
        of,
        MotionState(there.theta[-1], -there.rate[-1]),
        0.2,
        1e-3,
        WEIGHT,
        settings=IntegrationSettings(tolerance=1e-12),
    )
    np.testing.assert_allclose(back.theta[-1], start.theta, atol=1e-8)
    np.testing.assert_allclose(back.rate[-1], -start.rate, atol=1e-5)


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_small_oscillations_have_the_linear_frequencies(mode: int) -> None:
    of = odd_body()
    of = replace(of, damping=np.zeros_like(of.damping))
    rest = settle(of, WEIGHT)
    vibration = vibration_of(of, rest, WEIGHT)
    small = 1e-5 * vibration.shapes[:, mode] / np.max(np.abs(vibration.shapes[:, mode]))
    period = 1.0 / vibration.frequency[mode]
    motion = simulate(of, replace(rest, theta=rest.theta + small), 3.0 * period, period / 60.0, WEIGHT)
    phase = 2.0 * np.pi * motion.time / period
    np.testing.assert_allclose(motion.theta - rest.theta, np.cos(phase)[:, None] * small, atol=2e-9)


def test_logarithmic_decrement_of_kelvin_voigt_damping() -> None:
    """d = eta k damps a small mode of frequency omega with the ratio zeta = eta omega / 2."""
    eta = 1e-3
    of = body(SOFT, Modes(4), damping=Scaled(eta, SOFT.stiffness))
    vibration = vibration_of(of, settle(of))
    omega = 2.0 * np.pi * vibration.frequency[0]
    zeta = 0.5 * eta * omega
    period = 2.0 * np.pi / (omega * np.sqrt(1.0 - zeta**2))
    small = 1e-5 * vibration.shapes[:, 0] / np.max(np.abs(vibration.shapes[:, 0]))
    motion = simulate(of, MotionState(small, np.zeros(4)), 10.0 * period, period / 50.0)
    peaks = motion.theta[::50, 0] / small[0]
    decrement = -np.diff(np.log(peaks))
    np.testing.assert_allclose(decrement, 2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2), rtol=1e-4)


def test_slow_loading_ends_in_the_exact_equilibrium() -> None:
    of = body(ODD, Modes(10), damping=Scaled(0.02, ODD.stiffness))
    force, rise = np.array([-0.1, 0.15]), 2.0

    def ramp(time: float) -> Array:
        return np.asarray(force * (0.5 - 0.5 * np.cos(np.pi * min(time / rise, 1.0))))

    actions = Actions(forces=(AppliedForce(ramp, breaks=(rise,)),))
    motion = simulate(of, settle(of), rise + 1.0, 0.02, actions)
    exact = equilibrium(ODD, push(force)).xy(S)[0]
    np.testing.assert_allclose(motion.xy(S)[-1], exact, atol=1e-6 * ODD.length)


def test_settle_is_the_exact_equilibrium_with_nodes_as_coordinates() -> None:
    actions = Actions(forces=(AppliedForce((-0.1, 0.15)),), gravity=(1.0, -9.0))
    of = body(ODD)
    exact = ODD.equilibrium((-0.1, 0.15), gravity=(1.0, -9.0)).xy(S)
    np.testing.assert_allclose(of.xy(S, settle(of, actions).theta[None])[0], exact, atol=1e-9)


def test_motion_converges_with_the_number_of_modes() -> None:
    def path(n: int) -> Array:
        of = soft_body(n)
        return simulate(of, settle(of, PULL), 0.12, 1e-3).xy(1.0)[:, 0]

    finest = path(12)
    errors = [np.max(np.linalg.norm(path(n) - finest, axis=-1)) for n in (3, 5, 7, 9)]
    assert np.all(np.diff(np.log(errors)) < -0.5)
    assert errors[-1] < 2e-3 * SOFT.length


def test_a_force_that_ends_at_a_break_is_followed_to_full_order() -> None:
    of, at = soft_body(), 0.0333
    kick = Actions(forces=(AppliedForce(lambda t: (0.0, 0.2 if t < at else 0.0), breaks=(at,)),))
    rest = MotionState(np.zeros(4), np.zeros(4))
    whole = simulate(of, rest, 0.1, 3e-4, kick, settings=FINE)
    first = simulate(of, rest, at, 2e-4, Actions(forces=(AppliedForce((0.0, 0.2)),)), settings=FINE)
    second = simulate(of, MotionState(first.theta[-1], first.rate[-1]), 0.1 - at, 2e-4, settings=FINE)
    np.testing.assert_allclose(whole.xy(S)[-1], second.xy(S)[-1], atol=1e-8)
    assert at in whole.time


@pytest.mark.parametrize("tolerance", [1e-3, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_converged_motion_is_as_good_as_it_says(tolerance: float) -> None:
    of = soft_body()
    start = settle(of, PULL)
    found = converged(of, start, 0.2, tolerance=tolerance, step=0.02)
    assert found.error < tolerance
    finest = simulate(of, start, 0.2, found.step / 16.0, settings=IntegrationSettings(Method(4)))
    assert found.time.tolist() == pytest.approx(np.linspace(0.0, 0.2, 11).tolist())  # whatever the halvings
    assert np.max(np.linalg.norm(found.xy(S) - finest.xy(S)[:: 16 * found.steps // 10], axis=-1)) < found.error


def test_states_between_steps_are_interpolated_at_fourth_order() -> None:
    of, start = soft_body(2), MotionState(np.array([1.0, -0.3]), np.zeros(2))
    exact = simulate(of, start, 0.1, 1e-4, settings=FINE)
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        motion = simulate(of, start, 0.1, step, settings=FINE)
        np.testing.assert_allclose(motion.states_at(motion.time), motion.theta, atol=1e-12)
        errors.append(np.max(np.abs(motion.states_at(exact.time) - exact.theta)))
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.3)
    with pytest.raises(MechanicsError, match=r"known from t = 0 s to 0\.1 s"):
        exact.states_at(0.2)


def test_nodes_as_coordinates_move_as_many_modes_do() -> None:
    of = body(SOFT, resolution=Resolution(8))
    many = body(SOFT, Modes(8), resolution=Resolution(8))
    np.testing.assert_allclose(
        simulate(of, settle(of, PULL), 0.05, 1e-3).xy(S),
        simulate(many, settle(many, PULL), 0.05, 1e-3).xy(S),
        atol=1e-9,
    )


def test_steps_that_are_too_long_are_an_error() -> None:
    start = MotionState(np.array([3.0, 1.0, 0.0, 0.0]), np.full(4, 300.0))
    with pytest.raises(MechanicsError, match=r"beyond t = 0 s with steps of 5 s; give a smaller step"):
        simulate(soft_body(), start, 10.0, 5.0)


REST = MotionState(np.zeros(4), np.zeros(4))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: simulate(soft_body(), MotionState(np.zeros(3), np.zeros(4)), 1.0, 0.1), "3.*4"),
        (lambda: simulate(soft_body(), MotionState(np.full(4, np.nan), np.zeros(4)), 1.0, 0.1), "finite"),
        (lambda: simulate(soft_body(), REST, -1.0, 0.1), "positive"),
        (
            lambda: simulate(soft_body(), REST, 1.0, 1e-3, settings=IntegrationSettings(max_steps=10)),
            "1000 steps, more than the 10",
        ),
        (
            lambda: simulate(
                soft_body(), REST, 1.0, 0.1, Actions((AppliedForce(lambda t: (0.0, np.nan if t > 0.5 else 0.0)),))
            ),
            "a force is not finite at t = 0.5",
        ),
        (lambda: simulate(soft_body(), REST, 1.0, 0.1, Actions((AppliedForce((0.0, 1.0, 2.0)),))), "2 numbers"),
        (lambda: Actions((AppliedForce((0.0, 1.0), 1.5),)), r"s in \[0, 1\]"),
        (lambda: Actions(gravity=(0.0, 0.0, -9.81)), "gravity"),
        (lambda: Method(0), "1 to 6 stages"),
        (
            lambda: converged(soft_body(), settle(soft_body(), PULL), 0.1, tolerance=1e-12, step=0.01, halvings=1),
            "still",
        ),
        (
            lambda: settle(soft_body(), Actions(forces=(AppliedForce((-0.5 * np.pi**2 * 0.02 / 0.15, 0.0)),))),
            "not stable",
        ),
    ],
)
def test_what_cannot_be_followed_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        make()


def test_steps_of_mass_are_no_trouble_to_nodes() -> None:
    """A heavy tip on a light beam: nearly one degree of freedom, omega^2 = 3 EI / (m L^3)."""
    tip = 0.02
    light = Steps((0.0, 1.0 - tip, 1.0), (1e-4, 1.0))
    of = body(Beam(1.0, Uniform(1.0), mass_per_length=light), resolution=Resolution(10))
    omega = 2.0 * np.pi * vibration_of(of, settle(of)).frequency[0]
    arm = 1.0 - 0.5 * tip
    assert omega**2 == pytest.approx(3.0 / (tip * arm**3 + 1e-4 * 33.0 / 140.0), rel=2e-3)
