"""A recording that goes on: seen by two tabs, stopped, or its process or its studio killed; what it leaves."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient

from onebend.report.overview import overview
from onebend.studio.places import StudioFolder
from onebend.studio.recorder import WIDEST
from onebend.studio.server import application
from tests.studio.conftest import HOME, PORT, TOKEN, own

pytestmark = pytest.mark.slow
EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam"
SOCKET = f"ws://127.0.0.1:{PORT}/socket"


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder with a push of 18 s to play."""
    shutil.copytree(EXAMPLE, tmp_path / "lab")
    return tmp_path / "lab"


def pushed(**more: Any) -> dict[str, Any]:
    return {"out": "push", "like": "train", "camera": "film:train", "force": "log:train", "now": True, **more}


def recorder_of(parent: int) -> int | None:
    """The process that records for this one."""
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError):
            words, stat = (place / "cmdline").read_bytes(), (place / "stat").read_text().rpartition(")")[2].split()
            if b"onebend.studio.worker" in words and int(stat[1]) == parent:
                return int(place.name)
    return None


def until(client: TestClient, good: Callable[[dict[str, Any]], bool], seconds: float = 60.0) -> dict[str, Any]:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = client.get("/api/record").json()["recording"]
        if found is not None and good(found):
            return dict(found)
        time.sleep(0.1)
    raise AssertionError(found)


def test_two_tabs_see_one_recording_and_its_check(lab: Path) -> None:
    headers = own(host=f"127.0.0.1:{PORT}")
    with TestClient(application(StudioFolder.of(lab), TOKEN, PORT), base_url=HOME) as client:
        client.get("/", params={"token": TOKEN})
        with (
            client.websocket_connect(SOCKET, headers=headers) as one,
            client.websocket_connect(SOCKET, headers=headers) as two,
        ):
            for tab in (one, two):
                assert tab.receive_json()["recording"] is None
            assert client.post("/api/record/start", json=pushed(no_learning=True), headers=own()).status_code == 200
            again = client.post("/api/record/start", json=pushed(out="other"), headers=own())
            assert again.status_code == 422
            assert "push is being recorded" in again.json()["error"]
            begun = until(client, lambda found: found["state"].get("frames", 0) > 40)
            picture = client.get("/api/record/picture", params={"n": begun["picture"]})
            assert picture.headers["content-type"] == "image/jpeg"
            assert Image.open(io.BytesIO(picture.content)).width == min(WIDEST, begun["state"]["size_px"][0])
            client.post("/api/record/stop", json={}, headers=own())
            done = until(client, lambda found: found["phase"] == "done")
            last = []
            for tab in (one, two):
                while (message := tab.receive_json())["what"] != "places":
                    last.append(message)
            assert [one["recording"] for one in last if one["recording"]["phase"] == "done"] == [done, done]
    assert done["outcome"]["ended"] == "it was stopped"
    assert done["check"]["faults"] == []
    assert overview(lab / "push").faults == ()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
def test_a_killed_recorder_is_said_to_be_and_leaves_what_there_is(lab: Path) -> None:
    with TestClient(application(StudioFolder.of(lab), TOKEN, PORT), base_url=HOME) as client:
        client.get("/", params={"token": TOKEN})
        client.post("/api/record/start", json=pushed(), headers=own())
        until(client, lambda found: found["state"].get("seconds", 0.0) > 2.0)
        recorder = recorder_of(os.getpid())
        assert recorder is not None
        os.kill(recorder, signal.SIGKILL)
        ended = until(client, lambda found: found["phase"] == "failed", 20.0)
    assert ended["error"] == "the recorder ended with -9. The recording up to then is in push"
    assert overview(lab / "push").faults == ()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL])
def test_a_studio_that_ends_leaves_a_whole_recording(lab: Path, end: signal.Signals) -> None:
    command = [sys.executable, "-m", "onebend", "studio", str(lab), "--no-open"]
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    assert served.stdout is not None
    while "token" not in (line := served.stdout.readline()):
        pass
    home = line.strip().partition("/?")[0]
    with httpx2.Client(base_url=home, headers={"origin": home}, timeout=30.0) as person:
        person.get(line.strip().removeprefix(home))
        assert person.post("/api/record/start", json=pushed(no_learning=True)).status_code == 200
        while (person.get("/api/record").json()["recording"]["state"] or {}).get("seconds", 0.0) < 2.0:
            time.sleep(0.1)
        recorder = recorder_of(served.pid)
        served.send_signal(end)
    served.communicate(timeout=30)
    deadline = time.monotonic() + 20.0
    while Path(f"/proc/{recorder}").exists():
        assert time.monotonic() < deadline, "the recorder goes on"
        time.sleep(0.1)
    assert overview(lab / "push").faults == ()
    assert not list((lab / "push").glob(".*"))
    rows = np.genfromtxt(lab / "push" / "force.csv", delimiter=",", names=True)
    assert 1.5 < rows["time_s"][-1] < 12.0
