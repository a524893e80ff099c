"""An arm on the other side of ROS 2's wires, in a process of its own, with message types written out by hand.

    python -m tests.drive.ros_arm DOMAIN

It says where it is 100 times a second on /tool_pose and /wrench, sends pictures on /image, goes where /target_pose
says, and answers each line on standard input with what it was told so far. Cyclone DDS reads the annotations
themselves: they are no strings here.
"""

import sys
import threading
import time
from dataclasses import dataclass, field

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tests.drive.other_end import answer_lines


@final
@dataclass
class Stamp(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Stamp
    frame_id: str


@final
@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float
    y: float
    z: float


@final
@dataclass
class Vector(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float
    y: float
    z: float


@final
@dataclass
class Turn(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float
    y: float
    z: float
    w: float


@final
@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Turn


@final
@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@final
@dataclass
class Wrench(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector
    torque: Vector


@final
@dataclass
class WrenchStamped(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header
    wrench: Wrench


@final
@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]  # type: ignore[type-arg]


@dataclass
class Arm:
    """Where it is, and what it was told."""

    pose: Pose = field(default_factory=lambda: Pose(Point(0.4, -0.2, 0.3), Turn(0.0, 0.0, 0.0, 1.0)))
    told: list[dict[str, object]] = field(default_factory=list)

    def serve(self, domain: int) -> None:
        joined = DomainParticipant(domain)
        quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1))
        sent = {
            name: DataWriter(joined, Topic(joined, f"rt/{name}", kind), qos=quality)
            for name, kind in (("tool_pose", PoseStamped), ("wrench", WrenchStamped), ("image", Image))
        }
        heard = DataReader(joined, Topic(joined, "rt/target_pose", PoseStamped), qos=quality)
        pushed = DataReader(joined, Topic(joined, "rt/target_wrench", WrenchStamped), qos=quality)
        while True:
            now = time.time_ns()
            header = Header(Stamp(now // 10**9, now % 10**9), "base")
            sent["tool_pose"].write(PoseStamped(header, self.pose))
            sent["wrench"].write(WrenchStamped(header, Wrench(Vector(1.0, 2.0, 3.0), Vector(0.1, 0.2, 0.3))))
            data = [10 * row + column for row in range(2) for column in (0, 1, 2, 3, 4, 5)]
            sent["image"].write(Image(header, 2, 2, "rgb8", 0, 6, data))  # type: ignore[arg-type]
            for one in heard.take(64):
                if isinstance(one, PoseStamped):
                    self.pose = one.pose
                    at, turn = one.pose.position, one.pose.orientation
                    self.told.append({"frame": one.header.frame_id, "at": [at.x, at.y, at.z],
                                      "turn": [turn.x, turn.y, turn.z, turn.w]})  # fmt: skip
            for felt in pushed.take(64):
                if isinstance(felt, WrenchStamped):
                    force = felt.wrench.force
                    self.told.append({"force": [force.x, force.y, force.z]})
            time.sleep(0.01)


def main() -> None:
    arm = Arm()
    threading.Thread(target=arm.serve, args=(int(sys.argv[1]),), daemon=True).start()
    answer_lines(lambda _: arm.told)


if __name__ == "__main__":
    main()
