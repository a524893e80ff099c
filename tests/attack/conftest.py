"""The program under attack, loaded once, and recordings to mutilate."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.attack.victim import Victim
from tests.recording.tracked import track_folder

EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam" / "train"


@pytest.fixture(scope="session")
def victim() -> Iterator[Victim]:
    with Victim() as one:
        yield one


@pytest.fixture(scope="session")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of tracked markers, with nothing wrong."""
    return track_folder(tmp_path_factory.mktemp("sound") / "rec")


@pytest.fixture
def tracks(sound: Path, tmp_path: Path) -> Path:
    """A copy of it to mutilate."""
    return Path(shutil.copytree(sound, tmp_path / "rec"))


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """A copy of the bundled film, force log and description."""
    return Path(shutil.copytree(EXAMPLE, tmp_path / "rec"))
