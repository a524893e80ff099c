"""Tags are tracked picture by picture as well as in blocks, from what came before, whatever is lost on the way."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from onebend.errors import ObservationError
from onebend.recording.tag_finder import Finder
from onebend.recording.tags import LOOK_EVERY, TrackedFrame, Tracker, track_block
from onebend.recording.video import FilmFrame
from onebend.records import Array
from tests.recording.filmed import HEIGHT, WIDTH, corners_of, film, poses, view

COUNT, HIDDEN = 48, slice(16, 34)


@cache
def push() -> tuple[tuple[FilmFrame, ...], Array]:
    """A bending beam, its middle tag hidden for a while, and the true corners."""
    true = poses(COUNT)
    true[HIDDEN, 2] = np.nan
    return tuple(film(true, range(4), view())), corners_of(true, view())


def tracked(frames: tuple[FilmFrame, ...]) -> list[TrackedFrame]:
    tracker = Tracker(range(4))
    return [tracker.step(frame.luma, frame.time) for frame in frames]


@cache
def whole() -> tuple[TrackedFrame, ...]:
    return tuple(tracked(push()[0]))


def corners_in(frames: tuple[TrackedFrame, ...] | list[TrackedFrame]) -> Array:
    return np.array([frame.corners for frame in frames])


@pytest.mark.slow
def test_tags_are_where_the_block_wise_search_finds_them() -> None:
    frames, true = push()
    blocks = [track_block(frames[i : i + 16], range(4), Finder("tag36h11")).corners for i in range(0, COUNT, 16)]
    block, live = np.concatenate(blocks), corners_in(whole())
    error_of_both = [float(np.sqrt(np.nanmean((one - true) ** 2))) for one in (block, live)]
    assert error_of_both[1] < 1.1 * error_of_both[0] < 0.1
    assert np.sqrt(np.nanmean((live - block) ** 2)) < 0.02
    seen = np.asarray(np.isfinite(live).all(axis=(2, 3)))
    assert seen[:, [0, 1, 3]].all()
    assert not seen[HIDDEN, 2].any()  # none where it is hidden
    assert seen[: HIDDEN.start, 2].all()
    assert seen[HIDDEN.stop + 4 :, 2].all()  # and it is found again, within some frames


def test_no_frame_depends_on_a_later_one() -> None:
    frames, _ = push()
    short = tracked(frames[:20])
    blank = [FilmFrame(i, i / 30, np.zeros_like(frames[0].luma)) for i in range(20, 24)]
    other = tracked((*frames[:20], *blank))[:20]
    for part in (short, other):
        assert np.array_equal(corners_in(part), corners_in(whole()[:20]), equal_nan=True)


def test_a_late_frame_is_found_near_its_neighbours_and_changes_no_other() -> None:
    frames, true = push()
    order = [*range(9), 10, 9, *range(11, 16)]
    tracker = Tracker(range(4))
    found = {i: tracker.step(frames[i].luma, frames[i].time) for i in order}
    assert np.abs(found[9].corners - true[9]).max() < 0.5
    assert np.isfinite([found[i].corners for i in order]).all()


def test_what_is_no_picture_is_refused_and_the_tracker_goes_on() -> None:
    frames, _ = push()
    tracker, picture = Tracker(range(4)), frames[0].luma
    tracker.step(picture, 0.0)
    for wrong, time, words in (
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), 1.0, "grey array"),
        (picture.astype(float), 1.0, "grey array"),
        (picture[:-1], 1.0, "another size"),
        (picture, float("nan"), "no number"),
        (picture, 0.0, "given before"),
    ):
        with pytest.raises(ObservationError, match=words):
            tracker.step(wrong, time)
    for i in range(1, LOOK_EVERY + 1):
        tracker.step(picture, i / 30)
    with pytest.raises(ObservationError, match="too late"):
        tracker.step(picture, -1.0)
    assert np.isfinite(tracker.step(picture, 1.0).corners).all()


def test_what_is_kept_does_not_grow_and_gaps_do_no_harm() -> None:
    frames, true = push()
    tracker, kept = Tracker(range(4)), []
    for i in [i for i in range(COUNT) if i % 7 not in (2, 3)]:
        found = tracker.step(frames[i].luma, frames[i].time)
        kept.append(len(tracker._rows))
        away = np.abs(found.corners - true[i]).max(axis=(1, 2))[[0, 1, 3]]
        assert np.max(away) < 1.0
    assert max(kept) == LOOK_EVERY


def test_an_empty_picture_shows_no_tag_and_one_with_an_unknown_tag_says_so() -> None:
    frames, _ = push()
    tracker = Tracker([0, 1, 9])
    assert np.isnan(tracker.step(np.full((HEIGHT, WIDTH), 120, np.uint8), 0.0).corners).all()
    for i in range(1, LOOK_EVERY + 1):
        found = tracker.step(frames[0].luma, i / 30)
    assert np.isfinite(found.corners[:2]).all()
    assert np.isnan(found.corners[2]).all()
    assert set(found.strangers) == {2, 3}
