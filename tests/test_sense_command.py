"""What `onebend sense` writes, and what it refuses before any work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend.cli import app, learning
from onebend.records import Observations
from onebend.results.model import save_model
from tests.learning.bench import SOFT, forces, observed

SEEN = observed(SOFT, forces(14), noise=(3e-5, 1e-3))


@pytest.fixture
def sense(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """The command on a recording that is read already."""
    save_model(tmp_path / "model.json", SOFT, written_by="a test")

    def observe(*_: object) -> Observations:
        return SEEN

    def no_files(_: object) -> list[object]:
        return []

    monkeypatch.setattr(learning, "_observed", observe)
    monkeypatch.setattr(learning, "recording_files", no_files)

    def run(*options: str) -> Result:
        model, recording = str(tmp_path / "model.json"), str(tmp_path)
        return CliRunner().invoke(app, ["sense", model, recording, "--quiet", *options])

    return run


def test_the_table_is_written_and_written_again(sense: Callable[..., Result], tmp_path: Path) -> None:
    done = sense("-o", str(tmp_path / "out"), "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["output"] == str(tmp_path / "out")
    rows = np.genfromtxt(tmp_path / "out" / "force.csv", delimiter=",", names=True)
    assert np.isfinite(rows["fx_N"]).any()
    again = sense("-o", str(tmp_path / "out"), "--overwrite", "--quiet")
    assert again.exit_code == 0, again.output


def test_a_bad_folder_is_refused_before_the_recording_is_read(
    sense: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_soon(*_: object) -> Observations:
        raise AssertionError("the recording is read")

    monkeypatch.setattr(learning, "_observed", too_soon)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "thesis.tex").write_text("three years")
    for options, said in (((), "is not empty"), (("--overwrite",), "are not replaced")):
        done = sense("-o", str(tmp_path / "taken"), *options)
        assert done.exit_code == 2
        assert said in " ".join(done.output.split())
        assert ("--force" in done.output) == (not options)
