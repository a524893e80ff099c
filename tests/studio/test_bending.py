"""The room Bend, over the socket: what it answers is what the library says."""

from __future__ import annotations

import asyncio
import json
import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient, WebSocketTestSession
from typer.testing import CliRunner

from onebend.beam.setup import SetUp
from onebend.cli import app
from onebend.control.reach_set import Edge, ReachMap
from onebend.errors import StudioError
from onebend.records import Array
from onebend.results.model import read_model, save_model
from onebend.studio.bending import Bending, bending_of, edge_lines
from onebend.studio.desk import Desk
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked
from tests import made_up
from tests.studio.conftest import PORT, own

SOCKET = f"ws://127.0.0.1:{PORT}/socket"


def sheets(*corners: tuple[float, float, float, float]) -> ReachMap:
    """Rectangles (left, low, right, high) as sheets of their own; the first ends where the force is the largest."""
    points: list[tuple[float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for left, low, right, high in corners:
        at = len(points)
        points += [(left, low), (right, low), (right, high), (left, high)]
        triangles += [(at, at + 1, at + 2), (at, at + 2, at + 3)]
    force = np.where(np.arange(len(points)) < 4, 2.0, 1.0)[:, None] * np.array([1.0, 0.0])
    return ReachMap(2.0, force, np.zeros((len(points), 1)), np.array(points), np.array(triangles))


def test_the_edge_is_that_of_all_sheets_together() -> None:
    """Two crossed bars: no line runs where one ends in the other, and all of the cross has one."""
    lines = edge_lines(sheets((0.0, 0.1, 0.3, 0.2), (0.1, 0.0, 0.2, 0.3)))
    for kind in ("force", "stability"):
        assert length([one for one in lines if one[1] == kind]) == pytest.approx(
            0.6, rel=0.03
        )  # four arms, three sides
    x, y = np.abs(np.concatenate([line for line, _ in lines]) - 0.15).T
    away = np.minimum(np.maximum(x - 0.15, y - 0.05), np.maximum(x - 0.05, y - 0.15))  # m, from the edge of the cross
    assert np.abs(away).max() < 0.0015


def test_a_hole_has_an_edge_and_a_seam_has_none() -> None:
    ring = sheets((0.0, 0.0, 0.3, 0.1), (0.0, 0.2, 0.3, 0.3), (0.0, 0.1, 0.1, 0.2), (0.2, 0.1, 0.3, 0.2))
    assert length(edge_lines(ring)) == pytest.approx(4 * 0.3 + 4 * 0.1, rel=0.03)
    assert length(edge_lines(sheets((0.0, 0.0, 0.15, 0.3), (0.15, 0.0, 0.3, 0.3)))) == pytest.approx(1.2, rel=0.03)


def length(lines: list[tuple[Array, Edge]]) -> float:
    """m, of all of them."""
    return float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line, _ in lines))


def heard(socket: WebSocketTestSession, what: str) -> dict[str, Any]:
    """The next message of this kind."""
    for _ in range(200):
        message = socket.receive_json()
        if message["what"] == what:
            return dict(message)
        assert message["what"] != "error", message
    raise AssertionError(f"no {what}")


def opened(client: TestClient) -> WebSocketTestSession:
    return client.websocket_connect(SOCKET, headers=own(host=f"127.0.0.1:{PORT}"))


@pytest.mark.slow
def test_a_drag_is_answered_with_the_force_that_reach_gives(working: TestClient, folder: Path) -> None:
    beam = read_model(folder / "beam").beam
    goal = beam.equilibrium((0.05, 0.2)).xy(1.0)
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        assert heard(socket, "beam")["opened"]["mode"] == "point"
        assert heard(socket, "map")["map"]["triangles"]
        socket.send_json({"do": "drag", "model": "beam", "n": 7, "goal": goal.tolist()})
        message = heard(socket, "answer")
    assert message["n"] == 7
    answer = message["answer"]
    assert answer["limit"] is None
    assert np.allclose(
        answer["force_N"], [0.05, 0.2], atol=2e-3
    )  # along the beam a force moves the point by next to nothing
    assert np.allclose(answer["line_m"][-1], goal, atol=2e-6)
    long, short = answer["ellipse"]["semi_axes_m"]
    assert 0.0 < short <= long < 0.05


def test_the_command_beside_it_gives_the_same_force(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bending = bending_of("beam", folder / "beam")
    answer = bending.drag([0.1338, 0.0638])
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, [*shlex.split(answer["command"])[1:], "--json"])
    assert done.exit_code == 0, done.output
    assert np.allclose(json.loads(done.stdout)["force_N"], answer["force_N"], rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("force", [(0.0, 0.05), (0.3, 0.01), (0.01, 0.1), (0.05, 0.2)])
def test_the_command_is_exact_where_a_micrometre_takes_much_force(
    folder: Path, monkeypatch: pytest.MonkeyPatch, force: tuple[float, float]
) -> None:
    bending = bending_of("beam", folder / "beam")
    bending.point.under(force)
    command = bending.still()["command"]
    assert len(command.split("--goal ")[1].split()[0]) > len("0.150000")
    monkeypatch.chdir(folder)
    done = CliRunner().invoke(app, [*shlex.split(command)[1:], "--json"])
    assert done.exit_code == 0, done.output
    off = np.linalg.norm(np.subtract(json.loads(done.stdout)["force_N"], force))
    assert off <= max(3e-2 * np.hypot(*force), 1e-4)


def test_a_beam_is_bent_in_the_set_up_that_it_was_learned_in(tmp_path: Path) -> None:
    fit = made_up.posterior()
    mean, count = np.array([0.003, 0.05]), len(fit.stiffness.mean)
    sizes, slope = {"length": 1, "direction": 1}, np.zeros((2, count))
    setup = SetUp(1.0, (0.05, 0.2), (0.5, 1.0), 0.01, sizes, mean, slope, 1e-6 * np.eye(2), np.full(2, 0.01))
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness, setup=setup)
    bending, force = bending_of("beam", tmp_path), np.array([[0.02, 0.18], [0.1, 0.4]])
    goals = setup.bent(fit.beam, fit.stiffness, force).xy(np.ones(1))[:, 0]
    there = bending.drag(goals[0].tolist())
    assert np.linalg.norm(np.subtract(there["force_N"], force[0])) < 0.02 * np.linalg.norm(force[0])
    assert there["beyond_learned"] == 0.0
    far = bending.drag(goals[1].tolist())
    assert far["beyond_learned"] == pytest.approx(2.0, rel=0.05)
    bending.change(Asked({"mode": "hand"}))
    assert bending.stored.beam == bending.learned.beam


def test_at_rest_no_command_is_shown(folder: Path) -> None:
    bending = bending_of("beam", folder / "beam")
    assert bending.still()["command"]
    bending.change(Asked({"rest": True}))
    assert bending.still()["command"] == ""


def test_two_tabs_agree_and_a_returning_one_finds_the_beam_as_it_was(working: TestClient) -> None:
    with opened(working) as one, opened(working) as other:
        for socket in (one, other):
            socket.send_json({"do": "open", "model": "beam"})
            heard(socket, "beam")
        one.send_json({"do": "drag", "model": "beam", "n": 1, "goal": [0.14, 0.03]})
        seen = [heard(socket, "answer") for socket in (one, other)]
        assert seen[0] == seen[1]
        one.send_json({"do": "set", "model": "beam", "settings": {"point_s": 0.8, "push_s": 0.8}})
        assert heard(other, "beam")["opened"]["point_s"] == 0.8
    with opened(working) as again:
        again.send_json({"do": "open", "model": "beam"})
        found = heard(again, "beam")
        assert found["opened"]["push_s"] == 0.8
        again.send_json({"do": "set", "model": "beam", "settings": {"point_s": 1.0, "push_s": 1.0, "rest": True}})
        assert heard(again, "beam")["answer"]["force_N"] == [0.0, 0.0]


@pytest.mark.slow
def test_of_many_drags_the_last_is_answered(working: TestClient) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "map")
        for n in range(60):
            socket.send_json({"do": "drag", "model": "beam", "n": n, "goal": [0.14, 0.02 + 0.0005 * n]})
        answers: list[int] = []
        while not answers or answers[-1] != 59:
            answers.append(heard(socket, "answer")["n"])
    assert answers == sorted(answers)


def test_a_hand_holds_the_end_and_says_how_far_it_gets(working: TestClient) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "beam")
        socket.send_json({"do": "drag", "model": "beam", "n": 1, "goal": [0.135, 0.05]})
        heard(socket, "answer")
        socket.send_json({"do": "set", "model": "beam", "settings": {"mode": "hand", "max_force_N": 20.0}})
        answer = heard(socket, "beam")["answer"]
        assert len(heard(socket, "edge")["edge"]) == 36
        x, y, angle = answer["pose"]
        socket.send_json({"do": "drag", "model": "beam", "n": 2, "goal": [x, y, angle + 0.02]})
        turned = heard(socket, "answer")["answer"]
        assert turned["pose"][2] == pytest.approx(angle + 0.02, abs=1e-6)
        assert turned["moment_N_m"] != 0.0
        assert "--moment" in turned["command"]
        socket.send_json({"do": "set", "model": "beam", "settings": {"mode": "point"}})
        heard(socket, "beam")


@pytest.mark.parametrize("mode", ["hand", "point"])
def test_no_edge_is_told_of_a_hand_that_has_let_go(folder: Path, monkeypatch: pytest.MonkeyPatch, mode: str) -> None:
    bending = bending_of("beam", folder / "beam")
    bending.change(Asked({"mode": "hand"}))
    told: list[dict[str, Any]] = []

    async def late(*_: Any) -> list[Any]:
        if mode == "point":
            bending.change(Asked({"mode": mode}))
        return []

    async def edge() -> None:
        desk = Desk(StudioFolder(folder))
        monkeypatch.setattr(desk, "_aside", late)
        monkeypatch.setattr(desk, "tell", told.append)
        desk.beams["beam"] = bending
        await desk._edge("beam")
        await desk.end()

    asyncio.run(edge())
    assert [one["what"] for one in told] == (["edge"] if mode == "hand" else [])


@pytest.mark.parametrize("model", ["nowhere", "../beam", "/etc"])
def test_a_beam_that_is_not_there_is_said(working: TestClient, model: str) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": model})
        assert socket.receive_json()["what"] == "hello"
        assert socket.receive_json()["what"] == "error"


@pytest.mark.parametrize(
    "message",
    [
        "[]", "3", "{", '{"do": "drag"}', '{"do": "drag", "model": "beam", "n": 1, "goal": ["x"]}',
        '{"do": "drag", "model": "beam", "n": 1e999, "goal": [0.1, 0.1]}',
    ],
)  # fmt: skip
def test_what_is_no_message_of_the_page_ends_the_socket(working: TestClient, message: str) -> None:
    with opened(working) as socket:
        assert socket.receive_json()["what"] == "hello"
        socket.send_text(message)
        assert socket.receive()["type"] == "websocket.close"


def test_a_fault_of_the_server_is_told_and_reported_and_the_socket_stays(
    working: TestClient, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "beam")
        for fault in (ValueError, KeyError, RuntimeError, OverflowError):
            with monkeypatch.context() as patch:
                patch.setattr(Bending, "still", raising(fault))
                socket.send_json({"do": "open", "model": "beam"})
                while (message := socket.receive_json())["what"] != "error":
                    pass
            assert f"a fault of onebend's own ({fault.__name__}" in message["text"]
            [report] = tmp_path.glob("onebend-crash-*.txt")
            assert report.name in message["text"]
            assert report.name in capsys.readouterr().err
            assert "the server's own" in report.read_text(encoding="utf-8")
            report.unlink()
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "beam")


def raising(kind: type[Exception]) -> Callable[..., None]:
    def fail(*_: object) -> None:
        raise kind("the server's own")

    return fail


def test_a_tab_that_goes_is_forgotten_without_a_word(
    working: TestClient, capsys: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "beam")
    with opened(working) as socket:  # the server has let the first tab go
        heard(socket, "hello")
    assert capsys.readouterr().err == ""
    assert not recwarn.list


@pytest.mark.parametrize(
    "settings",
    [
        {"mode": "foot"}, {"push_s": "x"}, {"max_force_N": [1]},
        {"push_s": 0.0}, {"push_s": 1e-12}, {"point_s": 2}, {"max_force_N": -1},
        {"max_force_N": float("nan")}, {"max_force_N": 1e300},
    ],
)  # fmt: skip
def test_settings_without_meaning_are_refused(folder: Path, settings: dict[str, Any]) -> None:
    bending = bending_of("beam", folder / "beam")
    with pytest.raises(StudioError):
        bending.change(Asked(settings))
    assert bending.version == 0


def test_a_fault_in_one_drag_is_said_and_the_next_is_answered(
    working: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        shown = heard(socket, "beam")
        with monkeypatch.context() as patch:
            patch.setattr(Bending, "drag", lambda *_: 1 // 0)
            socket.send_json({"do": "drag", "model": "beam", "n": 1, "goal": [0.1, 0.1]})
            for _ in range(200):
                if (message := socket.receive_json())["what"] == "error":
                    break
            assert "a fault of onebend's own (ZeroDivisionError" in message["text"]
        socket.send_json({"do": "drag", "model": "beam", "n": 2, "goal": shown["answer"]["pose"][:2]})
        assert heard(socket, "answer")["n"] == 2


def test_a_goal_without_meaning_is_refused(folder: Path) -> None:
    bending = bending_of("beam", folder / "beam")
    for goal in ([0.1], [float("nan"), 0.0], [0.0] * 4):
        with pytest.raises(StudioError):
            bending.drag(goal)


def test_a_beam_that_was_learned_anew_is_opened_again(working: TestClient, folder: Path) -> None:
    with opened(working) as socket:
        socket.send_json({"do": "open", "model": "beam"})
        heard(socket, "beam")
        (folder / "odd").mkdir(exist_ok=True)
        (folder / "odd" / "recording.toml").write_text("format = 1\n")
        asked = {"recordings": ["odd"], "out": "beam"}
        assert working.post("/api/learn", json=asked, headers=own()).status_code == 200
        assert heard(socket, "forgotten")["model"] == "beam"
        socket.send_json({"do": "open", "model": "beam"})
        assert heard(socket, "beam")["opened"]["model"] == "beam"
