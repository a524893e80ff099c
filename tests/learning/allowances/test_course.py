"""The course of a push, from its tags."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances import course_of, filled, with_rest
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


def test_a_tag_that_is_not_seen_has_moved_as_the_nearest_one_says() -> None:
    """In proportion, which a beam that bends far keeps to within some percent."""
    xy, angle = MADE.xy.copy(), MADE.angle.copy()
    xy[::2, -1], angle[::2, -1] = np.nan, np.nan
    run, whole = course_of(replace(MADE, xy=xy, angle=angle), EVERY), course_of(MADE, EVERY)
    for one, other in ((run.bend, whole.bend), (run.turn, whole.turn), (run.turn_at_push, whole.turn_at_push)):
        np.testing.assert_allclose(one, other, atol=0.1 * np.max(np.abs(other)))
    np.testing.assert_allclose(run.moved, whole.moved, atol=0.05)


def test_a_marker_moves_as_the_nearest_where_they_were_never_seen_to_move_together() -> None:
    moved = np.linspace(0.0, 1.0, 9)[:, None, None] * np.arange(1.0, 4.0)[None, :, None] * np.ones(2)
    hidden = moved.copy()
    hidden[3:6, 1:] = np.nan
    np.testing.assert_allclose(filled(hidden), moved, atol=0.03)
    hidden[1:, 2] = np.nan
    hidden[0, 2] = 1e-3  # noise at rest
    np.testing.assert_allclose(filled(hidden)[[1, 2, 6, 7, 8], 2], moved[[1, 2, 6, 7, 8], 1])


def test_a_beam_that_never_moves_and_a_single_frame_are_no_error() -> None:
    still = replace(MADE, xy=np.tile(MADE.rest_xy, (21, 1, 1)), angle=np.tile(MADE.rest_angle, (21, 1)))
    run = course_of(still, EVERY)
    assert np.all(run.bend == 0.0)
    assert np.all(run.elapsed == 0.0)
    assert course_of(MADE, np.arange(21) == 3).bend.tolist() == [1.0]


def test_frames_at_rest_come_behind_with_zeros() -> None:
    values = with_rest(np.arange(6.0).reshape(3, 2), 5)
    np.testing.assert_array_equal(values, [[0, 1], [2, 3], [4, 5], [0, 0], [0, 0]])
