"""Frames and their times: what is in the file comes out, and what is wrong with a file is said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.recording.entries import VideoEntry
from onebend.recording.video import FilmFrame, frame_count, pictures_at, rate_remarks, read_frames, upright

WIDTH, HEIGHT = 64, 48
CLOCK = Fraction(1, 1000)
FIRST_INDEX = {"movflags": "faststart"}  # the index before the frames: a truncated file can still be opened


def pictures(count: int, top: int = 256) -> list[np.ndarray]:
    """Luma planes that tell their own number."""
    rows, columns = np.indices((HEIGHT, WIDTH))
    return [(16 + (7 * i + rows + 2 * columns) % (top - 40)).astype(np.uint16) for i in range(count)]


def write_video(
    path: Path,
    lumas: Sequence[np.ndarray],
    ticks: Sequence[int],
    *,
    codec: str = "ffv1",
    pixels: str = "yuv420p",
    options: dict[str, str] | None = None,
) -> VideoEntry:
    """A film with the given luma planes, at the given milliseconds."""
    with av.open(str(path), "w", options=options or {}) as container:
        stream = cast(av.VideoStream, container.add_stream(codec, rate=30))
        height, width = lumas[0].shape
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        stream.codec_context.time_base = CLOCK
        for luma, tick in zip(lumas, ticks, strict=True):
            frame = av.VideoFrame(width, height, pixels)
            kind = np.dtype("<u2") if "10" in pixels else np.dtype("u1")
            for number, plane in enumerate(frame.planes):
                rows = np.full((plane.height, plane.line_size // kind.itemsize), 128, dtype=kind)
                if number == 0:
                    rows[:, :width] = luma
                plane.update(rows.tobytes())
            frame.pts, frame.time_base = tick, CLOCK
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return VideoEntry(path)


@pytest.mark.parametrize("ticks", [range(0, 400, 40), [500, 533, 570, 590, 650, 700, 720, 780, 800, 900]])
def test_times_are_the_container_s_and_begin_at_zero(tmp_path: Path, ticks: Sequence[int]) -> None:
    video = write_video(tmp_path / "a.mkv", pictures(10), list(ticks))
    frames = list(read_frames(video))
    assert [frame.index for frame in frames] == list(range(10))
    assert [frame.time for frame in frames] == pytest.approx([(tick - ticks[0]) / 1000 for tick in ticks], abs=1e-9)


def test_luma_is_the_encoded_plane_bit_for_bit(tmp_path: Path) -> None:
    lumas = pictures(3)
    for name, pixels in (("a", "yuv420p"), ("b", "yuv444p"), ("c", "gray")):
        video = write_video(tmp_path / f"{name}.mkv", lumas, [0, 40, 80], pixels=pixels)
        for frame, luma in zip(read_frames(video), lumas, strict=True):
            assert frame.luma.dtype == np.uint8
            assert (frame.luma == luma).all()


def test_ten_bits_become_eight(tmp_path: Path) -> None:
    lumas = pictures(2, top=1024)
    video = write_video(tmp_path / "a.mkv", lumas, [0, 40], pixels="yuv420p10le")
    for frame, luma in zip(read_frames(video), lumas, strict=True):
        assert (frame.luma == luma >> 2).all()


def test_picture_without_a_luma_plane_is_made_grey(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    levels = (30, 200)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "bgr0"
        for i, level in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(np.full((HEIGHT, WIDTH, 3), level, np.uint8), format="rgb24")
            frame.pts = i
            container.mux(stream.encode(frame.reformat(format="bgr0")))
        container.mux(stream.encode())
    for frame_read, level in zip(read_frames(VideoEntry(path)), levels, strict=True):
        assert np.abs(frame_read.luma.astype(int) - level).max() <= 30


def test_a_picture_is_that_frame_in_colour(tmp_path: Path) -> None:
    lumas = pictures(5)
    video = write_video(tmp_path / "a.mkv", lumas, [0, 40, 80, 120, 160])
    [(_, colour)] = pictures_at(video, [3], colour=True)
    assert colour.shape == (HEIGHT, WIDTH, 3)
    full_range = (lumas[3].astype(float) - 16) * 255 / 219
    assert np.abs(colour.mean(axis=2) - full_range.clip(0, 255)).max() < 3
    assert not list(pictures_at(video, [5], colour=True))


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no file"):
        next(read_frames(VideoEntry(tmp_path / "none.mp4")))
    (tmp_path / "text.mp4").write_text("this is no video\n" * 100, encoding="utf-8")
    with pytest.raises(RecordingError, match="not a readable video"):
        next(read_frames(VideoEntry(tmp_path / "text.mp4")))
    (tmp_path / "empty.mp4").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"empty\.mp4"):
        next(read_frames(VideoEntry(tmp_path / "empty.mp4")))


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "libx264"), ("a.mkv", "ffv1")])
@pytest.mark.parametrize("kept", [0.5, 0.9])
def test_truncated_file_names_the_last_good_frame(tmp_path: Path, name: str, codec: str, kept: float) -> None:
    noise = np.random.default_rng(1)
    lumas = [noise.integers(16, 235, (HEIGHT, WIDTH)) for _ in range(60)]
    options = FIRST_INDEX if name.endswith("mp4") else {}
    video = write_video(tmp_path / name, lumas, range(0, 60 * 40, 40), codec=codec, options=options)
    assert len(list(read_frames(video))) == 60
    whole = video.file.read_bytes()
    video.file.write_bytes(whole[: int(kept * len(whole))])
    read: list[FilmFrame] = []
    with pytest.raises(RecordingError, match="damaged or truncated") as told:
        read += read_frames(video)
    good = int(str(told.value).split("frames 0 to ")[1].split(" ")[0])
    assert 0.5 * kept * 60 < good < 60


def test_whole_file_of_a_container_that_rounds_is_whole(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.avi", pictures(20), range(0, 800, 40), codec="mpeg4")
    assert len(list(read_frames(video))) == 20


def test_file_without_its_index_is_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4", pictures(30), range(0, 1200, 40), codec="libx264")
    video.file.write_bytes(video.file.read_bytes()[:-200])
    with pytest.raises(RecordingError, match="truncated"):
        list(read_frames(video))


def test_container_without_frames_is_refused(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4", pictures(30), range(0, 1200, 40), codec="libx264", options=FIRST_INDEX)
    whole = video.file.read_bytes()
    video.file.write_bytes(whole[: whole.index(b"mdat") + 4])
    with pytest.raises(RecordingError, match="no frame"):
        list(read_frames(video))


def test_times_from_a_file_are_used_and_counted(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mkv", pictures(4), [0, 40, 80, 120])
    table = tmp_path / "times.csv"
    timed = replace(video, frame_times=table)
    table.write_text("frame, time_s\n0, 7.0\n1, 7.1\n2, 7.15\n3, 7.3\n", encoding="utf-8")
    assert [frame.time for frame in read_frames(timed)] == pytest.approx([0.0, 0.1, 0.15, 0.3])
    for content, words in (
        ("time_s\n0\n1\n2\n", "3 times, but the video has more frames"),
        ("time_s\n0\n1\n2\n3\n4\n", "5 times for 4 frames"),
        ("time_s\n0\n1\n1\n2\n", "frame 2 .* does not rise"),
        ("time_s\n0\nx\n2\n3\n", "times.csv, line 3: time_s is 'x', not a number"),
        ("seconds\n0\n1\n2\n3\n", "no column time_s"),
        ("", "is empty"),
    ):
        table.write_text(content, encoding="utf-8")
        with pytest.raises(RecordingError, match=words):
            list(read_frames(timed))


def test_written_frame_rate_is_only_compared(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mkv", pictures(4), [0, 40, 80, 120])
    times = np.array([frame.time for frame in read_frames(video)])
    assert rate_remarks(video, times) == ()
    assert rate_remarks(replace(video, fps=25.0), times) == ()
    (remark,) = rate_remarks(replace(video, fps=30.0), times)
    assert "30 frames/s" in remark.text
    assert "25" in remark.text


def test_frames_are_counted_where_the_container_says(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4", pictures(7), range(0, 280, 40), codec="libx264")
    assert frame_count(video) == 7


def test_turned_pictures_are_set_upright() -> None:
    picture = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert (upright(picture, 90) == [[2, 5], [1, 4], [0, 3]]).all()
    assert (upright(upright(picture, 90), -90) == picture).all()
    assert upright(picture, 180).flags.c_contiguous
    with pytest.raises(RecordingError, match="45 degrees"):
        upright(picture, 45)
