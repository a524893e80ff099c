"""The topics of a bag, and which of them are probably the force and the film."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.bags.film_topic import PACKED, RAW
from onebend.recording.bags.force_topic import FIELDS
from onebend.recording.bags.message_times import stamp_of
from onebend.recording.bags.message_types import decoder
from onebend.recording.bags.reader import Bag, Topic, open_bag, raw_messages
from onebend.recording.dropped_samples import missing
from onebend.recording.signals import step

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
    fault: str  # where the bag breaks off, "" where it does not


def bag_contents(path: Path | str, definitions: Path | None = None) -> BagContents:
    """Every topic with its type, count, rate and span; a damaged bag up to the damage.

    Raises `RecordingError` where nothing can be read.
    """
    path = Path(path)
    try:
        bag = open_bag(path)
        rows = tuple(row_of(bag, topic, definitions) for _, topic in sorted(bag.topics.items()))
    except RecordingError:
        bag = open_bag(path, keep=True)
        if not bag.fault or not bag.count:
            raise
        rows = tuple(row_of(bag, topic, definitions) for _, topic in sorted(bag.topics.items()))
    return BagContents(path, rows, guess(bag, "force"), guess(bag, "image"), bag.fault)


def row_of(bag: Bag, topic: Topic, definitions: Path | None) -> TopicRow:
    """The topic's times, by its headers where they have stamps and their type is known."""
    try:
        decode = decoder(bag.path, topic.channel, definitions)
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
    return TopicRow(
        topic.channel.topic,
        topic.channel.type,
        topic.count,
        1 / spacing if spacing > 0 else np.nan,
        float(time[0]) * 1e-9 if len(time) else np.nan,
        float(time[-1]) * 1e-9 if len(time) else np.nan,
        "header" if stamped else "receipt",
        missing(since),
    )


def guess(bag: Bag, what: Literal["force", "image"]) -> str:
    """The topic of a fitting type with the most messages, the better type first; "" where there is none."""
    fitting = [
        (LIKELY[what].index(topic.channel.type), -topic.count, name)
        for name, topic in bag.topics.items()
        if topic.channel.type in LIKELY[what] and topic.count
    ]
    return min(fitting)[2] if fitting else ""
