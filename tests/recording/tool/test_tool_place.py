"""The place at which a tool is seen to touch the beam; and what is no tool is not seen."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from onebend.recording import tool
from onebend.recording.entries import PushEntry
from onebend.recording.tool import (
    AT_REST,
    LOADED,
    Meeting,
    ToolPlace,
    deviations,
    middle,
    not_seen,
    of_rows,
    place_of,
    rows_to_look_at,
    shrunk,
    tool_checked,
    tool_remarks,
)
from onebend.records import Array, ToolTrack
from tests.made_up import observations
from tests.recording.filmed import LENGTH, recording
from tests.recording.tool.scenes import (
    FRAMES,
    Bar,
    Filmed,
    filmed,
    in_room,
    mirrored,
    sometimes,
    with_beam,
)

TOOL = in_room(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("at", [0.7, 0.8, 1.0])
@pytest.mark.parametrize("bar", [TOOL, with_beam(0.0), with_beam(0.4)], ids=["in the room", "straight", "slanted"])
def test_the_tool_is_seen_where_it_touches(at: float, bar: Bar) -> None:
    seen = filmed((at, bar)).place()
    assert seen.seen, seen.why
    assert abs(seen.s - at) < 2.0 * seen.sd
    assert seen.sd < 0.012
    assert not seen.left
    assert seen.track is not None
    assert abs(float(np.median(seen.track.s)) - at) * LENGTH < 0.5e-3  # m
    assert np.linalg.norm(seen.track.effects.mean(axis=0)) <= seen.sd


def test_a_place_where_no_picture_shows_the_tool_has_no_track(monkeypatch: pytest.MonkeyPatch) -> None:
    film = filmed((0.8, TOOL))
    elsewhere = replace(film.place(), s=0.3, track=None)
    monkeypatch.setattr(tool, "place_of", lambda *_: elsewhere)
    assert film.place() == elsewhere


@pytest.mark.slow
def test_a_tool_that_looks_wider_than_what_is_searched_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    film = filmed((0.8, TOOL))
    wide = replace(film.place(), width=0.25 * LENGTH, track=None)
    monkeypatch.setattr(tool, "place_of", lambda *_: wide)
    assert abs(film.place().s - 0.8) < 0.05


def test_it_is_seen_on_either_side() -> None:
    film = filmed((0.8, TOOL))
    right, left = film.place(), mirrored(film).place()
    assert left.left
    assert not right.left
    assert left.s == pytest.approx(right.s, abs=2e-3)


@pytest.mark.parametrize(
    ("bars", "why"),
    [
        ((), "nothing lies against the beam"),
        ([(0.8, in_room(0.5, gap=0.008))], "too few frames show"),  # it only follows the beam
        ([(0.6, with_beam(0.2, always=True))], "at rest too"),  # a cable that hangs on the beam
        ([(0.6, TOOL), (0.95, TOOL)], "several places"),
        ([(0.7, sometimes(TOOL, 5))], "too few frames show"),
    ],
    ids=["none", "at a distance", "fixed to the beam", "two", "seldom"],
)  # fmt: skip
def test_what_is_no_tool_is_not_seen(bars: list[tuple[float, Bar]], why: str) -> None:
    found = filmed(*bars).place()
    assert not found.seen
    assert np.isnan(found.s)
    assert why in found.why


@pytest.mark.slow
def test_a_beam_that_rests_long_hides_nothing_that_is_fixed_to_it() -> None:
    film = filmed((0.8, with_beam(0.2, always=True)))
    rows = np.concatenate([np.arange(FRAMES), np.zeros(FRAMES, dtype=int)])
    noise = np.random.default_rng(0).standard_normal((2 * FRAMES, *film.pictures.shape[1:]))
    long = Filmed(film.pictures[rows] + noise, of_rows(film.markers, rows), film.loaded[rows])
    assert not long.place().seen


@pytest.mark.parametrize("shake", [0.6, 3.0, 10.0])
def test_a_shaking_camera_makes_no_other_place(shake: float) -> None:
    found = filmed((0.8, TOOL), shake=shake).place()
    assert not found.seen or abs(found.s - 0.8) < 3.0 * found.sd


def test_films_that_do_not_tell() -> None:
    film = filmed((0.8, TOOL))
    turned = replace(film, markers=replace(film.markers, base_angle=np.linspace(0.0, 0.1, FRAMES)))
    assert "the base turns" in turned.place().why
    assert "too few frames" in replace(film, loaded=np.zeros(FRAMES, dtype=bool)).place().why
    assert "too few frames" in replace(film, loaded=np.ones(FRAMES, dtype=bool)).place().why
    hidden = film.markers.xy.copy()
    hidden[:] = nan
    assert "beam's tags" in replace(film, markers=replace(film.markers, xy=hidden)).place().why
    never = replace(film.markers, xy=film.markers.xy * np.array([1.0, nan, 1.0])[:, None])
    assert replace(film, markers=never).place().s == pytest.approx(film.place().s, abs=0.02)
    still = replace(film, pictures=np.repeat(film.pictures[:1], FRAMES, axis=0))
    assert not still.place().seen


def meeting(s: float) -> Meeting:
    return Meeting(s, False, 0.006, 0.006, 0.0)


def test_the_place_is_the_middle_and_its_sd_does_not_average_out() -> None:
    pushed = np.arange(24) < 20
    found = [[meeting(0.79 + 0.01 * (i % 3))] if now else [] for i, now in enumerate(pushed)]
    told = place_of(found, pushed, LENGTH)
    assert told.s == pytest.approx(0.8)
    assert told.sd == pytest.approx(np.hypot(0.006 / LENGTH / np.sqrt(12.0), 1.4826 * 0.01))
    assert told.shown == 1.0
    beyond = [[meeting(1.03)] if now else [] for now in pushed]
    assert place_of(beyond, pushed, LENGTH).s == 1.0


def test_a_change_of_the_light_is_no_change() -> None:
    rng = np.random.default_rng(1)
    table = rng.uniform(60.0, 160.0, (40, 60))
    frames = table + rng.standard_normal((15, 40, 60))
    frames[4, 10:20, 10:20] += 30.0
    light = np.linspace(0.8, 1.2, 15)[:, None, None]
    away = deviations((light * frames).astype(np.float32))
    assert np.mean(away > 5.0) == pytest.approx(100 / frames.size, rel=0.1)
    assert (away[4, 10:20, 10:20] > 5.0).all()


def test_pictures_shrink_by_means_of_blocks() -> None:
    picture = np.arange(7 * 11, dtype=np.uint8).reshape(7, 11)
    assert shrunk(picture, 3).shape == (2, 3)
    assert shrunk(picture, 3)[1, 2] == pytest.approx(picture[3:6, 6:9].mean())
    assert np.array_equal(shrunk(picture, 1), picture)


def test_frames_are_chosen_over_time_and_way() -> None:
    still, moved = np.zeros((300, 1, 2)), np.linspace(0.0, 0.1, 100)[:, None, None] * np.ones(2)
    xy, loaded = np.concatenate([still, moved, moved[-1:] + still]), np.arange(700) >= 300
    rows = rows_to_look_at(xy, loaded)
    assert np.sum(~loaded[rows]) == AT_REST
    assert 0.8 * LOADED <= np.sum(loaded[rows]) <= LOADED
    assert np.sum((rows >= 300) & (rows < 400)) > np.sum(rows >= 400)  # a hold is seen seldom
    assert len(rows_to_look_at(xy[:5], loaded[:5])) == 5
    assert len(rows_to_look_at(xy[:0], loaded[:0])) == 0
    fourth = np.arange(700) % 4 == 0
    some = rows_to_look_at(xy, loaded, fourth)
    assert fourth[some].all()
    np.testing.assert_allclose(some[:: len(some) - 1], rows[:: len(rows) - 1], atol=4)
    few = rows_to_look_at(xy, loaded, np.arange(700) % 40 == 0)  # too few of the loaded ones
    assert np.array_equal(few[few >= 300], rows[rows >= 300])
    assert (few[few < 300] % 40 == 0).all()


def test_another_place_than_stated_is_warned_of() -> None:
    tool = ToolPlace(0.8, 0.02, 0.007, False, 1.0, "")
    rec = replace(recording(), push=PushEntry(at=1.0))
    (said,) = tool_remarks(tool, rec)
    assert "the tool at s = 0.80, give or take 0.02" in said.text
    assert "at_s = 1. " in said.text
    assert said.doubt
    assert said.about == "tool place"
    assert not tool_remarks(tool, replace(rec, push=PushEntry(at=0.8)))
    assert not tool_remarks(tool, replace(rec, push=PushEntry(at=0.85)))
    assert not tool_remarks(tool, replace(rec, push=PushEntry(at=1.0, at_sd=0.1 * LENGTH)))
    assert not tool_remarks(tool, replace(rec, push=PushEntry(column="push_s")))
    assert not tool_remarks(tool, replace(rec, push=None))
    assert not tool_remarks(not_seen("nothing is there"), rec)
    assert not tool_remarks(replace(tool, shown=0.49), rec)  # nor does it show the tool where it is said to be


@pytest.mark.parametrize(("s", "shown", "there"), [(0.98, 0.3, True), (0.8, 0.3, False), (0.8, 0.9, False)])
def test_the_place_is_seen_where_the_tool_is_seen_there(s: float, shown: float, there: bool) -> None:
    track = ToolTrack(np.arange(3.0), np.full(3, s), np.full(3, 0.01), np.full((3, 1), 0.02))
    tool, o = ToolPlace(s, 0.02, 0.007, False, shown, "", track, np.zeros((3, 2))), observations()
    rec = replace(recording(), push=PushEntry(at=1.0))
    checked = tool_checked(rec, o, np.zeros(len(o.time)), lambda *_: tool)
    assert checked.source.place_seen == there
    assert len(checked.source.remarks) - len(o.source.remarks) == (not there and shown > 0.5)
    assert (checked.tool is not None) == there


def test_a_tool_beside_the_stated_place_counts_less() -> None:
    track, o = ToolTrack(np.arange(3.0), np.full(3, 0.97), np.full(3, 0.01), np.full((3, 1), 0.02)), observations()
    rec = replace(recording(), push=PushEntry(at=1.0, at_sd=1e-3))

    def told(s: float) -> ToolTrack:
        tool = ToolPlace(s, 0.02, 0.007, False, 1.0, "", track, np.zeros((3, 2)))
        checked = tool_checked(rec, o, np.zeros(len(o.time)), lambda *_: tool).tool
        assert checked is not None
        return checked

    at, near = told(1.0), told(0.95)
    np.testing.assert_allclose(at.sd, track.sd)
    assert np.all(near.sd > 1.3 * track.sd)
    np.testing.assert_allclose(near.effects[:, :1] / track.effects, near.sd[0] / track.sd[0])


def test_a_tool_whose_force_leans_may_act_beside_its_end() -> None:
    """The line of the force through an end 10 mm from the axis meets it 10 mm farther at 45 degrees; less what is
    between is uniform: 10 mm over the root of three. A force straight across changes nothing."""
    o = observations()
    track = ToolTrack(o.time[:3], np.ones(3), np.full(3, 0.01), np.zeros((3, 1)))
    rec, ends = replace(recording(), push=PushEntry(at=1.0)), np.tile([0.0, -0.01], (3, 1))
    force = np.zeros_like(o.force)
    force[:3] = [[0.0, 1.0], [1.0, 1.0], [-1.0, 1.0]]
    tool = ToolPlace(1.0, 0.02, 0.007, False, 1.0, "", track, ends)
    checked = tool_checked(rec, replace(o, force=force), np.zeros(len(o.time)), lambda *_: tool).tool
    assert checked is not None
    lever = 0.01 / o.length / np.sqrt(3.0)
    np.testing.assert_allclose(np.abs(checked.effects[:, 1]), [0.0, lever, lever], atol=1e-12)
    assert checked.effects[1, 1] == pytest.approx(-checked.effects[2, 1])


def test_one_frame_does_not_tell_how_all_forces_lean() -> None:
    """An end that one frame shows far off changes nothing; a force within its noise leans either way, and so does any
    force of a log whose noise is not known."""
    o = observations()
    track = ToolTrack(o.time[:4], np.ones(4), np.full(4, 0.01), np.zeros((4, 1)))
    rec, ends = replace(recording(), push=PushEntry(at=1.0)), np.tile([0.0, -0.01], (4, 1))
    force = np.zeros_like(o.force)
    force[:4] = [[10.0, 10.0], [10.0, 10.0], [10.0, 10.0], [0.0, 0.01]]

    def checked(ends: Array, force_sd: float = 0.1) -> ToolTrack:
        tool, seen = ToolPlace(1.0, 0.02, 0.007, False, 1.0, "", track, ends), replace(o, force=force)
        seen = replace(seen, force_sd=np.full(2, force_sd))
        found = tool_checked(rec, seen, np.zeros(len(o.time)), lambda *_: tool).tool
        assert found is not None
        return found

    usual, far = checked(ends), checked(ends * np.array([1.0, 1.0, 3.0, 1.0])[:, None])
    np.testing.assert_allclose(far.effects[:, 1], usual.effects[:, 1])
    lever = 0.01 / o.length / np.sqrt(3.0)
    np.testing.assert_allclose(usual.sd[:3], np.hypot(0.01, 0.02 * lever))
    assert usual.sd[3] == pytest.approx(np.hypot(0.01, 2.0 * lever))
    np.testing.assert_allclose(checked(ends, np.nan).sd, np.hypot(0.01, 2.0 * lever))


def test_medians_are_those_of_numpy() -> None:
    rng = np.random.default_rng(5)
    for count in (7, 12):
        pictures = rng.integers(0, 255, (count, 9, 11)).astype(np.float32)
        np.testing.assert_array_equal(middle(pictures), np.median(pictures, axis=0))
