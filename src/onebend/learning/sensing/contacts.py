"""When contacts begin and end, by how far the beam is from rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from onebend.learning.swing import half_swings, roughness
from onebend.recording.signals import nan_median
from onebend.records import Array, BoolArray

RUN = 3  # frames in a row that show a force, before it is a contact; fewer without one do not end it


@dataclass(frozen=True)
class Edge:
    """When a contact begins or ends: mean and sd [s]; NaN and infinity where the frames do not show it."""

    time: float
    sd: float


UNKNOWN = Edge(float("nan"), float("inf"))


@dataclass(frozen=True)
class ContactFrames:
    """Frames of a contact."""

    first: int
    last: int
    moves: int  # last frame in which the beam is not at rest again
    begin: Edge = UNKNOWN
    end: Edge = UNKNOWN


def runs_of(touched: BoolArray) -> list[tuple[int, int]]:
    """First and last frame of each contact."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touched, [False]]).astype(int)))
    runs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    joined: list[tuple[int, int]] = []
    for first, last in runs:
        if joined and first - joined[-1][1] <= RUN:
            joined[-1] = joined[-1][0], last
        else:
            joined.append((first, last))
    return [(a, b) for a, b in joined if np.sum(touched[a : b + 1]) >= RUN]


@dataclass(frozen=True)
class Excursion:
    """How far the beam is from rest in T frames, as the tag that moves most shows it."""

    time: Array  # (T,) s
    value: Array  # (T,) m, in the direction of the largest distance; NaN where the tag was not seen
    noise: float  # m, at least as `roughness` has it


def excursion_of(time: Array, xy: Array, first: int) -> Excursion:
    """Of tags at `xy` (T, m, 2), the beam at rest before frame `first`."""
    seen = np.isfinite(xy[..., 0])
    xy = xy[:, seen.sum(axis=0) >= max(_OFTEN * np.max(seen.sum(axis=0)), 1)]
    away = xy - nan_median(xy[: max(first, 1)])
    far = np.nan_to_num(np.linalg.norm(away, axis=2))
    frame, tag = np.unravel_index(int(np.argmax(far)), far.shape)
    value = away[:, tag] @ away[frame, tag] / max(float(far[frame, tag]), 1e-12)
    noise = roughness(value[np.isfinite(value)]) if np.isfinite(value).sum() > RUN else 0.0
    slow = float(np.nanstd(value[:first])) if np.isfinite(value[:first]).sum() > _REST_FRAMES else 0.0
    return Excursion(time, value, max(noise, slow, 1e-12))


def contacts_of(seen: Excursion, runs: list[tuple[int, int]]) -> list[ContactFrames]:
    """The contacts of `runs` (first and last frame), with their edges and without the swings that follow."""
    out: list[ContactFrames] = []
    for first, last in runs:
        if out and first <= out[-1].moves:
            continue
        begin = _begin(seen, out[-1].moves + 1 if out else 0, first, (first + last + 1) // 2)
        out.append(replace(_let_go(seen, first, last, runs), begin=begin))
    afters = [*(one.first for one in out[1:]), len(seen.time)]
    return [
        one if np.isfinite(one.end.sd) else replace(one, end=_end(seen, one, after))
        for one, after in zip(out, afters, strict=True)
    ]


# A beam that was let go swings, and the swing looks like a force. The force ended within the half swing before the
# first passage through rest, or so little after it that the swing hides the end of its fall. A hand that leads the beam
# back with the least jerk has `10 u^3` of the force left at the share `u` of the fall before its end.

_PASSAGES = 3  # after the largest bending, of which one begins the swing: a hand may lead the beam through rest before
_HALF_SWINGS = 2  # that are a swing
_DIES = 0.9  # of the first half swing, that the last one is smaller than: a hand moves a beam to and fro for longer
_OFTEN = 0.7  # of the frames that the tag seen most often has: a tag seen less does not show a swing
_HELD = 0.9  # of the largest bending: where it was so large for the last time, the fall began
_LEAST_JERK = 10.0
_LARGER = 1.2  # times the last half swing: what follows is of the swing, of which there are few frames
_SOON = 2.0  # half swings after the last clear one, in which the rest of the swing may show


def _let_go(seen: Excursion, first: int, last: int, runs: list[tuple[int, int]]) -> ContactFrames:
    time, size = seen.time, np.nan_to_num(np.abs(seen.value))
    usual, peak = ContactFrames(first, last, last), first + int(np.argmax(size[first : last + 1]))
    later = np.flatnonzero(np.isfinite(seen.value) & (np.arange(len(time)) >= peak))
    swing = half_swings(time[later], seen.value[later], seen.noise, fewest=_HALF_SWINGS, starts=_PASSAGES)
    if swing is None or swing.left > _DIES:
        return usual
    moves = int(np.searchsorted(time, swing.end)) - 1
    for begin, end in runs:
        soon = end > moves and time[begin] < time[moves] + _SOON * swing.half
        if soon and np.max(size[moves : end + 1]) <= _LARGER * swing.left * swing.size:
            moves = end
    falls = swing.passage - float(time[(size > _HELD * size[peak]) & (time < swing.passage)][-1])
    tail = falls * np.cbrt(swing.size / size[peak] / _LEAST_JERK)
    let_go = Edge(swing.passage - 0.5 * (swing.half - tail), (swing.half + tail) / np.sqrt(12.0))
    held = int(np.searchsorted(time, let_go.time)) - 1
    return usual if moves < last or held < first else ContactFrames(first, held, moves, end=let_go)


# The bending is that at rest until `t0`, and then `j + v t + a t^2 / 2 + w(t)`, w white noise integrated twice, or
# `c t^3 / 3 + w(t)`, integrated four times. For given sizes of these the evidence of each `t0` has a closed form; it is
# averaged over sizes. An end without a swing is a beginning with time reversed.

_BEFORE, _AFTER = 48, 24  # frames that tell when it begins
_LATER = 5  # frames that show a force, and still may be from before
_PLACES = (48, 48, 48)  # times that are tried, and again where it is likely
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the end
# Of a jump, of what begins with the first, second and third power of time, and of both w. A robot's hand that begins as
# smoothly as it can (least jerk) begins with the third.
_SIZES = (
    *product((0.0, 1.0), (0.0, 1.0), (2.0,), (0.0,), _LAST, (0.0,)),
    *product((0.0,), (0.0,), (0.0,), (3.0,), (0.0,), _LAST[:-1]),
)
_LIKELY = 12.0  # of the log evidence below the best: farther down it is not
_REST_FRAMES = 8  # before the first contact, that tell how much the beam moves at rest
_REST_SDS = 3.0  # sds of the noise, by which rest after the contact may differ from that before
_FINEST = 1e-3  # of the largest bending: what the steps of w leave out


def _end(seen: Excursion, one: ContactFrames, after: int) -> Edge:
    middle = len(seen.time) - (one.first + one.last + 1) // 2
    back = Excursion(-seen.time[::-1], seen.value[::-1], seen.noise)
    found = _begin(back, len(seen.time) - after, len(seen.time) - 1 - one.last, middle)
    return Edge(-found.time, found.sd)


def _begin(seen: Excursion, early: int, first: int, late: int) -> Edge:
    """When the force begins that the frames from `first` on show, by the frames from `early` to `late`."""
    rows = np.arange(max(early, first - _BEFORE), min(max(late, first + RUN), first + _AFTER, len(seen.time)))
    rows = rows[np.isfinite(seen.value[rows])]
    before, after = rows[rows < first], rows[rows >= first]
    if not len(before) or len(after) < RUN:
        return UNKNOWN
    low, high = float(seen.time[before[0]]), float(seen.time[after[min(_LATER, len(after) - 1)]])
    value = seen.value[rows] / max(seen.noise, _FINEST * float(np.max(np.abs(seen.value[rows]))))
    for count in _PLACES:
        at = np.linspace(low, high, count)
        of = _evidence(seen.time[rows], value, at, float(seen.time[first]))
        likely, step = at[of > np.max(of) - _LIKELY], at[1] - at[0]
        low, high = max(low, float(likely[0] - step)), min(high, float(likely[-1] + step))
    weight = np.exp(of - np.max(of))
    mean = float(weight @ at / np.sum(weight))
    return Edge(mean, float(np.sqrt(weight @ (at - mean) ** 2 / np.sum(weight) + step**2 / 12.0)))


def _evidence(time: Array, value: Array, at: Array, first: float) -> Array:
    """(n,) log, of beginnings `at` (n,) [s], but for a constant; `value` (F,) over its noise, of a force at `first`."""
    since, long = np.maximum(time - at[:, None], 0.0), max(float(time[-1]) - first, 1e-9)
    less = np.minimum(since[:, :, None], since[:, None]) / long
    more = np.maximum(since[:, :, None], since[:, None]) / long
    kinds = [(since[:, :, None] * since[:, None] > 0.0).astype(float)]
    kinds += [(since[:, :, None] * since[:, None] / long**2) ** n / n**2 for n in (1, 2, 3)]
    apart = more - less
    kinds.append(less**2 * (less + 1.5 * apart))  # both of variance one at the end
    kinds.append(less**4 * (less**3 + 3.5 * apart * less**2 + 4.2 * apart**2 * less + 1.75 * apart**3))
    noise, largest, rows = np.eye(len(time)) + _REST_SDS**2, float(np.max(value**2)), []
    for sizes in _SIZES:
        load = sum(one**2 * kind for one, kind in zip(sizes, kinds, strict=True) if one > 0.0)
        root = np.linalg.cholesky(noise + largest * load)
        left = np.linalg.solve(root, np.broadcast_to(value[:, None], (len(at), len(value), 1)))[..., 0]
        rows.append(-0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nrr->nr", root)), axis=1))
    best = np.max(rows)
    return np.asarray(best + np.log(np.maximum(np.mean(np.exp(np.stack(rows) - best), axis=0), 1e-300)))
