"""The room Recordings: what is typed is checked and not written, what is saved loses nothing, nothing leads out."""

from __future__ import annotations

import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from onebend.files import single_file
from onebend.recording.folder import read_recording
from onebend.studio.places import StudioFolder
from onebend.studio.server import application
from tests.studio.conftest import HOME, PORT, ROOT, TOKEN, own

TRAIN = ROOT / "examples" / "linear-beam" / "train"
POSTED = ("read", "check", "save", "new", "frame")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, a film with its log, links that lead out, and what lies outside."""
    place = tmp_path_factory.mktemp("rooms")
    shutil.copytree(TRAIN, place / "in" / "train")
    (place / "in" / "raw").mkdir()
    shutil.copy(TRAIN / "video.mp4", place / "in" / "raw" / "Push.mp4")
    shutil.copy(TRAIN / "force.csv", place / "in" / "raw" / "wrench.csv")
    shutil.copytree(TRAIN, place / "out")
    (place / "in" / "away").symlink_to(place / "out")
    (place / "in" / "half").mkdir()
    (place / "in" / "half" / "recording.toml").symlink_to(place / "out" / "recording.toml")
    (place / "in" / "train" / "elsewhere.mp4").symlink_to(place / "out" / "video.mp4")
    return place / "in"


@pytest.fixture(scope="module")
def asked(room: Path) -> Iterator[TestClient]:
    with TestClient(application(StudioFolder.of(room), TOKEN, PORT), base_url=HOME, follow_redirects=False) as found:
        found.get("/", params={"token": TOKEN})
        yield found


def post(client: TestClient, what: str, **asked: Any) -> dict[str, Any]:
    answer = client.post(f"/api/recordings/{what}", json=asked, headers=own())
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


def refused(client: TestClient, what: str, **asked: Any) -> str:
    answer = client.post(f"/api/recordings/{what}", json=asked, headers=own())
    assert answer.status_code == 422, answer.text
    return str(answer.json()["error"])


def test_what_is_typed_is_checked_by_the_library_within_a_fifth_of_a_second_and_not_written(
    asked: TestClient, room: Path
) -> None:
    found = post(asked, "read", name="train")
    before = (room / "train" / "recording.toml").read_bytes()
    assert found["text"].encode() == before
    assert found["mistakes"] == []
    assert [one["text"] for one in found["remarks"]] == [one.text for one in read_recording(TRAIN).remarks]
    wrong = found["text"].replace("length_m", "lenght_m")
    began = time.perf_counter()
    checked = post(asked, "check", name="train", text=wrong)
    assert time.perf_counter() - began < 0.2
    line = 1 + wrong[: wrong.index("lenght_m")].count("\n")
    told = {"line": line, "text": "[beam] does not know the key lenght_m. Did you mean length_m?"}
    assert told in checked["mistakes"]
    assert [one["id"] for one in checked["tags"] if one["base"]] == [0]
    assert checked["file"] == "video.mp4"
    assert (room / "train" / "recording.toml").read_bytes() == before


@pytest.mark.parametrize(
    "text", ["", "tags = 3\nvideo = []", 'tags = {on_beam = [3, {id = "x"}]}', "[" * 10_000, "\0", "a" * 200_000]
)
def test_whatever_is_typed_has_mistakes_and_no_crash(asked: TestClient, text: str) -> None:
    assert post(asked, "check", name="train", text=text)["mistakes"]


def test_it_is_saved_whole_and_with_its_line_ends(asked: TestClient, room: Path) -> None:
    path = room / "train" / "recording.toml"
    text = path.read_text(encoding="utf-8")
    try:
        path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
        found = post(asked, "read", name="train")
        assert found["text"] == text
        saved = post(asked, "save", name="train", text=text + "# µ\n", version=found["version"])
        assert path.read_bytes() == b"\xef\xbb\xbf" + (text + "# µ\n").replace("\n", "\r\n").encode()
        assert post(asked, "read", name="train")["version"] == saved["version"]
        half = '{"name": "train", "text": "\\ud800", "version": "' + saved["version"] + '"}'
        assert asked.post("/api/recordings/check", content=half, headers=own()).json()["mistakes"]
        assert "half a character" in asked.post("/api/recordings/save", content=half, headers=own()).text
        assert sorted(one.name for one in path.parent.iterdir() if one.name.startswith(".")) == []
    finally:
        path.write_text(text, encoding="utf-8")


def test_what_changed_on_disk_is_not_overwritten_without_the_users_word(asked: TestClient, room: Path) -> None:
    path = room / "train" / "recording.toml"
    text = path.read_text(encoding="utf-8")
    try:
        found = post(asked, "read", name="train")
        path.write_text(text + "# by another program\n", encoding="utf-8")
        met = post(asked, "save", name="train", text=text + "# mine\n", version=found["version"])
        assert met["conflict"]
        assert met["text"] == path.read_text(encoding="utf-8") == text + "# by another program\n"
        assert "conflict" not in post(asked, "save", name="train", text=text + "# mine\n", version=met["version"])
        assert path.read_text(encoding="utf-8") == text + "# mine\n"
    finally:
        path.write_text(text, encoding="utf-8")


def test_a_save_that_fails_leaves_the_file(asked: TestClient, room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = room / "train" / "recording.toml"
    before, version = path.read_bytes(), post(asked, "read", name="train")["version"]

    def full(_path: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(single_file, "sync_file", full)
    assert "No space left" in refused(asked, "save", name="train", text="format = 1\n", version=version)
    assert path.read_bytes() == before
    assert [one.name for one in path.parent.iterdir() if one.name.startswith(".")] == []


def test_the_other_tabs_hear_of_a_save(asked: TestClient) -> None:
    found = post(asked, "read", name="train")
    with asked.websocket_connect(f"ws://127.0.0.1:{PORT}/socket", headers=own(host=f"127.0.0.1:{PORT}")) as socket:
        assert socket.receive_json()["what"] == "hello"
        saved = post(asked, "save", name="train", text=found["text"], version=found["version"])
        assert socket.receive_json() == {"what": "saved", "name": "train", "version": saved["version"]}


def test_the_first_frame_shows_its_tags(asked: TestClient) -> None:
    found = post(asked, "frame", name="train", file="video.mp4", topic="", family="tag36h11")
    assert sorted(one["id"] for one in found["tags"]) == [0, 1, 2, 3]
    assert all(0 < x < found["width"] and 0 < y < found["height"] for one in found["tags"] for x, y in one["corners"])
    assert found["picture"].startswith("data:image/jpeg;base64,")


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("../../out/video.mp4", "leads out"), ("/etc/passwd", "leads out"), ("elsewhere.mp4", "leads out"),
        ("", "no file"), ("\0", "no file"), ("nowhere.mp4", "no file"),
        ("force.csv", "readable video"), (".", "There is no file"),
    ],
)  # fmt: skip
def test_no_film_from_outside_is_shown(asked: TestClient, file: str, words: str) -> None:
    assert words in refused(asked, "frame", name="train", file=file, topic="", family="tag36h11")


@pytest.mark.parametrize("name", ["../out", "away", "half", "/etc", "", ".", "nowhere", "train/..", "a" * 5000])
@pytest.mark.parametrize("what", POSTED)
def test_no_name_leads_out(asked: TestClient, room: Path, what: str, name: str) -> None:
    before = {path: path.read_bytes() for path in (room.parent / "out").iterdir()}
    if (what, name) == ("new", "."):
        return  # the folder itself may hold a recording
    assert refused(asked, what, name=name, text="x", version="x", file="nowhere", family="tag36h11")
    assert {path: path.read_bytes() for path in (room.parent / "out").iterdir()} == before


def test_a_film_with_a_log_is_listed_and_begun_from_the_template(asked: TestClient, room: Path) -> None:
    rows = asked.get("/api/places").json()["found"]
    assert [one["name"] for one in rows if one["kind"] == "film"] == ["raw"]
    post(asked, "new", name="raw")
    found = post(asked, "read", name="raw")
    assert 'file = "Push.mp4"' in found["text"]
    assert any("length_m is empty" in one["text"] for one in found["mistakes"])
    assert (found["file"], found["family"]) == ("Push.mp4", "tag36h11")
    assert "exists already" in refused(asked, "new", name="raw")
    (room / "raw" / "recording.toml").unlink()


@pytest.mark.parametrize(
    "path", [*(f"recordings/{what}" for what in POSTED), "work/check/start", "work/loop/stop", "reach"]
)
def test_each_needs_the_token_and_this_page(room: Path, path: str) -> None:
    stranger = TestClient(application(StudioFolder.of(room), TOKEN, PORT), base_url=HOME, follow_redirects=False)
    assert stranger.post(f"/api/{path}", json={"name": "train"}, headers=own()).status_code == 403
    stranger.get("/", params={"token": TOKEN})
    for origin in ({}, {"origin": "http://evil.example"}, {"origin": "null"}):
        assert stranger.post(f"/api/{path}", json={"name": "train"}, headers=origin).status_code == 403
    assert stranger.get(f"/api/{path}", headers=own()).status_code in (404, 405)
    long = stranger.post(f"/api/{path}", content=b" " * (256 * 1024 + 1), headers=own())
    assert long.status_code == 413


def ended(client: TestClient, room: str, seconds: float = 90.0) -> dict[str, Any]:
    """The work of a room, when it is over."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = client.get(f"/api/work/{room}").json()
        if found["job"]["state"] not in ("running", "stopping"):
            return dict(found)
        time.sleep(0.1)
    raise AssertionError("it still runs")


@pytest.mark.slow
def test_a_check_leaves_its_picture_and_is_what_the_command_says(asked: TestClient, room: Path) -> None:
    assert asked.get("/api/check.png", params={"name": "train"}).status_code == 422
    assert asked.post("/api/work/check/start", json={"name": "train"}, headers=own()).status_code == 200
    assert "another runs" in asked.post("/api/work/check/start", json={"name": "train"}, headers=own()).json()["error"]
    done = ended(asked, "check")
    assert done["job"]["state"] == "done", done
    assert done["job"]["command"] == "onebend check train --output train/check.png"
    (found,) = done["found"]
    assert found["faults"] == []
    assert found["understood"]["tags seen"].startswith("0, 1, 2, 3")
    picture = asked.get("/api/check.png", params={"name": "train"})
    assert picture.content == (room / "train" / "check.png").read_bytes()
    assert picture.headers["content-type"] == "image/png"
    (room / "train" / "check.png").write_bytes(b"\x89PNG of somebody else")
    assert asked.get("/api/check.png", params={"name": "train"}).status_code == 422
    asked.post("/api/work/check/start", json={"name": "train"}, headers=own())
    (again,) = ended(asked, "check")["found"]
    assert not again["picture"]
    assert "exists already" in again["unwritten"]
    assert (room / "train" / "check.png").read_bytes() == b"\x89PNG of somebody else"
    (room / "train" / "check.png").unlink()


def test_a_check_is_stopped(asked: TestClient) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # as the server: what ignores it begins deaf work
    try:
        assert asked.post("/api/work/check/start", json={"name": "train"}, headers=own()).status_code == 200
        assert asked.post("/api/work/check/stop", json={}, headers=own()).status_code == 200
        assert ended(asked, "check")["job"]["state"] == "stopped"
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("path", ["work/nothing", "check.png?name=../out", "check.png?name=away"])
def test_what_is_not_there_is_said(asked: TestClient, path: str) -> None:
    assert asked.get(f"/api/{path}").status_code == 422
