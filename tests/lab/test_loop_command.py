"""`onebend loop`: simulations on beams that are not the model."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Uniform
from onebend.cli import app
from onebend.results.control_files import LOOP_COLUMNS
from onebend.results.model import save_model
from tests import made_up

BEAM = Beam(0.12, Powers((0.03, -0.015)), mass_per_length=Uniform(0.05))
GOAL = BEAM.equilibrium((-0.05, 0.3)).xy(1.0)


@pytest.mark.slow
def test_command_says_margins_and_writes_the_simulations(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    goal = [f"{value:.6g}" for value in GOAL]
    command = [
        "loop",
        str(tmp_path / "model.json"),
        "--goal",
        *goal,
        "--duration-s",
        "2",
        "--k-error",
        "0.2",
        "--delay-ms",
        "60",
    ]
    done = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["delay_s"] == 0.06
    assert said["margins"]["gain"] > 2.0
    assert [one["k_factor"] for one in said["trials"]] == [1.0, 0.8, 1.2]
    with (tmp_path / "out" / "loop.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == LOOP_COLUMNS
    last = [row for row in rows if row["k_factor"] == "0.8"][-1]
    np.testing.assert_allclose([float(last["x_m"]), float(last["y_m"])], GOAL, atol=4e-3)
    assert (tmp_path / "out" / "loop.png").read_bytes().startswith(b"\x89PNG")


def test_gravity_needs_a_mass_and_draws_need_a_band(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", Beam(BEAM.length, BEAM.stiffness), written_by="a test")
    asked = ["loop", str(tmp_path / "model.json"), "--goal", *map(str, GOAL)]
    for more, words in (
        (["--gravity-m-s2", "0", "-9.81"], "the model has no mass"),
        (["--draws", "2"], "no band to draw beams from"),
    ):
        done = CliRunner().invoke(app, [*asked, *more])
        assert done.exit_code == 2
        assert words in " ".join(done.output.split())


def test_the_command_simulates_drawn_beams(tmp_path: Path) -> None:
    fit = made_up.posterior()
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    goal = fit.beam.equilibrium((0.0, 0.02)).xy(1.0)
    asked = ["--goal", *map(str, goal), "--draws", "1", "--duration-s", "2", "--noise-mm", "0", "--fps", "10"]
    done = CliRunner().invoke(app, ["loop", str(tmp_path / "model.json"), *asked, "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "drawn, " in done.stdout
    said = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert [one["drawn"] for one in said["trials"]] == [False, True]
