"""What users and sensors really write: it is read, or refused with the reason."""

from __future__ import annotations

import re
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import ObservationError, RecordingError
from onebend.lab.bench import PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualRecording, observe_virtual, virtual_recording
from onebend.recording.camera import with_checked_turns
from onebend.recording.clock import fit_clock
from onebend.recording.entries import BeamEntry, CameraEntry, TagsEntry
from onebend.recording.folder import SECTIONS, camera_remarks, implausible
from onebend.recording.force_log import read_force_log, size_remarks, whole_log
from onebend.records import ForceLog, Remark
from tests.made_up import BEAM

KNOWN = VirtualClock(uncertainty=0.0)  # which nothing searches for
COLUMNS = ("time_s", "fx_N", "fy_N")
GOOD = ["time_s,fx_N,fy_N"] + [f"{0.1 * i:.1f},{0.01 * i},{-0.5 - 0.01 * i}" for i in range(40)]


def log_file(folder: Path, lines: list[str]) -> Path:
    path = folder / "force.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_rows_without_numbers_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = [*GOOD]
    lines[7], lines[9], lines[11] = "0.6,nan,1", "0.8,,", "1.0,inf,1"
    lines[-1] = "3.9,0.3"  # cut in the middle of a row
    log = read_force_log(log_file(tmp_path, lines), COLUMNS)
    left = np.delete(np.arange(40), [6, 8, 10, 39])
    assert np.allclose(log.time, 0.1 * left)
    assert np.allclose(log.force[:, 0], 0.01 * left)
    assert ("note", "4 of 40 ") in [(one.level, one.text[:8]) for one in log.remarks]


@pytest.mark.parametrize("dead", ["fx_N", "fy_N"])
def test_a_column_that_never_changes_is_named(tmp_path: Path, dead: str) -> None:
    rows = [f"{0.1 * i:.1f}," + ("0.3," if dead == "fx_N" else "") + f"{i}" for i in range(40)]
    rows = [row + ("" if dead == "fx_N" else ",0.3") for row in rows]
    log = read_force_log(log_file(tmp_path, [GOOD[0], *rows]), COLUMNS)
    assert [one.level for one in log.remarks] == ["warning"]
    which = "first" if dead == "fx_N" else "second"
    assert f"The {which} force of the log never changes (0.3 N)" in log.remarks[0].text


@pytest.mark.slow
@pytest.mark.parametrize("off", [60, *(pytest.param(off, marks=pytest.mark.slow) for off in (-30, 90))])
def test_a_turned_log_is_named_with_the_angle_that_fits(pushed: VirtualRecording, off: int) -> None:
    cos, sin = np.cos(np.deg2rad(off)), np.sin(np.deg2rad(off))
    log = replace(pushed.log, force=pushed.log.force @ np.array([[cos, sin], [-sin, cos]]))
    told = [one.text for one in observe_virtual(replace(pushed, log=log)).source.remarks if one.level == "warning"]
    fits = [float(text.split("(about ")[1].split()[0]) for text in told if "bending far better" in text]
    assert fits == [pytest.approx(-off, abs=8)]
    assert not [one for one in observe_virtual(pushed).source.remarks if one.level == "warning"]


def test_rows_of_one_time_become_their_mean(tmp_path: Path) -> None:
    stamps = [f"{i // 2},{i},{-i}" for i in range(40)]  # a clock of whole seconds
    log = read_force_log(log_file(tmp_path, [GOOD[0], *stamps]), COLUMNS)
    assert np.array_equal(log.time, np.arange(20.0))
    assert np.array_equal(log.force[:, 0], 2.0 * np.arange(20) + 0.5)
    assert [one.level for one in log.remarks] == ["warning"]
    assert "20 of 40" in log.remarks[0].text


@pytest.fixture(scope="module")
def pushed() -> VirtualRecording:
    peak = force_that_bends(BEAM, 1.0, 1.75)
    return virtual_recording(VirtualBench(beam=BEAM, push=PushProfile(peak), clock=KNOWN), seed=0)


def long_log(log: ForceLog, before: float, after: float) -> ForceLog:
    """The log with quiet stretches around it [s], and white noise of 1 % of the largest force."""
    apart = float(np.median(np.diff(log.time)))
    time = np.arange(log.time[0] - before, log.time[-1] + after, apart)
    force = np.stack([np.interp(time, log.time, column) for column in log.force.T], axis=1)
    return ForceLog(time, force + 0.01 * np.abs(force).max() * np.random.default_rng(0).standard_normal(force.shape))


@pytest.mark.slow
@pytest.mark.parametrize("before", [pytest.param(10.0, marks=pytest.mark.slow), 100.0])
def test_a_film_is_found_in_a_log_much_longer_than_it(pushed: VirtualRecording, before: float) -> None:
    clock = fit_clock(pushed.markers, long_log(pushed.log, before, 20.0), nan, inf, push_s=1.0).clock
    assert clock.found
    assert abs(clock.offset - pushed.bench.clock.offset) < 0.05


@pytest.mark.slow
def test_a_short_film_from_the_middle_of_the_push_is_not_drawn_to_the_quiet(pushed: VirtualRecording) -> None:
    m = pushed.markers
    cut = m.time >= 2.2
    film = replace(
        m,
        time=m.time[cut] - m.time[cut][0],
        xy=m.xy[cut],
        angle=m.angle[cut],
        covariance=m.covariance[cut],
        base_angle=m.base_angle[cut],
    )
    true = pushed.bench.clock.offset + m.time[cut][0]
    clock = fit_clock(film, long_log(pushed.log, 10.0, 10.0), true + 0.4, 2.0, push_s=1.0).clock
    assert clock.found
    assert abs(clock.offset - true) < 0.08


def test_milliseconds_are_named(pushed: VirtualRecording) -> None:
    log = replace(pushed.log, time=1000.0 * pushed.log.time)
    with pytest.raises(ObservationError, match='for milliseconds write time_unit = "ms"'):
        observe_virtual(replace(pushed, log=log))


@pytest.mark.parametrize("quarter", [1, 2, -1])
@pytest.mark.parametrize("which", [0, 2])
def test_a_tag_turned_otherwise_than_written_is_named(pushed: VirtualRecording, which: int, quarter: int) -> None:
    m, turn = pushed.markers, quarter * np.pi / 2
    with_checked_turns(m, pushed.recording)
    if which == 0:  # the base tag's own axes turn: so does all that is seen from it
        back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        m = replace(m, xy=m.xy @ back.T, angle=m.angle + turn)
    else:
        m = replace(m, angle=m.angle + turn * (m.tag_id == which))
    with pytest.raises(ObservationError) as caught:
        with_checked_turns(m, pushed.recording)
    fits = -90 * quarter if which == 0 else 90 * quarter
    assert f"tag {which} (turn_deg = 0; {180 if abs(fits) == 180 else fits} would fit)" in str(caught.value)
    assert str(caught.value).count("would fit") == 1


@pytest.mark.slow
def test_a_start_far_off_and_milliseconds_beside_a_start_in_seconds_are_hinted_at(pushed: VirtualRecording) -> None:
    video = pushed.recording.video
    assert video is not None
    late = replace(pushed, recording=replace(pushed.recording, video=replace(video, start=video.start + 5.0)))
    with pytest.raises(ObservationError, match=r"fits it from 250\.0\d s on. Correct start_s"):
        observe_virtual(late)
    fast = long_log(pushed.log, 0.0, 20.0)
    dense = ForceLog(np.linspace(0.0, 1000.0 * np.ptp(fast.time), 60000), np.tile(fast.force[:1], (60000, 1)))
    film = replace(pushed.markers, time=4.0 * pushed.markers.time)
    with pytest.raises(ObservationError, match="look like milliseconds"):
        observe_virtual(replace(pushed, markers=film, log=replace(dense, time=dense.time + 1e6)))


def noisy(count: int = 4000, *, seed: int = 0) -> np.ndarray:
    """Time, two forces of a push at 1 kHz, with noise."""
    time = 0.001 * np.arange(count)
    push = np.sin(np.pi * np.clip((time - 1.0) / 2.0, 0.0, 1.0)) ** 2
    force = np.outer(push, [0.5, -0.3]) + 0.02 * np.random.default_rng(seed).standard_normal((count, 2)) + 0.05
    return np.column_stack([time, force.round(5)])


def told(rows: np.ndarray) -> list[str]:
    return [one.text for one in whole_log("log", rows).remarks if one.level == "warning"]


def test_a_log_that_is_well_raises_no_doubt() -> None:
    for digits in (1, 2, 5):
        rows = noisy()
        rows[:, 1:] = rows[:, 1:].round(digits) + 0.013
        assert told(rows) == []
    slow = noisy()
    slow[:, 1:] = np.repeat(slow[::10, 1:], 10, axis=0)  # a sensor of 100 Hz in a log of 1 kHz
    assert told(slow) == []
    spikes = noisy()
    spikes[::90, 1] = -50.0
    assert told(spikes) == []


@pytest.mark.parametrize(("axis", "end"), [(1, "largest"), (2, "smallest")])
def test_a_sensor_at_its_end_is_named(axis: int, end: str) -> None:
    rows = noisy()
    limit = 0.6 * np.ptp(rows[:, axis])
    rows[:, axis] = np.minimum(rows[:, axis], limit) if end == "largest" else np.maximum(rows[:, axis], 0.05 - limit)
    which = ("first", "second")[axis - 1]
    assert [f"The {which} force of the log stands at exactly its {end} value" in text for text in told(rows)] == [True]


def at_its_end_of(made: VirtualRecording, force: np.ndarray) -> list[Remark]:
    """What is said of a sensor without noise, by the tags too, that writes these forces to 0.01 mN."""
    rows = np.column_stack([made.log.time, force.round(5)])
    log = whole_log("log", rows)
    remarks = observe_virtual(replace(made, log=log)).source.remarks
    return [one for one in remarks if one.about == "sensor's end"]


@pytest.mark.slow
def test_a_sensor_at_its_end_is_named_without_noise_where_the_beam_goes_on_moving() -> None:
    push = PushProfile(0.5, before=1.5, rise=2.0, hold=1.0, fall=2.0, after=1.5, turn=0.0)
    made = virtual_recording(VirtualBench(BEAM, push, clock=KNOWN), seed=1)
    force = made.log.force
    assert at_its_end_of(made, force) == []  # held for a second: the beam stands still
    limited = force.copy()
    limited[:, 1] = np.minimum(force[:, 1], 0.8 * np.max(force[:, 1]))
    assert [one.doubt for one in at_its_end_of(made, limited)] == [True]
    assert "The second force of the log stands at exactly its largest" in at_its_end_of(made, limited)[0].text


def test_a_log_that_hung_is_cut_there() -> None:
    rows = noisy()
    rows[2500:, 1:] = rows[2499, 1:]
    log = whole_log("log", rows)
    assert log.time[-1] == pytest.approx(2.499)
    assert any("1500 of 4000 rows of the force log only repeat the row before" in one.text for one in log.remarks)


def test_zeros_in_a_quiet_stretch_go_with_those_in_the_push() -> None:
    rows = noisy()
    for begin in range(40, 4000, 100):
        rows[begin : begin + 20, 1:] = 0.0
    log = whole_log("log", rows)
    assert len(log.time) == 4000 - 40 * 20
    assert not np.any(np.all(log.force == 0.0, axis=1))


def test_true_zeros_stay() -> None:
    rows = noisy()
    rows[:1000, 1:] = 0.0  # a simulated sensor, exactly zero at rest
    for begin in range(1500, 2500, 200):
        rows[begin : begin + 20, 1:] = 0.0
    log = whole_log("log", rows)
    assert np.sum(log.time < 0.9995) == 1000
    assert len(log.time) == 4000 - 5 * 20


@pytest.mark.parametrize(
    ("size", "mass", "words"),
    [
        (553.0, nan, "is 553 N: is the log in millinewtons"),
        (56.4, 0.08, "is 56.4 N, 72 times the beam"),
        (5e-4, nan, "is 0.0005 N: is the log in kilonewtons"),
        (0.55, 0.08, ""),
        (20.0, nan, ""),
    ],
)
def test_a_force_in_another_unit_is_doubted(size: float, mass: float, words: str) -> None:
    remarks = size_remarks(np.array([[0.0, 0.0], [0.6 * size, -0.8 * size]]), mass)
    assert [words in one.text and one.level == "warning" for one in remarks] == ([True] if words else [])


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (("time_s", "fx_mN", "fy_mN"), "fx_mN is in mN by its name: convert it to newtons"),
        (("time_s", "Fx [g]", "Fy [g]"), "is in g by its name"),
        (("t_ms", "fx_N", "fy_N"), 'write time_unit = "ms"'),
    ],
)
def test_a_column_of_another_unit_by_its_name_is_refused(
    tmp_path: Path, columns: tuple[str, str, str], words: str
) -> None:
    path = log_file(tmp_path, [",".join(columns), *GOOD[1:]])
    with pytest.raises(RecordingError, match=re.escape(words)):
        read_force_log(path, columns)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (GOOD[1:], "The first line holds numbers: write the header time_s,fx_N,fy_N above it"),
        (["# log of today", *GOOD], "remove the lines above it"),
        ([line.replace(",", ";").replace(".", ",") for line in GOOD], "decimals written with a point"),
        ([GOOD[0], *(f"{i},1,nan" for i in range(40))], "the column fy_N holds no number"),
        ([GOOD[0], *(f"{i},1,2" for i in range(40))], "neither force ever changes"),
    ],
)
def test_what_is_wrong_with_a_log_is_said(tmp_path: Path, lines: list[str], words: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(words)):
        read_force_log(log_file(tmp_path, lines), COLUMNS)


@pytest.mark.parametrize(
    ("fx", "fy", "centre", "words"),
    [
        (1320.0, 1200.0, (639.5, 359.5), "differ by more than 5 %"),
        (100.0, 100.0, (639.5, 359.5), "is it in pixels"),
        (1200.0, 1200.0, (0.0, 0.0), "check cx and cy"),
        (1200.0, 1200.0, (639.5, 359.5), ""),
    ],
)
def test_an_unlikely_camera_is_doubted(fx: float, fy: float, centre: tuple[float, float], words: str) -> None:
    camera = CameraEntry(width=1280, height=720, fx=fx, fy=fy, cx=centre[0], cy=centre[1], dist=(0.0,) * 5)
    remarks = camera_remarks(camera)
    assert [words in one.text for one in remarks] == ([True] if words else [])


def test_a_mass_in_grams_is_doubted() -> None:
    nothing = dict.fromkeys(SECTIONS)
    assert implausible(BeamEntry(length=0.15, mass=0.08), TagsEntry(), nothing, np.nan) == ()
    (told_of_mass,) = implausible(BeamEntry(length=0.15, mass=80.0), TagsEntry(), nothing, np.nan)
    assert "is it in kilograms?" in told_of_mass.text
