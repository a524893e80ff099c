"""The part of a force log's error that comes with the load: nearly constant while the load grows or falls, redrawn
where it begins and where it reverses.

Friction in the joints of a robot that estimates forces does that. The error is written as a stationary process of one
sd in a time of its own, which runs where the load begins, reverses and ends, and hardly elsewhere: covariance
`exp(-|change of that time|)`. When that happens is read from the tags, for the log shows its error too.
"""

from __future__ import annotations

import numpy as np

from onebend.recording.signals import bridged
from onebend.records import Array, Observations

TURN = 0.05  # of the largest displacement: a beam that comes back by less has not reversed
_BEGIN, _BACK = 0.1, 0.1  # of the largest displacement: by then a load has begun, or has clearly turned
_NEAR = 0.97  # of a turning point's displacement: before that the load has not turned
_ANEW, _RELEASED, _SLOWLY = 2.0, 0.5, 0.02  # how far the process' time runs at a change, at a release, in a stage
_EARLY = 0.1  # s, of a contact that the tags do not show yet


def own_time(observations: Observations, time: Array) -> Array:
    """(N,) of the error's own time at `time` (N,) [s]; it stands still in rests."""
    o = observations
    places, rates = [float(o.time[0]) - 1.0], []
    out = np.zeros(len(time))
    for low, high, run in changes(o):
        out += run * np.clip((time - low) / max(high - low, 1e-9), 0.0, 1.0)
    del places, rates
    return np.asarray(out)


def changes(observations: Observations) -> list[tuple[float, float, float]]:
    """Stretches of time (begin, end) [s] and how far the error's own time runs in each, evenly."""
    o = observations
    size = displacement(o)
    largest = float(np.max(size, initial=0.0))
    out: list[tuple[float, float, float]] = []
    if largest == 0.0:
        return out
    for first, last in _contacts(o.loaded):
        part, when = size[first:last], o.time[first:last]
        turns = turning_points(part, TURN * largest)
        ends = [0, *turns, len(part) - 1]
        begun = int(np.argmax(part > _BEGIN * largest))
        out.append((float(when[0]) - _EARLY, float(when[begun]), _ANEW))
        for before, at, after in zip(ends, ends[1:], ends[2:], strict=False):
            span = np.abs(part - part[at])
            margin = 1.0 - _NEAR
            low = at - int(np.argmax(span[before : at + 1][::-1] > margin * largest))
            gone = span[at : after + 1] > _BACK * largest
            high = at + (int(np.argmax(gone)) if gone.any() else after - at)
            out.append((float(when[low]), float(when[high]), _ANEW))
        if last < len(o.time):
            held = np.flatnonzero(part > _BEGIN * largest)
            out.append((float(when[held[-1]]) if len(held) else float(when[0]), float(when[-1]) + _EARLY, _RELEASED))
        out.append((float(when[0]), float(when[-1]), _SLOWLY * max(len(ends) - 1, 1)))
    return out


def turning_points(size: Array, margin: float) -> list[int]:
    """Indices where `size` (T,) stops to grow or to fall and then goes back by more than `margin`."""
    out: list[int] = []
    rising, extreme = True, 0
    for i, now in enumerate(size):
        if (now >= size[extreme]) if rising else (now <= size[extreme]):
            extreme = i
        elif abs(now - size[extreme]) > margin:
            out.append(extreme)
            rising, extreme = not rising, i
    return out


def displacement(observations: Observations) -> Array:
    """(T,) m, root mean square way of the tags from where they rest."""
    o = observations
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, o.xy[0])
    away = bridged(o.time, (o.xy - rest).reshape(len(o.time), -1))
    return np.asarray(np.sqrt(np.mean(away**2, axis=1)))


def _contacts(loaded: Array) -> list[tuple[int, int]]:
    edges = np.diff(np.concatenate([[0], loaded.astype(np.int64), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))
