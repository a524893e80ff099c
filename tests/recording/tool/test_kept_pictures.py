"""The pictures that are kept of a stream show the tool as the film does, and are bounded however long it runs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from onebend.recording.entries import PushEntry
from onebend.recording.flanks import grey
from onebend.recording.tool import AT_REST, LOADED, MOST, MOST_PIXELS, KeptPictures, tool_in_stream
from onebend.records import Array
from tests.recording.filmed import corners_of, recording, view
from tests.recording.tool.scenes import bends, filmed, in_room

RATE = 8.0  # pictures per second


@pytest.mark.parametrize("at", [0.7, 1.0])
def test_the_tool_is_seen_in_what_was_kept_as_in_the_film(at: float) -> None:
    film, kept = filmed((at, in_room(0.5))), KeptPictures()
    time: Array = np.arange(len(film.pictures)) / RATE
    buffer = np.zeros(film.pictures.shape[1:], np.uint8)  # as of a camera that writes all its pictures into one
    for t, picture, tags in zip(time.tolist(), film.pictures, bends(), strict=True):
        buffer[:] = np.clip(np.rint(picture), 0, 255)
        kept.add(t, corners_of(tags, view()), partial(grey, buffer))
    pictures, rec = kept.by_time(), replace(recording(), push=PushEntry(at=at))
    found = tool_in_stream(pictures, rec, film.markers, film.loaded, time)
    assert found.seen, found.why
    assert found.s == pytest.approx(film.place().s, abs=0.01)
    others = tool_in_stream(pictures, rec, film.markers, film.loaded, time + 0.5 / RATE)
    assert others.why == "there is no picture"


def test_rest_and_push_are_kept_of_a_long_stream() -> None:
    kept = KeptPictures()
    minutes = 20
    rest = np.arange(0.0, 60.0 * minutes, 0.5)
    push = rest[-1] + 0.1 * np.arange(1, 101)
    for time in (*rest.tolist(), *push.tolist()):
        way = 40.0 * np.clip((time - push[0]) / 10.0, 0.0, 1.0)  # px
        kept.add(time, tags_at(way), partial(grey, np.zeros((30, 40), np.uint8)))
        assert len(kept.by_time()) <= MOST
    times = np.sort([*kept.by_time()])
    resting, pushed = times[times <= push[3]], times[times > push[3]]
    assert len(resting) >= AT_REST  # as many as are looked at
    assert resting[-1] > 0.8 * rest[-1]  # of all the rest
    assert len(pushed) >= LOADED
    assert all(time in kept for time in times.tolist())
    assert push[0] + 0.05 not in kept


def test_large_pictures_are_fewer() -> None:
    few, many, small = KeptPictures(), KeptPictures(), np.zeros((100, 100), np.uint8)
    large = np.broadcast_to(np.uint8(0), (2000, MOST_PIXELS // 50_000))
    for i in range(200):
        few.add(0.2 * i, tags_at(2.0 * i), partial(grey, large))
        many.add(0.2 * i, tags_at(2.0 * i), partial(grey, small))
    assert 8 <= len(few.by_time()) <= 25 < len(many.by_time())
    blind = KeptPictures()
    blind.add(0.0, np.full((2, 4, 2), np.nan), partial(grey, small))
    assert not blind.by_time()


def tags_at(way: float) -> Array:
    """(2, 4, 2) px: a small tag that stays, and one that has moved so far."""
    square = np.array([[0.0, 10.0], [10.0, 10.0], [10.0, 0.0], [0.0, 0.0]])
    return np.stack([square, square + np.array([20.0, way])])
