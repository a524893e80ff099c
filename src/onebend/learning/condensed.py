"""The frames that the fit uses: neighbouring frames of a push, averaged in windows, EACH_PUSH windows of each push.

More windows hardly narrow the band, because neighbouring frames share their errors. They only cost time.

A window spans at most STEP of the largest displacement, TURN of the force's direction, and SECONDS. No window crosses a
gap, an instant where the load begins, reverses or ends, or one where a tag is lost or found again: the mean of the
frames that show a tag is not its pose under the mean force of all.

The mean of poses is not the pose under the mean force: both bend in time. Half the second derivative times the variance
of the window's instants is subtracted, so that both are values at the mean instant. The derivative comes from the means
of neighbouring windows.

The noise of the tags is partly white and partly slow: only the white part averages down. Third differences of a film
estimate the white part.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from onebend.learning.allowances import tag_accelerations
from onebend.learning.frames import learnable_frames, push_places, usable_frames
from onebend.recording.force_noise import TURN as REVERSAL, displacement, turning_points
from onebend.recording.signals import bridged, runs
from onebend.records import Array, BoolArray, FrameMeans, IntArray, Observations, tags_among

STEP = 0.02  # of the largest displacement
TURN = 0.05  # rad, of the force
SECONDS = 0.2
GAP = 0.05  # s: over a shorter one a tag moves straight on
EACH_PUSH = 60  # windows of one push, there and back (benchmarks/notes/one_recording.md)
_FIRM = 0.2  # of the largest force: the direction of a smaller one is noise
_THIRD = 20.0  # variance of the third difference of white noise of variance one


def condensed(o: Observations) -> Observations:
    """The film with its learnable frames averaged in windows; all else is unchanged."""
    if o.static or o.known_loads is not None or (o.held is not None and np.any(o.held)):
        return o
    learnable = learnable_frames(o)
    if np.sum(learnable) <= EACH_PUSH:
        return o
    parts = windows_of(o, learnable)
    bent = usable_frames(o) & ~learnable  # their force is distorted, but they show when the load ends
    return averaged(replace(o, force=np.where(bent[:, None], np.nan, o.force)), parts)


def worth(o: Observations) -> int:
    """How many frames of a recording the fit uses at most: all of static poses, EACH_PUSH of each push of a film."""
    if o.static:
        return len(o.time)
    size, loaded = displacement(o.time, o.xy, o.rest_xy), usable_frames(o)
    turns = turning_points(size[loaded], REVERSAL * float(np.max(size[loaded], initial=0.0)))
    return EACH_PUSH * max((len(turns) + 1) // 2, 1)


def windows_of(o: Observations, learnable: BoolArray) -> list[list[IntArray]]:
    """The frames of each window, in order, by the parts of the push; `learnable` (T,)."""
    size, most = displacement(o.time, o.xy, o.rest_xy), worth(o)
    parts = [(frames, _window_spans(o, frames, size)) for frames in _parts(o, learnable, size)]
    coarser, windows = 1.0, [_split(*part) for part in parts]
    while sum(map(len, windows)) > max(most, len(parts)):
        coarser *= 1.05
        windows = [_split(frames, along / coarser) for frames, along in parts]
    seen = np.isfinite(bridged(o.time, o.xy[:, tags_among(o)].reshape(len(o.time), -1), GAP))
    sight = np.append(0, np.cumsum(np.any(np.diff(seen, axis=0), axis=1)))  # another number, other tags are seen
    out = list[list[IntArray]]()
    for part in windows:
        pieces = [one for window in part for one in np.split(window, np.flatnonzero(np.diff(sight[window])) + 1)]
        out += [list(alike) for _, alike in groupby(pieces, key=lambda one: int(sight[one[0]]))]
    return out


def _parts(o: Observations, learnable: BoolArray, size: Array) -> list[IntArray]:
    """Runs of learnable frames, split where the load turns (`size` (T,)) or moves, or gravity changes."""
    place = push_places(o)
    cuts = np.zeros(len(o.time), dtype=bool)  # before this frame
    cuts[1:] |= (np.diff(place) != 0.0) | np.any(np.diff(o.gravity, axis=0) != 0.0, axis=1) | np.diff(o.loaded)
    largest = float(np.max(size[learnable], initial=0.0))
    out = []
    for first, last in runs(learnable):
        for turn in turning_points(size[first:last], REVERSAL * largest):
            cuts[first + turn] = True
        here = np.arange(first, last)
        out += [part for part in np.split(here, np.flatnonzero(cuts[first + 1 : last]) + 1) if len(part)]
    return out


def _window_spans(o: Observations, frames: IntArray, size: Array) -> Array:
    """(n,) progress along a run of frames, in units of the largest span of a window."""
    largest, force = max(float(np.max(size, initial=0.0)), 1e-300), np.linalg.norm(o.force, axis=1)
    firm = force[frames] > _FIRM * float(np.nanmax(force, initial=0.0))
    direction = np.unwrap(np.arctan2(o.force[frames, 1], o.force[frames, 0])[firm])
    turned = np.zeros(len(frames))
    if np.any(firm):
        turned[firm] = np.abs(direction - direction[0])
    terms = np.abs(size[frames] - size[frames[0]]) / (STEP * largest), turned / TURN
    time = (o.time[frames] - o.time[frames[0]]) / SECONDS
    return np.asarray(time + sum(np.maximum.accumulate(term) for term in terms))


def _split(frames: IntArray, along: Array) -> list[IntArray]:
    """Windows of about equal span of the progress `along` (n,)."""
    count = max(int(np.ceil(along[-1])), 1)
    number = np.minimum((count * along / max(along[-1], 1e-300)).astype(int), count - 1)
    return np.split(frames, np.flatnonzero(np.diff(number)) + 1)


def averaged(o: Observations, parts: list[list[IntArray]]) -> Observations:
    """The observations with the mean of each window's frames, which are neighbours; all others as they are. Windows of
    one part follow each other without a kink."""
    first, part = np.ones(len(o.time), dtype=bool), -1 - np.arange(len(o.time))
    for number, windows in enumerate(parts):
        for window in windows:
            first[window[1:]] = False
            part[window] = number
    starts = np.flatnonzero(first)
    part = part[starts]
    count = np.diff(np.append(starts, len(first)))

    def total(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, starts, axis=0))

    def mean(values: Array) -> Array:
        return total(values) / count.reshape(-1, *[1] * (values.ndim - 1))

    poses, time = np.concatenate([o.xy, o.angle[..., None]], axis=-1), mean(o.time)
    variance = mean((o.time - np.repeat(time, count)) ** 2)  # s^2, of the instants in each window

    def at_mean_instant(values: Array) -> Array:
        means = mean(values)
        bent = second_differences(time, means.reshape(len(means), -1), part).reshape(means.shape)
        return np.asarray(means - 0.5 * bent * variance.reshape(-1, *[1] * (means.ndim - 1)))

    filled = bridged(o.time, poses.reshape(len(poses), -1)).reshape(poses.shape)
    seen = mean(np.isfinite(poses).astype(float))
    pose = np.where(seen > 0.0, at_mean_instant(filled), np.nan)
    known = np.all(np.isfinite(o.covariance), axis=(-1, -2))
    frames = total(known.astype(float))[..., None, None]  # in which each tag was seen
    of_all = total(np.where(known[..., None, None], o.covariance, 0.0))
    usual = np.divide(of_all, frames, out=np.full_like(of_all, np.nan), where=frames > 0.0)
    middle = starts + count // 2
    acceleration = tag_accelerations(o)
    return replace(
        o,
        time=time,
        frame=o.frame[middle],
        xy=pose[..., :2],
        angle=pose[..., 2],
        covariance=usual * mean_variance(white_share(o, poses)[:, None, None], frames),
        force=at_mean_instant(o.force),
        push_s=o.push_s[middle],
        loaded=o.loaded[middle],
        gravity=mean(o.gravity),
        held=None if o.held is None else o.held[middle],
        by_camera=None if o.by_camera is None else mean(o.by_camera),
        means=FrameMeans(count, None if acceleration is None else mean(acceleration)),
    )


def second_differences(time: Array, values: Array, part: IntArray) -> Array:
    """(N, n) second derivatives of values (N, n) at `time` (N,) from neighbours of the same `part` (N,); at the ends of
    a part as beside it, zero in parts of fewer than three."""
    out = np.zeros_like(values)
    inner = np.flatnonzero((part[2:] == part[1:-1]) & (part[:-2] == part[1:-1])) + 1
    slopes = np.diff(values, axis=0) / np.diff(time)[:, None]
    out[inner] = 2.0 * (slopes[inner] - slopes[inner - 1]) / (time[inner + 1] - time[inner - 1])[:, None]
    for step in (1, -1):
        ends = np.setdiff1d(inner + step, inner)
        out[ends] = out[ends - step]
    return out


def mean_variance(white: Array, frames: Array) -> Array:
    """Variance of a mean of `frames` (...) over that of one, whose share `white` (...) is white noise."""
    return np.asarray(1.0 - white + white / np.maximum(frames, 1.0))


def white_share(o: Observations, poses: Array) -> Array:
    """(m,) share of each tag's stated variance that is white, at most 1, from third differences of poses (T, m, 3); 1
    of an outline's points, whose variance is stated as if it were."""
    third = np.diff(poses, n=3, axis=0)
    stated = np.diagonal(o.covariance, axis1=2, axis2=3)[: len(third)]
    usable = np.isfinite(third) & np.isfinite(stated) & (stated > 0.0)
    ratio = np.where(usable, np.abs(third) / np.sqrt(np.where(usable, stated, 1.0) * _THIRD), np.nan)
    flat = np.moveaxis(ratio, 1, 0).reshape(ratio.shape[1], -1)
    size = np.array([np.median(one[np.isfinite(one)]) / 0.6745 if np.isfinite(one).any() else 1.0 for one in flat])
    return np.where(tags_among(o), np.minimum(size**2, 1.0), 1.0)
