"""Bags made without the package: what the tests of bags know to be in them."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer as McapWriter
from PIL import Image
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from onebend.records import Array

START = 1_700_000_000_123_456_789  # ns
EPOCH = 10**9
TIME = "builtin_interfaces/Time stamp\nstring frame_id"
RULE = "=" * 80
HEADER = f"\n{RULE}\nMSG: std_msgs/Header\n{TIME}\n{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
VECTOR = f"\n{RULE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
WRENCH = f"\n{RULE}\nMSG: geometry_msgs/Wrench\nVector3 force\nVector3 torque"
STAMPED = f"std_msgs/Header header\nWrench wrench{WRENCH}{VECTOR}{HEADER}"
BARE = f"Vector3 force\nVector3 torque{VECTOR}"
IMAGE = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data{HEADER}"
)
PACKED = f"std_msgs/Header header\nstring format\nuint8[] data{HEADER}"
ROBOT = (
    "std_msgs/Header header\ngeometry_msgs/WrenchStamped k_f_ext_hat_k\ngeometry_msgs/WrenchStamped o_f_ext_hat_k\n"
    f"float64 time\n{RULE}\nMSG: geometry_msgs/WrenchStamped\nstd_msgs/Header header\ngeometry_msgs/Wrench wrench"
    f"{WRENCH}{VECTOR}{HEADER}"
)


@dataclass(frozen=True)
class Log:
    """Forces (N, 3) N at stamps (N,) ns."""

    stamp: np.ndarray
    force: Array


def log(count: int = 60, rate: float = 100.0, seed: int = 0) -> Log:
    """Stamps as even as whole ns allow."""
    stamp = START + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    return Log(stamp, np.random.default_rng(seed).standard_normal((count, 3)))


def header(stamp: int, frame: str) -> dict[str, object]:
    return {"stamp": {"sec": int(stamp) // EPOCH, "nanosec": int(stamp) % EPOCH}, "frame_id": frame}


def vector(row: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, row), strict=True))


def wrench(row: Sequence[float]) -> dict[str, object]:
    return {"force": vector(row), "torque": vector((0.0, 0.0, 0.0))}


def write_mcap(
    path: Path,
    log: Log | None,
    pictures: Sequence[tuple[int, np.ndarray]] = (),
    *,
    kind: str = "stamped",
    frame: str = "panda_link0",
    delay: int = 7_000_000,
    chunk: int = 4096,
    stamped: bool = True,
) -> Path:
    """Wrenches on /wrench and mono8 pictures on /image, received `delay` ns after their stamps."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=chunk)
        types = {
            "stamped": ("geometry_msgs/msg/WrenchStamped", STAMPED),
            "bare": ("geometry_msgs/msg/Wrench", BARE),
            "robot": ("franka_msgs/msg/FrankaRobotState", ROBOT),
        }
        schema = writer.register_msgdef(*types[kind])
        films = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE)
        events: list[tuple[int, Any, Any]] = []
        if log is not None:
            events += [(int(at), force, None) for at, force in zip(log.stamp, log.force, strict=True)]
        events += [(int(at), None, picture) for at, picture in pictures]
        for at, force, picture in sorted(events, key=lambda event: event[0]):
            top = header(at if stamped else 0, frame)
            if picture is None:
                one = {"header": top, "wrench": wrench(force)}
                message = {
                    "stamped": one,
                    "bare": wrench(force),
                    "robot": {
                        "header": top,
                        "o_f_ext_hat_k": one,
                        "k_f_ext_hat_k": {**one, "wrench": wrench(-force)},
                        "time": 0.0,
                    },
                }[kind]
                writer.write_message("/wrench", schema, message, log_time=at + delay)
            else:
                writer.write_message("/image", films, image(at if stamped else 0, picture), log_time=at + delay)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def image(stamp: int, picture: np.ndarray, encoding: str = "mono8") -> dict[str, object]:
    data = np.ascontiguousarray(picture)
    return {
        "header": header(stamp, "camera"),
        "height": data.shape[0],
        "width": data.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": data.nbytes // len(data),
        "data": data.tobytes(),
    }


def write_packed(path: Path, pictures: Sequence[tuple[int, np.ndarray]]) -> Path:
    """PNGs on /image."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/CompressedImage", PACKED)
        for at, picture in pictures:
            png = BytesIO()
            Image.fromarray(picture).save(png, "png")
            message = {"header": header(at, "camera"), "format": "mono8; png compressed", "data": png.getvalue()}
            writer.write_message("/image", schema, message, log_time=at)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def cdr_wrench(stamp: int, frame: str, force: Sequence[float]) -> bytes:
    """A WrenchStamped in little-endian CDR, by hand: four bytes say so, the rest is aligned from there."""
    name = frame.encode() + b"\0"
    body = struct.pack("<iI", stamp // EPOCH, stamp % EPOCH) + struct.pack("<I", len(name)) + name
    body += b"\0" * (-len(body) % 8)
    return b"\0\1\0\0" + body + struct.pack("<6d", *map(float, force), 0.0, 0.0, 0.0)


def write_db3(
    folder: Path,
    log: Log,
    *,
    metadata: bool = True,
    topic: str = "/wrench",
    parts: int = 1,
    kind: str = "geometry_msgs/msg/WrenchStamped",
    frames: Sequence[str] = ("panda_link0",),
) -> Path:
    """A sqlite3 bag as ROS 2 wrote it before it kept definitions, with or without its metadata.yaml."""
    folder.mkdir()
    for part, rows in enumerate(np.array_split(np.arange(len(log.stamp)), parts)):
        with closing(sqlite3.connect(folder / f"run_{part}.db3")) as base:
            base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
                         "offered_qos_profiles TEXT)")  # fmt: skip
            base.execute(
                "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
            )
            base.execute("INSERT INTO topics VALUES (1, ?, ?, 'cdr', '')", (topic, kind))
            packed = [
                (START + 10_000_000 * int(i), cdr_wrench(int(log.stamp[i]), frames[i % len(frames)], log.force[i]))
                for i in rows
            ]
            base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", packed)
            base.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
            base.commit()
    if metadata:
        files = "\n".join(f"  - run_{part}.db3" for part in range(parts))
        (folder / "metadata.yaml").write_text(
            f"""rosbag2_bagfile_information:
  version: 4
  storage_identifier: sqlite3
  relative_file_paths:
{files}
  duration: {{nanoseconds: {int(log.stamp[-1] - log.stamp[0])}}}
  starting_time: {{nanoseconds_since_epoch: {int(log.stamp[0])}}}
  message_count: {len(log.stamp)}
  topics_with_message_count:
  - topic_metadata: {{name: {topic}, type: {kind}, serialization_format: cdr,
      offered_qos_profiles: ""}}
    message_count: {len(log.stamp)}
  compression_format: ""
  compression_mode: ""
""",
            encoding="utf-8",
        )
    return folder


def write_compressed(folder: Path, log: Log, *, mcap: bool, mode: CompressionMode) -> Path:
    """A ROS 2 bag with packed files or packed messages."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer = Ros2Writer(folder, version=8, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/wrench", "geometry_msgs/msg/WrenchStamped", typestore=store)
        for at, force in zip(log.stamp, log.force, strict=True):
            writer.write(topic, int(at) + 500, cdr_wrench(int(at), "panda_link0", force))
    return folder


FRANKA_STATE = (
    "std_msgs/Header header\nfloat64[6] K_F_ext_hat_K\nfloat64[6] O_F_ext_hat_K\nfloat64 time\n"
    f"{RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
)


def write_ros1(path: Path, log: Log, pictures: Sequence[tuple[int, np.ndarray]] = (), *, franka: bool = False) -> Path:
    """A ROS 1 bag: /wrench (or Franka's state) and mono8 pictures on /image."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/WrenchStamped"
    if franka:
        kind = "franka_msgs/msg/FrankaState"
        store.register({kind: get_types_from_msg(FRANKA_STATE, kind)[kind]})
    types = store.types

    def top(stamp: int, frame: str, seq: int) -> Any:
        time = types["builtin_interfaces/msg/Time"](sec=int(stamp) // EPOCH, nanosec=int(stamp) % EPOCH)
        return types["std_msgs/msg/Header"](seq=seq, stamp=time, frame_id=frame)

    with Ros1Writer(path) as writer:
        writer.chunk_threshold = 4096
        forces = writer.add_connection("/wrench", kind, typestore=store)
        films = writer.add_connection("/image", "sensor_msgs/msg/Image", typestore=store)
        for i, (at, force) in enumerate(zip(log.stamp, log.force, strict=True)):
            if franka:
                message = types[kind](
                    header=top(at, "", i),
                    K_F_ext_hat_K=np.zeros(6),
                    O_F_ext_hat_K=np.concatenate([force, np.zeros(3)]),
                    time=0.0,
                )
            else:
                vectors = [types["geometry_msgs/msg/Vector3"](*map(float, row)) for row in (force, (0.0, 0.0, 0.0))]
                message = types[kind](top(at, "base", i), types["geometry_msgs/msg/Wrench"](*vectors))
            writer.write(forces, int(at) + 500, store.serialize_ros1(message, kind))
        for i, (at, picture) in enumerate(pictures):
            height, width = picture.shape
            made = types["sensor_msgs/msg/Image"](
                top(at, "camera", i), height, width, "mono8", 0, width, picture.reshape(-1)
            )
            writer.write(films, int(at) + 500, store.serialize_ros1(made, "sensor_msgs/msg/Image"))
    return path
