"""What is known while frames and force samples come in, and what to do next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness, half_width_words
from onebend.learning.posterior import Grade
from onebend.recording.tags.tracker import TrackedFrame
from onebend.records import Array, ClockOffset, Remark
from onebend.report.confidence import identified_ranges, identified_words, typical_half_width
from onebend.report.wording import significant
from onebend.streaming.review import ENDED, NO_TAGS, Reviewed

NOTHING_YET = "no frame has come yet"
SOON = "the frames so far are being read"
_STILL = "three seconds"


@dataclass(frozen=True)
class Counts:
    """What came in, and what of it was of no use."""

    frames: int = 0
    late_frames: int = 0  # that came after a newer one; their tags are kept for what is learned at the end
    refused_frames: int = 0  # given twice, far too late, without a time, or no picture of this camera
    samples: int = 0  # of the force
    late_samples: int = 0  # that came after a newer one; they are put in their places
    refused_samples: int = 0  # without a time
    learned_frames: int = 0  # taught one by one, since the last review


@dataclass(frozen=True)
class LiveVerdict:
    """The verdict while a push goes on. "Not yet": nothing speaks against k(s), but what tests the model, and says
    what it had to allow for, needs the whole push and comes from `Live.finish`."""

    grade: Grade | Literal["not yet"]
    headline: str
    known: str  # k(s), and how well it is known; empty where it is not
    next: str  # the one thing to do


@dataclass(frozen=True)
class LiveState:
    """What is known after the newest frame and sample. `None`, or NaN: not identifiable yet, and `waiting` says why."""

    time: float  # s, the camera's clock, of the newest frame
    counts: Counts
    tags: TrackedFrame | None  # of the newest frame
    clock: ClockOffset | None  # log time = camera time + offset, both as they were given
    force: Array  # (2,) N on the beam, in its frame, at the newest frame that was learned from
    stiffness: UncertainStiffness | None  # k(s) with its band
    verdict: LiveVerdict
    waiting: tuple[str, ...]  # what is not known yet, and why
    remarks: tuple[Remark, ...]  # of the last review, as `learn` makes them


def live_verdict(
    stiffness: UncertainStiffness | None, known: Reviewed, why: str, doubts: tuple[str, ...] = ()
) -> LiveVerdict:
    """The verdict on k(s) as it is now, or on `why` there is none: doubts as `learn` has them, as far as they can be
    known before the push is over. `doubts`: of the learner, at its last frame."""
    said = tuple(remark.text.rstrip(".") for remark in known.remarks if remark.doubt)
    step = _next(stiffness, why, known.moved, known.rested)
    if stiffness is None:
        return LiveVerdict("not yet", f"k(s) is not identifiable yet: {why or SOON}", "", step)
    against = tuple(dict.fromkeys((*stiffness.doubts, *doubts, *said, *([why] if why not in ("", ENDED) else []))))
    words = _words(stiffness)
    if against:
        headline = f"k(s) is NOT TO BE TRUSTED: {'; '.join(against)}"
        return LiveVerdict("not to be trusted", headline, words, said[0] if said else step)
    headline = "nothing speaks against k(s) so far; the tests of the model come after the last frame"
    return LiveVerdict("not yet", headline, words, step)


def _words(stiffness: UncertainStiffness) -> str:
    s = np.linspace(0.0, 1.0, 201)
    band, ranges = stiffness.band(s), identified_ranges(stiffness)
    k = band.k[band.identified] if band.identified.any() else band.k
    span = f"{significant(float(k.min()))} to {significant(float(k.max()))} N m"
    if not ranges:
        return f"{span}, not identified: at no place to a factor of 1.5 (95 %)"
    wide = half_width_words(typical_half_width(stiffness))
    return f"{span}, {wide} (95 %, median) over s = {identified_words(ranges)}"


def _next(stiffness: UncertainStiffness | None, why: str, moved: bool, rested: bool) -> str:
    if why == NO_TAGS:
        return "bring all tags into the picture, in focus and well lit"
    if not moved:
        return f"keep the beam at rest for {_STILL}, then push it slowly"
    if rested:
        return "stop, and learn from the whole push: `finish()`"
    if stiffness is None or not identified_ranges(stiffness):
        return "go on pushing, slowly and farther, then let go"
    return f"let go, and keep the beam at rest for {_STILL}: the drift of the force log shows only then"
