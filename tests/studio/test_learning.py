"""The room Learn: a process that learns, is stopped or killed, and what it leaves; results and films read back."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import StudioError
from onebend.results.model import read_model
from onebend.studio.jobs import Job
from onebend.studio.learned import film_data, result_data
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from tests.studio.conftest import own


def test_a_result_says_what_its_files_say(working: TestClient, folder: Path) -> None:
    found = working.get("/api/result", params={"name": "beam"}).json()
    stored = read_model(folder / "beam")
    s = np.array(found["curve"]["s"])
    assert np.allclose(found["curve"]["k_N_m"], stored.beam.stiffness(s))
    assert stored.uncertain is not None
    assert np.allclose(found["curve"]["bands"][0]["low_N_m"], stored.uncertain.band(s).low)
    assert found["curve"]["identified"] == stored.uncertain.band(s).identified.tolist()
    assert found["verdict"] is None


@pytest.mark.parametrize(
    "text",
    [
        '{"fit": [1]}', '{"fit": {"allowances": 5}}', '{"fit": {"allowances": [5]}}', '{"remarks": 5}',
        '{"remarks": [5]}', '{"provenance": "x"}', '{"verdict": NaN}',
        '{"verdict": {"grade": "\\ud800", "known": 1}, "recordings": 1}',
    ],
)  # fmt: skip
def test_a_summary_that_another_hand_wrote_harms_no_other_result(client: TestClient, folder: Path, text: str) -> None:
    (folder / "beam" / "summary.json").write_text(text)
    try:
        found = client.get("/api/result", params={"name": "beam"}).json()
        assert found["remarks"] == found["allowances"] == []
        assert {"beam", "hung weights"} <= {one["name"] for one in client.get("/api/places").json()["found"]}
    finally:
        (folder / "beam" / "summary.json").write_text("{}")


def test_the_list_says_what_is_there(working: TestClient) -> None:
    found = working.get("/api/places").json()["found"]
    assert {("beam", "result"), ("hung weights", "recording")} <= {(one["name"], one["kind"]) for one in found}


def film(folder: Path, data: str | None) -> dict[str, Any] | None:
    """Of a result with this in its report."""
    folder.mkdir()
    (folder / "model.json").write_text("{}")
    if data is not None:
        (folder / "report.html").write_text(f'<html><script type="application/json" id="data">{data}</script>')
    return film_data(StudioFolder.of(folder.parent), Asked(name=folder.name))


def test_the_film_is_the_reports(tmp_path: Path) -> None:
    filmed = {"width": 4, "height": 3, "frames": []}
    data = json.dumps({"film": filmed, "curve": {"tag_id": [1, 2]}})
    assert film(tmp_path / "a", data) == filmed | {"tag_id": [1, 2]}
    assert film(tmp_path / "b", '{"film": null}') is None
    assert film(tmp_path / "odd", '{"film": {}, "curve": [1]}') == {"tag_id": []}
    for name, text in (("c", "{"), ("d", "[]"), ("e", "[" * 100_000)):
        with pytest.raises(StudioError, match="Learn again"):
            film(tmp_path / name, text)
    with pytest.raises(StudioError, match="no report"):
        film(tmp_path / "bare", None)


def test_a_job_says_its_stages_in_order() -> None:
    job = Job({"recordings": ["a"], "out": "b", "command": "onebend learn a"})
    for said in (
        {"stage": "one", "done": 0, "total": 3}, {"stage": "one", "done": 3, "total": 3},
        {"stage": "two", "done": 0, "total": None}, {"published": True}, {"error": "no"},
    ):  # fmt: skip
        job.hear(dict(said))
    shown = job.shown()
    assert [(one["stage"], one["done"]) for one in shown["stages"]] == [("one", 3), ("two", 0)]
    assert shown["published"]
    assert shown["error"] == "no"


def result(folder: Path, name: str) -> dict[str, Any]:
    return result_data(StudioFolder.of(folder), Asked(name=name))


def settled(client: TestClient, seconds: float = 90.0) -> dict[str, Any]:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        job = client.get("/api/job").json()["job"]
        if job["state"] not in ("running", "stopping"):
            return dict(job)
        time.sleep(0.2)
    raise AssertionError("it still runs")


def test_a_recording_that_cannot_be_read_ends_in_one_sentence(working: TestClient, folder: Path) -> None:
    (folder / "broken").mkdir(exist_ok=True)
    (folder / "broken" / "recording.toml").write_text("format = 1\n")
    assert working.post("/api/learn", json={"recordings": ["broken"]}, headers=own()).status_code == 200
    job = settled(working)
    assert job["state"] == "failed"
    assert "[video]" in job["error"]
    assert not (folder / "broken-results").exists()


@pytest.mark.slow
def test_learned_here_is_learned_as_the_command_does(
    working: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = {"recordings": ["hung weights"], "out": "learned here"}
    assert working.post("/api/learn", json=asked, headers=own()).status_code == 200
    again = working.post("/api/learn", json=asked, headers=own())
    assert again.status_code == 422
    assert "another" in again.json()["error"]
    job = settled(working)
    assert job["state"] == "done", job
    assert job["published"]
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, ["learn", "hung weights", "-o", "learned there", "--quiet"])
    assert done.exit_code == 0, done.output
    here, there = (result(folder, name) for name in ("learned here", "learned there"))
    assert here["curve"] == there["curve"]
    assert here["verdict"] == there["verdict"]
    assert here["command"] == ["onebend", "learn", "hung weights", "--output", "learned here"]
    assert not list(folder.glob(".learned*"))


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_work_that_is_ended_leaves_an_earlier_result_whole(folder: Path, tmp_path: Path, end: signal.Signals) -> None:
    shutil.copytree(folder / "hung weights", tmp_path / "rec")
    shutil.copytree(folder / "beam", tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    wanted = {"folder": str(tmp_path), "command": "onebend learn rec --output fresh"}
    process = subprocess.Popen(
        [sys.executable, "-m", "onebend.studio.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(wanted) + "\n")
    process.stdin.flush()
    assert "stage" in json.loads(process.stdout.readline())
    process.send_signal(end)
    process.communicate(timeout=60)
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    fresh = tmp_path / "fresh"
    assert not fresh.exists() or read_model(fresh).beam is not None


@pytest.mark.slow
def test_a_killed_studio_leaves_no_process_behind(folder: Path) -> None:
    """What its workers hold open of its output is closed soon after it is gone."""
    command = [sys.executable, "-m", "onebend", "studio", str(folder), "--no-open"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    assert served.stdout is not None
    while "token" not in served.stdout.readline():
        pass
    time.sleep(1.0)  # the process beside has begun
    served.kill()
    served.communicate(timeout=20)


@pytest.mark.slow
def test_a_killed_studio_loses_no_result(folder: Path) -> None:
    """What learns goes on without it, and its result is put in place whole."""
    command = [sys.executable, "-m", "onebend", "studio", str(folder), "--no-open"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    assert served.stdout is not None
    while "token" not in (line := served.stdout.readline()):
        pass
    home = line.strip().partition("/?")[0]
    with httpx2.Client(base_url=home, headers={"origin": home}) as person:
        person.get(line.strip().removeprefix(home))
        asked = {"recordings": ["hung weights"], "out": "after the end"}
        assert person.post("/api/learn", json=asked).status_code == 200
        while not person.get("/api/job").json()["job"]["stages"]:
            time.sleep(0.1)
    served.kill()
    served.wait()
    served.stdout.close()
    end = time.monotonic() + 60.0
    while not (folder / "after the end" / "report.html").is_file():
        assert time.monotonic() < end
        time.sleep(0.2)
    assert result(folder, "after the end")["verdict"]["grade"]
