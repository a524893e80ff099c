"""The controller and its margins: exact cases first, then what it must do with bad frames and bounded forces."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Scaled, Uniform
from onebend.control.loop import (
    Controller,
    ControllerSettings,
    Gains,
    Plant,
    RequiredMargins,
    SampledLoop,
    Timing,
    behind_actuator,
    bounded,
    controller,
    frequencies,
    margins,
    phase_margin,
    plant_at,
)
from onebend.errors import ControlError
from onebend.records import Array

BEAM = Beam(0.15, Powers((0.03, -0.02)), mass_per_length=Uniform(0.1))
FORCE = np.array([-0.1, 0.3])
AT_ONCE = Plant(np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.array([[0.2, 0.1], [0.0, 0.05]]))


def inverse_of(one: Plant) -> Array:
    return np.asarray(np.linalg.inv(one.compliance), dtype=float)


INVERSE = inverse_of(AT_ONCE)
SHARP = 1e6  # rad/s, a corner that filters nothing


@cache
def plant() -> Plant:
    return plant_at(BEAM, FORCE)


@cache
def reaching() -> Controller:
    return controller(BEAM, BEAM.equilibrium(FORCE).xy(1.0))


def test_compliance_is_the_slope_of_the_equilibrium() -> None:
    step = 1e-5
    found = [(BEAM.equilibrium(FORCE + d).xy(1.0) - BEAM.equilibrium(FORCE - d).xy(1.0)) for d in step * np.eye(2)]
    np.testing.assert_allclose(plant().compliance, np.array(found).T / (2.0 * step), rtol=1e-6)


def test_a_plant_at_rest_moves_by_its_compliance() -> None:
    linear = behind_actuator(plant(), 0.02)
    np.testing.assert_allclose(-linear.c @ np.linalg.solve(linear.a, linear.b), plant().compliance, rtol=1e-9)


@pytest.mark.parametrize("factor", [0.5, 1.3])
def test_a_stiffer_beam_in_the_same_shape_is_known_exactly(factor: float) -> None:
    """Not only the compliance but all of the loop: the eigenvalues of both are the same."""
    other = plant_at(replace(BEAM, stiffness=Scaled(factor, BEAM.stiffness)), factor * FORCE)
    said = plant().stiffer(factor)
    np.testing.assert_allclose(said.omega, other.omega, rtol=1e-7)
    np.testing.assert_allclose(said.compliance, other.compliance, rtol=1e-7)
    loops = [SampledLoop(one, inverse_of(plant()), Gains(2.0, 10.0), Timing()) for one in (said, other)]
    assert loops[0].radius == pytest.approx(loops[1].radius, abs=1e-9)


@pytest.mark.parametrize(("delay", "limit"), [(0.0, 2.0), (1.0, 1.0), (2.0, 0.618034)])
def test_onset_of_a_beam_without_mass_is_the_textbook_one(delay: float, limit: float) -> None:
    """`z^(m+1) - z^m + rate / fps = 0` leaves the unit circle at 2 sin(pi / (4 m + 2))."""
    loop = SampledLoop(AT_ONCE, INVERSE, Gains(3.0, SHARP), Timing(30.0, delay / 30.0, 0.0))
    assert margins(loop).gain == pytest.approx(limit / 0.1, rel=2e-3)


def test_phase_margin_of_a_slow_integral_is_the_delays() -> None:
    rate, timing = 0.6, Timing(30.0, 0.11, 0.04)
    loop = SampledLoop(AT_ONCE, INVERSE, Gains(rate, 20.0), timing)
    keep = np.exp(-20.0 / timing.fps)
    late = timing.delay + timing.lag + 2.0 * keep / (1.0 - keep) / timing.fps  # holding and summing cancel
    assert phase_margin(loop) == pytest.approx(0.5 * np.pi - rate * late, abs=2e-3)


def test_gain_margin_is_where_a_locus_crosses_the_negative_axis() -> None:
    """Two routes: eigenvalues of the closed loop, and the frequency response of the open one."""
    loop = SampledLoop(plant(), inverse_of(plant()), Gains(2.0, 10.0), Timing(30.0, 0.07, 0.02))
    grid = np.linspace(0.01, 1.0, 20_000) * np.pi * 30.0
    curves = loop.loci(grid)
    crosses = (curves[:-1].imag * curves[1:].imag < 0.0) & (curves[:-1].real < 0.0)
    assert margins(loop).gain == pytest.approx(1.0 / np.max(np.abs(curves[:-1][crosses])), rel=1e-3)


@pytest.mark.slow
@settings(max_examples=3)
@given(st.floats(0.0, 0.12), st.floats(0.3, 2.0))
def test_delay_margin_is_the_onset(delay: float, rate: float) -> None:
    loop = SampledLoop(AT_ONCE, INVERSE, Gains(rate, 8.0), Timing(30.0, delay, 0.02))
    left = margins(loop).delay
    for share, stable in ((0.98, True), (1.02, False)):
        late = replace(loop, timing=replace(loop.timing, delay=delay + share * left))
        assert (late.radius < 1.0) is stable


@pytest.mark.slow
def test_tuned_gains_keep_the_wanted_margins_at_every_stiffness_and_the_longest_delay() -> None:
    control, wanted = reaching(), RequiredMargins()
    late = replace(control.settings.timing, delay=control.settings.longest_delay)
    least_gain, least_phase = np.inf, np.inf
    for factor in (0.7, 1.0, 1.3):
        found = margins(SampledLoop(control.plant.stiffer(factor), control.inverse, control.gains, late))
        least_gain, least_phase = min(least_gain, found.gain), min(least_phase, found.phase)
    assert least_gain > 0.99 * wanted.gain
    assert least_phase > wanted.phase - 0.01
    assert least_gain < 1.5 * wanted.gain or least_phase < 1.3 * wanted.phase  # and not slower than needed
    assert control.margins().softest < 0.5


def test_controller_and_margins_are_of_the_same_recursion() -> None:
    """The frozen controller on a linear plant walks exactly as the matrix says whose eigenvalues are the margins."""
    control = replace(reaching(), settings=ControllerSettings(timing=Timing(30.0, 0.05, 0.02)))
    inverse = control.inverse_at(control.reference.ends, 99.0)
    loop = SampledLoop(control.plant, inverse, control.gains, control.settings.timing)
    linear, frame, small = behind_actuator(loop.plant, 0.02), 1.0 / 30.0, 1e-9
    (a, b), (half_a, half_b) = linear.over(frame), linear.over(0.5 * frame)  # 0.05 s are one frame and a half
    n, rest = len(a), control.reference.position(1e9)
    x, late = np.zeros(n), [small * np.array([1.0, -2.0]), small * np.array([1.0, 1.0])]
    state = replace(control.begin(-100.0), frame_at=-1.0)
    walk = np.concatenate([x, *late[::-1], np.zeros(6)]) / small
    for i in range(40):
        state, force = control.step(state, rest + late.pop(0), i * frame)
        late.append(linear.c @ (half_a @ x + half_b @ state.correction))
        x = a @ x + b @ state.correction
        walk = loop.matrix() @ walk
        np.testing.assert_allclose(walk[-2:], state.correction / small, rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(force, control.reference.ends + state.correction, atol=1e-15)
    assert np.linalg.norm(walk[-2:]) > 1.0


def test_path_begins_and_ends_as_asked() -> None:
    control = reaching()
    state = control.begin(5.0)
    np.testing.assert_allclose(control.step(state, None, 5.0)[1], 0.0, atol=1e-15)
    np.testing.assert_allclose(control.step(state, None, 50.0)[1], FORCE, rtol=1e-6)
    np.testing.assert_allclose(control.reference.position(99.0), control.goal, atol=1e-8)


def test_a_hidden_point_and_no_frame_leave_the_state_as_it_is() -> None:
    control = reaching()
    state, force = control.step(control.begin(0.0), control.goal + 1e-3, 3.0)
    for seen in (None, (np.nan, np.nan), (0.1, np.nan)):
        after, still = control.step(state, seen, 3.5)
        assert after is state
        np.testing.assert_array_equal(still, force)


@settings(max_examples=4)
@given(st.floats(0.02, 1.0), st.integers(1, 20))
def test_the_force_never_leaves_its_bound_and_comes_back_at_once(error: float, frames: int) -> None:
    control = replace(reaching(), settings=ControllerSettings(most_force=0.35))
    state = control.begin(-100.0)
    for i in range(frames):
        state, force = control.step(state, control.goal - error * np.array([0.0, 1.0]), i / 30.0)
        assert np.hypot(*force) <= 0.35 * (1.0 + 1e-12)
    before = np.array(state.correction)
    for i in range(frames, frames + 20):
        state, force = control.step(state, control.goal + error * np.array([0.0, 1.0]), i / 30.0)
    assert (state.correction - before)[1] < 0.0  # however long it was held


def test_twice_the_frames_do_not_double_the_gain() -> None:
    found = []
    for fps in (30.0, 60.0):
        control, state = reaching(), reaching().begin(-100.0)
        for i in range(1, int(0.7 * fps)):
            state, _ = control.step(state, control.goal + 1e-3, i / fps)
        found.append(state.correction)
    np.testing.assert_allclose(found[0], found[1], rtol=0.1)


def test_bounded_keeps_the_direction() -> None:
    np.testing.assert_allclose(bounded(np.array([3.0, 4.0]), 1.0), (0.6, 0.8))
    np.testing.assert_array_equal(bounded(np.array([3.0, 4.0]), 5.0), (3.0, 4.0))


def test_a_beam_without_mass_is_controlled_and_has_no_frequencies() -> None:
    massless = replace(BEAM, mass_per_length=Uniform(0.0))
    control = controller(massless, massless.equilibrium(FORCE).xy(1.0))
    assert len(control.plant.omega) == 0
    assert control.margins().radius < 1.0


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: ControllerSettings(most_force=0.0),
        lambda: ControllerSettings(damping_ratio=1.5),
        lambda: ControllerSettings(rise=np.nan),
        lambda: ControllerSettings(longest_delay=-1.0),
        lambda: Timing(fps=0.0),
        lambda: Timing(delay=np.nan),
        lambda: Gains(-1.0, 3.0),
        lambda: RequiredMargins(gain=1.0),
        lambda: reaching().step(reaching().begin(0.0), (1.0, 2.0, 3.0), 1.0),
        lambda: controller(BEAM, reaching().goal, settings=ControllerSettings(most_force=0.2)),
    ],
)
def test_what_has_no_meaning_is_refused(wrong) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ControlError):
        wrong()


def test_frequencies_end_at_half_the_frame_rate() -> None:
    assert frequencies(Timing(fps=30.0))[-1] == pytest.approx(np.pi * 30.0)
