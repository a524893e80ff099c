"""What recording.toml says of clamp, rest curvature, picture scale and clock: read, refused, remarked on, passed on."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.recording.beam_frame import BaseLog, base_clock
from onebend.recording.clock import fit_clock, reach_of, search_range
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.recording.stated import stated_in
from onebend.records import CURVATURE_SD, PointMass
from onebend.report.overview import overview
from onebend.report.sentences import clock_words
from tests.recording.pushed import Pushed
from tests.recording.test_observe import observed, recording
from tests.recording.toml.test_folder_entries import FULL, folder_with, line_of, refusal
from tests.recording.tracked import START, track_folder

LINES = {
    "clamp_sd_deg": 'file = "video.mp4"\n',
    "rest_curvature_sd_deg": "mass_kg = 0.08\n",
    "rest_change_sd_deg": "mass_kg = 0.08\n",
    "scale_sd": "dist = [-0.06, 0.02, 0.0004, -0.0003]\n",
}
CALIBRATION = FULL[FULL.index("width = 1280") : FULL.index("[video]")]


def saying(key: str, value: str, content: str = FULL) -> str:
    """`content` with a line more."""
    return content.replace(LINES[key], f"{LINES[key]}{key} = {value}\n")


def read(folder: Path, content: str) -> Recording:
    return read_recording(folder_with(folder, content))


def remarks(folder: Path, content: str) -> list[tuple[str, str]]:
    """What reading `content` says beyond what `FULL` says."""
    usual = read(folder, FULL).remarks
    return [(r.level, r.text) for r in read(folder, content).remarks if r not in usual]


@pytest.mark.parametrize("key", LINES)
@pytest.mark.parametrize("value", ["-1", "nan", "inf", '"small"', "true", "[1]"])
def test_what_is_no_sd_is_refused_at_its_line(tmp_path: Path, key: str, value: str) -> None:
    content = saying(key, value)
    told = refusal(tmp_path, content)
    assert f"recording.toml:{line_of(content, key)}: " in told
    assert f"{key} must be a number of at least 0" in told


def test_the_sds_are_read_in_si_and_radians(tmp_path: Path) -> None:
    usual = read(tmp_path, FULL)
    assert math.isnan(usual.clamp_sd)
    assert math.isnan(usual.scale_sd)
    assert usual.beam.curvature_sd == CURVATURE_SD
    assert read(tmp_path, saying("clamp_sd_deg", "0.5")).clamp_sd == pytest.approx(math.radians(0.5))
    assert read(tmp_path, saying("rest_curvature_sd_deg", "20")).beam.curvature_sd == pytest.approx(math.radians(20))
    assert read(tmp_path, saying("scale_sd", "0.01")).scale_sd == 0.01
    assert read(tmp_path, saying("rest_change_sd_deg", "3")).beam.rest_change_sd == pytest.approx(math.radians(3))
    none = {key: read(tmp_path, saying(key, "0")) for key in LINES}
    assert none["clamp_sd_deg"].clamp_sd == none["scale_sd"].scale_sd == 0.0
    assert none["rest_curvature_sd_deg"].beam.curvature_sd == none["rest_change_sd_deg"].beam.rest_change_sd == 0.0


CLIP = "[[beam.masses]]\ns = 0.5\nmass_kg = 0.004\n[[beam.masses]]\ns = 1\nmass_kg = 0.002\n\n[tags]\n"


def test_what_rides_on_the_beam_is_read_and_refused_at_its_line(tmp_path: Path) -> None:
    content = FULL.replace("[tags]\n", CLIP)
    rec = read(tmp_path, content)
    assert [(one.s, one.mass) for one in rec.beam.masses] == [(0.5, 0.004), (1.0, 0.002)]
    assert stated_in(rec).masses == (PointMass(0.5, 0.004), PointMass(1.0, 0.002))
    for right, wrong, words in (
        ("mass_kg = 0.002", "mass_kg = -2", "[beam.masses] (entry 2) mass_kg must be a number above 0"),
        ("mass_kg = 0.002", "mass_g = 2", "does not know the key mass_g. Did you mean mass_kg?"),
        ("mass_kg = 0.002", "mass_kg =", "[beam.masses] (entry 2) mass_kg is empty. Fill it in: its mass, kg."),
    ):
        told = refusal(tmp_path, content.replace(right, wrong))
        assert words in told
        assert f"recording.toml:{line_of(content, right)}: " in told
    assert "must be tables: `[[beam.masses]]`" in refusal(tmp_path, FULL.replace("[beam]\n", "[beam]\nmasses = 3\n"))


def test_a_scale_may_be_all_that_is_said_of_the_camera(tmp_path: Path) -> None:
    alone = read(tmp_path, FULL.replace(CALIBRATION, "scale_sd = 0.01\n\n"))
    assert alone.camera is None
    assert alone.scale_sd == 0.01
    wrong = FULL.replace(CALIBRATION, "scale_sd = -0.01\n\n")
    assert "[camera] scale_sd must be a number of at least 0" in refusal(tmp_path, wrong)
    both = refusal(tmp_path, FULL.replace(CALIBRATION, "scale_sd = 0.01\nfx = 1200\n\n"))
    assert "[camera] lacks width" in both
    assert "Did you mean scale_sd?" in refusal(tmp_path, FULL.replace(CALIBRATION, "scale_ds = 0.01\n\n"))


@pytest.mark.parametrize(
    ("key", "value", "level", "words"),
    [
        ("clamp_sd_deg", "40", "warning", "clamp_sd_deg = 40 lets the clamp turn freely"),
        ("rest_curvature_sd_deg", "200", "warning", "may be rolled up"),
        ("scale_sd", "0.3", "warning", "is 30 %: is it a share"),
    ],
)
def test_odd_sds_are_remarked_on(tmp_path: Path, key: str, value: str, level: str, words: str) -> None:
    ((how, text),) = remarks(tmp_path, saying(key, value))
    assert how == level
    assert words in text
    for fine in ("0", "0.001"):
        assert remarks(tmp_path, saying(key, fine)) == []


def written(table: str, key: str, value: str) -> str:
    """FULL with `key` of `table` set to `value`, in place of what stands there."""
    head, after = FULL.split(f"[{table}]\n", 1)
    body, *others = re.split(r"(?m)^(?=\[)", after, maxsplit=1)
    body = re.sub(rf"(?m)^{key} .*\n", "", body)
    return f"{head}[{table}]\n{key} = {value}\n{body}{''.join(others)}"


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("beam", "length_m", "15", "is it in metres?"),
        ("tags", "size_m", "12", "are both in metres?"),
        ("tags", "placement_sd_m", "0.5", "placement_sd_m = 0.5 is more than a fifth"),
        ("push", "at_sd_m", "0.5", "at_sd_m = 0.5 is more than a fifth"),
        ("tags", "turn_sd_deg", "90", "turn_sd_deg = 90 leaves the direction open"),
        ("force", "rotation_sd_deg", "90", "rotation_sd_deg = 90 leaves the direction open"),
        ("gravity", "direction_sd_deg", "2000", "direction_sd_deg = 2000 leaves the direction open"),
        ("force", "gain_sd", "2", "gain_sd = 2 is 200 %: is it a share"),
    ],
)
def test_sizes_in_another_unit_are_warned_of(tmp_path: Path, table: str, key: str, value: str, words: str) -> None:
    said = [text for level, text in remarks(tmp_path, written(table, key, value)) if level == "warning"]
    assert any(words in text for text in said)
    assert not any(words.split(" = ")[0] in text for _, text in remarks(tmp_path, FULL))


def test_a_key_in_the_wrong_table_is_told_its_own(tmp_path: Path) -> None:
    assert "It belongs into [tags]." in refusal(tmp_path, written("beam", "turn_sd_deg", "1"))
    assert "It belongs into [video] or [markers]" in refusal(tmp_path, written("beam", "clamp_sd_deg", "1"))
    assert "Did you mean turn_sd_deg?" in refusal(tmp_path, written("tags", "turnsd_deg", "1"))


def test_a_curvature_that_is_ruled_out_is_said_to_be_unused(tmp_path: Path) -> None:
    straight = FULL.replace('rest = "unknown"', 'rest = "straight"')
    ((level, text),) = remarks(tmp_path, saying("rest_curvature_sd_deg", "20", straight))
    assert level == "note"
    assert 'only with rest = "unknown"' in text
    assert remarks(tmp_path, saying("rest_curvature_sd_deg", "0", straight)) == []


@pytest.mark.slow
def test_what_is_stated_is_carried_along() -> None:
    whole = recording()
    assert whole.video is not None
    exact = replace(whole.video, start=250.0, start_uncertainty=0.0)
    stated = replace(
        whole,
        video=replace(exact, clamp_sd=0.02),
        beam=replace(whole.beam, curvature_sd=0.4),
        scale_sd=0.05,
    )
    found = observed(rec=stated)
    assert (found.stated.clamp_sd, found.stated.curvature_sd, found.stated.scale_sd) == (0.02, 0.4, 0.05)
    assert found.source.clock is not None
    assert (found.source.clock.offset, found.source.clock.sd) == (250.0, 0.0)
    usual = observed(rec=replace(whole, video=exact))
    assert usual.stated.curvature_sd == CURVATURE_SD
    assert math.isnan(usual.stated.clamp_sd)
    assert math.isnan(usual.stated.scale_sd)


@pytest.mark.slow
def test_tracks_have_a_clamp_too(tmp_path: Path) -> None:
    rec = read_recording(track_folder(tmp_path, markers="clamp_sd_deg = 0.5\nstart_uncertainty_s = 0\n"))
    assert rec.clamp_sd == pytest.approx(math.radians(0.5))
    clocks = dict(overview(tmp_path).rows)["clocks"]
    assert clocks == f"the tracks start at {START:.3f} s of the log, as written: exact, nothing is looked for"


def test_an_uncertainty_without_a_start_says_nothing(tmp_path: Path) -> None:
    content = FULL.replace("start_s = 255.64\n", "")
    ((level, text),) = remarks(tmp_path, content)
    assert level == "note"
    assert "start_uncertainty_s says nothing without start_s" in text
    assert math.isinf(read(tmp_path, content).start[1])


@pytest.mark.slow
def test_an_exact_start_is_the_offset_however_wrong_it_is() -> None:
    pushed = Pushed(seed=30)
    for said in (pushed.offset, pushed.offset + 0.4):
        for place in (None, 1.0):
            fit = fit_clock(pushed.markers(), pushed.log(), said, 0.0, push_s=place)
            assert (fit.clock.offset, fit.clock.sd, fit.clock.stated, fit.clock.found) == (said, 0.0, said, True)
            assert fit.remarks == ()
    assert "as written in recording.toml, which calls it exact" in clock_words(fit.clock)
    looked = fit_clock(pushed.markers(), pushed.log(), pushed.offset + 0.4, 2.0).clock
    assert "as written" not in clock_words(looked)
    assert abs(looked.offset - pushed.offset) < 0.05


@pytest.mark.slow
def test_the_noise_is_found_at_an_exact_start() -> None:
    pushed = Pushed(seed=30)
    exact = fit_clock(pushed.markers(), pushed.log(), pushed.offset, 0.0).noise
    looked = fit_clock(pushed.markers(), pushed.log(), pushed.offset, 2.0).noise
    assert exact is not None
    assert looked is not None
    assert exact.coloured == pytest.approx(looked.coloured, rel=0.3)
    silent = replace(pushed.log(), force=np.zeros_like(pushed.log().force))
    assert fit_clock(pushed.markers(), silent, pushed.offset, 0.0).noise is None


@pytest.mark.parametrize(
    ("uncertainty", "push_s"), [(1e-15, None), (1e-4, None), (1e-3, 1.0), (0.005, None), (0.005, 1.0), (0.05, None)]
)
def test_a_start_that_is_known_closely_is_taken_at_its_word(uncertainty: float, push_s: float | None) -> None:
    pushed = Pushed(seed=31)
    for off in (0.0, 0.3):  # what is written is right, or far off
        said = pushed.offset + off
        fit = fit_clock(pushed.markers(), pushed.log(), said, uncertainty, push_s=push_s)
        assert 0.0 < fit.clock.sd < 1.2 * uncertainty + 1e-9
        assert abs(fit.clock.offset - said) <= reach_of(max(uncertainty, 1e-6))
        assert off or abs(fit.clock.offset - said) < 3.0 * uncertainty
        assert fit.clock.found or fit.clock.offset == said
        assert all(remark.level == "note" for remark in fit.remarks) or off


@pytest.mark.parametrize("push_s", [None, 1.0])
def test_a_close_start_that_the_data_contradict_is_kept_and_warned_of(push_s: float | None) -> None:
    pushed = Pushed(seed=31)
    fit = fit_clock(pushed.markers(), pushed.log(), pushed.offset + 0.3, 0.02, push_s=push_s)
    assert (fit.clock.offset, fit.clock.found) == (pushed.offset + 0.3, False)
    (remark,) = fit.remarks
    assert remark.level == "warning"
    assert re.search(r"the film start -0\.(29|30)\d s from start_s, more than its uncertainty", remark.text)


def test_the_range_searched_grows_evenly_with_what_is_not_known() -> None:
    film, log = np.linspace(0.0, 8.0, 200), np.linspace(240.0, 270.0, 3000)
    last = 0.0
    for uncertainty in (1e-4, 1e-3, 0.03, 0.0999, 0.1, 0.1001, 0.5, 2.0):
        low, high, prior = search_range(film, log, 250.0, uncertainty)
        assert 0.5 * (high - low) == pytest.approx(reach_of(uncertainty))
        sd = 1.0 / math.sqrt(-2.0 * float(prior(np.array([251.0]) - 1.0 + 1e-6)[0])) * 1e-6
        assert last < sd <= uncertainty + 1e-9
        last = sd
    wide = [search_range(film, log, 250.0, each)[:2] for each in (0.1, 2.0)]
    assert wide == [(250.0 - 2.1, 250.0 + 2.1), (246.0, 254.0)]


def test_a_turn_of_the_base_does_not_outdo_a_start_that_is_known_better() -> None:
    pushed = Pushed()
    markers = pushed.markers()
    time = np.linspace(95.0, 120.0, 500)
    log = BaseLog(time, 0.3 * np.sin(0.9 * time))
    seen = replace(markers, base_angle=np.interp(markers.time + 101.7, log.time, log.angle))
    for uncertainty in (1e-4, 0.001, 0.003):
        clock = base_clock(seen, log, 101.0, uncertainty)
        assert (clock.offset, clock.sd, clock.found) == (101.0, uncertainty, False)
    assert base_clock(seen, log, 101.0, 2.0).offset == pytest.approx(101.7, abs=0.005)
