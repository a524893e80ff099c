"""AprilTags in a picture, or in the part of it where one is expected.

Blur before the search takes noise off the edges of large tags, and closes the cells of small ones. So small tags are
searched without blur, and still smaller ones in an enlarged picture (`benchmarks/detectors.py` measures all three).
Large tags are searched in a reduced picture, whose pixels are means: at 350 px a side, noise or square blocks of pixels
hide them from the detector, and their corners are as exact."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import comb
from typing import Any

import numpy as np
from PIL import Image
from scipy.special import ndtr

from onebend.errors import RecordingError
from onebend.recording.entries import FAMILIES
from onebend.recording.signals import runs
from onebend.recording.video import FilmFrame, Picture
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


# A tag's corners from its whole printed pattern, for tags that stand still.
#
# The detector uses only the outer edges, each a few dozen noisy points, and its error at one place of the pixel grid
# is the same in every frame. For a tag that does not move there is more information: the mean of its pictures has
# little noise, and all the black-white edges inside the pattern show its place. The model is the pattern blurred by a
# Gaussian, whose width is fitted too. Bloom of the printer or the sensor shifts outer edges outward; inside, edges
# from black to white and from white to black shift in opposite directions, so that their shifts cancel.

CELLS = {"tag36h11": 8, "tag25h9": 7, "tag16h5": 6}  # of the black square's side; families with a plain black rim
RIM = 0.5  # cells of the white margin that are used
STILL = 0.2  # px: a tag whose corners stay this near to their median stands still
MOST_SHIFT = 0.3  # px: a larger correction is not used, as the errors of an edge fit are smaller
ROOT = float(np.sqrt(2 * np.pi))


@dataclass(frozen=True)
class Pattern:
    """brightness = dark + contrast * blurred pattern(homography(pixel)); pixels in tag sizes from the tag's centre."""

    homography: Array  # (8,) pixel to cells, the ninth entry is 1
    dark: Array  # (3,) level, slope along x, slope along y
    contrast: Array  # (3,) likewise
    blur: float  # logarithm of its sd in cells


def correct_still(frames: Sequence[FilmFrame], tracks: Array, cells: int | None) -> Array:
    """`tracks` (B, m, 4, 2) with the corners of every tag that stands still moved by what its whole pattern says.

    `cells` counts the cells along the black square's side; None for families without a plain rim: nothing is changed.
    """
    corrected = tracks.copy()
    if cells is None:
        return corrected
    for i in range(tracks.shape[1]):
        visible = np.flatnonzero(np.isfinite(tracks[:, i]).all(axis=(1, 2))).tolist()
        if len(visible) < 8:  # of a block, in which a tag must be seen to be taken as still
            continue
        middle = np.median(tracks[visible, i], axis=0)
        if np.abs(tracks[visible, i] - middle).max() > STILL:
            continue
        mean = tracks[visible, i].mean(axis=0)
        picture, corner = mean_picture([frames[t] for t in visible], mean)
        fitted = fit_pattern(picture, mean - corner, cells)
        if fitted is not None and np.abs(fitted + corner - mean).max() <= MOST_SHIFT:
            corrected[visible, i] += fitted + corner - mean
    return corrected


def mean_picture(frames: Sequence[FilmFrame], corners: Array) -> tuple[Array, Array]:
    """The mean of the frames around a tag with its margin, and the pixel (x, y) of its first corner."""
    rows, columns = part_around(corners, frames[0].luma.shape)
    parts = np.stack([frame.luma[rows, columns] for frame in frames])
    return parts.mean(axis=0), np.array([columns.start, rows.start], dtype=float)


def part_around(corners: Array, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a picture of `shape` that show the tag with corners (4, 2) [px] and its margin."""
    margin = 0.15 * float(np.ptp(corners, axis=0).max()) + 2
    left, top = np.maximum(np.floor(corners.min(axis=0) - margin), 0).astype(int).tolist()
    right, bottom = np.minimum(np.ceil(corners.max(axis=0) + margin) + 1, (shape[1], shape[0])).astype(int).tolist()
    return slice(top, bottom), slice(left, right)


def fit_pattern(picture: Array, corners: Array, cells: int) -> Array | None:
    """Corners (4, 2) px of the tag whose blurred pattern fits `picture` best, from a first guess; None if none does."""
    centre, size = corners.mean(axis=0), float(np.linalg.norm(corners[1] - corners[0]))
    if size < 2.5 * cells:  # px: smaller cells blur into each other
        return None
    outline = np.array([[0.0, 0.0], [cells, 0.0], [cells, cells], [0.0, cells]])
    homography = homography_between((corners - centre) / size, outline)
    printed, dark, bright = read_cells(picture, homography, centre, size, cells)
    rows, columns = np.indices(picture.shape)
    x, y = (columns.ravel() - centre[0]) / size, (rows.ravel() - centre[1]) / size
    u, v, _ = carry(homography, x, y)
    used = (u > -RIM) & (u < cells + RIM) & (v > -RIM) & (v < cells + RIM)
    x, y, brightness = x[used], y[used], picture.ravel()[used]
    even = np.array([1.0, 0.0, 0.0])
    model = Pattern(homography, dark * even, (bright - dark) * even, float(np.log(0.8 * cells / size)))  # px
    for _ in range(4):  # Gauss-Newton
        jacobian, residual = linearise(model, printed, x, y, brightness)
        try:
            step = np.linalg.solve(jacobian @ jacobian.T, jacobian @ residual)
        except np.linalg.LinAlgError:
            return None
        model = replace(
            model,
            homography=model.homography + step[:8],
            dark=model.dark + step[8:11],
            contrast=model.contrast + step[11:14],
            blur=model.blur + float(np.clip(step[14], -0.5, 0.5)),
        )
    _, residual = linearise(model, printed, x, y, brightness)
    # RMS residual over the contrast; a larger one: the tag is partly hidden, or of another family.
    if not float(np.sqrt((residual**2).mean())) < 0.1 * model.contrast[0]:
        return None
    x, y, _ = carry(homography_inverse(model.homography), outline[:, 0], outline[:, 1])
    return np.asarray(np.stack([x, y], axis=-1) * size + centre)


def read_cells(picture: Array, homography: Array, centre: Array, size: float, cells: int) -> tuple[Array, float, float]:
    """The printed pattern (cells + 4 square, 1 where white, two cells of margin), and the levels of black and white."""
    middles = np.arange(cells) + 0.5
    u, v = np.meshgrid(middles, middles)
    x, y, _ = carry(homography_inverse(homography), u, v)
    row = np.clip(np.rint(y * size + centre[1]).astype(int), 0, picture.shape[0] - 1)
    column = np.clip(np.rint(x * size + centre[0]).astype(int), 0, picture.shape[1] - 1)
    level = picture[row, column]
    rim = np.ones((cells, cells), dtype=bool)
    rim[1:-1, 1:-1] = False
    dark, bright = float(np.median(level[rim])), float(np.percentile(level[~rim], 90))
    printed = np.ones((cells + 4, cells + 4))
    printed[2:-2, 2:-2] = (level > (dark + bright) / 2) & ~rim
    return printed, dark, bright


def linearise(model: Pattern, printed: Array, x: Array, y: Array, brightness: Array) -> tuple[Array, Array]:
    """Jacobian (15, pixels) of the model, transposed, and its residual of `brightness`.

    The blurred pattern is a blend of the four cells around the nearest crossing, with the normal distribution's
    integral as weight; farther edges do not matter for blurs below 0.3 cells."""
    u, v, w = carry(model.homography, x, y)
    blur, last = float(np.exp(model.blur)), len(printed) - 3
    column, row = np.clip(np.rint(u), -1, last - 1).astype(int), np.clip(np.rint(v), -1, last - 1).astype(int)
    across, down = (u - column) / blur, (v - row) / blur
    right, below = ndtr(across), ndtr(down)
    bell_u, bell_v = np.exp(-(across**2) / 2) / ROOT, np.exp(-(down**2) / 2) / ROOT
    above_left, above_right = printed[row + 1, column + 1], printed[row + 1, column + 2]
    below_left, below_right = printed[row + 2, column + 1], printed[row + 2, column + 2]
    upper = above_left + right * (above_right - above_left)
    lower = below_left + right * (below_right - below_left)
    pattern = upper + below * (lower - upper)
    rise_u = (above_right - above_left) + below * ((below_right - below_left) - (above_right - above_left))
    rise_v = lower - upper
    even = np.stack([np.ones_like(x), x, y])
    contrast = model.contrast @ even
    by_u, by_v = contrast * bell_u * rise_u / blur / w, contrast * bell_v * rise_v / blur / w
    by_blur = -contrast * (bell_u * across * rise_u + bell_v * down * rise_v)
    by_w = -(by_u * u + by_v * v)
    by_homography = [by_u * x, by_u * y, by_u, by_v * x, by_v * y, by_v, by_w * x, by_w * y]
    jacobian = np.stack([*by_homography, *even, *(even * pattern), by_blur])
    return jacobian, brightness - model.dark @ even - contrast * pattern


def carry(homography: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Where a homography (8,) carries points, and its denominator there."""
    a, b, c, d, e, f, g, h = homography
    w = g * x + h * y + 1
    return (a * x + b * y + c) / w, (d * x + e * y + f) / w, w


def homography_between(source: Array, target: Array) -> Array:
    """The homography (8,) that carries four points (4, 2) to four others."""
    equations = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        equations += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
    return np.asarray(np.linalg.solve(np.array(equations), target.ravel()))


def homography_inverse(homography: Array) -> Array:
    """The inverse of a homography (8,)."""
    inverse = np.linalg.inv(np.append(homography, 1.0).reshape(3, 3)).ravel()
    return np.asarray(inverse[:8] / inverse[8])


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
        self.cells = CELLS.get(family)
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
