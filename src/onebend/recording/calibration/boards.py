"""Calibration boards (chessboard, ChArUco) in a film: corners of every frame that shows one sharply, by OpenCV.

OpenCV is an optional part of onebend. Only this module and `calibration` know it, and only while they work.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from onebend.errors import RecordingError
from onebend.extras import package
from onebend.progress import Progress, Silent
from onebend.recording.bags.film_topic import bag_frames
from onebend.recording.bags.reader import is_bag, listed, open_bag
from onebend.recording.bags.topics import guess
from onebend.recording.toml.source_entries import VideoEntry
from onebend.recording.video import Picture, decoded, frame_count, picture_in
from onebend.records import Array, IntArray

BoardKind = Literal["chessboard", "charuco"]

SEARCHED_FRAMES = 240  # frames of a film, evenly spread
_BURST = 0.35  # s, of which the sharpest frame counts
_FEWEST_CORNERS = 8
_RATE = 30.0  # frames/s, where a film does not say
_MOST_PIXELS = 1_000_000  # of a picture in which a chessboard is first looked for; refined in the whole one


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


def opencv() -> Any:
    """The module `cv2`.

    Raises:
        MissingPackageError: it is not installed.
    """
    return package("cv2", "calibrate")


def find_boards(film: Path, board: Board, *, topic: str = "", progress: Progress = Silent()) -> BoardFilm:
    """The board in frames spread over the film; of each few neighbours the sharpest. `topic`: of the images in a bag.

    Raises:
        RecordingError: no OpenCV, not a film, a bag without its topic, a picture that changes its size, an unknown
            dictionary.
    """
    cv2 = opencv()
    find = _finder(cv2, board)
    video = _film_of(film, topic)
    count = frame_count(video) or 0
    every = max(1, count // SEARCHED_FRAMES)
    size: tuple[int, int] | None = None
    views: list[BoardView] = []
    burst: list[BoardView] = []
    looked, boards, begin = 0, 0, 0.0
    progress.start("looking for the board", count // every if count else None)
    try:
        for index, now, raw in _timed(video):
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
                if burst and now - begin > _BURST:
                    views += _sharpest(burst)
                    burst = []
                begin = begin if burst else now
                burst.append(BoardView(index, corners[0], corners[1], _sharpness(cv2, picture, corners[1])))
            progress.advance()
    finally:
        progress.done()
    assert size is not None  # a film without frames is an error of `decoded`
    return BoardFilm(size[1], size[0], (*views, *_sharpest(burst)), looked, boards)


def _film_of(film: Path, topic: str) -> VideoEntry:
    """The film, or the topic of a bag."""
    bag = is_bag(film)
    if bag and not topic:
        contents = open_bag(film)
        likely = guess(contents, "image")
        hint = f" Add --topic {likely}." if likely else ""
        raise RecordingError(f"{film} is a bag that holds {listed(contents)}.{hint}")
    if topic and not bag:
        raise RecordingError(f"{film} is no bag and has no topics. Leave out --topic.")
    return VideoEntry(film, topic=topic)


def _timed(video: VideoEntry) -> Iterator[tuple[int, float, Any]]:
    """Index, time [s] and raw picture of every frame; a film without times counts as 30 frames/s."""
    if video.topic:
        for index, (time, message) in enumerate(bag_frames(video)):
            yield index, time, message
    else:
        for index, frame in enumerate(decoded(video.file)):
            yield index, index / _RATE if frame.time is None else float(frame.time), frame


def _sharpest(burst: list[BoardView]) -> list[BoardView]:
    """The one view to keep of a few neighbours."""
    return [max(burst, key=lambda view: (view.sharpness, len(view.number)))] if burst else []


Seen = tuple[IntArray, Array]


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
        if numbers is None or len(numbers) < _FEWEST_CORNERS:
            return None
        return np.asarray(numbers, dtype=np.int64).ravel(), np.asarray(corners, dtype=float).reshape(-1, 2)

    return find


def _chessboard(cv2: Any, board: Board, picture: Picture) -> Seen | None:
    """All inner corners; looked for in a smaller picture, refined in this one."""
    shrink = min(1.0, float(np.sqrt(_MOST_PIXELS / picture.size)))
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
