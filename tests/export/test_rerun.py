"""A Rerun file, read back by Rerun's own reader."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import MissingPackageError
from onebend.export.rerun_file import write_rerun
from onebend.learning.validation import validate
from onebend.recording.video import FilmFrame
from onebend.results.model import save_model
from tests.learning.bench import SOFT, forces, observed


def contents(path: Path) -> str:
    """What `rerun rrd print` says of the file."""
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_video_tags_beam_forces_and_residuals_are_there(tmp_path: Path) -> None:
    seen = observed(SOFT, forces(6), noise=(1e-4, 1e-3))
    frames = (FilmFrame(i, i / 30, np.full((48, 64), 10 * i, dtype=np.uint8)) for i in range(6))
    write_rerun(tmp_path / "a.rrd", SOFT, validate(SOFT, seen), seen, frames, every=3)
    said = contents(tmp_path / "a.rrd")
    for entity in ("/force/x_N", "/force/y_N", "/stiffness", "/residual/tag_1_mm", "/plane/beam", "/plane/tags"):
        assert entity in said, entity
    assert "/camera/picture" in said
    assert "/camera/beam" not in said  # these observations have no camera
    write_rerun(tmp_path / "b.rrd", SOFT, validate(SOFT, seen), seen)
    assert "/camera/picture" not in contents(tmp_path / "b.rrd")


def test_without_rerun_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    seen = observed(SOFT, forces(3))
    with pytest.raises(MissingPackageError, match=r"pip install 'onebend\[rerun\]'"):
        write_rerun(tmp_path / "a.rrd", SOFT, validate(SOFT, seen), seen)


def test_a_mistake_leaves_no_file(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", SOFT, written_by="a test")
    done = CliRunner().invoke(
        app, ["rerun", str(tmp_path), str(tmp_path / "none"), "-o", str(tmp_path / "x" / "a.rrd")]
    )
    assert done.exit_code == 2
    assert "recording.toml" in done.stderr
    assert list((tmp_path / "x").iterdir()) == []
