"""The error of a force log as a process in time: a level, a random walk, an Ornstein-Uhlenbeck part, white noise, and
a part that comes with the load (`recording/force/load_stages.py`). That part has a time of its own, which advances only
while the load changes; `LoadStages` finds it from frames as they come.

Frames that are averaged into one key frame share one number per axis: the mean of the error over their times. Key
frames follow each other in time and do not overlap, so the covariances of these means have short closed forms.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.learning.model.force_error import ANEW, RELEASED
from onebend.recording.force.load_stages import BEFORE, CLEAR, EARLY, TURN, LoadChange
from onebend.records import Array, BoolArray

_LEAST = 1e-12  # of each variance: what rounding leaves of two that are the same


@dataclass(frozen=True)
class ForceProcess:
    """One sd of each part."""

    level: float  # N, constant
    walk: float  # N per root second
    coloured: float  # N, Ornstein-Uhlenbeck
    memory: float  # s, its correlation time
    white: float  # N, of every frame
    load: float = 0.0  # N, error that comes with the load: a constant of this sd, and as much that varies


@dataclass(frozen=True)
class TimeSpans:
    """K time spans, in order, that do not overlap."""

    begin: Array  # (K,) s, first frame
    end: Array  # (K,) s, last frame
    frames: Array  # (K,) how many
    slow: Array  # (K,) 1 where only the slow parts (level, walk, load) count, at `end`; else 0
    own: Array  # (K,) the load's own time

    def after(self, time: float, own: float) -> TimeSpans:
        """These spans after one of which only the slow parts count."""
        first = (time, time, 1.0, 1.0, own)
        every = zip(first, (self.begin, self.end, self.frames, self.slow, self.own), strict=True)
        return TimeSpans(*(np.concatenate([[value], values]) for value, values in every))

    @cached_property
    def centre(self) -> Array:
        """(K,) s since the first."""
        return np.asarray(0.5 * (self.begin + self.end) - self.begin[0])

    @cached_property
    def width(self) -> Array:
        """(K,) s."""
        return np.asarray(self.end - self.begin)

    @cached_property
    def fast(self) -> Array:
        """(K,) 1 where the fast parts (coloured, white) count."""
        return np.asarray(1.0 - self.slow)

    @cached_property
    def walked(self) -> Array:
        """(K, K) s: covariance of a walk of size one."""
        out = np.minimum(self.centre[:, None], self.centre)
        out.ravel()[:: len(out) + 1] -= self.width / 6.0
        return out

    @cached_property
    def gap(self) -> Array:
        """(K, K) s between the spans; infinite to those of which only the slow parts count."""
        out = np.maximum(self.begin[:, None], self.begin) - np.minimum(self.end[:, None], self.end)
        np.maximum(out, 0.0, out=out)
        if np.any(self.slow):
            apart = self.slow > 0.0
            out[apart], out[:, apart] = np.inf, np.inf
        return out

    @cached_property
    def stages(self) -> Array:
        """(K, K) covariance of what comes with the load, of size one."""
        return np.asarray(1.0 + np.exp(-np.abs(self.own[:, None] - self.own)))


def covariance(process: ForceProcess, spans: TimeSpans) -> Array:
    """(K, K) N^2 of the mean errors over the spans, for one axis."""
    share, own = _averaging(spans.width / process.memory)
    out = np.exp(spans.gap * (-1.0 / process.memory))
    out *= (process.coloured * share)[:, None] * (process.coloured * share)
    diagonal = out.ravel()[:: len(out) + 1]
    diagonal[:] = spans.fast * (process.coloured**2 * own + process.white**2 / spans.frames)
    out += process.walk**2 * spans.walked
    out += process.load**2 * spans.stages
    out += process.level**2
    diagonal *= 1.0 + _LEAST
    return np.asarray(out)


def with_one_more(process: ForceProcess, spans: TimeSpans, time: float, own: float) -> tuple[Array, float]:
    """N^2, covariance (K,) of a single frame at `time`, after all spans, with them, and its variance."""
    begin = float(spans.begin[0]) if len(spans.begin) else time
    slow = process.level**2 + process.load**2
    alone = slow + process.load**2 + process.walk**2 * (time - begin) + process.coloured**2 + process.white**2
    share, _ = _averaging(spans.width / process.memory)
    fast = process.coloured**2 * spans.fast * share
    out = process.walk**2 * spans.centre if len(spans.begin) else np.zeros(0)
    out = out + fast * np.exp((spans.end - time) / process.memory)
    return out + slow + process.load**2 * np.exp(-np.abs(own - spans.own)), float(alone)


def fast_variance(process: ForceProcess, width: float, frames: float) -> float:
    """N^2: variance of the fast parts' mean over one span."""
    _, own = _averaging(np.array([width / process.memory]))
    return float(process.coloured**2 * own[0] + process.white**2 / frames)


def slow_variance(process: ForceProcess, seconds: float, own: float) -> float:
    """N^2: variance of the slow parts' change after `seconds` and after `own` of the load's own time."""
    return float(process.walk**2 * max(seconds, 0.0) - 2.0 * process.load**2 * np.expm1(-abs(own)))


def _averaging(u: Array) -> tuple[Array, Array]:
    """Averages over u correlation times: factors of the covariance with other times, and of the variance."""
    wide = np.maximum(u, 1e-4)
    share = -np.expm1(-wide) / wide
    return np.where(u < 1e-4, 1.0, share), np.where(u < 1e-4, 1.0, 2.0 * (1.0 - share) / wide)


_FINE = 0.005  # of the largest displacement: smaller differences are not kept
_PATH_LENGTH = 256  # displacements of one stage
_CHANGES = 6  # the last ones, whose spans may still change
_USUAL = 0.1  # of the length: the largest displacement that is expected before the data


class LoadStages:
    """The load's own time, found from frames as they come; its memory is fixed.

    As `recording/force/load_stages.py` has it for a whole recording: a load begins, reverses where the beam comes back
    by more than a share of the largest displacement so far, and ends. A reversal is noticed late; then it counts for
    the frames before, too.
    """

    def __init__(self, length: float, tags: int) -> None:
        self.largest = _USUAL * length  # m, displacement so far
        self.displacement = 0.0  # m, of the last frame
        self._here = np.full((tags, 2), np.nan)  # m, where tags were seen last
        self._rest = np.full((tags, 2), np.nan)
        self._loaded = False
        self._rising, self._extreme, self._peak = True, 0.0, 0.0  # m, and when
        self._path: deque[tuple[float, float]] = deque(maxlen=_PATH_LENGTH)  # s, m
        self._changes: deque[tuple[float, LoadChange]] = deque()
        self._past: deque[tuple[float, LoadChange]] = deque()
        self._open: float | None = None  # m, displacement where the present change began; None: it is over

    def add_frame(self, time: float, xy: Array, visible: BoolArray, loaded: bool) -> None:
        """The next frame: tags at `xy` (m, 2) m where `visible`."""
        self._here[visible] = xy[visible]
        if not loaded:
            self._rest[visible] = xy[visible]
            if self._loaded:
                self._release()
            self._loaded, self.displacement = False, 0.0
            return
        unknown = np.isnan(self._rest)
        self._rest[unknown] = self._here[unknown]
        away = (self._here - self._rest).ravel()
        away = away[np.isfinite(away)]
        self.displacement = size = float(np.sqrt(2.0 * (away @ away) / max(len(away), 1)))
        self.largest = max(self.largest, size)
        if not self._loaded:
            self._loaded = self._rising = True
            self._extreme, self._peak, self._open = size, time, 0.0
            self._path.clear()
            self._add(ANEW, LoadChange(time - EARLY, time, release=False))
        elif self._open is not None:
            self._go_on(time, abs(size - self._open) > CLEAR * self.largest)
        if not self._path or abs(size - self._path[-1][1]) > _FINE * self.largest:
            self._path.append((time, size))
        if size >= self._extreme if self._rising else size <= self._extreme:
            self._extreme, self._peak = size, time
        elif abs(size - self._extreme) > TURN * self.largest:
            self._turn(time, size)

    @property
    def falling(self) -> bool:
        """The load has reversed since it began, and not again."""
        return not self._rising

    def _go_on(self, time: float, over: bool) -> None:
        """The present change lasts until now."""
        amount, change = self._changes[-1]
        self._changes[-1] = amount, LoadChange(change.begin, time, change.release)
        self._open = None if over else self._open

    def _turn(self, time: float, size: float) -> None:
        """The load has reversed; the change began where the beam was last clear of the turning point."""
        before = [t for t, d in self._path if t < self._peak and abs(d - self._extreme) > BEFORE * self.largest]
        low = before[-1] if before else (self._path[0][0] if self._path else self._peak)
        self._add(ANEW, LoadChange(min(low, self._peak), time, release=False))
        self._open = self._extreme
        self._rising, self._extreme, self._peak = not self._rising, size, time
        self._path = deque([point for point in self._path if point[0] >= low], maxlen=_PATH_LENGTH)

    def _release(self) -> None:
        clear = [t for t, d in self._path if d > CLEAR * self.largest]
        end = self._path[-1][0]
        self._add(RELEASED, LoadChange(clear[-1] if clear else end, end + EARLY, release=True))
        self._open = None

    def _add(self, amount: float, change: LoadChange) -> None:
        if len(self._changes) == _CHANGES:
            self._past.append(self._changes.popleft())
        self._changes.append((amount, change))

    def own(self, time: Array) -> Array:
        """(N,) own time at `time` (N,) [s] from the changes that may still change."""
        return _sum(self._changes, time)

    def forgotten(self, time: Array) -> tuple[Array, float]:
        """(N,) own time at `time` (N,) [s] from the changes settled since the last call, and of later frames."""
        out = _sum(self._past, time), float(sum(amount for amount, _ in self._past))
        self._past.clear()
        return out


def _sum(changes: Iterable[tuple[float, LoadChange]], time: Array) -> Array:
    out = np.zeros(len(time))
    for amount, change in changes:
        out += amount * change.fraction(time)
    return out
