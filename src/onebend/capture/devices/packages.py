"""What their makers' own packages read: Universal Robots, Franka, the Lab Streaming Layer."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.devices.cells import Cells
from onebend.capture.sources import End, Samples
from onebend.errors import RecordingError
from onebend.extras import package

WRENCH = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
TOGETHER = 0.01  # s of rows that are given together
PATIENCE = 5.0  # s to find a stream
SILENT = 3.0  # s without a row


class _Robot:
    """A robot whose state is asked for, again and again."""

    columns: tuple[str, ...] = WRENCH

    def __init__(self, name: str, rate: float) -> None:
        self.name = name
        self.timing = StampTiming(delay=0.001, delay_error=0.01)
        self._rate = rate
        self._last = -np.inf
        self._clock: Clock | None = None
        self._heard = 0.0

    def read(self, wait: float) -> Samples | End | None:
        """The rows of the next moments."""
        assert self._clock is not None
        until = self._clock.now() + min(max(wait, 0.0), TOGETHER)
        rows: list[tuple[float, list[float]]] = []
        while True:
            try:
                time, force = self._state()
            except Exception as wrong:  # each package has errors of its own
                return End(f"{self.name} answers no more ({wrong})", fault=True)
            if time > self._last:
                rows.append((time, force))
                self._last, self._heard = time, self._clock.now()
            if self._clock.now() >= until:
                break
            self._clock.wait_until(min(until, self._clock.now() + 0.25 / self._rate))
        if rows:
            stamp, force_rows = zip(*rows, strict=True)
            return Samples(np.array(stamp), np.array(force_rows, dtype=float), self._heard)
        silent = self._clock.now() - self._heard > SILENT
        return End(f"{self.name} stands still: its time goes on no more", fault=True) if silent else None

    def _state(self) -> tuple[float, list[float]]:
        raise NotImplementedError


class UrForce(_Robot):
    """The wrench at a Universal Robot's tool, in the axes of its base, through `ur-rtde`."""

    def __init__(self, host: str, *, rate: float = 500.0) -> None:
        super().__init__(f"the robot {host}", rate)
        self._host = host
        self._robot: Any = None

    def open(self, clock: Clock) -> None:
        """Connect.

        Raises:
            RecordingError: the package is missing, or the robot does not answer.
        """
        made = package("rtde_receive", "ur")
        try:
            self._robot = made.RTDEReceiveInterface(self._host, self._rate)
        except Exception as wrong:
            raise RecordingError(f"{self.name} does not answer ({wrong}). Is it on, and is RTDE allowed?") from None
        self._clock, self._heard = clock, clock.now()

    def close(self) -> None:
        """Disconnect."""
        if self._robot is not None:
            self._robot.disconnect()
            self._robot = None

    def _state(self) -> tuple[float, list[float]]:
        if not self._robot.isConnected():
            raise ConnectionError("the connection was lost")
        return float(self._robot.getTimestamp()), list(self._robot.getActualTCPForce())


class FrankaForce(_Robot):
    """The outer wrench that a Franka arm estimates (`O_F_ext_hat_K`), in its base's axes, through `pylibfranka`."""

    def __init__(self, host: str) -> None:
        super().__init__(f"the arm {host}", 1000.0)
        self._host = host
        self._robot: Any = None

    def open(self, clock: Clock) -> None:
        """Connect; nothing is asked to move.

        Raises:
            RecordingError: the package is missing, or the arm does not answer.
        """
        made = package("pylibfranka", "franka")
        try:
            self._robot = made.Robot(self._host, made.RealtimeConfig.kIgnore)
        except Exception as wrong:
            raise RecordingError(
                f"{self.name} does not answer ({wrong}). Is FCI active, and nobody else on it?"
            ) from None
        self._clock, self._heard = clock, clock.now()

    def close(self) -> None:
        """Disconnect."""
        self._robot = None

    def _state(self) -> tuple[float, list[float]]:
        state = self._robot.read_once()
        return float(state.time.to_sec()), list(state.O_F_ext_hat_K)


class LslForce:
    """A stream of the Lab Streaming Layer, by its name, through `pylsl`."""

    def __init__(self, stream: str, cells: Cells) -> None:
        """`cells`: its channels, in order."""
        self.name, self.columns = f"the stream {stream}", cells.columns
        self.timing = StampTiming(delay=0.0005, delay_error=0.01)
        self._stream, self._cells = stream, cells
        self._inlet: Any = None
        self._clock: Clock | None = None
        self._heard = 0.0

    def open(self, clock: Clock) -> None:
        """Find the stream, and listen.

        Raises:
            RecordingError: the package is missing, there is no such stream, or it has other channels.
        """
        made = package("pylsl", "lsl")
        found = made.resolve_byprop("name", self._stream, 1, PATIENCE)
        if not found:
            raise RecordingError(
                f"lsl:{self._stream}: no such stream is on this network. Start it, or correct its name."
            )
        count = int(found[0].channel_count())
        if count != self._cells.count:
            raise RecordingError(
                f"{self.name} has {count} channels, and columns names {self._cells.count}. Name each, in order; _ for "
                "one that is left out."
            )
        self._inlet = made.StreamInlet(found[0], recover=False)
        self._inlet.open_stream(PATIENCE)
        self._clock, self._heard = clock, clock.now()

    def read(self, wait: float) -> Samples | End | None:
        """What came."""
        assert self._clock is not None
        try:
            rows, stamps = self._inlet.pull_chunk(timeout=min(wait, TOGETHER))
        except Exception as wrong:  # a LostError, of the package
            return End(f"{self.name} ended ({type(wrong).__name__})", fault=True)
        now = self._clock.now()
        if not len(stamps):
            return End(f"{self.name} sends nothing", fault=True) if now - self._heard > SILENT else None
        self._heard = now
        read = np.asarray(rows, dtype=float)
        return Samples(np.array(stamps, dtype=float), np.column_stack(list(self._columns(read))), now)

    def close(self) -> None:
        """Listen no more."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None

    def _columns(self, rows: Any) -> Iterator[Any]:
        for place, scale in zip(self._cells.place, self._cells.scale, strict=True):
            yield scale * rows[:, place] if place >= 0 else np.zeros(len(rows))
