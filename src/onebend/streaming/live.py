"""From camera frames and force samples, as they come in, to tags, clock, force, and k(s) with its band."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from onebend.blas import one_blas_thread
from onebend.errors import ObservationError, RecordingError
from onebend.learning.inference.stages import FitSettings
from onebend.learning.live.settings import OnlineSettings
from onebend.pipeline import Run, learn_observed
from onebend.progress import Progress, Silent
from onebend.recording.folder import read_recording
from onebend.recording.observe import ObserveSettings
from onebend.recording.tags.tracker import TrackedFrame, Tracker
from onebend.recording.toml.entries import Recording
from onebend.recording.tool.kept_small import KeptSmall
from onebend.recording.video import Picture
from onebend.records import ClockOffset
from onebend.streaming.following import Following
from onebend.streaming.history import ForceHistory, FrameHistory
from onebend.streaming.review import Reviewed, Seen, observed_in
from onebend.streaming.reviewer import Reviewer, ReviewerBeside, ReviewerHere
from onebend.streaming.state import NOTHING_YET, SOON, Counts, LiveState, live_verdict

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
    learning: OnlineSettings = field(default_factory=OnlineSettings)


class Live:
    """Follows one push while it goes on. Not thread-safe: give frames and samples from one thread.

    Every frame costs some milliseconds. What needs the stream as a whole (camera, rest, clock, tare, and with them k(s)
    of all frames so far) is read at growing intervals by a process beside this one.
    """

    def __init__(
        self,
        recording: Recording | Path | str,
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
        rec = recording if isinstance(recording, Recording) else read_recording(recording, filmed=False)
        if rec.video is None:
            raise RecordingError(f"{rec.folder}: a live camera needs [video] and [tags] in recording.toml.")
        if rec.gravity is not None and rec.gravity.base_angle_file is not None:
            raise RecordingError(
                f"{rec.folder}: [gravity] base_angle_file cannot be followed live. Give base_angle_deg, and leave the "
                "base alone."
            )
        self.recording, self.settings, self._clock = rec, settings, clock
        tag_id = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
        self._tracker = Tracker(tag_id, rec.tags.family)
        self._small = KeptSmall(rec.beam.length, rec.tags.size, settings.most_frames // 4)
        self._frames = FrameHistory(settings.most_frames, self._small)
        self._log = ForceHistory(settings.most_rows, 4 if rec.push is not None and rec.push.column else 3)
        made = ReviewerBeside if beside else ReviewerHere
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @one_blas_thread
    def frame(self, image: Picture | None, time: float) -> TrackedFrame | None:
        """One picture of the camera: its tags, at once. None where it is of no use; `state().counts` says of how many.

        Args:
            image: (H, W) grey, 8 bit; None where a picture was lost.
            time: s, the camera's own clock. Pictures may be late by some frames.

        Raises:
            ObservationError: after `finish` or `close`.
        """
        self._check_open()
        seen, self._refused = None, "it was lost" if image is None else ""
        try:
            if image is not None:
                seen = self._tracker.step(image, time)
        except ObservationError as error:
            self._refused = str(error)
        if seen is None:
            self._counts = replace(self._counts, refused_frames=self._counts.refused_frames + 1)
            return None
        if math.isnan(self._begin):
            self._begin = time
            self._state_clock()
        own = replace(seen, time=time - self._begin)
        late = self._newest is not None and time < self._newest.time
        counts = self._counts
        self._counts = replace(counts, frames=counts.frames + 1, late_frames=counts.late_frames + late)
        if image is not None and not late:
            self._small.add(own.time, image, own.corners)
        self._frames.add(own)
        if not late:
            self._newest = seen
            self._following.add(own.time, own.corners)
            self._review(own.time)
        return seen

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

    @property
    def learned_until(self) -> float:
        """s, the camera's clock: the last frame that k(s) has in it; NaN where there is none."""
        return self._following.until + self._begin

    @property
    def review_seconds(self) -> float:
        """s of this process's time that reviews took so far: none where another process makes them."""
        return self._reviewer.spent

    @property
    def kept(self) -> dict[str, int]:
        """Counts of all that is kept of the stream; each is bounded, however long it runs."""
        return {
            "frames": len(self._frames),
            "pictures": len(self._small),
            "rows": len(self._log),
            "tracker": self._tracker.kept,
            **self._following.kept,
        }

    @one_blas_thread
    def state(self) -> LiveState:
        """What is known now. It costs some 15 ms where k(s) is read: not for every frame."""
        known, learning, log = self._following.reviewed, self._following.learning, self._log
        stiffness = None if learning is None else learning.learner.stiffness
        why = NOTHING_YET if self._newest is None else SOON if known is None else known.why
        known = Reviewed(math.nan) if known is None else known
        waiting = [] if stiffness is not None else [f"k(s): {why or SOON}"]
        if self._refused:
            waiting.append(f"the newest frame is of no use: {self._refused}")
        if known.clock is None:
            waiting.append(f"clock offset: {why or SOON}")
        if self._following.behind > _LATE:
            late = f"{self._following.behind:.2g} s late, or not at all"
            waiting.append(f"the newest frames: samples of the force come {late}, and k(s) follows them")
        if (older := self._following.stands_in) > _OLDER and learning is not None:
            sure = f"the clocks, known to {learning.reader.offset_sd:.2g} s (one sd)"
            waiting.append(
                f"the force of the newest frames: they take the newest there is, {older:.2g} s older by {sure}"
            )
        if not known.rested:
            waiting.append("drift of the force log: it shows in a rest after the push")
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
        return learn_observed(observed_in(seen_by(self), self.settings.observing), fitting=fitting, progress=progress)

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
        """The offset between the clocks as they were given."""
        return replace(clock, offset=clock.offset - self._begin, stated=clock.stated - self._begin)

    def _seen(self) -> Seen:
        tracks, repeats = self._frames.tracks()
        return Seen(self.recording, tracks, repeats, self._log.rows.copy())

    def _review(self, now: float) -> None:
        """Take what a review has found; begin the next one where it is due."""
        following, reviewer = self._following, self._reviewer
        if reviewer.busy and (made := reviewer.result(following.later)) is not None:
            following.take(made)
        if not reviewer.busy and now >= self._due:
            self._due = max(now + self.settings.least_apart, now * self.settings.review_growth)
            reviewer.begin(self._seen())
            if (at_once := reviewer.result(following.later)) is not None:
                following.take(at_once)


def seen_by(live: Live) -> Seen:
    """A copy of what is kept of a stream, pictures too, for `onebend.streaming.review.observed_in`."""
    return replace(live._seen(), small=live._small.small())
