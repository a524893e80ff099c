"""Virtual recordings as folders of marker tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.recording.folder import read_recording
from onebend.recording.tracks import track_markers


def test_film_without_pixels_is_a_recording_with_its_truth(tmp_path: Path) -> None:
    words = ["film", "linear", "--markers", "--fps", "5", "--seconds", "2", "--sensor", "ideal", "-q"]
    for folder in ("one", "same"):
        assert CliRunner().invoke(app, [*words, "-o", str(tmp_path / folder)]).exit_code == 0
    markers = track_markers(read_recording(tmp_path / "one"))
    at_rest = markers.xy[0]
    assert np.abs(at_rest[:, 0] - 0.15 * markers.s).max() < 2e-4
    assert np.abs(markers.xy - at_rest).max() > 0.02
    with np.load(tmp_path / "one" / "truth" / "truth.npz") as truth:
        assert truth["k"][0] > truth["k"][-1] > 0.0 or truth["k"][-1] > truth["k"][0] > 0.0
    for file in ("markers.csv", "force.csv"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "same" / file).read_bytes()


@pytest.mark.parametrize(
    ("more", "said"), [(["--push", "free"], "swings the beam"), (["--gravity-m-s2", "9.81"], "gravity in the plane")]
)
def test_what_markers_cannot_show_is_refused(tmp_path: Path, more: list[str], said: str) -> None:
    found = CliRunner().invoke(app, ["film", "linear", "--markers", "-q", "-o", str(tmp_path / "x"), *more])
    assert found.exit_code == 2
    assert said in found.stderr
    assert not (tmp_path / "x").exists()
