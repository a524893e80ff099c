"""A film and a force log played as a camera and a sensor would give them, at their own pace or as fast as they can be
read, with what happens on the way."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from onebend.errors import RecordingError
from onebend.live.sources import Clock, End, Frame, Samples, StampTiming
from onebend.recording.entries import Recording, VideoEntry
from onebend.recording.folder import FILE_NAME, folder_of, read_recording
from onebend.recording.force_log import read_force_log
from onebend.recording.pairing import read_log
from onebend.recording.video import FilmFrame, Picture, read_frames
from onebend.records import Array, ForceLog

# A recorded push played as a camera and a sensor would give it: late, with gaps, out of order. Time is data: nothing
# waits.


@dataclass(frozen=True)
class Disturbances:
    """What happens to frames and samples on their way; all shares are of those that come."""

    frames_lost: float = 0.0
    frames_late: float = 0.0  # that come after the next ones
    frames_late_by: float = 0.1  # s
    frames_twice: float = 0.0
    frame_delay: float = 0.005  # s, from the exposure to where it is read
    frame_jitter: float = 0.0  # s, one sd of its stamp
    samples_lost: float = 0.0
    samples_late: float = 0.0
    samples_late_by: float = 0.05  # s
    samples_twice: float = 0.0
    samples_nan: float = 0.0
    sample_delay: float = 0.002  # s
    sample_jitter: float = 0.0  # s, one sd of its stamp
    samples_each: int = 10  # that come together

    def __post_init__(self) -> None:
        if self.samples_each < 1:
            raise RecordingError(f"at least one sample comes at a time, got samples_each = {self.samples_each}")


@dataclass(frozen=True)
class Arrival:
    """A picture, or samples of the force, as they come in."""

    at: float  # s, the camera's clock
    stamp: Array  # () or (n,) s, the own clock of what sends it
    picture: Picture | None = None
    rows: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) N, or with the place of the push (n, 3)
    number: int = -1  # of the picture in its film


def play(
    frames: Iterable[FilmFrame],
    log: ForceLog,
    offset: float,
    disturbances: Disturbances = Disturbances(),
    *,
    seed: int = 0,
) -> Iterator[Arrival]:
    """Frames and samples in the order in which they come in; the same `seed` gives the same order.

    `offset` [s] is what the log's clock is ahead of the film's. Only what is on its way is held at a time.
    """
    rng = np.random.default_rng(seed)
    coming: list[tuple[float, int, Arrival]] = []
    count = 0
    for begun, arrivals in _sent(frames, log, offset, disturbances, rng):
        while coming and coming[0][0] <= begun:
            yield heapq.heappop(coming)[2]
        for arrival in arrivals:
            heapq.heappush(coming, (arrival.at, count, arrival))
            count += 1
    while coming:
        yield heapq.heappop(coming)[2]


def _sent(
    frames: Iterable[FilmFrame], log: ForceLog, offset: float, how: Disturbances, rng: np.random.Generator
) -> Iterator[tuple[float, list[Arrival]]]:
    """When each frame or packet of samples is sent [s, the camera's clock], and how it comes in: not at all, or up to
    two times."""
    packets = iter(range(0, len(log.time), how.samples_each))
    packet = next(packets, None)
    for frame in frames:
        while packet is not None and log.time[_last(log, packet, how)] - offset <= frame.time:
            yield _samples(log, packet, offset, how, rng)
            packet = next(packets, None)
        late = how.frames_late_by * (rng.random() < how.frames_late)
        arrival = Arrival(
            at=frame.time + how.frame_delay + late,
            stamp=np.array(frame.time + how.frame_jitter * rng.normal()),
            picture=frame.luma,
            number=frame.index,
        )
        times = 0 if rng.random() < how.frames_lost else 1 + int(rng.random() < how.frames_twice)
        yield frame.time, [arrival] * times
    while packet is not None:
        yield _samples(log, packet, offset, how, rng)
        packet = next(packets, None)


def _samples(
    log: ForceLog, first: int, offset: float, how: Disturbances, rng: np.random.Generator
) -> tuple[float, list[Arrival]]:
    """When the rows from `first` on that go together are sent, and how they come in."""
    last = _last(log, first, how)
    packet = np.arange(first, last + 1)
    rows = log.force[packet] if log.push_s is None else np.column_stack([log.force[packet], log.push_s[packet]])
    rows, stamps = rows.copy(), log.time[packet] + how.sample_jitter * rng.normal(size=len(packet))
    rows[rng.random(len(packet)) < how.samples_nan] = np.nan
    kept = np.flatnonzero(rng.random(len(packet)) >= how.samples_lost)
    kept = np.concatenate([kept, kept[rng.random(len(kept)) < how.samples_twice]])
    sent = float(log.time[last] - offset)
    late = how.samples_late_by * (rng.random() < how.samples_late)
    arrival = Arrival(at=sent + how.sample_delay + late, stamp=stamps[kept], rows=rows[kept])
    return sent, [arrival] if len(kept) else []


def _last(log: ForceLog, first: int, how: Disturbances) -> int:
    return min(first + how.samples_each, len(log.time)) - 1


TIMING = StampTiming(delay_error=0.01)
LONGEST_WAIT = 3600.0  # s: no film goes on as long before its log begins
_NO_LOG = ForceLog(np.empty(0), np.empty((0, 2)))


@dataclass(frozen=True)
class OwnClock:
    """How a played source's stamps differ from the recorder's clock."""

    offset: float = 0.0  # s
    drift: float = 0.0  # of its second, as a share
    late: float = 0.0  # s, mean of what an item takes to come, beyond what all take; exponential


Item = TypeVar("Item", Frame, Samples)


class _Playing(Generic[Item]):
    """What is common to both: items with the times at which they come in."""

    def __init__(self, name: str, own: OwnClock, seed: int) -> None:
        self.name, self.timing = name, TIMING
        self._own, self._rng = own, np.random.default_rng([seed, 7])
        self._coming: Iterator[Arrival] = iter(())
        self._next: Arrival | None = None
        self._at = math.inf  # s, the recorder's clock
        self._clock: Clock | None = None
        self._fault = ""

    def _begin(self, clock: Clock, coming: Iterator[Arrival]) -> None:
        self._clock, self._coming, self._at = clock, coming, -math.inf
        self._advance()

    def due(self) -> float:
        return self._at if self._next is not None else math.inf

    def close(self) -> None:
        self._coming, self._next = iter(()), None

    def read(self, wait: float) -> Item | End | None:
        clock = self._clock
        if self._next is None or clock is None:
            return End(self._fault or f"{self.name} was played to its end", fault=bool(self._fault))
        if self._at > clock.now() + wait:
            clock.wait_until(clock.now() + wait)
            return None
        clock.wait_until(self._at)
        taken, at = self._next, max(self._at, clock.now())
        self._advance()
        return self._item(taken, self._own.offset + (1.0 + self._own.drift) * taken.stamp, at)

    def _item(self, arrival: Arrival, stamp: Array, at: float) -> Item:
        raise NotImplementedError

    def _advance(self) -> None:
        try:
            self._next = next(self._coming, None)
        except RecordingError as wrong:
            self._next, self._fault = None, str(wrong)
        if self._next is not None and self._clock is not None:
            late = float(self._rng.exponential(self._own.late)) if self._own.late > 0.0 else 0.0
            self._at = max(self._at, self._clock.origin + self._next.at + late)


class PlayedCamera(_Playing[Frame]):
    """A film as a camera."""

    def __init__(
        self,
        film: VideoEntry | Iterable[FilmFrame],
        disturbances: Disturbances = Disturbances(),
        *,
        own: OwnClock = OwnClock(),
        seed: int = 0,
        name: str = "the film",
    ) -> None:
        """`film`: a video, or its frames, whose times begin near 0 s."""
        super().__init__(name, own, seed)
        self.files = (film.file,) if isinstance(film, VideoEntry) else ()
        self._film, self._how, self._seed = film, disturbances, seed

    def open(self, clock: Clock) -> None:
        """Begin to play.

        Raises:
            RecordingError: the film cannot be read.
        """
        frames = iter(read_frames(self._film)) if isinstance(self._film, VideoEntry) else iter(self._film)
        first = next(frames, None)  # so that what is no film is told now
        frames = frames if first is None else chain([first], frames)
        self._begin(clock, play(frames, _NO_LOG, 0.0, self._how, seed=self._seed))

    def _item(self, arrival: Arrival, stamp: Array, at: float) -> Frame:
        assert arrival.picture is not None
        return Frame(arrival.picture, float(stamp), at, arrival.number)


class PlayedForce(_Playing[Samples]):
    """A force log as a sensor."""

    def __init__(
        self,
        log: ForceLog,
        start: float,
        disturbances: Disturbances = Disturbances(),
        *,
        columns: tuple[str, ...] = ("fx_N", "fy_N"),
        error: float = TIMING.delay_error,
        own: OwnClock = OwnClock(),
        seed: int = 0,
        name: str = "the force log",
        files: tuple[Path, ...] = (),
    ) -> None:
        """`start` [s]: the log's time when the film begins, to `error` [s]; what was logged before is left out;
        `files`: where the log was read from."""
        super().__init__(name, own, seed)
        self.timing = replace(TIMING, delay_error=error)
        self.columns, self.files = columns, files
        kept = log.time >= start
        place = None if log.push_s is None else log.push_s[kept]
        self._log = replace(log, time=log.time[kept] - start, force=log.force[kept], push_s=place)
        self._how, self._seed = disturbances, seed

    def open(self, clock: Clock) -> None:
        """Begin to play."""
        self._begin(clock, play((), self._log, 0.0, self._how, seed=self._seed + 1))

    def _item(self, arrival: Arrival, stamp: Array, at: float) -> Samples:
        return Samples(stamp, arrival.rows, at)


def played_camera(
    place: Path, disturbances: Disturbances = Disturbances(), *, own: OwnClock = OwnClock(), seed: int = 0
) -> PlayedCamera:
    """The film of a recording's folder, or a video file.

    Raises:
        RecordingError: there is no such film.
    """
    if (rec := _recording_at(place)) is not None:
        if rec.video is None:
            raise RecordingError(f"{place}: this recording has no film to play. Name one with [video].")
        entry = rec.video
    elif place.is_file():
        entry = VideoEntry(place)
    else:
        raise RecordingError(f"film:{place}: there is no such film or recording. Name a video file, or a folder.")
    return PlayedCamera(entry, disturbances, own=own, seed=seed, name=f"the film {place}")


def played_force(
    place: Path,
    disturbances: Disturbances = Disturbances(),
    *,
    start: float = math.nan,
    own: OwnClock = OwnClock(),
    seed: int = 0,
) -> PlayedForce:
    """The force log of a recording's folder, or a CSV file with the columns time_s, fx_N and fy_N.

    `start` [s]: the log's time when the film begins; NaN: as the recording says, else its first row.

    Raises:
        RecordingError: there is no such log, or it cannot be read.
    """
    rec, error = _recording_at(place), TIMING.delay_error
    if rec is not None:
        log, files = read_log(rec), () if rec.force is None else (rec.force.file,)
        if math.isnan(start):
            start, error = rec.start
    elif place.is_file():
        log, files = read_force_log(place, ("time_s", "fx_N", "fy_N")), (place,)
    else:
        raise RecordingError(f"log:{place}: there is no such log or recording. Name a CSV file, or a folder.")
    if log is None:
        raise RecordingError(f"{place}: this recording has no force log to play. Name one with [force].")
    if not math.isnan(start) and not np.any(log.time >= start):
        raise RecordingError(
            f"log:{place} ends at {log.time[-1]:.6g} s, before start_s = {start:.6g} s. Correct start_s, or leave it "
            "out."
        )
    if log.time[0] - start > LONGEST_WAIT:
        raise RecordingError(
            f"log:{place} begins at {log.time[0]:.6g} s, {log.time[0] - start:.3g} s after start_s = {start:.6g} s. "
            "Correct start_s, or leave it out."
        )
    start, error = (float(log.time[0]), 5.0) if math.isnan(start) else (start, error)
    columns = ("fx_N", "fy_N") if log.push_s is None else ("fx_N", "fy_N", "push_s")
    return PlayedForce(
        log, start, disturbances, columns=columns, error=error, own=own, seed=seed, name=f"the log {place}", files=files
    )


def _recording_at(place: Path) -> Recording | None:
    folder = folder_of(place)
    return read_recording(folder) if (folder / FILE_NAME).is_file() else None
