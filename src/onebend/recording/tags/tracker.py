"""Tracking tags picture by picture, for a camera that goes on filming.

The same searches as `tracking.py` makes of a block of frames, with what is known by then: a tag is sought near where
its last two sightings predict it. Where one is lost, the whole picture is searched again, one part a frame, so that no
frame takes much longer than another, and near where the tag beside it, which has moved with the beam, says that it is.
What is kept does not grow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onebend.errors import ObservationError
from onebend.recording.tags.finder import Finder, Sighting, margin_of, side_of
from onebend.recording.tags.frozen import change_between, coarse_of
from onebend.recording.tags.still_tags import StillTags
from onebend.recording.tags.tracking import LOOK_EVERY, WIDE, follow, sure_doubles, take
from onebend.recording.video import MOST_PIXELS, Picture
from onebend.records import Array

TILE = 160  # px: a lost tag is sought in parts of about this size, one a frame
SQUARE: Array = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # corners of a tag of side 1
OVERLAP = 1.6  # sides of a tag: parts overlap by as much, so that one of them shows it whole


@dataclass(frozen=True)
class TrackedFrame:
    """The tags in one picture of a camera."""

    time: float  # s, the camera's own clock
    corners: Array  # (m, 4, 2) px, as in `records.Detections`; NaN where not seen
    detected: Array  # (m, 4, 2) px, the same before the patterns of tags at rest corrected them
    still_since: Array  # (m,) s, when each tag came to where it stands; NaN where it was not seen
    shape: tuple[int, int]  # height, width, px
    change: float = math.inf  # mean difference of the grey levels from the picture before; infinite where unknown
    looked: bool = False  # the whole picture, or a part of it, was searched
    strangers: tuple[int, ...] = ()  # unexpected ids that were seen then
    doubles: tuple[int, ...] = ()  # ids that were read without error at two places


class Tracker:
    """Follows the tags of one camera. Not thread-safe; what it returns of a picture never changes afterwards."""

    def __init__(self, tag_id: Sequence[int], family: str = "tag36h11") -> None:
        """A tracker that has seen nothing of the tags `tag_id` (m,) of one AprilTag family."""
        self.tag_id = tuple(tag_id)
        self._finder = Finder(family)
        self._still = StillTags(self._finder.cells)
        self._rows: list[tuple[float, Array]] = []  # time and corners as detected, in order of time
        m = len(self.tag_id)
        self._last = np.full((m, m, 4, 2), np.nan)  # by tag: where all of them were when it was seen last
        self._turn, self._unseen = 0, 0
        self._coarse: NDArray[np.int16] | None = None
        self._shape: tuple[int, int] | None = None

    @property
    def kept(self) -> int:
        """Count of the pictures whose tags are still kept, to predict the next ones."""
        return len(self._rows)

    def step(self, picture: Picture, time: float) -> TrackedFrame:
        """The tags in one more picture, from it and those given before.

        Pictures should come in order of time [s]. One that is late, by up to `LOOK_EVERY` frames, is searched near
        where the tags were before and after it.

        Args:
            picture: (H, W) grey, 8 bit.
            time: s, the camera's clock, the middle of the exposure.

        Raises:
            ObservationError: not such a picture, or of another size than the first; a time that is no number, that was
                given before, or that is too late. The tracker stays as it was.
        """
        self._check(picture, time)
        t = sum(one < time for one, _ in self._rows)
        newest = t == len(self._rows)
        tracks = np.full((len(self._rows) + 1, len(self.tag_id), 4, 2), np.nan)
        times = np.insert(np.array([one for one, _ in self._rows]), t, time)
        for k, (_, corners) in enumerate(self._rows):
            tracks[k + (k >= t)] = corners
        for side in (-1, 1):
            follow(tracks, times, t, side, picture, self.tag_id, self._finder)
        sightings: list[Sighting] | None = None
        if newest and np.isnan(tracks).any(axis=(2, 3)).all(axis=0).any():
            sightings = self._look(picture, tracks[t])
            take(tracks[t], sightings or [], self.tag_id)
        self._rows.insert(t, (time, tracks[t]))
        del self._rows[:-LOOK_EVERY]
        corners, since, change = tracks[t], np.full(len(self.tag_id), np.nan), math.inf
        if newest:
            corners, since = self._still.correct(picture, tracks[t], time)
            seen = np.isfinite(tracks[t]).all(axis=(1, 2))
            self._last[seen] = tracks[t]
            coarse = coarse_of(picture)
            change, self._coarse = change_between(self._coarse, coarse), coarse
        found = sightings or []
        return TrackedFrame(
            time=time,
            corners=corners,
            detected=tracks[t],
            still_since=since,
            shape=(picture.shape[0], picture.shape[1]),
            change=change,
            looked=sightings is not None,
            strangers=tuple(tag.tag_id for tag in found if tag.tag_id not in self.tag_id),
            doubles=tuple(tag for tag in sure_doubles(found) if tag in self.tag_id),
        )

    def _check(self, picture: Picture, time: float) -> None:
        if not (isinstance(picture, np.ndarray) and picture.ndim == 2 and picture.dtype == np.uint8):
            what = f"{picture.dtype} of shape {picture.shape}" if isinstance(picture, np.ndarray) else type(picture)
            raise ObservationError(f"a picture must be a grey array (H, W) of uint8, not {what}. Convert it to grey")
        if not 0 < picture.size <= MOST_PIXELS:
            raise ObservationError(f"a picture of {picture.shape[1]} x {picture.shape[0]} cannot be searched")
        if self._shape not in (None, picture.shape):
            raise ObservationError(
                f"a picture of {picture.shape[1]} x {picture.shape[0]} after some of another size. Keep the camera's "
                "size as it is"
            )
        if not math.isfinite(time):
            raise ObservationError(f"the time of a picture is no number: {time}")
        if any(one == time for one, _ in self._rows):
            raise ObservationError(f"a picture of {time:.6f} s was given before")
        if len(self._rows) == LOOK_EVERY and time < self._rows[0][0]:
            raise ObservationError(f"a picture of {time:.6f} s is too late: {LOOK_EVERY} later ones were given")
        self._shape = (picture.shape[0], picture.shape[1])

    def _look(self, picture: Picture, row: Array) -> list[Sighting] | None:
        """Sightings in a part of the picture, or in all of it where no tag was seen lately; None where it was not
        searched this time. `row` (m, 4, 2) px holds what was found near where it was expected."""
        seen = np.isfinite(row).all(axis=(1, 2))
        lately = any(np.isfinite(corners).all(axis=(1, 2)).any() for _, corners in self._rows)
        if not (seen.any() or lately):
            self._unseen += 1
            return self._finder.look(picture, self.tag_id) if self._unseen % LOOK_EVERY == 1 else None
        self._unseen, self._turn = 0, self._turn + 1
        lost = [i for i in np.flatnonzero(~seen).tolist() if not any(_seen(corners[i]) for _, corners in self._rows)]
        i = lost[self._turn // 2 % len(lost)]
        expected = _moved_along(self._last[i], row, i)
        if self._turn % 2 and expected is not None:
            return self._finder.look_around(picture, expected, margin_of(expected, WIDE))
        own = np.diagonal(self._last, axis1=0, axis2=1).transpose(2, 0, 1)  # (m, 4, 2)
        known = np.isfinite(own).all(axis=(1, 2))
        side = max(side_of(corners) for corners in own[known])
        places = _places(picture.shape)
        last = own[i] if expected is None and known[i] else own[known][0] if expected is None else expected
        order = np.argsort(np.linalg.norm(places - last.mean(axis=0), axis=1), kind="stable")
        middle = places[order[self._turn // 2 % len(places)]]
        found = self._finder.look_around(picture, middle + side * SQUARE, 0.5 * TILE + (OVERLAP - 1.0) * side / 2)
        return [tag for tag in found if tag.errors <= self._finder.most_errors]


def _places(shape: tuple[int, ...]) -> Array:
    """(P, 2) px, the middles of the parts of a picture of `shape`."""
    y, x = ((np.arange(count := max(1, math.ceil(size / TILE))) + 0.5) * size / count for size in shape[:2])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _seen(corners: Array) -> bool:
    return bool(np.isfinite(corners).all())


def _moved_along(then: Array, now: Array, i: int) -> Array | None:
    """Corners (4, 2) px expected of tag `i`, hidden since all stood as in `then` (m, 4, 2), where the nearest of those
    seen `now` (m, 4, 2) has taken it along; None where there is none."""
    both = np.flatnonzero((np.isfinite(then) & np.isfinite(now)).all(axis=(1, 2)))
    if not len(both) or not np.isfinite(then[i]).all():
        return None
    away = np.linalg.norm(then[both].mean(axis=1) - then[i].mean(axis=0), axis=1)
    beside = int(both[np.argmin(away)])
    before, after = then[beside].mean(axis=0), now[beside].mean(axis=0)
    one, other = then[beside] - before, now[beside] - after
    turn = math.atan2(float(np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])), float(np.sum(one * other)))
    cos, sin = math.cos(turn), math.sin(turn)
    return np.asarray((then[i] - before) @ np.array([[cos, sin], [-sin, cos]]) + after)
