"""Forces on a beam as a ROS 2 bag: one .mcap file that carries its own definitions, for any ROS 2 and without one."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from onebend.errors import ExportError
from onebend.extras import require
from onebend.records import Array

if TYPE_CHECKING:  # as in the functions: few ask for a bag
    from rosbags.typesys.store import Typestore

FORCE_TOPIC, COVARIANCE_TOPIC = "/beam/force", "/beam/force_covariance"
WRENCH, NUMBERS = "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64MultiArray"
FRAME = "beam_base"  # of the headers, as of the forces of a path: x along the beam at rest, from its clamp
_SECOND = 10**9  # ns
_LATEST = 2**31  # s, the first that a stamp cannot hold


def force_bag(time: Array, force: Array, covariance: Array) -> bytes:
    """The content of a .mcap file with `force` (T, 2) [N] at `time` (T,) [s] and its `covariance` (T, 2, 2) [N^2].

    On `/beam/force` geometry_msgs/WrenchStamped, z and torque zero; on `/beam/force_covariance`
    std_msgs/Float64MultiArray, row by row, with the same time of receipt. Frames without a force are left out. A stamp
    of zero means none in ROS: it is written as 1 ns.

    Raises:
        ExportError: no frame has a force, or times that a stamp cannot hold.
    """
    require(("rosbags",), "ros")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    known = np.isfinite(force).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    time, force, covariance = time[known], force[known], covariance[known]
    if not len(time):
        raise ExportError("no frame has a force: there is nothing to write to a bag")
    if not (np.isfinite(time).all() and time.min() >= 0.0 and time.max() < _LATEST):
        raise ExportError(
            f"a bag's stamps run from 0 to {_LATEST} s, and the recording's times from {time.min():.6g} to "
            f"{time.max():.6g} s. Put its log's clock into that range"
        )
    store = get_typestore(Stores.LATEST)
    with tempfile.TemporaryDirectory() as folder:
        inside = Path(folder) / "force"
        with Writer(inside, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            wrenches = writer.add_connection(FORCE_TOPIC, WRENCH, typestore=store)
            covariances = writer.add_connection(COVARIANCE_TOPIC, NUMBERS, typestore=store)
            for at, of_frame, spread in zip(time, force, covariance, strict=True):
                stamp = max(round(float(at) * _SECOND), 1)
                writer.write(wrenches, stamp, bytes(store.serialize_cdr(_wrench(store, stamp, of_frame), WRENCH)))
                writer.write(covariances, stamp, bytes(store.serialize_cdr(_matrix(store, spread), NUMBERS)))
        return next(inside.glob("*.mcap")).read_bytes()


def _wrench(store: Typestore, stamp: int, force: Array) -> Any:
    """(2,) N as a message."""
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    seconds, rest = divmod(stamp, _SECOND)
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest), frame_id=FRAME
    )
    pushed = vector(x=float(force[0]), y=float(force[1]), z=0.0)
    turned = vector(x=0.0, y=0.0, z=0.0)
    return types[WRENCH](header=header, wrench=types["geometry_msgs/msg/Wrench"](force=pushed, torque=turned))


def _matrix(store: Typestore, covariance: Array) -> Any:
    """(2, 2) N^2 as a message."""
    types = store.types
    side = types["std_msgs/msg/MultiArrayDimension"]
    sides = [side(label="row: fx_N, fy_N", size=2, stride=4), side(label="column: fx_N, fy_N", size=2, stride=2)]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=sides, data_offset=0)
    return types[NUMBERS](layout=layout, data=np.ascontiguousarray(covariance, dtype=np.float64).ravel())
