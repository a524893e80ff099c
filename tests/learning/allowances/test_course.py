"""The course of a push, from its tags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances import course_of, with_rest
from tests.learning.bench import SOFT, forces, observed

MADE = observed(SOFT, forces(21))
EVERY = np.ones(21, dtype=bool)


def test_bend_and_turn_are_those_since_rest() -> None:
    run = course_of(MADE, EVERY)
    away = np.sqrt(np.mean(np.sum((MADE.xy - MADE.rest_xy) ** 2, axis=-1), axis=1))
    np.testing.assert_allclose(run.bend, away / np.max(away), atol=1e-14)
    np.testing.assert_allclose(run.turn, MADE.angle - MADE.rest_angle, atol=1e-14)


def test_the_way_back_begins_after_the_farthest_frame() -> None:
    run = course_of(MADE, EVERY)
    farthest = int(np.argmax(run.bend))
    assert 0 < farthest < 20
    np.testing.assert_array_equal(run.back, np.arange(21) > farthest)


def test_what_has_elapsed_grows_with_bend_and_time_up_to_one() -> None:
    held = replace(MADE, xy=np.tile(MADE.xy[10], (21, 1, 1)))
    np.testing.assert_allclose(course_of(held, EVERY).elapsed, np.arange(1, 22) / 21.0, atol=1e-12)
    elapsed = course_of(MADE, EVERY).elapsed
    assert np.all(np.diff(elapsed) > 0.0)
    assert elapsed[-1] == 1.0


def test_tags_that_are_not_seen_do_not_count() -> None:
    xy, angle = MADE.xy.copy(), MADE.angle.copy()
    xy[::2, 0], angle[::2, 0] = np.nan, np.nan
    run, whole = course_of(replace(MADE, xy=xy, angle=angle), EVERY), course_of(MADE, EVERY)
    np.testing.assert_allclose(run.bend[1::2] / run.bend[1], whole.bend[1::2] / whole.bend[1], atol=1e-12)
    assert np.all(run.turn[::2, 0] == 0.0)
    assert all(np.all(np.isfinite(x)) for x in (run.bend, run.elapsed, run.turn))


def test_a_beam_that_never_moves_and_a_single_frame_are_no_error() -> None:
    still = replace(MADE, xy=np.tile(MADE.rest_xy, (21, 1, 1)), angle=np.tile(MADE.rest_angle, (21, 1)))
    run = course_of(still, EVERY)
    assert np.all(run.bend == 0.0)
    assert np.all(run.elapsed == 0.0)
    assert course_of(MADE, np.arange(21) == 3).bend.tolist() == [1.0]


def test_frames_at_rest_come_behind_with_zeros() -> None:
    values = with_rest(np.arange(6.0).reshape(3, 2), 5)
    np.testing.assert_array_equal(values, [[0, 1], [2, 3], [4, 5], [0, 0], [0, 0]])
