"""A ROS bag that a robot is writing: its force topic, read again and again up to where it ends.

Each look reads the whole bag, as one that broke off, and takes what is new; so looks are farther apart the longer it
grows. A recorder writes in chunks: what it holds back is not seen before it lets go of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.sources import End, Samples
from onebend.errors import RecordingError
from onebend.recording.bags.force_topic import FIELDS, default_field, force_of
from onebend.recording.bags.message_times import clock_of, timed
from onebend.recording.bags.reader import Bag, Topic, open_bag, topic_of
from onebend.recording.toml.entries import ForceEntry

EVERY, SHARE = 0.5, 4.0  # s between two looks, and times what the last one took
LONG_AGO = 30.0  # s without a message


class GrowingBag:
    """The force in a bag that grows."""

    columns: tuple[str, ...] = ("fx_N", "fy_N", "fz_N")

    def __init__(self, path: Path, topic: str = "", field: str = "") -> None:
        """`topic`: empty: the only one whose force is known; `field`: where the force stands in its messages."""
        self.name, self._path, self.files = f"the bag {path}", path, (path,)
        self.timing = StampTiming(delay=0.01, delay_error=0.5)  # a recorder holds back what it writes
        self._entry = ForceEntry(path, topic=topic, field=field, damaged="keep")
        self._seen, self._due, self._heard = 0, -np.inf, 0.0
        self._clock: Clock | None = None

    def open(self, clock: Clock) -> None:
        """Find the topic; what is in the bag already is left out.

        Raises:
            RecordingError: there is no bag yet, or no such topic in it.
        """
        bag = open_bag(self._path, keep=True)
        topic = self._topic(bag)
        default = self._entry.field or default_field(topic, self._entry)
        self._entry = ForceEntry(self._path, topic=topic.channel.topic, field=default, damaged="keep")
        self._seen = len(self._rows()[0])
        self._clock, self._heard = clock, clock.now()

    def read(self, wait: float) -> Samples | End | None:
        """The messages that are new."""
        assert self._clock is not None
        begun = self._clock.now()
        if begun < self._due:
            self._clock.wait_until(min(self._due, begun + wait))
            return None
        try:
            time, force = self._rows()
        except (RecordingError, OSError) as wrong:
            return End(f"{self.name} cannot be read any more ({wrong})", fault=True)
        now = self._clock.now()
        self._due = now + max(EVERY, SHARE * (now - begun))
        if len(time) <= self._seen:
            return End(f"{self.name} does not grow any more", fault=True) if now - self._heard > LONG_AGO else None
        new = slice(self._seen, None)
        self._seen, self._heard = len(time), now
        return Samples(time[new], force[new], begun)

    def close(self) -> None:
        """Nothing is held between two looks."""

    def _topic(self, bag: Bag) -> Topic:
        if self._entry.topic:
            return topic_of(bag, self._entry.topic, "topic")
        known = [topic for topic in bag.topics.values() if topic.channel.type in FIELDS]
        if len(known) != 1:
            names = ", ".join(topic.channel.topic for topic in known or bag.topics.values()) or "none yet"
            raise RecordingError(f"bag:{self._path}: say which topic holds the force, topic=/NAME. It has {names}.")
        return known[0]

    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) s and (N, 3) N of all messages so far, in the order of the bag."""
        bag = open_bag(self._path, keep=True)
        topic = topic_of(bag, self._entry.topic, "topic")
        if not topic.count:
            return np.empty(0), np.empty((0, 3))
        clock = clock_of(bag, topic, None)
        where = f"{self._path}: {topic.channel.topic}"
        rows = [
            (time, *force_of(message, self._entry.field, where)[0]) for time, message in timed(bag, topic, clock, None)
        ]
        read = np.array(rows).reshape(-1, 4)
        return read[:, 0], read[:, 1:]
