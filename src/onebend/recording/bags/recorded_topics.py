"""Bags in a recording: that their topics are there, and when the film starts on the force log's clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from onebend.errors import RecordingError
from onebend.recording.bags.film_topic import bag_film
from onebend.recording.bags.message_times import TopicClock, clock_of
from onebend.recording.bags.reader import Bag, Topic, is_bag, listed, open_bag, raw_messages, topic_of
from onebend.recording.bags.topics import guess
from onebend.recording.toml.entries import ForceEntry, Recording
from onebend.recording.toml.schema import Mistakes
from onebend.recording.toml.source_entries import VideoEntry
from onebend.records import Remark

HEADERS_DOUBT = 0.1  # s: exposure, transfer and filters between an event and the stamp of its message
RECEIPT_DOUBT = 0.3  # s: queues besides
BAG_KEYS = ("topic", "field", "axes", "definitions", "damaged")  # only for bags
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
        contents = open_bag(entry.file, keep=entry.damaged == "keep")
        if not entry.topic:
            mistakes.add((name, "file"), f"[{name}] lacks topic: {asked(contents, name)}")
        else:
            topic_of(contents, entry.topic, f"[{name}] topic")
    except RecordingError as wrong:
        mistakes.add((name, "topic"), str(wrong))


def asked(bag: Bag, name: str) -> str:
    """Advice where a bag is named without its topic."""
    likely = guess(bag, "image" if name == "video" else "force")
    hint = f' Add `topic = "{likely}"`.' if likely else ""
    return f"{bag.path} is a bag that holds {listed(bag)}.{hint}"


def with_bags(rec: Recording, written: Mapping[str, Any]) -> Recording:
    """The recording with the start of its film taken from the bag where film and force share one, and with remarks.

    `written` is recording.toml as data: a start that stands there is kept.

    Raises:
        RecordingError: a bag cannot be read.
    """
    video = rec.video if rec.video is not None and rec.video.topic else None
    force = rec.force if rec.force is not None and rec.force.topic else None
    remarks = [*rec.remarks]
    for name, entry in (("video", video), ("force", force)):
        if entry is not None:
            remarks += bag_remarks(name, entry)
    if force is not None:
        silent = [key for key in ("rotation_deg", "acts_on", "axes") if key not in written["force"]]
        if silent:
            text = f"recording.toml does not say {', '.join(silent)} of [force]: their defaults are assumed."
            text += " A bag does not know how the robot stands to the beam."
            remarks.append(Remark("warning", text, about="bag's axes"))
    if video is None or force is None or not same(video, force) or "start_s" in written["video"]:
        return replace(rec, remarks=tuple(remarks))
    film_clock, force_clock = clock(video), clock(force)
    start = (film_clock.origin - force_clock.origin) * 1e-9
    doubt = HEADERS_DOUBT if film_clock.by == force_clock.by == "header" else RECEIPT_DOUBT
    doubt = float(written["video"].get("start_uncertainty_s", doubt))
    stamps = (
        "their headers' stamps" if film_clock.by == force_clock.by == "header" else "when their messages were received"
    )
    text = f"Film and force share the bag's clock: the film starts at {start:.4f} s by {stamps}, to {doubt:g} s."
    remarks = [remark for remark in remarks if "when the video starts" not in remark.text]
    remarks.append(Remark("note", text))
    return replace(rec, video=replace(video, start=start, start_uncertainty=doubt), remarks=tuple(remarks))


def same(video: VideoEntry, force: ForceEntry) -> bool:
    return video.file.resolve() == force.file.resolve()


def clock(entry: VideoEntry | ForceEntry) -> TopicClock:
    """The clock of the entry's topic."""
    bag, topic = opened_topic(entry)
    return clock_of(bag, topic, entry.definitions)


def opened_topic(entry: VideoEntry | ForceEntry) -> tuple[Bag, Topic]:
    if isinstance(entry, VideoEntry):
        return bag_film(entry)
    bag = open_bag(entry.file, keep=entry.damaged == "keep")
    return bag, topic_of(bag, entry.topic, "[force] topic")


def bag_remarks(name: str, entry: VideoEntry | ForceEntry) -> list[Remark]:
    """Remarks on damage of the bag and on its topic's clock."""
    bag, topic = opened_topic(entry)
    remarks = []
    if bag.fault:
        text = f"[{name}] {entry.file.name} is damaged ({bag.fault}): {topic.count} messages of {topic.channel.topic}"
        remarks.append(
            Remark(
                "warning", f"{text} are used, those before that. Check that the push is in them.", about="damaged bag"
            )
        )
    elif bag.scanned and entry.damaged == "refuse":
        text = f"[{name}] {entry.file.name} has no index (its recorder was not closed): read from front to back."
        remarks.append(Remark("note", text))
    if isinstance(entry, VideoEntry) and clock(entry).by == "receipt":
        text = (
            f"{topic.channel.topic} has no header stamps: the times at which it was received are used. Record header "
            "stamps."
        )
        remarks.append(Remark("warning", text, about="no stamps"))
    return remarks


def bag_span(video: VideoEntry) -> tuple[int, float]:
    """How many images the topic holds, and the time from the first to the last that was received, s."""
    bag, topic = bag_film(video)
    times = [received for received, _ in raw_messages(bag, topic)]
    return topic.count, (times[-1] - times[0]) * 1e-9 if times else math.nan
