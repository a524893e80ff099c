"""The command that calibrates a camera."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, get_args

import typer

from onebend.cli import BY
from onebend.cli.common import clean_errors, print_json, progress_of, screen
from onebend.cli.options import Json, Overwrite, Quiet
from onebend.errors import RecordingError
from onebend.files.single_file import check_name_free, write_file
from onebend.recording.calibration.boards import Board, BoardKind
from onebend.recording.calibration.intrinsics import calibrate as calibrate_camera
from onebend.terminal.calibrating import show_calibration

Film = Annotated[Path, typer.Argument(metavar="VIDEO", help="A film of the board, or a bag, taken as the beam is.")]
BoardOption = Annotated[
    tuple[str, str],
    typer.Option(
        "--board",
        metavar="KIND SIZE",
        help="chessboard 9x6 (its inner corners), or charuco 7x5 (its squares).",
    ),
]
SquareMm = Annotated[float, typer.Option("--square-mm", metavar="MM", help="Side of a square, measured on the print.")]
MarkerMm = Annotated[
    float | None,
    typer.Option("--marker-mm", metavar="MM", help="Side of a ChArUco board's tags; default: 3/4 of a square."),
]
Dictionary = Annotated[str, typer.Option(metavar="NAME", help="Of a ChArUco board's tags, such as 5x5_100.")]
ImageTopic = Annotated[str, typer.Option("--topic", metavar="NAME", help="Of the images, where VIDEO is a bag.")]
MostViews = Annotated[int, typer.Option("--views", min=4, metavar="N", help="At most so many views are used.")]
CameraFile = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Where the table of the camera goes.")]

CALIBRATE_FORMAT = "onebend-calibrate-1"


def calibrate(
    video: Film,
    *,
    board: BoardOption,
    square: SquareMm,
    marker: MarkerMm = None,
    dictionary: Dictionary = "5x5_100",
    topic: ImageTopic = "",
    views: MostViews = 30,
    output: CameraFile = Path("camera.toml"),
    overwrite: Overwrite = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate the camera from a film of a board, and write the table of the camera for recording.toml."""
    with clean_errors():
        wanted = _board(board, square, marker, dictionary)
        check_name_free(output, overwrite=overwrite)
        with progress_of(quiet) as progress:
            found = calibrate_camera(video, wanted, topic=topic, most_views=views, progress=progress)
        write_file(output, found.camera_table(), overwrite=overwrite)
    if as_json:
        said = {
            "format": CALIBRATE_FORMAT,
            "written_by": BY,
            "video": str(video),
            "topic": topic or None,
            **found.as_dict(),
        }
        print_json({**said, "output": str(output)})
    else:
        show_calibration(screen(), found, output)


def _board(board: tuple[str, str], square: float, marker: float | None, dictionary: str) -> Board:
    """From what was typed."""
    kind, size = board
    kinds: dict[str, BoardKind] = {one: one for one in get_args(BoardKind)}
    if kind not in kinds:
        raise RecordingError(f"There is no board {kind!r}. Known: {', '.join(kinds)}")
    sides = re.fullmatch(r"(\d{1,3})x(\d{1,3})", size)
    if sides is None:
        raise RecordingError(f"The board's size is written as 9x6, got {size!r}")
    side = float("nan") if marker is None else marker / 1000.0
    return Board(kinds[kind], int(sides[1]), int(sides[2]), square / 1000.0, side, dictionary)
