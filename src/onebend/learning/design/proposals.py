"""What a plan says: pushes, what each would leave of the band, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.beam.profiles.uncertain import half_width_words
from onebend.learning.design.instruments import PlannedPush
from onebend.records import Array

PLACES = np.linspace(0.0, 1.0, 101)  # where the band is looked at


@dataclass(frozen=True)
class Quality:
    """How well k(s) is known. Widths are of the 95 % band of log k."""

    mean_width: float
    worst_width: float
    worst_s: float
    identified: float  # share of the beam
    identified_to: float  # k is identified from the clamp to here

    @property
    def mean_words(self) -> str:
        """How well k is known, on average over the whole beam."""
        return half_width_words(0.5 * self.mean_width)

    @property
    def worst_words(self) -> str:
        """How well k is known where it is known least."""
        return half_width_words(0.5 * self.worst_width)


@dataclass(frozen=True)
class Proposal:
    """One push, what it needs, and what it would leave of the band."""

    push: PlannedPush
    added_tag: float | None  # place of one more tag
    better_sensor: float | None  # times smaller errors than today's; None: today's sensor
    repeats: bool  # a push made before, once more
    tip_moves: float  # m
    tip_turns: float  # rad
    before: Quality
    after: Quality
    sd: Array  # (101,) of log k at `PLACES` after it

    @property
    def needs(self) -> str:
        """What is not on the bench yet."""
        if self.added_tag is not None:
            return f"a tag at s = {self.added_tag:.2f}"
        return "" if self.better_sensor is None else f"a force sensor {self.better_sensor:g} times as good"

    @property
    def text(self) -> str:
        """In one plain line."""
        again = "once more: " if self.repeats else ""
        with_what = f", with {self.needs}" if self.needs else ""
        return (
            f"{again}push at s = {self.push.at_s:.2f}, {direction_words(self.push.direction)}, to "
            f"{self.push.largest:.2g} N (tip moves {1e3 * self.tip_moves:.0f} mm){with_what}: k(s) "
            f"{self.before.mean_words} -> {self.after.mean_words} on average; "
            f"{identified_words(self.after)}"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON, in SI."""
        return {
            "text": self.text,
            "at_s": self.push.at_s,
            "direction_rad": self.push.direction,
            "largest_N": self.push.largest,
            "added_tag_s": self.added_tag,
            "better_sensor": self.better_sensor,
            "repeats": self.repeats,
            "tip_moves_m": self.tip_moves,
            "tip_turns_rad": self.tip_turns,
            "after": vars(self.after),
            "sd_log_k": self.sd.tolist(),
        }


@dataclass(frozen=True)
class Plan:
    """Proposals, what costs nothing first; the best two pushes on today's bench; and what was left out."""

    before: Quality
    sd: Array  # (101,) of log k at `PLACES` now
    proposals: tuple[Proposal, ...]
    pair: tuple[Proposal, ...]  # the second given the first
    left_out: tuple[str, ...]  # sentences

    def as_dict(self) -> dict[str, Any]:
        """For JSON, in SI."""
        return {
            "before": vars(self.before),
            "s": PLACES.tolist(),
            "sd_log_k": self.sd.tolist(),
            "proposals": [one.as_dict() for one in self.proposals],
            "pair": [one.as_dict() for one in self.pair],
            "left_out": list(self.left_out),
        }


def direction_words(direction: float) -> str:
    """The force's direction in the beam's frame: up is to the beam's left, out to its tip."""
    degrees = float(np.rad2deg(np.angle(np.exp(1j * direction))))
    side, off = ("up", 90.0 - degrees) if degrees >= 0.0 else ("down", 90.0 + degrees)
    if abs(off) < 0.5:
        return side
    return f"{side} and {abs(off):.0f} deg {'out' if off > 0.0 else 'back'}"


def identified_words(quality: Quality) -> str:
    """Where k is known to within half of itself."""
    if quality.identified >= 1.0:
        return "identified all along"
    if quality.identified <= 0.0:
        return "identified nowhere"
    if quality.identified_to > quality.identified - 0.02:
        return f"identified to s = {quality.identified_to:.2f}"
    return f"identified on {100.0 * quality.identified:.0f} % of the beam"
