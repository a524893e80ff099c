"""A film that ends anywhere can be read up to there, with the camera's own times."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import av
import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.live.recording_folder import FilmWriter, whole_boxes
from onebend.recording.entries import VideoEntry
from onebend.recording.video import FilmFrame, pictures_at, read_frames
from onebend.records import Array

RNG = np.random.default_rng(4)
TIMES = np.cumsum(0.033 + 0.004 * RNG.random(40))
TIMES -= TIMES[0]


def picture(index: int, shape: tuple[int, int] = (96, 128)) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]]
    level = 120 + 80 * np.sin(x / 9 + 0.2 * index) * np.cos(y / 7)
    return np.asarray(np.clip(level, 0, 255), np.uint8)


def written(path: Path, times: Array = TIMES) -> list[int]:
    """Bytes in the file after each frame."""
    film, sizes = FilmWriter(path, (128, 96)), []
    for i, time in enumerate(times.tolist()):
        assert film.write(picture(i), time)
        sizes.append(film.bytes)
    film.close()
    return sizes


def read(path: Path) -> list[FilmFrame]:
    return list(read_frames(VideoEntry(path)))


def test_times_and_pictures_come_back(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    written(path)
    frames = read(path)
    assert [frame.time for frame in frames] == pytest.approx(TIMES.tolist(), abs=1e-6)
    for i, frame in enumerate(frames):
        assert np.abs(frame.luma.astype(int) - picture(i)).mean() < 2.0


def test_a_film_that_was_cut_anywhere_has_its_whole_frames(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    sizes = written(path)
    data = path.read_bytes()
    cut = tmp_path / "cut.mp4"
    for end in range(sizes[5], sizes[7] + 200, 97):
        cut.write_bytes(data[: whole_boxes(data[:end])])
        there = sum(size <= end for size in sizes) - 1  # the newest frame waits for the time of the next one
        assert len(read(cut)) >= there


def test_a_frame_is_on_disk_when_the_next_one_is_written(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    film = FilmWriter(path, (128, 96))
    for i in range(12):
        film.write(picture(i), float(TIMES[i]))
    assert len(read(path)) == 11  # of a writer that is killed now
    film.close()
    assert len(read(path)) == 12


def test_a_full_disk_leaves_whole_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, real, room = tmp_path / "video.mp4", os.write, [20_000]

    def write(handle: int, data: bytes) -> int:
        if room[0] <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = real(handle, bytes(data)[: room[0]])
        room[0] -= count
        return count

    monkeypatch.setattr(os, "write", write)
    film, frames = FilmWriter(path, (128, 96)), 0

    def filmed() -> None:
        nonlocal frames
        for i in range(len(TIMES)):
            film.write(RNG.integers(0, 255, (96, 128)).astype(np.uint8), float(TIMES[i]))
            frames += 1

    with pytest.raises(OSError, match="No space left"):
        filmed()
    with pytest.raises(OSError, match="No space left"):
        film.close()
    monkeypatch.undo()
    assert frames > 1
    assert len(read(path)) == frames - 1
    assert whole_boxes(path.read_bytes()) == path.stat().st_size


def test_times_that_fall_are_left_out(tmp_path: Path) -> None:
    film = FilmWriter(tmp_path / "video.mp4", (128, 96))
    assert film.write(picture(0), 0.0)
    assert not film.write(picture(1), 0.0)
    assert film.write(picture(1), 0.1)
    film.close()
    assert film.frames == 2


def test_colours_stay_and_odd_sizes_lose_a_row(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    rgb = np.zeros((97, 129, 3), np.uint8)
    rgb[..., 0] = 200
    colour = av.VideoFrame.from_ndarray(rgb, format="rgb24")
    film = FilmWriter(path, (129, 97))
    for i in range(3):
        film.write(np.full((97, 129), 90, np.uint8), 0.1 * i, colour)
    film.close()
    [(_, shown)] = pictures_at(VideoEntry(path), [1], colour=True)
    assert shown.shape == (96, 128, 3)
    assert shown[..., 0].mean() > 1.5 * shown[..., 1].mean()


def test_a_file_that_is_there_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    path.write_bytes(b"mine")
    with pytest.raises(RecordingError, match=r"cannot be written.*Choose another folder"):
        FilmWriter(path, (128, 96))
    assert path.read_bytes() == b"mine"
