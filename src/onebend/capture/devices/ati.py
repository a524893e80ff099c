"""ATI's Net F/T and Axia sensors: records over UDP, as the maker's manual of the Net F/T (9620-05-NET FT, section 9)
describes its Raw Data Transfer (RDT).

A request is 8 bytes, big-endian: 0x1234, a command (0 stop, 2 stream at once), a count (0: without end). A record is
36 bytes: a sequence number, the number of the internal sample, a status, and six counts. Counts per newton, units and
the rate stand in the page netftapi2.xml of the box.
"""

from __future__ import annotations

import math
import socket
import struct
import urllib.request
from dataclasses import dataclass, replace
from http.client import HTTPException
from xml.etree import ElementTree

import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.devices.cells import KILOPOND, POUND
from onebend.capture.sources import End, Samples
from onebend.errors import RecordingError

PORT, WEB_PORT = 49152, 80
REQUEST, RECORD = struct.Struct("!HHI"), struct.Struct("!IIIiiiiii")
HEADER, STOP, STREAM = 0x1234, 0, 2
SERIOUS = 0x80000000  # of the status: the sensor's own sum of its errors
WRAPS = 2**32
SILENT = 1.0  # s without a record: the request is sent again
LOST = 3.0  # s without one: the cable
MOST_PAGE = 1_000_000  # bytes
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


class AtiForce:
    """A box that is asked to stream."""

    columns: tuple[str, ...] = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")

    def __init__(
        self, address: str, *, port: int = PORT, web_port: int = WEB_PORT, scale: AtiScale | None = None
    ) -> None:
        """`scale`: None: it is asked of the box."""
        self.name = f"the ATI sensor at {address}"
        self.timing = StampTiming(own=False, delay=0.0005, delay_error=0.005)
        self._place, self._web, self._scale = (address, port), web_port, scale
        self._socket: socket.socket | None = None
        self._clock: Clock | None = None
        self._heard = self._asked = 0.0
        self._number = -1  # of the newest record, without wraps

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
        self._clock, self._heard = clock, clock.now()
        self._ask(STREAM)

    def read(self, wait: float) -> Samples | End | None:
        """The records that came."""
        assert self._socket is not None
        assert self._clock is not None
        records: list[tuple[int, ...]] = []
        try:
            self._socket.settimeout(max(wait, 1e-3))
            while len(records) < MOST_TOGETHER:
                data = self._socket.recv(RECORD.size + 1)
                self._socket.settimeout(0.0)
                if len(data) == RECORD.size:
                    records.append(RECORD.unpack(data))
        except (TimeoutError, BlockingIOError):
            pass
        except ConnectionRefusedError:
            return self._silence() if not records else self._samples(records)
        except OSError as wrong:
            return End(f"{self.name} is not reached any more ({wrong.strerror or wrong})", fault=True)
        return self._samples(records) if records else self._silence()

    def close(self) -> None:
        """Ask it to stop."""
        if self._socket is not None:
            self._ask(STOP)
            self._socket.close()
            self._socket = None

    def _ask(self, command: int) -> None:
        assert self._socket is not None
        assert self._clock is not None
        self._asked = self._clock.now()
        try:
            self._socket.send(REQUEST.pack(HEADER, command, 0))
        except OSError:
            return  # it is asked again, and its silence told

    def _silence(self) -> End | None:
        assert self._clock is not None
        now = self._clock.now()
        if now - self._heard > LOST:
            return End(f"{self.name} sends nothing: its cable, its power or its address", fault=True)
        if now - self._asked > SILENT:
            self._ask(STREAM)
        return None

    def _samples(self, records: list[tuple[int, ...]]) -> Samples | End:
        assert self._clock is not None
        assert self._scale is not None
        scale, self._heard = self._scale, self._clock.now()
        if records[-1][2] & SERIOUS:
            return End(f"{self.name} reports an error (status {records[-1][2]:#010x}): see its web page", fault=True)
        lost, numbers = 0, []
        for record in records:
            number = self._unwrapped(record[0])
            lost += max(number - self._number - 1, 0) if self._number >= 0 else 0
            self._number = max(self._number, number)
            numbers.append(number)
        per = np.array([scale.per_newton] * 3 + [scale.per_newton_metre] * 3)
        counts = np.array([record[3:] for record in records], dtype=float)
        stamp = np.array(numbers) / scale.rate if scale.rate > 0.0 else np.full(len(records), np.nan)
        return Samples(stamp, counts / per, self._heard, lost)

    def _unwrapped(self, number: int) -> int:
        """A number of 32 bits as one that goes on."""
        if self._number < 0:
            return number
        return self._number + (number - self._number + WRAPS // 2) % WRAPS - WRAPS // 2


def read_scale(address: str, port: int = WEB_PORT) -> AtiScale:
    """What the box says of itself.

    Raises:
        RecordingError: it does not answer, or not so.
    """
    page = f"http://{address}:{port}/netftapi2.xml"
    try:
        with urllib.request.urlopen(page, timeout=3.0) as answer:
            found = dict(values_in(answer.read(MOST_PAGE)))
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


def values_in(page: bytes) -> list[tuple[str, str]]:
    """Names and texts of a page's elements; it must name no entities."""
    if b"<!DOCTYPE" in page or b"<!ENTITY" in page:
        raise ValueError("it is no plain XML")
    return [(one.tag.lower(), (one.text or "").strip()) for one in ElementTree.fromstring(page).iter()]
