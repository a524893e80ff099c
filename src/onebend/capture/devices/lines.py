"""Load cells that send a line of numbers a sample over a serial port, and logs that another program is writing."""

from __future__ import annotations

import os
import select
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.devices.cells import SEPARATORS, Cells, cells_of
from onebend.capture.sources import End, Samples
from onebend.errors import RecordingError
from onebend.records import Array

try:
    import termios
except ImportError:  # there are none on Windows
    termios = None  # type: ignore[assignment]

TIMING = StampTiming(own=False, delay=0.002, delay_error=0.03)
MOST_LINE = 4096  # bytes
SILENT = 3.0  # s without a line
UNREADABLE = 20  # lines in a row
POLL = 0.02  # s between looks at a file
LONG_AGO = 30.0  # s without a row in a file


class _Lines:
    """Bytes to rows."""

    def __init__(self, name: str, cells: Cells) -> None:
        self.name, self.columns = name, cells.columns
        self.timing = replace(TIMING, own=cells.time >= 0)
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
        self._clock: Clock | None = None
        self._heard, self._begun = 0.0, False

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
        self._clock, self._heard = clock, clock.now()

    def read(self, wait: float) -> Samples | End | None:
        """The lines that came."""
        assert self._clock is not None
        try:
            ready, _, _ = select.select([self._handle], [], [], wait)
            data = os.read(self._handle, 65536) if ready else b""
        except OSError as wrong:
            return End(f"{self.name} is gone ({wrong.strerror}): its cable was pulled", fault=True)
        now = self._clock.now()
        if ready and not data:
            return End(f"{self.name} is gone: its cable was pulled", fault=True)
        if data:
            self._heard = now
        if not self._begun and b"\n" in data:  # the first line has no beginning
            data, self._begun = data[data.index(b"\n") + 1 :], True
        samples = self._rows(data, now) if self._begun else None
        if self._bad >= UNREADABLE:
            wanted = f"{self._cells.count} numbers"
            return End(
                f"{self.name} sends {self._last[:60]!r}, and {wanted} were expected: correct columns", fault=True
            )
        if now - self._heard > SILENT:
            return End(f"{self.name} sends nothing: is it switched on, and is baud={self._baud} right?", fault=True)
        return samples

    def close(self) -> None:
        """Leave the port."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def _plain(handle: int, speed: int) -> None:
    """Bytes as they come, 8 bits, no parity, one stop bit."""
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
        self._clock: Clock | None = None
        self._heard = 0.0

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
        self._clock, self._heard = clock, clock.now()

    def read(self, wait: float) -> Samples | End | None:
        """The rows that were added."""
        assert self._clock is not None
        try:
            data = self._stream.read(1 << 20)
            if not data:
                if os.fstat(self._stream.fileno()).st_size < self._stream.tell():
                    return End(f"{self.name} was written anew", fault=True)
                self._clock.wait_until(self._clock.now() + min(wait, POLL))
                data = self._stream.read(1 << 20)
        except OSError as wrong:
            return End(f"{self.name} cannot be read any more ({wrong.strerror})", fault=True)
        now = self._clock.now()
        samples = self._rows(data, now)
        if samples is not None:
            self._heard = now
        if self._bad >= UNREADABLE:
            return End(f"{self.name} has lines such as {self._last[:60]!r}: correct columns", fault=True)
        return End(f"{self.name} does not grow any more", fault=True) if now - self._heard > LONG_AGO else samples

    def close(self) -> None:
        """Leave the file."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _header(self) -> list[str]:
        try:
            with self._path.open("rb") as stream:
                line = stream.readline(MOST_LINE).decode("utf-8", "replace")
        except OSError as wrong:
            raise RecordingError(f"csv:{self._path} cannot be read ({wrong.strerror}). Begin to log first.") from None
        if not line.strip():
            raise RecordingError(f"csv:{self._path} has no header yet. Begin to log first, or name its columns.")
        return [name for name in SEPARATORS.split(line.strip()) if name]
