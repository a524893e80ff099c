"""Where a contact is followed by half swings to either side, alike in time and none larger than the one before."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onebend.records import Array

CLEAR = 5.0  # sds of the noise above which a half swing is one
_UNEVEN = (0.6, 1.6)  # of the first: how long the next ones last
_GROWS = 1.1  # times the one before, at most
_FORCED = 2  # half swings that may be before the end of the contact
_ALONE = 10.0  # times as large as need be: a half swing that is followed by none


@dataclass(frozen=True)
class HalfSwings:
    """Half swings after a push."""

    passage: float  # s, where the first begins
    half: float  # s, how long one lasts
    last: int  # frame up to which they are clear


class _Lobe(NamedTuple):
    """Frames on one side."""

    sign: int
    first: int
    last: int
    size: float
    peak: int


def find_swing(time: Array, value: Array, noise: float, first: int, last: int) -> HalfSwings | None:
    """After the push that is largest between frames `first` and `last`; None: nothing swings. `value` (T,) is zero at
    rest, with an sd of `noise`."""
    least = CLEAR * noise
    lobes = _lobes(value, least)
    inside = [i for i, lobe in enumerate(lobes) if lobe.last >= first and lobe.first <= last]
    if not inside:
        return None
    lobes = lobes[max(inside, key=lambda i: lobes[i].size) :]
    passages = [_passage(time, value, a, b) for a, b in pairwise(lobes)]
    lasts = np.diff(passages)
    for i in range(min(_FORCED + 1, len(passages) - 1)):
        count = _alike(lobes[i + 1 :], lasts[i:], least)
        if lobes[i + 1].size > _GROWS * lobes[0].size + least:
            return None
        if count > 1:
            last = lobes[i + count].last
            if i + count + 2 == len(lobes):  # how long the very last one lasts is not seen
                more = _alike(lobes[i + count :], np.full(2, lasts[i]), least) > 1
                last = lobes[-1].last if more and time[lobes[-1].last] - passages[-1] < _UNEVEN[1] * lasts[i] else last
            return _checked(time, lobes[i], lobes[i + 1], HalfSwings(passages[i], float(lasts[i]), last))
    if len(lobes) != 2 or lobes[1].size < _ALONE * least:
        return None
    half = 2.0 * max(float(time[lobes[1].peak]) - passages[0], 0.5 * float(np.median(np.diff(time))))
    return _checked(time, lobes[0], lobes[1], HalfSwings(passages[0], half, lobes[1].last))


def _checked(time: Array, before: _Lobe, after: _Lobe, found: HalfSwings) -> HalfSwings | None:
    """None where the beam came to rest between the two."""
    return found if time[after.first] - time[before.last] <= found.half else None


def _alike(lobes: list[_Lobe], lasts: Array, least: float) -> int:
    """How many half swings there are in a row, from the first of `lobes` on."""
    count = 1
    while count < min(len(lasts), len(lobes)):
        uneven = not _UNEVEN[0] < lasts[count] / lasts[0] < _UNEVEN[1]
        if uneven or lobes[count].size > _GROWS * lobes[count - 1].size + least:
            break
        count += 1
    return count


def _lobes(value: Array, least: float) -> list[_Lobe]:
    """Stretches on one side, from the first frame beyond `least` to the last one."""
    signs = np.where(value > least, 1, np.where(value < -least, -1, 0))
    spans: list[tuple[int, int, int]] = []
    for i in np.flatnonzero(signs):
        if spans and spans[-1][0] == signs[i]:
            spans[-1] = spans[-1][0], spans[-1][1], int(i)
        else:
            spans.append((int(signs[i]), int(i), int(i)))
    out = []
    for sign, a, b in spans:
        size = np.abs(value[a : b + 1])
        out.append(_Lobe(sign, a, b, float(np.max(size)), a + int(np.argmax(size))))
    return out


def _passage(time: Array, value: Array, before: _Lobe, after: _Lobe) -> float:
    """s, of the passage through rest between two."""
    i, j = before.last, after.first
    return float(time[i] + (time[j] - time[i]) * value[i] / (value[i] - value[j]))
