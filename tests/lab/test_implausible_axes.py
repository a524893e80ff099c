"""A force whose axes or sign are not as written: every such reading is refused or in doubt, and the line is named."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from onebend.errors import ObservationError
from onebend.lab.bench import PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualRecording, observe_virtual, virtual_recording
from onebend.recording.beam_frame import RestShape
from onebend.recording.force_axes import READINGS, Reading, axes_words, read_force
from onebend.recording.tracks import angles_per_chord, check_angles
from onebend.records import Array, Markers, Observations
from tests.made_up import BEAM

LINE = {
    "opposite": "acts_on",
    "x and y swapped": "exchange the two forces in columns",
    "x and y swapped and both of opposite sign": "columns, and give acts_on",
    "x of opposite sign": "give the x force the opposite sign",
    "y of opposite sign": "give the y force the opposite sign",
    "turned by +90 deg": "correct rotation_deg",
    "turned by -90 deg": "correct rotation_deg",
}


@pytest.fixture(scope="module")
def pushed() -> VirtualRecording:
    push = PushProfile(force_that_bends(BEAM, 1.0, 1.75), direction=radians(117.0))
    return virtual_recording(VirtualBench(beam=BEAM, push=push, clock=VirtualClock(uncertainty=0.0)), seed=0)


@pytest.fixture(scope="module")
def seen(pushed: VirtualRecording) -> Observations:
    return observe_virtual(pushed)


def read(o: Observations, axes: Array, late: float = 0.0) -> Reading:
    """The force of `o` with other axes, on a clock that is `late` [s] off."""
    force = np.stack([np.interp(o.time - late, o.time, column) for column in (o.force @ axes.T).T], axis=1)
    markers = Markers(o.time, o.tag_id, o.marker_s, o.xy, o.angle, o.covariance, np.zeros(len(o.time)), None)
    rest = RestShape(o.rest_xy, o.rest_angle, o.rest_covariance)
    found = read_force(markers, rest, force, o.push_s, o.loaded)
    assert found is not None
    return found


@pytest.mark.parametrize("late", [0.0, 0.2])
@pytest.mark.parametrize("how", LINE)
def test_every_wrong_sign_or_axis_is_named_with_its_line(seen: Observations, how: str, late: float) -> None:
    found = read(seen, READINGS[how].T, late)
    text = axes_words(found, 0.0)
    assert found.better == how
    assert "The force fits the bending far better" in text
    assert LINE[how] in text


def test_a_right_log_is_not_accused(seen: Observations) -> None:
    for found in (read(seen, np.eye(2)), read(seen, np.eye(2), 0.2)):
        assert found.better == ""
        assert not found.rotated
        assert not found.impossible


@pytest.mark.slow
def test_two_exchanged_axes_of_the_opposite_sign_put_k_in_doubt(pushed: VirtualRecording) -> None:
    log = replace(pushed.log, force=-pushed.log.force[:, ::-1])
    said = [one.text for one in observe_virtual(replace(pushed, log=log)).source.remarks if one.doubt]
    assert len(said) == 1
    assert "exchange the two forces in columns, and give acts_on the other value" in said[0]


def reading(turned: float = 1.0, **shares: float) -> Reading:
    return Reading(
        dict.fromkeys(READINGS, 1.0) | {name.replace("_", " "): share for name, share in shares.items()}, 0.3, turned
    )


def test_noise_that_all_readings_share_is_no_better_reading() -> None:
    both = "x and y swapped and both of opposite sign"
    assert reading(0.002, as_it_is=0.012, **{both: 0.0005}).better == both
    assert reading(0.02, as_it_is=0.022, **{both: 0.007}).better == ""
    assert reading(0.0001, as_it_is=0.003, **{both: 0.0005}).better == ""  # an error of the push's place does as much
    turned = reading(0.0004, as_it_is=0.1, **{"turned by +90 deg": 0.02})
    assert (turned.better, turned.rotated) == ("", True)


def test_bags_are_told_of_axes() -> None:
    swapped = reading(as_it_is=1.0, **{"x and y swapped": 0.001})
    assert axes_words(swapped, 0.0, key="axes").endswith("In [force], exchange the two forces in axes.")
    mirrored = reading(as_it_is=0.5, **{"x of opposite sign": 0.001})
    assert axes_words(mirrored, radians(30.0)).endswith("or exchange both in columns and set rotation_deg to 120.")


@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_other_way_to_mend_a_sign_is_the_same(axis: str) -> None:
    force, rotation = np.array([[0.3, 0.7], [-0.2, 0.4]]), radians(30.0)

    def turned(by: float) -> Array:
        return np.array([[np.cos(by), -np.sin(by)], [np.sin(by), np.cos(by)]])

    text = axes_words(reading(as_it_is=0.5, **{f"{axis} of opposite sign": 0.001}), rotation)
    fits = radians(float(text.split(" to ")[-1].rstrip(".")))
    negated = force * ([-1.0, 1.0] if axis == "x" else [1.0, -1.0])
    assert force[:, ::-1] @ turned(fits).T == pytest.approx(negated @ turned(rotation).T)


def bent() -> tuple[Array, Array, Array]:
    """Arcs of growing curvature: places (T, 3, 2) m, s (3,), angles (T, 3) rad."""
    s, bend = np.array([0.3, 0.6, 1.0]), np.linspace(1e-6, 1.0, 20)[:, None]
    places = np.stack([np.sin(bend * s) / bend, (1.0 - np.cos(bend * s)) / bend], axis=-1)
    return 0.15 * places, s, bend * s


def test_angles_that_turn_against_the_places_are_refused() -> None:
    xy, s, angle = bent()
    assert angles_per_chord(xy, s, angle) == pytest.approx(1.0, abs=0.05)
    check_angles(xy, s, angle, "right")
    check_angles(xy, s, angle + 0.4, "markers turned on the beam")
    check_angles(xy, s, np.full_like(angle, np.nan), "no angles")
    check_angles(xy[:2], s, -angle[:2], "not bent")
    with pytest.raises(ObservationError, match=r"turns the other way.*sign or the unit of angle_rad"):
        check_angles(xy, s, -angle, "mirrored")
    with pytest.raises(ObservationError, match=r"57 times as far"):
        check_angles(xy, s, np.degrees(angle), "degrees")


def robot_log(pushed: VirtualRecording, error: tuple[float, float]) -> VirtualRecording:
    """The push in a log that is off by `error` [N] while the load grows, and right before and after."""
    begin, _ = pushed.bench.push.contact
    when = pushed.log.time - pushed.bench.clock.offset
    rising = (when > begin + 0.3) & (when < begin + pushed.bench.push.rise)
    return replace(pushed, log=replace(pushed.log, force=pushed.log.force + rising[:, None] * np.array(error)))


@pytest.mark.slow
def test_an_error_that_comes_with_the_load_is_no_turn_of_the_axes(pushed: VirtualRecording) -> None:
    peak = pushed.bench.push.peak
    seen = observe_virtual(robot_log(pushed, (0.8 * peak, 0.3 * peak)))
    said = [one for one in seen.source.remarks if one.about == "axes"]
    assert [one.doubt for one in said] == [False]
    assert "Or it is the sensor's own error, which changes with the load" in said[0].text


def test_axes_that_are_merely_turned_are_in_doubt(pushed: VirtualRecording) -> None:
    cos, sin = np.cos(radians(70.0)), np.sin(radians(70.0))
    turned = pushed.log.force @ np.array([[cos, sin], [-sin, cos]])
    said = observe_virtual(replace(pushed, log=replace(pushed.log, force=turned))).source.remarks
    assert [one.doubt for one in said if one.about == "axes"] == [True]
    assert not any("sensor's own error" in one.text for one in said)
