"""Frames of a video with their times: the encoded luma plane, and the container's own clock."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from onebend.errors import RecordingError
from onebend.recording.bag_topics import bag_frames, bag_topic, picture_of
from onebend.recording.entries import VideoEntry
from onebend.recording.signals import LATEST, missing_remarks
from onebend.recording.tables import read_columns
from onebend.records import Array, IntArray, Remark

Picture = NDArray[np.uint8]

LUMA_FIRST = ("yuv4", "yuvj4", "nv12", "nv21", "nv16", "gray")  # pixel formats whose first plane is luma
MOST_PIXELS = 2**26  # of a picture
# What a camera or a phone writes. Playlists and lists of files, which name others and even addresses, are not in it.
FILMS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,mxf,ogg,yuv4mpegpipe,dv,nut,ivf,h264,hevc,mjpeg,m4v"
ONLY_FILMS = {"format_whitelist": FILMS, "protocol_whitelist": "file"}
STILLS = ("mjpeg", "png", "bmp", "gif", "tiff", "webp")  # codecs of covers; some cameras film in the first


@dataclass(frozen=True)
class FilmFrame:
    """One frame of a video."""

    index: int
    time: float  # s since the first frame, the video's own clock
    luma: Picture  # (H, W), as a person sees it (rotation of the camera taken off); not to be written to
    colour: Any = None  # the same as `av.VideoFrame`; None of bags, and of a camera that was turned


def read_frames(video: VideoEntry) -> Iterator[FilmFrame]:
    """Every frame in order, one at a time.

    The times are the presentation times of the container, or those of the CSV file that `recording.toml` names, or in a
    bag the stamps of its images, taken as the middle of the exposure.

    Raises:
        RecordingError: not a video, damaged (with the last good frame), no frame, frame times missing or falling.
    """
    for index, time, raw in timed(video):
        colour = None if video.topic or raw.rotation % 360 else raw
        yield FilmFrame(index, time, picture_in(video, index, raw), colour)


def picture_in(video: VideoEntry, index: int, raw: Any, *, colour: bool = False) -> Picture:
    """The luma (H, W), or (H, W, 3) RGB, of what `timed` gives, as a person sees it."""
    if video.topic:
        return picture_of(raw, f"{video.file}, image {index} of {video.topic}", colour=colour)
    if colour:
        return upright(raw.to_ndarray(format="rgb24").astype(np.uint8, copy=False), raw.rotation)
    return luma_of(raw)


def timed(video: VideoEntry) -> Iterator[tuple[int, float, Any]]:
    """Index, time and raw picture of every frame, as `read_frames`; for those who need few of the pictures."""
    if video.topic:
        for index, (time, message) in enumerate(bag_frames(video)):
            yield index, time, message
        return
    times = None if video.frame_times == "container" else read_times(video.frame_times)
    index, first, last = -1, 0.0, -math.inf
    for index, frame in enumerate(decoded(video.file)):
        if times is None:
            if frame.time is None:
                raise RecordingError(
                    f"{video.file}: frame {index} has no time. Put it into an MP4 or MKV container, or name a CSV "
                    "file with frame_times in [video]."
                )
            first = frame.time if index == 0 else first
            time = float(frame.time) - first
        elif index < len(times):
            time = float(times[index] - times[0])
        else:
            raise RecordingError(
                f"{video.frame_times}: {len(times)} times, but the video has more frames. Give one row for each frame."
            )
        if not time > last:
            raise RecordingError(
                f"{video.file}: the time of frame {index} ({time:.6f} s) does not rise. Write it anew."
            )
        last = time
        yield index, time, frame
    if times is not None and index + 1 < len(times):
        raise RecordingError(
            f"{video.frame_times}: {len(times)} times for {index + 1} frames. Give one row for each frame."
        )


def pictures_at(video: VideoEntry, indices: Collection[int], *, colour: bool = False) -> Iterator[tuple[int, Picture]]:
    """Those of these frames that the video has, in order, with their indices; each as from `picture_in`."""
    if not indices:
        return
    last, wanted = max(indices), frozenset(indices)
    every: Iterator[Any] = (message for _, message in bag_frames(video)) if video.topic else decoded(video.file)
    for index, raw in enumerate(every):
        if index in wanted:
            yield index, picture_in(video, index, raw, colour=colour)
        if index >= last:
            return


def frame_count(video: VideoEntry) -> int | None:
    """The number of frames that the container states; None where it states none. For progress only."""
    if video.topic:
        return bag_topic(video)[1].count
    with opened(video.file) as container:
        stream = film_stream(container)
        return None if stream is None else stream.frames or None


def rate_remarks(video: VideoEntry, time: Array) -> tuple[Remark, ...]:
    """Remarks where the stated frame rate is not the measured one, and where a bag lacks frames."""
    lost = missing_remarks(time, "images of the bag") if video.topic else ()
    if math.isnan(video.fps) or len(time) < 2:
        return lost
    measured = 1 / float(np.median(np.diff(time)))
    # Of the frame rate: a larger difference between stated and measured rate gets a remark.
    if abs(measured / video.fps - 1) <= 0.01:
        return lost
    text = f"recording.toml says {video.fps:g} frames/s, the video's own times say {measured:.4g}: these are used. "
    return (Remark("warning", f"{text}Correct fps.", about="frame rate"), *lost)


def read_times(path: Path) -> Array:
    """The column `time_s` of a table, (T,) s."""
    table = read_columns(path, ("time_s",), kind="table of frame times")
    time = table.get("time_s")
    table.refuse(~(np.abs(time) < LATEST), "time_s is empty or no time. Correct the row.")
    return time


@contextmanager
def opened(path: Path) -> Iterator[av.container.InputContainer]:
    """The container of a file that holds at least one video stream."""
    if not path.is_file():
        raise RecordingError(f"There is no file {path}. Put it there, or correct its name.")
    if path.stat().st_size == 0:
        raise RecordingError(f"{path} is empty. Copy it again from the camera.")
    try:
        container = av.open(str(path.resolve()), options=ONLY_FILMS, metadata_errors="replace")
    except (av.error.FFmpegError, OSError, ValueError) as wrong:
        why = getattr(wrong, "strerror", None) or type(wrong).__name__
        raise RecordingError(
            f"{path} is not a readable video ({why}). If it is truncated, copy it again from the camera."
        ) from None
    with container:
        stream = film_stream(container)
        if stream is None:
            raise RecordingError(f"{path} holds no film. Name the video file in [video] file.")
        if stream.width * stream.height > MOST_PIXELS:
            size = f"{stream.width} x {stream.height}"
            raise RecordingError(f"{path}: pictures of {size} are larger than can be read. Film at a lower size.")
        yield container


def film_stream(container: av.container.InputContainer) -> av.VideoStream | None:
    """The first video stream that is no cover picture: neither said to be one, nor a still beside a film."""
    films = [one for one in container.streams.video if not one.disposition & av.stream.Disposition.attached_pic]
    return min(films, key=lambda one: one.codec_context.name in STILLS, default=None)


def decoded(path: Path) -> Iterator[av.VideoFrame]:
    """Frames of the first video stream; an error where the file is damaged or shorter than it states."""
    with opened(path) as container:
        stream = film_stream(container)
        assert stream is not None  # `opened` refuses a file without one
        stream.thread_type = "AUTO"
        stream.codec_context.options = {"max_pixels": str(MOST_PIXELS)}
        size = None
        count, last, duration, interval = 0, math.nan, 0.0, 0.0
        frames = container.decode(stream)
        while True:
            try:
                frame = next(frames, None)
            except av.error.FFmpegError as wrong:
                raise damaged(path, count, wrong.strerror) from None
            if frame is None:
                break
            if frame.is_corrupt:
                raise damaged(path, count, "the frame is damaged")
            if frame.time is not None:
                interval = frame.time - last if count else 0.0
                duration = float(frame.duration * frame.time_base) if frame.duration and frame.time_base else interval
                last = frame.time
            if size not in (None, (frame.width, frame.height)):
                raise damaged(path, count, "the pictures change their size")
            size = (frame.width, frame.height)
            count += 1
            yield frame
        if count == 0:
            raise RecordingError(f"{path} holds no frame. Copy it again from the camera.")
        stated = stated_length(container, stream)
        # s, how much longer than the film other streams of the file may last.
        slack = 1.5 * max(duration, interval) + (0.5 if len(container.streams) > 1 else 0.0)
        if last + duration < stated - slack and not 0 < stream.frames <= count:
            raise damaged(path, count, f"it ends at {last + duration:.2f} s and says it lasts {stated:.2f} s")


def stated_length(container: av.container.InputContainer, stream: av.VideoStream) -> float:
    """The length of the film that the file states, s; minus infinity where it states none.

    The shorter one of stream and container: a film that was cut without new encoding may still carry its first length.
    """
    lengths = []
    if stream.duration is not None and stream.time_base is not None:
        lengths.append(float(stream.duration * stream.time_base))
    if container.duration is not None and container.format.name != "mpegts":
        lengths.append(container.duration / av.time_base)
    return min(lengths, default=-math.inf)


def damaged(path: Path, count: int, why: str | None) -> RecordingError:
    """The error for a video that is readable only up to a frame."""
    good = f"frames 0 to {count - 1} are good" if count else "no frame is good"
    return RecordingError(
        f"{path} is damaged or truncated: {good}, then {why}. Copy it again, or cut it there with a video tool."
    )


def luma_of(frame: av.VideoFrame) -> Picture:
    """The luma plane, (H, W) of 8 bit, without a colour conversion where the pixel format has such a plane."""
    layout = frame.format
    bits = layout.components[0].bits
    if not layout.name.startswith(LUMA_FIRST):
        return upright(frame.to_ndarray(format="gray").astype(np.uint8, copy=False), frame.rotation)
    if bits == 8:
        return upright(samples(frame.planes[0]), frame.rotation)
    deep = samples(frame.planes[0], ">u2" if layout.is_big_endian else "<u2")
    return upright((deep >> (bits - 8)).astype(np.uint8), frame.rotation)


def samples(plane: Any, kind: str = "u1") -> NDArray[Any]:
    """A plane of a frame, (H, W) of `kind`."""
    rows = np.frombuffer(memoryview(plane), kind).reshape(plane.height, -1)
    rows.flags.writeable = False  # the decoder builds later frames on it
    return rows[:, : plane.width]


def upright(picture: Picture, rotation: int) -> Picture:
    """The picture turned as the camera's orientation says (degrees counter-clockwise)."""
    if rotation % 90:
        raise RecordingError(f"The video is stored turned by {rotation} degrees. Only multiples of 90 can be read.")
    return picture if rotation % 360 == 0 else np.array(np.rot90(picture, rotation // 90), order="C")


# Frames whose number is a multiple of a power of two are kept as they pass, so that the film is not decoded again for a
# few pictures. Which these are follows from the film's length and size alone.

MOST_KEPT_PIXELS = 50_000_000  # of all frames that are kept; a pixel takes 1.5 bytes as a rule
FEWEST = 24  # frames: where fewer would fit, none is kept


def spacing_of(count: int, pixels: int) -> int:
    """Every so manyth of the `count` frames of a film is kept, its pictures having so many `pixels`; 0: none is."""
    most = MOST_KEPT_PIXELS // max(pixels, 1)
    if most < FEWEST:
        return 0
    every = 1
    while -(-count // every) > most:
        every *= 2
    return every


def roundest(frames: IntArray) -> int:
    """The place in `frames` (n,) of the number that the highest power of two divides: the likeliest to be kept."""
    return int(np.argmax(np.where(frames == 0, np.iinfo(np.int64).max, frames & -frames)))


class KeptFrames:
    """Frames of the film that was read last, if it is a video file; those of bags are quickly found again."""

    def __init__(self) -> None:
        """Nothing is kept yet."""
        self._file: Path | None = None
        self._frames: dict[int, av.VideoFrame] = {}

    def __len__(self) -> int:
        """Count of the frames that are kept."""
        return len(self._frames)

    def keep(self, video: VideoEntry, index: int, frame: av.VideoFrame) -> None:
        """Take notice of a frame as it passes; the first of a film takes the place of all that was kept."""
        if index == 0:
            self._file, self._frames = video.file, {}
        every = spacing_of(index + 1, frame.width * frame.height)
        if every and index % every == 0:
            if len(self._frames) * every > index:  # the spacing has just doubled
                self._frames = {i: kept for i, kept in self._frames.items() if i % every == 0}
            self._frames[index] = frame

    def pictures(
        self, video: VideoEntry, indices: Collection[int], *, colour: bool = False
    ) -> Iterator[tuple[int, Picture]]:
        """As `video.pictures_at`; the film is read only for those that are not kept.

        Raises:
            RecordingError: the film cannot be read.
        """
        kept = self._frames if video.file == self._file and not video.topic else {}
        sought = pictures_at(video, set(indices) - kept.keys(), colour=colour)
        found = next(sought, None)
        for index in sorted(set(indices)):
            if index in kept:
                yield index, picture_in(video, index, kept[index], colour=colour)
            elif found is not None and found[0] == index:
                yield found
                found = next(sought, None)
