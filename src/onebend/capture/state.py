"""What a recorder is told, what it says while it records, and what it leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.capture.film_writer import CRF
from onebend.recording.video import Picture
from onebend.records import Array
from onebend.streaming.live import LiveSettings
from onebend.streaming.state import LiveState

Stage = Literal["exposure", "tare", "first rest", "push", "last rest", "done"]
STAGES: tuple[Stage, ...] = ("exposure", "tare", "first rest", "push", "last rest", "done")


class Stop(Protocol):
    """As `threading.Event`."""

    def is_set(self) -> bool: ...


@dataclass(frozen=True)
class CaptureSettings:
    """How a push is recorded."""

    until: float = math.nan  # stop when k(s) is known to this share (half the 95 % band, median); NaN: after one push
    begin_at_once: bool = False  # film whatever is wrong with the picture
    follow: bool = True  # learn k(s) while it goes on
    setup: float = 1.0  # s for which the picture must be good before the film begins; they are in the film
    tare: float = 1.0  # s of the first rest that give the first zero of the force
    rest: float = 3.0  # s of each rest
    least_rest: float = 0.8  # s: a push that begins earlier begins the first rest anew
    share: float = 0.5  # of the beam's length by which the tip should move
    longest: float = 600.0  # s of the film
    crf: int = CRF
    flush_every: float = 0.5  # s: rows that a sudden end may lose
    state_every: float = 0.1  # s
    stiffness_every: float = 0.5  # s: reading k(s) takes some time
    least_disk: float = 200e6  # bytes: the film ends before the disk is full
    most_waiting: int = 4  # pictures: where more wait, they are filmed and not followed
    overwrite: bool = False  # replace film and log of an earlier recording
    live: LiveSettings = field(default_factory=LiveSettings)
    live_beside: bool = True  # as `onebend.Live`


@dataclass(frozen=True)
class TagView:
    """A tag as the newest picture shows it."""

    id: int
    s: float  # its place along the beam; those of the base at 0
    corners: Array  # (4, 2) px; NaN where it is not seen
    on_base: bool

    @property
    def seen(self) -> bool:
        return bool(np.isfinite(self.corners).all())

    @property
    def side_px(self) -> float:
        """Mean side; NaN where it is not seen."""
        sides = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1)
        return float(sides.mean())


@dataclass(frozen=True)
class CaptureState:
    """What is known while a push is recorded. NaN or None: not known yet."""

    stage: Stage
    advice: tuple[str, ...] = ()  # what to do now, the most urgent first
    picture: Picture | None = None  # (H, W), the newest
    tags: tuple[TagView, ...] = ()  # of the newest picture that was searched
    force: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N, newest, in the sensor's axes, less tare
    force_time: float = math.nan  # s, the film's clock
    tare: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N
    displacement: float = math.nan  # of the tip from its rest, as a share of the beam's length
    largest: float = math.nan  # of these so far
    stiffness: UncertainStiffness | None = None  # k(s) with its band
    half_width: float = math.nan  # of the band of k(s), as a share: 0.05 is 5 %
    until: float = math.nan  # the half width that is wanted
    seconds: float = 0.0  # of film
    frames: int = 0  # in the film
    drops: int = 0  # frames that the camera took and that did not come, or came too late
    unfollowed: int = 0  # frames that are filmed, and were not searched for tags for want of time
    samples: int = 0  # rows of the force log
    lost_samples: int = 0  # rows that are known to be missing
    clock_sd: float = math.nan  # s, of the line that brings the force's stamps to the camera's clock
    bytes: int = 0  # of film and log
    disk_left: float = math.nan  # bytes
    live: LiveState | None = None  # tags, clock, verdict in full
    next_push: str = ""  # where another one is wanted: which would narrow the band most


@dataclass(frozen=True)
class CaptureOutcome:
    """What a recording left."""

    folder: Path
    film: Path | None  # None: nothing was recorded
    log: Path | None
    why: str  # it ended, in a sentence
    fault: bool  # it ended otherwise than asked for: a cable, a full disk
    state: CaptureState  # the last one
    remarks: tuple[str, ...] = ()  # what to know before learning from it

    @property
    def whole(self) -> bool:
        """Whether a film is there from a rest to a push and back."""
        return self.state.stage == "done"


def outcome_words(outcome: CaptureOutcome) -> str:
    """What was recorded, for people."""
    state, folder = outcome.state, outcome.folder
    size = f"{state.seconds:.1f} s, {state.frames} frames"
    missing = f" ({state.drops} more are missing)" if state.drops else ""
    rows = f", {state.samples} samples of the force" if outcome.log is not None else ""
    lines = [f"Recorded {folder}: {size}{missing}{rows}. It ended: {outcome.why}."]
    if math.isfinite(state.half_width):
        lines.append(f"k(s) so far: ± {100 * state.half_width:.2g} % (95 %, median).")
    lines += [f"{remark[0].upper()}{remark[1:]}." for remark in outcome.remarks]
    return "\n".join([*lines, f"Look at it with: onebend check {folder}   Learn from it with: onebend learn {folder}"])


def outcome_data(outcome: CaptureOutcome) -> dict[str, object]:
    """The same as plain data, SI."""
    state = outcome.state
    return {
        "folder": str(outcome.folder),
        "film": str(outcome.film),
        "log": None if outcome.log is None else str(outcome.log),
        "ended": outcome.why,
        "whole": outcome.whole,
        "stage": state.stage,
        "seconds": state.seconds,
        "frames": state.frames,
        "frames_missing": state.drops,
        "samples": state.samples,
        "samples_missing": state.lost_samples,
        "clock_sd_s": none_of(state.clock_sd),
        "half_width": none_of(state.half_width),
        "remarks": list(outcome.remarks),
    }


def none_of(value: float) -> float | None:
    """A number as JSON has it: NaN is null."""
    return value if math.isfinite(value) else None
