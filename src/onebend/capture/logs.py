"""The stamps of frames and the rows of the force while they come, on the film's clock: 0 s at its first frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from onebend.capture.clocks import StampedClock, StampTiming
from onebend.capture.folder import STAMP_COLUMNS, GrowingTable, RecordingPlaces, retimed
from onebend.capture.sources import Frame, Samples
from onebend.records import Array

ADDED = ("own_s", "arrival_s")  # columns of the log behind the forces: the sensor's own stamps, and when rows came
_TIME, _VALUE = "%.6f", "%.7g"
_LATE_ROW = 1e-6  # s behind the row before, of one that came late; the whole log is put in order at the end
_GAP = 1.6  # intervals: a longer way from stamp to stamp lacks frames


@dataclass
class Drops:
    """Frames that the camera took and that did not come, by its count, or else by its stamps."""

    lost: int = 0
    _number: int = -1
    _stamp: float = math.nan
    _intervals: list[float] = field(default_factory=list)

    def see(self, number: int, stamp: float) -> None:
        """One more frame, later than those before."""
        step = stamp - self._stamp
        if self._number >= 0 and number > self._number:
            self.lost += number - self._number - 1
        elif number < 0 and step > 0.0:
            usual = float(np.median(self._intervals)) if len(self._intervals) >= 5 else math.inf
            self.lost += round(step / usual) - 1 if step > _GAP * usual else 0
        if step > 0.0:
            self._intervals = [*self._intervals[-50:], step]
        self._number, self._stamp = number, stamp


class Logs:
    """Both clocks, and the two tables on disk."""

    def __init__(self, camera: StampTiming, force: StampTiming | None, columns: tuple[str, ...]) -> None:
        """Nothing has come, and nothing is on disk. `columns` of the force."""
        self._camera, self._columns = StampedClock(camera), columns
        self._force = None if force is None else StampedClock(force)
        self._first = math.nan  # s, the camera's clock, of the first frame
        self._last_frame = self._last_row = -math.inf  # s, the film's clock
        self._kept: list[Array] = []  # (n, 2) own stamps and arrivals of the rows, in the order of the file
        self._stamps: GrowingTable | None = None
        self._rows: GrowingTable | None = None
        self._drops = Drops()
        self.lost_samples = 0

    @property
    def drops(self) -> int:
        """Frames that are not in the film: one that came too late left a gap, too."""
        return self._drops.lost

    @property
    def samples(self) -> int:
        """Rows of the force log."""
        return 0 if self._rows is None else self._rows.rows

    @property
    def bytes(self) -> int:
        """In the files."""
        return sum(table.size for table in (self._stamps, self._rows) if table is not None)

    @property
    def clock_sd(self) -> float:
        """s, of the lines that bring the force's stamps to the camera's clock; NaN before there are any."""
        clocks = [one for one in (self._camera, self._force) if one is not None]
        sds = [one.line.sd for one in clocks if one.timing.own and not one.timing.host]
        return math.hypot(*sds) if sds else 0.0

    @property
    def error(self) -> float:
        """s, the largest error of what is known of both clocks beforehand."""
        force = 0.0 if self._force is None else self._force.timing.delay_error
        return self._camera.timing.delay_error + force

    def see(self, item: Frame | Samples) -> None:
        """What a stamp and its arrival say of the clocks."""
        if isinstance(item, Frame):
            self._camera.add(item.stamp, item.arrival)
        elif self._force is not None and np.isfinite(item.stamp).any():
            self._force.add(np.nanmax(item.stamp), item.arrival)  # rows that come together waited for the newest

    def begin(self, places: RecordingPlaces, first: Frame) -> None:
        """Make the files of a film that begins with `first`. Raises `OSError` where they cannot be."""
        self._first = float(self._camera.own(first.stamp, first.arrival))
        self._stamps = GrowingTable(places.stamps, STAMP_COLUMNS)
        if places.log is not None:
            self._rows = GrowingTable(places.log, ("time_s", *self._columns, *ADDED))

    def frame(self, frame: Frame) -> float | None:
        """The time of a frame in the film, s; None where it came after a newer one."""
        own = float(self._camera.own(frame.stamp, frame.arrival))
        time = own - self._first
        if not time > self._last_frame:
            return None
        self._drops.see(frame.number, own)
        self._last_frame = time
        if self._stamps is not None:
            row = np.array([[time, frame.number, frame.stamp, frame.arrival]])
            self._stamps.add(row, (_TIME, "%d", _TIME, _TIME))
        return time

    def rows(self, samples: Samples) -> Array:
        """(n,) s, the film's clock, of rows of the force, as well as it is known by now; and put them into the log."""
        assert self._force is not None
        arrival = np.full(len(samples.stamp), samples.arrival)
        time = self._on_film(self._force.host(samples.stamp, arrival))
        self.lost_samples += samples.lost
        if self._rows is not None and len(time):
            steps = _LATE_ROW * np.arange(len(time))
            written = np.maximum.accumulate(np.maximum(time - steps, self._last_row + _LATE_ROW)) + steps
            self._last_row = float(written[-1])
            self._rows.add(
                np.column_stack([written, samples.force, samples.stamp, arrival]),
                (_TIME, *(_VALUE for _ in self._columns), _TIME, _TIME),
            )
            self._kept.append(np.column_stack([samples.stamp, arrival]))
        return time

    def flush(self) -> None:
        """Put what waits into the files. Raises `OSError`."""
        for table in (self._stamps, self._rows):
            if table is not None:
                table.flush()

    def finish(self) -> None:
        """Close the files, and write the log anew with what all stamps together say of the clocks.

        Raises:
            OSError: what is in the files by then stays.
        """
        tables = [table for table in (self._stamps, self._rows) if table is not None]
        try:
            for table in tables:
                table.close()
        finally:
            rows, self._stamps, kept = self._rows, None, self._kept
        if rows is None or self._force is None or not kept:
            return
        self._camera.renew()
        self._force.renew()
        own, arrival = np.concatenate(kept).T
        retimed(rows.path, self._on_film(self._force.host(own, arrival)))

    def _on_film(self, host: Array) -> Array:
        return np.asarray(self._camera.from_host(host) - self._first)
