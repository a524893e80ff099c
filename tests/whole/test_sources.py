"""Cameras and sensors of `onebend record` as no one means them: one message each, and nobody waits without end."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from onebend.live.force_sensors import cells_of
from tests.attack.conftest import EXAMPLE
from tests.attack.family import Case, params, withstood
from tests.attack.victim import Victim

CAMERA, LOG = "film:film", "log:film"
DIGITS = "9" * 5000
REQUESTS: dict[str, tuple[str, str, str]] = {  # --camera, --force, words
    "a start of 5000 digits": (CAMERA, f"log:film,start_s={DIGITS}", "start_s=9{60}: this must be a number"),
    "a picture of 5000 digits": (f"v4l2:/dev/null,size={DIGITS}x1", LOG, "write width and height in pixels"),
    "a picture of no size": ("v4l2:/dev/null,size=0x0", LOG, "size=0x0: write width and height in pixels"),
    "a picture of raised digits": ("v4l2:/dev/null,size=²x²", LOG, "write width and height in pixels"),
    "a pipe as a camera": ("av:pipe", LOG, "pipe is a pipe, and no camera"),
    "a pipe as a film": ("film:pipe", LOG, "there is no such film"),
    "a text as a camera": ("av:film/recording.toml", LOG, "cannot be opened as a camera"),
    "a pipe as a log": (CAMERA, "csv:pipe", "csv:pipe is no file"),
    "zeros without end": (CAMERA, "csv:/dev/zero", "csv:/dev/zero is no file"),
    "a log that ended before": (CAMERA, "log:film,start_s=1e11", "ends at .* before start_s = 1e.11 s"),
    "a log that begins after": (CAMERA, "log:film,start_s=-1e12", "begins at .* s after start_s = -1e.12 s"),
    "a log of another universe": (CAMERA, "log:film,start_s=1e300", "start_s=1e300: this must be a number"),
    "a port beyond all ports": (CAMERA, "ati:127.0.0.1,counts=1000,port=1e9", "port=1e9: this must be a number from 1"),
    "an address of 70 letters": (CAMERA, f"ati:{'a' * 70},counts=1000", "is not reached"),
    "an address with control characters": (CAMERA, "ati:\x01", "netftapi2.xml cannot be read"),
    "counts beyond all numbers": (CAMERA, "ati:127.0.0.1,counts=1e300", "counts=1e300: this must be a number"),
    "a rate of a port of 300 digits": (CAMERA, "serial:/dev/null,columns=fx_N/fy_N,baud=1e300", "baud=1e300"),
    "no sensor where one is described": (CAMERA, "none", r"names a .force., and no sensor is given"),
    "an escape sequence": (CAMERA, "\x1b[31m", r"--force .x1b\[31m: there is no such source"),
}  # fmt: skip
QUICK = {"a start of 5000 digits", "a pipe as a camera", "a pipe as a log", "an address with control characters"}
CASES = [Case(name, lambda _: None, words) for name, (_, _, words) in REQUESTS.items()]


def prepare(folder: Path) -> None:
    """What the requests name."""
    shutil.copytree(EXAMPLE, folder / "film")
    os.mkfifo(folder / "pipe")


def recorded(name: str) -> Sequence[object]:
    """The command line of a request."""
    camera, force, _ = REQUESTS[name]
    sources = ["--camera", camera, "--force", force]
    return ["record", "out", "--like", "film", *sources, "--fast", "--now", "--no-learning", "-q"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sources")
    prepare(folder)
    return folder


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_source_that_is_none(victim: Victim, place: Path, case: Case) -> None:
    withstood(victim.attack(recorded(case.name), place, seconds=30.0), case, seconds=30.0)


@pytest.mark.parametrize("line", ["inf,1,0.1,0.2", "0.5,1e999,0.1,0.2", "nan,2,0.1,0.2", "0.5,nan,0.1,0.2"])
def test_a_time_and_a_counter_beyond_all_numbers(line: str) -> None:
    cells = cells_of(["time_s", "number", "fx_N", "fy_N"], where="serial")
    rows, bad = cells.rows([line, "0.5,1,0.1,0.2"])
    assert rows.tolist() == [[0.5, 1.0, 0.1, 0.2]]
    assert bad == 1
