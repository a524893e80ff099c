"""`onebend shape` and `onebend path`: from a model and a CSV to folders of files; clear words where it cannot be."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.beam.model import Beam
from onebend.results.model import save_model
from tests.control.shape.test_shape import S, band, gripped

KNOWN = band(0.01, 0.03)
BEAM = Beam(0.15, KNOWN.profile)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], env={"COLUMNS": "200"})


@pytest.fixture
def model(tmp_path: Path) -> Path:
    save_model(tmp_path / "model.json", BEAM, written_by="a test", uncertain=KNOWN)
    return tmp_path / "model.json"


@pytest.fixture
def targets(tmp_path: Path) -> Path:
    file, wanted = tmp_path / "targets.csv", gripped(np.array([0.2, 0.3, -0.02]), S, BEAM)
    rows = [f"{s:.9g},{x:.12g},{y:.12g}\n" for s, (x, y, _) in zip(S, wanted, strict=True)]
    file.write_text("s,x_m,y_m\n" + "".join(rows), encoding="utf-8")
    return file


@pytest.fixture
def goals(tmp_path: Path) -> Path:
    file = tmp_path / "goals.csv"
    xy = BEAM.equilibrium(np.stack([np.zeros(5), np.linspace(0.1, 0.3, 5)], axis=1)).xy(1.0)
    rows = [f"{0.1 * i:.3g},{x:.12g},{y:.12g}\n" for i, (x, y) in enumerate(xy)]
    file.write_text("time_s,x_m,y_m\n" + "".join(rows), encoding="utf-8")
    return file


def test_a_gripper_for_a_shape(model: Path, targets: Path, tmp_path: Path) -> None:
    done = run("shape", model, "--targets", targets, "--grip", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    for words in ("gripper", "they are met", "margin", "from the band on k(s)"):
        assert words in done.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert set(summary["files"]) == {"shape.csv", "shape.png", "summary.json", "targets.csv"}
    wanted = gripped(np.array([0.2, 0.3, -0.02]), S, BEAM)[-1]
    np.testing.assert_allclose(list(summary["gripper_pose"].values()), wanted, atol=1e-7)
    with (tmp_path / "out" / "targets.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(S)
    assert rows[0]["wanted_angle_rad"] == ""
    assert (tmp_path / "out" / "shape.png").read_bytes().startswith(b"\x89PNG")


def test_bounded_pushes_for_a_script(model: Path, targets: Path) -> None:
    asked = ("--push-at", "0.5", "--push-at", "1", "--max-force-N", "0.1", "--json")
    data = json.loads(run("shape", model, "--targets", targets, *asked).stdout)
    assert data["format"] == "onebend-shape-1"
    assert np.all(np.linalg.norm(data["force_N"], axis=1) <= 0.1 * (1.0 + 1e-9))
    assert data["limits"]
    assert data["gripper_pose"] is None


def test_a_path_with_a_limit(model: Path, goals: Path, tmp_path: Path) -> None:
    asked = ("--point", "1.0", "--push-at", "1.0", "--rate-Hz", "100", "--max-force-rate-N-per-s", "0.2")
    done = run("path", model, "--goals", goals, *asked, "-o", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "times the goals'" in done.stdout
    with (tmp_path / "out" / "path.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    force = np.array([[float(row["force_1_x_N"]), float(row["force_1_y_N"])] for row in rows])
    assert np.max(np.linalg.norm(np.diff(force, axis=0), axis=1)) * 100.0 <= 0.2 * (1.0 + 1e-6)
    np.testing.assert_allclose(force[[0, -1]], [[0.0, 0.1], [0.0, 0.3]], atol=1e-6)
    assert (tmp_path / "out" / "push_1_wrench.yaml").is_file()
    again = run("path", model, "--goals", goals, *asked, "-o", tmp_path / "out")
    assert again.exit_code == 2
    assert "already holds results" in again.stderr.replace("\n", " ")


@pytest.mark.parametrize(
    ("limit", "value"), [("--max-speed-m-per-s", 0.001), ("--max-turn-rate-deg-per-s", 1), ("--max-moment-N-m", 0.1)]
)
def test_a_limit_of_a_gripper_that_is_not_there_is_refused(model: Path, goals: Path, limit: str, value: float) -> None:
    told = run("path", model, "--goals", goals, limit, value)
    assert told.exit_code == 2
    assert f"{limit} limits a gripper, and there is none: add --grip" in told.stderr


def test_gravity_in_another_unit_is_refused(model: Path, targets: Path) -> None:
    told = run("shape", model, "--targets", targets, "--gravity-m-s2", 0, -9810)
    assert told.exit_code == 2
    assert "9810 m/s^2" in told.stderr


@pytest.mark.parametrize(("row", "words"), [("1,140,50", "in millimetres"), ("1,-0.2,0.1", "nothing near the targets")])
def test_targets_that_no_shape_comes_near_are_an_error(model: Path, tmp_path: Path, row: str, words: str) -> None:
    file = tmp_path / "far.csv"
    file.write_text(f"s,x_m,y_m\n{row}\n0.5,0.2,0\n", encoding="utf-8")
    done = run("shape", model, "--targets", file, "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_model_in_doubt_is_warned_of(model: Path, targets: Path, tmp_path: Path) -> None:
    doubted = replace(KNOWN, doubts=("the fit did not converge",))
    save_model(tmp_path / "doubted.json", BEAM, written_by="a test", uncertain=doubted)
    done = run("shape", tmp_path / "doubted.json", "--targets", targets, "--json")
    assert "NOT TO BE TRUSTED: the fit did not converge" in done.stderr
    assert json.loads(done.stdout)
    assert "TRUSTED" not in run("shape", model, "--targets", targets, "--json").stderr


def test_a_value_out_of_range_is_named_with_its_option(model: Path, goals: Path) -> None:
    for option, value in (("--push-at", "0"), ("--push-at", "nan"), ("--rate-Hz", "0"), ("--max-force-N", "-1")):
        done = run("path", model, "--goals", goals, option, value)
        assert done.exit_code == 2, option
        assert option in done.stderr


def test_a_bad_file_is_named_with_its_line(model: Path, goals: Path) -> None:
    goals.write_text(goals.read_text(encoding="utf-8").replace("0.2,", "half,"), encoding="utf-8")
    done = run("path", model, "--goals", goals)
    assert done.exit_code == 2
    assert "goals.csv, line 4: time_s is 'half', not a number" in done.stderr.replace("\n", " ")
