"""A camera's focal length, principal point and lens from views of a board, with their sds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import RecordingError
from onebend.progress import Progress, Silent
from onebend.recording.calibration.boards import Board, BoardFilm, BoardView, find_boards, opencv
from onebend.records import Array, IntArray, Remark

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")

_FEWEST, _ENOUGH = 4, 10  # views: below, no calibration; below, a warning
_GROUPS = 8  # of views, each left out once: the spread of the results gives the sd
_CELLS = (8, 6)  # of the picture, across and down, in which corners are counted
_COVERED = 0.5  # of the cells; less is a warning
_TURNED = np.deg2rad(25.0)  # between two of the board's directions; less is a warning
_FOCAL_SD = 0.01  # of the focal length; more is a warning
_MISFIT = 1.0  # px; a larger error is a warning
_WRONG = 3.0  # times the median of the views' errors: such a view is left out
_NEEDED = 3.0  # sd that k3 must differ from 0 by


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
    cv2 = opencv()
    board_film = find_boards(film, board, topic=topic, progress=progress)
    if len(board_film.views) < _FEWEST:
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
    good = [v for v, e in zip(views, first.errors, strict=True) if e <= _WRONG * float(np.median(first.errors))]
    fitted = _fit(cv2, film, board, good, k3=False)
    sd = _spread_of_groups(cv2, film, board, good, fitted, k3=False, progress=progress)
    richer = _fit(cv2, film, board, good, k3=True)
    progress.advance()
    if abs(richer.values[8]) > _NEEDED * richer.sd[8] and richer.error < 0.97 * fitted.error:
        fitted = richer
        sd = _spread_of_groups(cv2, film, board, good, fitted, k3=True, progress=Silent())
    pixel = np.concatenate([view.pixel for view in good])
    across, down = (np.clip((pixel[:, i] + 0.5) / n * c, 0, c - 1).astype(int) for i, n, c in _cells(film))
    coverage = len(np.unique(across * _CELLS[1] + down)) / (_CELLS[0] * _CELLS[1])
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
    return Calibration(**{**vars(calibration), "remarks": _remarks(calibration)})


def _cells(film: BoardFilm) -> tuple[tuple[int, int, int], ...]:
    return ((0, film.width, _CELLS[0]), (1, film.height, _CELLS[1]))


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
    if len(fitted.frames) < _ENOUGH:
        warnings.append(
            f"Only {len(fitted.frames)} different sharp views: film the board longer, and hold it still often."
        )
    if fitted.coverage < _COVERED:
        warnings.append(
            f"The board was seen in {100 * fitted.coverage:.0f} % of the picture: the lens is not known elsewhere. "
            "Show it in the corners too."
        )
    if fitted.turned < _TURNED:
        warnings.append(
            f"All views are alike: the board's directions differ by {np.rad2deg(fitted.turned):.0f} degrees at most: "
            "focal length and distance are hardly distinguishable. Tilt it by 30 degrees or more, each way."
        )
    focal = float(np.max(fitted.sd[:2] / fitted.values[:2]))
    if not focal < _FOCAL_SD:
        warnings.append(
            f"The focal length is known to {100 * focal:.2g} % only (one sd): film more tilts and distances."
        )
    if fitted.error > _MISFIT:
        warnings.append(
            f"The corners are {fitted.error:.2g} px from the model: is the board flat and stiff, the focus fixed, and "
            "--board right?"
        )
    remarks = [Remark("warning", text, about="calibration") for text in warnings]
    if fitted.left_out:
        remarks.append(Remark("note", f"{fitted.left_out} views fitted far worse than the others and were left out."))
    return tuple(remarks)
