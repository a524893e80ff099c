"""A film and a force log played as a camera and a sensor would give them, at their own pace or as fast as they can be
read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from onebend.errors import RecordingError
from onebend.live.sources import Clock, End, Frame, Samples, StampTiming
from onebend.recording import entries, force, force_log, video
from onebend.recording.folder import FILE_NAME, folder_of, read_recording
from onebend.records import ForceLog

TIMING = StampTiming(delay_error=0.01)
LONGEST_WAIT = 3600.0  # s: no film goes on as long before its log begins
FRAME_DELAY, SAMPLE_DELAY = 0.005, 0.002  # s, from the exposure or the measurement to where it is read
TOGETHER = 10  # samples that come together

Item = TypeVar("Item", Frame, Samples)


class Playing(Generic[Item]):
    """What is common to both: items that come in one after the other."""

    def __init__(self, name: str) -> None:
        self.name, self.timing = name, TIMING
        self._coming: Iterator[Item] = iter(())
        self._next: Item | None = None
        self._at = -math.inf  # s, the recorder's clock, when that comes in
        self._clock: Clock | None = None
        self._fault = ""

    def items(self) -> Iterator[Item]:
        """What comes in, in order; its arrival counts from the beginning of the session.

        Raises:
            RecordingError: it cannot be read.
        """
        raise NotImplementedError

    def open(self, clock: Clock) -> None:
        """Begin to play.

        Raises:
            RecordingError: as `items`.
        """
        self._clock, self._coming, self._at = clock, self.items(), -math.inf
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
        taken = replace(self._next, arrival=max(self._at, clock.now()))
        self._advance()
        return taken

    def _advance(self) -> None:
        try:
            self._next = next(self._coming, None)
        except RecordingError as wrong:
            self._next, self._fault = None, str(wrong)
        if self._next is not None and self._clock is not None:
            self._at = max(self._at, self._clock.origin + self._next.arrival)


class PlayedCamera(Playing[Frame]):
    """A film as a camera."""

    def __init__(self, film: entries.VideoEntry | Iterable[video.FilmFrame], *, name: str = "the film") -> None:
        """`film`: a video, or its frames, whose times begin near 0 s."""
        super().__init__(name)
        self.files = (film.file,) if isinstance(film, entries.VideoEntry) else ()
        self.film = film

    def items(self) -> Iterator[Frame]:
        frames = iter(video.read_frames(self.film) if isinstance(self.film, entries.VideoEntry) else self.film)
        first = next(frames, None)  # so that what is no film is told now
        shown = frames if first is None else chain([first], frames)
        return (Frame(one.luma, one.time, one.time + FRAME_DELAY, one.index, one.colour) for one in shown)


class PlayedForce(Playing[Samples]):
    """A force log as a sensor."""

    def __init__(
        self,
        log: ForceLog,
        start: float,
        *,
        columns: tuple[str, ...] = ("fx_N", "fy_N"),
        error: float = TIMING.delay_error,
        name: str = "the force log",
        files: tuple[Path, ...] = (),
    ) -> None:
        """`start` [s]: the log's time when the film begins, to `error` [s]; what was logged before is left out;
        `files`: where the log was read from."""
        super().__init__(name)
        self.timing = replace(TIMING, delay_error=error)
        self.columns, self.files = columns, files
        late = log.rows(log.time >= start)
        self.log = replace(late, time=late.time - start)

    def items(self) -> Iterator[Samples]:
        log = self.log
        rows = log.force if log.push_s is None else np.column_stack([log.force, log.push_s])
        for first in range(0, len(rows), TOGETHER):
            time = log.time[first : first + TOGETHER]
            yield Samples(time, rows[first : first + TOGETHER], float(time[-1]) + SAMPLE_DELAY)


def played_camera(place: Path) -> PlayedCamera:
    """The film of a recording's folder, or a video file.

    Raises:
        RecordingError: there is no such film.
    """
    if (rec := _recording_at(place)) is not None:
        if rec.video is None:
            raise RecordingError(f"{place}: this recording has no film to play. Name one with [video].")
        entry = rec.video
    elif place.is_file():
        entry = entries.VideoEntry(place)
    else:
        raise RecordingError(f"film:{place}: there is no such film or recording. Name a video file, or a folder.")
    return PlayedCamera(entry, name=f"the film {place}")


def played_force(place: Path, *, start: float = math.nan) -> PlayedForce:
    """The force log of a recording's folder, or a CSV file with the columns time_s, fx_N and fy_N.

    `start` [s]: the log's time when the film begins; NaN: as the recording says, else its first row.

    Raises:
        RecordingError: there is no such log, or it cannot be read.
    """
    rec, error = _recording_at(place), TIMING.delay_error
    if rec is not None:
        log, files = force.read_log(rec), () if rec.force is None else (rec.force.file,)
        if math.isnan(start):
            start, error = rec.start
    elif place.is_file():
        log, files = force_log.read_force_log(place, ("time_s", "fx_N", "fy_N")), (place,)
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
    return PlayedForce(log, start, columns=columns, error=error, name=f"the log {place}", files=files)


def _recording_at(place: Path) -> entries.Recording | None:
    folder = folder_of(place)
    return read_recording(folder) if (folder / FILE_NAME).is_file() else None
