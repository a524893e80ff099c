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
import weakref
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any

import numpy as np

from onebend import records
from onebend.errors import ObservationError, OnebendError
from onebend.learning.frames import of_tags
from onebend.learning.start import start_of
from onebend.live.body import NOT_SEEN, SeenOutline
from onebend.live.history import FrameReader, reader_of
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner
from onebend.live.replayed import replay
from onebend.progress import interrupts_held, leave_interrupts_to_parent, one_blas_thread
from onebend.recording.camera import measure_tags, with_checked_turns
from onebend.recording.entries import Recording
from onebend.recording.flanks import Planes
from onebend.recording.force import find_contact
from onebend.recording.force_log import FEWEST_ROWS, whole_log
from onebend.recording.observe import FEWEST_FRAMES, ObserveSettings, observe_markers
from onebend.recording.outline import joined, left_out, outlined
from onebend.recording.tags import BlockTracks, summary
from onebend.recording.tool import ToolPlace, tool_checked, tool_in_stream
from onebend.recording.tracks import with_angles
from onebend.report.sentences import say

NO_TAGS = "no tag of recording.toml is in the picture"
NO_PUSH = "the beam has not moved yet"
ENDED = "the process that reviews the push ended; what was known goes on, and the next review starts another"
CLOCK_KNOWN = 0.02  # s, one sd: clocks that are stated so well need no match by the push


@dataclass(frozen=True)
class Seen:
    """A copy of what is kept of a stream."""

    recording: Recording
    tracks: BlockTracks
    rows: records.Array  # (N, 3 or 4) of the force log
    outline: SeenOutline | None = None  # of a body without tags
    pictures: Mapping[float, Planes] = field(default_factory=dict)  # some of them, by their time

    @property
    def until(self) -> float:
        return float(self.tracks.time[-1])


@dataclass(frozen=True)
class Reviewed:
    """What a review found; None: not yet, and `why` says why."""

    until: float  # s, the frames' clock: the last frame that it knows
    why: str = ""
    clock: records.ClockOffset | None = None
    remarks: tuple[records.Remark, ...] = ()
    moved: bool = False  # the beam was pushed
    rested: bool = False  # and is at rest again: the drift of the log is known
    reader: FrameReader | None = None
    learner: OnlineLearner | None = None


def observed_in(seen: Seen, settings: ObserveSettings = ObserveSettings()) -> records.Observations:
    """The observations of what was seen, as `learn` makes them of a recording.

    Raises:
        ObservationError: what is wrong with it, or not there yet.
    """
    rec, pictures, markers = seen.recording, seen.pictures, _markers_in(seen)
    observed = observe_markers(rec, markers, log_of(rec, seen.rows), settings)

    def find(tags: records.Markers, loaded: records.BoolArray, frame: records.IntArray) -> ToolPlace:
        return tool_in_stream(pictures, rec, tags, loaded, markers.time[frame])

    return tool_checked(rec, observed, markers.base_angle[observed.frame], find)


def _markers_in(seen: Seen) -> records.Markers:
    rec, tracks = seen.recording, seen.tracks
    assert rec.video is not None
    if not np.isfinite(tracks.corners).all(axis=(2, 3)).any():
        raise ObservationError(NO_TAGS, about="unseen tag")
    if len(tracks.time) < FEWEST_FRAMES:
        raise ObservationError(f"{len(tracks.time)} frames came so far; at least {FEWEST_FRAMES} are needed")
    tag_id = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    found = summary(rec.video, rec.tags, tag_id, [tracks])
    tags, outline = measure_tags(found, rec), seen.outline
    markers = with_checked_turns(tags.markers(), rec)
    read = np.flatnonzero(np.isin(tracks.time, list(seen.pictures)))
    pictures = [seen.pictures[t] for t in tracks.time[read].tolist()]
    if rec.tags.on_beam:
        return outlined(tags, markers, read, pictures) if rec.traces_outline and len(read) else markers
    if outline is None:
        raise ObservationError(NOT_SEEN, about="outline")
    return joined(tags, markers, lambda: outline.track(dict(zip(read.tolist(), pictures, strict=True))))


def log_of(rec: Recording, rows: records.Array) -> records.ForceLog | None:
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
        few = with_angles(records.of_markers(markers, records.read_before_fit(markers)))
        moved = bool(find_contact(few).loaded.any())
        if not moved:  # nothing else can be known yet
            return Reviewed(seen.until, NO_PUSH, remarks=markers.remarks)
        observed = observe_markers(seen.recording, markers, log, replace(observing, check_force=False))
        observed = of_tags(observed, observed.tag_id != records.END_ID)  # it is not read frame by frame
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
        if learner.doubts and observed.traced is not None and not observed.traced.all():  # as `fit` does
            alone = review(replace(seen, pictures={}), observing, learning)
            return replace(alone, remarks=(*alone.remarks, left_out(learner.doubts[0])))
    except (OnebendError, np.linalg.LinAlgError) as error:
        return replace(known, why=str(error))
    return replace(known, reader=reader_of(seen.recording, observed, seen.outline), learner=learner)


def known_clock(clock: records.ClockOffset | None) -> records.ClockOffset | None:
    """The offset where it was found, or is stated so well that the push need not show it."""
    return clock if clock is not None and (clock.found or clock.sd < CLOCK_KNOWN) else None


def _not_yet(rec: Recording, observed: records.Observations) -> str:
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


# Who makes the reviews of a stream: this process, at once, or another one beside it, so that no frame waits.

NICE = 5  # added to the niceness of the process that reviews


class Reviewer:
    """Makes one review at a time: at once, in this process, so that the same stream always gives the same results."""

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        self._settings = observing, learning
        self._made: SimpleQueue[Reviewed] = SimpleQueue()
        self.busy = False

    def begin(self, seen: Seen) -> None:
        self.busy = True
        self._made.put(review(seen, *self._settings))

    def result(self) -> Reviewed | None:
        """The review, once it is made. Does not wait."""
        try:
            made = self._made.get_nowait()
        except Empty:
            return None
        self.busy = False
        return made

    def close(self) -> None:
        """End it; nothing more may be begun."""


class ReviewerBeside(Reviewer):
    """Reviews in a process of its own, which ends with this object, or with its parent."""

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        super().__init__(observing, learning)
        self._start()  # it loads what it needs while the first frames come

    def begin(self, seen: Seen) -> None:
        self.busy = True
        if self._process.poll() is not None:
            self._start()
        threading.Thread(target=_ask, args=(self._process, seen, self._made), daemon=True).start()

    def close(self) -> None:
        self._end()

    def _start(self) -> None:
        path = os.pathsep.join(one or str(Path.cwd()) for one in sys.path)
        with interrupts_held():
            self._process = subprocess.Popen(
                [sys.executable, "-c", "from onebend.live.review import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path},
            )
        self._end = weakref.finalize(self, _end, self._process)
        _send(self._process.stdin, self._settings)


def _send(stream: IO[bytes] | None, message: object) -> None:
    assert stream is not None
    pickle.dump(message, stream)
    stream.flush()


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        with suppress(OSError, ValueError):  # what was not written yet is lost
            assert stream is not None
            stream.close()


def _ask(process: subprocess.Popen[bytes], seen: Seen, made: SimpleQueue[Reviewed]) -> None:
    """Put the answer of the process into `made`; a pipe takes no more at once than the other side reads."""
    assert process.stdout is not None
    try:
        _send(process.stdin, seen)
        made.put(pickle.load(process.stdout))
    except (EOFError, OSError, ValueError, pickle.UnpicklingError):
        _end(process)
        made.put(Reviewed(seen.until, ENDED))


def serve() -> None:
    """The other process: settings first, then reviews, until there is nothing more to read."""
    leave_interrupts_to_parent()
    with suppress(OSError, AttributeError):
        os.nice(NICE)
    inward, outward = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what is printed by mistake is no answer
    with suppress(EOFError, OSError):
        settings: Any = pickle.load(inward)
        while True:
            seen: Seen = pickle.load(inward)
            try:
                made = review(seen, *settings)
            except Exception as error:  # the next review may do
                made = Reviewed(seen.until, say("live: review failed", wrong=f"{type(error).__name__}: {error}"))
            _send(outward, made)
