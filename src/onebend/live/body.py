"""What each picture of a camera shows of the body: its tags, or the outline of one that has none."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.errors import ObservationError
from onebend.recording import body_end, camera, entries, flanks, outline as outlines, plane, signals, video
from onebend.recording.tags import TrackedFrame, Tracker
from onebend.records import Array, Detections, IntArray, OutlineTrack, View

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
    places: Array | None = None  # (3, 2) of `SHOWN`, over the length; NaN where the body was lost


class BodyTracker:
    """Follows the tags, or the outline of a body without tags, through the pictures of one camera. Not thread-safe."""

    def __init__(self, rec: entries.Recording) -> None:
        self.bare = rec.traces_outline and not rec.tags.on_beam
        self.why = NOT_SEEN if self.bare else ""  # nothing is seen of the body in the newest picture
        self.follower: outlines.FlankFollower | None = None
        self._rec, self._next, self._corners = rec, -np.inf, np.empty(0)
        self._tags = Tracker([tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)], rec.tags.family)

    def step(self, picture: video.Picture, time: float, colour: Any = None) -> TrackedFrame:
        """As `Tracker.step`; `colour`: the same picture as `av.VideoFrame`, where there is more than grey."""
        seen = self._tags.step(picture, time)
        if not self.bare:
            return seen
        outline = self._outline(planes_in(self._rec, picture, colour), seen)
        if outline is None or self.follower is None:
            return BodyFrame(**vars(seen))
        stations = self.follower.place.stations
        curve = stations.curve(outline.state).xy / stations.length
        places = np.stack([np.interp(SHOWN, stations.s, column) for column in curve.T], axis=1)
        places = np.where(np.isfinite(outline.away).any(), places, np.nan)
        return BodyFrame(**vars(seen), outline=outline, curve=outline.drawn(self.follower), places=places)

    def _outline(self, planes: flanks.Planes, seen: TrackedFrame) -> OutlineSighting | None:
        if not np.isfinite(seen.corners).any() or (self.follower is None and seen.time < self._next):
            return None
        try:
            if self.follower is None:
                self._next, self._corners = seen.time + AGAIN, seen.corners
                height, width = seen.shape
                tag_id = np.array([tag.id for tag in self._rec.tags.on_base])
                found = Detections(np.array([seen.time]), tag_id, seen.corners[None], width, height)
                view = camera.measure_markers(found, self._rec).view
                assert view is not None
                self.follower = outlines.FlankFollower(outlines.body_place(self._rec, view))
            shift = np.nan_to_num(signals.nan_mean((seen.corners - self._corners).reshape(-1, 2)))
            state, away = self.follower.step(flanks.Sight(planes, self.follower.place.view, shift))
        except ObservationError as wrong:
            self.follower, self.why = None, str(wrong).removeprefix(f"{self._rec.name}: ")
            return None
        self.why = "" if np.isfinite(away).any() else NOT_SEEN
        return OutlineSighting(state, away, shift)


def planes_in(rec: entries.Recording, picture: video.Picture, colour: Any = None) -> flanks.Planes:
    """A picture, grey and perhaps as `av.VideoFrame` too, as the outline is looked for in it."""
    return flanks.grey(picture) if colour is None else flanks.planes_of(rec, 0, colour)


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

    def track(self, pictures: Mapping[int, flanks.Planes]) -> OutlineTrack:
        """Its points; its end is looked for in the `pictures` of some frames. Raises `ObservationError` where what was
        followed is no body."""
        looked = [] if self.place.hidden[-1] else [*pictures][:: math.ceil(len(pictures) / body_end.PICTURES) or 1]
        at_end = {row: flanks.Sight(pictures[row], self.place.view, self.shift[row]) for row in looked}
        return outlines.track_of(self.place, self.found, self.half, self.shift, at_end)


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
    """What turns the flanks in a frame into points of a body without tags."""

    place: flanks.BodyPlace
    half: Array  # (M,) m
    kept: IntArray  # (n,) which of `PLACES`
    covariance: Array  # (n, 3, 3) of a point in one frame

    def poses(self, view: View, seen: OutlineSighting | None) -> camera.Poses:
        """(1, n) points in the view's plane; NaN where they were not seen."""
        stations, scale, n = self.place.stations, self.place.scale, len(self.kept)
        if seen is None or not np.isfinite(seen.away).any():
            return camera.Poses(np.full((1, n, 2), np.nan), np.full((1, n), np.nan), self.covariance[None])
        found = outlines.OutlineSearch(seen.state[None], seen.away[None])
        middle = outlines.centreline(found, stations, self.half, flanks.MEASURED / scale)
        track = outlines.points_of(middle, found, stations, self.place.view, seen.shift[None], scale)
        poses = camera.points_in_plane(view, track)
        poses = camera.drop(poses, ~np.isfinite(track.sd))
        return camera.Poses(poses.xy[:, self.kept], poses.angle[:, self.kept], self.covariance[None])


def point_reader(outline: SeenOutline, s: Array, covariance: Array) -> PointReader:
    """The reader of points at `s` (n,), of these covariances (n, 3, 3) [m^2, rad^2]."""
    width, _ = outlines.body_width(outline.found.away, outline.half)
    return PointReader(outline.place, 0.5 * width, np.searchsorted(outlines.PLACES, s - 1e-9), covariance)
