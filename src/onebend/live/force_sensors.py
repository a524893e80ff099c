"""What the cells of a line are: forces with their units, a time, a counter; for load cells that send lines, and for
logs that grow."""

from __future__ import annotations

import math
import os
import re
import select
import socket
import struct
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.errors import RecordingError
from onebend.extras import Extra, package
from onebend.live.sources import Clock, Device, End, Samples, StampTiming
from onebend.records import Array

POUND, KILOPOND = 4.4482216152605, 9.80665  # N
UNITS = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "g": 1e-3 * KILOPOND, "kg": KILOPOND, "lbf": POUND}
MOMENTS = {"Nm": 1.0, "N_m": 1.0, "mNm": 1e-3, "Nmm": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
IGNORED, COUNTER = "_", "number"
KNOWN = (
    f"Name forces as fx_N, fy_mN, fz_kg ({', '.join(UNITS)}), moments as tz_Nm, a time as time_s or time_ms, "
    f"{COUNTER} for a counter, {IGNORED} for what is left out"
)
WRENCH = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
TOOL = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")  # a robot's tool in its base: place, rotation vector
SEPARATORS = re.compile(r"[,;\s]+")


@dataclass(frozen=True)
class Cells:
    """How a line of numbers is read."""

    columns: tuple[str, ...]  # of the log: fx_N and so on
    place: tuple[int, ...]  # in the line, of each; -1: it is zero
    scale: tuple[float, ...]  # to SI
    time: int = -1  # the cell with the time; -1: there is none
    time_scale: float = 1.0
    counter: int = -1
    count: int = 0  # cells of a line

    def rows(self, lines: Sequence[str]) -> tuple[Array, int]:
        """(n, 2 + c) of the lines that can be read: time [s] (NaN where none), counter, forces; and how many could
        not."""
        read = [row for line in lines if (row := self._row(line)) is not None]
        return np.array(read).reshape(-1, 2 + len(self.columns)), len(lines) - len(read)

    def _row(self, line: str) -> list[float] | None:
        cells = [cell for cell in SEPARATORS.split(line.strip()) if cell]
        if len(cells) != self.count:
            return None
        try:
            forces = [0.0 if i < 0 else float(cells[i]) * k for i, k in zip(self.place, self.scale, strict=True)]
            time = math.nan if self.time < 0 else float(cells[self.time]) * self.time_scale
            number = math.nan if self.counter < 0 else float(cells[self.counter])
        except ValueError:
            return None
        named = [time] * (self.time >= 0) + [number] * (self.counter >= 0)
        return [time, number, *forces] if all(map(math.isfinite, (*named, *forces))) else None


def cells_of(names: Sequence[str], zero: Sequence[str] = (), *, where: str) -> Cells:
    """The cells of lines whose columns have these names, in order.

    `zero`: forces that cannot be (a roller, a thread), which no cell gives.

    Raises:
        RecordingError: a name without a meaning, no force, one force alone.
    """
    columns: list[tuple[str, int, float]] = []
    time, time_scale, counter = -1, 1.0, -1
    for i, name in enumerate(names):
        head, _, unit = name.partition("_")
        if name == COUNTER:
            counter = i
        elif head == "time" and unit in TIMES:
            time, time_scale = i, TIMES[unit]
        elif re.fullmatch(r"f[xyz]", head) and unit in UNITS:
            columns.append((f"{head}_N", i, UNITS[unit]))
        elif re.fullmatch(r"t[xyz]", head) and unit in MOMENTS:
            columns.append((f"{head}_Nm", i, MOMENTS[unit]))
        elif name == "push_s":
            columns.append((name, i, 1.0))
        elif name != IGNORED:
            raise RecordingError(f"{where}: the column {name!r} has no meaning here. {KNOWN}.")
    columns += [(name, -1, 0.0) for name in zero]
    given = [name for name, _, _ in columns]
    if len(set(given)) < len(given):
        raise RecordingError(f"{where}: a column is named twice in {', '.join(given)}.")
    if sum(name.endswith("_N") for name in given) < 2:
        raise RecordingError(
            f"{where}: two forces are needed, those in the plane of bending. Where one cannot be (a roller, a thread), "
            "say so: zero=fx_N."
        )
    columns.sort(key=lambda one: one[0])
    return Cells(
        columns=tuple(name for name, _, _ in columns),
        place=tuple(i for _, i, _ in columns),
        scale=tuple(scale for _, _, scale in columns),
        time=time,
        time_scale=time_scale,
        counter=counter,
        count=len(names),
    )


# ATI's Net F/T and Axia sensors: Raw Data Transfer over UDP (manual 9620-05-NET FT, section 9). Requests are 8 bytes
# and records 36 bytes, big-endian; `read_scale` reads counts per newton, units and rate from the box.

PORT, WEB_PORT = 49152, 80
REQUEST, RECORD = struct.Struct("!HHI"), struct.Struct("!IIIiiiiii")
HEADER, STOP, STREAM = 0x1234, 0, 2
SERIOUS = 0x80000000  # of the status: the sensor's own sum of its errors
WRAPS = 2**32
SILENT = 1.0  # s without a record: the request is sent again
LOST = 3.0  # s without one: the cable
PAGE, MOST_PAGE = "/netftapi2.xml", 1_000_000  # bytes
PAGE_SECONDS = 3.0  # without an answer
MOST_TOGETHER = 64  # records
FORCE_UNITS = {"N": 1.0, "lbf": POUND, "klbf": 1e3 * POUND, "kN": 1e3, "kgf": KILOPOND, "gf": 1e-3 * KILOPOND}
TORQUE_UNITS = {"N-m": 1.0, "Nm": 1.0, "N-mm": 1e-3, "Nmm": 1e-3, "kN-m": 1e3, "lbf-in": 0.0254 * POUND}
TORQUE_UNITS |= {"lbf-ft": 0.3048 * POUND, "kgf-cm": 0.01 * KILOPOND}


@dataclass(frozen=True)
class AtiScale:
    """What the counts are."""

    per_newton: float
    per_newton_metre: float
    rate: float = 0.0  # Hz of the records; 0: not known


class AtiForce(Device):
    """A box that is asked to stream."""

    columns: tuple[str, ...] = WRENCH

    def __init__(
        self, address: str, *, port: int = PORT, web_port: int = WEB_PORT, scale: AtiScale | None = None
    ) -> None:
        """`scale`: None: it is asked of the box."""
        super().__init__(f"the ATI sensor at {address}", StampTiming(own=False, delay=0.0005, delay_error=0.005))
        self._place, self._web, self._scale = (address, port), web_port, scale
        self._socket: socket.socket | None = None
        self._asked = 0.0
        self._number = -1.0  # of the newest record, without wraps

    def open(self, clock: Clock) -> None:
        """Read the scale, and ask for records.

        Raises:
            RecordingError: the box does not answer, or in units that are not known.
        """
        scale = self._scale or read_scale(self._place[0], self._web)
        self._scale = scale
        if scale.rate > 0.0:  # records are counted, so that those that are lost leave a gap
            self.timing = replace(self.timing, own=True, most_drift=0.05)
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.connect(self._place)
        except (OSError, ValueError) as wrong:
            raise RecordingError(
                f"{self.name} is not reached ({getattr(wrong, 'strerror', None) or wrong}). Check its address."
            ) from None
        self._begin(clock)
        self._ask(STREAM)

    def read(self, wait: float) -> Samples | End | None:
        assert self._socket is not None
        records: list[tuple[int, ...]] = []
        try:
            self._socket.settimeout(max(wait, 1e-3))
            while len(records) < MOST_TOGETHER:
                data = self._socket.recv(RECORD.size + 1)
                self._socket.settimeout(0.0)
                if len(data) == RECORD.size:
                    records.append(RECORD.unpack(data))
        except (TimeoutError, BlockingIOError, ConnectionRefusedError):
            pass
        except OSError as wrong:
            return self._fault(f"is not reached any more ({wrong.strerror or wrong})")
        if records:
            return self._samples(records)
        if self._clock.now() - self._asked > SILENT:
            self._ask(STREAM)
        return self._silence(LOST, "sends nothing: its cable, its power or its address")

    def close(self) -> None:
        if self._socket is not None:
            self._ask(STOP)
            self._socket.close()
            self._socket = None

    def _ask(self, command: int) -> None:
        assert self._socket is not None
        self._asked = self._clock.now()
        try:
            self._socket.send(REQUEST.pack(HEADER, command, 0))
        except OSError:
            return  # it is asked again, and its silence told

    def _samples(self, records: list[tuple[int, ...]]) -> Samples | End:
        assert self._scale is not None
        scale, self._heard = self._scale, self._clock.now()
        if records[-1][2] & SERIOUS:
            return self._fault(f"reports an error (status {records[-1][2]:#010x}): see its web page")
        numbers = np.array([record[0] for record in records], dtype=float)
        before = numbers[0] - 1.0 if self._number < 0 else self._number
        numbers = np.unwrap(np.append(before, numbers), period=WRAPS)
        newest = np.maximum.accumulate(numbers)
        lost, self._number = int(np.sum(np.maximum(numbers[1:] - newest[:-1] - 1.0, 0.0))), float(newest[-1])
        per = np.array([scale.per_newton] * 3 + [scale.per_newton_metre] * 3)
        counts = np.array([record[3:] for record in records], dtype=float)
        stamp = numbers[1:] / scale.rate if scale.rate > 0.0 else np.full(len(records), np.nan)
        return Samples(stamp, counts / per, self._heard, lost)


def read_scale(address: str, port: int = WEB_PORT) -> AtiScale:
    """What the box says of itself.

    Raises:
        RecordingError: it does not answer, or not so.
    """
    page = f"http://{address}:{port}{PAGE}"
    try:
        found = dict(values_in(page_of(address, port)))
    except (OSError, ValueError, HTTPException, ElementTree.ParseError) as wrong:
        raise RecordingError(
            f"{page} cannot be read ({wrong}). Check the address and the cable, or give counts=1000000 of the sensor's "
            "certificate (counts per N)."
        ) from None
    try:
        force, torque = FORCE_UNITS[found["scfgfu"]], TORQUE_UNITS[found["scfgtu"]]
        per, per_torque = float(found["cfgcpf"]), float(found["cfgcpt"])
        rate = float(found.get("comrdtrate", 0.0))
    except (KeyError, ValueError) as wrong:
        raise RecordingError(f"{page} does not say {wrong}. Give counts=1000000 (counts per N).") from None
    if not (0.0 < per < math.inf and 0.0 < per_torque < math.inf and math.isfinite(rate)):
        raise RecordingError(f"{page} says {per:g} counts a unit of force. Give counts=1000000 (counts per N).")
    return AtiScale(per / force, per_torque / torque, max(rate, 0.0))


def page_of(address: str, port: int) -> bytes:
    """The box's own page, by no proxy, and by nobody whom it sends to.

    Raises:
        OSError, HTTPException, ValueError: there is none.
    """
    with closing(HTTPConnection(address, port, timeout=PAGE_SECONDS)) as connection:
        connection.request("GET", PAGE)
        answer = connection.getresponse()
        if answer.status != HTTPStatus.OK:
            raise ValueError(f"it answers with status {answer.status}")
        return answer.read(MOST_PAGE)


def values_in(page: bytes) -> list[tuple[str, str]]:
    """Names and texts of a page's elements; it must name no entities."""
    if b"<!DOCTYPE" in page or b"<!ENTITY" in page:
        raise ValueError("it is no plain XML")
    return [(one.tag.lower(), (one.text or "").strip()) for one in ElementTree.fromstring(page).iter()]


# Load cells that send a line of numbers a sample over a serial port, and logs that another program is writing.

try:
    import termios
except ImportError:  # there are none on Windows
    termios = None  # type: ignore[assignment]

MOST_LINE = 4096  # bytes
SILENT_LINE = 3.0  # s without a line
UNREADABLE = 20  # lines in a row
POLL = 0.02  # s between looks at a file
LONG_AGO = 30.0  # s without a row in a file


class _Lines(Device):
    """Bytes to rows."""

    def __init__(self, name: str, cells: Cells) -> None:
        super().__init__(name, StampTiming(own=cells.time >= 0, delay=0.002, delay_error=0.03))
        self.columns = cells.columns
        self._cells, self._rest, self._number = cells, b"", np.nan
        self._bad = 0  # lines in a row that could not be read
        self._last = ""

    def _rows(self, data: bytes, arrival: float) -> Samples | None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-MOST_LINE:]
        texts = [line.decode("ascii", "replace").strip() for line in lines]
        texts = [line for line in texts if line]
        if not texts:
            return None
        rows, bad = self._cells.rows(texts)
        self._bad = 0 if len(rows) else self._bad + bad
        self._last = texts[-1]
        if not len(rows):
            return None
        return Samples(rows[:, 0], rows[:, 2:], arrival, bad + self._lost(rows[:, 1]))

    def _lost(self, numbers: Array) -> int:
        known = np.concatenate([[self._number], numbers])
        self._number = float(numbers[-1])
        steps = np.diff(known)
        return int(np.sum(np.where(steps > 1.0, steps - 1.0, 0.0))) if np.isfinite(steps).any() else 0


class SerialForce(_Lines):
    """A serial port, read line by line."""

    def __init__(self, port: Path, cells: Cells, *, baud: int = 115200) -> None:
        super().__init__(f"the load cell at {port}", cells)
        self._port, self._baud, self._handle = port, baud, -1
        self._begun = False

    def open(self, clock: Clock) -> None:
        """Open the port.

        Raises:
            RecordingError: there is no such port, it may not be read, or not at this rate.
        """
        if termios is None:
            raise RecordingError("serial ports are read on Linux and macOS. Let a program write a CSV: csv:PATH.")
        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise RecordingError(f"{self._port}: baud={self._baud} is no rate of a serial port. Take 9600 or 115200.")
        try:
            self._handle = os.open(self._port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            _plain(self._handle, speed)
        except FileNotFoundError:
            raise RecordingError(f"{self._port}: there is no such port. Plug it in: ls /dev/tty*") from None
        except PermissionError:
            raise RecordingError(f"{self._port} may not be read: sudo usermod -aG dialout $USER") from None
        except (OSError, termios.error) as wrong:
            raise RecordingError(f"{self._port} is no serial port ({wrong}). Name another one.") from None
        self._begin(clock)

    def read(self, wait: float) -> Samples | End | None:
        try:
            ready, _, _ = select.select([self._handle], [], [], wait)
            data = os.read(self._handle, 65536) if ready else b""
        except OSError as wrong:
            return self._fault(f"is gone ({wrong.strerror}): its cable was pulled")
        now = self._clock.now()
        if ready and not data:
            return self._fault("is gone: its cable was pulled")
        if b"\n" in data:  # bytes without an end of a line are nothing that can be read
            self._heard = now
        if not self._begun and b"\n" in data:  # the first line has no beginning
            data, self._begun = data[data.index(b"\n") + 1 :], True
        samples = self._rows(data, now) if self._begun else None
        if self._bad >= UNREADABLE:
            wanted = f"{self._cells.count} numbers were expected: correct columns"
            return self._fault(f"sends {self._last[:60]!r}, and {wanted}")
        silent = self._silence(SILENT_LINE, f"sends no line: is it switched on, and is baud={self._baud} right?")
        return silent or samples

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def _plain(handle: int, speed: int) -> None:
    iflag, oflag, cflag, lflag, _, _, cc = termios.tcgetattr(handle)
    iflag &= ~(
        termios.IGNBRK | termios.BRKINT | termios.PARMRK | termios.ISTRIP | termios.INLCR | termios.IGNCR
        | termios.ICRNL | termios.IXON
    )  # fmt: skip
    oflag &= ~termios.OPOST
    lflag &= ~(termios.ECHO | termios.ECHONL | termios.ICANON | termios.ISIG | termios.IEXTEN)
    cflag = cflag & ~(termios.CSIZE | termios.PARENB | termios.CSTOPB) | termios.CS8 | termios.CREAD | termios.CLOCAL
    termios.tcsetattr(handle, termios.TCSANOW, [iflag, oflag, cflag, lflag, speed, speed, cc])
    termios.tcflush(handle, termios.TCIFLUSH)


class GrowingLog(_Lines):
    """A CSV that another program is writing: what is added to it from now on."""

    def __init__(self, path: Path, names: Sequence[str] = (), zero: Sequence[str] = ()) -> None:
        """`names` of its columns, in order; none: those of its header.

        Raises:
            RecordingError: there is no such file, or its columns have no meaning.
        """
        self._path, self.files = path, (path,)
        if path.exists() and not path.is_file():  # a pipe would wait for its other end without end
            raise RecordingError(f"csv:{path} is no file. Name the CSV that the other program writes.")
        super().__init__(f"the log {path}", cells_of(names or self._header(), zero, where=f"csv:{path}"))
        self._stream: Any = None

    def open(self, clock: Clock) -> None:
        """Go to the end of what is there."""
        try:
            self._stream = self._path.open("rb")
            self._stream.seek(0, os.SEEK_END)
            at = self._stream.tell()
            self._stream.seek(max(at - MOST_LINE, 0))
            self._rest = self._stream.read(at - self._stream.tell()).rpartition(b"\n")[2]
        except OSError as wrong:
            raise RecordingError(f"{self._path} cannot be read ({wrong.strerror}).") from None
        self._begin(clock)

    def read(self, wait: float) -> Samples | End | None:
        try:
            data = self._stream.read(1 << 20)
            if not data:
                if gone := self._gone():
                    return self._fault(gone)
                self._clock.wait_until(self._clock.now() + min(wait, POLL))
                data = self._stream.read(1 << 20)
        except OSError as wrong:
            return self._fault(f"cannot be read any more ({wrong.strerror})")
        now = self._clock.now()
        samples = self._rows(data, now)
        if samples is not None:
            self._heard = now
        if self._bad >= UNREADABLE:
            return self._fault(f"has lines such as {self._last[:60]!r}: correct columns")
        return self._silence(LONG_AGO, "does not grow any more") or samples

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _gone(self) -> str:
        """What happened to the file that is read; empty where it is the one of that name."""
        here = os.fstat(self._stream.fileno())
        try:
            if os.path.samestat(here, self._path.stat()):
                return "was written anew" if here.st_size < self._stream.tell() else ""
        except FileNotFoundError:
            return "was deleted"
        return "was replaced by another file"

    def _header(self) -> list[str]:
        try:
            with self._path.open("rb") as stream:
                line = stream.readline(MOST_LINE).decode("utf-8", "replace")
        except OSError as wrong:
            raise RecordingError(f"csv:{self._path} cannot be read ({wrong.strerror}). Begin to log first.") from None
        if not line.strip():
            raise RecordingError(f"csv:{self._path} has no header yet. Begin to log first, or name its columns.")
        return [name for name in SEPARATORS.split(line.strip()) if name]


# What their makers' own packages read: Universal Robots, Franka.

TOGETHER = 0.01  # s of rows that are given together
SILENT_PACKAGE = 3.0  # s without a row


class _Robot(Device):
    """A robot whose state is asked for, again and again."""

    columns: tuple[str, ...] = (*WRENCH, *TOOL)
    _package: str  # its maker's
    _extra: Extra  # that brings it
    _hint: str  # to look at if it does not answer

    def __init__(self, name: str, host: str, rate: float) -> None:
        super().__init__(f"{name} {host}", StampTiming(delay=0.001, delay_error=0.01))
        self._host, self._rate, self._last = host, rate, -np.inf
        self._robot: Any = None

    def open(self, clock: Clock) -> None:
        """Connect.

        Raises:
            RecordingError: the package is missing, or the robot does not answer.
        """
        made = package(self._package, self._extra)
        try:
            self._robot = self._connected(made)
        except Exception as wrong:
            raise RecordingError(f"{self.name} does not answer ({wrong}). {self._hint}") from None
        self._begin(clock)

    def close(self) -> None:
        if self._robot is not None:
            self._disconnect()
            self._robot = None

    def read(self, wait: float) -> Samples | End | None:
        until = self._clock.now() + min(max(wait, 0.0), TOGETHER)
        rows: list[tuple[float, list[float]]] = []
        while True:
            try:
                time, force = self._state()
            except Exception as wrong:  # each package has errors of its own
                return self._fault(f"answers no more ({wrong})")
            if time > self._last:
                rows.append((time, force))
                self._last, self._heard = time, self._clock.now()
            if self._clock.now() >= until:
                break
            self._clock.wait_until(min(until, self._clock.now() + 0.25 / self._rate))
        if rows:
            stamp, force_rows = zip(*rows, strict=True)
            return Samples(np.array(stamp), np.array(force_rows, dtype=float), self._heard)
        return self._silence(SILENT_PACKAGE, "stands still: its time goes on no more")

    def _connected(self, made: Any) -> Any:
        """The robot, through its maker's package."""
        raise NotImplementedError

    def _disconnect(self) -> None:
        """Nothing, if the robot needs no goodbye."""

    def _state(self) -> tuple[float, list[float]]:
        """Its time [s], its wrench, and where its tool is."""
        raise NotImplementedError


class UrForce(_Robot):
    """The wrench at a Universal Robot's tool and the tool's pose, in the axes of its base, through `ur-rtde`."""

    _package, _extra, _hint = "rtde_receive", "ur", "Is it on, and is RTDE allowed?"

    def __init__(self, host: str, *, rate: float = 500.0) -> None:
        super().__init__("the robot", host, rate)

    def _connected(self, made: Any) -> Any:
        return made.RTDEReceiveInterface(self._host, self._rate)

    def _disconnect(self) -> None:
        self._robot.disconnect()

    def _state(self) -> tuple[float, list[float]]:
        if not self._robot.isConnected():
            raise ConnectionError("the connection was lost")
        return float(self._robot.getTimestamp()), [*self._robot.getActualTCPForce(), *self._robot.getActualTCPPose()]


class FrankaForce(_Robot):
    """The outer wrench that a Franka arm estimates (`O_F_ext_hat_K`) and its tool's pose, in its base's axes, through
    `pylibfranka`. Nothing is asked to move."""

    _package, _extra, _hint = "pylibfranka", "franka", "Is FCI active, and nobody else on it?"

    def __init__(self, host: str) -> None:
        super().__init__("the arm", host, 1000.0)

    def _connected(self, made: Any) -> Any:
        return made.Robot(self._host, made.RealtimeConfig.kIgnore)

    def _state(self) -> tuple[float, list[float]]:
        state = self._robot.read_once()
        pose = np.asarray(state.O_T_EE, dtype=float).reshape(4, 4).T  # it comes column by column
        turned = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        return float(state.time.to_sec()), [*state.O_F_ext_hat_K, *pose[:3, 3], *turned]
