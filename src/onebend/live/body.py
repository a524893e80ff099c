"""What each picture of a camera shows of the body: its tags and its outline."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.errors import ObservationError
from onebend.recording import camera, entries, flanks, outline as outlines, plane, signals, video
from onebend.recording.tags import TrackedFrame, Tracker
from onebend.records import Array, BoolArray, Detections, IntArray, OutlineTrack, View

GIVEN_UP = 60  # pictures in a row without the outline: beside tags it is followed no more. One in which it was looked
# for in vain takes as long as many
AGAIN = 0.5  # s after which a body that was not found is looked for again
DRAWN = 60  # points of a followed outline, about
SHOWN = (1.0 / 3.0, 2.0 / 3.0, 1.0)  # s of the points that say how far the body moved
NOT_SEEN = "the outline of the body is not seen"


@dataclass(frozen=True)
class OutlineSighting:
    """The flanks in one picture, as of `FlankFollower.step`."""

    state: Array  # (1 + K,)
    away: Array  # (2, M) m; NaN where the body was lost
    shift: Array  # (2,) px, of the picture against the one in which the body was found

    def drawn(self, follower: outlines.FlankFollower) -> Array:
        """(c, 2) px along the middle between the flanks, NaN where they were not seen."""
        assert follower.body is not None
        place, every = follower.place, max(1, follower.place.stations.count // DRAWN)
        curve = place.stations.curve(self.state)
        middle = signals.nan_mean(self.away - flanks.SIDES[:, None] * follower.body.half)
        return (plane.project(place.view, curve.xy + middle[:, None] * curve.normal) + self.shift)[::every]


@dataclass(frozen=True)
class BodyFrame(TrackedFrame):
    """The tags of the base and the outline in one picture."""

    outline: OutlineSighting | None = None  # None: it was not found yet
    curve: Array | None = None  # (c, 2) px, as of `OutlineSighting.drawn`
    places: Array | None = None  # (3, 2) of `SHOWN`, over the length of a body without tags; NaN where it was lost


class BodyTracker:
    """Follows tags and outline through the pictures of one camera. Not thread-safe."""

    def __init__(self, rec: entries.Recording) -> None:
        self.why = "" if rec.tags.on_beam else NOT_SEEN  # nothing is seen of the body in the newest picture
        self.follower: outlines.FlankFollower | None = None
        self._rec, self._next, self._corners, self._lost = rec, -np.inf, np.empty(0), 0
        self._tags = Tracker([tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)], rec.tags.family)

    @property
    def kept(self) -> int:
        """As of `Tracker`."""
        return self._tags.kept

    def step(self, picture: video.Picture, time: float, colour: Any = None) -> TrackedFrame:
        """As `Tracker.step`; `colour`: the same picture as `av.VideoFrame`, where there is more than grey."""
        seen = self._tags.step(picture, time)
        if not self._rec.traces_outline or (self._rec.tags.on_beam and self._lost > GIVEN_UP):
            return seen
        planes = (
            flanks.Planes(picture, np.full((2, 2, 2), 128, np.uint8))
            if colour is None
            else flanks.planes_of(self._rec, 0, colour)
        )
        outline = self._outline(planes, seen)
        if outline is None or self.follower is None:
            return BodyFrame(**vars(seen))
        places = None
        if not self._rec.tags.on_beam:
            stations = self.follower.place.stations
            curve = stations.curve(outline.state).xy / stations.length
            places = np.stack([np.interp(SHOWN, stations.s, column) for column in curve.T], axis=1)
            places = np.where(np.isfinite(outline.away).any(), places, np.nan)
        return BodyFrame(**vars(seen), outline=outline, curve=outline.drawn(self.follower), places=places)

    def _outline(self, planes: flanks.Planes, seen: TrackedFrame) -> OutlineSighting | None:
        base = len(self._rec.tags.on_base)
        if not np.isfinite(seen.corners[:base]).any() or (self.follower is None and seen.time < self._next):
            return None
        try:
            if self.follower is None:
                self._next = seen.time + AGAIN
                height, width = seen.shape
                tag_id = np.array([tag.id for tag in (*self._rec.tags.on_base, *self._rec.tags.on_beam)])
                found = Detections(np.array([seen.time]), tag_id, seen.corners[None], width, height)
                view = camera.measure_markers(found, self._rec).view
                assert view is not None
                self.follower, self._corners = (
                    outlines.FlankFollower(outlines.body_place(self._rec, view)),
                    seen.corners[:base],
                )
            shift = np.nan_to_num(signals.nan_mean((seen.corners[:base] - self._corners).reshape(-1, 2)))
            state, away = self.follower.step(flanks.Sight(planes, self.follower.place.view, shift))
        except ObservationError as wrong:
            self.follower, why = None, str(wrong).removeprefix(f"{self._rec.name}: ")
            self.why, self._lost = "" if self._rec.tags.on_beam else why, self._lost + GIVEN_UP // 3
            return None
        self._lost = 0 if np.isfinite(away).any() else self._lost + 1
        self.why = NOT_SEEN if self._lost and not self._rec.tags.on_beam else ""
        return OutlineSighting(state, away, shift)


def curve_in(seen: TrackedFrame) -> Array:
    """(c, 2) px of the outline in a picture; (0, 2) where none was followed."""
    none = np.zeros((0, 2))
    return none if not isinstance(seen, BodyFrame) or seen.curve is None else seen.curve


@dataclass(frozen=True)
class SeenOutline:
    """The outline in T frames."""

    place: flanks.BodyPlace
    half: Array  # (M,) m, half the width where the body was found
    found: outlines.OutlineSearch
    shift: Array  # (T, 2) px

    @property
    def track(self) -> OutlineTrack:
        """Its points. Raises `ObservationError` where what was followed is no body."""
        return outlines.track_of(self.place, self.found, self.half, self.shift)


def outline_in(frames: Iterable[TrackedFrame], follower: outlines.FlankFollower | None) -> SeenOutline | None:
    """The outline in these frames; None where it was never found."""
    if follower is None or follower.body is None:
        return None
    nothing = OutlineSighting(follower.body.state, np.full((2, follower.place.stations.count), np.nan), np.zeros(2))
    every = [one.outline if isinstance(one, BodyFrame) and one.outline is not None else nothing for one in frames]
    state, away, shift = (np.stack([getattr(one, name) for one in every]) for name in ("state", "away", "shift"))
    return SeenOutline(follower.place, follower.body.half, outlines.OutlineSearch(state, away), shift)


@dataclass(frozen=True)
class PointReader:
    """What turns the flanks in a frame into points of the body."""

    place: flanks.BodyPlace
    half: Array  # (M,) m
    kept: IntArray  # (n,) which of `PLACES`
    covariance: Array  # (n, 3, 3) of a point in one frame
    traced: BoolArray  # (m,) which of tags and points together, in the order of their places, they are
    height: Array  # (N,) m, of all places of an outline over the tags' plane

    def beside(self, tags: camera.Poses, view: View, seen: OutlineSighting | None) -> camera.Poses:
        """(1, m) the tags (1, m - n) and the points, in the order of their places."""
        order = np.argsort(np.concatenate([np.flatnonzero(~self.traced), np.flatnonzero(self.traced)]))
        pairs = zip(vars(tags).values(), vars(self.poses(view, seen)).values(), strict=True)
        return camera.Poses(*(np.concatenate(pair, axis=1)[:, order] for pair in pairs))

    def poses(self, view: View, seen: OutlineSighting | None) -> camera.Poses:
        """(1, n) points in the view's plane; NaN where they were not seen."""
        stations, scale, n = self.place.stations, self.place.scale, len(self.kept)
        if seen is None or not np.isfinite(seen.away).any():
            return camera.Poses(np.full((1, n, 2), np.nan), np.full((1, n), np.nan), self.covariance[None])
        found = outlines.OutlineSearch(seen.state[None], seen.away[None])
        middle = outlines.centreline(found, stations, self.half, flanks.MEASURED / scale)
        track = outlines.points_of(middle, found, stations, self.place.view, seen.shift[None], scale)
        poses = camera.points_in_plane(view, track, self.height)
        poses = camera.drop(poses, ~np.isfinite(track.sd))
        return camera.Poses(poses.xy[:, self.kept], poses.angle[:, self.kept], self.covariance[None])


def point_reader(outline: SeenOutline, s: Array, covariance: Array, traced: BoolArray, height: Array) -> PointReader:
    """The reader of the `traced` (m,) ones among markers at `s` (m,), of these covariances (m, 3, 3) [m^2, rad^2]."""
    width, _ = outlines.body_width(outline.found.away, outline.half)
    kept = np.searchsorted(outlines.PLACES, s[traced] - 1e-9)
    return PointReader(outline.place, 0.5 * width, kept, covariance[traced], traced, height)
