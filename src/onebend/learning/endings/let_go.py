"""When contacts end, by how far the beam is bent along its slowest mode.

Where it swings then, it was let go, and what it does afterwards is no contact; else the bending goes to zero.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.endings.edge import RUN, ContactFrames
from onebend.learning.endings.mode import ModeBending
from onebend.learning.endings.release import release
from onebend.learning.endings.straight import straight
from onebend.learning.endings.swing import CLEAR, HalfSwings, find_swing
from onebend.records import Array

_REST = 8  # frames before the first contact that tell how the beam is at rest
_SLIGHT = 2.0  # times what a swing is clear from: so little is left of it
_SOON = 2.0  # half swings after the last clear one in which what is left is of it


def ended(seen: ModeBending, runs: list[tuple[int, int]], widened: float) -> list[ContactFrames]:
    """The contacts of `runs` (first and last frame) without those that are a swing, with the ends that the bending
    tells; `seen` is of all frames, `widened` how much wider the variance of its noise counts, as it lasts."""
    if not runs:
        return []
    value, noise = _from_rest(seen, runs[0][0])
    out: list[ContactFrames] = []
    for first, last in runs:
        if out and first <= out[-1].moves:
            continue
        out.append(_contact(seen.time, value, noise, (first, last), runs))
    after = [*(one.first for one in out[1:]), len(value)]
    lasting = float(np.sqrt(widened)) * noise
    return [_straight(seen.time, value, lasting, one, last) for one, last in zip(out, after, strict=True)]


def _straight(time: Array, value: Array, noise: float, one: ContactFrames, after: int) -> ContactFrames:
    """With the end where the bending goes to zero before frame `after`, where no swing tells it."""
    if one.end is not None:
        return one
    known = np.flatnonzero(np.isfinite(value[:after]))
    first, last = (int(np.searchsorted(known, i)) for i in (one.first, one.last))
    return replace(one, end=straight(time[known], value[known], noise, first, last))


def _from_rest(seen: ModeBending, first: int) -> tuple[Array, float]:
    """The bending (T,) less that before frame `first`, and the sd of its noise."""
    before = seen.value[:first][np.isfinite(seen.value[:first])]
    noise = float(np.nanmedian(seen.sd))
    if len(before) < _REST:
        return seen.value, noise
    return seen.value - float(np.mean(before)), max(noise, float(np.std(before, ddof=1)))


def _contact(
    time: Array, value: Array, noise: float, run: tuple[int, int], runs: list[tuple[int, int]]
) -> ContactFrames:
    """Where a swing tells the end of `run`, by that; else as it is."""
    first, last = run
    usual = ContactFrames(first, last, last)
    known = np.flatnonzero(np.isfinite(value))
    times, values = time[known], value[known]
    begin, end = int(np.searchsorted(known, first)), int(np.searchsorted(known, last))
    swing = find_swing(times, values, noise, begin, end)
    if swing is None or end - begin < RUN:
        return usual
    moves = _until(time, value, noise, int(known[swing.last]), swing, runs)
    if moves < last:
        return usual
    told = release(times, values, noise, swing, begin)
    let = -1 if told is None else int(np.searchsorted(time, told.time)) - 1
    return usual if let < first else ContactFrames(first, let, moves, told)


def _until(time: Array, value: Array, noise: float, last: int, swing: HalfSwings, runs: list[tuple[int, int]]) -> int:
    """Last frame of the runs that are what is left of the swing after its last clear frame."""
    for first, end in runs:
        soon = first <= last or time[first] - time[last] < _SOON * swing.half
        rest = np.nan_to_num(value[max(last + 1, first) : end + 1])
        if end > last and soon and np.max(np.abs(rest)) < _SLIGHT * CLEAR * noise:
            last = end
    return last
