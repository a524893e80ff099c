"""Copies of pictures are told from a beam that rests, and from one that moves by jerks."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.recording.signals import copies_in_motion
from onebend.recording.tags import GOES_ON, STANDS, stale_remarks
from onebend.records import Array

COUNT = 60


def along(way: Array) -> Array:
    """(T, 1, 2) px of one tag that goes `way` (T,) px along x."""
    return np.stack([way, np.zeros_like(way)], axis=-1)[:, None]


@pytest.mark.parametrize(
    ("way", "left_out"),
    [
        (np.arange(COUNT) * 2.0, True),  # it moved on while the pictures stood
        (np.full(COUNT, 5.0), False),  # it rests
        (np.where(np.arange(COUNT) < 30, 0.0, np.arange(COUNT) * 2.0 - 58.0), False),  # it begins to move then
    ],
)
def test_pictures_are_left_out_where_the_beam_is_elsewhere_afterwards(way: Array, left_out: bool) -> None:
    seen = along(way)
    repeats = np.zeros(COUNT, dtype=bool)
    repeats[20:30] = True
    seen[20:30] = seen[19]
    hung = copies_in_motion(np.arange(COUNT) / 30.0, seen, STANDS, GOES_ON)
    assert np.array_equal(hung, repeats if left_out else np.zeros(COUNT, dtype=bool))
    said = [remark.text for remark in stale_remarks(hung, np.arange(COUNT) / 30.0)]
    assert bool(said) == left_out
    assert all("frames 20 to 29" in text and "hung for 0.37 s" in text for text in said)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_single_copies_are_found_where_the_beam_moves_and_only_there(share: float) -> None:
    random = np.random.default_rng(1)
    time = np.arange(400)
    way = 40.0 * np.clip(np.sin(2.0 * np.pi * (time - 60) / 400.0), 0.0, None) ** 2 + 0.02 * random.standard_normal(400)
    copies = random.random(400) < share
    copies[0] = False
    of = np.maximum.accumulate(np.where(copies, 0, time))  # the frame that is shown
    stale = copies_in_motion(time / 30.0, along(way[of]), STANDS, GOES_ON)
    moves = np.abs(way[of] - 40.0 * np.clip(np.sin(2.0 * np.pi * (time - 60) / 400.0), 0.0, None) ** 2) > 0.3
    assert np.sum(stale & ~copies) <= 3  # where it all but stands
    assert moves.sum() > 5
    assert stale[moves].all()
    assert not stale[:55].any()


def test_a_few_copied_pictures_are_said_with_their_share() -> None:
    stale = np.zeros(200, dtype=bool)
    stale[[20, 50, 51, 90]] = True
    (remark,) = stale_remarks(stale, np.arange(200) / 30.0)
    assert remark.text.startswith("4 of 200 pictures (2 %) only repeat the one before")
