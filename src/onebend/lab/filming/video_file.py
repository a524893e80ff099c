"""Pictures into an MP4 file: H.264, yuv420p, each frame with its own time."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from onebend.errors import RecordingError
from onebend.lab.filming.render import YuvFrame

TIME_BASE = Fraction(1, 90_000)
PRESET = "veryfast"


def write_video(
    path: Path, frames: Iterable[tuple[float, YuvFrame]], size: tuple[int, int], fps: float, crf: int
) -> int:
    """Write frames (time [s], 8 bit planes) that come in order; return their number.

    Raises:
        RecordingError: the encoder is missing or refuses.
    """
    count = 0
    try:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
            stream.width, stream.height = size
            stream.pix_fmt = "yuv420p"
            stream.codec_context.time_base = TIME_BASE
            stream.options = {"crf": str(crf), "preset": PRESET, "threads": "1"}
            for time, picture in frames:
                frame = video_frame(picture)
                frame.pts, frame.time_base = round(time / TIME_BASE), TIME_BASE
                container.mux(stream.encode(frame))
                count += 1
            container.mux(stream.encode(None))
    except av.error.FFmpegError as wrong:
        raise RecordingError(f"{path} cannot be encoded as H.264: {wrong.strerror}") from None
    return count


def video_frame(picture: YuvFrame) -> av.VideoFrame:
    """The planes as the encoder takes them."""
    rows, columns = picture.y.shape
    stacked = np.concatenate([picture.y.ravel(), picture.u.ravel(), picture.v.ravel()])
    return av.VideoFrame.from_ndarray(stacked.reshape(rows * 3 // 2, columns), format="yuv420p")
