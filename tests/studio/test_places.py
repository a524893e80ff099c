"""What the studio sees of a folder, and that it sees nothing beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from onebend.errors import StudioError
from onebend.studio.learned import film_data
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from tests.studio.conftest import own

OUTSIDE = (
    "..", "../secret", "beam/../../secret", "/etc", "//etc", "beam\0", "C:\\beam", "beam\\..\\..", "~/../..", "",
    "./../secret", "link", "link/inner", "beam:x", "a" * 5000,
    "a" * 300, "beam\udcff", "\ud800",
)  # fmt: skip


@pytest.fixture
def places(tmp_path: Path) -> StudioFolder:
    for folder in (tmp_path / "secret" / "inner", tmp_path / "studio" / "beam"):
        folder.mkdir(parents=True)
        for name in ("model.json", "summary.json", "recording.toml"):
            (folder / name).write_text("{}")
    (tmp_path / "studio" / "link").symlink_to(tmp_path / "secret")
    (tmp_path / "studio" / "file").mkdir()
    for name in ("model.json", "recording.toml"):
        (tmp_path / "studio" / "file" / name).symlink_to(tmp_path / "secret" / "inner" / name)
    return StudioFolder.of(tmp_path / "studio")


@pytest.mark.parametrize("name", OUTSIDE)
def test_no_name_leads_out(places: StudioFolder, name: str) -> None:
    for way in (places.result, places.recording):
        with pytest.raises(StudioError):
            way(name)


def test_a_link_to_a_file_outside_is_none(places: StudioFolder) -> None:
    for way in (places.result, places.recording):
        with pytest.raises(StudioError, match="out of"):
            way("file")


def test_a_report_that_is_a_link_shows_no_film(places: StudioFolder) -> None:
    report = places.root.parent / "secret" / "report.html"
    report.write_text('<script type="application/json" id="data">{"film": {"frames": []}}</script>')
    (places.root / "beam" / "report.html").symlink_to(report)
    with pytest.raises(StudioError, match="has no report"):
        film_data(places, Asked(name="beam"))


def test_what_is_there_is_found_by_name(places: StudioFolder) -> None:
    assert [(one.name, one.kind) for one in places.found()] == [("beam", "recording"), ("beam", "result")]
    assert places.result("beam").name == "beam"


def test_a_name_that_is_no_text_is_not_listed(places: StudioFolder) -> None:
    (places.root / "odd\udcff").mkdir()
    (places.root / "odd\udcff" / "recording.toml").write_text("")
    assert {one.name for one in places.found()} == {"beam"}


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(StudioError, match="not a folder"):
        StudioFolder.of(tmp_path / "nowhere")


@pytest.mark.parametrize(
    "path", ["/../pyproject.toml", "/..%2f..%2fguard.py", "/%2e%2e/guard.py", "/sources.json/../../guard.py"]
)
def test_the_pages_files_are_its_own(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404


@pytest.mark.parametrize("name", ["../x", "/etc", "nowhere", ""])
def test_the_server_says_what_is_wrong_with_a_name(client: TestClient, name: str) -> None:
    for path in ("/api/result", "/api/film"):
        answer = client.get(path, params={"name": name})
        assert answer.status_code == 422
        assert answer.json()["error"]


@pytest.mark.parametrize(
    "asked",
    [
        {}, {"recordings": "hung weights"}, {"recordings": ["../x"]}, {"recordings": ["nowhere"]}, {"recordings": [1]},
        {"recordings": ["hung weights"], "out": "../x"}, {"recordings": ["hung weights"], "out": "/tmp/x"},
        {"recordings": ["hung weights"], "out": "."}, {"recordings": ["hung weights"], "validate": ["/etc"]},
        {"recordings": ["hung weights"] * 51}, {"recordings": ["\ud800"]}, {"recordings": ["a" * 300]},
        {"recordings": ["hung weights"], "out": "\udcff"},
    ],
)  # fmt: skip
def test_learning_takes_names_of_this_folder_alone(client: TestClient, asked: dict[str, object]) -> None:
    answer = client.post("/api/learn", content=json.dumps(asked), headers=own())
    assert answer.status_code == 422
    assert client.get("/api/job").json() == {"job": None}


@pytest.mark.parametrize("body", [b"", b"[]", b"{", b"[" * 100_000, b"\xff"])
def test_a_body_that_is_no_object_is_said(client: TestClient, body: bytes) -> None:
    assert client.post("/api/learn", content=body, headers=own()).status_code == 422
