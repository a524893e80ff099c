"""A film that is written while it is filmed: H.264 in MP4 fragments, one a frame, so that what was written can be read
whatever happens next. Times are the camera's own, to a microsecond."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from onebend.errors import RecordingError
from onebend.files.growing import GrowingFile
from onebend.recording.video import Picture
from onebend.workers import available_cores

TIME_BASE = Fraction(1, 1_000_000)
CRF = 18  # what it does to tags: benchmarks/notes/record.md
PRESET = "veryfast"
TUNE = "psnr,zerolatency"  # for what is measured, not for the eye: half of the change of tags, and of the file
KEY_EVERY = 30  # frames
MOST_THREADS = 4
FRAGMENTS = "empty_moov+default_base_moof+frag_every_frame+skip_trailer"


class WholeFragments:
    """What the muxer writes into: bytes go to the file in whole fragments alone."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` where the file is there, or cannot be made."""
        self._file = GrowingFile(path)
        self._waiting = bytearray()

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    def write(self, data: bytes) -> int:
        """Keep bytes until the fragment is whole."""
        self._waiting += data
        return len(data)

    def put(self) -> None:
        """Write the boxes that are whole; where they do not fit, the file is as before, and `OSError` raised."""
        whole = whole_boxes(self._waiting)
        if not whole:
            return
        self._file.append(bytes(self._waiting[:whole]))
        del self._waiting[:whole]

    def close(self) -> None:
        """Nothing more is written."""
        self._file.close()


def whole_boxes(data: bytes | bytearray) -> int:
    """Bytes of the whole boxes at the beginning of `data`; a moof counts with its mdat alone."""
    at = good = 0
    while at + 8 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4], "big"), bytes(data[at + 4 : at + 8])
        if size == 1 and at + 16 <= len(data):
            size = int.from_bytes(data[at + 8 : at + 16], "big")
        if size < 8 or at + size > len(data):
            break
        at += size
        good = good if kind == b"moof" else at
    return good


def mend_film(path: Path) -> int:
    """Cut what follows the last whole fragment of a film whose writing was ended by force; the bytes cut."""
    with path.open("r+b") as stream:
        data = stream.read()
        whole = whole_boxes(data)
        stream.truncate(whole)
    return len(data) - whole


class FilmWriter:
    """One film, from its first frame on."""

    def __init__(self, path: Path, size: tuple[int, int], *, crf: int = CRF) -> None:
        """A film of pictures of `size` (width, height) px.

        Raises:
            RecordingError: the file is there already, cannot be written, or there is no encoder.
        """
        self.path, self.frames, self.last = path, 0, -math.inf  # last: pts
        self.shape = size[1], size[0]
        try:
            self._sink = WholeFragments(path)
        except OSError as wrong:
            raise RecordingError(f"{path} cannot be written ({wrong.strerror}). Choose another folder.") from None
        try:
            self._container = av.open(
                self._sink, "w", format="mp4", options={"movflags": FRAGMENTS, "flush_packets": "1"}
            )
            stream = self._container.add_stream("libx264", rate=30)
            stream.width, stream.height = even(size[0]), even(size[1])
            stream.pix_fmt = "yuv420p"
            stream.codec_context.time_base = TIME_BASE
            stream.options = {
                "crf": str(crf),
                "preset": PRESET,
                "tune": TUNE,
                "g": str(KEY_EVERY),
                "x264-params": "sliced-threads=1",  # slices of one picture: none waits for the next
                "threads": str(min(MOST_THREADS, available_cores())),
            }
        except (av.error.FFmpegError, ValueError) as wrong:
            self._sink.close()
            raise RecordingError(f"{path} cannot be encoded as H.264: {wrong}") from None
        self._stream: Any = stream

    @property
    def bytes(self) -> int:
        """In the file."""
        return self._sink.size

    def write(self, picture: Picture, time: float, colour: Any = None) -> bool:
        """One more picture (H, W) at `time` [s] of the film; False where that is not after the last.

        Raises:
            OSError: the disk is full, or gone. The film then ends with the last whole frame.
        """
        pts = round(time / TIME_BASE)
        if pts <= self.last:
            return False
        frame = with_luma(picture, colour)
        frame.pts, frame.time_base = pts, TIME_BASE
        self._container.mux(self._stream.encode(frame))
        self._sink.put()
        self.frames, self.last = self.frames + 1, pts
        return True

    def close(self) -> None:
        """The end of the film: all frames are in the file. Raises `OSError` as `write`."""
        try:
            if self.frames:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            self._sink.put()
        finally:
            self._sink.close()


def even(size: int) -> int:
    """Of an odd number of rows or columns the last one is left out: colours are of two each."""
    return size - size % 2


def with_luma(picture: Picture, colour: Any) -> av.VideoFrame:
    """The frame to encode: the luma as it is, and the colours of `colour` (`av.VideoFrame`), or none."""
    rows, columns = even(picture.shape[0]), even(picture.shape[1])
    chroma = np.full((rows // 2, columns), 128, np.uint8)
    if colour is not None:
        planes = colour.reformat(width=columns, height=rows, format="yuv420p").to_ndarray()
        chroma = planes[rows:].reshape(rows // 2, columns)
    stacked = np.concatenate([picture[:rows, :columns], chroma])
    return av.VideoFrame.from_ndarray(np.ascontiguousarray(stacked), format="yuv420p")
