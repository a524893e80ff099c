"""A batch on worker processes, as the command runs it: itself, a worker or the scheduler killed in its middle."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from onebend.errors import ResultsError
from onebend.many.tasks import RECORDS, cluster
from tests.many.stems import stem

COUNT = 6
LONG = 240.0  # s that anything here may take


def command(stems: Path, out: Path, *options: str) -> list[str]:
    where = options or ("--workers", "1")
    return [sys.executable, "-m", "onebend", "batch", str(stems), "-o", str(out), *where, "--json", "-q"]


def records(out: Path) -> dict[str, int]:
    """The records that are there, with the time of each."""
    return {path.name: path.stat().st_mtime_ns for path in (out / RECORDS).glob("[!.]*.json")}


def until(true: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait for it, while the process lives."""
    last = time.monotonic() + LONG
    while not true():
        assert time.monotonic() < last
        assert process.poll() is None
        time.sleep(0.05)


@pytest.fixture
def stems(tmp_path: Path) -> Path:
    for i in range(COUNT):
        stem(tmp_path / "stems" / f"stem-{i}", seed=i)
    return tmp_path / "stems"


@contextmanager
def started(stems: Path, out: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """The command, once two recordings are learned."""
    line = command(stems, out, *options)
    first = subprocess.Popen(line, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        until(lambda: len(records(out)) >= 2, first)
        yield first
    finally:
        if first.poll() is None:
            os.killpg(first.pid, signal.SIGKILL)


def goes_on(stems: Path, out: Path, *options: str) -> None:
    """The same command learns what has no record, nothing twice, and leaves nothing else behind."""
    before = records(out)
    assert 2 <= len(before) < COUNT
    again = subprocess.run(command(stems, out, *options), check=True, capture_output=True, text=True)
    summary = json.loads(again.stdout)
    assert summary["learned"] == COUNT
    assert summary["worked_on_now"] == COUNT - len(before)
    after = records(out)
    assert len(after) == COUNT
    assert {name: after[name] for name in before} == before
    assert not [path for path in out.parent.iterdir() if path not in (stems, out)]


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT], ids=["killed", "interrupted"])
def test_stopped_in_its_middle_nothing_is_lost_and_nothing_done_twice(
    stems: Path, tmp_path: Path, how: signal.Signals
) -> None:
    out = tmp_path / "out"
    with started(stems, out) as first:
        os.killpg(first.pid, how) if how == signal.SIGINT else os.kill(first.pid, how)
        _, said = first.communicate(timeout=LONG)
    assert first.returncode == (130 if how == signal.SIGINT else -9), said
    if how == signal.SIGINT:  # one sentence, and nothing of the workers
        assert said.startswith("onebend: Interrupted.")
        assert len(said.splitlines()) == 1, said
    time.sleep(3.0)  # a worker without its parent ends by itself
    goes_on(stems, out)


@pytest.mark.slow
def test_a_lost_worker_is_replaced_and_its_recording_learned(stems: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with started(stems, out) as first:
        before = records(out)
        workers = [one for one in psutil.Process(first.pid).children() if "spawn_main" in " ".join(one.cmdline())]
        assert workers
        for one in workers:
            one.kill()
        printed, said = first.communicate(timeout=LONG)
    assert first.returncode == 0, said
    summary = json.loads(printed)
    assert (summary["learned"], summary["failed"]) == (COUNT, [])
    after = records(out)
    assert len(after) == COUNT
    assert {name: after[name] for name in before} == before


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_command_and_the_next_one_goes_on(stems: Path, tmp_path: Path) -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    address, out = f"tcp://127.0.0.1:{port}", tmp_path / "out"
    with cluster_of_processes(port) as scheduler, started(stems, out, "--scheduler", address) as first:
        scheduler.kill()
        _, said = first.communicate(timeout=LONG)
    assert first.returncode == 2, said
    assert "the scheduler of the cluster is lost" in said
    assert "the same command goes on from there" in said
    with cluster_of_processes(port):
        goes_on(stems, out, "--scheduler", address)


@contextmanager
def cluster_of_processes(port: int) -> Iterator[subprocess.Popen[bytes]]:
    """A scheduler and one worker as somebody starts them by hand."""
    begin = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port)]
    join = [sys.executable, "-m", "distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1"]
    made = []
    try:
        for line in (begin, join):
            made.append(
                subprocess.Popen([*line, "--no-dashboard"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            )
        yield made[0]
    finally:
        for one in made:
            one.terminate()
        for one in made:
            one.wait(LONG)


def test_no_scheduler_at_the_address_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onebend.many.tasks.WAIT", "1s")
    with pytest.raises(ResultsError, match="no scheduler answers at tcp"), cluster("tcp://127.0.0.1:1"):
        pass
