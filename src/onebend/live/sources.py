"""Cameras and force sensors as a recorder sees them: opened, read until they end, closed.

`read` returns after a given time, and an `End` with its reason for a fault of a cable or a robot. Only `open` raises.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from onebend.recording.force_log import STRONGEST
from onebend.recording.signals import LATEST, MAD_TO_SD
from onebend.recording.video import Picture
from onebend.records import Array

# A stamp x of a sensor arrives at y = a + b x + delay, and the delay is seldom below some least value: the line follows
# the lower edge of the points (Moon, Skelly, Towsley 1999). Each part of the recording gives one low quantile; the line
# is the median of those through two such points (Theil, Sen).

LEAST_SPAN = 4.0  # s of stamps: of a shorter stretch the pace is taken as stated
PARTS = 48  # of a recording, each with one point of its lower edge
LEAST_IN_PART = 8
LOW = 0.1  # quantile of the delays of a part
MOST_DRIFT = 1e-3  # of two clocks of quartz: ten times what is usual


class Clock(Protocol):
    """Time that only rises, s."""

    origin: float  # s, when a session began

    def now(self) -> float: ...

    def wait_until(self, moment: float) -> None: ...


@dataclass
class HostClock:
    """This machine's monotonic clock, that of the stamps of Linux's cameras."""

    origin: float = field(default_factory=time.monotonic)

    def now(self) -> float:
        return time.monotonic()

    def wait_until(self, moment: float) -> None:
        if (left := moment - time.monotonic()) > 0.0:
            time.sleep(left)


@dataclass
class PlayedClock:
    """A clock that stands until somebody waits: what is played then takes no time but that of the work."""

    origin: float = 0.0
    _now: float = -math.inf

    def now(self) -> float:
        return max(self._now, self.origin)

    def wait_until(self, moment: float) -> None:
        self._now = max(self._now, moment)


@dataclass(frozen=True)
class ClockLine:
    """Own stamps to this machine's clock: `begin + pace * (stamp - first)`, s."""

    first: float
    begin: float
    pace: float = 1.0
    sd: float = math.nan  # s, of the points of the lower edge about the line

    def host(self, stamp: ArrayLike) -> Array:
        """(n,) s on this machine's clock."""
        return np.asarray(self.begin + self.pace * (np.asarray(stamp, dtype=float) - self.first))

    def own(self, host: ArrayLike) -> Array:
        """(n,) s on the sensor's own clock."""
        return np.asarray(self.first + (np.asarray(host, dtype=float) - self.begin) / self.pace)


def clock_line(stamp: Array, arrival: Array, *, most_drift: float = MOST_DRIFT) -> ClockLine:
    """The line along the lower edge of stamps (n,) and arrivals (n,), s; those that are no numbers are left out.

    `most_drift`: by how much the sensor's second may differ from this machine's, as a share.
    """
    good = np.isfinite(stamp) & np.isfinite(arrival)
    x, y = stamp[good], arrival[good]
    if not len(x):
        return ClockLine(0.0, math.nan)
    first = float(x.min())
    x, lag = x - first, y - (x - first)
    span = float(x.max())
    parts = int(np.clip(len(x) // LEAST_IN_PART, 1, PARTS))
    if span <= 0.0:
        return ClockLine(first, float(np.quantile(lag, LOW)))
    part = np.minimum((x / span * parts).astype(int), parts - 1)
    slope, lags = 0.0, lag
    for _ in range(2):  # with a slope, what is low in a part depends on it
        points = [_low_point(x[part == i], lags[part == i]) for i in range(parts) if np.sum(part == i) >= 2]
        low = np.array(points).reshape(-1, 2)
        slope += _median_slope(low, most_drift) if span >= LEAST_SPAN else 0.0
        slope = float(np.clip(slope, -most_drift, most_drift))
        lags = lag - slope * x
    left = np.array([_low_point(x[part == i], lags[part == i])[1] for i in range(parts) if np.sum(part == i) >= 2])
    if not len(left):
        left = np.array([np.quantile(lags, LOW)])
    begin = float(np.median(left))
    return ClockLine(first, begin, 1.0 + slope, float(MAD_TO_SD * np.median(np.abs(left - begin))))


def _low_point(x: Array, lag: Array) -> tuple[float, float]:
    """Where the lower edge of a part is: the mean of its earliest arrivals."""
    near = lag <= np.quantile(lag, LOW)
    return float(x[near].mean()), float(lag[near].mean())


def _median_slope(points: Array, most: float) -> float:
    """Theil and Sen: the median of the slopes between all points (n, 2) that are a quarter of the span apart."""
    if len(points) < 2:
        return 0.0
    one, other = np.triu_indices(len(points), 1)
    away = points[other, 0] - points[one, 0]
    far = np.abs(away) >= 0.25 * np.ptp(points[:, 0])
    slopes = (points[other, 1] - points[one, 1])[far] / away[far]
    return float(np.clip(np.median(slopes), -most, most)) if len(slopes) else 0.0


@dataclass(frozen=True)
class StampTiming:
    """What is known of a sensor's stamps."""

    own: bool = True  # it has a clock of its own; False: what comes has the time at which it came
    host: bool = False  # its stamps are on this machine's monotonic clock already
    delay: float = 0.0  # s, from the measurement to the stamp, or to the earliest arrival where the clock is its own
    delay_error: float = 0.02  # s, the largest error of that
    most_drift: float = MOST_DRIFT  # by how much its second may differ from this machine's, as a share


class StampedClock:
    """The clock of one sensor, from its stamps and their arrivals so far; what is kept of them is bounded."""

    def __init__(self, timing: StampTiming, *, most: int = 20_000) -> None:
        self.timing = timing
        self._most = most
        self._points: list[tuple[float, float]] = []
        self._every, self._count, self._due = 1, 0, 0
        self._line = ClockLine(0.0, math.nan)

    def add(self, stamp: float, arrival: float) -> None:
        """A stamp and when it came in, s."""
        if self.timing.host or not self.timing.own:
            return
        if self._count % self._every == 0 and math.isfinite(stamp) and math.isfinite(arrival):
            self._points.append((stamp, arrival))
        self._count += 1
        if len(self._points) > self._most:
            self._points, self._every, self._due = self._points[::2], 2 * self._every, 0

    @property
    def line(self) -> ClockLine:
        """The line through what came so far, made again when there is a tenth more."""
        if (used := len(self._points)) >= self._due:
            points = np.array(self._points).reshape(-1, 2)
            self._line = clock_line(points[:, 0], points[:, 1], most_drift=self.timing.most_drift)
            self._due = used + max(used // 10, 1)
        return self._line

    def renew(self) -> None:
        self._due = 0

    def own(self, stamp: ArrayLike, arrival: ArrayLike) -> Array:
        """(n,) s on the sensor's clock: its stamps, or where it has none the arrivals."""
        stamps = np.asarray(stamp, dtype=float)
        return np.where(np.isfinite(stamps) & self.timing.own, stamps, np.asarray(arrival, dtype=float))

    def host(self, stamp: ArrayLike, arrival: ArrayLike) -> Array:
        """(n,) s on this machine's clock, of the measurement itself."""
        own = self.own(stamp, arrival)
        if self.timing.host or not self.timing.own:
            return np.asarray(own - self.timing.delay)
        line = self.line
        known = self.line.host(own) if math.isfinite(line.begin) else np.full(own.shape, np.nan)
        missing = ~np.isfinite(np.asarray(stamp, dtype=float)) | ~np.isfinite(known)
        return np.asarray(np.where(missing, np.asarray(arrival, dtype=float), known) - self.timing.delay)

    def from_host(self, host: ArrayLike) -> Array:
        """(n,) s on the sensor's clock of moments on this machine's."""
        later = np.asarray(host, dtype=float) + self.timing.delay
        if self.timing.host or not self.timing.own or not math.isfinite(self.line.begin):
            return later
        return self.line.own(later)


@dataclass(frozen=True)
class Frame:
    """One picture of a camera."""

    picture: Picture  # (H, W), luma
    stamp: float  # s, the camera's own clock; NaN where it gives none
    arrival: float  # s, this machine's monotonic clock
    number: int = -1  # as the camera counts; -1: it does not
    colour: Any = None  # the same as `av.VideoFrame`, where there is more than luma


@dataclass(frozen=True)
class Samples:
    """Some rows of a force sensor."""

    stamp: Array  # (n,) s, the sensor's own clock; NaN where it gives none
    force: Array  # (n, c) N and N m, as `ForceSource.columns` says
    arrival: float  # s, this machine's monotonic clock
    lost: int = 0  # rows that are known to be missing before these


def measurable(samples: Samples) -> Samples:
    """The rows that a log may hold: one with a force or a stamp beyond all measures counts as lost, and so does one
    with an infinite force."""
    good = ~(np.abs(samples.force) > STRONGEST).any(axis=1) & ~(np.abs(samples.stamp) > LATEST)
    if good.all():
        return samples
    lost = samples.lost + int(np.sum(~good))
    return replace(samples, stamp=samples.stamp[good], force=samples.force[good], lost=lost)


@dataclass(frozen=True)
class End:
    """No more will come."""

    why: str  # a sentence
    fault: bool = False  # a cable, a full buffer: rather than the end of what is played


class Device:
    """A camera or a sensor on a cable: its name, the recorder's clock, and when it was heard last."""

    def __init__(self, name: str, timing: StampTiming) -> None:
        self.name, self.timing = name, timing
        self._clock: Clock = HostClock()
        self._heard = 0.0

    def _begin(self, clock: Clock) -> None:
        self._clock, self._heard = clock, clock.now()

    def _fault(self, why: str) -> End:
        return End(f"{self.name} {why}", fault=True)

    def _silence(self, longest: float, why: str) -> End | None:
        """The end, where nothing was heard for longer than that [s]."""
        return self._fault(why) if self._clock.now() - self._heard > longest else None


class AnySource(Protocol):
    """A camera or a force sensor."""

    name: str  # for messages
    timing: StampTiming

    def open(self, clock: Clock) -> None: ...

    def close(self) -> None: ...


class CameraSource(AnySource, Protocol):
    """A camera."""

    def read(self, wait: float) -> Frame | End | None:
        """The next picture; None where none came within `wait` [s]."""
        ...


class ForceSource(AnySource, Protocol):
    """A force sensor."""

    columns: tuple[str, ...]  # of the log, with units: fx_N, fy_N and so on

    def read(self, wait: float) -> Samples | End | None:
        """The next rows; None where none came within `wait` [s]."""
        ...


def files_of(*sources: CameraSource | ForceSource | None) -> tuple[Path, ...]:
    """The files that these sources read (their `files`, where they have any; of a folder, all in it), which no
    recording may replace."""
    named = [Path(path) for source in sources for path in getattr(source, "files", ())]
    return tuple(file for path in named for file in (path, *(path.iterdir() if path.is_dir() else ())))


@runtime_checkable
class Played(Protocol):
    """A source that is played knows when its next item comes."""

    def due(self) -> float:
        """s, on the clock that it was opened with; infinite at its end."""
        ...
