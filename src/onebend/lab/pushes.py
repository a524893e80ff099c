"""A push as a tool makes it: rest, rise, hold, fall, rest; its direction may turn on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.errors import RecordingError
from onebend.records import Array


@dataclass(frozen=True)
class PushProfile:
    """The force on the beam over a film that begins at 0 s."""

    peak: float  # N
    direction: float = 1.75  # rad, against the beam's x axis, in the middle of the push
    turn: float = 0.5  # rad, by which the direction turns from first to last contact
    at_s: float = 1.0
    before: float = 1.5  # s, rest
    rise: float = 2.0  # s
    hold: float = 0.3  # s
    fall: float = 2.0  # s
    after: float = 1.0  # s, rest; 0: held to the end

    def __post_init__(self) -> None:
        if not (self.rise > 0.0 and self.fall > 0.0 and min(self.before, self.hold, self.after) >= 0.0):
            raise RecordingError("a push needs a rise and a fall that last, and no negative times")
        if not 0.0 < self.at_s <= 1.0:
            raise RecordingError(f"a push acts at s in (0, 1], got {self.at_s}")

    @property
    def contact(self) -> tuple[float, float]:
        """s, first and last contact."""
        return self.before, self.before + self.rise + self.hold + self.fall

    @property
    def duration(self) -> float:
        """s, of the film."""
        return self.contact[1] + self.after

    def force(self, time: Array) -> Array:
        """(N, 2) N at `time` (N,) [s]."""
        begin, end = self.contact
        part = smooth((time - begin) / self.rise) - smooth((time - end + self.fall) / self.fall)
        angle = self.angle(time)
        return np.asarray(self.peak * part[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def angle(self, time: Array) -> Array:
        """(N,) rad, the direction of the force at `time` (N,) [s], also before and after contact."""
        begin, end = self.contact
        return np.asarray(self.direction + self.turn * (np.clip((time - begin) / (end - begin), 0.0, 1.0) - 0.5))


def smooth(part: Array) -> Array:
    """0 to 1 with no jump of velocity or acceleration."""
    u = np.clip(part, 0.0, 1.0)
    return np.asarray(u**3 * (10.0 - 15.0 * u + 6.0 * u**2))
