"""What the frames and the log so far say when they are read as a whole: camera, rest, clock, tare, k(s).

A review reads all that is kept as `learn` reads a recording, with the same functions, and plays it to a new live
learner. Frame by frame only that learner goes on, with the camera, clock and tare of the last review. So what was
wrong with them in the beginning is not carried along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import ObservationError, OnebendError
from onebend.learning.live.online_learner import OnlineLearner
from onebend.learning.live.settings import OnlineSettings
from onebend.learning.replay import replay
from onebend.learning.start import start_of
from onebend.recording.force.contact import find_contact
from onebend.recording.force.force_log import FEWEST_ROWS, whole_log
from onebend.recording.observe import FEWEST_FRAMES, ObserveSettings, markers_of, observe_markers
from onebend.recording.tags.detection import summary
from onebend.recording.tags.tracking import BlockTracks
from onebend.recording.toml.entries import Recording
from onebend.recording.tool.film import SmallPictures, tool_checked, tool_in_small
from onebend.recording.tool.place import ToolPlace
from onebend.recording.tracks.chords import with_angles
from onebend.records import Array, BoolArray, ClockOffset, ForceLog, IntArray, Markers, Observations, Remark
from onebend.streaming.history import ForceHistory
from onebend.streaming.reading import FrameReader, reader_of

NO_TAGS = "no tag of recording.toml is in the picture"
NO_PUSH = "the beam has not moved yet"
ENDED = "the process that reviews the push ended; what was known goes on, and the next review starts another"
HALF = 0.015  # s: the force of a frame is the mean of the rows that are as near
LONGEST_GAP = 0.1  # s, to the nearest row where none is


@dataclass(frozen=True)
class Seen:
    """A copy of what is kept of a stream."""

    recording: Recording
    tracks: BlockTracks
    repeats: BoolArray  # (T,) pictures that are those before
    rows: Array  # (N, 3 or 4) of the force log
    small: SmallPictures | None = None  # in which the tool may show; None: it is not looked for

    @property
    def until(self) -> float:
        """s, the frames' clock."""
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
    return markers_of(rec, summary(rec.video, rec.tags, tag_id, [tracks], seen.repeats))


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
        clock=source.clock if source.clock is not None and source.clock.found else None,
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


def _not_yet(rec: Recording, observed: Observations) -> str:
    """Why k(s) cannot be learned frame by frame from what was observed so far; empty where it can."""
    if refused := not_live(rec):
        return refused
    source = observed.source
    if source.clean_force is None:
        return "there is no [force] in recording.toml"
    if not observed.loaded.any():
        return "the force log shows no push"
    if not len(source.clean_force.zero_time):
        return "no rest before the push was seen: the zero of the force is not known"
    if source.clock is not None and not source.clock.found:
        return f"the clocks of camera and force are not matched yet ({source.clock.sd:.2g} s, one sd)"
    return ""


def not_live(rec: Recording) -> str:
    """What of recording.toml the live learner does not know, in words; empty where it knows all."""
    if rec.beam.stiffness_along != "unknown":
        what = "a stated course of k(s) (stiffness_along)"
    elif rec.frequencies:
        what = "natural frequencies ([[frequencies]])"
    elif rec.beam.masses and rec.gravity is not None:
        what = "masses that ride on the beam ([[beam.masses]])"
    else:
        return ""
    return f"the live learner knows nothing of {what}: k(s) comes after the last frame, from `finish()`"


@one_blas_thread
def go_on(known: Reviewed, later: Later) -> Reviewed:
    """The review with what came since taught to its learner."""
    if known.learner is None or known.reader is None or not later.time:
        return known
    log = ForceHistory(max(len(later.rows), 1), later.rows.shape[1])
    log.add(later.rows)
    for time, corners in zip(later.time, later.corners, strict=True):
        logged = logged_at(log, known.reader, time, known.reader.stands_in(later.ahead))
        teach(known.learner, known.reader, time, corners, logged)
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
