"""A batch on worker processes: as the command runs it, killed in its middle, and run again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from onebend.batch.engine import cluster
from onebend.batch.record import RECORDS
from onebend.errors import ResultsError
from tests.batch.stems import stem

COUNT = 6


def command(stems: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "onebend", "batch", str(stems), "-o", str(out), "--workers", "1", "--json", "-q"]


def records(out: Path) -> dict[str, int]:
    """The records that are there, with the time of each."""
    return {path.name: path.stat().st_mtime_ns for path in (out / RECORDS).glob("[!.]*.json")}


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_killed_in_its_middle_nothing_is_lost_and_nothing_done_twice(tmp_path: Path, how: signal.Signals) -> None:
    stems, out = tmp_path / "stems", tmp_path / "out"
    for i in range(COUNT):
        stem(stems / f"stem-{i}", seed=i)
    first = subprocess.Popen(command(stems, out), start_new_session=True, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120.0
    while len(records(out)) < 2:
        assert time.monotonic() < until
        assert first.poll() is None
        time.sleep(0.05)
    os.killpg(first.pid, how) if how == signal.SIGINT else os.kill(first.pid, how)
    _, said = first.communicate(timeout=60.0)
    assert first.returncode == (130 if how == signal.SIGINT else -9), said
    time.sleep(3.0)  # a worker without its parent ends by itself
    before = records(out)
    assert 2 <= len(before) < COUNT
    again = subprocess.run(command(stems, out), check=True, capture_output=True, text=True)
    summary = json.loads(again.stdout)
    assert summary["learned"] == COUNT
    assert summary["worked_on_now"] == COUNT - len(before)
    after = records(out)
    assert len(after) == COUNT
    assert {name: after[name] for name in before} == before
    assert not [path for path in tmp_path.iterdir() if path not in (stems, out)]


def test_no_scheduler_at_the_address_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onebend.batch.engine.WAIT", "1s")
    with pytest.raises(ResultsError, match="no scheduler answers at tcp"), cluster("tcp://127.0.0.1:1"):
        pass
