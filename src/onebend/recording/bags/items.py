"""Records of a robot log that is read from front to back: topics, messages, and where it breaks off."""

from __future__ import annotations

from dataclasses import dataclass


class BrokenOffError(Exception):
    """The file cannot be read beyond a place; the text says which and why."""


@dataclass(frozen=True)
class Channel:
    """One topic as the file declares it."""

    topic: str
    type: str  # "geometry_msgs/msg/Wrench"
    encoding: str  # of the messages: "cdr" or "ros1"
    definition: str  # the message's definition as text; "" where the file has none
    idl: bool  # whether that is IDL, not MSG


Item = tuple[Channel, int, bytes] | Channel  # a message (received at, ns) or the declaration of a topic
