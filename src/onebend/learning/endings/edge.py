"""The frames of a contact, and when it begins or ends."""

from __future__ import annotations

from dataclasses import dataclass

RUN = 3  # frames in a row that show a force, before it is a contact; fewer without one do not end it


@dataclass(frozen=True)
class Edge:
    """When a contact begins or ends: mean and sd [s]; NaN and infinity where the frames do not show it."""

    time: float
    sd: float


@dataclass(frozen=True)
class ContactFrames:
    """Frames of a contact."""

    first: int
    last: int
    moves: int  # last frame in which the beam is not at rest again
    end: Edge | None = None  # None: the bending does not tell it
