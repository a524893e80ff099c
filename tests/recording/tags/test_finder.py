"""Small tags are found, and where they are; what is none is not taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from onebend.recording.entries import FAMILIES
from onebend.recording.tag_finder import USUAL, Finder, most_errors, side_of
from onebend.recording.tags import track_block
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array
from tests.recording.filmed import corners_of, picture, poses, view

LENS = 0.8  # px, blur


@pytest.fixture(scope="module")
def finder() -> Finder:
    return Finder("tag36h11")


def noisy(clean: np.ndarray, *, noise: float = 2.0, seed: int = 0) -> Picture:
    """As a camera with a lens would show it."""
    seen = gaussian_filter(clean, LENS) + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    return np.asarray(np.clip(np.rint(seen), 0, 255), dtype=np.uint8)


def small(side: float, count: int = 8) -> tuple[list[FilmFrame], Array]:
    """Frames of four moving tags of about this side [px], and their corners (T, 4, 4, 2)."""
    seen = view()
    far = replace(seen, translation=seen.translation * np.array([1.0, 1.0, 29.0 / side]))
    true = poses(3 * count)[:count] + np.array([0.0, 0.0, 0.5])
    frames = [FilmFrame(t, t / 30, noisy(picture(row, range(4), far), seed=t)) for t, row in enumerate(true)]
    return frames, corners_of(true, far)


@pytest.mark.parametrize(("side", "most"), [(14.0, 0.16), (18.0, 0.12), (24.0, 0.09)])
def test_small_moving_tags_are_found_where_they_are(side: float, most: float, finder: Finder) -> None:
    frames, true = small(side)
    error = track_block(frames, range(4), finder).corners - true
    assert np.median([side_of(tag) for tag in true.reshape(-1, 4, 2)]) == pytest.approx(side, rel=0.1)
    assert np.isfinite(error).all(axis=(2, 3)).mean() > 0.9
    assert np.sqrt(np.nanmean(error**2)) < most
    seen = [(frame.index, tag) for frame in frames for tag in finder.search(frame.luma, USUAL)]
    blurred = [tag.corners - true[t, tag.tag_id] for t, tag in seen]
    assert len(blurred) < 0.3 * error[..., 0, 0].size or np.sqrt(np.mean(np.square(blurred))) > most


def test_large_tags_stay_as_one_search_with_blur_finds_them(finder: Finder) -> None:
    near = replace(view(), translation=view().translation * np.array([1.0, 1.0, 0.5]))
    luma = noisy(picture(poses(3)[0, 1:3], (1, 2), near))
    alone, looked = finder.search(luma, USUAL), finder.look(luma, range(4))
    assert [tag.tag_id for tag in looked] == [tag.tag_id for tag in alone]
    assert all(np.array_equal(one.corners, other.corners) for one, other in zip(alone, looked, strict=True))
    assert len(alone) == 2


def clutter(seed: int) -> Picture:
    """Black and white squares of the size of small tags' cells, and noise."""
    rng = np.random.default_rng(seed)
    cell = int(rng.integers(2, 8))
    squares = rng.integers(0, 2, (1 + 240 // cell, 1 + 320 // cell)).repeat(cell, axis=0).repeat(cell, axis=1)
    return noisy(30.0 + 190.0 * squares[:240, :320], noise=float(rng.choice([2.0, 25.0])), seed=seed)


@pytest.mark.parametrize("family", FAMILIES)
def test_clutter_is_not_taken_for_tags(family: str) -> None:
    made = Finder(family)
    usual = more = 0
    for seed in range(12):
        with_blur = made.search(clutter(seed), USUAL)
        found = made.look(clutter(seed), range(30))
        usual, more = usual + len(with_blur), more + len(found) - len(with_blur)
    assert more <= 1  # of thousands of squares
    assert family == "tag16h5" or usual == 0  # whose few cells chance often makes


def test_a_thing_of_another_size_is_not_the_tag_that_is_expected(finder: Finder) -> None:
    frames, true = small(24.0, 1)
    around = true[0, 1].mean(axis=0)
    expected = around + (true[0, 1] - around)
    assert [tag.tag_id for tag in finder.look_around(frames[0].luma, expected, 10.0)] == [1]
    assert finder.look_around(frames[0].luma, around + (expected - around) * 2.5, 10.0) == []


def test_errors_that_a_family_bears() -> None:
    assert most_errors(codes=587, bits=36) == 2
    assert most_errors(codes=35, bits=25) == 0
    assert most_errors(codes=30, bits=16) == 0


def test_a_tag_of_hundreds_of_pixels_is_found_where_it_is(finder: Finder) -> None:
    """Of square blocks of pixels, as in a film that was enlarged: a search at its own size does not find it."""
    times, (left, top) = 12, (0, 0)
    row = poses(3)[0]
    true = corners_of(row[None], view())[0, 1]
    left, top = np.floor(true.min(axis=0) - 12.0).astype(int).tolist()
    part = noisy(picture(row, range(4), view()))[top : top + 60, left : left + 60]
    large = np.kron(part, np.ones((times, times), dtype=np.uint8))
    (found,) = finder.look(large, (1,))
    assert found.tag_id == 1
    assert side_of(found.corners) > 300.0
    assert np.abs((found.corners + 0.5) / times - 0.5 + np.array([left, top]) - true).max() < 0.3  # of its 28 px before
    (near,) = finder.look_around(large, found.corners, 100.0)
    assert np.abs(near.corners - found.corners).max() < 0.3 * times


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (8, 8), (9, 31), (16, 640)])
def test_pictures_of_a_few_pixels_hold_no_tag(shape: tuple[int, int]) -> None:
    """The detector's own code crashes on the smallest, which a reduced picture may become."""
    assert Finder("tag36h11").look(np.full(shape, 200, dtype=np.uint8), [0]) == []
