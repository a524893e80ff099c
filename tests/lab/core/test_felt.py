"""A loop that feels the force: the robot's mistake is put right, as far as the force is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Scaled, Uniform
from onebend.control.loop import (
    Controller,
    ControllerSettings,
    Exposure,
    FeltForce,
    ForceSense,
    LoggedForce,
    Reference,
    believed_share,
    controller,
)
from onebend.control.loop_simulation import (
    Actuator,
    LoopCamera,
    LoopSimulation,
    TrueSystem,
    simulate_loop,
    simulate_range,
)
from onebend.errors import ControlError
from onebend.lab.sensed_force import SensedForce, drawn_tags, felt_by
from onebend.records import Array

BEAM = Beam(0.15, Powers((0.06, -0.04)), mass_per_length=Uniform(0.1))
FORCE = np.array([-0.2, 0.6])
OFF = (0.12, -0.16)  # N, the robot's
BLIND = LoopCamera(noise=0.0, hidden=((0.0, 99.0),))


@cache
def reaching() -> Controller:
    return controller(BEAM, BEAM.equilibrium(FORCE).xy(1.0))


def run(feel: ForceSense | None, *, control: Controller | None = None, truth: Beam = BEAM) -> LoopSimulation:
    system = TrueSystem(truth, damping_ratio=0.2, eye=BLIND, hand=Actuator(bias=OFF))
    return simulate_loop(control or reaching(), system, 4.0, feel=feel)


def known(bias: Array | tuple[float, float] = (0.0, 0.0), sd: float = 1e-3) -> LoggedForce:
    return LoggedForce(np.asarray(bias), sd=sd)


def test_a_force_that_is_felt_is_the_wanted_one_though_the_point_is_never_seen() -> None:
    assert run(None).steady() > 5e-3
    found = run(known())
    np.testing.assert_allclose(found.force[-1], FORCE, atol=1e-3)
    np.testing.assert_allclose(found.asked[-1], FORCE - OFF, atol=1e-3)
    assert found.steady() < 2e-4


def test_a_log_that_is_off_is_believed_as_far_as_its_band_says() -> None:
    """In the end the offset is the share `K` of what is asked for less what is felt."""
    off = np.array([0.05, 0.1])
    sure, unsure = run(known(off)), run(known(off, sd=0.2))
    np.testing.assert_allclose(sure.force[-1], FORCE - off, atol=1e-3)
    np.testing.assert_allclose(unsure.force[-1], FORCE + 0.5 * (np.array(OFF) - off), atol=2e-3)
    np.testing.assert_allclose(believed_share(0.04 * np.eye(2), 0.2), 0.5 * np.eye(2))


def test_what_cannot_be_the_robot_is_not_followed() -> None:
    state = reaching().begin(0.0)
    for i in range(600):
        state, _ = reaching().step(state, None, i / 30.0, felt=FeltForce(np.array([50.0, 0.0]), 1e-6 * np.eye(2)))
    assert np.linalg.norm(state.offset.force) == pytest.approx(0.6, rel=1e-6)  # three of `force_sd`


def test_a_frame_that_tells_nothing_leaves_the_offset() -> None:
    state = reaching().begin(0.0, offset=(0.1, 0.0))
    after, asked = reaching().step(state, None, 0.5, felt=FeltForce(np.full(2, np.nan), np.eye(2)))
    assert after.offset is state.offset
    np.testing.assert_allclose(asked, reaching().step(reaching().begin(0.0), None, 0.5)[1] + [0.1, 0.0])


@pytest.mark.slow
def test_as_much_is_felt_when_the_point_hides_as_when_it_was_on_the_goal() -> None:
    """So a log that is off does no harm then."""
    stiffer = replace(BEAM, stiffness=Scaled(1.2, BEAM.stiffness))
    eye = LoopCamera(noise=0.0, hidden=((3.0, 99.0),))
    system = TrueSystem(stiffer, damping_ratio=0.2, eye=eye, hand=Actuator(bias=OFF))
    found = simulate_loop(reaching(), system, 5.0, feel=known(np.array([0.05, 0.1])))
    assert found.steady() < 1e-3


def test_a_frame_that_shows_the_point_leaves_the_offset_and_remembers_what_is_felt() -> None:
    felt, still = FeltForce(np.array([0.1, 0.0]), 1e-6 * np.eye(2)), np.zeros(2)
    control = replace(reaching(), reference=Reference(still, still, 1.0, np.zeros((2, 2))))
    state = control.begin(0.0)
    for i in range(60):
        state, asked = control.step(state, still, i / 30.0, felt=felt)
    np.testing.assert_array_equal(asked, still)
    np.testing.assert_allclose(state.offset.more, felt.force, atol=1e-4)


def test_an_exposure_shows_the_beam_that_moves() -> None:
    """In the end it stands still: under the force that is on it."""
    shown: list[Exposure] = []

    def look(seen: Exposure) -> None:
        shown.append(seen)

    found = run(look)
    s = np.array([0.3, 1.0])
    shape = BEAM.equilibrium(found.force[-1])
    np.testing.assert_allclose(shown[-1].pose(s), np.column_stack([shape.xy(s), shape.angle(s)]), atol=1e-5)
    np.testing.assert_allclose(shown[-1].force, found.force[-1], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_a_sensed_force_brings_a_beam_of_a_wrong_stiffness_to_the_goal(factor: float) -> None:
    """Which the true force does not: the sensed one is wrong by the same factor as the model's."""
    truth = replace(BEAM, stiffness=Scaled(factor, BEAM.stiffness))
    tags = drawn_tags((0.25, 0.5, 0.75), np.random.default_rng(1))
    sensed = run(SensedForce(BEAM, truth, tags, push_s=1.0), truth=truth)
    assert sensed.steady() < 1e-3
    assert run(known(), truth=truth).steady() > 1e-2


def test_a_hidden_point_hides_its_tag_and_two_others_are_needed() -> None:
    class OneTag:
        tags = (0.5, 1.0)

    with pytest.raises(ControlError, match="fewer than two"):
        felt_by("shape", reaching(), setup=OneTag(), hidden=True)  # type: ignore[arg-type]
    assert felt_by("nothing", reaching()) is None


def test_a_robots_force_is_off_by_a_size() -> None:
    with pytest.raises(ControlError, match="off by a finite size"):
        simulate_range(reaching(), force_off=-0.1)
    with pytest.raises(ControlError, match="sd above zero"):
        ControllerSettings(force_sd=0.0)
