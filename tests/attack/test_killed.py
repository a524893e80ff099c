"""Wherever a process is killed, results are old or new and known as such; the next run finds nothing in its way."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.attack.killing import SCENARIOS
from tests.attack.scripts import said_by

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="forks")


def whole(found: dict[str, object], least: int) -> None:
    assert found["faults"] == []
    assert isinstance(found["points"], int)
    assert found["points"] >= least


@pytest.mark.parametrize(
    ("scenario", "how", "every"),
    [
        ("fresh", "killed", 7),
        ("others", "killed", 7),
        ("twice", "killed", 7),
        ("others", "full", 11),
        ("earlier", "interrupted-lines", 211),
    ],
)
def test_ended_at_some_points(tmp_path: Path, scenario: str, how: str, every: int) -> None:
    whole(said_by("killing.py", tmp_path / "x", scenario, every, how), 4)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["killed", "full"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_ended_before_every_touch_of_the_disk(tmp_path: Path, scenario: str, how: str) -> None:
    found = said_by("killing.py", tmp_path / "x", scenario, 1, how)
    whole(found, 20)
    assert len(found["seen"]) > 1  # some left the old one, some the new one


@pytest.mark.slow
@pytest.mark.parametrize("how", ["killed-lines", "interrupted-lines"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_ended_before_every_ninth_line(tmp_path: Path, scenario: str, how: str) -> None:
    whole(said_by("killing.py", tmp_path / "x", scenario, 9, how), 30)
