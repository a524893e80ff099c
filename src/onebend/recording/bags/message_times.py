"""The times of a bag's messages: the stamps of their headers, or the times of receipt where these are empty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from onebend.errors import RecordingError
from onebend.recording.bags.reader import Bag, Topic, messages

FIRST = 100  # messages that are searched for a stamp


@dataclass(frozen=True)
class TopicClock:
    """Where a topic's times come from, and the first of them."""

    by: Literal["header", "receipt"]
    origin: int  # ns


def clock_of(bag: Bag, topic: Topic, definitions: Path | None = None) -> TopicClock:
    """By the headers' stamps if one of the first messages has any, else by receipt.

    Raises:
        RecordingError: as `messages` does, or no message of the topic can be read.
    """
    received = None
    for time, message in islice(messages(bag, topic, definitions), FIRST):
        received = time if received is None else received
        if stamp := stamp_of(message):
            return TopicClock("header", stamp)
    if received is None:
        raise RecordingError(f"{bag.path}: no message of {topic.channel.topic} can be read.")
    return TopicClock("receipt", received)


def stamp_of(message: Any) -> int:
    """ns of the header's stamp; 0 where there is none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def timed(bag: Bag, topic: Topic, clock: TopicClock, definitions: Path | None = None) -> Iterator[tuple[float, Any]]:
    """Time since the clock's origin, s, and message; NaN where a stamp is missing among others that are there."""
    for received, message in messages(bag, topic, definitions):
        time = received if clock.by == "receipt" else stamp_of(message)
        yield (time - clock.origin) * 1e-9 if time else float("nan"), message
