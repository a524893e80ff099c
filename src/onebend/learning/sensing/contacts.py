"""When contacts begin and end."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from onebend.learning.sensing.endings import RUN, ContactFrames, Edge, scanned
from onebend.learning.sensing.forces import FrameForces, noise_root
from onebend.records import Array, BoolArray, IntArray

# The force is zero until `t0`, and then `j + v t + a t^2 / 2 + c t^3 / 3 + w(t)`, with w white noise integrated twice.
# For given sizes of the five the evidence of each `t0` has a closed form; it is summed over sizes. An end is a
# beginning with time reversed, where the bending does not show it (`endings`).

_BEFORE, _AFTER = 48, 24  # frames that tell when it begins
_LATER = 5  # frames that show a force, and still may be from before
_PLACES = (48, 48)  # times that are tried, and again where it is likely
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the end
# Of a jump, of what begins with the first, second and third power of time, and of w. A robot's hand that begins as
# smoothly as it can (least jerk) begins with the third.
_SIZES = (*product((0.0, 1.0), (0.0, 1.0), (2.0,), (0.0,), _LAST), *product((0.0,), (0.0,), (0.0,), (3.0,), _LAST))


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


def within(runs: list[tuple[int, int]], count: int) -> BoolArray:
    """(count,) whether a frame is of a contact."""
    inside: BoolArray = np.zeros(count, dtype=np.bool_)
    for first, last in runs:
        inside[first : last + 1] = True
    return inside


def frames_at_edges(runs: list[tuple[int, int]], count: int) -> IntArray:
    """Those of `count` frames that tell when contacts begin and end."""
    some: list[int] = []
    for first, last in runs:
        some += range(max(first - _BEFORE, 0), min(first + _AFTER, count))
        some += range(max(last - _AFTER + 1, 0), min(last + _BEFORE + 1, count))
    return np.unique(np.array(some, dtype=np.int64))


def edges_of(
    readings: FrameForces, frames: IntArray, contacts: list[ContactFrames], count: int, prior_sd: float
) -> list[tuple[Edge, Edge]]:
    """Beginning and end of each contact; `readings` are of `frames` out of `count`."""
    out = []
    for i, one in enumerate(contacts):
        first, last = one.first, one.last
        before = contacts[i - 1].moves if i else -1
        after = contacts[i + 1].first if i + 1 < len(contacts) else count
        middle = (first + last + 1) // 2
        early, late = max(before + 1, first - _BEFORE), min(max(middle, first + RUN), first + _AFTER)
        begin = _begin(readings.take(np.flatnonzero((frames >= early) & (frames < late))), first - early, prior_sd)
        if one.end is not None:
            out.append((begin, one.end))
            continue
        early, late = max(middle, last - _AFTER + 1), min(after, last + _BEFORE + 1)
        back = readings.take(np.flatnonzero((frames >= min(early, last - RUN + 1)) & (frames < late))[::-1])
        end = _begin(replace(back, time=-back.time), late - 1 - last, prior_sd)
        out.append((begin, Edge(-end.time, end.sd)))
    return out


def _begin(readings: FrameForces, first: int, prior_sd: float) -> Edge:
    """When the force begins that the frames from `first` on show."""
    time = readings.time
    if first == 0 or len(time) < RUN + 1:
        return Edge(float("nan"), float("inf"))
    low, high = float(time[0]), float(time[min(first + _LATER, len(time) - 1)])
    mean, sd, _ = scanned(lambda at: _evidence_of_edges(readings, at, first, prior_sd), low, high, _PLACES)
    return Edge(mean, sd)


def _evidence_of_edges(readings: FrameForces, at: Array, first: int, prior_sd: float) -> Array:
    """(n,) log, of beginnings `at` (n,) [s], but for a constant."""
    tells = np.any(readings.weigh != 0.0, axis=-1)  # (W, 2)
    weigh, told, common = readings.weigh[tells], readings.told[tells], readings.common[tells]
    since = np.maximum(np.repeat(readings.time[:, None], 2, axis=1)[tells] - at[:, None], 0.0)  # (n, R)
    long = max(float(readings.time[-1] - readings.time[first]), 1e-9)
    size = _size(readings, first, prior_sd)
    on = (since > 0.0).astype(float)
    less = np.minimum(since[:, :, None], since[:, None]) / long
    more = np.maximum(since[:, :, None], since[:, None]) / long
    kinds = [on[:, :, None] * on[:, None]]
    kinds += [(since[:, :, None] * since[:, None] / long**2) ** n / n**2 for n in (1, 2, 3)]
    kinds.append(1.5 * less**2 * (more - less / 3.0))  # of variance one at the end
    alike = size**2 * (weigh @ weigh.T)
    rows = []
    for sizes in _SIZES:
        load = alike * sum(one**2 * kind for one, kind in zip(sizes, kinds, strict=True) if one > 0.0)
        root = noise_root(common @ common.T + load)
        left = np.linalg.solve(root, np.broadcast_to(told[:, None], (len(at), len(told), 1)))[..., 0]
        rows.append(-0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nrr->nr", root)), axis=1))
    every = np.stack(rows)
    best = np.max(every)
    return np.asarray(best + np.log(np.maximum(np.mean(np.exp(every - best), axis=0), 1e-300)))


def _size(readings: FrameForces, first: int, prior_sd: float) -> float:
    """N, of the forces that the frames from `first` on show."""
    normal = np.swapaxes(readings.weigh, 1, 2) @ readings.weigh + np.eye(2) / prior_sd**2
    right = np.einsum("fdc,fd->fc", readings.weigh, readings.told)
    force = np.linalg.solve(normal, right[..., None])[..., 0]
    return max(float(np.max(np.hypot(*force[first:].T))), 1e-9 * prior_sd)
