"""AprilTags in a picture, or in the part of it where one is expected.

A little blur before the search takes noise off the edges of large tags, and closes the cells of small ones: below three
pixels a cell they are lost. So a picture is searched with blur first, and without where tags may be too small for it.
Where a tag's size is known, it decides: small tags are searched without blur, and still smaller ones in an enlarged
picture, since the detector looks for an edge within two pixels, where they have their next one.
`benchmarks/detectors.py` measures all three at every size.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
from PIL import Image
from pyapriltags import Detector

from onebend.recording.tags.pattern import CELLS
from onebend.recording.video import Picture
from onebend.records import Array

HALF_PIXEL = 0.5  # the detector puts pixel centres at halves, we at whole numbers
SMALL, TINY = 3.5, 3.0  # px, a cell's side: below, tags are searched without blur, and in an enlarged picture
LOST = 3.5  # px, a cell's side: where tags are larger, blur hides none
LEAST_PART = 8  # px: smaller parts of a picture are not searched
CHANCE = 1e-4  # that what is no tag reads as one: small tags of a whole picture are read with as many errors
MOST_ERRORS = 2  # that the detector corrects
RATIO = 2.0  # of the sides of what is found and what was expected: more is another thing
NEAR = 0.25  # margin around an expected tag, in tag sizes
LEAST_MARGIN = 8  # px


@dataclass(frozen=True)
class Search:
    """How the detector looks at a picture. It is never made smaller: that costs accuracy or small tags."""

    blur: float  # px, sd
    sharpening: float  # of the cells before they are read
    enlarged: float


USUAL, SHARP, ENLARGED = Search(0.8, 0.25, 1.0), Search(0.0, 1.0, 1.0), Search(0.0, 1.0, 1.5)


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
        self.cells = CELLS.get(family)
        self._detector = Detector(families=family, quad_decimate=1.0)
        table: Any = self._detector.tag_families[family].contents
        self._border = int(table.width_at_border)
        self.most_errors = most_errors(table.ncodes, table.nbits)

    def look(self, picture: Picture, wanted: Collection[int] = ()) -> list[Sighting]:
        """Every tag in `picture`, the most certain first.

        Where an id of `wanted` is missing and nothing says that the tags are large, small ones are looked for as well.
        Without blur there is more that looks like a tag: these count only with so few errors that chance has no part.
        """
        seen = self.search(picture, USUAL)
        missing = not {tag.tag_id for tag in seen}.issuperset(wanted)
        if missing and min((side_of(tag.corners) for tag in seen), default=0.0) < LOST * self._border:
            more = [tag for tag in self.search(picture, SHARP) if tag.errors <= self.most_errors]
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
        return [
            Sighting(tag.tag_id, tag.corners + np.array([left, top]), tag.errors, tag.margin)
            for tag in self.search(picture[top:bottom, left:right], how)
            if side / RATIO < side_of(tag.corners) < side * RATIO
        ]

    def search(self, picture: Picture, how: Search) -> list[Sighting]:
        """Every tag that one search finds, the most certain first."""
        pointer: Any = self._detector.tag_detector_ptr
        settings = pointer.contents
        settings.quad_sigma, settings.decode_sharpening = how.blur, how.sharpening
        width, height = picture.shape[1], picture.shape[0]
        if how.enlarged > 1.0:
            size = (round(how.enlarged * width), round(how.enlarged * height))
            picture = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
        scale = np.array([picture.shape[1] / width, picture.shape[0] / height])
        sightings = [
            Sighting(tag.tag_id, tag.corners / scale - HALF_PIXEL, tag.hamming, tag.decision_margin)
            for tag in self._detector.detect(np.ascontiguousarray(picture))
        ]
        return sorted(sightings, key=lambda tag: (tag.errors, -tag.margin))

    def _again(self, picture: Picture, tag: Sighting) -> Sighting:
        """A small tag as its own size is best looked at."""
        if side_of(tag.corners) >= SMALL * self._border:
            return tag
        again = self.look_around(picture, tag.corners, margin_of(tag.corners, NEAR))
        return next((one for one in again if same_place(one, tag)), tag)


def most_errors(codes: int, bits: int) -> int:
    """The errors that a family bears: with them, one in 1 / `CHANCE` random squares reads as one of its tags."""
    chance = [4 * codes * sum(comb(bits, k) for k in range(errors + 1)) / 2**bits for errors in range(MOST_ERRORS + 1)]
    return max(int(np.sum(np.array(chance) < CHANCE)) - 1, 0)


def side_of(corners: Array) -> float:
    """Mean side of a tag with corners (4, 2), px."""
    side = corners - corners[[-1, 0, 1, 2]]
    return float(np.hypot(side[:, 0], side[:, 1]).mean())


def margin_of(corners: Array, share: float) -> float:
    """Margin around corners (4, 2) in which a tag is searched, px: a share of its size."""
    return max(share * float(np.ptp(corners, axis=0).max()), LEAST_MARGIN)


def same_place(tag: Sighting, other: Sighting) -> bool:
    """Whether two sightings are of one tag."""
    away = np.linalg.norm(tag.corners.mean(axis=0) - other.corners.mean(axis=0))
    return tag.tag_id == other.tag_id and float(away) < 0.5 * side_of(tag.corners)
