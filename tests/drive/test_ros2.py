"""ROS 2 without ROS: messages against a second implementation, and an arm in another process."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image as Photo
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from onebend.drive.robots import Robot, ToolForce, ToolPose
from onebend.drive.ros2 import MESSAGES, RosNetwork, RosRobot, RosTopics, message, message_class
from onebend.drive.specs import camera_of, force_of, robot_of
from onebend.errors import RecordingError
from onebend.live.sources import End, Frame, HostClock, Samples
from onebend.recording.bag_topics import picture_of
from tests.drive.other_end import Ask, other_end, wait_for

pytest.importorskip("cyclonedds")
STORE = get_typestore(Stores.ROS2_HUMBLE)
# Loopback alone, without multicast, as two containers on one machine have it.
LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
DOMAIN = 1 + os.getpid() % 200


def random_message(name: str, rng: np.random.Generator) -> Any:
    made: dict[str, Any] = {}
    for field, kind in MESSAGES[name]:
        if kind in MESSAGES:
            made[field] = random_message(kind, rng)
        elif kind == "string":
            made[field] = "base" * int(rng.integers(1, 4))
        elif kind == "uint8[]":
            made[field] = bytes(rng.integers(0, 256, int(rng.integers(1, 9)), dtype=np.uint8))
        else:
            made[field] = float(rng.standard_normal()) if kind == "float64" else int(rng.integers(0, 200))
    return message(name, **made)


def plain(one: Any, name: str) -> Any:
    """The fields as lists, texts and numbers, of either implementation."""
    out = {}
    for field, kind in MESSAGES[name]:
        value = getattr(one, field)
        if kind in MESSAGES:
            out[field] = plain(value, kind)
        else:
            out[field] = list(bytes(value)) if kind == "uint8[]" else value
    return out


@pytest.mark.parametrize("name", MESSAGES)
@pytest.mark.parametrize("seed", range(3))
def test_messages_are_those_of_ros(name: str, seed: int) -> None:
    ours = random_message(name, np.random.default_rng(seed))
    theirs = STORE.deserialize_cdr(ours.serialize(use_version_2=False), name)
    assert plain(theirs, name) == plain(ours, name)
    back = message_class(name).deserialize(bytes(STORE.serialize_cdr(theirs, name)))
    assert plain(back, name) == plain(ours, name)


def test_pictures_become_luma() -> None:
    rng = np.random.default_rng(0)
    colours = rng.integers(0, 256, (3, 5, 3), dtype=np.uint8)
    rows = np.zeros((3, 18), np.uint8)  # lines are longer than the picture is wide
    rows[:, :15] = colours.reshape(3, 15)
    sent = message("sensor_msgs/msg/Image", height=3, width=5, encoding="bgr8", step=18, data=rows.tobytes())
    got = picture_of(sent, "here")
    assert np.abs(got - (0.114 * colours[..., 0] + 0.587 * colours[..., 1] + 0.299 * colours[..., 2])).max() <= 0.5001
    sent.encoding = "32FC1"
    with pytest.raises(RecordingError, match="'32FC1' cannot be read"):
        picture_of(sent, "here")
    grey, file = np.tile(np.arange(64, dtype=np.uint8), (64, 1)), io.BytesIO()
    Photo.fromarray(grey).save(file, "PNG")
    packed = message("sensor_msgs/msg/CompressedImage", data=file.getvalue())
    assert np.array_equal(picture_of(packed, "here"), grey)


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ask]:
    """Asks the arm what it was told."""
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    with other_end("tests.drive.ros_arm", str(DOMAIN)) as ask:
        yield ask


def turned(robot: Robot, until: Any) -> Any:
    """The robot's state, as soon as it is so; each look tells it again."""
    return wait_for(lambda: state if until(state := robot.state()) else None)


def test_an_arm_in_another_process_goes_where_it_is_told(arm: Ask) -> None:
    topics = RosTopics(wrench_out="/target_wrench", wrench_axes="tool")
    robot = RosRobot(RosNetwork(DOMAIN, frame="world"), topics, now=lambda: 12.5)
    assert robot.can == {"pose", "force"}
    robot.connect(HostClock())
    state = turned(robot, lambda state: np.isfinite(state.wrench).all())
    assert state.pose.position.tolist() == [0.4, -0.2, 0.3]
    assert state.wrench.tolist() == [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    quarter = np.asarray(Rotation.from_rotvec([0.0, 0.0, 0.5 * np.pi]).as_matrix())
    robot.command(ToolPose(np.array([0.5, -0.1, 0.2]), quarter))
    there = turned(robot, lambda state: state.pose.position[0] == 0.5)
    assert there.pose.rotation == pytest.approx(quarter)
    newer = turned(robot, lambda state: abs(state.wrench[0] + 2.0) < 1e-9)  # the wrench turns with the tool
    assert newer.wrench == pytest.approx([-2.0, 1.0, 3.0, -0.2, 0.1, 0.3])
    robot.command(ToolForce(np.array([0.3, 0.4]), np.eye(3), 0.03))
    wait_for(lambda: robot.state() and any("force" in one for one in arm()), "the force")
    told = arm()
    assert told[0] == {"frame": "world", "at": [0.5, -0.1, 0.2], "turn": pytest.approx([0.0, 0.0, 0.5**0.5, 0.5**0.5])}
    assert next(one["force"] for one in told if "force" in one) == pytest.approx([0.3, 0.4, 0.0])
    robot.hold()
    assert robot.state().pose.position.tolist() == [0.5, -0.1, 0.2]
    robot.release()
    robot.close()


@pytest.mark.usefixtures("arm")
def test_a_camera_and_a_wrench_on_topics() -> None:
    camera, force = camera_of(f"ros2:{DOMAIN},topic=/image"), force_of(f"ros2:{DOMAIN},topic=wrench")
    clock = HostClock()
    camera.open(clock)
    force.open(clock)
    frames = [got for _ in range(40) if isinstance(got := camera.read(0.5), Frame)]
    assert frames[0].picture.tolist() == [[1, 4], [11, 14]]
    assert frames[-1].stamp > frames[0].stamp > 1.6e9
    rows = [one for _ in range(40) if isinstance(one := force.read(0.5), Samples)]
    assert rows[0].force.tolist() == [[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]]
    camera.close()
    force.close()


class Passing(HostClock):
    """Time passes when somebody waits, and only then."""

    passed = 0.0

    def now(self) -> float:
        return self.passed

    def wait_until(self, moment: float) -> None:
        self.passed = max(self.passed, moment)


def test_nobody_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    robot = RosRobot(RosNetwork(DOMAIN + 1), RosTopics(pose_in="/nowhere"))
    with pytest.raises(RecordingError, match="/nowhere: no PoseStamped came for 5 s"):
        robot.connect(Passing())
    camera = camera_of(f"ros2:{DOMAIN + 1},topic=/image,qos=best_effort")
    clock = Passing()
    camera.open(clock)
    assert camera.read(0.0) is None
    clock.passed = 6.0
    ended = camera.read(0.0)
    assert isinstance(ended, End)
    assert ended.fault
    assert "the topic /image sends nothing" in ended.why
    camera.close()


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("ros2:0,pose_out=", "must take poses"),
        ("ros2:0,qos=perfect", "take reliable or best_effort"),
        ("ros2:400", "domain"),
        ("ros2:0,topic=/a", "topic"),
        ("ros2:0,wrench_axes=camera", "take base or tool"),
    ],
)
def test_a_wrong_spec_is_refused(spec: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        robot_of(spec)(None, None)  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="say which topic"):
        camera_of("ros2:0")
