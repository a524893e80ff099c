"""Strangers, half requests and frames that are no text cost the owner nothing, and leave no traceback."""

from __future__ import annotations

import asyncio
import http.client
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect

from onebend.studio.desk import Client, Desk
from onebend.studio.guard import Strangers
from onebend.studio.places import StudioFolder

resource = pytest.importorskip("resource")
FILES = 256  # that the studio may open
FRAME = b"\x81\x83\x00\x00\x00\x00\xff\xfe{"  # a text of three bytes, which are no UTF-8
GO = (
    "import resource, sys; resource.setrlimit(resource.RLIMIT_NOFILE, ({0}, {0})); from onebend.cli import main; main()"
)


class Studio:
    """A studio as it is started, and what it says in the terminal."""

    def __init__(self, folder: Path, said: Path) -> None:
        self.said = said
        with said.open("w") as out:
            line = [sys.executable, "-c", GO.format(FILES), "studio", str(folder), "--no-open"]
            self.process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=out, text=True)
        assert self.process.stdout is not None
        found = None
        while found is None and (row := self.process.stdout.readline()):
            found = re.search(r"http://127\.0\.0\.1:(\d+)/\?token=(\S+)", row)
        assert found is not None
        self.port, self.token = int(found[1]), found[2]
        self.cookie = self.enter()

    def connected(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=30.0)

    def enter(self) -> str:
        """As the owner who opens the address; the cookie."""
        asked = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        asked.request("GET", f"/?token={self.token}")
        answer = asked.getresponse()
        assert answer.status == 303
        asked.close()
        return str(answer.headers["set-cookie"]).partition(";")[0]

    def head(self, line: str, cookie: str = "", *more: str) -> bytes:
        here = f"127.0.0.1:{self.port}"
        rows = [f"{line} HTTP/1.1", f"Host: {here}", f"Origin: http://{here}", *more]
        return "\r\n".join([*rows, *([f"Cookie: {cookie}"] if cookie else []), "", ""]).encode()

    def socket_head(self, cookie: str = "") -> bytes:
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
        return self.head(
            "GET /socket", cookie, "Upgrade: websocket", "Connection: Upgrade", key, "Sec-WebSocket-Version: 13"
        )

    def end(self) -> None:
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(30) == 0
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture(scope="module")
def studio(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    made = Studio(folder, tmp_path_factory.mktemp("terminal") / "stderr.txt")
    yield made
    made.end()


SENT = ("nothing", "half a request", "a request", "a socket")
QUICKLY = "half a request"


@pytest.mark.parametrize("sent", [pytest.param(one, marks=() if one == QUICKLY else pytest.mark.slow) for one in SENT])
def test_strangers_do_not_lock_the_owner_out(studio: Studio, sent: str) -> None:
    data = {
        "nothing": b"",
        "half a request": b"GET / HTTP/1.1\r\nHost: 1",
        "a request": studio.head("GET /"),
        "a socket": studio.socket_head(),
    }[sent]
    strangers = []
    for _ in range(2 * FILES):
        strangers.append(studio.connected())
        strangers[-1].sendall(data)
    assert studio.enter()
    for one in strangers:
        one.close()
    assert studio.said.read_text() == ""


@pytest.mark.slow
def test_what_is_cut_or_no_text_leaves_no_traceback(studio: Studio) -> None:
    with studio.connected() as cut:
        cut.sendall(studio.head("POST /api/learn", studio.cookie, "Content-Length: 1000") + b"{")
    with studio.connected() as tab:
        tab.sendall(studio.socket_head(studio.cookie) + FRAME)
        while tab.recv(4096):  # it is closed
            pass
    assert studio.enter()
    said = studio.said.read_text()
    assert "Traceback" not in said
    assert len(said.splitlines()) <= 1


class Wire:
    """A connection as asyncio has it."""

    def __init__(self, port: int) -> None:
        self.port, self.closed = port, False

    def get_extra_info(self, _: str) -> tuple[str, int]:
        return "127.0.0.1", self.port

    def is_closing(self) -> bool:
        return self.closed

    def close(self) -> None:
        self.closed = True


def test_of_too_many_strangers_the_oldest_goes_and_nobody_who_is_known() -> None:
    strangers, wires = Strangers(3), [Wire(port) for port in range(8)]
    for wire in wires[:4]:
        strangers.came(wire)  # type: ignore[arg-type]
        if wire is wires[0]:
            strangers.known(("127.0.0.1", 0))
    wires[1].close()
    for wire in wires[4:]:
        strangers.came(wire)  # type: ignore[arg-type]
    assert [wire.closed for wire in wires] == [False, True, True, True, True, False, False, False]


def test_a_fault_of_the_servers_own_is_said_and_no_going_of_a_tab(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A message that is none: the tab is told, and gets the next one."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    sent: list[str] = []

    class Tab:
        async def send_text(self, text: str) -> None:
            sent.append(text)
            if len(sent) == 2:
                raise WebSocketDisconnect

    tab: Any = Tab()
    client = Client(tab)
    client.put({"what": "map", "map": object()})
    client.put({"what": "answer"})
    asyncio.run(asyncio.wait_for(client.write(), 30.0))
    assert "a fault of onebend's own (TypeError" in sent[0]
    assert sent[1] == '{"what": "answer"}'

    async def broken() -> None:
        raise KeyError("model")

    async def watched() -> list[Any]:
        told: list[Any] = []
        await Desk(StudioFolder.of(folder))._watched(broken(), told.append)
        return told

    [said] = asyncio.run(watched())
    assert "KeyError" in said["text"]
    assert "KeyError" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == 2
