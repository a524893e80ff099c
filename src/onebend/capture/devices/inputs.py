"""What FFmpeg opens as a film that goes on: cameras of other systems, streams on a network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av

from onebend.capture.clocks import Clock, StampTiming
from onebend.capture.sources import End, Frame
from onebend.errors import RecordingError
from onebend.recording.video import luma_of

TIMING = StampTiming(delay=0.03, delay_error=0.1)
PATIENCE = (10.0, 5.0)  # s: to open, and from frame to frame


class AvCamera:
    """A place that FFmpeg knows, with the format that reads it (avfoundation, dshow, v4l2; none: by its address)."""

    def __init__(self, place: str, kind: str = "", options: dict[str, str] | None = None) -> None:
        self.name, self.timing = f"the camera {place}", TIMING
        self.files = _file_at(place)
        self._place, self._kind, self._options = place, kind, dict(options or {})
        self._container: Any = None
        self._frames: Iterator[Any] = iter(())
        self._clock: Clock | None = None

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
        self._clock = clock

    def read(self, wait: float) -> Frame | End | None:  # noqa: ARG002 (FFmpeg waits by `PATIENCE`)
        """The next picture."""
        assert self._clock is not None
        try:
            frame = next(self._frames, None)
        except (av.error.FFmpegError, OSError) as wrong:
            return End(f"{self.name} is gone ({getattr(wrong, 'strerror', None) or wrong})", fault=True)
        if frame is None:
            return End(f"{self.name} ended")
        stamp = float("nan") if frame.time is None else float(frame.time)
        return Frame(luma_of(frame), stamp, self._clock.now(), -1, frame)

    def close(self) -> None:
        """Leave it."""
        if self._container is not None:
            self._container.close()
            self._container = None


def _file_at(place: str) -> tuple[Path, ...]:
    """The file that is played, where the place is no camera."""
    path = Path(place.removeprefix("file:"))
    try:
        return (path,) if path.is_file() else ()
    except (OSError, ValueError):  # no name that a file can have
        return ()
