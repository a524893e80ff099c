"""Two runs into one folder: one writes, the other says so at its start; the folder is one run's, whole."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from onebend.errors import ResultsError
from onebend.files.publish import prepare
from tests.attack.killing import run, state_of
from tests.attack.scripts import environment, said_by

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")
HOLD = """
import sys, time
from pathlib import Path
from onebend.files.publish import prepare
place = prepare(Path(sys.argv[1]), kind="onebend-test-1", overwrite=True)
print("here", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("arguments", [(6, 2), (4, 5), (4, 4, "force")])
def test_some_rounds(tmp_path: Path, arguments: tuple[object, ...]) -> None:
    found = said_by("at_once.py", tmp_path / "x", *arguments)
    assert found["faults"] == []


@pytest.mark.slow
@pytest.mark.parametrize("force", ["", "force"])
@pytest.mark.parametrize("processes", [2, 3, 6])
def test_many_rounds(tmp_path: Path, processes: int, force: str) -> None:
    found = said_by("at_once.py", tmp_path / "x", 150, processes, force)
    assert found["faults"] == []
    assert found["busy"] > 100


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that writes to `out`."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True, env=environment()
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "here\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_the_second_is_told_who_writes_since_when(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    out = tmp_path / "out"
    (tmp_path / "link").symlink_to(tmp_path)
    for way in (out, tmp_path / "link" / "out", tmp_path / "nowhere" / ".." / "out"):  # by every name
        with pytest.raises(ResultsError) as refused:
            prepare(way, kind="onebend-another-1", overwrite=True)
        words = rf"out: is being written by process {holder.pid} on \S+ since 20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d"
        assert re.search(words, str(refused.value)), refused.value
    assert sorted(path.name[:5] for path in tmp_path.iterdir()) == [".out.", "link"]


def test_who_is_killed_holds_nothing(tmp_path: Path, holder: subprocess.Popen[str]) -> None:
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    run(tmp_path / "out", "mine")
    assert state_of(tmp_path / "out") == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
