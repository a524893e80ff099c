"""When a load begins, reverses and ends, from the tags: a sensor's error may change then.

Robots that estimate forces from joint torques have friction in the joints: the error of the estimate is nearly constant
while the load grows or falls, and changes when the load begins, reverses or ends. These times are read from the tags,
as the log itself contains the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.recording.signals import bridged, runs
from onebend.records import Array, BoolArray

TURN = 0.05  # of the largest displacement: a beam that comes back by less has not reversed
CLEAR = 0.1  # of the largest displacement: by then a load has begun, or has turned
BEFORE = 0.03  # of the same: within this of a turning point the load may be reversing
EARLY = 0.1  # s, by which contact may begin before the tags show it


@dataclass(frozen=True)
class LoadChange:
    """A span of time in which the load begins, reverses or ends."""

    begin: float  # s
    end: float  # s
    release: bool  # it ends

    def fraction(self, time: Array) -> Array:
        """(N,) 0 before it, 1 after it, evenly between."""
        return np.clip((time - self.begin) / max(self.end - self.begin, 1e-9), 0.0, 1.0)


def load_changes(time: Array, size: Array, loaded: BoolArray) -> list[LoadChange]:
    """Changes of the load in order, from the tags' displacement (T,) at `time` (T,) [s] and contact (T,)."""
    largest = float(np.max(size, initial=0.0))
    changes: list[LoadChange] = []
    for first, last in runs(loaded) if largest > 0.0 else ():
        part, when = size[first:last], time[first:last]
        moved = np.flatnonzero(part > CLEAR * largest)
        if not len(moved):
            continue
        turns = turning_points(part, TURN * largest)
        changes.append(LoadChange(float(when[0]) - EARLY, float(when[moved[0]]), release=False))
        ends = [0, *turns, len(part) - 1]
        for before, turn, after in zip(ends, ends[1:], ends[2:], strict=False):
            from_turn = np.abs(part - part[turn])
            earlier, later = (
                from_turn[before : turn + 1][::-1] > BEFORE * largest,
                from_turn[turn : after + 1] > CLEAR * largest,
            )
            low = turn - int(np.argmax(earlier))
            high = turn + int(np.argmax(later)) if later.any() else after
            changes.append(LoadChange(float(when[low]), float(when[high]), release=False))
        if last < len(time):
            changes.append(LoadChange(float(when[moved[-1]]), float(when[-1]) + EARLY, release=True))
    return changes


def turning_points(size: Array, margin: float) -> list[int]:
    """Indices at which `size` (T,) stops growing or falling, and then goes back by more than `margin`."""
    turns: list[int] = []
    rising, extreme = True, 0
    for i, now in enumerate(size):
        if (now >= size[extreme]) if rising else (now <= size[extreme]):
            extreme = i
        elif abs(now - size[extreme]) > margin:
            turns.append(extreme)
            rising, extreme = not rising, i
    return turns


def displacement(time: Array, xy: Array, rest: Array) -> Array:
    """(T,) m, root mean square way of tags (T, m, 2) from where they rest (m, 2); from the first frame where that is
    not known."""
    filled = bridged(time, xy.reshape(len(time), -1))
    start = np.where(np.isfinite(rest).ravel(), rest.ravel(), filled[0])
    return np.asarray(np.sqrt(np.mean((filled - start) ** 2, axis=1)))
