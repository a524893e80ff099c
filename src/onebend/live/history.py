"""The tags and the force log of a stream so far, in order of time, of bounded size.

A full store goes on at half the rate: every other frame is dropped, and two rows of the log become their mean.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.errors import ObservationError
from onebend.live.body import BodyFrame, OutlineSighting, PointReader, SeenOutline, point_reader
from onebend.live.replayed import LiveFrame
from onebend.recording import camera, entries, signals, tags
from onebend.recording.force import to_beam
from onebend.records import Array, BoolArray, Observations, View, read_before_fit

_MOST_SIGHTINGS = 1000  # of unexpected and of doubled tags


class FrameHistory:
    """The tags of the frames so far. `time` is that of `TrackedFrame`."""

    def __init__(self, most: int, spared: Container[float] = ()) -> None:
        """An empty store of at most `most` frames. Those with a time in `spared`, of which there are far fewer, stay
        where every other one goes."""
        self._most, self._spared, self._every, self._skipped = most, spared, 1, 0
        self._frames: list[tags.TrackedFrame] = []
        self._looks = 0
        self._strangers: deque[int] = deque(maxlen=_MOST_SIGHTINGS)
        self._doubles: deque[tuple[int, int]] = deque(maxlen=_MOST_SIGHTINGS)
        self._shifts: dict[tuple[int, float], Array] = {}  # (4, 2) px, by tag and by when it came where it stands
        self.count = 0  # of all frames so far

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: tags.TrackedFrame) -> None:
        """Put a frame in its place in time."""
        self._looks += frame.looked
        self._strangers.extend(frame.strangers)
        self._doubles.extend((self.count, tag) for tag in frame.doubles)
        self.count += 1
        for i in np.flatnonzero(np.isfinite(frame.still_since)).tolist():
            self._shifts[i, float(frame.still_since[i])] = frame.corners[i] - frame.detected[i]
        if self._frames and frame.time < self._frames[-1].time:
            self._frames.insert(bisect_left(self._frames, frame.time, key=lambda one: one.time), frame)
        elif self._skipped + 1 >= self._every or frame.time in self._spared:
            self._frames.append(frame)
            self._skipped = 0
        else:
            self._skipped += 1
        if len(self._frames) > self._most:
            self._frames = [one for i, one in enumerate(self._frames) if i % 2 == 0 or one.time in self._spared]
            self._every *= 2
            kept = {(i, since) for one in self._frames for i, since in enumerate(one.still_since.tolist())}
            self._shifts = {key: shift for key, shift in self._shifts.items() if key in kept}

    @property
    def frames(self) -> tuple[tags.TrackedFrame, ...]:
        """Those that are kept."""
        return tuple(self._frames)

    def tracks(self) -> tags.BlockTracks:
        """The frames kept. A tag at rest is corrected in all its frames by what the last of them say."""
        frames = self._frames
        return tags.BlockTracks(
            time=np.array([one.time for one in frames]),
            corners=self._corrected(),
            searched=np.ones(len(frames), dtype=bool),
            shape=frames[0].shape,
            looks=self._looks,
            strangers=tuple(self._strangers),
            doubles=tuple(self._doubles),
        )

    def _corrected(self) -> Array:
        """(T, m, 4, 2) px."""
        corners = np.stack([one.detected for one in self._frames])
        since = np.stack([one.still_since for one in self._frames])
        for (i, begun), shift in self._shifts.items():
            if shift.any():
                corners[since[:, i] == begun, i] += shift
        return corners


class ForceHistory:
    """The rows of the force log so far: time [s, its own clock], the two forces [N], and the place of the push where it
    is given."""

    def __init__(self, most: int, columns: int = 3) -> None:
        """An empty store of at most `most` rows, of 3 columns or of 4."""
        self._most, self._every, self._columns = most, 1, columns
        self._rows = np.empty((1024, columns))
        self._used = 0
        self._waiting: list[Array] = []  # rows that become one
        self.count, self.late, self.refused = 0, 0, 0  # rows so far; not in order of time; without a time

    def __len__(self) -> int:
        return self._used

    @property
    def rows(self) -> Array:
        """(N, c), in order of time. Do not write into it: copy it before more rows come."""
        return self._rows[: self._used]

    @property
    def newest(self) -> float:
        """s: up to when there are rows; minus infinity where there is none."""
        return float(self._rows[self._used - 1, 0]) if self._used else -math.inf

    def add(self, rows: Array) -> None:
        """Put rows (n, c) in their places. A row with a time that is none is left out; NaN forces are a gap."""
        good = np.isfinite(rows[:, 0]) & (np.abs(rows[:, 0]) < signals.LATEST)
        self.count += len(rows)
        self.refused += len(rows) - int(np.sum(good))
        rows = rows[good]
        late = rows[:, 0] <= self.newest
        self.late += int(np.sum(late))
        self._append(rows[~late][np.argsort(rows[~late, 0], kind="stable")])
        if late.any():
            self._insert(rows[late])

    def mean_near(self, time: float, half: float, longest_gap: float) -> Array:
        """(c - 1,) mean of the rows within `half` [s] of `time`, else of the nearest one that is not farther than
        `longest_gap` [s]; NaN where there is none."""
        rows = self.rows
        low, high = np.searchsorted(rows[:, 0], (time - half, time + half))
        part = rows[low:high, 1:]
        part = part[np.isfinite(part).all(axis=1)]
        if len(part):
            return np.asarray(part.mean(axis=0))
        near = rows[max(low - 1, 0) : high + 1]
        near = near[np.isfinite(near).all(axis=1)]
        away = np.abs(near[:, 0] - time)
        if not len(near) or away.min() > longest_gap:
            return np.full(self._columns - 1, np.nan)
        return np.asarray(near[np.argmin(away), 1:])

    def _append(self, rows: Array) -> None:
        if self._every > 1:
            self._waiting += list(rows)
            whole = len(self._waiting) // self._every * self._every
            groups = np.array(self._waiting[:whole]).reshape(-1, self._every, self._columns)
            self._waiting = self._waiting[whole:]
            rows = groups.mean(axis=1)
        self._put(self._used, rows)

    def _insert(self, rows: Array) -> None:
        begin = int(np.searchsorted(self.rows[:, 0], rows[:, 0].min()))
        tail = np.concatenate([self.rows[begin:], rows])
        self._put(begin, tail[np.argsort(tail[:, 0], kind="stable")])

    def _put(self, begin: int, rows: Array) -> None:
        """Rows in place of those from `begin` on."""
        self._used = begin + len(rows)
        while self._used > len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[begin : self._used] = rows
        if self._used > self._most:
            self._halve()

    def _halve(self) -> None:
        pairs = self._used // 2
        rest = self._rows[2 * pairs : self._used].copy()
        self._rows[:pairs] = self._rows[: 2 * pairs].reshape(pairs, 2, self._columns).mean(axis=1)
        self._rows[pairs : pairs + len(rest)] = rest
        self._used, self._every = pairs + len(rest), 2 * self._every


# One frame of a stream in metres and newtons, by what the frames before it showed of camera, clock and force log.

AS_NEAR = 2.0  # sd of the clocks' offset: a force that is as near may be that of the frame
_WRONG, _LEAST_SD = 10.0, 0.02  # sd of a corner, px: as `camera.projection` leaves tags out
_TOUCHED_SD = 8.0  # of a tag's place: farther from rest than this,
_TOUCHED_SHARE = 0.02  # and than this share of the largest displacement so far, the beam is being pushed


@dataclass(frozen=True)
class FrameReader:
    """What turns a frame's corners and the log's rows into what the live learner takes."""

    rec: entries.Recording  # as described, with force and push
    offset: float  # s: log time less the frames' time
    offset_sd: float  # s
    view: View  # of the beam's frame
    follows_base: bool  # camera or base move
    known_xy: Array  # (T, m, 2) m of the frames so far
    camera_part: Array  # (T, m, 3, 3) what all tags share by the camera, as noise of each
    rest_xy: Array  # (m, 2) m, NaN where unknown
    rest_sd: float  # m, of a tag in one frame
    tare: Array  # (2,) N
    gravity: Array  # (2,) m/s^2
    largest: float  # m, displacement so far
    traced: BoolArray  # (m,) which markers are points of an outline; beside tags these are not read frame by frame
    points: PointReader | None = None  # where all are

    @cached_property
    def turn(self) -> Array:
        """(b + m,) rad of the tags, as written."""
        return np.array([tag.turn for tag in (*self.rec.tags.on_base, *self.rec.tags.on_beam)])

    @cached_property
    def to_beam(self) -> Array:
        """(2, 2), sign included: rows of the log times it are forces on the beam."""
        assert self.rec.force is not None
        return (-1.0 if self.rec.force.acts_on == "robot" else 1.0) * to_beam(self.rec.force.rotation)

    def stands_in(self, ahead: float) -> float:
        """s: a frame up to so far after the newest row of the log takes its force. `ahead` [s]: usual lead of that
        row's time over a frame's at its arrival.

        Arrivals at one moment are usually of one time. With a wrong offset of the clocks a frame would wait for ever.
        """
        return float(np.clip(self.offset - ahead, 0.0, AS_NEAR * self.offset_sd))

    def poses(self, corners: Array, outline: OutlineSighting | None = None) -> tuple[Array, Array, Array]:
        """(m, 2) m, (m,) rad and (m, 3, 3): the beam's markers in its frame, from corners (b + tags, 4, 2) px or its
        outline; NaN where not seen."""
        noise = max(self.view.corner_sd, _LEAST_SD)
        tags = self.rec.tags
        poses, misfit, _ = camera.measure_poses(self.view, corners[None], tags.size, noise=noise, refinements=1)
        poses = camera.drop(poses, misfit > _WRONG * noise)
        poses = camera.Poses(poses.xy, poses.angle - self.turn, poses.covariance)
        base = len(tags.on_base)
        own = camera.part(poses, slice(base, None)) if self.points is None else self.points.poses(self.view, outline)
        if self.follows_base:
            along = [tag.s * self.rec.beam.length for tag in tags.on_base]
            own = camera.relative_to(camera.together(camera.part(poses, slice(base)), along), own)
        read = self.traced if self.traced.all() else ~self.traced
        xy, angle, covariance = (_among(read, one[0]) for one in (own.xy, own.angle, own.covariance))
        seen = np.isfinite(xy).all(axis=1)
        away = np.sum((self.known_xy - xy)[:, seen] ** 2, axis=(1, 2))
        if seen.any() and np.isfinite(away).any():
            covariance = covariance + self.camera_part[int(np.nanargmin(away))]
        return xy, np.where(seen, angle, np.nan), covariance

    def force_on_beam(self, logged: Array) -> Array:
        """(2,) N of a row (2,) of the log, its zero that of the first rest."""
        return np.asarray(logged @ self.to_beam - self.tare)

    def pushed(self, xy: Array) -> bool | None:
        """Whether tags at (m, 2) m show the beam pushed; None where that is not sure."""
        away = np.linalg.norm(xy - self.rest_xy, axis=1)
        if not np.isfinite(away).any():
            return None
        return bool(np.nanmax(away) > max(_TOUCHED_SD * self.rest_sd, _TOUCHED_SHARE * self.largest)) or None

    def frame(self, time: float, seen: tags.TrackedFrame, logged: Array) -> LiveFrame | None:
        """What the learner takes of a frame at `time` [s, the frames' clock] with a row (2 or 3) of the log; None where
        nothing is to be learned from it: no tag, no force, or no sure contact."""
        xy, angle, covariance = self.poses(seen.corners, seen.outline if isinstance(seen, BodyFrame) else None)
        pushed = self.pushed(xy)
        assert self.rec.push is not None
        place = self.rec.push.at if len(logged) == 2 else float(logged[2])
        if pushed is None or not np.isfinite(logged).all() or not 0.0 < place <= 1.0:
            return None
        force = self.force_on_beam(logged[:2])
        return LiveFrame(time + self.offset, xy, angle, covariance, force, place, pushed, self.gravity)


def _among(rows: BoolArray, values: Array) -> Array:
    """(m, ...) the values (k, ...) in these rows (m,), NaN in the others."""
    out = np.full((len(rows), *values.shape[1:]), np.nan)
    out[rows] = values
    return out


def reader_of(rec: entries.Recording, seen: Observations, outline: SeenOutline | None = None) -> FrameReader:
    """The reader that goes on from what was observed so far, of frames that show a rest and a push; `outline` of a body
    without tags.

    Raises:
        ObservationError: there is no camera or no force.
    """
    view, clock, clean = seen.source.view, seen.source.clock, seen.source.clean_force
    if view is None or clock is None or clean is None or rec.force is None or rec.push is None:
        raise ObservationError(f"{rec.name}: a film, a force log and where it acts are needed to go on frame by frame")
    m = len(seen.tag_id)
    shared = np.zeros((len(seen.time), m, 3, 3))
    if seen.by_camera is not None:
        shared = seen.by_camera @ np.swapaxes(seen.by_camera, -1, -2)
    away, few = np.linalg.norm(seen.xy - seen.rest_xy, axis=-1), read_before_fit(seen)
    variance = np.trace(seen.covariance[:, few, :2, :2], axis1=-2, axis2=-1)
    return FrameReader(
        rec=rec,
        offset=clock.offset,
        offset_sd=clock.sd,
        view=view,
        follows_base=any(remark.about == "base moves" for remark in seen.source.remarks),
        known_xy=seen.xy,
        camera_part=np.asarray(shared),
        rest_xy=seen.rest_xy,
        rest_sd=float(np.sqrt(np.nanmedian(variance))),
        tare=clean.tare,
        gravity=seen.gravity[-1],
        largest=float(np.nanmax(away)) if np.isfinite(away).any() else 0.0,
        traced=np.zeros(m, dtype=bool) if seen.traced is None else seen.traced,
        points=None if outline is None else point_reader(outline, seen.marker_s, signals.nan_median(seen.covariance)),
    )
