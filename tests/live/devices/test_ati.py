"""A box that speaks ATI's RDT, on the loopback interface, made from the maker's manual."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.live.force_sensors import POUND, AtiForce, AtiScale, read_scale
from onebend.live.sources import End, HostClock, Samples
from onebend.live.specs import force_of

PAGE = """<?xml version="1.0"?><netft><runstat>00000000</runstat><cfgcpf>{counts}</cfgcpf><cfgcpt>1000000</cfgcpt>
<scfgfu>{unit}</scfgfu><scfgtu>N-m</scfgtu><comrdte>Enabled</comrdte><comrdtrate>1000</comrdtrate></netft>"""


class Box:
    """It answers a request of 8 bytes with as many records as the test puts in."""

    def __init__(self, first: int = 0) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.port, self.number, self.peer = self.socket.getsockname()[1], first, ("", 0)

    def asked(self) -> tuple[int, int, int]:
        """The next request: header, command, count."""
        data, self.peer = self.socket.recvfrom(100)
        header, command, count = struct.unpack("!HHI", data)
        return header, command, count

    def send(self, force: tuple[float, ...], *, skip: int = 0, status: int = 0) -> None:
        self.number = (self.number + 1 + skip) % 2**32
        counts = [round(1e6 * value) for value in (*force, 0.1, 0.2, 0.3)]
        record = struct.pack("!IIIiiiiii", self.number, 7 * self.number % 2**32, status, *counts)
        self.socket.sendto(record, self.peer)


@pytest.fixture
def box() -> Iterator[Box]:
    made = Box()
    yield made
    made.socket.close()


@pytest.fixture
def web() -> Iterator[Any]:
    """A web page of a box; its text can be changed."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            text = server.page.encode()  # type: ignore[attr-defined]
            self.send_response(200 if self.path == "/netftapi2.xml" else 404)
            self.send_header("Content-Length", str(len(text)))
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Page)
    server.page = PAGE.format(counts=1000000, unit="N")  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def opened(box: Box, scale: AtiScale | None = AtiScale(1e6, 1e6, 1000.0), **more: Any) -> AtiForce:
    sensor = AtiForce("127.0.0.1", port=box.port, scale=scale, **more)
    sensor.open(HostClock())
    return sensor


def test_records_become_newtons_with_stamps_of_their_count(box: Box) -> None:
    sensor = opened(box)
    assert box.asked() == (0x1234, 2, 0)
    for force in ((1.0, -2.0, 3.5), (1.5, -2.0, 3.5)):
        box.send(force)
    got = sensor.read(1.0)
    assert isinstance(got, Samples)
    rows, stamps = got.force, got.stamp
    if len(rows) < 2:  # the second one may come a moment later
        more = sensor.read(1.0)
        assert isinstance(more, Samples)
        rows, stamps = np.concatenate([rows, more.force]), np.concatenate([stamps, more.stamp])
    assert rows == pytest.approx(np.array([[1.0, -2.0, 3.5, 0.1, 0.2, 0.3], [1.5, -2.0, 3.5, 0.1, 0.2, 0.3]]))
    assert np.diff(stamps) == pytest.approx([1e-3])
    sensor.close()
    assert box.asked() == (0x1234, 0, 0)


def test_lost_records_leave_a_gap_over_the_end_of_the_count() -> None:
    box = Box(first=2**32 - 3)
    sensor = opened(box)
    box.asked()
    stamps, lost = [], 0
    for skip in (0, 0, 4, 0):
        box.send((0.0, 0.0, 0.0), skip=skip)
        got = sensor.read(1.0)
        assert isinstance(got, Samples)
        stamps.append(float(got.stamp[0]))
        lost += got.lost
    assert np.diff(stamps) == pytest.approx([1e-3, 5e-3, 1e-3])
    assert lost == 4
    sensor.close()
    box.socket.close()


def test_an_error_of_the_sensor_is_told(box: Box) -> None:
    sensor = opened(box)
    box.asked()
    box.send((0.0, 0.0, 0.0), status=0x80010000)
    got = sensor.read(1.0)
    assert isinstance(got, End)
    assert got.fault
    assert "status 0x80010000" in got.why
    sensor.close()


def test_a_silent_box_is_asked_again_and_then_given_up(box: Box) -> None:
    class Slow(HostClock):
        passed = 0.0

        def now(self) -> float:
            return self.passed

    clock = Slow()
    sensor = AtiForce("127.0.0.1", port=box.port, scale=AtiScale(1e6, 1e6))
    sensor.open(clock)
    clock.passed = 1.5
    assert sensor.read(0.001) is None
    assert [box.asked()[1], box.asked()[1]] == [2, 2]
    clock.passed = 4.0
    got = sensor.read(0.001)
    assert isinstance(got, End)
    assert "sends nothing" in got.why
    sensor.close()


def test_the_scale_is_read_from_the_boxs_page(web: Any) -> None:
    port = web.server_address[1]
    assert read_scale("127.0.0.1", port) == AtiScale(1e6, 1e6, 1000.0)
    web.page = PAGE.format(counts=1000000, unit="lbf")
    assert read_scale("127.0.0.1", port).per_newton == pytest.approx(1e6 / POUND)


@pytest.mark.parametrize(
    ("page", "says"),
    [
        ("no page", "cannot be read"),
        (PAGE.format(counts=0, unit="N"), "0 counts a unit of force"),
        (PAGE.format(counts=1, unit="stone"), "does not say 'stone'"),
        ("<netft/>", "does not say 'scfgfu'"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><netft/>', "it is no plain XML"),
    ],
)
def test_another_page_is_told_with_a_way_out(web: Any, page: str, says: str) -> None:
    web.page = page
    with pytest.raises(RecordingError, match=says) as told:
        read_scale("127.0.0.1", web.server_address[1])
    assert "counts=1000000" in str(told.value)


def answering(answer: Callable[[socket.socket], None]) -> Iterator[int]:
    """The port of somebody who takes one request and answers in a way of his own."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                peer, _ = server.accept()
                with peer:
                    peer.recv(1000)
                    answer(peer)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield server.getsockname()[1]
    thread.join(10.0)


def test_nobody_is_asked_but_the_box(web: Any) -> None:
    there = f"http://127.0.0.1:{web.server_address[1]}/netftapi2.xml"

    def send_on(peer: socket.socket) -> None:
        peer.sendall(f"HTTP/1.0 302 Found\r\nLocation: {there}\r\nContent-Length: 0\r\n\r\n".encode())

    answers = contextmanager(answering)(send_on)
    with answers as port, pytest.raises(RecordingError, match="it answers with status 302"):
        read_scale("127.0.0.1", port)


def test_the_spec_names_a_box(box: Box, web: Any) -> None:
    sensor = force_of(f"ati:127.0.0.1,port={box.port},web_port={web.server_address[1]}")
    sensor.open(HostClock())
    assert box.asked()[1] == 2
    assert sensor.timing.own
    sensor.close()
