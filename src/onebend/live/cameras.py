"""Cameras that FFmpeg opens as a film that goes on: Video4Linux with the kernel's stamps, AVFoundation, DirectShow, and
streams on a network.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import av

from onebend.errors import RecordingError
from onebend.live.sources import Clock, Device, End, Frame, StampTiming
from onebend.recording.video import luma_of

PACKED = {"MJPG": "mjpeg", "YUYV": "yuyv422", "GREY": "gray", "NV12": "nv12"}  # names of V4L2 and of FFmpeg
PATIENCE = (10.0, 5.0)  # s: to open, and from frame to frame
SILENT = 5.0  # s without a picture
PAUSE = 0.002  # s, after which a camera without a new picture is asked again
NONBLOCK = "+4"  # FFmpeg's flag of this name, which has no other: else a driver that hangs is waited for without end
KERNEL = StampTiming(host=True, delay=0.0, delay_error=0.03)
SAME_CLOCK = 1.0  # s from this machine's clock at the most
ADVICE = {
    errno.ENOENT: "There is no such camera. Plug it in, or look for it: ls /dev/video*",
    errno.EACCES: "Join its group: sudo usermod -aG video $USER",
    errno.EBUSY: "Another program has it. Close that one",
    errno.ENODEV: "Many cameras have two of these. Try the other one",
}


class AvCamera(Device):
    """A place that FFmpeg knows, with the format that reads it (avfoundation, dshow, v4l2; none: by its address)."""

    def __init__(self, place: str, kind: str = "", options: Mapping[str, str] | None = None) -> None:
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
        if self._kind and not any(self._kind in names.split(",") for names in av.formats_available):
            raise RecordingError(
                f"this FFmpeg knows no {self._kind}: it is of another system, or PyAV must be installed with the "
                "system's own FFmpeg."
            )
        if Path(self._place.removeprefix("file:")).is_fifo():  # FFmpeg would wait for its other end without end
            raise RecordingError(f"{self._place} is a pipe, and no camera. Name a device or an address.")
        try:
            self._container = av.open(
                self._place, format=self._kind or None, container_options=self._options, timeout=PATIENCE
            )
            self._frames = self._container.decode(video=0)
        except (av.error.FFmpegError, OSError, ValueError, IndexError) as wrong:
            self.close()
            why = getattr(wrong, "strerror", None) or wrong
            advice = ADVICE.get(getattr(wrong, "errno", None) or 0, "Check its name")
            raise RecordingError(f"{self._place} cannot be opened as a camera ({why}). {advice}.") from None
        self._begin(clock)
        if self._kind == "v4l2":
            self._see_first()

    def _see_first(self) -> None:
        """Take the first picture, whose stamp says whether the kernel stamps by this machine's clock."""
        first = None
        while first is None:
            first = self.read(SILENT)
        if isinstance(first, End):
            self.close()
            raise RecordingError(f"{first.why}.")
        if abs(first.arrival - first.stamp) < SAME_CLOCK:
            self.timing = KERNEL

    def read(self, wait: float) -> Frame | End | None:
        try:
            frame = next(self._frames, None)
        except (BlockingIOError, av.error.InvalidDataError, av.error.ArgumentError):  # none yet; one that was cut
            self._frames = self._container.decode(video=0)
            self._clock.wait_until(self._clock.now() + min(wait, PAUSE))
            return self._silence(SILENT, "sends no pictures any more")
        except (av.error.FFmpegError, OSError) as wrong:
            return self._fault(f"is gone ({getattr(wrong, 'strerror', None) or wrong})")
        if frame is None:
            return End(f"{self.name} ended")
        self._heard = self._clock.now()
        stamp = float("nan") if frame.time is None else float(frame.time)
        if frame.format.name in PACKED.values():  # its pixels are the driver's memory, which goes when this is closed
            frame = av.VideoFrame.from_ndarray(frame.to_ndarray(), format=frame.format.name)
        return Frame(luma_of(frame), stamp, self._heard, -1, frame)

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
