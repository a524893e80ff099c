"""The tags of a film are found once: what misses, what does not, and that what comes back is what was found."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.files.kept import KeptFolder, users_folder
from onebend.recording.entries import TagEntry, TagsEntry, VideoEntry
from onebend.records import Detections, Remark
from onebend.results import detection_cache
from onebend.results.detection_cache import DetectionCache, finder_version, key_of, packed, unpacked
from onebend.results.provenance import checksum_of, inputs_of
from tests.made_up import same

TAGS = TagsEntry(size=0.012, on_base=(TagEntry(0, 0.0),), on_beam=(TagEntry(4, 1.0),))


def detections() -> Detections:
    corners = np.arange(2 * 2 * 4 * 2, dtype=float).reshape(2, 2, 4, 2) / 7
    corners[1, 0] = np.nan
    return Detections(
        np.array([0.0, 1 / 30]), np.array([0, 4]), corners, 1280, 720, (Remark("note", "blurred – much"),)
    )


def equal(found: Detections | None) -> bool:
    return found is not None and all(same(getattr(found, f.name), getattr(detections(), f.name)) for f in fields(found))


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The films that were searched, by a search that finds `detections()`."""
    searched: list[Path] = []

    def search(video: VideoEntry, *_: Any, **__: Any) -> Detections:
        searched.append(video.file)
        return detections()

    monkeypatch.setattr(detection_cache, "detect_tags", search)
    return searched


@pytest.fixture
def film(tmp_path: Path) -> VideoEntry:
    file = tmp_path / "video.mp4"
    file.write_bytes(b"a film")
    return VideoEntry(file)


def test_detections_come_back_to_the_last_bit() -> None:
    assert equal(unpacked(packed(detections()), [0, 4]))
    assert unpacked(None, [0, 4]) is None
    assert unpacked(packed(detections()), [0, 5]) is None
    assert unpacked(packed(replace(detections(), corners=np.zeros((2, 2, 2)))), [0, 4]) is None


@pytest.mark.parametrize("cut", [0, 10, 300])
def test_what_is_no_archive_of_detections_counts_as_not_there(cut: int) -> None:
    assert unpacked(packed(detections())[:cut], [0, 4]) is None


def test_nothing_in_an_entry_is_run(tmp_path: Path) -> None:
    """An archive with a pickle in it, as another program might put there, is refused unread."""

    class Trap:
        def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
            return (Path.touch, (tmp_path / "sprung",))

    whole = packed(detections())
    file = tmp_path / "trap.npz"
    rest = np.zeros(1)
    np.savez(file, time=np.array([Trap()], dtype=object), tag_id=rest, corners=rest, size=np.ones(2), remarks="[]")
    assert unpacked(file.read_bytes(), [0, 4]) is None
    assert not (tmp_path / "sprung").exists()
    assert equal(unpacked(whole, [0, 4]))


def test_a_film_is_searched_once_whatever_its_name(tmp_path: Path, film: VideoEntry, searches: list[Path]) -> None:
    cache = DetectionCache(KeptFolder(tmp_path / "kept"), "1")
    assert equal(cache.detect(film, TAGS))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    copy = VideoEntry((elsewhere / "copied.MP4"), start=12.0, start_uncertainty=0.1)
    copy.file.write_bytes(film.file.read_bytes())
    moved = replace(TAGS, size=0.02, placement_sd=0.0, on_beam=(TagEntry(4, 0.9, 0.1),))
    assert equal(cache.detect(copy, moved, threads=3))
    assert searches == [film.file]


MISSES: dict[str, Callable[[VideoEntry, TagsEntry], tuple[VideoEntry, TagsEntry]]] = {
    "family": lambda film, tags: (film, replace(tags, family="tag25h9")),
    "another id": lambda film, tags: (film, replace(tags, on_beam=(TagEntry(5, 1.0),))),
    "one tag more": lambda film, tags: (film, replace(tags, on_beam=(*tags.on_beam, TagEntry(5, 0.5)))),
    "tag on the base": lambda film, tags: (film, replace(tags, on_base=(*tags.on_base, *tags.on_beam), on_beam=())),
    "rate that is compared": lambda film, tags: (replace(film, fps=25.0), tags),
    "another kind of file": lambda film, tags: (
        replace(film, file=film.file.rename(film.file.with_suffix(".avi"))),
        tags,
    ),
}


@pytest.mark.parametrize("what", MISSES)
def test_what_changes_the_search_misses(film: VideoEntry, what: str) -> None:
    before = key_of(film, TAGS, "1")
    assert key_of(*MISSES[what](film, TAGS), "1") != before


def test_another_content_another_version_other_times_miss(tmp_path: Path, film: VideoEntry) -> None:
    before = key_of(film, TAGS, "1")
    assert key_of(film, TAGS, "2") != before
    film.file.write_bytes(b"A film")
    assert key_of(film, TAGS, "1") != before
    times = tmp_path / "times.csv"
    times.write_text("time_s\n0\n")
    timed = replace(film, frame_times=times)
    first = key_of(timed, TAGS, "1")
    assert first != key_of(film, TAGS, "1")
    times.write_text("time_s\n0.0\n")
    assert key_of(timed, TAGS, "1") != first


def test_of_a_bag_every_part_counts(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for name in ("bag_0.mcap", "bag_1.mcap", "metadata.yaml"):
        (bag / name).write_bytes(name.encode())
    video, keys = VideoEntry(bag, topic="/camera"), set()
    keys.add(key_of(video, TAGS, "1"))
    for changed in (bag / "bag_0.mcap", bag / "bag_1.mcap", bag / "metadata.yaml"):
        changed.write_bytes(changed.read_bytes() + b" ")
        keys.add(key_of(video, TAGS, "1"))
    keys.add(key_of(replace(video, topic="/other"), TAGS, "1"))
    assert len(keys) == 5


def test_the_code_that_finds_tags_is_part_of_the_key(monkeypatch: pytest.MonkeyPatch, film: VideoEntry) -> None:
    before = key_of(film, TAGS, "1")
    assert finder_version() == finder_version()
    monkeypatch.setattr(detection_cache, "finder_version", lambda: "other code")
    assert key_of(film, TAGS, "1") != before


def test_a_damaged_entry_is_replaced(tmp_path: Path, film: VideoEntry, searches: list[Path]) -> None:
    folder = KeptFolder(tmp_path / "kept")
    cache = DetectionCache(folder, "1")
    cache.detect(film, TAGS)
    (entry,) = folder.entries()
    whole = entry.read_bytes()
    for damaged in (whole[:-1], whole[:200] + bytes(40) + whole[240:], b""):
        entry.write_bytes(damaged)
        assert equal(cache.detect(film, TAGS))
        assert equal(cache.detect(film, TAGS))
    assert len(searches) == 4


def test_a_film_that_changes_while_it_is_searched_is_not_kept(
    tmp_path: Path, film: VideoEntry, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = KeptFolder(tmp_path / "kept")

    def search(*_: Any, **__: Any) -> Detections:
        film.file.write_bytes(b"another film")
        return detections()

    monkeypatch.setattr(detection_cache, "detect_tags", search)
    assert equal(DetectionCache(folder, "1").detect(film, TAGS))
    assert folder.entries() == []


def test_without_a_cache_every_film_is_searched(
    tmp_path: Path, film: VideoEntry, searches: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    users = users_folder()
    assert users is not None
    for _ in range(2):
        detection_cache.detection_cache().detect(film, TAGS)
    assert (len(searches), len(users.entries())) == (1, 1)
    (tmp_path / "file").write_text("")
    for value in ("off", str(tmp_path / "file")):  # the file cannot be a folder
        monkeypatch.setenv("ONEBEND_CACHE", value)
        assert equal(detection_cache.detection_cache().detect(film, TAGS))
    assert len(searches) == 3


def test_a_large_film_is_known_in_well_under_a_second(tmp_path: Path) -> None:
    large = tmp_path / "large.mp4"
    with large.open("wb") as stream:
        stream.truncate(100_000_000)
    began = time.process_time()
    key_of(VideoEntry(large), TAGS, "1")
    took = time.process_time() - began
    (one,) = inputs_of([large])
    assert took < 1.0, took
    assert checksum_of(one) is checksum_of(one)  # once a run, for the key and for where results come from
    os.utime(large, (1e9, 1e9))
    assert inputs_of([large]) != (one,)
