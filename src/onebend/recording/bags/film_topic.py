"""The film in a bag: images of one topic, packed or not, with the times of their headers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from onebend.errors import RecordingError
from onebend.recording.bags.message_times import clock_of, timed
from onebend.recording.bags.reader import Bag, Topic, open_bag, topic_of
from onebend.recording.toml.source_entries import VideoEntry

Pixels = NDArray[np.uint8]

RAW, PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
LUMA = np.array([299, 587, 114], dtype=np.uint32)  # parts in 1000 of red, green and blue (ITU-R BT.601)
# Bytes a pixel; where red, green and blue stand.
COLOURS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))}
COLOURS |= {"8UC3": (3, (2, 1, 0)), "8UC4": (4, (2, 1, 0))}  # OpenCV's order
GREYS = {"mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2}
LUMA_AT = {"uyvy": 1, "yuv422": 1, "yuyv": 0, "yuv422_yuy2": 0}  # of two bytes a pixel, which one is luma
MOSAICS = ("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")


def bag_film(video: VideoEntry) -> tuple[Bag, Topic]:
    """The bag and its image topic.

    Raises:
        RecordingError: no such topic, or it holds no images.
    """
    bag = open_bag(video.file, keep=video.damaged == "keep")
    topic = topic_of(bag, video.topic, "[video] topic")
    if topic.channel.type not in (RAW, PACKED):
        raise RecordingError(
            f"[video] topic: {topic.channel.topic} of {video.file} is {topic.channel.type}, not images. Name one of "
            f"{RAW} or {PACKED}."
        )
    return bag, topic


def bag_frames(video: VideoEntry) -> Iterator[tuple[float, Any]]:
    """Time since the first, s, and message of every image, in order.

    Raises:
        RecordingError: as `bag_film`, or a time that is missing or does not rise.
    """
    bag, topic = bag_film(video)
    clock = clock_of(bag, topic, video.definitions)
    last, first = -math.inf, 0.0
    for count, (time, message) in enumerate(timed(bag, topic, clock, video.definitions)):
        first = time if count == 0 else first
        if not time > last:
            what = "has no stamp" if math.isnan(time) else f"({time:.6f} s) does not come after the one before"
            raise RecordingError(f"{video.file}: image {count} of {topic.channel.topic} {what}. Write the bag anew.")
        last = time
        yield time - first, message


def picture_of(message: Any, place: str, *, colour: bool = False) -> Pixels:
    """Luma (H, W), or with `colour` RGB (H, W, 3), of an image message.

    Raises:
        RecordingError: an encoding that is not known, or fewer bytes than the size asks for.
    """
    if not hasattr(message, "encoding"):
        return unpacked(message, place, colour)
    height, width, name = int(message.height), int(message.width), str(message.encoding)
    data = np.asarray(message.data, dtype=np.uint8)
    size = COLOURS[name][0] if name in COLOURS else 2 if name in LUMA_AT else GREYS.get(name, 1)
    if name not in (*COLOURS, *GREYS, *LUMA_AT, *MOSAICS):
        known = ", ".join((*GREYS, *COLOURS, *MOSAICS, *LUMA_AT))
        raise RecordingError(f"{place}: images encoded as {name!r} cannot be read; {known} can.")
    step = int(message.step) or size * width
    least = (height - 1) * step + size * width
    if height < 1 or width < 1 or not size * width <= step <= len(data) or len(data) < least:
        raise RecordingError(f"{place}: an image of {width} x {height} {name} has {len(data)} bytes. Is it cut off?")
    padded = np.zeros(height * step, dtype=np.uint8)  # some drivers leave out the last row's padding
    padded[: min(len(data), len(padded))] = data[: len(padded)]
    rows = padded.reshape(height, step)[:, : size * width].reshape(height, width, size)
    if name in COLOURS:
        rgb = rows[..., list(COLOURS[name][1])]
        return rgb if colour else luma(rgb)
    if name in MOSAICS:
        grey = smooth_mosaic(rows[..., 0])
    elif name in LUMA_AT:
        grey = rows[..., LUMA_AT[name]]
    else:
        grey = rows[..., 0 if size == 1 or message.is_bigendian else 1]  # of 16 bits the upper ones
    return np.stack([grey] * 3, axis=-1) if colour else np.ascontiguousarray(grey)


def luma(rgb: Pixels) -> Pixels:
    """(H, W) brightness of (H, W, 3)."""
    return np.asarray((rgb @ LUMA + 500) // 1000, dtype=np.uint8)


def smooth_mosaic(raw: Pixels) -> Pixels:
    """Brightness (R + 2 G + B) / 4 of a Bayer mosaic at every pixel: a 1-2-1 mean each way holds these parts at each
    place of the pattern, whichever it is."""
    wide = np.pad(raw.astype(np.uint16), 1, mode="reflect")
    across = wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]
    return np.asarray((across[:-2] + 2 * across[1:-1] + across[2:] + 8) // 16, dtype=np.uint8)


def unpacked(message: Any, where: str, colour: bool) -> Pixels:
    """A JPEG or PNG in a message."""
    try:
        with Image.open(BytesIO(bytes(message.data))) as image:
            return np.array(image.convert("RGB" if colour else "L"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as wrong:
        kind = str(getattr(message, "format", ""))
        raise RecordingError(f"{where}: an image packed as {kind!r} cannot be read ({wrong}).") from None
