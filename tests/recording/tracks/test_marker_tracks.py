"""Marker tracks: the same beam in a plane, in space, with and without base markers, gives the same observations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.errors import ObservationError, RecordingError
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.recording.entries import MarkersEntry
from onebend.recording.folder import read_recording
from onebend.recording.observe import ObserveSettings, observe
from onebend.recording.signals import jumps
from onebend.recording.tracks import best_plane, chord_angles, line_frame, track_markers
from onebend.records import Markers, Observations
from onebend.report.overview import overview
from tests.made_up import BEAM, LENGTH, MARKER_S
from tests.recording.pushed import table
from tests.recording.tracked import PUSHED, START, track_folder, turned_plane

pytestmark = pytest.mark.usefixtures("no_other_places")

AXES = turned_plane()
SEEN_FROM = f"seen_from = {AXES[:, 2].tolist()}\n"


def truth() -> Markers:
    return PUSHED.markers()


@pytest.mark.parametrize(
    ("options", "tolerance"),
    [
        ({}, 1e-4),
        ({"base": False}, 2e-4),
        ({"axes": AXES, "markers": SEEN_FROM}, 1e-4),
        ({"axes": AXES, "markers": SEEN_FROM, "base": False}, 2e-4),
        ({"angles": True}, 1e-4),
    ],
    ids=["plane", "plane, no base", "space", "space, no base", "with angles"],
)
def test_tracks_come_into_the_beams_frame(tmp_path: Path, options: dict[str, object], tolerance: float) -> None:
    found = track_markers(read_recording(track_folder(tmp_path, **options)))  # type: ignore[arg-type]
    assert np.nanmax(np.abs(found.xy - truth().xy)) < tolerance
    assert found.tag_id.tolist() == [1, 2, 3]
    if "angles" in options:
        assert np.abs(found.angle - truth().angle).max() < 2e-3
        assert np.all(found.covariance[..., 2, 2] < 1e-4)
    else:
        assert np.all(np.isnan(found.angle))
    sd = np.sqrt(np.nanmedian(found.covariance[..., 0, 0]))
    assert 1.4e-5 < sd < 3e-5  # 2e-5 was put in


def test_what_a_tracker_took_for_a_marker_now_and_then_is_left_out(tmp_path: Path) -> None:
    folder, rng = track_folder(tmp_path), np.random.default_rng(0)
    file, whole = folder / "markers.csv", track_markers(read_recording(folder))
    header, *rows = file.read_text().splitlines()
    strays = set(rng.choice(len(rows), len(rows) // 33, replace=False).tolist())
    x = header.split(",").index("x_m")
    for i in strays:
        cells = rows[i].split(",")
        rows[i] = ",".join([*cells[:x], f"{float(cells[x]) + rng.choice([-1, 1]) * 0.03:.6f}", *cells[x + 1 :]])
    file.write_text("\n".join([header, *rows]) + "\n")
    found = track_markers(read_recording(folder))
    assert np.nanmax(np.abs(found.xy - whole.xy)) < 2e-4
    assert 0.01 < np.mean(np.isnan(found.xy[..., 0]) & ~np.isnan(whole.xy[..., 0])) < 0.07  # its rows, or its base's
    assert any("jumps away and back" in remark.text for remark in found.remarks)


@given(st.sampled_from([25.0, 60.0, 120.0]), st.floats(0.5, 12.0), st.floats(0.2, 3.0), st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_a_push_that_is_let_go_and_swings_is_no_stray(fps: float, hertz: float, decay: float, seed: int) -> None:
    time = np.arange(-3.0, 5.0, 1.0 / fps)
    led = 0.03 * np.clip(time + 2.5, 0.0, 1.0)
    y = np.where(time < 0.0, led, 0.03 * np.exp(-time / decay) * np.cos(2.0 * np.pi * hertz * time))
    noise = np.random.default_rng(seed).normal(scale=3e-5, size=(len(time), 2))
    path = np.column_stack([0.1 - y**2, y]) + noise
    assert not np.any(jumps(path, 1e-3))
    path[len(path) // 5, 1] += 0.02
    assert np.flatnonzero(jumps(path, 1e-3)).tolist() == [len(path) // 5]


def test_looking_from_the_other_side_mirrors_the_beam(tmp_path: Path) -> None:
    behind = f"seen_from = {(-AXES[:, 2]).tolist()}\n"
    found = track_markers(read_recording(track_folder(tmp_path, axes=AXES, markers=behind)))
    assert np.nanmax(np.abs(found.xy * [1, -1] - truth().xy)) < 1e-4


def test_a_bench_that_moves_is_followed(tmp_path: Path) -> None:
    time = truth().time
    way = np.stack([0.02 * np.sin(time), 0.01 * np.cos(2 * time), 0.2 * np.sin(0.7 * time)], axis=1)
    found = track_markers(read_recording(track_folder(tmp_path, base_way=way)))
    assert np.nanmax(np.abs(found.xy - truth().xy)) < 2e-4
    assert np.abs(found.base_angle - way[:, 2]).max() < 1e-3
    assert any("base moves" in remark.text for remark in found.remarks)


def test_clamp_and_axis_may_be_written(tmp_path: Path) -> None:
    written = f"clamp_m = [0.3, 0.2]\nx_axis = [{np.cos(0.4)}, {np.sin(0.4)}]\n"
    found = track_markers(read_recording(track_folder(tmp_path, base=False, markers=written)))
    assert np.nanmax(np.abs(found.xy - truth().xy)) < 1e-6


def test_frames_that_repeat_the_one_before_are_left_out_where_the_beam_moves(tmp_path: Path) -> None:
    folder, copies = track_folder(tmp_path), np.arange(7, len(truth().time), 11)
    rows = (folder / "markers.csv").read_text().splitlines()
    count = (len(rows) - 1) // len(truth().time)  # markers a frame
    for t in copies.tolist():
        for i in range(count):
            now, before = 1 + t * count + i, 1 + (t - 1) * count + i
            rows[now] = ",".join([rows[now].split(",")[0], *rows[before].split(",")[1:]])
    (folder / "markers.csv").write_text("\n".join(rows) + "\n")
    found = track_markers(read_recording(folder))
    (remark,) = (one for one in found.remarks if one.about == "film hung")
    assert f"of {len(truth().time)} frames" in remark.text
    exact = truth()
    kept = np.searchsorted(exact.time, found.time - 1e-6)
    moved = np.linalg.norm(np.diff(exact.xy[:, -1], axis=0), axis=1)
    fast = copies[moved[copies - 1] > 5e-4]
    assert len(fast) > 5
    assert not set(fast.tolist()) & set(kept.tolist())
    assert len(found.time) >= len(exact.time) - len(copies)


def test_gaps_stay_gaps_and_are_told(tmp_path: Path) -> None:
    keep = np.random.default_rng(3).random((len(truth().time), 3)) > [0.0, 0.2, 0.0]
    found = track_markers(read_recording(track_folder(tmp_path, keep=keep)))
    assert np.array_equal(np.isfinite(found.xy).all(axis=-1), keep)
    assert any("Marker 2 is missing" in remark.text for remark in found.remarks)


def observed(folder: Path) -> Observations:
    return observe(folder, settings=ObserveSettings())


def test_k_is_learned_from_points_alone(tmp_path: Path) -> None:
    """No angles, no base marker, a clock 0.9 s off: k(s) lies in its band around the truth."""
    seen = observed(track_folder(tmp_path, base=False))
    assert seen.source.clock is not None
    assert seen.source.clock.offset == pytest.approx(PUSHED.offset, abs=4 * seen.source.clock.sd)
    assert np.isnan(seen.angle).all()
    assert np.isnan(seen.rest_angle).all()
    posterior = fit([seen], 0.05, settings=FitSettings(functions=8, most_frames=40, first_frames=40))
    s = np.linspace(0.05, 0.8, 20)
    band = posterior.band(s)
    true = BEAM.stiffness(s)
    assert np.all((band.low < true) & (true < band.high))
    assert np.median(np.abs(posterior.beam.stiffness(s) / true - 1)) < 0.05


@pytest.mark.slow
def test_one_clock_for_both_is_taken_at_its_word(tmp_path: Path) -> None:
    folder = track_folder(tmp_path, markers="start_uncertainty_s = 0\n")
    seen = observed(folder)
    assert seen.source.clock is not None
    assert (seen.source.clock.offset, seen.source.clock.sd, seen.source.clock.found) == (START, 0.0, True)


@pytest.mark.slow
def test_overview_names_the_tracks(tmp_path: Path) -> None:
    rows = dict(overview(track_folder(tmp_path)).rows)
    assert "markers.csv" in rows["markers"]
    assert "the tracks start" in rows["clocks"]


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"unit": 1000.0}, ObservationError, ["in metres", "mm apart"]),
        ({"axes": AXES, "markers": f"seen_from = {AXES[:, 0].tolist()}\n"}, ObservationError, ["edge on", "seen_from"]),
        ({"markers": "x_axis = [0, 0, 1]\n"}, ObservationError, ["x_axis", "2 numbers"]),
    ],
    ids=["millimetres", "edge on", "three numbers"],
)
def test_mistakes_are_named(tmp_path: Path, options: dict[str, object], error: type, words: list[str]) -> None:
    with pytest.raises(error) as told:
        observed(track_folder(tmp_path, **options))  # type: ignore[arg-type]
    for word in words:
        assert word in str(told.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (",1,", ",7,", ["marker 1", "0, 2, 3, 7, 9"]),
        ("time_s", "t", ["no column time_s", "found t, id"]),
        ("0.000000,1,", "0.000000,one,", ["line 4", "id is 'one'"]),
        ("0.033333,1,", "0.000000,1,", ["marker 1 is there twice"]),
        ("0.000000,1,", "0.000000,1.5,", ["line 4", "no whole number"]),
        ("0.000000,1,", ",1,", ["line 4", "time_s is empty"]),
    ],
)
def test_mistakes_in_the_table_are_named_with_their_row(tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    folder = track_folder(tmp_path)
    path = folder / "markers.csv"
    path.write_text(path.read_text().replace(old, new) if old == ",1," else path.read_text().replace(old, new, 1))
    with pytest.raises((RecordingError, ObservationError)) as told:
        observed(folder)
    for word in words:
        assert word in str(told.value)


def test_a_lone_marker_needs_a_direction(tmp_path: Path) -> None:
    rec = read_recording(track_folder(tmp_path, base=False))
    one = replace(rec, tags=replace(rec.tags, on_beam=rec.tags.on_beam[2:]))
    with pytest.raises(ObservationError, match="x_axis"):
        track_markers(one)


def test_weight_hides_the_clamp(tmp_path: Path) -> None:
    folder = track_folder(tmp_path, base=False)
    toml = folder / "recording.toml"
    toml.write_text(toml.read_text() + "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\n")
    with pytest.raises(ObservationError, match="clamp_m"):
        observed(folder)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 1e-3))
def test_best_plane_is_the_planes_own(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    axes = turned_plane(seed)
    flat = rng.normal(size=(200, 2)) * [0.2, 0.1]
    points = flat @ axes[:, :2].T + noise * rng.normal(size=(200, 1)) * axes[:, 2] + rng.normal(size=3)
    plane = best_plane(points[:, None], axes[:, 2].tolist())
    assert plane.normal @ axes[:, 2] > 1 - 1e-3
    np.testing.assert_allclose(np.cross(plane.axes[0], plane.axes[1]), plane.normal, atol=1e-12)
    gram = plane.lay(points) - plane.lay(points).mean(axis=0)
    there = flat - flat.mean(axis=0)
    np.testing.assert_allclose(np.linalg.svd(gram)[1], np.linalg.svd(there)[1], rtol=1e-3)  # the same up to a turn


def test_points_on_a_line_leave_the_plane_to_who_looks() -> None:
    line = np.linspace(0, 1, 50)[:, None] * [1.0, 2.0, 0.0]
    assert best_plane(line[:, None], (0.0, 0.0, 1.0)).normal == pytest.approx([0, 0, 1])


def test_line_frame_is_exact_on_a_line() -> None:
    along, turn, origin = np.array([0.05, 0.1, 0.15]), 0.7, np.array([0.2, -0.1])
    points = origin + along[:, None] * [np.cos(turn), np.sin(turn)]
    found, direction = line_frame("bench", along, points, None)
    assert direction == pytest.approx(turn)
    assert found == pytest.approx(origin)


def test_chord_angles_are_near_the_beams() -> None:
    _, xy, angle = table()
    assert np.abs(chord_angles(xy, MARKER_S) - angle).max() < 0.08 * np.abs(angle).max()
    arc = np.array([0.0, 0.3, 0.8, 1.0])[None, 1:]
    circle = LENGTH * np.stack([np.sin(arc), 1 - np.cos(arc)], axis=-1)  # turns by 1 rad over its length
    assert chord_angles(circle, arc[0]) == pytest.approx(arc, abs=1e-3)


def test_defaults_of_the_entry_are_those_of_the_page() -> None:
    entry = MarkersEntry(Path("markers.csv"))
    assert entry.seen_from == (0.0, 0.0, 1.0)
    assert entry.start_uncertainty == 2.0
