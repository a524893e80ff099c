"""Small pictures of a stream, kept as it goes on, spread over rest and push: the tool is looked for in them at the end.

Which frames are of the push is known only when it is over. A beam at rest is where it was in the beginning, so of the
frames that show the tags there some are kept, and of all others more: each evenly over time and way together, as
`film.rows_to_look_at` chooses among the frames of a film.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onebend.recording.tool.covered import BEAM_PIXELS, shrunk
from onebend.recording.tool.film import AT_REST, LOADED, SmallPictures
from onebend.recording.video import Picture
from onebend.records import Array

MOST = 2 * (LOADED + AT_REST)  # pictures: at least half as many are left where every other one has gone
MOST_PIXELS = 25_000_000  # of all that are kept; a pixel takes 4 bytes
MOVED = 0.05  # of a tag's side: farther from where it was first, it may be pushed
SECONDS, WAY = 0.1, 0.1  # s, and sides of a tag: so far apart are the pictures to begin with


@dataclass(frozen=True)
class _Kept:
    """A picture with its tags."""

    time: float  # s
    middle: Array  # (m, 2) px
    picture: NDArray[np.float32]


@dataclass
class _Spread:
    """Pictures evenly over time and way; where there are too many, every other one goes, and so on."""

    share: float  # of all that are kept
    spacing: float = 1.0
    kept: list[_Kept] = field(default_factory=list)

    def wants(self, time: float, middle: Array, side: float) -> bool:
        """Whether a picture is far enough from the last one."""
        if not self.kept:
            return True
        last = self.kept[-1]
        return (time - last.time) / SECONDS + _farthest(middle - last.middle) / (WAY * side) >= self.spacing

    def add(self, one: _Kept, most: int) -> None:
        """One more, of at most `most` in both stores."""
        self.kept.append(one)
        if len(self.kept) > max(1, int(self.share * most)):
            self.kept, self.spacing = self.kept[::2], 2.0 * self.spacing


class KeptSmall:
    """The pictures that are kept of a stream."""

    def __init__(self, length: float, tag_size: float, most: int = MOST) -> None:
        """Nothing is kept yet: of a beam of `length` [m], with tags of `tag_size` [m], at most so many pictures."""
        self._tags_long = length / tag_size
        self._most = min(most, MOST)
        self._factor, self._side = 0, math.nan
        self._first: Array | None = None  # (m, 2) px, where each tag was seen first
        self._rest, self._away = (_Spread(part / (AT_REST + LOADED)) for part in (AT_REST, LOADED))

    def __len__(self) -> int:
        """Count of the pictures that are kept."""
        return len(self._rest.kept) + len(self._away.kept)

    def __contains__(self, time: object) -> bool:
        """Whether the picture of a time [s] is kept."""
        return any(one.time == time for spread in (self._rest, self._away) for one in spread.kept)

    def add(self, time: float, picture: Picture, corners: Array) -> None:
        """Take notice of the newest picture, which shows the tags' corners (m, 4, 2) [px]; NaN where it does not."""
        seen = np.isfinite(corners).all(axis=(1, 2))
        if not seen.any():
            return
        middle = corners.mean(axis=1)
        if self._first is None:
            self._begin(
                picture, float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)[seen].mean()), middle
            )
        assert self._first is not None
        self._first = np.where(np.isfinite(self._first), self._first, middle)
        moved = _farthest(middle - self._first) > MOVED * self._side
        spread = self._away if moved else self._rest
        if self._most and spread.wants(time, middle, self._side):
            spread.add(_Kept(time, middle, shrunk(picture, self._factor)), self._most)

    def small(self) -> SmallPictures | None:
        """Those that are kept, in order of time; None where there are none."""
        kept = sorted((*self._rest.kept, *self._away.kept), key=lambda one: one.time)
        if not kept:
            return None
        return SmallPictures(np.array([one.time for one in kept]), tuple(one.picture for one in kept), self._factor)

    def _begin(self, picture: Picture, side: float, middle: Array) -> None:
        """Know the scale, as `covered.shrink_factor` does by the camera, by the tags' side [px]."""
        self._side, self._first = side, middle
        self._factor = max(1, math.ceil(self._tags_long * side / BEAM_PIXELS))
        self._most = min(self._most, MOST_PIXELS * self._factor**2 // picture.size)


def _farthest(way: Array) -> float:
    """Of ways (m, 2), the longest one that is known; 0 where none is."""
    known = way[np.isfinite(way).all(axis=1)]
    return float(np.linalg.norm(known, axis=1).max()) if len(known) else 0.0
