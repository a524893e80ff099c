"""A tag's corners from its whole printed pattern, for tags that stand still.

The detector uses only the outer edges, each a few dozen noisy points, and its error at one place of the pixel grid is
the same in every frame. For a tag that does not move there is more information: the mean of its pictures has little
noise, and all the black-white edges inside the pattern show its place. The model is the pattern blurred by a Gaussian,
whose width is fitted too. Bloom of the printer or the sensor shifts outer edges outward; inside, edges from black to
white and from white to black shift in opposite directions, so that their shifts cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from onebend.recording.video import FilmFrame
from onebend.records import Array

CELLS = {"tag36h11": 8, "tag25h9": 7, "tag16h5": 6}  # of the black square's side; families with a plain black rim
RIM = 0.5  # cells of the white margin that are used
LEAST_FRAMES = 8  # of a block, in which a tag must be seen to be taken as still
STILL = 0.2  # px: a tag whose corners stay this near to their median stands still
MOST_SHIFT = 0.3  # px: a larger correction is not used, as the errors of an edge fit are smaller
MOST_MISFIT = 0.1  # RMS residual over the contrast; a larger one: the tag is partly hidden, or of another family
STEPS = 4  # Gauss-Newton
FIRST_BLUR = 0.8  # px
ROOT = float(np.sqrt(2 * np.pi))
LEAST_CELL = 2.5  # px: smaller cells blur into each other


@dataclass(frozen=True)
class Pattern:
    """A tag's picture as a model: brightness = dark + contrast * blurred pattern(homography(pixel)).

    Pixels are in tag sizes from the tag's centre. Light that falls unevenly makes `dark` and `contrast` change
    linearly over the tag.
    """

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
        if len(visible) < LEAST_FRAMES:
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
    if size < LEAST_CELL * cells:
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
    model = Pattern(homography, dark * even, (bright - dark) * even, float(np.log(FIRST_BLUR * cells / size)))
    for _ in range(STEPS):
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
    if not float(np.sqrt((residual**2).mean())) < MOST_MISFIT * model.contrast[0]:
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

    Near an edge between cells the blurred pattern is a blend of the four cells around the nearest crossing of cell
    borders, with the normal distribution's integral as weight; farther edges do not matter for blurs below 0.3 cells.
    """
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
    equations, values = [], []
    for (x, y), (u, v) in zip(source, target, strict=True):
        equations += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        values += [u, v]
    return np.linalg.solve(np.array(equations), np.array(values))


def homography_inverse(homography: Array) -> Array:
    """The inverse of a homography (8,)."""
    inverse = np.linalg.inv(np.append(homography, 1.0).reshape(3, 3)).ravel()
    return np.asarray(inverse[:8] / inverse[8])
