"""Load cells on a pseudo-terminal, and logs that another program writes."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.live.force_sensors import KILOPOND, GrowingLog, SerialForce, cells_of
from onebend.live.sources import End, HostClock, Samples
from onebend.live.specs import force_of

pty = pytest.importorskip("pty")


class Cell:
    """The other end of the wire."""

    def __init__(self) -> None:
        self.wire, self._inside = pty.openpty()
        self.port = Path(os.ttyname(self._inside))

    def send(self, text: str) -> None:
        os.write(self.wire, text.encode())

    def pull(self) -> None:
        """The cable."""
        for handle in (self._inside, self.wire):
            if handle >= 0:
                os.close(handle)
        self._inside = self.wire = -1


@pytest.fixture
def cell() -> Iterator[Cell]:
    made = Cell()
    yield made
    made.pull()


class Hand(HostClock):
    """A clock that is set by hand."""

    passed = 0.0

    def now(self) -> float:
        return self.passed


def opened(cell: Cell, columns: str, clock: HostClock | None = None, zero: str = "") -> SerialForce:
    cells = cells_of(columns.split("/"), [zero] if zero else [], where="serial")
    sensor = SerialForce(cell.port, cells)
    sensor.open(clock or HostClock())
    return sensor


def read(sensor: SerialForce | GrowingLog) -> Samples:
    """The next rows; a line may take a moment to pass."""
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        got = sensor.read(0.05)
        if got is not None:
            assert isinstance(got, Samples), got
            return got
    raise AssertionError("nothing came")


def test_lines_are_read_in_their_units(cell: Cell) -> None:
    sensor = opened(cell, "time_ms/fx_g/fy_mN/_")
    cell.send("7,1\n1500, 100.0; -20\tabc\n")
    got = read(sensor)
    assert sensor.columns == ("fx_N", "fy_N")
    assert got.stamp == pytest.approx([1.5])
    assert got.force == pytest.approx(np.array([[0.1 * KILOPOND, -0.02]]))
    assert sensor.timing.own
    sensor.close()


def test_a_line_may_come_in_parts_and_a_broken_one_is_counted(cell: Cell) -> None:
    sensor = opened(cell, "fx_N/fy_N")
    cell.send("half a line\n1.0,2.0\n3.")
    assert read(sensor).force == pytest.approx(np.array([[1.0, 2.0]]))
    cell.send("5,4.0\n# a word\n9,9\n")
    got = read(sensor)
    assert got.force == pytest.approx(np.array([[3.5, 4.0], [9.0, 9.0]]))
    assert got.lost == 1
    assert not sensor.timing.own
    sensor.close()


def test_a_counter_says_what_is_lost(cell: Cell) -> None:
    sensor = opened(cell, "number/fx_N/fy_N")
    cell.send("\n1,0,0\n2,0,0\n6,0,0\n")
    assert read(sensor).lost == 3
    cell.send("8,0,0\n")
    assert read(sensor).lost == 1
    sensor.close()


def test_a_force_that_cannot_be_is_said_to_be_zero(cell: Cell) -> None:
    sensor = opened(cell, "fy_N", zero="fx_N")
    cell.send("\n2.5\n")
    assert read(sensor).force == pytest.approx(np.array([[0.0, 2.5]]))
    sensor.close()


def test_a_pulled_cable_ends_it(cell: Cell) -> None:
    sensor = opened(cell, "fx_N/fy_N")
    cell.pull()
    got = sensor.read(1.0)
    assert isinstance(got, End)
    assert got.fault
    assert "its cable was pulled" in got.why
    sensor.close()


def test_other_lines_than_expected_are_told(cell: Cell) -> None:
    sensor = opened(cell, "fx_N/fy_N")
    cell.send("\n" + "ST,GS,+0.1kg\n" * 25)
    got = None
    for _ in range(50):
        if (got := sensor.read(0.05)) is not None:
            break
    assert isinstance(got, End)
    assert "'ST,GS,+0.1kg', and 2 numbers were expected" in got.why
    sensor.close()


def test_silence_is_told(cell: Cell) -> None:
    clock = Hand()
    sensor = opened(cell, "fx_N/fy_N", clock)
    assert sensor.read(0.001) is None
    clock.passed = 4.0
    got = sensor.read(0.001)
    assert isinstance(got, End)
    assert "baud=115200" in got.why
    sensor.close()


def test_lines_without_an_end_are_told(cell: Cell) -> None:
    clock = Hand()
    sensor = opened(cell, "fx_N/fy_N", clock)
    for clock.passed in (0.0, 2.0, 4.0):
        cell.send("0.1 0.2 ")
        got = sensor.read(1.0)
    assert isinstance(got, End)
    assert "sends no line" in got.why
    sensor.close()


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("fx_N", "two forces are needed"),
        ("fx_N/fx_kg", "named twice"),
        ("fx/fy_N", "'fx' has no meaning"),
        ("time_h/fx_N/fy_N", "'time_h' has no meaning"),
    ],
)
def test_columns_without_a_meaning_are_refused(columns: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        cells_of(columns.split("/"), where="serial:/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("serial:/dev/ttyNone,columns=fx_N/fy_N", "there is no such port"),
        ("serial:/dev/null,columns=fx_N/fy_N", "is no serial port"),
        ("serial:/dev/ttyUSB0", "say what a line holds"),
        ("serial:/dev/ttyNone,columns=fx_N/fy_N,baud=7", "must be a number from 50"),
        ("serial:/dev/ttyNone,columns=fx_N/fy_N,baud=12345", "no rate of a serial port"),
        ("serial:/dev/ttyNone,colums=fx_N", "has no key colums"),
        ("csv:/nowhere.csv", "Begin to log first"),
        ("usb:0", "there is no such source"),
    ],
)
def test_what_cannot_be_opened_says_what_to_do(spec: str, says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        force_of(spec).open(HostClock())


def test_a_growing_log_gives_what_is_added(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,fx_N,fy_N,tz_Nm\n0.0,1,1,1\n0.1,")
    log = GrowingLog(path)
    log.open(HostClock())
    assert log.read(0.0) is None
    with path.open("a") as stream:
        stream.write("2,2,2\n0.2,3,")
        stream.flush()
        got = read(log)
        assert (got.stamp.tolist(), got.force.tolist()) == ([0.1], [[2.0, 2.0, 2.0]])
        stream.write("4,5\n")
    assert read(log).force.tolist() == [[3.0, 4.0, 5.0]]
    path.write_text("time_s\n")
    got_end = log.read(0.0)
    assert isinstance(got_end, End)
    assert "was written anew" in got_end.why
    log.close()


@pytest.mark.parametrize("how", ["deleted", "replaced by another file"])
def test_a_log_that_is_gone_is_told_at_once(tmp_path: Path, how: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,fx_N,fy_N\n")
    log = GrowingLog(path)
    log.open(HostClock())
    with path.open("a") as stream:
        stream.write("0.0,1,2\n")
    (path.unlink if how == "deleted" else lambda: path.rename(tmp_path / "older.csv"))()
    if how != "deleted":
        path.write_text("time_s,fx_N,fy_N\n0.1,1,1\n")
    assert read(log).force.tolist() == [[1.0, 2.0]]  # what was written before
    got = log.read(0.0)
    assert isinstance(got, End)
    assert got.fault
    assert f"was {how}" in got.why
    log.close()


def test_a_log_that_stands_still_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,a,b\n")
    log, clock = GrowingLog(path, ["time_ms", "fx_N", "fy_N"]), Hand()
    log.open(clock)
    clock.passed = 31.0
    got = log.read(0.0)
    assert isinstance(got, End)
    assert "does not grow" in got.why
    log.close()


def test_a_header_that_is_not_there_yet_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.touch()
    with pytest.raises(RecordingError, match="no header yet"):
        GrowingLog(path)
