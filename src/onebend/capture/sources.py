"""What a camera and a force sensor are to a recorder: opened, read until they end, closed.

`read` waits for some time at most, so that a recorder can be stopped. It never raises what a cable, a robot or a full
buffer may cause: that is an `End` with its reason. `open` raises, with what to do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import av
import numpy as np

from onebend.capture.clocks import Clock, StampTiming
from onebend.recording.video import Picture
from onebend.records import Array


@dataclass(frozen=True)
class Frame:
    """One picture of a camera."""

    picture: Picture  # (H, W), luma
    stamp: float  # s, the camera's own clock; NaN where it gives none
    arrival: float  # s, this machine's monotonic clock
    number: int = -1  # as the camera counts; -1: it does not
    colour: Any = None  # the same as `av.VideoFrame`, where there is more than luma


@dataclass(frozen=True)
class Samples:
    """Some rows of a force sensor."""

    stamp: Array  # (n,) s, the sensor's own clock; NaN where it gives none
    force: Array  # (n, c) N and N m, as `ForceSource.columns` says
    arrival: float  # s, this machine's monotonic clock
    lost: int = 0  # rows that are known to be missing before these


@dataclass(frozen=True)
class End:
    """No more will come."""

    why: str  # a sentence
    fault: bool = False  # a cable, a full buffer: rather than the end of what is played


class CameraSource(Protocol):
    """A camera."""

    name: str  # for messages
    timing: StampTiming

    def open(self, clock: Clock) -> None: ...

    def read(self, wait: float) -> Frame | End | None:
        """The next picture; None where none came within `wait` [s]."""
        ...

    def close(self) -> None: ...


class ForceSource(Protocol):
    """A force sensor."""

    name: str  # for messages
    timing: StampTiming
    columns: tuple[str, ...]  # of the log, with units: fx_N, fy_N and so on

    def open(self, clock: Clock) -> None: ...

    def read(self, wait: float) -> Samples | End | None:
        """The next rows; None where none came within `wait` [s]."""
        ...

    def close(self) -> None: ...


def of_yuyv(pairs: Picture) -> tuple[Picture, Any]:
    """Luma (H, W), and the same with its colours as an `av.VideoFrame`, of YUYV's bytes (H, W, 2): luma, one of two
    colours."""
    return pairs[..., 0].copy(), av.VideoFrame.from_ndarray(np.ascontiguousarray(pairs), format="yuyv422")


def files_of(*sources: CameraSource | ForceSource | None) -> tuple[Path, ...]:
    """The files that these sources read (their `files`, where they have any; of a folder, all in it), which no
    recording may replace."""
    named = [Path(path) for source in sources for path in getattr(source, "files", ())]
    return tuple(file for path in named for file in (path, *(path.iterdir() if path.is_dir() else ())))


@runtime_checkable
class Played(Protocol):
    """A source that is played knows when its next item comes."""

    def due(self) -> float:
        """s, on the clock that it was opened with; infinite at its end."""
        ...
