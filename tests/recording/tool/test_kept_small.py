"""The pictures that are kept of a stream show the tool as the film does, and are bounded however long it runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.recording.entries import PushEntry
from onebend.recording.tool import AT_REST, LOADED, MOST, KeptSmall, tool_in_small
from onebend.records import Array
from tests.recording.filmed import LENGTH, SIZE, corners_of, recording, view
from tests.recording.tool.scenes import FACTOR, bends, filmed, in_room

RATE = 8.0  # pictures per second


@pytest.mark.parametrize("at", [0.7, 1.0])
def test_the_tool_is_seen_in_what_was_kept_as_in_the_film(at: float) -> None:
    film, kept = filmed((at, in_room(0.5))), KeptSmall(LENGTH, SIZE)
    time: Array = np.arange(len(film.pictures)) / RATE
    for t, picture, tags in zip(time.tolist(), film.pictures, bends(), strict=True):
        whole = np.repeat(np.repeat(np.clip(np.rint(picture), 0, 255), FACTOR, axis=0), FACTOR, axis=1)
        kept.add(t, whole.astype(np.uint8), corners_of(tags, view()))
    small, rec = kept.small(), replace(recording(), push=PushEntry(at=at))
    assert small is not None
    assert small.factor == FACTOR
    assert small.pictures[0].shape == film.pictures[0].shape
    found = tool_in_small(small, rec, film.markers, film.loaded, time)
    assert found.seen, found.why
    assert found.s == pytest.approx(film.place().s, abs=0.01)
    others = tool_in_small(small, rec, film.markers, film.loaded, time + 0.5 / RATE)
    assert others.why == "no picture was kept"


def test_rest_and_push_are_kept_of_a_long_stream() -> None:
    kept = KeptSmall(LENGTH, SIZE)
    minutes = 20
    rest = np.arange(0.0, 60.0 * minutes, 0.5)
    push = rest[-1] + 0.1 * np.arange(1, 101)
    for time in (*rest.tolist(), *push.tolist()):
        way = 40.0 * np.clip((time - push[0]) / 10.0, 0.0, 1.0)  # px
        kept.add(time, np.zeros((30, 40), np.uint8), tags_at(way))
        assert len(kept) <= MOST
    small = kept.small()
    assert small is not None
    assert (np.diff(small.time) > 0.0).all()
    resting, pushed = small.time[small.time <= push[3]], small.time[small.time > push[3]]
    assert len(resting) >= AT_REST  # as many as are looked at
    assert resting[-1] > 0.8 * rest[-1]  # of all the rest
    assert len(pushed) >= LOADED
    assert all(time in kept for time in small.time.tolist())
    assert push[0] + 0.05 not in kept


def test_large_pictures_are_fewer() -> None:
    few, many = KeptSmall(LENGTH, SIZE), KeptSmall(LENGTH, SIZE)
    for i in range(200):
        few.add(0.2 * i, np.zeros((1000, 1000), np.uint8), tags_at(2.0 * i))
        many.add(0.2 * i, np.zeros((100, 100), np.uint8), tags_at(2.0 * i))
    assert 8 <= len(few) <= 25 < len(many)
    blind = KeptSmall(LENGTH, SIZE)
    blind.add(0.0, np.zeros((100, 100), np.uint8), np.full((2, 4, 2), np.nan))
    assert blind.small() is None


def tags_at(way: float) -> Array:
    """(2, 4, 2) px: a small tag that stays, and one that has moved so far."""
    square = np.array([[0.0, 10.0], [10.0, 10.0], [10.0, 0.0], [0.0, 0.0]])
    return np.stack([square, square + np.array([20.0, way])])
