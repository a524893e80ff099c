"""What is kept of a stream is in order of time, bounded, and spans all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.live.history import ForceHistory, FrameHistory
from onebend.recording.tags import TrackedFrame


def frame(time: float) -> TrackedFrame:
    corners = np.full((2, 4, 2), time)
    return TrackedFrame(time, corners, corners, np.full(2, np.nan), (10, 20))


def test_frames_stay_in_order_bounded_and_spread_over_the_whole_stream() -> None:
    history = FrameHistory(100)
    for i in range(1000):
        history.add(frame(i / 10))
        assert len(history) <= 100
    tracks = history.tracks()
    assert np.all(np.diff(tracks.time) > 0)
    assert tracks.time[0] == 0.0
    assert tracks.time[-1] > 97.0
    assert np.diff(tracks.time).max() < 2.0  # evenly
    assert np.array_equal(tracks.corners[:, 0, 0, 0], tracks.time)
    assert history.count == 1000


def test_frames_that_are_spared_stay() -> None:
    spared = {i / 10 for i in range(7, 1000, 90)}
    history = FrameHistory(100, spared)
    for i in range(1000):
        history.add(frame(i / 10))
        assert len(history) <= 100
    tracks = history.tracks()
    assert spared < set(tracks.time.tolist())
    assert np.all(np.diff(tracks.time) > 0)


def test_a_late_frame_comes_into_its_place() -> None:
    history = FrameHistory(100)
    for time in (0.0, 0.1, 0.3, 0.2, 0.4):
        history.add(frame(time))
    assert history.tracks().time.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]


def test_a_tag_at_rest_is_corrected_in_all_its_frames_by_the_last_of_them() -> None:
    history = FrameHistory(100)
    for i in range(30):
        came = frame(0.0)
        since, shift = (0.0, 0.1 * (i >= 8)) if i < 20 else (2.0, 0.0)
        history.add(replace(came, time=i / 10, corners=came.detected + shift, still_since=np.array([since, np.nan])))
    x = history.tracks().corners[:, :, 0, 0]
    assert np.allclose(x[:20, 0], 0.1)
    assert np.all(x[20:, 0] == 0.0)
    assert np.all(x[:, 1] == 0.0)


def rows(time: list[float]) -> np.ndarray:
    return np.column_stack([time, np.array(time) * 2.0, np.array(time) * -1.0])


def test_rows_come_into_their_places_however_they_come() -> None:
    rng, log = np.random.default_rng(0), ForceHistory(5000)
    time = np.arange(2000) / 1000.0
    order = np.argsort(time + rng.uniform(0.0, 0.05, len(time)))
    for part in np.array_split(order, 300):
        log.add(rows(time[part].tolist()))
    assert np.array_equal(log.rows, rows(time.tolist()))
    assert log.late > 100
    log.add(rows([np.nan, np.inf, 2.5]))
    assert (len(log), log.refused, log.count) == (2001, 2, 2003)


def test_rows_are_bounded_and_become_means() -> None:
    log = ForceHistory(300)
    for i in range(1000):
        log.add(rows([i / 1000.0]))
        assert len(log) <= 300
    assert np.all(np.diff(log.rows[:, 0]) > 0)
    assert log.rows[-1, 0] > 0.99
    assert np.allclose(log.rows[:, 1], 2.0 * log.rows[:, 0])
    assert np.mean(np.diff(log.rows[:, 0])) == pytest.approx(4e-3, rel=0.02)


def test_the_force_at_a_time_is_the_mean_around_it_and_nothing_far_from_any_row() -> None:
    log = ForceHistory(300)
    log.add(rows([0.0, 0.1, 0.11, 0.5]))
    assert log.mean_near(0.105, 0.02, 0.1) == pytest.approx([0.21, -0.105])
    assert log.mean_near(0.05, 0.01, 0.1)[0] in (0.0, pytest.approx(0.2))
    assert np.isnan(log.mean_near(0.3, 0.01, 0.1)).all()
    assert np.isnan(ForceHistory(10).mean_near(0.0, 1.0, 1.0)).all()
    log.add(np.array([[0.105, np.nan, np.nan]]))
    assert log.mean_near(0.105, 0.02, 0.1) == pytest.approx([0.21, -0.105])  # a gap is no zero
