"""Whatever is posted to the studio is answered: with its work begun, or with one sentence."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from onebend.studio.jobs import Jobs
from tests.studio.conftest import own

LONGEST_SENTENCE = 600
NASTY: list[Any] = [
    None, True, -1, 1e308, 5e-324, 10**30, math.nan, math.inf, "", "a" * 5000, "é" * 200, "../etc", "/etc/passwd",
    "beam/../../x", "C:\\x", "\x00", "\x1b[31m", "\ud800", "name\n", "--force", "nan", [], [[]], [None], ["../x"],
    ["a"] * 51, {}, {"a": 1},
]  # fmt: skip
POSTS: dict[str, dict[str, Any]] = {
    "recordings/read": {"name": "hung weights"},
    "recordings/check": {"name": "hung weights", "text": "format = 1"},
    "recordings/save": {"name": "hung weights", "text": "format = 1", "version": "none"},
    "recordings/new": {"name": "hung weights"},
    "recordings/frame": {"name": "hung weights", "file": "poses.csv", "topic": "", "family": "36h11"},
    "recordings/lose": {"name": "hung weights"},
    "work/check/start": {"name": "hung weights"},
    "work/loop/start": {"model": "beam", "goal_m": [0.1, 0.05], "push_s": 1.0, "fps": 30, "draws": 0,
                            "max_force_N": 1.0},
    "work/drive/start": {"model": "beam", "like": "hung weights", "robot": "virtual:linear", "camera": "", "out": "new",
                         "goal_m": [0.1, 0.05], "push_s": 1.0},
    "work/drive/go": {},
    "work/nothing/start": {},
    "record/start": {"out": "new", "camera": "film:hung weights", "force": "log:hung weights", "like": "hung weights",
                     "until_percent": 5, "longest_s": 600, "crf": 18, "now": False},
    "record/lose": {},
    "learn": {"recordings": ["hung weights"], "validate": [], "out": "new", "replace": False},
}  # fmt: skip
BODIES = [b"", b"[]", b"nul", b"\xff\xfe", b"[" * 20_000, b'{"name":' + b"9" * 6000 + b"}", b'{"name":1e999}']


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What would have been begun; no process is."""
    wanted: list[dict[str, Any]] = []

    async def begin(_self: object, asked: dict[str, Any]) -> None:
        wanted.append(json.loads(json.dumps(asked, allow_nan=False)))

    monkeypatch.setattr(Jobs, "start", begin)
    return wanted


def answered(client: TestClient, what: str, body: bytes) -> None:
    found = client.post(f"/api/{what}", content=body, headers=own())
    assert found.status_code in (200, 422), (what, body[:200])
    if found.status_code == 422:
        assert 0 < len(found.json()["error"]) < LONGEST_SENTENCE


@pytest.mark.parametrize("what", POSTS)
def test_a_wrong_kind_of_everything(client: TestClient, folder: Path, begun: list[dict[str, Any]], what: str) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*.toml")}
    for body in BODIES:
        answered(client, what, body)
    for key in POSTS[what]:
        for value in NASTY:
            answered(client, what, json.dumps({**POSTS[what], key: value}).encode())
    assert {path: path.read_bytes() for path in folder.rglob("*.toml")} == before
    for one in begun:
        assert one["folder"] == str(folder)
        assert str(one.get("out", "")).isprintable()
        assert " --output --" not in one["command"]


@pytest.mark.parametrize("out", [["new"], True, 3.5, {"a": 1}, "a\nb", "\x1b[31m"])
def test_results_go_to_a_name_that_is_text(client: TestClient, begun: list[dict[str, Any]], out: Any) -> None:
    found = client.post("/api/learn", json={"recordings": ["hung weights"], "out": out}, headers=own())
    assert found.status_code == 422
    assert "out: give it as text" in found.json()["error"]
    assert begun == []


def test_half_a_character_names_no_film(client: TestClient) -> None:
    body = json.dumps({**POSTS["recordings/frame"], "file": "\ud800.mp4"})
    found = client.post("/api/recordings/frame", content=body, headers=own())
    assert found.status_code == 422
    assert found.json()["error"] == "no file is named"
