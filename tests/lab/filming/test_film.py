"""A filmed bench: the folder is a recording, its pixels show the truth, its log is the true force."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.markers import errors
from benchmarks.truth import read_truth
from onebend.cli import app
from onebend.errors import RecordingError
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.designs import DESIGNS
from onebend.lab.filming import Filming, entries, film
from onebend.lab.rendering import Camera, Scene
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualTag
from onebend.pipeline import learn
from onebend.recording.camera import measure_markers
from onebend.recording.folder import read_recording
from onebend.recording.force_log import read_force_log
from onebend.recording.tags import detect_tags
from onebend.recording.video import read_frames

DESIGN = DESIGNS["linear"]
PUSH = PushProfile(0.4, direction=1.75, before=0.2, rise=0.9, hold=0.1, fall=0.7, after=0.1)
BENCH = VirtualBench(
    beam=DESIGN.beam(),
    push=PUSH,
    tags=(
        VirtualTag(4, 0.333333),
        VirtualTag(8, 0.666667, along=0.0004, across=-0.0002, turn=0.01),
        VirtualTag(15, 1.0),
    ),
    base=(0.0, 0.0003, -0.02),
    sensor=ForceSensor(rate=200.0),
    fps=15.0,
    clock=VirtualClock(30.0, 30.4, 2.0),
    name="small",
)
FILMING = Filming(
    BENCH,
    width=DESIGN.width,
    camera=Camera(640, 360, 600.0),
    scene=Scene(exposure=0.004),
    log_rotation=0.5,
    log_of_robot=True,
    lost=0.1,
    base_angle=0.4,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return film(FILMING, tmp_path_factory.mktemp("film") / "small", seed=3)


def test_the_folder_reads_as_what_was_filmed(folder: Path) -> None:
    read, told = read_recording(folder), entries(FILMING, folder)
    for name in ("name", "beam", "camera", "push", "gravity"):
        assert getattr(read, name) == getattr(told, name), name
    assert read.tags == told.tags
    assert read.video is not None
    assert read.force is not None
    assert read.video.start == 30.4
    assert read.force.rotation == pytest.approx(0.5)
    assert read.force.acts_on == "robot"


@pytest.mark.slow
def test_tags_are_seen_where_they_truly_are(folder: Path) -> None:
    rec, truth = read_recording(folder), read_truth(folder)
    assert rec.video is not None
    place, angle, _ = errors(measure_markers(detect_tags(rec.video, rec.tags, threads=1), rec), truth)
    assert place < 6e-5  # m; a pixel is 0.35 mm
    assert angle < np.radians(0.35)


def test_frames_have_the_times_of_the_truth_and_some_are_lost(folder: Path) -> None:
    rec, truth = read_recording(folder), read_truth(folder)
    assert rec.video is not None
    times = [frame.time for frame in read_frames(rec.video)]
    np.testing.assert_allclose(times, truth.time, atol=2e-5)
    assert len(times) < np.ceil(PUSH.duration * BENCH.fps)
    np.testing.assert_allclose(np.round(truth.time * 15.0), truth.time * 15.0, atol=1e-9)


def test_the_log_is_the_true_force_in_its_own_axes_and_clock(folder: Path) -> None:
    rec, truth = read_recording(folder), read_truth(folder)
    assert rec.force is not None
    log = read_force_log(rec.force.file, rec.force.columns)
    cos, sin = np.cos(0.5), np.sin(0.5)
    on_beam = -log.force @ np.array([[cos, sin], [-sin, cos]])
    np.testing.assert_allclose(on_beam, PUSH.force(log.time - 30.0), atol=2e-4)
    np.testing.assert_allclose(truth.log_force, log.force, atol=2e-5)
    np.testing.assert_allclose(truth.force, PUSH.force(truth.time), atol=1e-12)


def test_the_truth_agrees_with_itself(folder: Path) -> None:
    data = np.load(folder / "truth" / "truth.npz")
    facts = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    np.testing.assert_allclose(data["EI"], DESIGN.bending(data["s"]), rtol=1e-9)
    np.testing.assert_allclose(data["k"] * 0.15, data["EI"])
    tip = np.stack([data["x"][:, -1], data["y"][:, -1]], axis=-1)
    room = tip @ np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    np.testing.assert_allclose(data["tag_xya"][:, 3, :2], room, atol=1e-12)
    np.testing.assert_allclose(data["tag_xya"][:, 3, 2], data["alpha"][:, -1] + 0.4, atol=1e-12)
    assert data["tag_id"].tolist() == [0, 4, 8, 15]
    assert facts["clock"]["error_said_minus_true"] == pytest.approx(0.4)


@pytest.mark.slow
def test_the_same_seed_makes_the_same_files_and_another_one_does_not(tmp_path: Path) -> None:
    blink = replace(PUSH, before=0.0, rise=0.1, hold=0.0, fall=0.1, after=0.0)
    short = replace(FILMING, bench=replace(BENCH, push=blink))
    one, same = (film(short, tmp_path / name / "short", seed=1) for name in ("one", "same"))
    other = film(short, tmp_path / "other" / "short", seed=2)
    for name in ("video.mp4", "force.csv", "recording.toml"):
        assert (one / name).read_bytes() == (same / name).read_bytes(), name
    assert (one / "video.mp4").read_bytes() != (other / "video.mp4").read_bytes()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (replace(FILMING, scene=Scene(exposure=0.1)), "Shorten it"),
        (replace(FILMING, lost=0.7), "share of its frames"),
        (replace(FILMING, bench=replace(BENCH, tags=())), "at least one tag"),
        (replace(FILMING, bench=replace(BENCH, push=replace(PUSH, peak=30.0))), "smaller force"),
    ],
)
def test_what_cannot_be_filmed_is_refused(wrong: Filming, says: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=says):
        film(wrong, tmp_path / "film", seed=0)
    assert not (tmp_path / "film").exists()


def test_nothing_is_overwritten(folder: Path) -> None:
    with pytest.raises(RecordingError, match="not an empty folder"):
        film(FILMING, folder, seed=3)


def test_the_command_makes_a_recording(tmp_path: Path) -> None:
    out = tmp_path / "pushed"
    asked = [
        "film",
        "cubic",
        "--push",
        "s06",
        "--seconds",
        "1",
        "--fps",
        "3",
        "--camera",
        "webcam",
        "-o",
        str(out),
        "--json",
    ]
    done = CliRunner().invoke(
        app, [*asked, "-q", "--sensor", "wrist", "--gravity-m-s2", "9.81", "--base-angle-deg", "-90"]
    )
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["output"] == str(out)
    rec = read_recording(out)
    assert rec.push is not None
    assert rec.push.at == 0.6
    assert rec.gravity is not None
    assert rec.gravity.base_angle == pytest.approx(-0.5 * np.pi)
    refused = CliRunner().invoke(app, ["film", "cubik", "-o", str(tmp_path / "none"), "-q"])
    assert refused.exit_code == 2
    assert "Did you mean 'cubic'" in refused.output


@pytest.mark.slow
def test_what_is_learned_from_a_film_is_the_truth(tmp_path: Path) -> None:
    slow = replace(PUSH, before=1.5, rise=4.0, hold=0.5, fall=3.0, after=1.2)
    bench = replace(BENCH, push=slow, sensor=replace(BENCH.sensor, white_sd=0.01, bias=(0.2, -0.1)))
    out = film(replace(FILMING, bench=bench, camera=Camera(960, 540, 900.0)), tmp_path / "film", seed=5)
    found = learn(out)
    assert found.posterior is not None
    s = np.linspace(0.05, 0.9, 35)
    band, truth = found.posterior.band(s), np.asarray(bench.beam.stiffness(s))
    assert np.mean((band.low <= truth) & (truth <= band.high)) > 0.85


@pytest.mark.slow
def test_the_example_runs_and_its_seed_gives_the_same_film_again() -> None:
    words = [sys.executable, str(Path(__file__).parents[3] / "examples" / "film_a_push.py")]
    first, again = (subprocess.run(words, capture_output=True, text=True, check=True).stdout for _ in range(2))
    assert float(first.split()[-1]) < 0.1  # mm
    assert again == first
