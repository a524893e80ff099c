"""From camera frames and force samples, as they come in, to tags, clock, force, and k(s) with its band."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from statistics import median
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.stiffness import UncertainStiffness, half_width_words
from onebend.errors import ObservationError, OnebendError, RecordingError
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Grade
from onebend.live import body, history, hyperparameters, review
from onebend.live.learner import OnlineLearner
from onebend.live.review import ENDED, NO_TAGS, Reviewed, Reviewer, ReviewerBeside, Seen
from onebend.pipeline import Run, learn_observed
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.recording import entries, folder, tool
from onebend.recording.observe import ObserveSettings
from onebend.recording.tags import TrackedFrame
from onebend.recording.video import Picture
from onebend.records import Array, ClockOffset, Remark
from onebend.report.confidence import identified_ranges, identified_words, typical_half_width
from onebend.report.sentences import say, significant

# Frame by frame between two reviews: frames wait for their force, and are taught to the learner of the last review.

_BEHIND = 4  # frames that came during a review, of which its learner is taught with each new one
_SOON = 0.03  # s of newer frames, after which a force that is as near as the clocks are known is taken for that
HALF = 0.015  # s: the force of a frame is the mean of the rows that are as near
LONGEST_GAP = 0.1  # s, to the nearest row where none is
_LATELY = 31  # frames, of which is known how far the log had come

Frame = tuple[float, TrackedFrame]  # time [s, the frames' clock]


@dataclass
class Learning:
    """A learner with what it needs of each frame."""

    reader: history.FrameReader
    learner: OnlineLearner
    until: float  # s, the frames' clock: the last frame that it was shown
    learned: int = 0  # frames, one by one
    doubts: tuple[str, ...] = ()
    force: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N, at the last frame

    def update(self, log: history.ForceHistory, time: float, seen: TrackedFrame, ahead: float) -> None:
        """Teach it one frame; `ahead`: as `FrameReader.stands_in`."""
        wanted = time + self.reader.offset
        if len(log) and wanted - log.newest <= self.reader.stands_in(ahead):
            wanted = min(wanted, log.newest)
        logged = log.mean_near(wanted, HALF, LONGEST_GAP)
        self.until, self.force = time, self.reader.force_on_beam(logged[:2])
        frame = self.reader.frame(time, seen, logged)
        if frame is not None:
            with suppress(OnebendError):  # one not newer than the last, or without meaning: the next one will do
                self.doubts = self.learner.update(**vars(frame)).doubts
                self.learned += 1


class Following:
    """The frames on their way into k(s)."""

    def __init__(self, log: history.ForceHistory, wait: float, most: int) -> None:
        """Nothing yet. A frame waits no longer than `wait` [s, of later frames] for its force; at most `most` frames
        are kept that no review has seen."""
        self.reviewed: Reviewed | None = None
        self.learning: Learning | None = None
        self._log, self._wait, self._most = log, wait, most
        self._coming: Learning | None = None  # of the last review, until it has seen all frames
        self._since: list[Frame] = []  # that no review has seen
        self._ahead: deque[float] = deque(maxlen=_LATELY)  # s: of the log's newest row when a frame came, and its time

    @property
    def until(self) -> float:
        """s, the frames' clock: of the last frame learned."""
        return math.nan if self.learning is None else self.learning.until

    @property
    def ahead(self) -> float:
        """s: what the log's newest row usually is ahead of a frame that comes in, by their own clocks."""
        return median(self._ahead) if self._ahead else -math.inf

    @property
    def stands_in(self) -> float:
        """s: so far after the newest row of the log frames are, by the clocks, and take its force; as a rule 0."""
        return 0.0 if self.learning is None else self.learning.reader.stands_in(self.ahead)

    @property
    def behind(self) -> float:
        """s: how far the frame that waits longest for its force is behind the newest; 0 where there is no learner."""
        waiting = [] if self.learning is None else self._left(self.learning)
        return waiting[-1][0] - waiting[0][0] if waiting else 0.0

    def add(self, time: float, seen: TrackedFrame) -> None:
        """One more frame, later than all before."""
        self._since.append((time, seen))
        del self._since[: -self._most]
        if len(self._log):
            self._ahead.append(self._log.newest - time)
        self.release()
        if self._coming is not None and self._teach(self._coming, _BEHIND):
            self.learning, self._coming = self._coming, None

    def release(self) -> None:
        """Teach the frames whose force is there, or that waited long enough."""
        if self.learning is not None:
            self._teach(self.learning, self._most)

    def _left(self, learning: Learning) -> list[Frame]:
        """The frames that it was not shown yet."""
        return self._since[bisect_right(self._since, learning.until, key=itemgetter(0)) :]

    def _teach(self, learning: Learning, most: int) -> bool:
        """Teach at most so many frames; whether none is left that need not wait."""
        left = self._left(learning)
        for time, seen in left[:most]:
            if not self._there(time, learning.reader):
                return True
            learning.update(self._log, time, seen, self.ahead)
        return len(left) <= most

    def _there(self, time: float, reader: history.FrameReader) -> bool:
        """Whether a frame at `time` need not wait for more of the log."""
        waited, lacks, stands_in = self._since[-1][0] - time, time + reader.offset - self._log.newest, 0.0
        if lacks > -HALF:
            stands_in = reader.stands_in(self.ahead)
        near = min(history.AS_NEAR * reader.offset_sd, LONGEST_GAP)
        at_once = lacks <= (stands_in if stands_in > HALF else -HALF)
        return at_once or (waited >= _SOON and lacks <= near) or waited >= self._wait

    def take(self, made: Reviewed) -> None:
        """Go on from a review. Where it found less than the one before, that one stands, with the doubt."""
        before = self.reviewed
        if made.learner is None or made.reader is None:
            knew = before is not None and before.learner is not None
            self.reviewed = replace(before, why=made.why) if knew and before is not None else made
            return
        self.reviewed, self._coming = made, Learning(made.reader, made.learner, made.until)
        del self._since[: bisect_right(self._since, made.until, key=itemgetter(0))]


# What is known while frames and force samples come in, and what to do next.

NOTHING_YET = "no frame has come yet"
SOON = "the frames so far are being read"


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
    causes_of_width: Mapping[str, float] = field(default_factory=dict)  # of `LiveHyperparameters`; empty without k(s)


def live_verdict(
    stiffness: UncertainStiffness | None, known: Reviewed, why: str, doubts: tuple[str, ...] = ()
) -> LiveVerdict:
    """The verdict on k(s) as it is now, or on `why` there is none: doubts as `learn` has them, as far as they can be
    known before the push is over. `doubts`: of the learner, at its last frame."""
    said = tuple(remark.text.rstrip(".") for remark in known.remarks if remark.doubt)
    step = _next(stiffness, why, known.moved, known.rested)
    if stiffness is None:
        return LiveVerdict("not yet", say("live: not yet", why=why or SOON), "", step)
    against = tuple(dict.fromkeys((*stiffness.doubts, *doubts, *said, *([why] if why not in ("", ENDED) else []))))
    words = _words(stiffness)
    if against:
        headline = say("live: not to be trusted", doubts="; ".join(against))
        return LiveVerdict("not to be trusted", headline, words, said[0] if said else step)
    return LiveVerdict("not yet", say("live: so far"), words, step)


def _words(stiffness: UncertainStiffness) -> str:
    s = np.linspace(0.0, 1.0, 201)
    band, ranges = stiffness.band(s), identified_ranges(stiffness)
    k = band.k[band.identified] if band.identified.any() else band.k
    span = f"{significant(float(k.min()))} to {significant(float(k.max()))} N m"
    if not ranges:
        return say("live: nowhere", span=span)
    wide = half_width_words(typical_half_width(stiffness))
    return say("live: band", span=span, wide=wide, where=identified_words(ranges))


def _next(stiffness: UncertainStiffness | None, why: str, moved: bool, rested: bool) -> str:
    if why == NO_TAGS:
        return say("live next: tags")
    if not moved:
        return say("live next: rest")
    if rested:
        return say("live next: finish")
    if stiffness is None or not identified_ranges(stiffness):
        return say("live next: push")
    return say("live next: let go")


_LATE = 0.2  # s: a force that comes later is said to,
_OLDER = 0.05  # s: and one that is so much older than a frame, by the clocks, and is taken for its own


@dataclass(frozen=True)
class LiveSettings:
    """How a stream is kept and read."""

    most_frames: int = 6000  # kept; then every other one goes, and so on
    most_rows: int = 200_000  # of the force log, likewise
    first_review: float = 1.0  # s of frames before the first review
    review_growth: float = 1.25  # each review when the stream is so many times as long as at the last one,
    least_apart: float = 1.0  # and s longer
    wait: float = 2.0  # s: a frame waits no longer for the force at its time, and is then left to the next review
    observing: ObserveSettings = field(default_factory=ObserveSettings)
    learning: hyperparameters.OnlineSettings = field(default_factory=hyperparameters.OnlineSettings)


class Live:
    """Follows one push while it goes on. Not thread-safe: give frames and samples from one thread.

    Every frame costs some milliseconds. What needs the stream as a whole (camera, rest, clock, tare, and with them k(s)
    of all frames so far) is read at growing intervals by a process beside this one.
    """

    def __init__(
        self,
        recording: entries.Recording | Path | str,
        *,
        clock: tuple[float, float] | None = None,
        settings: LiveSettings = LiveSettings(),
        beside: bool = True,
    ) -> None:
        """A stream of which nothing has come yet.

        Args:
            recording: what is known of beam, tags, camera and sensor: a `recording.toml`, its folder, or what was read
                of it. The film and the force log that it names need not be there.
            clock: what the force log's time is ahead of the camera's, and its largest error, s: (0.0, 0.01) where one
                clock stamps both. None: as `start_s` says; where that says nothing either, it is found.
            beside: False: reviews are made by this process, and the frame at which one is due waits for it, some
                seconds. The same stream then always gives the same result.

        Raises:
            RecordingError: `recording.toml` cannot be read, or shows no [video] with tags.
        """
        rec = recording if isinstance(recording, entries.Recording) else folder.read_recording(recording, filmed=False)
        if rec.video is None:
            raise RecordingError(f"{rec.folder}: a live camera needs [video] and [tags] in recording.toml.")
        if rec.gravity is not None and rec.gravity.base_angle_file is not None:
            raise RecordingError(
                f"{rec.folder}: [gravity] base_angle_file cannot be followed live. Give base_angle_deg, and leave the "
                "base alone."
            )
        self.recording, self.settings, self._clock = rec, settings, clock
        self._tracker = body.BodyTracker(rec)
        self._pictures = tool.KeptPictures(settings.most_frames // 4)
        self._frames = history.FrameHistory(settings.most_frames, self._pictures)
        self._log = history.ForceHistory(settings.most_rows, 4 if rec.push is not None and rec.push.column else 3)
        made = ReviewerBeside if beside else Reviewer
        self._reviewer: Reviewer = made(settings.observing, settings.learning)
        self._begin = math.nan  # s, the camera's clock, of the first frame
        self._newest: TrackedFrame | None = None
        self._due = settings.first_review
        self._following = Following(self._log, settings.wait, settings.most_frames)
        self._counts = Counts()
        self._refused = ""  # why the newest frame was
        self._ended = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @one_blas_thread
    def frame(self, image: Picture | None, time: float, colour: Any = None) -> TrackedFrame | None:
        """One picture of the camera: its tags, at once. None where it is of no use; `state().counts` says of how many.

        Args:
            image: (H, W) grey, 8 bit; None where a picture was lost.
            time: s, the camera's own clock. Pictures may be late by some frames.
            colour: the same picture as `av.VideoFrame`. The body's outline is searched in its colours.

        Raises:
            ObservationError: after `finish` or `close`.
        """
        self._check_open()
        seen, self._refused = None, "it was lost" if image is None else ""
        try:
            if image is not None:
                seen = self._tracker.step(image, time, colour)
        except ObservationError as error:
            self._refused = str(error)
        if seen is None:
            self._counts = replace(self._counts, refused_frames=self._counts.refused_frames + 1)
        else:
            self.tracked(seen, image, colour)
        return seen

    @one_blas_thread
    def tracked(self, seen: TrackedFrame, image: Picture | None = None, colour: Any = None) -> None:
        """The tags of one picture, where a `Tracker` elsewhere found them; picture and colour as of `frame`.

        Raises:
            ObservationError: after `finish` or `close`.
        """
        self._check_open()
        time = seen.time
        if math.isnan(self._begin):
            self._begin = time
            self._state_clock()
        own = replace(seen, time=time - self._begin)
        late = self._newest is not None and time < self._newest.time
        counts = self._counts
        self._counts = replace(counts, frames=counts.frames + 1, late_frames=counts.late_frames + late)
        if image is not None and not late:
            self._pictures.add(own.time, own.corners, partial(body.planes_in, self.recording, image, colour))
        self._frames.add(own)
        if not late:
            self._newest = seen
            self._following.add(own.time, own)
            self._review(own.time)

    @one_blas_thread
    def force(self, time: ArrayLike, values: ArrayLike, place: ArrayLike | None = None) -> None:
        """One sample of the force sensor, or several.

        Args:
            time: s, the log's own clock, () or (n,); rows may be late, and in any order.
            values: (2,) or (n, 2) N, in the sensor's axes, as the columns of [force] in recording.toml. NaN: no value.
            place: () or (n,) of the push along the beam, where recording.toml names a column for it.

        Raises:
            ObservationError: shapes that do not fit; after `finish` or `close`.
        """
        self._check_open()
        times = np.atleast_1d(np.asarray(time, dtype=float))
        forces = np.asarray(values, dtype=float).reshape(-1, np.shape(values)[-1] if np.ndim(values) else 1)
        columns = self._log.rows.shape[1]
        if times.ndim != 1 or forces.shape != (len(times), 2) or (place is None) != (columns == 3):
            wanted = "times (n,), forces (n, 2)" + (" and places (n,) of the push" if columns == 4 else "")
            raise ObservationError(f"samples of the force are {wanted}; got {np.shape(time)} and {np.shape(values)}")
        rows = np.column_stack([times, forces])
        if place is not None:
            rows = np.column_stack([rows, np.broadcast_to(np.asarray(place, dtype=float), len(times))])
        self._log.add(rows)
        self._following.release()

    @one_blas_thread
    def state(self) -> LiveState:
        """What is known now. It costs some 15 ms where k(s) is read: not for every frame."""
        known, learning, log = self._following.reviewed, self._following.learning, self._log
        stiffness = None if learning is None else learning.learner.stiffness
        why = NOTHING_YET if self._newest is None else SOON if known is None else known.why
        known = Reviewed(math.nan) if known is None else known
        waiting = [] if stiffness is not None else [f"k(s): {why or SOON}"]
        if self._refused:
            waiting.append(say("live: refused", why=self._refused))
        if known.clock is None:
            waiting.append(f"clock offset: {why or SOON}")
        if self._following.behind > _LATE:
            waiting.append(say("live: late force", late=self._following.behind))
        if (older := self._following.stands_in) > _OLDER and learning is not None:
            waiting.append(say("live: older force", older=older, sd=learning.reader.offset_sd))
        if not known.rested:
            waiting.append(say("live: drift"))
        return LiveState(
            time=math.nan if self._newest is None else self._newest.time,
            counts=replace(
                self._counts,
                samples=log.count,
                late_samples=log.late,
                refused_samples=log.refused,
                learned_frames=0 if learning is None else learning.learned,
            ),
            tags=self._newest,
            clock=None if known.clock is None else self._own(known.clock),
            force=np.full(2, np.nan) if learning is None else learning.force,
            stiffness=stiffness,
            verdict=live_verdict(stiffness, known, why, () if learning is None else learning.doubts),
            waiting=tuple(waiting),
            remarks=known.remarks,
            causes_of_width={} if learning is None else learning.learner.hyperparameters.causes_of_width,
        )

    def finish(self, *, fitting: FitSettings = FitSettings(), progress: Progress = Silent()) -> Run:
        """Learn from all that came, as `learn` does from a recording; nothing more may come. It takes some seconds.

        Raises:
            ObservationError, LearningError: what is wrong with what came, and what to do.
        """
        self._check_open()
        self.close()
        if not len(self._frames):
            raise ObservationError(f"{self.recording.name}: {NOTHING_YET}")
        return learn_observed(
            review.observed_in(self._seen(), self.settings.observing), fitting=fitting, progress=progress
        )

    def close(self) -> None:
        """End the process beside this one; nothing more may come."""
        self._ended = True
        self._reviewer.close()

    def _check_open(self) -> None:
        if self._ended:
            raise ObservationError("this stream is finished. Begin another with `Live`")

    def _state_clock(self) -> None:
        """What is known of the clocks beforehand, of frames whose time begins with the first one."""
        if self._clock is not None and self.recording.video is not None:
            ahead, error = self._clock
            video = replace(self.recording.video, start=ahead + self._begin, start_uncertainty=error)
            self.recording = replace(self.recording, video=video)

    def _own(self, clock: ClockOffset) -> ClockOffset:
        return replace(clock, offset=clock.offset - self._begin, stated=clock.stated - self._begin)

    def _seen(self) -> Seen:
        outline = body.outline_in(self._frames.frames, self._tracker.follower)
        return Seen(self.recording, self._frames.tracks(), self._log.rows.copy(), outline, self._pictures.by_time())

    def _review(self, now: float) -> None:
        """Take what a review has found; begin the next one where it is due."""
        following, reviewer = self._following, self._reviewer
        if (made := reviewer.result()) is not None:
            following.take(made)
        if not reviewer.busy and now >= self._due:
            self._due = max(now + self.settings.least_apart, now * self.settings.review_growth)
            reviewer.begin(self._seen())
            if (at_once := reviewer.result()) is not None:
                following.take(at_once)
