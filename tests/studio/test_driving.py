"""The room Drive: the plan, nothing before Go, what is told meanwhile, and a stop."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.drive import commands, specs
from onebend.drive.run import drive
from onebend.drive.virtual import VirtualCell
from onebend.errors import ControlError, StudioError
from onebend.learning.instruments import instruments_of
from onebend.live.sources import PlayedClock
from onebend.recording.folder import read_recording
from onebend.results.model import StoredModel, model_text
from onebend.studio import requests
from onebend.studio.driving import work
from onebend.studio.jobs import Job
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from tests import made_up
from tests.drive.cells import CellCamera, CellRobot, described, model_of, setup_for
from tests.studio.conftest import done_here


def asked_for(**more: Any) -> Asked:
    x, y = np.asarray(model_of("linear").beam.equilibrium((0.0, 0.1)).xy(1.0)).reshape(2).tolist()
    return Asked(
        {"model": "beam", "like": "like", "robot": "virtual:linear", "out": "driven", "goal_m": [x, y], **more}
    )


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A learned beam with its bench, and a recording of it."""
    fit, beam = made_up.posterior(), model_of("linear").beam
    stored = StoredModel(beam, None, None, instruments_of(fit))
    (tmp_path / "beam").mkdir()
    (tmp_path / "beam" / "model.json").write_text(model_text(stored, written_by="a test"), encoding="utf-8")
    described(tmp_path / "like", width=640)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_nothing_moves_before_go(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "run", lambda *_a, **_k: pytest.fail("it moved"))
    told: list[dict[str, Any]] = []
    with pytest.raises(KeyboardInterrupt):  # the studio is gone
        done_here(work, requests.drive(StudioFolder.of(bench), asked_for()), b"stop\n", stays=False, told=told)
    (plan,) = [one["found"] for one in told if "found" in one]
    assert "0.1 N at 90 deg" in dict(plan["plan"])["force"]
    assert not (bench / "driven").exists()


def test_a_drive_is_planned_shown_and_recorded(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rec = read_recording(bench / "like", filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    monkeypatch.setattr("onebend.studio.worker.OFTEN", 0.0)
    monkeypatch.setattr(specs, "robot_of", lambda _spec: lambda _rec, _settings: CellRobot(cell))
    monkeypatch.setattr(specs, "camera_of", lambda _spec: CellCamera(cell))
    monkeypatch.setattr(commands, "run", partial(drive, clock=PlayedClock(), beside=False, setup=0.15))
    wanted = requests.drive(StudioFolder.of(bench), asked_for(camera="/dev/video0"))
    told = done_here(work, wanted, b"go\n")
    job = Job(wanted)
    for one in told:
        job.hear(one)
    assert [next(iter(one)) for one in job.found] == ["plan", "outcome"]
    assert told.index({"found": job.found[0]}) < next(i for i, one in enumerate(told) if "now" in one)
    (goal,) = job.found[1]["outcome"]
    assert goal["reached"]
    assert goal["off_m"] < goal["said_within_m"]
    now = [one["now"] for one in told if "now" in one]
    assert now[-1]["stage"] == "done"
    assert job.shown()["now"] == now[-1]
    led = [one for one in now if one["stage"] == "staying"]
    assert np.linalg.norm(np.subtract(led[-1]["axis_m"][-1], wanted["goal_m"])) < 2e-3
    assert np.linalg.norm(np.subtract(led[-1]["point_m"], wanted["goal_m"])) < 1e-3
    assert now[-1]["distance_m"] is None
    assert (bench / "driven" / "drive.json").is_file()
    with pytest.raises(StudioError, match="holds a recording already"):
        requests.drive(StudioFolder.of(bench), asked_for())


def test_a_goal_out_of_reach_is_said(bench: Path) -> None:
    told: list[dict[str, Any]] = []
    with pytest.raises(ControlError, match="nearest reachable"):
        done_here(work, requests.drive(StudioFolder.of(bench), asked_for(goal_m=[0.2, 0.1])), told=told)
    assert told == [{"stage": "planning", "done": 0, "total": None}]


@pytest.mark.parametrize(
    "more",
    [
        {"goal_m": [1]}, {"push_s": 0}, {"model": "../beam"}, {"like": "beam"}, {"out": ""}, {"out": "."},
        {"robot": ""}, {"robot": "virtual:/etc/passwd"}, {"robot": "virtual:../beam"},
        {"camera": "film:/etc/passwd"}, {"out": "../x"},
    ],
)  # fmt: skip
def test_what_has_no_meaning_is_refused(bench: Path, more: dict[str, Any]) -> None:
    with pytest.raises(StudioError):
        requests.drive(StudioFolder.of(bench), asked_for(**more))


def test_what_is_asked_is_in_the_command(bench: Path) -> None:
    more = {"push_s": 0.8, "point_s": 0.9, "robot": "ur:10.0.0.7", "camera": "/dev/video0", "goal_m": [0.1, 0.05]}
    command = requests.drive(StudioFolder.of(bench), asked_for(**more))["command"]
    assert command == (
        "onebend drive beam driven --goal 0.1 0.05 --push-at 0.8 --point 0.9 --like like --robot ur:10.0.0.7 "
        "--camera /dev/video0 --go"
    )
