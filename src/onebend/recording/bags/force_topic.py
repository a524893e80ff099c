"""The force log in a bag: a wrench topic, or a field of a robot's state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.bags.message_times import clock_of, timed
from onebend.recording.bags.reader import Topic, open_bag, topic_of
from onebend.recording.force.force_log import remark, whole_log
from onebend.recording.toml.entries import ForceEntry
from onebend.records import Array, ForceLog, Remark
from onebend.text_files import ascii_only

FIELDS = {
    "geometry_msgs/msg/WrenchStamped": "wrench.force",
    "geometry_msgs/msg/Wrench": "force",
    "franka_msgs/msg/FrankaState": "O_F_ext_hat_K",
    "franka_msgs/msg/FrankaRobotState": "o_f_ext_hat_k",
}
AXES = {"x": 0, "y": 1, "z": 2}


def read_bag_force(entry: ForceEntry) -> ForceLog:
    """The force along `entry.axes` of every message of `entry.topic`, on the headers' clock; its zero is the first one.

    Raises:
        RecordingError: no such topic or field, a damaged bag, too few messages, forces in several frames, or zero
            throughout.
    """
    bag = open_bag(entry.file, keep=entry.damaged == "keep")
    topic = topic_of(bag, entry.topic, "[force] topic")
    field = entry.field or default_field(topic, entry)
    clock = clock_of(bag, topic, entry.definitions)
    rows: list[tuple[float, float, float]] = []
    frames: dict[str, None] = {}
    picks = [(AXES[axis[-1]], -1.0 if axis.startswith("-") else 1.0) for axis in entry.axes]
    for time, message in timed(bag, topic, clock, entry.definitions):
        force, frame = force_of(message, field, f"{entry.file}: {topic.channel.topic}")
        frames[frame] = None
        (first, sign), (second, other) = picks
        rows.append((time, sign * force[first], other * force[second]))
    named = [frame for frame in frames if frame]
    if len(named) > 1:
        raise RecordingError(
            f"{entry.file}: the forces of {topic.channel.topic} are in several frames ({', '.join(named)}). Record one."
        )
    read = np.array(rows)
    order = np.argsort(read[:, 0], kind="stable")
    early = int(np.sum(np.diff(read[:, 0]) < 0))
    remarks = (*remark(early, len(read), "messages of the force log lie out of order and are sorted"),)
    if clock.by == "receipt":
        text = (
            f"{topic.channel.topic} has no header stamps: the times at which it was received are used. Record header "
            "stamps."
        )
        remarks = (*remarks, Remark("warning", text, about="no stamps"))
    remarks = (*remarks, *frame_remarks(entry, field, named))
    return whole_log(f"{entry.file}, {topic.channel.topic}", read[order], remarks)


def default_field(topic: Topic, entry: ForceEntry) -> str:
    """Where the force stands in the types that are known."""
    field = FIELDS.get(topic.channel.type)
    if field is None:
        raise RecordingError(
            f"{entry.file}: {ascii_only(topic.channel.topic)} is {ascii_only(topic.channel.type)}; where "
            'its force stands is not known. Write field = "NAME" (or "NAME.NAME") in [force], or name a wrench topic.'
        )
    return field


def force_of(message: Any, field: str, where: str) -> tuple[Array, str]:
    """(3,) N at `field` of the message, and the frame it is in ("" where nothing says).

    Raises:
        RecordingError: there is no such field, or it holds no force.
    """
    value, frame = message, frame_of(message)
    for name in (*field.split("."), "wrench", "force"):
        inside = getattr(value, name, None) if name in fields_of(value) else None
        if inside is None and name in ("wrench", "force"):
            continue  # the field may be the force itself, a wrench or a stamped wrench
        if inside is None:
            names = ", ".join(fields_of(value)) or "no fields"
            raise RecordingError(f"{where}: there is no field {name} (of {field}); there are {names}. Correct field.")
        value = inside
        frame = frame_of(value) or frame
    if all(hasattr(value, axis) for axis in AXES):
        return np.array([value.x, value.y, value.z], dtype=float), frame
    numbers = np.asarray(value) if isinstance(value, np.ndarray | list | tuple) else np.empty(0)
    if numbers.ndim != 1 or len(numbers) < 3 or numbers.dtype.kind not in "fiu":
        raise RecordingError(f"{where}: the field {field} holds no force of three numbers. Correct field in [force].")
    return numbers[:3].astype(float), frame


def frame_of(message: Any) -> str:
    return str(getattr(getattr(message, "header", None), "frame_id", "") or "")


def fields_of(message: Any) -> Iterator[str]:
    """The names of a message's fields."""
    return (name for name in getattr(message, "__dataclass_fields__", {}) if not name.startswith("__"))


def frame_remarks(entry: ForceEntry, field: str, named: list[str]) -> tuple[Remark, ...]:
    """Which axes the force was taken along, and a warning where they turn with the tool."""
    frame = f"the frame {named[0]}" if named else "a frame that the bag does not name"
    across = " and ".join(entry.axes)
    remarks = [
        Remark(
            "note",
            f"The force is along {across} of {frame}; rotation_deg = {np.rad2deg(entry.rotation):.4g} says how they "
            f"lie to the beam, and acts_on that it is on the {entry.acts_on}.",
        )
    ]
    if field.split(".")[0].lower().startswith("k_f_ext") or (named and named[0].endswith(("_K", "_EE", "_hand"))):
        text = (
            "These axes turn with the tool: the force is right only if the tool kept its direction. Log it in axes "
            "that stand still."
        )
        remarks.append(Remark("warning", text, about="tool axes"))
    return tuple(remarks)
