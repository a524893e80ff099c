"""Virtual recordings: exact without noise, the fit gets k back, every planted error shows where it should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.errors import RecordingError
from onebend.lab.bench import ForceSensor, PushProfile, TagNoise
from onebend.lab.designs import force_that_bends, random_stiffness
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualClock,
    VirtualRecording,
    VirtualTag,
    observe_virtual,
    virtual_recording,
)
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from tests.lab.from_truth import observe_from_truth

pytestmark = pytest.mark.usefixtures("no_other_places")

S = np.linspace(0.05, 0.9, 60)
BEAM = Beam(0.15, random_stiffness("smooth", np.random.default_rng(3)))
PUSH = PushProfile(force_that_bends(BEAM, 1.0, 1.75))
QUIET = TagNoise(white_xy=1e-7, white_angle=1e-5)
TAGS = (VirtualTag(1, 1.0 / 3.0), VirtualTag(2, 2.0 / 3.0), VirtualTag(3, 1.0))


def made(seed: int = 0, **changes: object) -> VirtualRecording:
    bench = replace(VirtualBench(BEAM, PUSH, camera=QUIET), **changes)  # type: ignore[arg-type]
    return virtual_recording(bench, seed=seed)


@pytest.fixture(scope="module")
def plain() -> VirtualRecording:
    return made()


def test_tags_ride_on_the_exact_equilibrium(plain: VirtualRecording) -> None:
    shape = BEAM.equilibrium(PUSH.force(plain.markers.time))
    np.testing.assert_allclose(plain.pose[..., :2], shape.xy(plain.markers.s), atol=1e-9)
    np.testing.assert_allclose(plain.pose[..., 2], shape.angle(plain.markers.s), atol=1e-7)


def test_a_push_rests_rises_and_turns() -> None:
    time = np.linspace(0.0, PUSH.duration, 500)
    force = PUSH.force(time)
    begin, end = PUSH.contact
    assert np.all(force[(time <= begin) | (time >= end)] == 0.0)
    assert np.max(np.linalg.norm(force, axis=1)) == pytest.approx(PUSH.peak, rel=1e-6)
    angle = np.arctan2(force[:, 1], force[:, 0])[np.linalg.norm(force, axis=1) > 1e-6]
    assert np.ptp(angle) == pytest.approx(PUSH.turn, rel=0.05)


def test_without_noise_the_whole_way_gives_force_clock_and_stiffness_back(plain: VirtualRecording) -> None:
    late = replace(plain.bench, clock=VirtualClock(250.0, 250.8), sensor=ForceSensor(bias=(0.2, -0.1)))
    seen = observe_virtual(virtual_recording(late, seed=0))
    assert seen.source.clock is not None
    assert seen.source.clock.offset == pytest.approx(250.0, abs=0.005)
    np.testing.assert_allclose(seen.force, PUSH.force(seen.time - 250.0), atol=0.01 * PUSH.peak)
    found = fit([seen], 0.03, settings=FitSettings(functions=16, most_frames=80, first_frames=40))
    np.testing.assert_allclose(found.band(S).k, BEAM.stiffness(S), rtol=0.03)


@pytest.mark.slow
def test_the_shortcut_agrees_with_the_whole_way() -> None:
    one = made(sensor=ForceSensor(white_sd=0.01 * PUSH.peak))
    quick, whole = observe_from_truth(one), observe_virtual(one)
    assert len(quick.time) == len(whole.time)
    np.testing.assert_allclose(quick.xy, whole.xy, atol=1e-6)
    np.testing.assert_allclose(quick.force, whole.force, atol=0.03 * PUSH.peak)


def test_the_shortcut_takes_a_given_error(plain: VirtualRecording) -> None:
    error = 0.01 * np.ones_like(plain.force)
    quick = observe_from_truth(plain, error=error, clock_error=0.02, clock_sd=0.03)
    np.testing.assert_allclose(quick.force, plain.force + error)
    np.testing.assert_allclose(quick.time - 250.0, plain.markers.time + 0.02)
    with pytest.raises(RecordingError, match="its error is"):
        observe_from_truth(plain, error=error[:-1])


def test_displaced_tags_and_base_are_where_they_are_said_to_be(plain: VirtualRecording) -> None:
    moved = (
        VirtualTag(1, 1.0 / 3.0, along=1e-3),
        VirtualTag(2, 2.0 / 3.0, across=-5e-4, turn=0.02),
        VirtualTag(3, 1.0, along=2e-3),
    )
    off = made(tags=moved)
    rest = off.pose[0]
    np.testing.assert_allclose(rest[:, 0], [0.051, 0.1, 0.152], atol=1e-9)
    np.testing.assert_allclose(rest[:, 1:], [[0.0, 0.0], [-5e-4, 0.02], [0.0, 0.0]], atol=1e-9)
    bent = BEAM.equilibrium(PUSH.force(off.markers.time))
    np.testing.assert_allclose(off.pose[:, 0, :2], bent.xy(1.0 / 3.0 + 1e-3 / 0.15), atol=1e-9)
    seen = made(base=(1e-3, -2e-3, 0.03)).markers
    cos, sin = np.cos(0.03), np.sin(0.03)
    back = seen.xy @ np.array([[cos, sin], [-sin, cos]]) + np.array([1e-3, -2e-3])
    np.testing.assert_allclose(back, plain.pose[..., :2], atol=1e-6)


def test_camera_and_sensor_draw_from_streams_of_their_own() -> None:
    noisy = ForceSensor(white_sd=0.01)
    first, again = made(7, sensor=noisy), made(7, sensor=replace(noisy, white_sd=0.02))
    np.testing.assert_array_equal(first.markers.xy, again.markers.xy)
    np.testing.assert_array_equal(first.log.force, made(7, sensor=noisy).log.force)
    assert not np.array_equal(first.markers.xy, made(8, sensor=noisy).markers.xy)


def test_what_is_said_may_be_wrong() -> None:
    wrong = made(declared=DeclaredValues(length=0.16, push_s=0.9, placement_sd=1e-4, rest="unknown")).recording
    assert (wrong.beam.length, wrong.beam.rest, wrong.tags.placement_sd) == (0.16, "unknown", 1e-4)
    assert wrong.push is not None
    assert wrong.push.at == 0.9


def test_pushes_that_cannot_be_are_refused() -> None:
    with pytest.raises(RecordingError, match="rise"):
        PushProfile(1.0, rise=0.0)
    with pytest.raises(RecordingError, match="acts at"):
        PushProfile(1.0, at_s=0.0)
    with pytest.raises(RecordingError, match="frame rate"):
        made(fps=0.0)
