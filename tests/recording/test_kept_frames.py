"""Frames that are kept as they pass: the very ones that would be sought, of bounded number."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import av
import numpy as np
import pytest

from onebend.recording import video as kept_frames
from onebend.recording.entries import VideoEntry
from onebend.recording.video import (
    FEWEST,
    MOST_KEPT_PIXELS,
    KeptFrames,
    Picture,
    pictures_at,
    read_frames,
    roundest,
    spacing_of,
    timed,
)
from tests.recording.test_video import write_video

WIDTH, HEIGHT, COUNT = 64, 48, 50


@pytest.fixture
def film(tmp_path: Path) -> VideoEntry:
    rng = np.random.default_rng(3)
    lumas = [rng.integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8) for _ in range(COUNT)]
    return write_video(tmp_path / "film.mp4", lumas, range(0, 40 * COUNT, 40), codec="libx264")


def pass_by(kept: KeptFrames, film: VideoEntry) -> None:
    """Show it every frame, as the search for the outline does."""
    for index, _, raw in timed(film):
        kept.keep(film, index, raw)


def not_sought(_: VideoEntry, indices: Collection[int], **__: bool) -> Iterator[tuple[int, Picture]]:
    """In place of a search of the film, which is not to be made for what is kept."""
    assert set(indices) == {1000}
    return iter(())


def test_frames_that_passed_are_those_that_would_be_sought(film: VideoEntry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_frames, "MOST_KEPT_PIXELS", 13 * WIDTH * HEIGHT)
    monkeypatch.setattr(kept_frames, "FEWEST", 5)
    kept = KeptFrames()
    pass_by(kept, film)
    every = spacing_of(COUNT, WIDTH * HEIGHT)
    assert every == 4
    assert len(kept) == 13
    wanted = [48, 0, 4, 20, 1000]
    for colour in (False, True):
        sought = dict(pictures_at(film, wanted, colour=colour))
        assert list(sought) == [0, 4, 20, 48]
        with monkeypatch.context() as patch:
            patch.setattr(kept_frames, "pictures_at", not_sought)
            passed = dict(kept.pictures(film, wanted, colour=colour))
        assert list(passed) == list(sought)
        for index, picture in passed.items():
            np.testing.assert_array_equal(picture, sought[index])


def test_what_is_not_kept_is_sought(film: VideoEntry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_frames, "MOST_KEPT_PIXELS", 13 * WIDTH * HEIGHT)
    monkeypatch.setattr(kept_frames, "FEWEST", 5)
    kept = KeptFrames()
    pass_by(kept, film)
    found = dict(kept.pictures(film, [3, 4]))
    assert list(found) == [3, 4]
    for index, picture in pictures_at(film, [3, 4]):
        np.testing.assert_array_equal(found[index], picture)


def test_pictures_stay_as_they_are_while_the_film_goes_on(film: VideoEntry) -> None:
    at_once = [frame.luma.copy() for frame in read_frames(film)]
    for frame, luma in zip(list(read_frames(film)), at_once, strict=True):
        np.testing.assert_array_equal(frame.luma, luma)
        assert not frame.luma.flags.writeable  # the decoder builds later frames on it


def test_another_film_takes_the_place_of_the_first(film: VideoEntry, tmp_path: Path) -> None:
    black = [np.zeros((HEIGHT, WIDTH), dtype=np.uint8)] * 12
    dark = write_video(tmp_path / "dark.mkv", black, range(0, 480, 40))
    kept = KeptFrames()
    pass_by(kept, film)
    assert len(kept) == COUNT
    pass_by(kept, dark)
    assert len(kept) == 12
    assert dict(kept.pictures(dark, [4]))[4].mean() < 2.0
    assert dict(kept.pictures(film, [4]))[4].mean() > 100.0


@pytest.mark.parametrize("pixels", [640 * 480, 1280 * 720, 1920 * 1080])
@pytest.mark.parametrize("count", [1, 2, 100, 536, 100_000])
def test_as_many_are_kept_as_fit(count: int, pixels: int) -> None:
    every = spacing_of(count, pixels)
    number = len(range(0, count, every))
    assert number * pixels <= MOST_KEPT_PIXELS
    assert every & (every - 1) == 0
    assert every == 1 or len(range(0, count, every // 2)) * pixels > MOST_KEPT_PIXELS
    assert number >= min(count, FEWEST // 2)


def test_of_very_large_pictures_none_is_kept() -> None:
    assert spacing_of(500, 3840 * 2160) == 0
    kept, entry = KeptFrames(), VideoEntry(Path("none.mp4"))
    kept.keep(entry, 0, av.VideoFrame(3840, 2160, "yuv420p"))
    assert len(kept) == 0


def test_the_roundest_frame_is_in_every_thinner_set() -> None:
    frames = np.arange(37, 70)
    assert frames[roundest(frames)] == 64
    assert frames[roundest(frames[:20])] == 48
    assert roundest(np.array([7, 0, 64])) == 1
