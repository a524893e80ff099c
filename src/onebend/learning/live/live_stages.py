"""The own time of a force error that comes with the load, while the load is still changing.

As `recording/force/load_stages.py` finds it in a whole recording, from frames as they come: a load begins, reverses
where the beam comes back by more than a share of the largest displacement so far, and ends. What is found out late (a
turning point is known when the beam has come back) counts for the frames before too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from onebend.learning.model.force_error import ANEW, RELEASED
from onebend.recording.force.load_stages import BEFORE, CLEAR, EARLY, TURN, LoadChange
from onebend.records import Array, BoolArray

_FINE = 0.005  # of the scale: displacements that differ by less are one
_KEPT = 256  # displacements of one stage
_CHANGES = 6  # the last ones, whose stretch of time is still looked at
_USUAL = 0.1  # of the length: a push is expected to move the tags by so much


class LoadStages:
    """Where the own time stands; its size is fixed."""

    def __init__(self, length: float, tags: int) -> None:
        self._largest = _USUAL * length  # m
        self._here = np.full((tags, 2), np.nan)  # m, where tags were seen last
        self._rest = np.full((tags, 2), np.nan)
        self._loaded = False
        self._rising, self._extreme, self._peak = True, 0.0, 0.0  # m, and when
        self._path: deque[tuple[float, float]] = deque(maxlen=_KEPT)  # s, m
        self._changes: deque[tuple[float, LoadChange]] = deque()
        self._past: deque[tuple[float, LoadChange]] = deque()
        self._open: float | None = None  # m, displacement that a change has begun from and is not over

    def see(self, time: float, xy: Array, seen: BoolArray, loaded: bool) -> None:
        """The next frame: tags (m, 2) m where `seen`."""
        self._here[seen] = xy[seen]
        if not loaded:
            self._rest[seen] = xy[seen]
            if self._loaded:
                self._release()
            self._loaded = False
            return
        unknown = np.isnan(self._rest)
        self._rest[unknown] = self._here[unknown]
        away = (self._here - self._rest).ravel()
        away = away[np.isfinite(away)]
        size = float(np.sqrt(2.0 * (away @ away) / max(len(away), 1)))
        self._largest = max(self._largest, size)
        if not self._loaded:
            self._loaded = self._rising = True
            self._extreme, self._peak, self._open = size, time, 0.0
            self._path.clear()
            self._add(ANEW, LoadChange(time - EARLY, time, release=False))
        elif self._open is not None:
            self._go_on(time, abs(size - self._open) > CLEAR * self._largest)
        if not self._path or abs(size - self._path[-1][1]) > _FINE * self._largest:
            self._path.append((time, size))
        if size >= self._extreme if self._rising else size <= self._extreme:
            self._extreme, self._peak = size, time
        elif abs(size - self._extreme) > TURN * self._largest:
            self._turn(time, size)

    def _go_on(self, time: float, over: bool) -> None:
        """The change that is on lasts to now."""
        amount, change = self._changes[-1]
        self._changes[-1] = amount, LoadChange(change.begin, time, change.release)
        self._open = None if over else self._open

    def _turn(self, time: float, size: float) -> None:
        """The load has reversed: from where it was last clear of the turning point."""
        before = [t for t, d in self._path if t < self._peak and abs(d - self._extreme) > BEFORE * self._largest]
        low = before[-1] if before else (self._path[0][0] if self._path else self._peak)
        self._add(ANEW, LoadChange(min(low, self._peak), time, release=False))
        self._open = self._extreme
        self._rising, self._extreme, self._peak = not self._rising, size, time
        self._path = deque([one for one in self._path if one[0] >= low], maxlen=_KEPT)

    def _release(self) -> None:
        clear = [t for t, d in self._path if d > CLEAR * self._largest]
        end = self._path[-1][0]
        self._add(RELEASED, LoadChange(clear[-1] if clear else end, end + EARLY, release=True))
        self._open = None

    def _add(self, amount: float, change: LoadChange) -> None:
        if len(self._changes) == _CHANGES:
            self._past.append(self._changes.popleft())
        self._changes.append((amount, change))

    def own(self, time: Array) -> Array:
        """(N,) what the changes that are still looked at add to the own time at `time` (N,) [s]."""
        return _sum(self._changes, time)

    def forgotten(self, time: Array) -> tuple[Array, float]:
        """(N,) what changes that are not looked at any more add at `time` (N,) [s], and to all later frames; once."""
        out = _sum(self._past, time), float(sum(amount for amount, _ in self._past))
        self._past.clear()
        return out


def _sum(changes: Iterable[tuple[float, LoadChange]], time: Array) -> Array:
    out = np.zeros(len(time))
    for amount, change in changes:
        out += amount * change.fraction(time)
    return out
