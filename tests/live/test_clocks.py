"""Two clocks that drift and jitter, brought together from stamps and arrivals alone."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.live.sources import PlayedClock, StampedClock, StampTiming, clock_line
from onebend.records import Array


def arrivals(stamp: Array, pace: float, begin: float, seed: int, *, late: float = 0.004, jitter: float = 3e-4) -> Array:
    """(n, 2) stamps and arrivals of moments (n,) s on this machine's clock: delays of 1 ms and more, one in fifty very
    late, and for a tenth of the time everything late by 30 ms."""
    rng = np.random.default_rng(seed)
    own = begin + pace * stamp + jitter * rng.standard_normal(len(stamp))
    delay = 0.001 + rng.exponential(late, len(stamp)) + 0.1 * (rng.random(len(stamp)) < 0.02)
    busy = (stamp > 0.4 * stamp[-1]) & (stamp < 0.5 * stamp[-1])
    return np.column_stack([own, stamp + delay + 0.03 * busy])


@pytest.mark.parametrize("seconds", [3.0, 20.0, 300.0])
@pytest.mark.parametrize("seed", range(5))
def test_camera_and_force_agree_to_two_milliseconds(seconds: float, seed: int) -> None:
    drift = np.random.default_rng(seed).uniform(-1e-4, 1e-4, 2)
    moments = np.arange(0.0, seconds, 1 / 30), np.arange(0.0, seconds, 1 / 500)
    camera, force = StampedClock(StampTiming(delay=0.001)), StampedClock(StampTiming(delay=0.001))
    for clock, when, pace, begin in zip((camera, force), moments, 1.0 + drift, (1e4, -50.0), strict=True):
        for one in arrivals(when, pace, begin, seed).tolist():
            clock.add(*one)
    push = np.linspace(0.0, seconds, 50)
    on_film = camera.from_host(force.host(-50.0 + (1.0 + drift[1]) * push, np.full(50, np.nan)))
    assert np.abs(on_film - (1e4 + (1.0 + drift[0]) * push)).max() < 0.002


def test_the_line_is_the_lower_edge_and_says_how_sure_it_is() -> None:
    stamp = np.linspace(0.0, 60.0, 3000)
    points = arrivals(stamp, 1.0, 7.0, 3)
    line = clock_line(points[:, 0], points[:, 1])
    assert line.host(67.0) == pytest.approx(60.001, abs=1e-3)
    assert 0.0 < line.sd < 1e-3
    assert line.own(line.host([8.0, 9.0])) == pytest.approx([8.0, 9.0])


def test_without_stamps_the_arrivals_count() -> None:
    clock = StampedClock(StampTiming(own=False, delay=0.02))
    clock.add(np.nan, 5.0)
    assert clock.host([np.nan], [5.0]) == pytest.approx(4.98)
    assert clock.from_host(4.98) == pytest.approx(5.0)


def test_stamps_of_this_machine_stand_as_they_are() -> None:
    clock = StampedClock(StampTiming(host=True, delay=0.01))
    clock.add(1.0, 1.5)
    clock.add(2.0, 2.7)
    assert clock.host([1.0, 2.0], [1.5, 2.7]) == pytest.approx([0.99, 1.99])


def test_a_row_without_a_stamp_goes_by_its_arrival() -> None:
    clock = StampedClock(StampTiming())
    for stamp in range(100):
        clock.add(stamp, stamp + 40.0)
    assert clock.host([3.0, np.nan], [43.2, 44.2]) == pytest.approx([43.0, 44.2])


def test_no_number_is_no_line() -> None:
    line = clock_line(np.array([np.nan]), np.array([1.0]))
    assert np.isnan(line.begin)
    clock = StampedClock(StampTiming())
    assert clock.host([2.0], [5.0]) == pytest.approx(5.0)  # nothing is known yet: as it came


def test_what_is_kept_is_bounded() -> None:
    clock = StampedClock(StampTiming(), most=1000)
    for stamp in np.arange(0.0, 100.0, 1e-3).tolist():
        clock.add(stamp, stamp + 5.0)
        assert len(clock._points) <= 1000
    assert clock.host(90.0, np.nan) == pytest.approx(95.0, abs=1e-6)


def test_a_counter_of_another_rate_is_followed_where_that_is_allowed() -> None:
    stamp = np.arange(0.0, 30.0, 0.01)
    points = arrivals(1.25 * stamp, 0.8, 0.0, 1, jitter=0.0)
    line = clock_line(points[:, 0], points[:, 1], most_drift=0.5)
    assert line.pace == pytest.approx(1.25, abs=1e-4)


def test_a_played_clock_goes_where_it_is_told() -> None:
    clock = PlayedClock(10.0)
    assert clock.now() == 10.0
    clock.wait_until(12.0)
    clock.wait_until(11.0)
    assert clock.now() == 12.0
