"""A film that hung is told from a beam that rests, and from one that moves by jerks."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.recording.tags import frozen, frozen_remarks, noting_changes, repeated
from onebend.recording.video import FilmFrame
from onebend.records import Array

COUNT = 60


def corners(way: Array) -> Array:
    """(T, 1, 4, 2) px of one tag that goes `way` (T,) px along x."""
    square = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    return np.asarray(square + np.stack([way, np.zeros_like(way)], axis=-1)[:, None, None])


@pytest.mark.parametrize(
    ("way", "left_out"),
    [
        (np.arange(COUNT) * 2.0, True),  # it moved on while the pictures stood
        (np.full(COUNT, 5.0), False),  # it rests
        (np.where(np.arange(COUNT) < 30, 0.0, np.arange(COUNT) * 2.0 - 58.0), False),  # it begins to move then
    ],
)
def test_pictures_are_left_out_where_the_beam_is_elsewhere_afterwards(way: Array, left_out: bool) -> None:
    seen = corners(way)
    repeats = np.zeros(COUNT, dtype=bool)
    repeats[20:30] = True
    seen[20:30] = seen[19]
    hung = frozen(seen, repeats)
    assert np.array_equal(hung, repeats if left_out else np.zeros(COUNT, dtype=bool))
    said = [remark.text for remark in frozen_remarks(hung, np.arange(COUNT) / 30.0)]
    assert bool(said) == left_out
    assert all("frames 20 to 29" in text and "hung for 0.37 s" in text for text in said)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_repeat_is_told_by_the_noise_that_it_lacks(noise: float) -> None:
    random = np.random.default_rng(0)
    pictures = [random.normal(120.0, noise, (40, 60)) + t for t in range(COUNT)]
    pictures[20:30] = [pictures[19]] * 10
    frames = [FilmFrame(t, t / 30.0, one.astype(np.uint8)) for t, one in enumerate(pictures)]
    changes: list[float] = []
    assert list(noting_changes(frames, changes)) == frames
    assert np.array_equal(np.flatnonzero(repeated(changes)), np.arange(20, 30))
