"""Reviews of a stream: all frames and rows so far, read as `learn` reads a recording.

Each review finds camera, rest, clock and tare anew and plays the stream to a new live learner, so early errors are not
carried along.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

import numpy as np

from onebend.errors import ObservationError, OnebendError
from onebend.learning.start import start_of
from onebend.live.history import ForceHistory, FrameReader, reader_of
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner
from onebend.live.replayed import replay
from onebend.progress import interrupts_held, leave_interrupts_to_parent, one_blas_thread
from onebend.recording.entries import Recording
from onebend.recording.force import find_contact
from onebend.recording.force_log import FEWEST_ROWS, whole_log
from onebend.recording.observe import FEWEST_FRAMES, ObserveSettings, markers_of, observe_markers
from onebend.recording.tags import BlockTracks, summary
from onebend.recording.tool import SmallPictures, ToolPlace, tool_checked, tool_in_small
from onebend.recording.tracks import with_angles
from onebend.records import Array, BoolArray, ClockOffset, ForceLog, IntArray, Markers, Observations, Remark
from onebend.report.sentences import say

NO_TAGS = "no tag of recording.toml is in the picture"
NO_PUSH = "the beam has not moved yet"
ENDED = "the process that reviews the push ended; what was known goes on, and the next review starts another"
HALF = 0.015  # s: the force of a frame is the mean of the rows that are as near
LONGEST_GAP = 0.1  # s, to the nearest row where none is
CLOCK_KNOWN = 0.02  # s, one sd: clocks that are stated so well need no match by the push


@dataclass(frozen=True)
class Seen:
    """A copy of what is kept of a stream."""

    recording: Recording
    tracks: BlockTracks
    rows: Array  # (N, 3 or 4) of the force log
    small: SmallPictures | None = None  # in which the tool may show; None: it is not looked for

    @property
    def until(self) -> float:
        return float(self.tracks.time[-1])


@dataclass(frozen=True)
class Later:
    """Frames and rows that came while a review was made."""

    time: tuple[float, ...]  # s
    corners: tuple[Array, ...]  # (m, 4, 2) px each
    rows: Array  # (N, 3 or 4), from before the first of these frames
    ahead: float  # s: as `FrameReader.stands_in`


@dataclass(frozen=True)
class Reviewed:
    """What a review found; None: not yet, and `why` says why."""

    until: float  # s, the frames' clock: the last frame that it knows
    why: str = ""
    clock: ClockOffset | None = None
    remarks: tuple[Remark, ...] = ()
    moved: bool = False  # the beam was pushed
    rested: bool = False  # and is at rest again: the drift of the log is known
    reader: FrameReader | None = None
    learner: OnlineLearner | None = None


def observed_in(seen: Seen, settings: ObserveSettings = ObserveSettings()) -> Observations:
    """The observations of what was seen, as `learn` makes them of a recording.

    Raises:
        ObservationError: what is wrong with it, or not there yet.
    """
    rec, small, markers = seen.recording, seen.small, _markers_in(seen)
    observed = observe_markers(rec, markers, log_of(rec, seen.rows), settings)
    if small is None:
        return observed

    def find(tags: Markers, loaded: BoolArray, frame: IntArray) -> ToolPlace:
        return tool_in_small(small, rec, tags, loaded, markers.time[frame])

    return tool_checked(rec, observed, markers.base_angle[observed.frame], find)


def _markers_in(seen: Seen) -> Markers:
    rec, tracks = seen.recording, seen.tracks
    assert rec.video is not None
    if not np.isfinite(tracks.corners).all(axis=(2, 3)).any():
        raise ObservationError(NO_TAGS, about="unseen tag")
    if len(tracks.time) < FEWEST_FRAMES:
        raise ObservationError(f"{len(tracks.time)} frames came so far; at least {FEWEST_FRAMES} are needed")
    tag_id = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    return markers_of(rec, summary(rec.video, rec.tags, tag_id, [tracks]))


def log_of(rec: Recording, rows: Array) -> ForceLog | None:
    """The log from its rows; None where the recording has no force.

    Raises:
        ObservationError: too few rows came.
    """
    if rec.force is None:
        return None
    if len(rows) < FEWEST_ROWS:
        raise ObservationError(f"{len(rows)} samples of the force came so far; at least {FEWEST_ROWS} are needed")
    return whole_log("the force log", rows)


@one_blas_thread
def review(
    seen: Seen, observing: ObserveSettings = ObserveSettings(), learning: OnlineSettings = OnlineSettings()
) -> Reviewed:
    """Read all that was seen, and play it to a new learner. Never raises what a recording may cause: `why` says it.

    A force that contradicts the bending is a doubt here, since a push that has just begun may look like that.
    """
    moved = False
    try:
        markers = _markers_in(seen)
        log = log_of(seen.recording, seen.rows)
        moved = bool(find_contact(with_angles(markers), settings=observing.contact).loaded.any())
        if not moved:  # nothing else can be known yet
            return Reviewed(seen.until, NO_PUSH, remarks=markers.remarks)
        observed = observe_markers(seen.recording, markers, log, replace(observing, check_force=False))
    except OnebendError as error:
        return Reviewed(seen.until, str(error), moved=moved)
    source = observed.source
    clean = source.clean_force
    known = Reviewed(
        until=seen.until,
        clock=known_clock(source.clock),
        remarks=source.remarks,
        moved=moved,
        rested=moved and clean is not None and len(clean.zero_time) > 1,
    )
    if why := _not_yet(seen.recording, observed):
        return replace(known, why=why)
    try:
        start = start_of([observed], None)
        learner = replay(observed, start, gain_sd=observed.stated.gain_sd, settings=learning)
    except (OnebendError, np.linalg.LinAlgError) as error:
        return replace(known, why=str(error))
    return replace(known, reader=reader_of(seen.recording, observed), learner=learner)


def known_clock(clock: ClockOffset | None) -> ClockOffset | None:
    """The offset where it was found, or is stated so well that the push need not show it."""
    return clock if clock is not None and (clock.found or clock.sd < CLOCK_KNOWN) else None


def _not_yet(rec: Recording, observed: Observations) -> str:
    """Why k(s) cannot be learned frame by frame from what was observed so far; empty where it can."""
    if refused := not_live(rec):
        return refused
    source = observed.source
    if source.clean_force is None:
        return say("live: no force")
    if not observed.loaded.any():
        return say("live: no push in the log")
    if not len(source.clean_force.zero_time):
        return say("live: no rest")
    if source.clock is not None and known_clock(source.clock) is None:
        return say("live: clocks", sd=source.clock.sd)
    return ""


def not_live(rec: Recording) -> str:
    """What of recording.toml the live learner does not know, in words; empty where it knows all."""
    if rec.beam.stiffness_along != "unknown":
        return say("live: stated course")
    if rec.frequencies:
        return say("live: frequencies")
    return say("live: masses") if rec.beam.masses and rec.gravity is not None else ""


@one_blas_thread
def go_on(known: Reviewed, later: Later) -> Reviewed:
    """The review with what came since taught to its learner."""
    if known.learner is None or known.reader is None or not later.time:
        return known
    log = ForceHistory(max(len(later.rows), 1), later.rows.shape[1])
    log.add(later.rows)
    for when, corners in zip(later.time, later.corners, strict=True):
        logged = logged_at(log, known.reader, when, known.reader.stands_in(later.ahead))
        teach(known.learner, known.reader, when, corners, logged)
    return replace(known, until=later.time[-1])


def logged_at(log: ForceHistory, reader: FrameReader, time: float, stands_in: float) -> Array:
    """(2,) or (3,) of the log at `time` [s, the frames' clock]; NaN where it says nothing. Up to `stands_in` [s] after
    its newest row that one counts."""
    wanted = time + reader.offset
    if len(log) and wanted - log.newest <= stands_in:
        wanted = min(wanted, log.newest)
    return log.mean_near(wanted, HALF, LONGEST_GAP)


def teach(
    learner: OnlineLearner, reader: FrameReader, time: float, corners: Array, logged: Array
) -> Sequence[str] | None:
    """Update the learner with a frame at `time` [s, the frames' clock]; the doubts it then has. None where there was
    nothing to learn in it."""
    frame = reader.frame(time, corners, logged)
    if frame is None:
        return None
    try:
        return learner.update(**vars(frame)).doubts
    except OnebendError:  # a frame not newer than the last, a covariance without meaning: the next one will do
        return None


# Who makes the reviews of a stream: this process, at once, or another one beside it, so that no frame waits.

NICE = 5  # added to the niceness of the process that reviews


class Reviewer:
    """Makes one review at a time: at once, in this process, so that the same stream always gives the same results."""

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        self._settings = observing, learning
        self._made: Reviewed | None = None
        self.spent = 0.0  # s of this process's time that reviews took so far

    @property
    def busy(self) -> bool:
        return self._made is not None

    def begin(self, seen: Seen) -> None:
        begun = time.thread_time()
        self._made = review(seen, *self._settings)
        self.spent += time.thread_time() - begun

    def result(self, since: Callable[[Reviewed], Later]) -> Reviewed | None:  # noqa: ARG002 (nothing came meanwhile)
        """The review, once it is made; `since` gives what came after its last frame. Does not wait."""
        made, self._made = self._made, None
        return made

    def close(self) -> None:
        """End it; nothing more may be begun."""
        self._made = None


class ReviewerBeside(Reviewer):
    """Reviews in a process of its own, which ends with this object, or with its parent. Frames that came meanwhile are
    sent after each review, so that its learner is nearly up to date."""

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        super().__init__(observing, learning)
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: SimpleQueue[Reviewed | None] = SimpleQueue()
        self._messages: SimpleQueue[bytes] = SimpleQueue()
        self._until, self._caught_up, self._busy = 0.0, False, False
        self._start()  # it loads what it needs while the first frames come

    @property
    def busy(self) -> bool:
        return self._busy

    def begin(self, seen: Seen) -> None:
        self._until, self._caught_up, self._busy = seen.until, False, True
        if self._process is None or self._process.poll() is not None:
            self._start()
        self._send(seen)

    def result(self, since: Callable[[Reviewed], Later]) -> Reviewed | None:
        try:
            made = self._answers.get_nowait()
        except Empty:
            return None
        if made is None:
            self.close()
            return Reviewed(self._until, ENDED)
        if self._caught_up or made.reader is None:
            self._busy = False
            return made
        self._caught_up = True
        self._send(since(made))
        return None

    def close(self) -> None:
        self._end()
        self._process, self._busy = None, False

    def _start(self) -> None:
        self._answers, self._messages = SimpleQueue(), SimpleQueue()
        path = os.pathsep.join(one or str(Path.cwd()) for one in sys.path)
        with interrupts_held():
            self._process = process = subprocess.Popen(
                [sys.executable, "-c", "from onebend.live.review import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path},
            )
        self._end = weakref.finalize(self, _end, process, self._messages)
        threading.Thread(target=_listen, args=(process.stdout, self._answers), daemon=True).start()
        threading.Thread(target=_write, args=(process.stdin, self._messages), daemon=True).start()
        self._send(self._settings)

    def _send(self, message: object) -> None:
        self._messages.put(pickle.dumps(message))


def _end(process: subprocess.Popen[bytes], messages: SimpleQueue[bytes]) -> None:
    messages.put(b"")
    process.kill()
    process.wait()


def _write(stream: IO[bytes], messages: SimpleQueue[bytes]) -> None:
    """Pass on what is to be sent: a pipe takes no more at once than the other side reads. Empty bytes are the end."""
    with suppress(OSError):  # the process ended: `_listen` notices
        while data := messages.get():
            stream.write(data)
            stream.flush()
    with suppress(OSError):
        stream.close()


def _listen(stream: IO[bytes], answers: SimpleQueue[Reviewed | None]) -> None:
    """Pass on what the process answers; None when it ends."""
    with suppress(EOFError, OSError, pickle.UnpicklingError), stream:
        while True:
            answers.put(pickle.load(stream))
    answers.put(None)


def serve() -> None:
    """The other process: settings first, then reviews, until there is nothing more to read."""
    leave_interrupts_to_parent()
    with suppress(OSError, AttributeError):
        os.nice(NICE)
    inward, outward = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what is printed by mistake is no answer
    made = Reviewed(-np.inf)
    with suppress(EOFError, OSError):
        settings: Any = pickle.load(inward)
        while True:
            message = pickle.load(inward)
            try:
                made = review(message, *settings) if isinstance(message, Seen) else go_on(made, message)
            except Exception as error:  # the next review may do
                until = message.until if isinstance(message, Seen) else made.until
                made = Reviewed(until, say("live: review failed", wrong=f"{type(error).__name__}: {error}"))
            # after a review what came meanwhile is taught first
            pickle.dump(replace(made, learner=None) if isinstance(message, Seen) else made, outward)
            outward.flush()
