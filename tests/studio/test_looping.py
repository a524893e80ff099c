"""The room Loop: what it plays is what `onebend loop` simulates."""

from __future__ import annotations

import csv
import io
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from onebend.cli import app
from onebend.control.reach import reach
from onebend.errors import ControlError, StudioError
from onebend.results.model import read_model
from onebend.studio import looping
from onebend.studio.bending import beam_data
from onebend.studio.looping import MOST_MOMENTS
from onebend.studio.places import StudioFolder
from onebend.studio.requests import loop
from onebend.studio.words import Asked
from tests.studio.conftest import done_here, own
from tests.studio.test_recordings import ended


def asked_for(folder: Path, **more: Any) -> Asked:
    goal = beam_data(StudioFolder.of(folder), Asked(name="beam"))["goal_m"]
    return Asked({"model": "beam", "goal_m": goal, "duration_s": 2, **more})


def test_a_beam_is_shown_with_a_goal_that_it_reaches(client: TestClient, folder: Path) -> None:
    found = client.get("/api/beam", params={"name": "beam"}).json()
    beam = read_model(folder / "beam").beam
    assert found["length_m"] == beam.length
    assert np.allclose(found["rest_m"][-1], beam.equilibrium((0.0, 0.0)).xy(1.0), atol=1e-6)
    assert found["band"]
    assert reach(beam, np.array(found["goal_m"])).converged
    assert client.get("/api/beam", params={"name": "../beam"}).status_code == 422


def test_what_is_played_is_what_the_command_writes(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    wanted = loop(StudioFolder.of(folder), asked_for(folder, k_error=0, delay_ms=40, fps=15, noise_mm=0.1))
    told = done_here(looping.work, wanted)
    trials = [one["found"]["trial"] for one in told if "trial" in one.get("found", {})]
    (control,) = [one["found"]["control"] for one in told if "control" in one.get("found", {})]
    words = [*shlex.split(wanted["command"])[1:], "--json", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert control["force_N"] == said["feedforward_N"]
    assert control["gain"] == said["margins"]["gain"]
    assert [one["factor"] for one in trials] == [one["k_factor"] for one in said["trials"]]
    assert [one["name"] for one in trials] == ["as the model"]
    assert [one["steady_m"] for one in trials] == [one["steady_m"] for one in said["trials"]]
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "loop.csv").read_text(encoding="utf-8"))))
    for trial in trials:
        own_rows = [row for row in rows if float(row["k_factor"]) == pytest.approx(trial["factor"], rel=1e-6)]
        assert len(trial["time_s"]) == min(MOST_MOMENTS, len(own_rows))
        assert np.allclose(trial["force_N"][-1], [float(own_rows[-1][f"force_{axis}_N"]) for axis in "xy"], atol=1e-6)
        assert np.allclose(trial["axis_m"][-1][-1], [float(own_rows[-1][f"{axis}_m"]) for axis in "xy"], atol=2e-5)


def test_what_can_be_reached_is_shown(working: TestClient, folder: Path) -> None:
    asked = {"model": "beam", "push_s": 1.0, "point_s": 0.9, "max_force_N": 0.3}
    found = working.post("/api/reach", json=asked, headers=own()).json()
    points = np.array(found["points_m"])
    near = read_model(folder / "beam").beam.equilibrium((0.1, 0.2)).xy(0.9)
    assert np.min(np.linalg.norm(points - near, axis=1)) < 0.01
    assert found["triangles"]
    for wrong in ({"model": "../beam"}, {"point_s": 2}, {"max_force_N": -1}, {"push_s": "x"}):
        assert working.post("/api/reach", json=asked | wrong, headers=own()).status_code == 422


@pytest.mark.parametrize(
    "more",
    [
        {"goal_m": [1]}, {"goal_m": "x"}, {"goal_m": [float("nan"), 0]}, {"goal_m": [True, 0]}, {"delay_ms": -1},
        {"delay_ms": float("nan")}, {"fps": 0}, {"duration_s": 1}, {"duration_s": 1e9}, {"k_error": 1}, {"draws": 9},
        {"draws": "3"}, {"push_s": 0}, {"max_force_N": 0}, {"noise_mm": None}, {"model": "../beam"},
        {"model": "hung weights"},
    ],
)  # fmt: skip
def test_what_has_no_meaning_is_refused(folder: Path, more: dict[str, Any]) -> None:
    with pytest.raises(StudioError):
        loop(StudioFolder.of(folder), asked_for(folder, **more))


def test_what_is_asked_is_in_the_command(folder: Path) -> None:
    more = {"draws": 4, "push_s": 0.8, "point_s": 0.9, "max_force_N": 2.5, "delay_ms": 60.5}
    command = loop(StudioFolder.of(folder), asked_for(folder, **more))["command"]
    for words in ("--draws 4", "--push-at 0.8", "--point 0.9", "--max-force-N 2.5", "--delay-ms 60.5"):
        assert words in command
    assert "--k-error" not in command


def test_a_goal_out_of_reach_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with pytest.raises(ControlError):
        done_here(looping.work, loop(StudioFolder.of(folder), asked_for(folder, goal_m=[5.0, 5.0])))


@pytest.mark.slow
def test_a_simulation_is_stopped(working: TestClient, folder: Path) -> None:
    asked = asked_for(folder, duration_s=600)
    assert working.post("/api/work/loop/start", json=asked, headers=own()).status_code == 200
    assert working.post("/api/work/loop/stop", json={}, headers=own()).status_code == 200
    stopped = ended(working, "loop")["job"]
    assert stopped["state"] == "stopped"
    assert stopped["goal_m"] == asked["goal_m"]
