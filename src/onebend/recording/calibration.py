"""A camera's intrinsic parameters from a film of a calibration board."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from onebend.errors import RecordingError
from onebend.extras import package
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.recording.bag_topics import asked
from onebend.recording.bags import is_bag, open_bag
from onebend.recording.entries import VideoEntry
from onebend.recording.video import Picture, frame_count, picture_in, timed
from onebend.records import Array, IntArray, Remark

BoardKind = Literal["chessboard", "charuco"]


@dataclass(frozen=True)
class Board:
    """A flat board of squares. `columns` x `rows`: inner corners of a chessboard, squares of a ChArUco board."""

    kind: BoardKind
    columns: int
    rows: int
    square: float  # m
    marker: float = np.nan  # m, side of a ChArUco board's tags; NaN: three quarters of a square
    dictionary: str = "5x5_100"  # of the ChArUco board's tags

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3:
            raise RecordingError(f"A board of {self.columns} x {self.rows} is too small: 3 x 3 at least.")
        if self.kind == "chessboard" and self.columns == self.rows:
            raise RecordingError(
                f"A chessboard of {self.columns} x {self.rows} inner corners looks the same from four sides. "
                "Use one with unequal sides, such as 9x6."
            )
        if not 0.0 < self.square < 10.0 or self.marker_side >= self.square or not self.marker_side > 0.0:
            raise RecordingError("The squares' side must be positive, and the tags' smaller than it.")

    @property
    def marker_side(self) -> float:
        """m."""
        return 0.75 * self.square if np.isnan(self.marker) else self.marker

    @property
    def corners(self) -> Array:
        """(N, 2) m, inner corners by their number, row by row."""
        fewer = 0 if self.kind == "chessboard" else 1
        y, x = np.mgrid[: self.rows - fewer, : self.columns - fewer]
        first = 0.0 if self.kind == "chessboard" else self.square
        return np.asarray(np.stack([x.ravel(), y.ravel()], axis=1) * self.square + first)


@dataclass(frozen=True)
class BoardView:
    """The board in one frame."""

    frame: int
    number: IntArray  # (n,) of the corners
    pixel: Array  # (n, 2) px
    sharpness: float  # only to be compared within one film


@dataclass(frozen=True)
class BoardFilm:
    """What a film shows of a board."""

    width: int  # px
    height: int  # px
    views: tuple[BoardView, ...]
    frames_searched: int  # frames
    frames_found: int  # of these, that show the board


def find_boards(film: Path, board: Board, *, topic: str = "", progress: Progress = Silent()) -> BoardFilm:
    """The board in frames spread over the film (or the `topic` of a bag); of each few neighbours the sharpest."""
    cv2 = package("cv2", "calibrate")
    find = _finder(cv2, board)
    video = _film_of(film, topic)
    count = frame_count(video) or 0
    every = max(1, count // 240)  # frames of a film, evenly spread
    size: tuple[int, int] | None = None
    views: list[BoardView] = []
    burst: list[BoardView] = []
    looked, boards, begin = 0, 0, 0.0
    progress.start("looking for the board", count // every if count else None)
    try:
        for index, now, raw in timed(video):
            if index % every:
                continue
            picture = picture_in(video, index, raw)
            size = picture.shape if size is None else size
            if picture.shape != size:
                raise RecordingError(f"{film}: the picture's size changes at frame {index}. Film in one size.")
            corners = find(picture)
            looked += 1
            if corners is not None:
                boards += 1
                if burst and now - begin > 0.35:  # s, of which the sharpest frame counts
                    views += _sharpest(burst)
                    burst = []
                begin = begin if burst else now
                burst.append(BoardView(index, corners[0], corners[1], _sharpness(cv2, picture, corners[1])))
            progress.advance()
    finally:
        progress.done()
    assert size is not None  # a film without frames is an error of `timed`
    return BoardFilm(size[1], size[0], (*views, *_sharpest(burst)), looked, boards)


def _film_of(film: Path, topic: str) -> VideoEntry:
    """The film, or the topic of a bag."""
    bag = is_bag(film)
    if bag and not topic:
        raise RecordingError(asked(open_bag(film), "image", "Add --topic {}."))
    if topic and not bag:
        raise RecordingError(f"{film} is no bag and has no topics. Leave out --topic.")
    return VideoEntry(film, topic=topic)


def _sharpest(burst: list[BoardView]) -> list[BoardView]:
    """The one view to keep of a few neighbours."""
    return [max(burst, key=lambda view: (view.sharpness, len(view.number)))] if burst else []


Seen = tuple[IntArray, Array]  # the corners' numbers and pixels


def _finder(cv2: Any, board: Board) -> Any:
    """A function from a picture to corners' numbers and pixels, or None."""
    if board.kind == "chessboard":
        return lambda picture: _chessboard(cv2, board, picture)
    name = f"DICT_{board.dictionary.upper()}"
    if not hasattr(cv2.aruco, name):
        known = sorted(one[5:].lower() for one in dir(cv2.aruco) if one.startswith("DICT_") and one.isupper())
        raise RecordingError(f"There is no dictionary {board.dictionary!r}. Known: {', '.join(known)}.")
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    if board.columns * board.rows // 2 > len(words.bytesList):
        raise RecordingError(f"{board.dictionary} has too few tags for a board of {board.columns} x {board.rows}.")
    sides = float(board.square), float(board.marker_side)
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((board.columns, board.rows), *sides, words))

    def find(picture: Picture) -> Seen | None:
        corners, numbers, _, _ = detector.detectBoard(picture)
        if numbers is None or len(numbers) < 8:
            return None
        return np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)

    return find


def _chessboard(cv2: Any, board: Board, picture: Picture) -> Seen | None:
    """All inner corners; looked for in a smaller picture, refined in this one."""
    # Of a picture in which a chessboard is first looked for; refined in the whole one.
    shrink = min(1.0, float(np.sqrt(1e6 / picture.size)))
    small = picture if shrink == 1.0 else cv2.resize(picture, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    shape = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(small, shape, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    corners = (np.asarray(corners, dtype=np.float32).reshape(-1, 1, 2) + 0.5) / shrink - 0.5
    if shrink < 1.0:
        spacing = float(np.median(np.linalg.norm(np.diff(corners[:, 0], axis=0), axis=1)))
        reach = (max(2, round(0.2 * spacing)),) * 2
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
        corners = cv2.cornerSubPix(picture, np.asarray(corners, dtype=np.float32), reach, (-1, -1), stop)
    return np.arange(len(corners), dtype=np.int64), np.asarray(corners, dtype=float).reshape(-1, 2)


def _sharpness(cv2: Any, picture: Picture, pixel: Array) -> float:
    """Variance of the Laplacian over the grey levels' own, where the board is."""
    (x0, top), (right, bottom) = pixel.min(axis=0).astype(int), pixel.max(axis=0).astype(int) + 1
    part = picture[max(top, 0) : bottom + 1, max(x0, 0) : right + 1]
    return float(cv2.Laplacian(part, cv2.CV_64F).var() / max(float(part.var()), 1.0))


NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

_GROUPS = 8  # of views, each left out once: the spread of the results gives the sd
_CELLS = (8, 6)  # of the picture, across and down, in which corners are counted


@dataclass(frozen=True)
class Calibration:
    """The camera as calibrated from a film of a board."""

    width: int  # px
    height: int  # px
    values: Array  # (9,) fx fy cx cy [px], k1 k2 p1 p2 k3; k3 is 0 where it is not needed
    sd: Array  # (9,)
    error: float  # px, RMS distance of the corners from where they should be
    frames: IntArray  # of the views used
    view_error: Array  # (V,) px
    coverage: float  # share of the picture's cells that hold a corner
    turned: float  # rad, the largest angle between two directions of the board
    left_out: int  # views that fitted badly
    remarks: tuple[Remark, ...]

    @property
    def dist(self) -> Array:
        """(4,) or (5,): without k3 where it is 0."""
        return self.values[4:] if self.values[8] != 0.0 else self.values[4:8]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; pixels and radians."""
        pairs = zip(NAMES, self.values, self.sd, strict=True)
        return {
            "width": self.width,
            "height": self.height,
            "parameters": {name: {"value": value, "sd": sd} for name, value, sd in pairs},
            "error_px": self.error,
            "frames": self.frames,
            "view_error_px": self.view_error,
            "coverage": self.coverage,
            "turned_rad": self.turned,
            "remarks": [remark.as_dict() for remark in self.remarks],
        }

    def camera_table(self) -> str:
        """A `[camera]` table for recording.toml."""
        numbers = dict(zip(NAMES, zip(self.values, self.sd, strict=True), strict=True))
        lines = [
            "[camera]",
            f"# {len(self.frames)} views of a board: {self.error:.3f} px from the model (RMS), corners in "
            f"{100 * self.coverage:.0f} % of the picture.",
            *(f"# {remark.text}" for remark in self.remarks if remark.level == "warning"),
            f"width = {self.width}",
            f"height = {self.height}",
            *(f"{name} = {numbers[name][0]:.3f}  # sd {numbers[name][1]:.2g} px" for name in NAMES[:4]),
            f"dist = [{', '.join(f'{value:.6g}' for value in self.dist)}]"
            f"  # sd {', '.join(f'{value:.2g}' for value in self.sd[4 : 4 + len(self.dist)])}",
        ]
        return "\n".join(lines) + "\n"


@one_blas_thread
def calibrate(
    film: Path, board: Board, *, topic: str = "", most_views: int = 30, progress: Progress = Silent()
) -> Calibration:
    """Pinhole and lens (OpenCV's k1 k2 p1 p2, and k3 where the views need it) from a film of a board, or the images of
    one `topic` of a bag.

    Raises:
        RecordingError: no OpenCV, no board seen, too few or too similar views.
    """
    cv2 = package("cv2", "calibrate")
    board_film = find_boards(film, board, topic=topic, progress=progress)
    if len(board_film.views) < 4:  # views: below, no calibration
        size = f"{board.columns}x{board.rows} " + ("inner corners" if board.kind == "chessboard" else "squares")
        raise RecordingError(
            f"{film}: the {board.kind} was found in {board_film.frames_found} of {board_film.frames_searched} frames, "
            f"in {len(board_film.views)} different views, too few. Check --board ({size} were looked for), light and "
            "focus; show the whole board with its white margin"
        )
    views = spread(cv2, board_film, board, most_views)
    progress.start("calibrating", 3 + _GROUPS)
    try:
        return _calibrated(cv2, board_film, board, views, progress)
    except cv2.error as error:
        raise RecordingError(
            f"{film}: no calibration from these views ({error.err}). Tilt the board by 30 degrees or more, each way"
        ) from error
    finally:
        progress.done()


def spread(cv2: Any, film: BoardFilm, board: Board, most: int) -> list[BoardView]:
    """Views that differ in place, size and tilt: each next one is the furthest from those taken; sharp ones only."""
    sharp = np.array([view.sharpness for view in film.views])
    chosen = [view for view in film.views if view.sharpness >= 0.5 * np.median(sharp)]
    looks = np.array([_looks(cv2, view, board, film) for view in chosen])
    taken = [int(np.argmax([len(view.number) + 1e-3 * view.sharpness for view in chosen]))]
    distance = np.linalg.norm(looks - looks[taken[0]], axis=1)
    while len(taken) < min(most, len(chosen)):
        taken.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(looks - looks[taken[-1]], axis=1))
    return [chosen[i] for i in sorted(taken)]


def _looks(cv2: Any, view: BoardView, board: Board, film: BoardFilm) -> Array:
    """(5,) where the board's middle is, how large it is, how its sides taper: all of order 1."""
    corners = board.corners
    flat, _ = cv2.findHomography(corners[view.number], view.pixel)
    low, high = corners.min(axis=0), corners.max(axis=0)
    box = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    x, y, z = np.asarray(flat) @ np.column_stack([box, np.ones(4)]).T
    outline = np.stack([x / z, y / z], axis=1) / film.width
    side = np.maximum(np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1), 1e-6)
    taper = 3.0 * np.log(side[:2] / side[2:])
    return np.array([*outline.mean(axis=0), 0.5 * np.log(side.mean()), *taper])


def _calibrated(cv2: Any, film: BoardFilm, board: Board, views: list[BoardView], progress: Progress) -> Calibration:
    """Fit, leave out what does not fit, judge k3, and see what the groups of views do to it."""
    first = _fit(cv2, film, board, views, k3=False)
    progress.advance()
    # Times the median of the views' errors: such a view is left out.
    good = [v for v, e in zip(views, first.errors, strict=True) if e <= 3.0 * float(np.median(first.errors))]
    fitted, richer = (_fit(cv2, film, board, good, k3=one) for one in (False, True))
    progress.advance()
    # sd that k3 must differ from 0 by.
    k3 = abs(richer.values[8]) > 3.0 * richer.sd[8] and richer.error < 0.97 * fitted.error
    fitted = richer if k3 else fitted
    sd = _spread_of_groups(cv2, film, board, good, fitted, k3=k3, progress=progress)
    pixel = np.concatenate([view.pixel for view in good])
    cell = ((pixel + 0.5) / (film.width, film.height) * _CELLS).astype(int)
    coverage = len(np.unique(np.clip(cell, 0, np.array(_CELLS) - 1), axis=0)) / (_CELLS[0] * _CELLS[1])
    turned = float(np.arccos(np.clip(fitted.normals @ fitted.normals.T, -1.0, 1.0)).max())
    calibration = Calibration(
        width=film.width,
        height=film.height,
        values=fitted.values,
        sd=sd,
        error=fitted.error,
        frames=np.array([view.frame for view in good], dtype=np.int64),
        view_error=fitted.errors,
        coverage=coverage,
        turned=turned,
        left_out=len(views) - len(good),
        remarks=(),
    )
    return replace(calibration, remarks=_remarks(calibration))


@dataclass(frozen=True)
class _Fit:
    values: Array  # (9,)
    sd: Array  # (9,) were all corners' errors independent
    error: float  # px
    errors: Array  # (V,) px
    normals: Array  # (V, 3)


def _fit(cv2: Any, film: BoardFilm, board: Board, views: list[BoardView], *, k3: bool) -> _Fit:
    """OpenCV's least squares over all corners."""
    flat = np.column_stack([board.corners, np.zeros(len(board.corners))]).astype(np.float32)
    error, matrix, dist, turns, _, sd, _, errors = cv2.calibrateCameraExtended(
        [flat[view.number] for view in views],
        [view.pixel.astype(np.float32)[:, None] for view in views],
        (film.width, film.height),
        None,
        None,
        flags=0 if k3 else cv2.CALIB_FIX_K3,
    )
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(dist)[:5]])
    if not (np.all(np.isfinite(values)) and np.isfinite(error)):
        raise RecordingError("The views of the board allow no calibration: tilt it by 30 degrees or more, each way")
    normals = np.array([np.asarray(cv2.Rodrigues(turn)[0])[:, 2] for turn in turns])
    return _Fit(values, np.ravel(sd)[:9], float(error), np.ravel(errors), normals)


def _spread_of_groups(
    cv2: Any, film: BoardFilm, board: Board, views: list[BoardView], full: _Fit, *, k3: bool, progress: Progress
) -> Array:
    """(9,) sd by leaving out every eighth view in turn (jackknife), no smaller than that of independent corners."""
    count = min(_GROUPS, len(views) // 2)
    if count < 2:
        return np.full(9, np.inf)
    group_values = []
    for i in range(count):
        rest = [view for j, view in enumerate(views) if j % count != i]
        group_values.append(_fit(cv2, film, board, rest, k3=k3).values)
        progress.advance()
    deviation = np.array(group_values) - np.mean(group_values, axis=0)
    return np.asarray(np.maximum(np.sqrt((count - 1) / count * np.sum(deviation**2, axis=0)), full.sd))


def _remarks(fitted: Calibration) -> tuple[Remark, ...]:
    warnings = []
    if len(fitted.frames) < 10:  # below, a warning
        warnings.append(
            f"Only {len(fitted.frames)} different sharp views: film the board longer, and hold it still often."
        )
    if fitted.coverage < 0.5:  # of the cells; less is a warning
        warnings.append(
            f"The board was seen in {100 * fitted.coverage:.0f} % of the picture: the lens is not known elsewhere. "
            "Show it in the corners too."
        )
    if fitted.turned < np.deg2rad(25.0):  # between two of the board's directions; less is a warning
        warnings.append(
            f"All views are alike: the board's directions differ by {np.rad2deg(fitted.turned):.0f} degrees at most: "
            "focal length and distance are hardly distinguishable. Tilt it by 30 degrees or more, each way."
        )
    focal = float(np.max(fitted.sd[:2] / fitted.values[:2]))
    if not focal < 0.01:  # of the focal length; more is a warning
        warnings.append(
            f"The focal length is known to {100 * focal:.2g} % only (one sd): film more tilts and distances."
        )
    if fitted.error > 1.0:  # px; a larger error is a warning
        warnings.append(
            f"The corners are {fitted.error:.2g} px from the model: is the board flat and stiff, the focus fixed, and "
            "--board right?"
        )
    remarks = [Remark("warning", text, about="calibration") for text in warnings]
    if fitted.left_out:
        remarks.append(Remark("note", f"{fitted.left_out} views fitted far worse than the others and were left out."))
    return tuple(remarks)
