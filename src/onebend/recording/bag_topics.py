"""The topics of a bag, and which of them are probably the force and the film."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from onebend.errors import RecordingError
from onebend.recording.bags import Bag, Topic, decoder, is_bag, listed, messages, open_bag, raw_messages, topic_of
from onebend.recording.entries import ForceEntry, Recording, VideoEntry
from onebend.recording.force_log import remark, whole_log
from onebend.recording.schema import Mistakes
from onebend.recording.signals import missing, step
from onebend.records import Array, ForceLog, Remark
from onebend.text_files import ascii_only, quoted


@dataclass(frozen=True)
class TopicClock:
    """Where a topic's times come from, and the first of them."""

    by: Literal["header", "receipt"]
    origin: int  # ns


def clock_of(bag: Bag, topic: Topic) -> TopicClock:
    """By the headers' stamps if one of the first messages has any, else by receipt."""
    received = None
    for time, message in islice(messages(bag, topic), 100):  # messages that are searched for a stamp
        received = time if received is None else received
        if stamp := stamp_of(message):
            return TopicClock("header", stamp)
    if received is None:
        raise RecordingError(f"{bag.path}: no message of {topic.name} can be read.")
    return TopicClock("receipt", received)


def stamp_of(message: Any) -> int:
    """ns of the header's stamp; 0 where there is none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def timed(bag: Bag, topic: Topic, clock: TopicClock) -> Iterator[tuple[float, Any]]:
    """Time since the clock's origin, s, and message; NaN where a stamp is missing among others that are there."""
    for received, message in messages(bag, topic):
        time = received if clock.by == "receipt" else stamp_of(message)
        yield (time - clock.origin) * 1e-9 if time else float("nan"), message


Pixels = NDArray[np.uint8]

RAW, PACKED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
LUMA = np.array([299, 587, 114], dtype=np.uint32)  # parts in 1000 of red, green and blue (ITU-R BT.601)
# Bytes a pixel; where red, green and blue stand.
COLOURS = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))}
COLOURS |= {"8UC3": (3, (2, 1, 0)), "8UC4": (4, (2, 1, 0))}  # OpenCV's order
GREYS = {"mono8": 1, "8UC1": 1, "mono16": 2, "16UC1": 2}
LUMA_AT = {"uyvy": 1, "yuv422": 1, "yuyv": 0, "yuv422_yuy2": 0}  # of two bytes a pixel, which one is luma
MOSAICS = ("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")


def bag_topic(entry: VideoEntry | ForceEntry) -> tuple[Bag, Topic]:
    """The bag of a film or a force log, and its topic."""
    film = isinstance(entry, VideoEntry)
    bag = open_bag(entry.file)
    topic = topic_of(bag, entry.topic, "[video] topic" if film else "[force] topic")
    if film and topic.type not in (RAW, PACKED):
        raise RecordingError(
            f"[video] topic: {topic.name} of {entry.file} is {topic.type}, not images. Name one of {RAW} or {PACKED}."
        )
    return bag, topic


def bag_frames(video: VideoEntry) -> Iterator[tuple[float, Any]]:
    """Time since the first, s, and message of every image, in order."""
    bag, topic = bag_topic(video)
    last, first = -math.inf, 0.0
    for count, (time, message) in enumerate(timed(bag, topic, clock_of(bag, topic))):
        first = time if count == 0 else first
        if not time > last:
            what = "has no stamp" if math.isnan(time) else f"({time:.6f} s) does not come after the one before"
            raise RecordingError(f"{video.file}: image {count} of {topic.name} {what}. Write the bag anew.")
        last = time
        yield time - first, message


def picture_of(message: Any, place: str, *, colour: bool = False) -> Pixels:
    """Luma (H, W), or with `colour` RGB (H, W, 3), of an image message."""
    if not hasattr(message, "encoding"):
        return unpacked(message, place, colour)
    height, width, name = int(message.height), int(message.width), str(message.encoding)
    data = np.frombuffer(bytes(message.data), dtype=np.uint8)
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
    """Brightness (R + 2 G + B) / 4 of a Bayer mosaic at every pixel, of any pattern: a 1-2-1 mean each way."""
    wide = np.pad(raw.astype(np.uint16), 1, mode="reflect")
    across = wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]
    return np.asarray((across[:-2] + 2 * across[1:-1] + across[2:] + 8) // 16, dtype=np.uint8)


def unpacked(message: Any, where: str, colour: bool) -> Pixels:
    """A JPEG or PNG in a message."""
    from PIL import Image, UnidentifiedImageError  # here: most recordings are no bags with packed pictures

    try:
        with Image.open(BytesIO(bytes(message.data))) as image:
            return np.array(image.convert("RGB" if colour else "L"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError, Image.DecompressionBombError) as wrong:
        kind = str(getattr(message, "format", ""))
        raise RecordingError(f"{where}: an image packed as {kind!r} cannot be read ({wrong}).") from None


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


def bag_camera(video: VideoEntry, name: str) -> CameraInfo:
    """The calibration on topic `name` of the film's bag."""
    bag, _ = bag_topic(video)
    topic = topic_of(bag, name, "[camera] camera_info")
    place = f"[camera] camera_info: {ascii_only(topic.name)} of {video.file}"
    if topic.type != INFO:
        raise RecordingError(f"{place} is {ascii_only(topic.type)}, no calibration. Name one of type {INFO}.")
    every = (info_of(message, topic, place) for _, message in messages(bag, topic))
    first = next(every)
    for count, info in enumerate(every, start=1):
        if not all(map(np.array_equal, vars(first).values(), vars(info).values())):
            raise RecordingError(
                f"{place} changes at message {count}: the camera was zoomed or set anew. Keep it as it is in a film."
            )
    return first


def info_of(message: Any, topic: Topic, place: str) -> CameraInfo:
    """The calibration in one message; ROS 1 writes D, K and P, ROS 2 d, k and p."""

    def numbers(name: str) -> Array:
        value = getattr(message, name.upper(), getattr(message, name, ()))
        read = np.asarray(value, dtype=float).ravel()
        if not np.isfinite(read).all():
            raise RecordingError(f"{place}: {name.upper()} holds what is no number. Calibrate the camera.")
        return read

    return CameraInfo(
        topic.name,
        int(message.width),
        int(message.height),
        str(message.distortion_model),
        numbers("d"),
        numbers("k").reshape(3, 3),
        numbers("p").reshape(3, 4)[:, :3],
    )


def picture_size(video: VideoEntry) -> tuple[int, int]:
    """Width and height of the film's first image, px."""
    for _, message in bag_frames(video):
        height, width = picture_of(message, f"{video.file}, image 0 of {quoted(video.topic)}").shape
        return width, height
    raise RecordingError(f"{video.file} holds no image of {quoted(video.topic)}.")


FIELDS = {
    "geometry_msgs/msg/WrenchStamped": "wrench.force",
    "geometry_msgs/msg/Wrench": "force",
    "franka_msgs/msg/FrankaState": "O_F_ext_hat_K",
    "franka_msgs/msg/FrankaRobotState": "o_f_ext_hat_k",
}
AXES = {"x": 0, "y": 1, "z": 2}


def read_bag_force(entry: ForceEntry) -> ForceLog:
    """The force along `entry.axes` of every message, on the headers' clock; its zero is the first message."""
    bag, topic = bag_topic(entry)
    field = entry.field or default_field(topic, entry)
    clock = clock_of(bag, topic)
    rows: list[tuple[float, float, float]] = []
    frames: dict[str, None] = {}
    picks = [(AXES[axis[-1]], -1.0 if axis.startswith("-") else 1.0) for axis in entry.axes]
    for time, message in timed(bag, topic, clock):
        force, frame = force_of(message, field, f"{entry.file}: {topic.name}")
        frames[frame] = None
        (first, sign), (second, other) = picks
        rows.append((time, sign * force[first], other * force[second]))
    named = [frame for frame in frames if frame]
    if len(named) > 1:
        raise RecordingError(
            f"{entry.file}: the forces of {topic.name} are in several frames ({', '.join(named)}). Record one."
        )
    read = np.array(rows)
    order = np.argsort(read[:, 0], kind="stable")
    early = int(np.sum(np.diff(read[:, 0]) < 0))
    remarks = (*remark(early, len(read), "messages of the force log lie out of order and are sorted"),)
    remarks = (*remarks, *stamp_remarks(topic, clock), *frame_remarks(entry, field, named))
    return whole_log(f"{entry.file}, {topic.name}", read[order], remarks)


def stamp_remarks(topic: Topic, clock: TopicClock) -> list[Remark]:
    """A warning where the times are those of receipt."""
    if clock.by == "header":
        return []
    text = f"{topic.name} has no header stamps: the times at which it was received are used. Record header "
    return [Remark("warning", f"{text}stamps.", about="no stamps")]


def default_field(topic: Topic, entry: ForceEntry) -> str:
    """Where the force stands in the types that are known."""
    field = FIELDS.get(topic.type)
    if field is None:
        raise RecordingError(
            f"{entry.file}: {ascii_only(topic.name)} is {ascii_only(topic.type)}; where "
            'its force stands is not known. Write field = "NAME" (or "NAME.NAME") in [force], or name a wrench topic.'
        )
    return field


def force_of(message: Any, field: str, where: str) -> tuple[Array, str]:
    """(3,) N at `field` of the message, and the frame it is in ("" where nothing says)."""
    value, frame = message, frame_of(message)
    for name in (*field.split("."), "wrench", "force"):
        inside = getattr(value, name, None) if name in field_names(value) else None
        if inside is None and name in ("wrench", "force"):
            continue  # the field may be the force itself, a wrench or a stamped wrench
        if inside is None:
            names = ", ".join(field_names(value)) or "no fields"
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


def field_names(message: Any) -> Iterator[str]:
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


LIKELY: dict[str, tuple[str, ...]] = {"force": tuple(FIELDS), "image": (RAW, PACKED)}


@dataclass(frozen=True)
class TopicRow:
    """One topic."""

    topic: str
    type: str
    count: int
    rate: float  # Hz, the median; NaN where there are fewer than two messages
    start: float  # s since 1970 on the clock of `by`; NaN without messages
    end: float  # s
    by: Literal["header", "receipt"]
    gaps: int  # messages that are missing by the rate


@dataclass(frozen=True)
class BagContents:
    """A bag as `onebend topics` shows it."""

    path: Path
    rows: tuple[TopicRow, ...]
    force: str  # the likeliest topic of the force, "" where there is none
    image: str


def bag_contents(path: Path | str) -> BagContents:
    """Every topic with its type, count, rate and span. Raises `RecordingError` for a bag that cannot be read."""
    bag = open_bag(Path(path))
    rows = tuple(row_of(bag, topic) for _, topic in sorted(bag.topics.items()))
    return BagContents(bag.path, rows, guess(bag, "force"), guess(bag, "image"))


def row_of(bag: Bag, topic: Topic) -> TopicRow:
    """The topic's times, by its headers where they have stamps and their type is known."""
    try:
        decode = decoder(bag.path, topic)
    except RecordingError:
        decode = None
    received, stamps = [], []
    for time_received, data in raw_messages(bag, topic):
        received.append(time_received)
        if decode is not None:
            try:
                stamps.append(stamp_of(decode(data)))
            except Exception:  # a message that does not fit its type, in whichever way: its receipt remains
                decode = None
    stamped = decode is not None and len(stamps) > 0 and all(stamps)
    time = np.sort(np.array(stamps if stamped else received, dtype=np.int64))
    since = np.asarray((time - time[:1]) * 1e-9, dtype=np.float64)
    spacing = step(since) if len(since) > 1 else np.nan
    start, end = (float(time[i]) * 1e-9 if len(time) else np.nan for i in (0, -1))
    rate = 1 / spacing if spacing > 0 else np.nan
    by: Literal["header", "receipt"] = "header" if stamped else "receipt"
    return TopicRow(topic.name, topic.type, topic.count, rate, start, end, by, missing(since))


def guess(bag: Bag, what: Literal["force", "image"]) -> str:
    """The topic of a fitting type with the most messages, the better type first; "" where there is none."""
    fitting = [
        (LIKELY[what].index(topic.type), -topic.count, name)
        for name, topic in bag.topics.items()
        if topic.type in LIKELY[what] and topic.count
    ]
    return min(fitting)[2] if fitting else ""


HEADERS_DOUBT = 0.1  # s: exposure, transfer and filters between an event and the stamp of its message
RECEIPT_DOUBT = 0.3  # s: queues besides
BAG_KEYS = ("topic", "field", "axes")  # only for bags
TEXT_KEYS = ("columns", "time_unit", "frame_times")  # not for bags


def check_bag(name: str, entry: VideoEntry | ForceEntry, written: Mapping[str, Any], mistakes: Mistakes) -> None:
    """Add mistakes: of the bag that `entry` names, and of keys of its table, as `written`, that do not fit a bag."""
    bag = is_bag(entry.file)
    for key in TEXT_KEYS if bag else BAG_KEYS:
        if key in written:
            kind = "a bag, whose messages have types" if bag else "no bag"
            mistakes.add((name, key), f"[{name}] {key}: {entry.file} is {kind}. Remove {key}.")
    if isinstance(entry, ForceEntry) and len({axis[-1] for axis in entry.axes}) < 2:
        mistakes.add((name, "axes"), f"[{name}] axes names one axis twice. Name the two of the plane of bending.")
    if not bag:
        return
    try:
        contents = open_bag(entry.file)
        if not entry.topic:
            more = asked(contents, "image" if name == "video" else "force", 'Add `topic = "{}"`.')
            mistakes.add((name, "file"), f"[{name}] lacks topic: {more}")
        else:
            topic_of(contents, entry.topic, f"[{name}] topic")
    except RecordingError as wrong:
        mistakes.add((name, "topic"), str(wrong))


def asked(bag: Bag, what: Literal["force", "image"], how: str) -> str:
    """Advice where a bag is named without its topic; `how` the likeliest one may be added."""
    likely = guess(bag, what)
    return f"{bag.path} is a bag that holds {listed(bag)}.{likely and ' ' + how.format(likely)}"


def with_bags(rec: Recording, written: Mapping[str, Any]) -> Recording:
    """The recording with remarks, and the film's start from a bag that film and force share, unless it is `written`."""
    video = rec.video if rec.video is not None and rec.video.topic else None
    force = rec.force if rec.force is not None and rec.force.topic else None
    remarks = [*rec.remarks]
    if video is not None:
        bag, topic = bag_topic(video)
        remarks += stamp_remarks(topic, clock_of(bag, topic))
    if force is not None:
        silent = [key for key in ("rotation_deg", "acts_on", "axes") if key not in written["force"]]
        if silent:
            text = f"recording.toml does not say {', '.join(silent)} of [force]: their defaults are assumed."
            text += " A bag does not know how the robot stands to the beam."
            remarks.append(Remark("warning", text, about="bag's axes"))
    one_bag = video is not None and force is not None and video.file.resolve() == force.file.resolve()
    if video is None or force is None or not one_bag or "start_s" in written["video"]:
        return replace(rec, remarks=tuple(remarks))
    film_clock, force_clock = (clock_of(*bag_topic(entry)) for entry in (video, force))
    start = (film_clock.origin - force_clock.origin) * 1e-9
    stamped = film_clock.by == force_clock.by == "header"
    doubt = float(written["video"].get("start_uncertainty_s", HEADERS_DOUBT if stamped else RECEIPT_DOUBT))
    stamps = "their headers' stamps" if stamped else "when their messages were received"
    text = f"Film and force share the bag's clock: the film starts at {start:.4f} s by {stamps}, to {doubt:g} s."
    remarks = [remark for remark in remarks if "when the video starts" not in remark.text]
    remarks.append(Remark("note", text))
    return replace(rec, video=replace(video, start=start, start_uncertainty=doubt), remarks=tuple(remarks))


def bag_span(video: VideoEntry) -> tuple[int, float]:
    """How many images the topic holds, and the time from the first to the last that was received, s."""
    bag, topic = bag_topic(video)
    times = [received for received, _ in raw_messages(bag, topic)]
    return topic.count, (times[-1] - times[0]) * 1e-9 if times else math.nan
