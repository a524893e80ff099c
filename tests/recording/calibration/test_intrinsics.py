"""A camera from a film of a board: the known one found back, sds that hold, and a clear word on bad films."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.errors import MissingPackageError, RecordingError
from onebend.extras import package
from onebend.recording import calibration as boards
from onebend.recording.calibration import Board, Calibration, calibrate, find_boards, spread
from tests.recording.board_film import CHARUCO, CHESS, DIST, HEIGHT, MATRIX, WIDTH, film, poses, view

TRUE = np.array([MATRIX[0, 0], MATRIX[1, 1], MATRIX[0, 2], MATRIX[1, 2], *DIST])


def shown(path: Path, board: Board, count: int, *, tilt: float = 0.7) -> Path:
    """A pose a frame, twice a second, with noise."""
    rng = np.random.default_rng(1)
    pictures = []
    for turn, place in poses(count, seed=3, tilt=tilt):
        one = view(board, turn, place)
        pictures.append(one + 1.5 * rng.standard_normal(one.shape))
    return film(path, pictures)


@pytest.fixture(scope="module")
def chess_film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shown(tmp_path_factory.mktemp("chess") / "board.mp4", CHESS, 14)


@pytest.fixture(scope="module")
def found(chess_film: Path) -> Calibration:
    return calibrate(chess_film, CHESS)


def check(found: Calibration) -> None:
    """Near the truth, in pixels and in sd."""
    away = found.values[:8] - TRUE
    assert np.all(np.abs(away[:4]) < 3.0)
    assert np.all(np.abs(away) < 5.0 * found.sd[:8])
    assert found.sd[0] < 3.0
    assert found.error < 0.25
    assert (found.width, found.height) == (WIDTH, HEIGHT)


def test_a_chessboard_gives_the_camera_back(found: Calibration) -> None:
    check(found)
    assert found.coverage > 0.6
    assert found.turned > np.deg2rad(50)
    assert len(found.frames) >= 10
    assert found.values[8] == 0.0  # the lens has no k3
    assert not [one for one in found.remarks if one.level == "warning"]


def test_the_table_is_what_a_recording_reads(found: Calibration) -> None:
    camera = tomllib.loads(found.camera_table())["camera"]
    assert set(camera) == {"width", "height", "fx", "fy", "cx", "cy", "dist"}
    assert camera["fx"] == pytest.approx(found.values[0], abs=1e-3)
    assert camera["dist"] == pytest.approx(found.values[4:8], abs=1e-6)


def test_pixels_through_the_found_camera_meet_the_true_ones(found: Calibration) -> None:
    cv2 = package("cv2", "calibrate")
    rays = np.array([[x, y, 1.0] for x in np.linspace(-0.35, 0.35, 9) for y in np.linspace(-0.25, 0.25, 7)])
    matrix = np.array([[found.values[0], 0, found.values[2]], [0, found.values[1], found.values[3]], [0, 0, 1]])
    still = np.zeros(3)
    true = cv2.projectPoints(rays, still, still, MATRIX, DIST)[0]
    ours = cv2.projectPoints(rays, still, still, matrix, found.dist)[0]
    shift = ours[:, 0] - true[:, 0]
    assert np.abs(shift - shift.mean(axis=0)).max() < 1.0  # a shift of all is a turn of the camera


@pytest.mark.slow
def test_of_each_burst_the_sharp_frame_counts(tmp_path: Path) -> None:
    cv2 = package("cv2", "calibrate")
    pictures = []
    for turn, place in poses(2, seed=5):
        one = view(CHESS, turn, place)
        pictures += [cv2.GaussianBlur(one, (0, 0), sd) if sd else one for sd in (2.0, 0.0, 1.5, 1.0)]
    seen = find_boards(film(tmp_path / "a.mp4", pictures, rate=10), CHESS)
    assert [one.frame for one in seen.views] == [1, 5]
    assert (seen.frames_searched, seen.frames_found) == (8, 8)


@pytest.mark.slow
def test_views_that_repeat_are_left_for_those_that_differ(chess_film: Path) -> None:
    seen = find_boards(chess_film, CHESS)
    again = boards.BoardFilm(seen.width, seen.height, (*seen.views, *seen.views[:1] * 20), 40, 40)
    frames = [one.frame for one in spread(package("cv2", "calibrate"), again, CHESS, 8)]
    assert len(set(frames)) == 8


def test_views_that_are_all_alike_are_warned_of(tmp_path: Path) -> None:
    found = calibrate(shown(tmp_path / "flat.mp4", CHESS, 5, tilt=0.05), CHESS)
    said = " ".join(one.text for one in found.remarks if one.level == "warning")
    assert "views are alike" in said
    assert "different sharp views" in said
    assert "# All views are alike" in found.camera_table()
    assert np.abs(found.values[0] - TRUE[0]) < 4.0 * found.sd[0]


def test_what_cannot_be_calibrated_is_refused(
    tmp_path: Path, chess_film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = film(tmp_path / "empty.mp4", [np.full((HEIGHT, WIDTH), 120.0)] * 5)
    with pytest.raises(RecordingError, match="found in 0 of 5 frames"):
        calibrate(empty, CHESS)
    with pytest.raises(RecordingError, match="four sides"):
        Board("chessboard", 6, 6, 0.02)
    with pytest.raises(RecordingError, match="too small"):
        Board("charuco", 2, 6, 0.02)
    with pytest.raises(RecordingError, match="smaller than it"):
        Board("charuco", 7, 6, 0.02, 0.03)
    with pytest.raises(RecordingError, match="no dictionary '9x9'"):
        calibrate(empty, Board("charuco", 7, 6, 0.02, dictionary="9x9"))
    with pytest.raises(RecordingError, match="too few tags"):
        calibrate(empty, Board("charuco", 12, 12, 0.02, dictionary="4x4_50"))
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'onebend\[calibrate\]'"):
        calibrate(chess_film, CHESS)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], env={"COLUMNS": "160"})


def test_the_command_writes_the_table_and_replaces_none_unasked(
    found: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "camera.toml"
    monkeypatch.setattr("onebend.cli.recordings.calibrate_camera", lambda *_, **__: found)
    asked = ["calibrate", "board.mp4", "--board", "chessboard", "8x5", "--square-mm", "20", "-o", out, "-q"]
    said = run(*asked)
    assert said.exit_code == 0, said.output
    assert "views; corners 0." in said.stdout
    assert found.camera_table() in said.stdout
    assert out.read_text(encoding="utf-8") == found.camera_table()
    assert (run(*asked).exit_code, run(*asked, "--force").exit_code) == (2, 0)
    assert '"coverage"' in run(*asked, "--force", "--json").stdout
    for kind, size, word in (("checkers", "9x6", "Known: chessboard, charuco"), ("charuco", "9by6", "written as 9x6")):
        wrong = run("calibrate", "b.mp4", "--board", kind, size, "--square-mm", "20", "-q")
        assert (wrong.exit_code, word in wrong.stderr) == (2, True)


@pytest.mark.slow
def test_a_charuco_board_in_a_process_of_its_own_ends_well(tmp_path: Path) -> None:
    made = shown(tmp_path / "charuco.mp4", CHARUCO, 10)
    out = tmp_path / "camera.toml"
    command = [sys.executable, "-m", "onebend", "calibrate", str(made), "--board", "charuco", "8x6"]
    rest = ["--square-mm", "20", "-o", str(out), "-q"]
    done = subprocess.run([*command, *rest], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # OpenCV's tag detector and ours share the process
    camera = tomllib.loads(out.read_text(encoding="utf-8"))["camera"]
    assert camera["fx"] == pytest.approx(TRUE[0], abs=8.0)
    assert camera["cx"] == pytest.approx(TRUE[2], abs=8.0)
