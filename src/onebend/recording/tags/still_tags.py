"""Corners of tags that stand still, from their whole printed pattern (`pattern.py`), picture by picture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from onebend.recording.tags.pattern import MOST_SHIFT, STILL, fit_pattern, part_around
from onebend.recording.video import Picture
from onebend.records import Array

# Pictures of a tag at one place, after which its pattern is fitted; after the last they are counted anew, and what was
# fitted before holds until the last again.
FITS = (8, 32, 64)


@dataclass
class _Window:
    """The pictures of one tag since it last moved, summed."""

    since: float  # s, of the first of them
    part: tuple[slice, slice]  # rows and columns of the picture
    grey: Array  # their sum
    corners: Array  # (4, 2) px, likewise
    count: int = 0
    fitted: int = 0  # pictures that the last fit was made of


@dataclass
class StillTags:
    """What was seen of each tag since it last moved. At most one pattern is fitted a picture, as each takes some
    milliseconds; what is kept does not grow."""

    cells: int | None  # along a tag's black square; None for families without a plain rim: nothing is corrected
    shifts: dict[int, Array] = field(default_factory=dict)  # (4, 2) px, by the tag's place in the list
    windows: dict[int, _Window] = field(default_factory=dict)

    def correct(self, picture: Picture, corners: Array, time: float) -> tuple[Array, Array]:
        """`corners` (m, 4, 2) px as the detector found them in the newest picture, at `time` [s], those of tags that
        stand still moved by what their patterns say; and (m,) s, since when each stands where it is, NaN where it was
        not seen. What a later picture says of the same stand holds for all of it."""
        since = np.full(len(corners), np.nan)
        if self.cells is None:
            return corners, since
        corrected, due = corners.copy(), -1
        for i in np.flatnonzero(np.isfinite(corners).all(axis=(1, 2))).tolist():
            window = self._with(i, picture, corners[i], time)
            since[i] = window.since
            late = next((count for count in FITS if window.fitted < count <= window.count), 0)
            due = i if due < 0 and late else due
        if due >= 0:
            self._fit(due)
        for i, shift in self.shifts.items():
            corrected[i] += shift  # a tag that is not seen stays NaN
        return corrected, since

    def _with(self, i: int, picture: Picture, corners: Array, time: float) -> _Window:
        """The window of tag `i`, this picture added; a new one where the tag has moved."""
        window = self.windows.get(i)
        if window is not None and np.abs(corners - window.corners / window.count).max() > STILL:
            self.shifts.pop(i, None)
            window = None
        if window is None or window.count >= FITS[-1]:
            part = part_around(corners, picture.shape)
            shape = tuple(one.stop - one.start for one in part)
            fitted = 0 if window is None else FITS[-2]
            window = self.windows[i] = _Window(time, part, np.zeros(shape), np.zeros((4, 2)), 0, fitted)
        window.grey += picture[window.part]
        window.corners = window.corners + corners
        window.count += 1
        return window

    def _fit(self, i: int) -> None:
        """Fit the pattern of tag `i` to the mean of its pictures."""
        assert self.cells is not None
        window = self.windows[i]
        mean, corner = window.corners / window.count, [window.part[1].start, window.part[0].start]
        fitted = fit_pattern(window.grey / window.count, mean - corner, self.cells)
        self.shifts.pop(i, None)
        if fitted is not None and np.abs(fitted + corner - mean).max() <= MOST_SHIFT:
            self.shifts[i] = fitted + corner - mean
        window.fitted = window.count
