"""The camera's calibration from a bag: as its driver published it, and refused where it does not fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import RecordingError
from onebend.recording.bag_topics import INFO
from onebend.recording.calibration import find_boards
from onebend.recording.entries import CameraEntry
from onebend.recording.folder import read_recording
from tests.recording import bagged
from tests.recording.bags.test_recorded_topics import TOML
from tests.recording.board_film import CHARUCO, poses, view
from tests.recording.filmed import HEIGHT, WIDTH

K = [600.0, 0.0, 322.0, 0.0, 601.0, 177.0, 0.0, 0.0, 1.0]
P = [580.0, 0.0, 320.0, 0.0, 0.0, 580.0, 180.0, 0.0, 0.0, 0.0, 1.0, 0.0]
LENS = [-0.08, 0.02, 5e-4, -3e-4, 0.01]
DEFINITION = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
    "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    f"{bagged.HEADER}\n{bagged.RULE}\nMSG: sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\n"
    "uint32 height\nuint32 width\nbool do_rectify"
)
SOURCES = '[video]\nfile = "run.mcap"\ntopic = "/image"\n[camera]\ncamera_info = "/camera_info"\n'


def info(**changed: Any) -> dict[str, Any]:
    """A message, as `sensor_msgs/CameraInfo`."""
    roi = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    said: dict[str, Any] = {
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": LENS,
        "k": K,
        "r": np.eye(3).ravel().tolist(),
        "p": P,
        "binning_x": 0,
        "binning_y": 0,
        "roi": {**roi, "do_rectify": False},
    }
    return {**said, **changed, "roi": {**said["roi"], **changed.get("roi", {})}}


def write(
    path: Path, infos: Sequence[dict[str, Any]], size: tuple[int, int] = (WIDTH, HEIGHT), image: str = "/image"
) -> Path:
    """Three grey pictures and these messages."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        films = writer.register_msgdef("sensor_msgs/msg/Image", bagged.IMAGE)
        schema = writer.register_msgdef(INFO, DEFINITION)
        for i, said in enumerate(infos):
            at = bagged.START + i * 10_000_000
            writer.write_message("/camera_info", schema, {"header": bagged.header(at, "camera"), **said}, log_time=at)
        for i in range(3):
            at = bagged.START + i * 33_000_000
            picture = np.full((size[1], size[0]), 90 + i, dtype=np.uint8)
            writer.write_message(image, films, bagged.image(at, picture), log_time=at)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_ros1(path: Path, said: dict[str, Any]) -> Path:
    """The same by ROS 1, whose names are D, K, R and P."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with Ros1Writer(path) as writer:
        infos = writer.add_connection("/camera_info", INFO, typestore=store)
        films = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=store)
        for i in range(3):
            at = bagged.START + i * 33_000_000
            time = types["builtin_interfaces/msg/Time"](sec=at // bagged.EPOCH, nanosec=at % bagged.EPOCH)
            top = types["std_msgs/msg/Header"](seq=i, stamp=time, frame_id="camera")
            picture = np.full(HEIGHT * WIDTH, 90 + i, dtype=np.uint8)
            frame = types["sensor_msgs/msg/Image"](top, HEIGHT, WIDTH, "mono8", 0, WIDTH, picture)
            numbers = {name.upper(): np.array(said[name]) for name in "dkrp"}
            rest = {name: said[name] for name in ("height", "width", "distortion_model", "binning_x", "binning_y")}
            roi = types["sensor_msgs/msg/RegionOfInterest"](**said["roi"])
            message = types[INFO](header=top, **numbers, **rest, roi=roi)
            writer.write(infos, at, store.serialize_ros1(message, INFO))
            writer.write(films, at, store.serialize_ros1(frame, "sensor_msgs/msg/Image"))
    return path


def camera_of(folder: Path, said: Sequence[dict[str, Any]], sources: str = SOURCES, **how: Any) -> CameraEntry:
    """[camera] of a recording whose bag says this."""
    write(folder / "run.mcap", said, **how)
    return camera_in(folder, sources)


def camera_in(folder: Path, sources: str) -> CameraEntry:
    (folder / "recording.toml").write_text(TOML.replace("[push]\nat_s = 1.0\n", "") + sources, encoding="utf-8")
    camera = read_recording(folder).camera
    assert camera is not None
    return camera


def test_what_the_driver_says_is_the_camera_by_ros_2_and_ros_1(tmp_path: Path) -> None:
    expected = CameraEntry(WIDTH, HEIGHT, 600.0, 601.0, 322.0, 177.0, tuple(LENS), scale_sd=0.002)
    sources = SOURCES + "scale_sd = 0.002\n"
    assert camera_of(tmp_path, [info()] * 3, sources) == expected
    write_ros1(tmp_path / "run.bag", info())
    assert camera_in(tmp_path, sources.replace("run.mcap", "run.bag")) == expected
    said = [remark.text for remark in read_recording(tmp_path).remarks if "/camera_info" in remark.text]
    assert said == ["The camera is that of /camera_info: lens plumb_bob."]


def test_a_part_of_the_sensor_or_a_binned_picture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="Record the picture that was calibrated"):
        camera_of(tmp_path, [info(binning_x=2, binning_y=2)], size=(320, 180))


def test_rectified_pictures_have_the_matrix_p_and_no_lens(tmp_path: Path) -> None:
    sources = SOURCES.replace('"/image"', '"/camera/image_rect_color"')
    camera = camera_of(tmp_path, [info()], sources, image="/camera/image_rect_color")
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (580.0, 580.0, 320.0, 180.0)
    assert camera.dist == (0.0,) * 5


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ([info(k=[0.0] * 9)], r"camera_info of .* is not calibrated.*onebend calibrate"),
        ([info(k=[float("nan")] * 9)], "K holds what is no number"),
        ([info(k=[600.0, 3.0, *K[2:]])], "oblique axes"),
        ([info(distortion_model="scheimpflug")], "'scheimpflug' is not known; plumb_bob, rational_polynomial"),
        ([info(d=[0.1, 0.2])], "D has 2 numbers; plumb_bob has 4 or 5"),
        ([info(distortion_model="rational_polynomial", d=[0.3, 0.05, 0.0, 0.0, 0.01, 0.38, 0.06, 0.01])], "k4 to k6"),
        ([info(width=2 * WIDTH, height=2 * HEIGHT)], "of pictures of 1280 x 720, /image of .* has 640 x 360"),
        ([info(), info(), info(k=[610.0, *K[1:]])], "changes at message 2"),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(tmp_path: Path, said: list[dict[str, Any]], message: str) -> None:
    with pytest.raises(RecordingError, match=rf"recording.toml:\d+: .*{message}"):
        camera_of(tmp_path, said)


@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        ('"/camera_info"', '"/camera_inof"', "has no topic /camera_inof.* Did you mean /camera_info"),
        ('"/camera_info"', '"/image"', "/image of .* is sensor_msgs/msg/Image, no calibration"),
        ('"/camera_info"\n', '"/camera_info"\nfx = 600.0\n', "stands for the whole calibration. Remove it, or fx"),
        ('file = "run.mcap"\ntopic = "/image"', 'file = "film.mp4"', "the film is in no bag"),
    ],
)
def test_mistakes_in_naming_a_calibration_are_explained(tmp_path: Path, wrong: str, right: str, message: str) -> None:
    (tmp_path / "film.mp4").write_bytes(b"film")
    with pytest.raises(RecordingError, match=message):
        camera_of(tmp_path, [info()], SOURCES.replace(wrong, right))


def test_a_board_is_found_in_a_bag_as_in_its_pictures_raw_and_packed(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    shown = [view(CHARUCO, turn, place).clip(0, 255).astype(np.uint8) for turn, place in poses(3, seed=3)]
    stamped = [(bagged.START + i * 500_000_000, one) for i, one in enumerate(shown)]
    raw = find_boards(bagged.write_mcap(tmp_path / "raw.mcap", None, stamped), CHARUCO, topic="/image")
    packed = find_boards(bagged.write_packed(tmp_path / "packed.mcap", stamped), CHARUCO, topic="/image")
    assert [one.frame for one in raw.views] == [0, 1, 2]
    assert (raw.width, raw.height) == (640, 480)
    for one, other in zip(raw.views, packed.views, strict=True):
        assert np.array_equal(one.pixel, other.pixel)


def test_calibrate_asks_for_the_topic_of_a_bag(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    write(tmp_path / "run.mcap", [info()])
    common = ["calibrate", "--board", "charuco", "8x6", "--square-mm", "20", "-o", str(tmp_path / "camera.toml")]
    env = {"COLUMNS": "200"}
    asked = CliRunner().invoke(app, [*common, str(tmp_path / "run.mcap")], env=env)
    assert asked.exit_code == 2
    assert "Add --topic /image" in asked.stderr
    asked = CliRunner().invoke(app, [*common, str(tmp_path / "run.mcap"), "--topic", "/image"], env=env)
    assert "charuco was found in 0 of 3 frames" in asked.stderr
    (tmp_path / "film.mp4").write_bytes(b"film")
    asked = CliRunner().invoke(app, [*common, str(tmp_path / "film.mp4"), "--topic", "/image"], env=env)
    assert "is no bag and has no topics" in asked.stderr
