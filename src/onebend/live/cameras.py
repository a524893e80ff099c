"""Cameras of Linux by its own interface, V4L2 (docs.kernel.org, "Video for Linux API"), with the kernel's stamps and
its count of frames.

Requests and the layout of what they carry are those of `linux/videodev2.h` on 64-bit Linux.
"""

from __future__ import annotations

import errno
import math
import os
import select
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import numpy as np

from onebend.errors import RecordingError
from onebend.live.sources import Clock, Device, End, Frame, StampTiming, of_yuyv
from onebend.recording.video import Picture, luma_of

try:
    import fcntl
    import mmap
except ImportError:  # there is no such thing on Windows
    fcntl = None  # type: ignore[assignment]

QUERYCAP, S_FMT, REQBUFS = 0x80685600, 0xC0D05605, 0xC0145608
QUERYBUF, QBUF, DQBUF = 0xC0585609, 0xC058560F, 0xC0585611
STREAMON, STREAMOFF, S_PARM, S_CTRL = 0x40045612, 0x40045613, 0xC0CC5616, 0xC008561C
CAPABILITY = struct.Struct("<16s32s32sIII12x")
FORMAT = struct.Struct("<I4x12I152x")  # type, then width, height, pixel format ...
BUFFERS = struct.Struct("<IIIII")
BUFFER = struct.Struct("<IIIII4xqq16xIIQIII4x")
RATE = struct.Struct("<IIIII184x")  # type, capability, mode, seconds: numerator, denominator
CONTROL = struct.Struct("<Ii")
CAPTURE, MAPPED, NO_FIELD = 1, 1, 1  # type of buffer, its memory, a whole picture
CAN_CAPTURE, CAN_STREAM, OWN_CAPABILITIES = 0x1, 0x04000000, 0x80000000
BROKEN, STAMP_KIND, MONOTONIC = 0x40, 0xE000, 0x2000  # flags of a buffer
EXPOSURE_AUTO, EXPOSURE, FOCUS_AUTO = 0x009A0901, 0x009A0902, 0x009A090C
BY_HAND, EXPOSURE_UNIT = 1, 1e-4  # s
COUNT = 8  # buffers: a quarter of a second of pictures may wait in the kernel
PACKED = ("MJPG", "YUYV", "GREY", "NV12")
SILENT = 5.0  # s without a picture
TIMING = StampTiming(host=True, delay=0.0, delay_error=0.03)


@dataclass(frozen=True)
class CameraSettings:
    """What is asked of a camera, which gives what is nearest."""

    width: int = 1280  # px
    height: int = 720
    fps: float = 30.0
    exposure: float = math.nan  # s; NaN: the camera chooses
    packed: str = "MJPG"


class Kernel:
    """The calls of Linux that are used."""

    def open(self, path: Path) -> int:
        return os.open(path, os.O_RDWR | os.O_NONBLOCK)

    def ioctl(self, handle: int, request: int, data: bytearray) -> None:
        fcntl.ioctl(handle, request, data, True)

    def map(self, handle: int, length: int, offset: int) -> Any:
        return mmap.mmap(handle, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def ready(self, handle: int, wait: float) -> bool:
        return bool(select.select([handle], [], [], wait)[0])

    def close(self, handle: int) -> None:
        os.close(handle)


class V4l2Camera(Device):
    """A camera such as /dev/video0."""

    def __init__(self, path: Path, settings: CameraSettings = CameraSettings(), kernel: Kernel | None = None) -> None:
        super().__init__(f"the camera {path}", TIMING)
        self._path, self._settings, self._kernel = path, settings, kernel or Kernel()
        self._handle, self._maps = -1, list[Any]()
        self._size, self._stride, self._packed = (0, 0), 0, ""
        self._jpeg: Any = None

    def open(self, clock: Clock) -> None:
        """Begin to stream.

        Raises:
            RecordingError: there is no such camera, another program has it, or it gives no pictures that can be read.
        """
        if fcntl is None:
            raise RecordingError("V4L2 cameras are of Linux. Name the camera as FFmpeg does: av:...")
        try:
            self._handle = self._kernel.open(self._path)
            self._choose()
            self._stream()
        except OSError as wrong:
            self.close()
            raise RecordingError(f"{self._path}: {_why(wrong)}") from None
        except RecordingError:
            self.close()
            raise
        self._begin(clock)

    def read(self, wait: float) -> Frame | End | None:
        try:
            if not self._kernel.ready(self._handle, wait):
                return self._silence(SILENT, "sends no pictures any more")
            buffer = self._buffer(DQBUF, 0)
            arrival = self._clock.now()
            index, used, flags = buffer[0], buffer[2], buffer[3]
            data = bytes(self._maps[index][:used])
            self._buffer(QBUF, index)
        except BlockingIOError:
            return None
        except OSError as wrong:
            return self._fault(f"is gone ({wrong.strerror or wrong}): its cable was pulled")
        self._heard = arrival
        picture, colour = self._unpacked(data) if not flags & BROKEN else (None, None)
        if picture is None:
            return None
        return Frame(picture, buffer[5] + 1e-6 * buffer[6], arrival, buffer[7], colour)

    def close(self) -> None:
        if self._handle < 0:
            return
        with suppress(OSError):  # it is gone
            self._call(STREAMOFF, struct.pack("<i", CAPTURE))
        for one in self._maps:
            one.close()
        self._maps.clear()
        self._kernel.close(self._handle)
        self._handle = -1

    def _call(self, request: int, data: bytes) -> bytes:
        carried = bytearray(data)
        self._kernel.ioctl(self._handle, request, carried)
        return bytes(carried)

    def _buffer(self, request: int, index: int) -> tuple[Any, ...]:
        return BUFFER.unpack(self._call(request, BUFFER.pack(index, CAPTURE, 0, 0, 0, 0, 0, 0, MAPPED, 0, 0, 0, 0)))

    def _choose(self) -> None:
        able = CAPABILITY.unpack(self._call(QUERYCAP, bytes(CAPABILITY.size)))
        can = able[5] if able[4] & OWN_CAPABILITIES else able[4]
        if not (can & CAN_CAPTURE and can & CAN_STREAM):
            raise RecordingError(
                f"{self._path} streams no pictures: many cameras have two of these. Try the other one."
            )
        asked = self._settings
        wanted = (asked.width, asked.height, int.from_bytes(asked.packed.encode(), "little"), NO_FIELD)
        got = FORMAT.unpack(self._call(S_FMT, FORMAT.pack(CAPTURE, *wanted, *(0,) * 8)))
        self._size, self._stride = (got[1], got[2]), got[5]
        self._packed = got[3].to_bytes(4, "little").decode("ascii", "replace")
        if self._packed not in PACKED:
            raise RecordingError(
                f"{self._path} gives pictures packed as {self._packed}, and {', '.join(PACKED)} can be read. Ask for "
                "one of them: packed=YUYV, or another size."
            )
        if self._packed == "MJPG":
            self._jpeg = av.CodecContext.create("mjpeg", "r")
        rate = (CAPTURE, 0, 0, 1000, round(1000 * asked.fps))
        self._if_it_can(S_PARM, RATE.pack(*rate))
        self._if_it_can(S_CTRL, CONTROL.pack(FOCUS_AUTO, 0))  # a lens that moves is another camera
        if asked.exposure > 0.0:
            self._if_it_can(S_CTRL, CONTROL.pack(EXPOSURE_AUTO, BY_HAND))
            self._if_it_can(S_CTRL, CONTROL.pack(EXPOSURE, max(1, round(asked.exposure / EXPOSURE_UNIT))))

    def _if_it_can(self, request: int, data: bytes) -> None:
        try:
            self._call(request, data)
        except OSError as wrong:
            if wrong.errno not in (errno.EINVAL, errno.ENOTTY, errno.ERANGE, errno.EACCES):
                raise

    def _stream(self) -> None:
        count = BUFFERS.unpack(self._call(REQBUFS, BUFFERS.pack(COUNT, CAPTURE, MAPPED, 0, 0)))[0]
        for i in range(count):
            there = self._buffer(QUERYBUF, i)
            if there[3] & STAMP_KIND != MONOTONIC:
                self.timing = replace(TIMING, host=False)
            self._maps.append(self._kernel.map(self._handle, there[10], there[9] & 0xFFFFFFFF))
            self._buffer(QBUF, i)
        self._call(STREAMON, struct.pack("<i", CAPTURE))

    def _unpacked(self, data: bytes) -> tuple[Picture | None, Any]:
        """Luma (H, W), and the frame with its colours where there are some; None of data that are no picture."""
        width, height = self._size
        if self._packed == "MJPG":
            try:
                frame = next(iter(self._jpeg.decode(av.Packet(data))), None)
            except av.error.FFmpegError:  # a picture that was cut on its way
                frame = None
            return (None, None) if frame is None else (luma_of(frame), frame)
        rows = self._stride or width * (2 if self._packed == "YUYV" else 1)
        if len(data) < rows * height:
            return None, None
        plane = np.frombuffer(data, np.uint8, rows * height).reshape(height, rows)
        if self._packed != "YUYV":
            return plane[:, :width].copy(), None
        return of_yuyv(plane[:, : 2 * width].reshape(height, width, 2))


def _why(wrong: OSError) -> str:
    known = {
        errno.ENOENT: "there is no such camera. Plug it in, or look for it: ls /dev/video*",
        errno.EACCES: "this camera may not be read. Join its group: sudo usermod -aG video $USER",
        errno.EBUSY: "another program has it. Close that one",
        errno.ENOTTY: "this is no camera. Name another one: ls /dev/video*",
        errno.ENODEV: "this camera is gone. Plug it in again",
    }
    return f"{known.get(wrong.errno or 0, f'this camera cannot be used ({wrong.strerror})')}."


# What FFmpeg opens as a film that goes on: cameras of other systems, streams on a network.

PATIENCE = (10.0, 5.0)  # s: to open, and from frame to frame


class AvCamera(Device):
    """A place that FFmpeg knows, with the format that reads it (avfoundation, dshow, v4l2; none: by its address)."""

    def __init__(self, place: str, kind: str = "", options: dict[str, str] | None = None) -> None:
        super().__init__(f"the camera {place}", StampTiming(delay=0.03, delay_error=0.1))
        self.files = _file_at(place)
        self._place, self._kind, self._options = place, kind, dict(options or {})
        self._container: Any = None
        self._frames: Iterator[Any] = iter(())

    def open(self, clock: Clock) -> None:
        """Begin to stream.

        Raises:
            RecordingError: it cannot be opened, or shows no film.
        """
        if self._kind and self._kind not in av.formats_available:
            raise RecordingError(
                f"this FFmpeg knows no {self._kind}. On Linux name the camera as /dev/video0; on others install PyAV "
                "with the system's own FFmpeg."
            )
        if Path(self._place.removeprefix("file:")).is_fifo():  # FFmpeg would wait for its other end without end
            raise RecordingError(f"{self._place} is a pipe, and no camera. Name a device or an address.")
        try:
            self._container = av.open(self._place, format=self._kind or None, options=self._options, timeout=PATIENCE)
            self._frames = self._container.decode(video=0)
        except (av.error.FFmpegError, OSError, ValueError, IndexError) as wrong:
            self.close()
            why = getattr(wrong, "strerror", None) or wrong
            raise RecordingError(f"{self._place} cannot be opened as a camera ({why}). Check its name.") from None
        self._begin(clock)

    def read(self, wait: float) -> Frame | End | None:  # noqa: ARG002 (FFmpeg waits by `PATIENCE`)
        try:
            frame = next(self._frames, None)
        except (av.error.FFmpegError, OSError) as wrong:
            return self._fault(f"is gone ({getattr(wrong, 'strerror', None) or wrong})")
        if frame is None:
            return End(f"{self.name} ended")
        stamp = float("nan") if frame.time is None else float(frame.time)
        return Frame(luma_of(frame), stamp, self._clock.now(), -1, frame)

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None


def _file_at(place: str) -> tuple[Path, ...]:
    path = Path(place.removeprefix("file:"))
    try:
        return (path,) if path.is_file() else ()
    except (OSError, ValueError):  # no name that a file can have
        return ()
