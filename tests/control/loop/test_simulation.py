"""The closed loop in full motion: a beam that is not the model, a camera that is late, noisy and at times blind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Profile, Scaled, Table, Uniform
from onebend.control.loop import (
    Controller,
    ControllerSettings,
    Gains,
    SampledLoop,
    Timing,
    controller,
    margins,
    plant_at,
)
from onebend.control.loop_simulation import Actuator, LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.records import Array

BEAM = Beam(0.15, Powers((0.03, -0.02)), mass_per_length=Uniform(0.1))
FORCE = np.array([-0.1, 0.3])
GOAL = BEAM.equilibrium(FORCE).xy(1.0)
BAD = LoopCamera(delay=0.1, jitter=0.01, noise=1e-4, dropped=0.1)
S = np.linspace(0.0, 1.0, 201)


def wrong_by(share: Array) -> Profile:
    return Table(tuple(S.tolist()), tuple((BEAM.stiffness(S) * (1.0 + 0.3 * share)).tolist()))


WRONG = {
    "softer": Scaled(0.7, BEAM.stiffness),
    "stiffer": Scaled(1.3, BEAM.stiffness),
    "softer tip": wrong_by(1.0 - 2.0 * S),
    "softer base": wrong_by(2.0 * S - 1.0),
    "waves": wrong_by(np.sin(4.0 * np.pi * S)),
}


@cache
def reaching() -> Controller:
    return controller(BEAM, GOAL)


def with_only(feedforward: bool, feedback: bool) -> Controller:
    return replace(reaching(), settings=ControllerSettings(feedforward=feedforward, feedback=feedback))


def test_open_loop_ends_at_the_equilibrium_of_the_true_beam() -> None:
    other = replace(BEAM, stiffness=WRONG["stiffer"])
    found = simulate_loop(with_only(True, False), TrueSystem(other, damping_ratio=0.3), 2.5)
    np.testing.assert_allclose(found.xy[-1], other.equilibrium(FORCE).xy(1.0), atol=1e-6)
    assert found.steady() > 5e-3


@pytest.mark.slow
def test_with_the_true_model_the_feedback_has_nothing_to_do() -> None:
    found = simulate_loop(reaching(), TrueSystem(BEAM, eye=LoopCamera(noise=0.0)), 3.0)
    assert found.steady() < 1e-4
    assert np.max(np.linalg.norm(found.asked - FORCE, axis=1)[found.time > 1.5]) < 0.05 * np.linalg.norm(FORCE)


SLOW = ("softer", "softer tip", "waves")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in WRONG])
def test_error_goes_where_k_is_wrong_and_the_camera_bad(name: str) -> None:
    truth = TrueSystem(replace(BEAM, stiffness=WRONG[name]), eye=BAD)
    assert simulate_loop(reaching(), truth, 6.0, seed=3).steady() < 5e-4


@pytest.mark.slow
def test_both_settle_sooner_than_feedback_alone_and_open_loop_never() -> None:
    truth = TrueSystem(replace(BEAM, stiffness=WRONG["softer"]), eye=LoopCamera(delay=0.06))
    both, alone, never = (
        simulate_loop(with_only(*what), truth, 5.0).settled(1e-3)
        for what in ((True, True), (False, True), (True, False))
    )
    assert both < alone < 4.0
    assert np.isinf(never)


def test_what_only_passes_the_goal_in_the_end_has_not_settled() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    none = np.zeros((len(time), 2))

    def near_from(begin: float) -> LoopSimulation:
        away = np.where(time < begin, 5e-3, 1e-4)
        return LoopSimulation(
            np.zeros(2), time, np.column_stack([away, 0.0 * away]), none, none, np.zeros((len(time), 0, 2))
        )

    ends_near, stays = near_from(3.9), near_from(2.5)
    assert ends_near.steady() == 5e-3
    assert np.isinf(ends_near.settled(1e-3))
    assert stays.settled(1e-3) == pytest.approx(2.5)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", ["softer", "softer tip"])
def test_stated_gain_margin_is_where_the_true_beam_begins_to_ring(stiffness: str) -> None:
    """Margins of the linear sampled loop about the true working point, against full motion of the true beam."""
    other, timing = replace(BEAM, stiffness=WRONG[stiffness]), Timing(30.0, 0.08, 0.02)
    truth = TrueSystem(other, eye=LoopCamera(delay=0.08, noise=0.0))
    held = simulate_loop(reaching(), truth, 8.0).asked[-1]  # the force with which the true beam stands at the goal
    loop = SampledLoop(plant_at(other, held), reaching().inverse_at(held, 99.0), reaching().gains, timing)
    onset = margins(loop).gain * reaching().gains.rate
    grown = []
    for share in (0.9, 1.1):
        fast = replace(
            reaching(),
            gains=replace(reaching().gains, rate=share * onset),
            reference=replace(reaching().reference, ends=held, rise=3.0),
            settings=ControllerSettings(timing=timing),
        )
        found = simulate_loop(fast, truth, 7.0)
        off = np.linalg.norm(found.xy - GOAL, axis=1)
        grown.append(np.max(off[found.time > 6.0]) / np.max(off[(found.time > 3.5) & (found.time < 4.5)]))
    assert grown[0] < 1.0 < grown[1]


def test_hidden_frames_hold_the_force_and_the_loop_goes_on() -> None:
    truth = TrueSystem(replace(BEAM, stiffness=WRONG["softer"]), eye=LoopCamera(hidden=((1.2, 2.4),)))
    found = simulate_loop(reaching(), truth, 5.0)
    blind = found.asked[(found.time > 1.3) & (found.time < 2.4)]
    assert np.ptp(blind, axis=0).max() == 0.0
    assert found.steady() < 5e-4


@pytest.mark.slow
def test_a_robot_with_a_wrong_gain_and_a_bias_is_corrected_too() -> None:
    found = simulate_loop(reaching(), TrueSystem(BEAM, hand=Actuator(0.03, 0.9, (0.03, -0.02))), 5.0)
    assert found.steady() < 5e-4


@pytest.mark.slow
def test_bounded_force_leaves_an_error_and_nothing_winds_up() -> None:
    bound = ControllerSettings(most_force=1.1 * float(np.linalg.norm(FORCE)))
    control = replace(reaching(), settings=bound)
    found = simulate_loop(control, TrueSystem(replace(BEAM, stiffness=WRONG["stiffer"])), 4.0)
    assert np.linalg.norm(found.asked, axis=1).max() <= bound.most_force * (1.0 + 1e-12)
    assert found.steady() > 1e-3


def test_a_seed_repeats_itself() -> None:
    truth = TrueSystem(BEAM, eye=BAD)
    first, again, other = (simulate_loop(reaching(), truth, 0.5, seed=seed).asked for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_gains_given_are_kept() -> None:
    given = Gains(1.0, 5.0)
    assert controller(BEAM, GOAL, settings=ControllerSettings(gains=given)).gains == given
