"""From markers and log to observations: one clock, one frame, and mistakes that are named."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import ObservationError, RecordingError
from onebend.recording.beam_frame import (
    BaseLog,
    base_clock,
    beam_turn,
    gravity_in_frame,
    read_base_log,
    rest_shape,
    to_beam_frame,
    turned,
)
from onebend.recording.entries import (
    BeamEntry,
    ForceEntry,
    GravityEntry,
    PushEntry,
    Recording,
    TagEntry,
    TagsEntry,
    VideoEntry,
)
from onebend.recording.observe import ObserveSettings, assemble
from onebend.recording.plane import project
from onebend.records import GAIN_SD, ForceLog, Observations, View
from tests.made_up import LENGTH, MARKER_S, TAGS
from tests.recording.pushed import Pushed

PUSHED = Pushed()
ROUGHLY = VideoEntry(Path("video.mp4"), start=249.4, start_uncertainty=2.0)


def recording(**changes: object) -> Recording:
    """What the folder of `PUSHED` would say."""
    tags = tuple(TagEntry(int(i), float(s)) for i, s in zip(TAGS, MARKER_S, strict=True))
    whole = Recording(
        folder=Path("bench"),
        name="bench",
        beam=BeamEntry(LENGTH, mass=0.07),
        tags=TagsEntry(size=0.012, on_base=(TagEntry(0, 0.0),), on_beam=tags),
        camera=None,
        video=VideoEntry(Path("video.mp4"), start=PUSHED.offset, start_uncertainty=0.0),  # which nothing searches for
        force=ForceEntry(Path("force.csv")),
        push=PushEntry(at=1.0),
        gravity=None,
    )
    return replace(whole, **changes)  # type: ignore[arg-type]


@cache
def plain() -> Observations:
    """`PUSHED` as it is."""
    return observed()


def observed(log: ForceLog | None = None, rec: Recording | None = None, **settings: object) -> Observations:
    given = ObserveSettings(**settings)  # type: ignore[arg-type]
    return assemble(rec or recording(), PUSHED.markers(), log or PUSHED.log(), None, given)


def test_force_and_markers_meet_on_one_clock() -> None:
    found = observed(rec=recording(video=ROUGHLY))
    assert found.source.clock is not None
    assert found.source.clean_force is not None
    assert found.time - found.source.clock.offset == pytest.approx(PUSHED.markers().time[found.frame])
    wrong = found.force - PUSHED.true_force(found.time - PUSHED.offset)
    assert np.sqrt(np.mean(wrong**2)) < 0.015
    assert np.all(np.isfinite(found.force))
    assert np.all(found.push_s == 1.0)
    assert 120 < found.loaded.sum() < 160
    assert np.all(found.gravity == 0)
    assert found.rest_angle == pytest.approx(np.zeros(3), abs=math.radians(0.2))


@pytest.mark.slow
def test_the_beam_defines_the_frame_not_the_base_tag() -> None:
    straight = plain()
    turn = math.radians(1.5)
    skew = assemble(recording(), PUSHED.markers(turn=turn), PUSHED.log(), None, ObserveSettings())
    assert skew.xy == pytest.approx(straight.xy, abs=4e-5)  # the tag's own direction still counts a little
    assert skew.angle == pytest.approx(straight.angle, abs=3e-4)
    assert any("base tag is turned by 1.5 deg" in remark.text for remark in skew.source.remarks)


@pytest.mark.slow
def test_forces_of_opposite_sign_are_named() -> None:
    log = PUSHED.log()
    with pytest.raises(ObservationError, match=r"opposite sign.*acts_on"):
        observed(replace(log, force=-log.force))
    found = observed(replace(log, force=-log.force), check_force=False)
    assert any("opposite sign" in r.text and r.level == "warning" and r.doubt for r in found.source.remarks)
    assert not any("force looks" in r.text or r.doubt for r in plain().source.remarks)


@pytest.mark.slow
def test_a_film_at_a_wrong_rate_is_told_to_look_at_it() -> None:
    slow = replace(PUSHED.markers(), time=3.0 * PUSHED.markers().time)
    with pytest.raises(ObservationError, match=r"frame rate is wrong \(by it the film lasts"):
        assemble(recording(), slow, PUSHED.log(), None, ObserveSettings())


@pytest.mark.slow
def test_where_frames_were_lost_and_closed_up_not_only_the_axes_are_suspected() -> None:
    short = replace(PUSHED.markers(), time=0.85 * PUSHED.markers().time)
    remarks = assemble(recording(video=ROUGHLY), short, PUSHED.log(), None, ObserveSettings()).source.remarks
    (remark,) = (one for one in remarks if one.about == "axes")
    assert "the film lasts 6.77 s), or frames are missing" in remark.text


@pytest.mark.slow
def test_a_wrong_start_is_not_taken_for_wrong_axes() -> None:
    for start in (246.5, 254.5):
        video = VideoEntry(Path("video.mp4"), start=start, start_uncertainty=1.0)
        with pytest.raises(ObservationError, match=r"fits it from 250\.\d\d s on. Correct start_s"):
            observed(rec=recording(video=video))


@pytest.mark.slow
def test_a_swap_is_named_in_the_axes_of_the_log() -> None:
    log = PUSHED.log()
    entry = ForceEntry(Path("force.csv"), rotation=math.radians(30))
    cos, sin = math.cos(entry.rotation), math.sin(entry.rotation)
    sensed = (log.force @ np.array([[cos, -sin], [sin, cos]]))[:, ::-1].copy()
    with pytest.raises(ObservationError, match="x and y swapped"):
        observed(replace(log, force=sensed), recording(force=entry))


def test_what_is_said_of_the_tags_turns_is_carried_along() -> None:
    whole = recording()
    stated = replace(whole, tags=replace(whole.tags, turn_sd=0.05))
    assert observed(rec=stated).stated.turn_sd == 0.05
    assert plain().stated.turn_sd == pytest.approx(math.radians(1.5))


def test_robot_and_rotation_are_undone() -> None:
    log = PUSHED.log()
    entry = ForceEntry(Path("force.csv"), rotation=math.radians(30), acts_on="robot", gain_sd=0.03)
    axes = np.array(
        [[math.cos(entry.rotation), math.sin(entry.rotation)], [-math.sin(entry.rotation), math.cos(entry.rotation)]]
    )
    found = observed(replace(log, force=-log.force @ axes.T), recording(force=entry))
    assert found.force == pytest.approx(plain().force, abs=0.003)
    assert (found.stated.gain_sd, plain().stated.gain_sd) == (0.03, GAIN_SD)  # 2 % where it is not declared


def test_no_overlap_names_both_spans() -> None:
    video = VideoEntry(Path("video.mp4"), start=500.0, start_uncertainty=1.0)
    with pytest.raises(ObservationError, match=r"500\.0 to 508\.0 s.*249\.1 to 259\.\d s.*overlap"):
        observed(rec=recording(video=video))


def test_frames_outside_the_log_are_left_out() -> None:
    log = PUSHED.log()
    early = log.time < PUSHED.offset + 6.0
    found = observed(replace(log, time=log.time[early], force=log.force[early]))
    assert 175 <= len(found.time) <= 181
    assert any("outside the force log" in remark.text for remark in found.source.remarks)


def test_nearest_pairs_within_epsilon_only() -> None:
    log = PUSHED.log()
    rows = np.arange(0, len(log.time), 8)  # 25 Hz against 30 frames per second
    thin = replace(log, time=log.time[rows], force=log.force[rows])
    all_frames = observed(thin)
    near = observed(thin, epsilon=0.01)
    assert len(all_frames.time) == 240
    assert 80 < len(near.time) < 160
    assert near.source.clean_force is not None
    away = np.abs(near.time[:, None] - near.source.clean_force.time).min(axis=1)
    assert away.max() <= 0.01
    assert np.all(np.isin(near.force[:, 0], near.source.clean_force.force[:, 0]))


def test_hidden_tags_stay_missing_and_empty_frames_go() -> None:
    markers = PUSHED.markers()
    xy, angle = markers.xy.copy(), markers.angle.copy()
    xy[100, 1], angle[100, 1] = np.nan, np.nan
    xy[120], angle[120] = np.nan, np.nan
    found = assemble(recording(), replace(markers, xy=xy, angle=angle), PUSHED.log(), None, ObserveSettings())
    assert 120 not in found.frame
    row = int(np.flatnonzero(found.frame == 100)[0])
    assert np.isnan(found.xy[row, 1]).all()
    assert np.isfinite(found.xy[row, [0, 2]]).all()


def test_without_a_log_the_force_is_zero_and_nothing_is_loaded() -> None:
    found = assemble(recording(force=None, push=None), PUSHED.markers(), None, None, ObserveSettings())
    assert np.all(found.force == 0)
    assert np.isnan(found.push_s).all()
    assert not found.loaded.any()
    assert found.source.clean_force is None
    assert found.stated.gain_sd == 0.0


def test_push_place_from_the_log() -> None:
    log = PUSHED.log()
    places = np.linspace(0.5, 1.0, len(log.time))
    found = observed(replace(log, push_s=places), recording(push=PushEntry(column="where")), check_force=False)
    assert found.push_s == pytest.approx(np.interp(found.time, log.time, places), abs=1e-9)


def test_turn_of_the_beam_is_least_squares_with_the_base_tag() -> None:
    rest = rest_shape(PUSHED.markers(turn=0.02), np.arange(240) < 30)
    assert beam_turn(rest, 5e-4) == pytest.approx(-0.02, abs=1e-3)
    # One tag at hand's breadth that may sit anywhere within 10 mm says little against the base tag's 2 deg.
    loose = replace(rest, xy=rest.xy[:1], angle=rest.angle[:1], covariance=rest.covariance[:1])
    assert abs(beam_turn(loose, 0.01)) < 0.2 * 0.02


def test_a_turned_frame_is_seen_at_the_same_pixels() -> None:
    markers = PUSHED.markers()
    view = View(
        np.array([[1000.0, 0, 640], [0, 1000, 360], [0, 0, 1]]), np.zeros(5), np.diag([1.0, -1.0, -1.0]),
        np.array([-0.05, 0.02, 0.4]), True, 0.1,
    )  # fmt: skip
    other = turned(replace(markers, view=view), 0.3)
    assert other.view is not None
    assert project(other.view, other.xy[50]) == pytest.approx(project(view, markers.xy[50]))
    assert np.trace(other.covariance[0, 0]) == pytest.approx(np.trace(markers.covariance[0, 0]))


def test_rest_covariance_is_that_of_the_mean() -> None:
    means = []
    for seed in range(40):
        rest = rest_shape(Pushed(seed=seed).markers(), np.arange(240) < 40)
        means.append(np.concatenate([rest.xy, rest.angle[:, None]], axis=1))
    scatter = np.var(means, axis=0)
    claimed = np.diagonal(rest.covariance, axis1=1, axis2=2)
    assert 0.3 < np.median(scatter / claimed) < 1.5


def test_gravity_of_a_hanging_and_of_a_level_beam() -> None:
    markers = Pushed(film=1.0).markers()
    down = math.radians(-90)
    hanging = GravityEntry(down, base_angle=down)
    level = GravityEntry(down, base_angle=0.0)
    upright = GravityEntry(down, base_angle=math.radians(90))
    for entry, expected in ((hanging, (9.81, 0.0)), (level, (0.0, -9.81)), (upright, (-9.81, 0.0))):
        found = gravity_in_frame(entry, None, markers, markers.time)
        assert found == pytest.approx(np.broadcast_to(expected, found.shape), abs=1e-9)
    assert np.all(gravity_in_frame(None, None, markers, markers.time) == 0)


def test_weight_leaves_no_undeformed_frame_unless_the_beam_hangs() -> None:
    markers = PUSHED.markers(turn=0.03)
    still = np.arange(240) < 30
    level, hanging = (np.broadcast_to(g, (240, 2)) for g in ((0.0, -9.81), (9.81, 0.0)))
    kept, rest, remarks = to_beam_frame(markers, still, 5e-4, level)
    assert np.array_equal(kept.xy, markers.xy)
    assert np.isnan(rest.xy).all()
    assert "Weight" in remarks[0].text
    kept, rest, _ = to_beam_frame(markers, still, 5e-4, hanging)
    assert np.abs(rest.xy[:, 1]).max() < 1e-4


def turning_base() -> tuple[BaseLog, np.ndarray]:
    time = np.arange(0.0, 12.0, 0.1)
    return BaseLog(time + 100.0, 0.8 * np.sin(time)), time


def test_clock_from_the_base() -> None:
    log, _ = turning_base()
    markers = PUSHED.markers()
    seen = 0.8 * np.sin(markers.time + 1.7) - 0.8 * np.sin(1.7)
    clock = base_clock(replace(markers, base_angle=seen), log, 101.0, 2.0)
    assert clock.found
    assert clock.offset == pytest.approx(101.7, abs=0.005)
    assert not base_clock(markers, log, 101.0, 2.0).found


def test_base_log_errors_name_the_line(tmp_path: Path) -> None:
    path = tmp_path / "base.csv"
    for text, words in (
        ("time_s,deg\n0,1\n", "base_deg"),
        ("time_s,base_deg\n0,1\n1,x\n", "line 3"),
        ("time_s,base_deg\n0,1\n0,2\n", "line 3"),
        ("time_s,base_deg\n0,1\n", "at least 2"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(RecordingError, match=words):
            read_base_log(path)
    path.write_text("time_s,base_deg\n0,-90\n1,90\n", encoding="utf-8")
    assert read_base_log(path).angle == pytest.approx([-math.pi / 2, math.pi / 2])


def test_a_beam_that_bends_beyond_the_push_is_doubted() -> None:
    said = [one for one in observed(rec=recording(push=PushEntry(at=0.3))).source.remarks if one.doubt]
    assert ["beyond the push" in one.text and "at_s" in one.text for one in said] == [True]
    assert not [one for one in plain().source.remarks if one.doubt]


def test_a_log_of_two_rows_a_second_keeps_its_peak() -> None:
    log = PUSHED.log()
    few = ForceLog(log.time[::100], log.force[::100])
    found = np.linalg.norm(observed(few).force, axis=1).max()
    assert found == pytest.approx(np.linalg.norm(plain().force, axis=1).max(), rel=0.1)
