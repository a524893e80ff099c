"""What sensors do to a log: a lag, less on the way back than on the way out, and less than the force where it is
large."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualRecording, observe_virtual, virtual_recording
from onebend.learning.allowances import EVERY_ALLOWANCE, LAG_SD, hysteresis
from onebend.learning.instruments import setup_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Nuisance, Posterior, fit
from onebend.records import Array
from tests.learning.allowances.allowed_bench import course

BEAM = Beam(0.15, Powers((0.05, -0.03)))
PUSH = PushProfile(0.5, before=1.5, rise=2.0, hold=0.4, fall=1.6, after=1.5)
BENCH = VirtualBench(beam=BEAM, push=PUSH, sensor=ForceSensor(rate=100.0, white_sd=0.003), fps=15.0)
S = np.linspace(0.1, 0.9, 9)
LAG, LOOP = 0.3, 0.075  # s; of the force
pytestmark = pytest.mark.usefixtures("no_other_places")


def logged(change: Array, made: VirtualRecording) -> VirtualRecording:
    return replace(made, log=replace(made.log, force=made.log.force + change))


@cache
def recorded(sensor: str) -> VirtualRecording:
    known = VirtualClock(uncertainty=2.0 if sensor == "slow" else 0.0)  # a lag looks like another start
    made = virtual_recording(replace(BENCH, clock=known), seed=4)
    force = PUSH.force(made.log.time - BENCH.clock.offset)
    if sensor == "slow":
        kept = np.exp(-0.01 / LAG)
        return logged(lfilter([1.0 - kept], [1.0, -kept], force, axis=0) - force, made)
    if sensor == "loops":
        grows = np.tanh(20.0 * np.gradient(np.linalg.norm(force, axis=1)) / 0.005)
        return logged(LOOP * grows[:, None] * force, made)
    if sensor == "limited":  # in axes of its own, so that no column stands still
        most = 0.8 * PUSH.peak / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
        return logged(np.minimum(most - 1.0, 0.0) * force, made)
    return made


@cache
def fitted(sensor: str, *without: str) -> Posterior:
    seen = observe_virtual(recorded(sensor))
    return fit([seen], settings=FitSettings(functions=12, allowances=EVERY_ALLOWANCE - set(without)))


def named(found: Posterior, name: str) -> Nuisance:
    return next(n for n in found.nuisances() if n.name.endswith(name))


def error(found: Posterior) -> float:
    """RMS of log k."""
    return float(np.sqrt(np.mean((found.stiffness.log_at(S)[0] - np.log(np.asarray(BEAM.stiffness(S)))) ** 2)))


@pytest.mark.slow
def test_a_slow_sensor_is_found_and_costs_no_stiffness() -> None:
    found = fitted("slow")
    one = named(found, "lag squared")  # its effect is that of a second derivative, of a force that is low-passed
    assert 5.0 * one.sd < one.value < 0.5 * LAG**2
    assert error(found) < 0.8 * error(fitted("slow", "lag"))


@pytest.mark.slow
def test_hysteresis_is_found_and_costs_no_stiffness() -> None:
    found = fitted("loops")
    loop = named(found, "hysteresis of the force").value
    assert loop == pytest.approx(-LOOP, rel=0.2)
    assert found.gain_sd == pytest.approx(abs(loop))  # which branch is right nobody knows
    assert error(found) < 0.5 * error(fitted("loops", "hysteresis"))


@pytest.mark.slow
def test_a_force_that_grows_too_little_is_told() -> None:
    found = fitted("limited")
    assert "force curve" in [one.score.suspect.name for one in found.criticism.alarms]
    assert found.grade == "not to be trusted"


@pytest.mark.slow
def test_a_sensor_without_either_costs_next_to_nothing() -> None:
    found, without = fitted("good"), fitted("good", "lag", "hysteresis")
    assert named(found, "lag squared").value < 0.1 * LAG_SD
    assert abs(named(found, "hysteresis of the force").value) < 0.1 * LOOP
    np.testing.assert_allclose(found.stiffness.log_at(S)[1], without.stiffness.log_at(S)[1], rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["slow", "loops"])
def test_what_the_sensor_does_in_motion_leaves_the_set_up_known(sensor: str) -> None:
    found = fitted(sensor)
    setup = setup_of(found)
    assert setup is not None
    spread = setup.slope @ found.stiffness.covariance @ setup.slope.T + setup.covariance
    assert np.all(np.sqrt(np.diag(spread)) < 2.0 * setup.prior_sd)  # its sizes are chosen by the evidence


def test_hysteresis_turns_where_the_beam_does() -> None:
    push = course()
    one = hysteresis(push)
    assert one is not None
    share = np.sum(one.basis[..., 0] * push.force, axis=1)[:-1] / np.sum(push.force**2, axis=1)[:-1]
    turn = int(np.argmax(push.bend))
    assert np.all(np.diff(share[max(turn - 2, 0) : turn + 3]) < 0.0)
    assert share[turn // 2] > 0.9
    assert share[(turn + len(share)) // 2] < -0.9
    assert np.all(one.basis[-1] == 0.0)
