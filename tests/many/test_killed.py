"""A batch on worker processes, as the command runs it: itself or a worker killed in its middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from onebend.many.tasks import RECORDS, Item, ItemResult, TaskSettings, results_of
from tests.many.stems import stem

COUNT = 6
LONG = 240.0  # s that anything here may take


def command(stems: Path, out: Path, *options: str) -> list[str]:
    where = options or ("--workers", "2")
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
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_a_lost_worker_is_replaced_and_its_recording_learned(stems: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with started(stems, out) as first:
        before = records(out)
        children = Path(f"/proc/{first.pid}/task/{first.pid}/children").read_text().split()
        lines = {int(one): Path(f"/proc/{one}/cmdline").read_text() for one in children}
        workers = [number for number, line in lines.items() if "spawn_main" in line]
        assert workers
        for number in workers:
            os.kill(number, signal.SIGKILL)
        printed, said = first.communicate(timeout=LONG)
    assert first.returncode == 0, said
    summary = json.loads(printed)
    assert (summary["learned"], summary["failed"]) == (COUNT, [])
    after = records(out)
    assert len(after) == COUNT
    assert {name: after[name] for name in before} == before


def dies(item: Item, settings: TaskSettings) -> ItemResult:  # noqa: ARG001
    """In place of the learning: one recording ends every process, another its first."""
    first = item.folder / "tried"
    if item.name == "always" or (item.name == "once" and not first.exists()):
        first.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return ItemResult("done", True)


@pytest.mark.slow
def test_a_recording_that_ends_its_process_ends_no_batch(tmp_path: Path) -> None:
    items = [Item(name, tmp_path) for name in ("always", "once", "a", "b")]
    found = dict(results_of(items, TaskSettings(tmp_path, "0"), 2, dies))
    assert [found[i].hash for i in range(4)] == ["", "done", "done", "done"]
    assert "ended: too little memory?" in found[0].reason
