"""The calibration of a camera in a bag: `sensor_msgs/CameraInfo`, as it stands there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.bags.film_topic import bag_film, bag_frames, picture_of
from onebend.recording.bags.reader import messages, topic_of
from onebend.recording.toml.source_entries import VideoEntry
from onebend.records import Array
from onebend.text_files import ascii_only, quoted

INFO = "sensor_msgs/msg/CameraInfo"


@dataclass(frozen=True)
class CameraInfo:
    """What the messages of one topic say; all of them say the same."""

    topic: str
    width: int  # px, of the whole sensor's picture
    height: int  # px
    model: str  # of the lens
    lens: Array  # (n,)
    matrix: Array  # (3, 3) px
    rectified: Array  # (3, 3) px, of pictures that the driver has rectified
    binning: tuple[int, int]  # across, down; 1: none
    corner: tuple[int, int]  # px, where the part of the picture that was recorded begins
    part: tuple[int, int]  # px, width and height of that part


def bag_camera(video: VideoEntry, name: str) -> CameraInfo:
    """The calibration on topic `name` of the film's bag.

    Raises:
        RecordingError: no such topic, another type, numbers that are none, or messages that differ.
    """
    bag, _ = bag_film(video)
    topic = topic_of(bag, name, "[camera] camera_info")
    place = f"[camera] camera_info: {ascii_only(topic.channel.topic)} of {video.file}"
    if topic.channel.type != INFO:
        raise RecordingError(f"{place} is {ascii_only(topic.channel.type)}, no calibration. Name one of type {INFO}.")
    first: Any = None
    for count, (_, message) in enumerate(messages(bag, topic, video.definitions)):
        said = fields_of(message, place)
        if first is None:
            first = said
        elif any(not np.array_equal(one, other) for one, other in zip(first, said, strict=True)):
            raise RecordingError(
                f"{place} changes at message {count}: the camera was zoomed or set anew. Keep it as it is in a film."
            )
    width, height, model, lens, matrix, projection, binning, corner, part = first
    whole = (part[0] or width, part[1] or height)
    return CameraInfo(
        topic.channel.topic, width, height, model, lens, matrix, projection[:, :3], binning, corner, whole
    )


def fields_of(message: Any, place: str) -> tuple[Any, ...]:
    """Size, lens, matrices and part of the sensor in one message; ROS 1 writes D, K and P, ROS 2 d, k and p."""

    def numbers(name: str) -> Array:
        value = getattr(message, name.upper(), getattr(message, name, ()))
        read = np.asarray(value, dtype=float).ravel()
        if not np.isfinite(read).all():
            raise RecordingError(f"{place}: {name.upper()} holds what is no number. Calibrate the camera.")
        return read

    roi = message.roi
    return (
        int(message.width),
        int(message.height),
        str(message.distortion_model),
        numbers("d"),
        numbers("k").reshape(3, 3),
        numbers("p").reshape(3, 4),
        (max(int(message.binning_x), 1), max(int(message.binning_y), 1)),
        (int(roi.x_offset), int(roi.y_offset)),
        (int(roi.width), int(roi.height)),
    )


def picture_size(video: VideoEntry) -> tuple[int, int]:
    """Width and height of the film's first image, px."""
    for _, message in bag_frames(video):
        height, width = picture_of(message, f"{video.file}, image 0 of {quoted(video.topic)}").shape
        return width, height
    raise RecordingError(f"{video.file} holds no image of {quoted(video.topic)}.")
