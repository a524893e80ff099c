"""Recordings whose film and force are in a robot's log: one clock, and mistakes that are named."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import RecordingError
from onebend.recording.camera import measure_markers
from onebend.recording.entries import VideoEntry
from onebend.recording.folder import read_recording
from onebend.recording.force import read_log
from onebend.recording.force_log import likely_forces, read_force_log
from onebend.recording.observe import ObserveSettings, observe
from onebend.recording.tags import detect_tags
from onebend.records import Observations
from onebend.report.overview import overview
from tests.recording import bagged, filmed
from tests.recording.bags.test_bags import LOG, PICTURES
from tests.recording.test_video import write_video

TOML = """\
format = 1
[beam]
length_m = 0.15
[tags]
size_m = 0.012
[[tags.on_base]]
id = 0
s = 0
[[tags.on_beam]]
id = 1
s = 0.333333
[[tags.on_beam]]
id = 2
s = 0.666667
[[tags.on_beam]]
id = 3
s = 1
[push]
at_s = 1.0
"""
BOTH = (
    '[video]\nfile = "run.mcap"\ntopic = "/image"\n[force]\nfile = "run.mcap"\ntopic = "/wrench"\nacts_on = "robot"\n'
)
FRAMES = 20
FORCED = replace(bagged.log(200, 100.0), stamp=bagged.START - 400_000_000 + np.arange(200) * 10_000_000)


@cache
def film() -> list[np.ndarray]:
    """Pictures of a beam that bends and straightens."""
    frames = filmed.film(filmed.poses(FRAMES), [0, 1, 2, 3], filmed.view())
    return [frame.luma for frame in frames]


def folder_of(folder: Path, sources: str, toml: str = TOML) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recording.toml").write_text(toml + sources, encoding="utf-8")
    return folder


def pushed_force() -> bagged.Log:
    """A log whose force along y follows the film's bend, with a little noise; it begins 0.4 s before the film."""
    at = (FORCED.stamp - bagged.START) * 1e-9
    bend = np.where((at > 0) & (at < FRAMES / 30), np.sin(np.pi * at / (FRAMES / 30)) ** 2, 0.0)
    noise = 0.01 * np.random.default_rng(3).standard_normal((len(at), 3))
    return replace(FORCED, force=noise - bend[:, None] * [0.0, 0.3, 0.0])


def look(folder: Path) -> Observations:
    """Everything but the force's agreement with the bending, which is made up."""
    return observe(folder, settings=ObserveSettings(threads=2, check_force=False))


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders of one push: in a film and a CSV file, and in a bag."""
    place = tmp_path_factory.mktemp("twice")
    log, ticks = pushed_force(), [round(1000 * i / 30) for i in range(FRAMES)]
    video = '[video]\nfile = "film.mkv"\nstart_s = 0.4\nstart_uncertainty_s = 0.1\n'
    matrix, dist = filmed.view().matrix, filmed.view().dist.tolist()
    camera = f"[camera]\nwidth = {filmed.WIDTH}\nheight = {filmed.HEIGHT}\nfx = {matrix[0, 0]}\n"
    camera += f"fy = {matrix[1, 1]}\ncx = {matrix[0, 2]}\ncy = {matrix[1, 2]}\ndist = {dist}\n"
    plain = folder_of(place / "plain", f'{camera}{video}[force]\nfile = "force.csv"\nacts_on = "robot"\n')
    write_video(plain / "film.mkv", film(), ticks, pixels="gray")
    rows = zip(((log.stamp - log.stamp[0]) / 1e9).tolist(), log.force.tolist(), strict=True)
    text = "".join(f"{at!r},{x!r},{y!r}\n" for at, (x, y, _) in rows)
    (plain / "force.csv").write_text(f"time_s,fx_N,fy_N\n{text}", encoding="utf-8")
    robot = folder_of(place / "robot", camera + BOTH)
    stamps = [bagged.START + tick * 1_000_000 for tick in ticks]
    bagged.write_mcap(robot / "run.mcap", log, list(zip(stamps, film(), strict=True)), chunk=1 << 20)
    return plain, robot


@pytest.mark.slow
def test_a_bag_shows_the_markers_and_forces_that_the_files_show(twice: tuple[Path, Path]) -> None:
    plain, robot = (read_recording(folder) for folder in twice)
    assert robot.start == pytest.approx(plain.start, abs=1e-9)
    found = []
    for rec in (plain, robot):
        assert rec.video is not None
        found.append(measure_markers(detect_tags(rec.video, rec.tags, threads=2), rec))
    assert np.array_equal(found[0].xy, found[1].xy)
    assert np.array_equal(found[0].angle, found[1].angle)
    assert found[0].time == pytest.approx(found[1].time, abs=1e-9)
    logs = [read_log(rec) for rec in (plain, robot)]
    assert logs[0] is not None
    assert logs[1] is not None
    assert np.array_equal(logs[0].force, logs[1].force)
    assert logs[0].time == pytest.approx(logs[1].time, abs=1e-9)


@pytest.mark.slow
def test_a_push_in_a_bag_is_observed_as_the_same_push_in_a_film_and_a_file(twice: tuple[Path, Path]) -> None:
    plain, robot = (look(folder) for folder in twice)
    assert len(plain.time) == FRAMES
    assert np.array_equal(robot.xy, plain.xy)
    assert np.array_equal(robot.angle, plain.angle)
    assert robot.time == pytest.approx(plain.time, abs=1e-6)
    assert robot.force == pytest.approx(plain.force, abs=1e-6)
    assert plain.source.clock is not None
    assert robot.source.clock is not None
    assert robot.source.clock.stated == pytest.approx(0.4, abs=1e-9)
    assert robot.source.clock.offset == pytest.approx(plain.source.clock.offset, abs=1e-6)
    assert robot.source.video_topic == "/image"
    said = " ".join(remark.text for remark in robot.source.remarks)
    assert "share the bag's clock: the film starts at 0.4000 s by their headers' stamps" in said
    assert "does not say rotation_deg, axes of [force]" in said
    assert "when the video starts" not in said


def test_what_is_written_of_the_start_counts_more_than_the_bag(tmp_path: Path) -> None:
    bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES)
    folder_of(tmp_path, BOTH.replace('topic = "/image"\n', 'topic = "/image"\nstart_s = 7.0\n'))
    assert read_recording(tmp_path).start == (7.0, 2.0)
    folder_of(tmp_path, BOTH.replace('topic = "/image"\n', 'topic = "/image"\nstart_uncertainty_s = 0.7\n'))
    assert read_recording(tmp_path).start == pytest.approx((0.001, 0.7), abs=1e-12)
    bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES, stamped=False)
    folder_of(tmp_path, BOTH)
    assert read_recording(tmp_path).start == pytest.approx((0.001, 0.3), abs=1e-12)


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        (
            'topic = "/wrench"\n',
            "",
            r"lacks topic: .*/image \(sensor_msgs/msg/Image, 12 messages\).*topic = \"/wr",
        ),
        ('topic = "/wrench"', 'topic = "/wrensh"', "has no topic /wrensh. It holds /image .* Did you mean /wrench"),
        ('topic = "/wrench"', 'topic = "/wrench"\naxes = ["x", "-x"]', "axes names one axis twice"),
        ('topic = "/wrench"', 'topic = "/wrench"\ntime_unit = "ms"', "Remove time_unit"),
        ('topic = "/image"', 'topic = "/image"\nframe_times = "t.csv"', "Remove frame_times"),
        ('topic = "/image"', 'topic = "/wrench"', "not images"),
        ("at_s = 1.0", 'column = "push_s"', "bag, which has no columns"),
    ],
)
def test_mistakes_in_naming_a_bag_are_explained(tmp_path: Path, wrong: str, right: str, message: str) -> None:
    bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES)
    (tmp_path / "t.csv").write_text("time_s\n0\n", encoding="utf-8")
    toml = TOML + BOTH
    assert wrong in toml
    folder_of(tmp_path, "", toml.replace(wrong, right))
    with pytest.raises(RecordingError, match=message):
        read_recording(tmp_path)


def test_keys_of_bags_are_refused_of_other_files(tmp_path: Path) -> None:
    (tmp_path / "force.csv").write_text("time_s,fx_N,fy_N\n", encoding="utf-8")
    bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES)
    folder_of(tmp_path, BOTH.replace('[force]\nfile = "run.mcap"', '[force]\nfile = "force.csv"'))
    with pytest.raises(RecordingError, match=r"force.csv is no bag. Remove topic"):
        read_recording(tmp_path)


def test_check_and_topics_say_what_is_in_a_bag(tmp_path: Path) -> None:
    bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES)
    folder_of(tmp_path, BOTH)
    rows = dict(overview(tmp_path).rows)
    assert rows["video"] == "run.mcap /image, 8 x 6, 12 frames, 0.37 s"
    assert rows["force log"].startswith("run.mcap /wrench, 60 rows, 0.59 s at 100")
    asked = CliRunner().invoke(app, ["topics", str(tmp_path / "run.mcap")], env={"COLUMNS": "150"})
    assert asked.exit_code == 0
    assert 'topic = "/wrench"' in asked.stdout
    assert 'topic = "/image"' in asked.stdout
    told = json.loads(CliRunner().invoke(app, ["topics", str(tmp_path / "run.mcap"), "--json"]).stdout)
    assert (told["force"], told["image"]) == ("/wrench", "/image")
    assert [row["count"] for row in told["topics"]] == [12, 60]
    assert told["topics"][1]["rate"] == pytest.approx(100.0)
    assert told["topics"][1]["start"] == pytest.approx(bagged.START * 1e-9, abs=1e-6)


def test_a_cut_bag_is_told_in_one_message(tmp_path: Path) -> None:
    bag = bagged.write_mcap(tmp_path / "run.mcap", LOG, PICTURES)
    bag.write_bytes(bag.read_bytes()[:3500])
    asked = CliRunner().invoke(app, ["topics", str(bag)])
    assert asked.exit_code == 2
    assert "damaged" in asked.stderr
    assert "a-bag-is-damaged" in asked.stderr
    folder_of(tmp_path, BOTH)
    with pytest.raises(RecordingError, match="mcap recover"):
        read_recording(tmp_path)


def test_tags_in_a_bag_of_packed_pictures_are_found(tmp_path: Path) -> None:
    stamps = [bagged.START + i * 33_333_333 for i in range(3)]
    bag = bagged.write_packed(tmp_path / "run.mcap", list(zip(stamps, film()[:3], strict=True)))
    packed = detect_tags(VideoEntry(file=bag, topic="/image"), filmed.recording().tags, threads=1)
    plain = write_video(tmp_path / "film.mkv", film()[:3], [0, 33, 67], pixels="gray")
    same = detect_tags(plain, filmed.recording().tags, threads=1).corners
    assert np.array_equal(packed.of_searched()[0].corners, same[np.isfinite(same).all(axis=(1, 2, 3))])


@pytest.mark.parametrize(
    ("header", "found"),
    [
        (("time", "O_F_ext_hat_K[0]", "O_F_ext_hat_K[1]"), (1, 2)),
        (("%time", "a.K_F_ext_hat_K0", "a.K_F_ext_hat_K1", "a.O_F_ext_hat_K0", "a.O_F_ext_hat_K1"), (3, 4)),
        (("__time", "/ft/wrench/force/x", "/ft/wrench/force/y"), (1, 2)),
        (("when", "left", "right"), None),
    ],
)
def test_the_forces_in_text_logs_of_robots_are_recognised(
    header: tuple[str, ...], found: tuple[int, int] | None
) -> None:
    assert likely_forces(header) == (None if found is None else tuple(header[i] for i in found))


def test_a_log_without_the_columns_says_which_it_has(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("when,left,right\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="found when, left, right"):
        read_force_log(path, ("time_s", "fx_N", "fy_N"))


def test_units_of_time_are_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(f"{10 * i}, {i}, {0.1 * i}\n" for i in range(20))
    path.write_text(f"time, O_F_ext_hat_K[0], O_F_ext_hat_K[1]\n{rows}", encoding="utf-8")
    found = read_force_log(path, ("time", "O_F_ext_hat_K[0]", "O_F_ext_hat_K[1]"), time_unit="ms")
    assert found.time == pytest.approx(np.arange(20) / 100)
    assert found.force[:, 0] == pytest.approx(np.arange(20))
