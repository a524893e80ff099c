"""AprilTags in a picture, or in the part of it where one is expected.

Blur before the search takes noise off the edges of large tags, and closes the cells of small ones. So small tags are
searched without blur, and still smaller ones in an enlarged picture (`benchmarks/detectors.py` measures all three).
Large tags are searched in a reduced picture, whose pixels are means: at 350 px a side, noise or square blocks of pixels
hide them from the detector, and their corners are as exact."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache
from math import comb
from typing import Any

import numpy as np
from PIL import Image

from onebend.errors import RecordingError
from onebend.recording.entries import FAMILIES
from onebend.recording.signals import runs
from onebend.recording.video import Picture
from onebend.records import Array, BoolArray


@dataclass(frozen=True)
class PrintedTag:
    """A tag's cells. `size_m` of a recording is the side of the square of `border` cells in the middle of them."""

    id: int
    cells: BoolArray  # (n, n) True where white; row 0 is the printed upper edge, column 0 the left one
    border: int  # cells along the side of the square whose corners are detected

    @property
    def margin(self) -> int:
        """Cells between the edge of `cells` and the detected square."""
        return (len(self.cells) - self.border) // 2

    @property
    def ink(self) -> Array:
        """(n, 4, 2) corners of the black runs of each row, in cells right of and below the upper left corner."""
        boxes = [
            [[left, row], [right, row], [right, row + 1], [left, row + 1]]
            for row, white in enumerate(self.cells)
            for left, right in runs(~white).tolist()
        ]
        return np.array(boxes, dtype=float)


@dataclass(frozen=True)
class _Family:
    codes: tuple[int, ...]
    border: int
    total: int
    reversed_border: bool
    bit_x: tuple[int, ...]
    bit_y: tuple[int, ...]


def printed_tag(tag_id: int, family: str = FAMILIES[0]) -> PrintedTag:
    """The cells of one tag, its outermost ring included (white for families with a plain black rim).

    Raises:
        RecordingError: an unknown family, or an id that the family does not have.
    """
    layout = _family(family)
    if not 0 <= tag_id < len(layout.codes):
        raise RecordingError(f"{family} has tags 0 to {len(layout.codes) - 1}, not {tag_id}.")
    cells = np.zeros((layout.total, layout.total), dtype=bool)
    ring = layout.border if layout.reversed_border else layout.border + 2  # cells along the side of the white ring
    first, last = (layout.total - ring) // 2, (layout.total + ring) // 2 - 1
    cells[[first, last], first : last + 1] = True
    cells[first : last + 1, [first, last]] = True
    start, code = (layout.total - layout.border) // 2, layout.codes[tag_id]
    for bit, (x, y) in enumerate(zip(layout.bit_x, layout.bit_y, strict=True)):
        if code >> (len(layout.bit_x) - 1 - bit) & 1:
            cells[start + y, start + x] = True
    cells.setflags(write=False)
    return PrintedTag(tag_id, cells, layout.border)


def _detector(family: str) -> Any:
    from pyapriltags import Detector  # here: who reads an outline looks for no tags

    return Detector(families=family, quad_decimate=1.0)


@cache
def _family(name: str) -> _Family:
    if name not in FAMILIES:
        raise RecordingError(f"{name!r} is not a family of tags. Take one of {', '.join(FAMILIES)}.")
    detector = _detector(name)  # owns the memory that is read below
    table = detector.tag_families[name].contents
    return _Family(
        codes=tuple(int(table.codes[i]) for i in range(table.ncodes)),
        border=int(table.width_at_border),
        total=int(table.total_width),
        reversed_border=bool(table.reversed_border),
        bit_x=tuple(int(table.bit_x[i]) for i in range(table.nbits)),
        bit_y=tuple(int(table.bit_y[i]) for i in range(table.nbits)),
    )


HALF_PIXEL = 0.5  # the detector puts pixel centres at halves, we at whole numbers
SMALL, TINY = 3.5, 3.0  # px, a cell's side: below, tags are searched without blur, and in an enlarged picture
LARGE = 100.0  # px, a tag's side: from twice that on, it is searched in a picture reduced by a whole number
REDUCED = (2, 4)  # of a whole picture in which tags are missing
LEAST_PART = 8  # px: smaller pictures, and parts of one, are not searched
CHANCE = 1e-4  # that what is no tag reads as one: small tags of a whole picture are read with as many errors
RATIO = 2.0  # of the sides of what is found and what was expected: more is another thing
NEAR = 0.25  # margin around an expected tag, in tag sizes


@dataclass(frozen=True)
class Search:
    """How the detector looks at a picture."""

    blur: float  # px, sd
    sharpening: float  # of the cells before they are read
    enlarged: float = 1.0
    reduced: int = 1  # pixels along either axis of which the mean is taken


USUAL, SHARP, ENLARGED = Search(0.8, 0.25), Search(0.0, 1.0), Search(0.0, 1.0, 1.5)


@dataclass(frozen=True)
class Sighting:
    """One tag in one picture; `corners` as in `records.Detections`."""

    tag_id: int
    corners: Array  # (4, 2) px
    errors: int  # bits of the code that had to be corrected
    margin: float  # contrast of the code's bits; larger is more certain


class Finder:
    """An AprilTag detector. It owns memory outside Python, and its settings change: one for each thread."""

    def __init__(self, family: str) -> None:
        self._detector = _detector(family)
        table: Any = self._detector.tag_families[family].contents
        self._border = int(table.width_at_border)
        self.most_errors = most_errors(table.ncodes, table.nbits)

    def look(self, picture: Picture, wanted: Collection[int] = ()) -> list[Sighting]:
        """Every tag in `picture`, the most certain first.

        Where an id of `wanted` is missing, small tags are searched as well, unless those found are large. Without blur
        more looks like a tag: these count only with so few errors that chance has no part. So do large tags then."""
        seen = self.search(picture, USUAL)
        for how in (SHARP, *(replace(USUAL, reduced=size) for size in REDUCED)):
            if {tag.tag_id for tag in seen}.issuperset(wanted):
                break
            # px, a cell's side: where tags are larger, blur hides none.
            if how is SHARP and min((side_of(tag.corners) for tag in seen), default=0.0) >= 3.5 * self._border:
                continue
            more = [tag for tag in self.search(picture, how) if tag.errors <= self.most_errors]
            seen += [tag for tag in more if not any(same_place(tag, other) for other in seen)]
        return sorted((self._again(picture, tag) for tag in seen), key=lambda tag: (tag.errors, -tag.margin))

    def look_around(self, picture: Picture, expected: Array, margin: float) -> list[Sighting]:
        """Tags about as large as the one expected at corners (4, 2) [px], within `margin` of them."""
        height, width = picture.shape
        left, top = np.maximum(np.floor(expected.min(axis=0) - margin), 0).astype(int)
        right, bottom = np.minimum(np.ceil(expected.max(axis=0) + margin) + 1, (width, height)).astype(int)
        if right - left < LEAST_PART or bottom - top < LEAST_PART:
            return []
        side = side_of(expected)
        how = USUAL if side >= SMALL * self._border else SHARP if side >= TINY * self._border else ENLARGED
        how = replace(how, reduced=max(int(side / LARGE), 1))
        return [
            Sighting(tag.tag_id, tag.corners + np.array([left, top]), tag.errors, tag.margin)
            for tag in self.search(picture[top:bottom, left:right], how)
            if side / RATIO < side_of(tag.corners) < side * RATIO
        ]

    def search(self, picture: Picture, how: Search) -> list[Sighting]:
        """Every tag that one search finds, the most certain first; none in a picture of a few pixels."""
        if min(picture.shape) < LEAST_PART * how.reduced:  # the detector crashes on two by two
            return []
        pointer: Any = self._detector.tag_detector_ptr
        settings = pointer.contents
        settings.quad_sigma, settings.decode_sharpening = how.blur, how.sharpening
        width, height = picture.shape[1], picture.shape[0]
        scale = np.full(2, 1.0 / how.reduced)
        if how.reduced > 1:
            picture = np.asarray(Image.fromarray(picture).reduce(how.reduced))
        elif how.enlarged > 1.0:
            size = (round(how.enlarged * width), round(how.enlarged * height))
            picture = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
            scale = np.array([size[0] / width, size[1] / height])
        sightings = [
            Sighting(tag.tag_id, tag.corners / scale - HALF_PIXEL, tag.hamming, tag.decision_margin)
            for tag in self._detector.detect(np.ascontiguousarray(picture))
        ]
        return sorted(sightings, key=lambda tag: (tag.errors, -tag.margin))

    def _again(self, picture: Picture, tag: Sighting) -> Sighting:
        """A small or a large tag as its own size is best looked at."""
        if SMALL * self._border <= side_of(tag.corners) < 2.0 * LARGE:
            return tag
        again = self.look_around(picture, tag.corners, margin_of(tag.corners, NEAR))
        return next((one for one in again if same_place(one, tag)), tag)


def most_errors(codes: int, bits: int) -> int:
    """The errors that a family bears: with them, one in 1 / `CHANCE` random squares reads as one of its tags."""
    chance = [
        4 * codes * sum(comb(bits, k) for k in range(errors + 1)) / 2**bits for errors in range(3)
    ]  # it corrects two
    return max(int(np.sum(np.array(chance) < CHANCE)) - 1, 0)


def side_of(corners: Array) -> float:
    """Mean side of a tag with corners (4, 2), px."""
    side = corners - corners[[-1, 0, 1, 2]]
    return float(np.hypot(side[:, 0], side[:, 1]).mean())


def margin_of(corners: Array, share: float) -> float:
    """Margin around corners (4, 2) in which a tag is searched, px: a share of its size."""
    return max(share * float(np.ptp(corners, axis=0).max()), 8)  # px


def same_place(tag: Sighting, other: Sighting) -> bool:
    """Whether two sightings are of one tag."""
    away = np.linalg.norm(tag.corners.mean(axis=0) - other.corners.mean(axis=0))
    return tag.tag_id == other.tag_id and float(away) < 0.5 * side_of(tag.corners)
