"""Robots and cameras that speak ROS 2, without ROS: its messages over DDS, as Cyclone DDS's Python package sends them.

A topic `/a/b` is the DDS topic `rt/a/b`, a type `geometry_msgs/msg/Point` the DDS type
`geometry_msgs::msg::dds_::Point_`, and messages are plain CDR (design.ros2.org, "Topic and
Service name mapping to DDS" and "ROS 2 interface definition").
"""

from __future__ import annotations

import math
import sys
import time
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.drive.robots import DEAD_MAN, ArmState, Skill, ToolForce, ToolPose
from onebend.errors import RecordingError
from onebend.extras import package
from onebend.live.force_sensors import WRENCH
from onebend.live.sources import Clock, Device, End, Frame, Samples, StampTiming
from onebend.recording.bag_topics import picture_of
from onebend.records import Array

# Messages as their definitions have them: a name and the kind of each field.
MESSAGES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "builtin_interfaces/msg/Time": (("sec", "int32"), ("nanosec", "uint32")),
    "std_msgs/msg/Header": (("stamp", "builtin_interfaces/msg/Time"), ("frame_id", "string")),
    "geometry_msgs/msg/Point": (("x", "float64"), ("y", "float64"), ("z", "float64")),
    "geometry_msgs/msg/Vector3": (("x", "float64"), ("y", "float64"), ("z", "float64")),
    "geometry_msgs/msg/Quaternion": (("x", "float64"), ("y", "float64"), ("z", "float64"), ("w", "float64")),
    "geometry_msgs/msg/Pose": (
        ("position", "geometry_msgs/msg/Point"), ("orientation", "geometry_msgs/msg/Quaternion"),
    ),
    "geometry_msgs/msg/Wrench": (("force", "geometry_msgs/msg/Vector3"), ("torque", "geometry_msgs/msg/Vector3")),
    "geometry_msgs/msg/PoseStamped": (("header", "std_msgs/msg/Header"), ("pose", "geometry_msgs/msg/Pose")),
    "geometry_msgs/msg/WrenchStamped": (("header", "std_msgs/msg/Header"), ("wrench", "geometry_msgs/msg/Wrench")),
    "sensor_msgs/msg/Image": (
        ("header", "std_msgs/msg/Header"), ("height", "uint32"), ("width", "uint32"), ("encoding", "string"),
        ("is_bigendian", "uint8"), ("step", "uint32"), ("data", "uint8[]"),
    ),
    "sensor_msgs/msg/CompressedImage": (("header", "std_msgs/msg/Header"), ("format", "string"), ("data", "uint8[]")),
}  # fmt: skip
POSE, FORCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
IMAGE, PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
Trust = Literal["reliable", "best_effort"]
SILENT = 5.0  # s without a picture or a wrench


@cache
def message_class(name: str) -> Any:
    """The class of a message for Cyclone DDS.

    Raises:
        MissingPackageError: it is not installed.
    """
    idl, kinds = package("cyclonedds.idl", "ros2"), package("cyclonedds.idl.types", "ros2")
    annotations = package("cyclonedds.idl.annotations", "ros2")
    plain: dict[str, Any] = {"string": str, "float64": float, "uint8[]": kinds.sequence[kinds.uint8]}

    def kind_of(kind: str) -> Any:
        if kind in MESSAGES:
            return message_class(kind)
        return plain.get(kind) or getattr(kinds, kind)

    space, _, short = name.rpartition("/")
    fields = {one: kind_of(kind) for one, kind in MESSAGES[name]}
    dds = f"{space.replace('/', '::')}::dds_::{short}_"
    made = types.new_class(
        short, (idl.IdlStruct,), {"typename": dds},
        lambda space: space.update(__annotations__=fields, __module__=__name__),
    )  # fmt: skip
    made = annotations.final(dataclass(made))
    setattr(sys.modules[__name__], f"_{short}", made)  # where Cyclone DDS looks for the types of fields
    return made


def message(name: str, **values: Any) -> Any:
    """A message with these fields, the others zero."""
    filled = {}
    for one, kind in MESSAGES[name]:
        blank = message(kind) if kind in MESSAGES else {"string": "", "float64": 0.0, "uint8[]": b""}.get(kind, 0)
        filled[one] = values.get(one, blank)
    return message_class(name)(**filled)


@dataclass(frozen=True)
class RosNetwork:
    """A domain, and how well messages are to be carried."""

    domain: int = 0
    trust: Trust = "reliable"
    depth: int = 1
    frame: str = "base"  # frame_id of what is sent

    def participant(self) -> Any:
        """Raises `MissingPackageError`, `RecordingError`."""
        made = package("cyclonedds.domain", "ros2")
        try:
            return made.DomainParticipant(self.domain)
        except Exception as wrong:
            raise RecordingError(
                f"domain {self.domain} of DDS cannot be joined ({wrong}). Is a network there? See CYCLONEDDS_URI."
            ) from None

    def quality(self, *, deadline: bool = False) -> Any:
        """QoS; with a `deadline`, the other end is told when nothing comes for `DEAD_MAN`."""
        core, util = package("cyclonedds.core", "ros2"), package("cyclonedds.util", "ros2")
        policy = core.Policy
        reliable = policy.Reliability.Reliable(util.duration(milliseconds=10))
        chosen = [
            reliable if self.trust == "reliable" else policy.Reliability.BestEffort,
            policy.Durability.Volatile,
            policy.History.KeepLast(self.depth),
            policy.DataRepresentation(use_cdrv0_representation=True),
        ]
        if deadline:
            chosen.append(policy.Deadline(util.duration(milliseconds=1e3 * DEAD_MAN)))
        return core.Qos(*chosen)


class RosReader:
    """The newest messages of one topic."""

    def __init__(self, participant: Any, topic: str, name: str, quality: Any) -> None:
        made = package("cyclonedds.topic", "ros2").Topic(participant, dds_name(topic), message_class(name))
        self._util = package("cyclonedds.util", "ros2")
        self._reader = package("cyclonedds.sub", "ros2").DataReader(participant, made, qos=quality)

    def newest(self) -> Any:
        """The newest that came since the last look; None where none did."""
        came = [one for one in self._reader.take(64) if hasattr(one, "header")]
        return came[-1] if came else None

    def wait(self, seconds: float) -> Any:
        """The next; None where none came so soon."""
        for one in self._reader.take_iter(timeout=self._util.duration(seconds=max(seconds, 1e-3))):
            if hasattr(one, "header"):
                return one
        return None


def ros_writer(participant: Any, topic: str, name: str, quality: Any) -> Any:
    """What sends on one topic."""
    made = package("cyclonedds.topic", "ros2").Topic(participant, dds_name(topic), message_class(name))
    return package("cyclonedds.pub", "ros2").DataWriter(participant, made, qos=quality)


def dds_name(topic: str) -> str:
    """`/a/b` as DDS has it."""
    return f"rt/{topic.strip('/')}"


@dataclass(frozen=True)
class RosTopics:
    """Where a robot is heard and told; an empty one is not there."""

    pose_in: str = "/tool_pose"
    wrench_in: str = "/wrench"
    pose_out: str = "/target_pose"
    wrench_out: str = ""
    wrench_axes: Literal["base", "tool"] = "base"  # of what comes in


class RosRobot:
    """A robot whose controller takes PoseStamped or WrenchStamped. What it sends has a deadline of 0.1 s: a controller
    that heeds it stops where the drive is silent."""

    timing = StampTiming(delay=0.002, delay_error=0.02)

    def __init__(self, network: RosNetwork, topics: RosTopics, *, now: Callable[[], float] | None = None) -> None:
        """`now`: time for the stamps of what is sent; default: this machine's clock since 1970."""
        self.name, self._network, self._topics = f"the robot on {topics.pose_in}", network, topics
        told = [(topics.pose_out, "pose"), (topics.wrench_out, "force")]
        self.can: frozenset[Skill] = frozenset(skill for topic, skill in told if topic)  # type: ignore[misc]
        if "pose" not in self.can:
            raise RecordingError("ros2: a robot must take poses, to hold and to come back: name pose_out=/TOPIC.")
        self._now = now
        self._pose: ToolPose | None = None
        self._stamp, self._wrench = math.nan, np.full(6, np.nan)
        self._kept: tuple[Any, Any] | None = None
        self._readers: list[RosReader] = []
        self._writers: dict[Skill, Any] = {}
        self._participant: Any = None

    def connect(self, clock: Clock) -> None:
        self._participant = joined = self._network.participant()
        topics, quality = self._topics, self._network.quality()
        self._readers = [RosReader(joined, topics.pose_in, POSE, quality)]
        if topics.wrench_in:
            self._readers.append(RosReader(joined, topics.wrench_in, FORCE, quality))
        sent = self._network.quality(deadline=True)
        self._writers = {"pose": ros_writer(joined, topics.pose_out, POSE, sent)}
        if topics.wrench_out:
            self._writers["force"] = ros_writer(joined, topics.wrench_out, FORCE, sent)
        until = clock.now() + SILENT
        while self._pose is None:
            if clock.now() > until:
                raise RecordingError(
                    f"{topics.pose_in}: no PoseStamped came for {SILENT:.0f} s. Is the topic's name right, the domain "
                    f"{self._network.domain}, and qos={self._network.trust} what its publisher offers?"
                )
            self._listen()
            clock.wait_until(clock.now() + 0.02)

    def state(self) -> ArmState:
        self._listen()
        if self._kept is not None:  # what was told last is told again: a controller may have a deadline
            self._kept[0].write(self._kept[1])
        assert self._pose is not None
        return ArmState(self._stamp, self._pose, self._wrench)

    def command(self, wanted: ToolPose | ToolForce) -> None:
        if isinstance(wanted, ToolPose):
            self._tell("pose", POSE, pose=ros_pose(wanted))
        else:
            x, y, z = (wanted.plane[:, :2] @ wanted.force).tolist()
            force = message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
            self._tell("force", FORCE, wrench=message("geometry_msgs/msg/Wrench", force=force))

    def hold(self) -> None:
        assert self._pose is not None
        self.command(self._pose)

    def release(self) -> None:
        self._kept = None

    def close(self) -> None:
        self._readers, self._writers, self._participant = [], {}, None

    def _tell(self, skill: Skill, name: str, **values: Any) -> None:
        now = time.time() if self._now is None else self._now()
        stamp = message("builtin_interfaces/msg/Time", sec=int(now), nanosec=int(1e9 * (now - int(now))))
        header = message("std_msgs/msg/Header", stamp=stamp, frame_id=self._network.frame)
        made = message(name, header=header, **values)
        self._kept = (self._writers[skill], made)
        self._writers[skill].write(made)

    def _listen(self) -> None:
        if (came := self._readers[0].newest()) is not None:
            self._pose, self._stamp = tool_pose(came.pose), seconds(came.header)
        if len(self._readers) > 1 and (felt := self._readers[1].newest()) is not None:
            wrench = wrench_of(felt)
            if self._topics.wrench_axes == "tool" and self._pose is not None:
                wrench = np.concatenate([self._pose.rotation @ wrench[:3], self._pose.rotation @ wrench[3:]])
            self._wrench = wrench


def seconds(header: Any) -> float:
    """s of a header's stamp."""
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def tool_pose(pose: Any) -> ToolPose:
    """Of a geometry_msgs/Pose."""
    at, turn = pose.position, pose.orientation
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    return ToolPose(np.array([at.x, at.y, at.z]), np.asarray(rotation))


def ros_pose(pose: ToolPose) -> Any:
    """A geometry_msgs/Pose."""
    x, y, z = pose.position.tolist()
    i, j, k, w = Rotation.from_matrix(pose.rotation).as_quat().tolist()
    return message(
        "geometry_msgs/msg/Pose",
        position=message("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=message("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w),
    )


def wrench_of(felt: Any) -> Array:
    """(6,) N, N m of a WrenchStamped."""
    force, torque = felt.wrench.force, felt.wrench.torque
    return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


class _RosTopic(Device):
    """What one topic brings."""

    def __init__(self, topic: str, kind: str, network: RosNetwork, timing: StampTiming) -> None:
        super().__init__(f"the topic {topic}", timing)
        self._topic, self._kind, self._network = topic, kind, network
        self._reader: RosReader | None = None
        self._kept: Any = None

    def open(self, clock: Clock) -> None:
        self._kept = self._network.participant()
        self._reader = RosReader(self._kept, self._topic, self._kind, self._network.quality())
        self._begin(clock)

    def _next(self, wait: float) -> Any:
        """The next message, or the end where none comes any more."""
        assert self._reader is not None
        came = self._reader.wait(wait) if wait > 0.0 else self._reader.newest()
        if came is None:
            return self._silence(SILENT, "sends nothing")
        self._heard = self._clock.now()
        return came

    def close(self) -> None:
        self._reader = self._kept = None


class RosCamera(_RosTopic):
    """Pictures of a topic, plain or packed as JPEG or PNG."""

    def __init__(self, topic: str, network: RosNetwork = RosNetwork(), *, packed: bool = False) -> None:
        super().__init__(topic, PACKED if packed else IMAGE, network, StampTiming(delay=0.01, delay_error=0.05))

    def read(self, wait: float) -> Frame | End | None:
        came = self._next(wait)
        if came is None or isinstance(came, End):
            return came
        try:
            picture = picture_of(came, self.name)
        except RecordingError as wrong:
            return End(str(wrong), fault=True)
        return Frame(picture, seconds(came.header), self._heard)


class RosForce(_RosTopic):
    """A WrenchStamped as a force sensor."""

    columns: tuple[str, ...] = WRENCH

    def __init__(self, topic: str, network: RosNetwork = RosNetwork()) -> None:
        super().__init__(topic, FORCE, network, StampTiming(delay=0.002, delay_error=0.02))

    def read(self, wait: float) -> Samples | End | None:
        came = self._next(wait)
        if came is None or isinstance(came, End):
            return came
        return Samples(np.array([seconds(came.header)]), wrench_of(came)[None], self._heard)
