"""Tags in rendered films are found where they are, whatever the threads, and what is wrong is said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from onebend.errors import ObservationError
from onebend.recording.entries import TagEntry, TagsEntry, VideoEntry
from onebend.recording.tag_finder import CELLS, Finder, correct_still
from onebend.recording.tags import detect_tags, in_order, track_block, uneven
from onebend.recording.video import FilmFrame
from onebend.records import Array
from tests.recording.filmed import HEIGHT, SIZE, WIDTH, corners_of, film, picture, poses, view

TAGS = TagsEntry(size=SIZE, on_base=(TagEntry(0, 0.0),), on_beam=tuple(TagEntry(i, i / 3) for i in (1, 2, 3)))


def save(path: Path, frames: Sequence[FilmFrame], rate: int = 30) -> VideoEntry:
    """The frames as a lossless file."""
    height, width = frames[0].luma.shape
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, height, "gray"
        for i, frame in enumerate(frames):
            out = av.VideoFrame.from_ndarray(frame.luma, format="gray")
            out.pts = i
            container.mux(stream.encode(out))
        container.mux(stream.encode())
    return VideoEntry(path)


@pytest.fixture(scope="module")
def push(tmp_path_factory: pytest.TempPathFactory) -> tuple[VideoEntry, Array]:
    """A short film of a bending beam, the middle tag hidden for a while, and its true corners."""
    true = poses(40)
    true[14:25, 2] = np.nan
    return save(tmp_path_factory.mktemp("push") / "video.mkv", film(true, range(4), view())), corners_of(true, view())


def test_corners_are_found_where_they_are(push: tuple[VideoEntry, Array]) -> None:
    video, true = push
    found = detect_tags(video, TAGS)
    assert found.tag_id.tolist() == [0, 1, 2, 3]
    assert (found.width, found.height) == (WIDTH, HEIGHT)
    assert found.time == pytest.approx(np.arange(40) / 30, abs=1e-3)
    error = found.corners - true
    assert (np.isfinite(error) == np.isfinite(true)).all()  # every visible tag, and none where it is hidden
    assert np.sqrt(np.nanmean(error**2)) < 0.1
    assert np.abs(np.nanmean(error, axis=(0, 1, 2))).max() < 0.01  # the half-pixel convention
    assert any("Tag 2 was not seen in 11 of 40 frames" in remark.text for remark in found.remarks)


def test_threads_do_not_change_the_result(push: tuple[VideoEntry, Array]) -> None:
    one, three = (detect_tags(push[0], TAGS, threads=threads).corners for threads in (1, 3))
    assert np.array_equal(one, three, equal_nan=True)


def test_fast_tag_is_followed_and_a_jump_is_caught() -> None:
    true = poses(24)
    true[:, 3, 0] -= 0.0012 * np.arange(24)  # px: about 3 a frame, and
    true[12:, 3, 1] -= 0.03  # 70 at once
    frames = film(true, range(4), view())
    tracks = track_block(frames, range(4), Finder("tag36h11"))
    assert np.isfinite(tracks.corners).all()
    assert np.abs(tracks.corners - corners_of(true, view())).max() < 0.4
    assert tracks.looks <= 3  # the whole picture is searched at the start and for the jump, not in every frame


def test_tag_that_appears_is_followed_back_to_its_first_frame() -> None:
    true = poses(20)
    true[:11, 1] = np.nan  # found by the search of frame 16, seen from frame 11 on
    tracks = track_block(film(true, range(4), view()), range(4), Finder("tag36h11"))
    assert np.isnan(tracks.corners[:11, 1]).all()
    assert np.isfinite(tracks.corners[11:, 1]).all()


@pytest.mark.slow
def test_whole_pattern_is_better_than_the_edges_for_a_still_tag() -> None:
    random = np.random.default_rng(3)
    before, after = [], []
    for turn in random.uniform(-3, 3, 6):
        pose = np.array([[0.07 + 0.001 * turn, 0.0, turn]])
        frames = film(np.repeat(pose[None], 12, axis=0), [5], view(), seed=int(100 * abs(turn)))
        finder = Finder("tag36h11")
        raw = np.array([[finder.look(frame.luma)[0].corners] for frame in frames])
        better = correct_still(frames, raw, CELLS["tag36h11"])
        true = corners_of(pose, view())
        before.append((raw.mean(axis=0) - true).ravel())
        after.append((better.mean(axis=0) - true).ravel())
    assert np.sqrt(np.mean(np.square(after))) < 0.7 * np.sqrt(np.mean(np.square(before)))
    assert np.sqrt(np.mean(np.square(after))) < 0.025  # much of it from rendering by a few samples a pixel


def test_pattern_fit_leaves_moving_and_half_hidden_tags_alone() -> None:
    true = np.repeat(poses(3)[:1], 12, axis=0)
    true[:, 1, 0] += 1e-4 * np.arange(12)  # about 0.2 px a frame
    frames = film(true, range(4), view())
    edge = corners_of(true, view()).copy()
    for frame in frames:  # something dark over a third of tag 2, between its corners
        left, top = edge[0, 2].min(axis=0).astype(int)
        frame.luma[top + 4 : top + 24, left + 8 : left + 18] = 90
    assert np.array_equal(correct_still(frames, edge, 8)[:, 1:3], edge[:, 1:3])
    assert not np.array_equal(correct_still(frames, edge, 8)[:, 3], edge[:, 3])
    assert np.array_equal(correct_still(frames, edge, None), edge)


def still(
    tmp_path: Path, tag_id: Sequence[int], *, family: str = "tag36h11", count: int = 3, rate: int = 30
) -> VideoEntry:
    luma = np.rint(picture(poses(3)[0, : len(tag_id)], tag_id, view(), family=family)).astype(np.uint8)
    return save(tmp_path / "video.mkv", [FilmFrame(i, i / rate, luma) for i in range(count)], rate)


def test_no_tag_at_all(tmp_path: Path) -> None:
    empty = np.full((HEIGHT, WIDTH), 90, np.uint8)
    with pytest.raises(ObservationError, match=r"no tag of recording\.toml is in any of the 3 frames.*in focus"):
        detect_tags(save(tmp_path / "a.mkv", [FilmFrame(i, i / 30, empty) for i in range(3)]), TAGS)


def test_wrong_ids_and_wrong_family_are_named(tmp_path: Path) -> None:
    with pytest.raises(ObservationError, match="ids seen are 10, 11, 12, 13"):
        detect_tags(still(tmp_path, [10, 11, 12, 13]), TAGS)
    with pytest.raises(ObservationError, match=r"look like tag25h9 \(ids 0, 1, 2, 3\)"):
        detect_tags(still(tmp_path, [0, 1, 2, 3], family="tag25h9"), TAGS)


def test_one_id_at_two_places_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ObservationError, match=r"tag 1 is in the picture twice \(frame 0"):
        detect_tags(still(tmp_path, [0, 1, 1, 3]), TAGS)


def test_missing_base_and_missing_beam_tags(tmp_path: Path) -> None:
    with pytest.raises(ObservationError, match=r"no base tag \(id 0\)"):
        detect_tags(still(tmp_path, [1, 2, 3]), TAGS)
    with pytest.raises(ObservationError, match=r"no beam tag \(id 1, 2, 3\)"):
        detect_tags(still(tmp_path, [0]), TAGS)


def test_an_unseen_tag_beside_a_stranger_is_a_wrong_id(tmp_path: Path) -> None:
    with pytest.raises(ObservationError, match="tag 3 is in none of 3 frames; seen: 0, 1, 2, 9"):
        detect_tags(still(tmp_path, [0, 1, 2, 9]), TAGS)


def test_a_stranger_or_an_unseen_tag_alone_is_remarked(tmp_path: Path) -> None:
    found = detect_tags(still(tmp_path, [0, 1, 2, 3]), replace(TAGS, on_beam=TAGS.on_beam[:-1]))
    assert any("does not name: 3" in remark.text for remark in found.remarks if remark.level == "note")
    found = detect_tags(still(tmp_path, [0, 1, 2]), TAGS)
    assert any("Tag 3 is in none of 3 frames" in one.text for one in found.remarks if one.level == "warning")


def test_other_family_is_found_when_asked(tmp_path: Path) -> None:
    video = still(tmp_path, [0, 1, 2, 3], family="tag25h9")
    found, _ = detect_tags(video, replace(TAGS, family="tag25h9")).of_searched()
    assert np.abs(found.corners - corners_of(poses(3)[0], view())).max() < 0.3


def test_work_in_order_takes_no_more_than_it_may() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for i in range(20):
            taken.append(i)
            yield i

    with ThreadPoolExecutor(2) as pool:
        for done, result in enumerate(in_order(pool, lambda i: i * i, items(), ahead=3)):
            assert result == done * done
            assert len(taken) <= done + 4
    assert taken == list(range(20))


def test_frames_between_are_searched_where_tags_do_not_pass_evenly() -> None:
    x = np.where(np.arange(33) < 16, 2.0 * np.arange(33), 32.0)  # px: on evenly, then at rest
    tracks = np.zeros((33, 1, 4, 2))
    tracks[..., 0] = x[:, None, None]
    even = np.arange(33) % 2 == 0
    tracks[~even] = np.nan
    assert uneven(tracks, even, np.arange(33) % 2, 2).tolist() == [13, 15, 17, 19]
    tracks[24] = np.nan  # hidden in one frame that was searched
    assert {23, 25} <= set(uneven(tracks, even, np.arange(33) % 2, 2).tolist())


def test_a_tag_at_rest_is_searched_in_every_other_frame_and_the_others_are_said_not_to_be(tmp_path: Path) -> None:
    found = detect_tags(still(tmp_path, [0, 1, 2, 3], rate=60), TAGS)
    assert found.searched is not None
    assert found.searched.tolist() == [True, False, True]
    assert np.isnan(found.corners[1]).all()
    some, number = found.of_searched()
    assert number.tolist() == [0, 2]
    assert np.isfinite(some.corners).all()
