"""A folder with a recording and a learned beam, and the studio over it."""

from __future__ import annotations

import io
import json
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import pytest
from starlette.testclient import TestClient

from onebend.cli import Command, all_commands
from onebend.results.model import save_model
from onebend.studio.places import StudioFolder
from onebend.studio.server import application
from onebend.studio.worker import Studio
from tests import made_up

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[2]
PORT = 8765
TOKEN = "a-token-that-nobody-guesses"
HOME = f"http://127.0.0.1:{PORT}"
CHROMIUM = next((one for one in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if one), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, and a learned beam as its model alone."""
    place = tmp_path_factory.mktemp("studio")
    shutil.copytree(ROOT / "examples" / "hung-weights", place / "hung weights")
    fit = made_up.posterior()
    (place / "beam").mkdir()
    save_model(place / "beam" / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    (place / "beam" / "summary.json").write_text("{}")
    return place


@pytest.fixture
def stranger(folder: Path) -> TestClient:
    """A client that has not shown the token. Nothing is computed: the work is not begun."""
    return TestClient(application(StudioFolder.of(folder), TOKEN, PORT), base_url=HOME, follow_redirects=False)


@pytest.fixture
def client(stranger: TestClient) -> TestClient:
    """One that has."""
    assert stranger.get("/", params={"token": TOKEN}).status_code == 303
    return stranger


@pytest.fixture(scope="module")
def working(folder: Path) -> Iterator[TestClient]:
    """The studio at work."""
    with TestClient(application(StudioFolder.of(folder), TOKEN, PORT), base_url=HOME, follow_redirects=False) as found:
        found.get("/", params={"token": TOKEN})
        yield found


def done_here(
    work: Callable[..., None], wanted: dict[str, Any], *said: bytes, stays: bool = True, told: list[Any] | None = None
) -> list[dict[str, Any]]:
    """What a job tells (and `told`, also of one that fails) whose process is this one, in this folder. A person says
    some lines meanwhile, and `stays`."""
    out, lines, words = io.StringIO(), iter(said), shlex.split(wanted["command"])[1:]

    def readline() -> bytes:
        line = next(lines, b"")
        if not line and stays:
            Event().wait()
        return line

    found = [] if told is None else told
    try:
        given = Command(words[0], all_commands()[words[0]]).given(words[1:])
        work(Studio(out, cast(BinaryIO, SimpleNamespace(readline=readline))), **given)
    finally:
        found += [json.loads(line) for line in out.getvalue().splitlines()]
    return found


def own(**more: str) -> dict[str, Any]:
    """Headers of a request that the page itself makes."""
    return {"origin": HOME, **more}
