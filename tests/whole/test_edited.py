"""Results that were edited or mixed by hand are said to be, wherever they are read; a film is whole or absent."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend import cli, load_model, load_observations, load_uncertain
from onebend.cli import learning as learning_commands
from onebend.files.publish import changed_files, read_summary, sha256_of
from onebend.lab import commands as filming_commands
from onebend.report.pictures import Pictures
from onebend.results.model import read_model, save_model
from onebend.results.observations_file import save_observations
from tests import made_up

EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam" / "train"


def run(*arguments: object) -> Any:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments])


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A results folder, of the bundled recording by its files and of made-up findings by its content."""
    found = made_up.findings(1)
    monkeypatch.setattr(learning_commands, "learn_from", lambda *_, **__: found)
    monkeypatch.setattr(learning_commands, "draw_all", lambda *_, **__: Pictures())
    result = run("learn", EXAMPLE, "-o", tmp_path / "out", "--clamp-sd-deg", "0.5", "--quiet")
    assert result.exit_code == 0, result.output
    return tmp_path / "out"


def change(file: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    data = json.loads(file.read_text(encoding="utf-8"))
    edit(data)
    file.write_text(json.dumps(data), encoding="utf-8")


def test_a_summary_says_what_the_results_are_made_from(out: Path) -> None:
    summary = read_summary(out)
    assert summary is not None
    assert changed_files(out) == []
    for name, checksum in summary["files"].items():
        assert checksum == (None if name == "summary.json" else sha256_of(out / name))
    source = summary["provenance"]
    inputs = {Path(one["file"]).name: one for one in source["inputs"]}
    assert set(inputs) == {"recording.toml", "video.mp4", "force.csv"}
    for name, one in inputs.items():
        assert one["sha256"] == sha256_of(EXAMPLE / name)
        assert one["bytes"] == (EXAMPLE / name).stat().st_size
    assert source["versions"]["numpy"] == np.__version__
    assert source["options"]["clamp_sd_deg"] == 0.5
    assert source["settings"]["fit"]["clamp_sd"] == pytest.approx(np.deg2rad(0.5))
    assert source["command"][0] == "onebend"
    assert source["changed_meanwhile"] == []


def test_a_file_that_changes_while_it_is_read_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = tmp_path / "rec"
    shutil.copytree(EXAMPLE, recording)

    def learn_from(*_: object, **__: object) -> Any:
        with (recording / "force.csv").open("a") as file:
            file.write("\n")
        return made_up.findings(0)

    monkeypatch.setattr(learning_commands, "learn_from", learn_from)
    monkeypatch.setattr(learning_commands, "draw_all", lambda *_, **__: Pictures())
    result = run("learn", recording, "-o", tmp_path / "out", "--quiet")
    assert result.exit_code == 0, result.output
    assert f"{recording / 'force.csv'} was changed while it was read" in result.stderr.replace("\n", "")


def without_doubts(data: dict[str, Any]) -> None:
    del data["uncertain"]["doubts"]


def softer(data: dict[str, Any]) -> None:
    data["beam"]["mass_per_length_kg_m"] = {"kind": "uniform", "value": 9.0}


def without_checksum(data: dict[str, Any]) -> None:
    del data["sha256"]


def older(data: dict[str, Any]) -> None:
    data["version"] = 2


@pytest.mark.parametrize("edit", [without_doubts, softer, without_checksum, older])
def test_an_edited_model_is_not_trusted(tmp_path: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    fit = made_up.posterior()
    doubted = replace(fit.stiffness, doubts=("the fit did not converge",))
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=doubted)
    change(tmp_path / "model.json", edit)
    stored = read_model(tmp_path)
    assert stored.changed
    assert stored.uncertain is not None
    assert not stored.uncertain.band(np.linspace(0.0, 1.0, 11)).identified.any()
    with pytest.warns(UserWarning, match="was changed after onebend wrote it"):
        load_model(tmp_path)
    with pytest.warns(UserWarning, match="was changed after onebend wrote it"):
        load_uncertain(tmp_path)
    for command in (["show"], ["export", "--to", "numpy", "-o", tmp_path / "n.npz"]):
        result = run(command[0], tmp_path, *command[1:])
        assert result.exit_code == 0
        assert "was changed after onebend wrote it" in result.stderr


def test_writing_it_anew_with_spaces_is_no_edit(tmp_path: Path) -> None:
    fit = made_up.posterior()
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    change(tmp_path / "model.json", lambda _: None)
    assert read_model(tmp_path).changed == ""


def test_an_edited_model_of_an_old_version_is_known_by_its_summary(out: Path) -> None:
    def as_before(data: dict[str, Any]) -> None:
        del data["sha256"]
        data["version"] = 3
        data["uncertain"].pop("doubts", None)
        data.pop("setup", None)

    change(out / "model.json", as_before)
    with pytest.warns(UserWarning, match="is not the file that the run of this folder wrote"):
        load_model(out)
    assert "is not the file that the run of this folder wrote" in run("show", out).stderr


def test_the_model_of_one_run_beside_the_summary_of_another(out: Path) -> None:
    save_model(out / "model.json", made_up.BEAM, written_by="a test")
    with pytest.warns(UserWarning, match="is not the file that the run of this folder wrote"):
        load_model(out)


def test_observations_of_another_run(out: Path) -> None:
    load_observations(out)
    data = (out / "observations.parquet").read_bytes()
    (out / "summary.json").write_text((out / "summary.json").read_text().replace("  ", " "))  # no edit
    load_observations(out)
    save_observations(out / "observations.parquet", made_up.observations("another"))
    assert (out / "observations.parquet").read_bytes() != data
    with pytest.warns(UserWarning, match="is not the file that the run of this folder wrote"):
        load_observations(out)


def test_an_edited_folder_is_not_replaced_by_force(out: Path) -> None:
    change(out / "model.json", softer)
    result = run("learn", EXAMPLE, "-o", out, "--force", "--quiet")
    assert result.exit_code == 2
    assert "model.json there is not as the earlier run left it" in result.stderr


LONG = '{"format": "onebend-model", "version": 4, "beam": {"length_m": 1' + "0" * 400 + "}}"


@pytest.mark.parametrize("text", ["1" * 5000, '{"format": ' + "9" * 5000 + "}", LONG])
def test_numbers_without_end_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "model.json").write_text(text)
    result = run("show", tmp_path)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("onebend: ")


@pytest.mark.parametrize("ends", [KeyboardInterrupt(), OSError(28, "No space left on device"), MemoryError()])
def test_a_film_is_whole_or_absent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: BaseException) -> None:
    def half(_: object, folder: Path, **__: object) -> None:
        (folder / "video.mp4").write_bytes(b"half a film")
        raise ends

    monkeypatch.setattr(filming_commands, "make_film", half)
    result = run("film", "cubic", "-o", tmp_path / "film", "--quiet")
    assert result.exit_code != 0
    assert list(tmp_path.iterdir()) == []


def test_a_film_goes_into_no_folder_that_holds_something(tmp_path: Path) -> None:
    (tmp_path / "film").mkdir()
    (tmp_path / "film" / "thesis.tex").write_text("three years")
    result = run("film", "cubic", "-o", tmp_path / "film", "--quiet")
    assert result.exit_code == 2
    assert [path.name for path in tmp_path.rglob("*")] == ["film", "thesis.tex"]
