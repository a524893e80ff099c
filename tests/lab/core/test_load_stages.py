"""When a load begins, reverses and ends, from the tags alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.recording.force_noise import LoadChange, displacement, load_changes, turning_points

TIME = np.linspace(0.0, 10.0, 501)


def test_a_wave_turns_where_it_turns() -> None:
    wave = np.interp(TIME, [0.0, 3.0, 5.0, 8.0, 10.0], [0.0, 1.0, 0.3, 0.8, 0.0])
    assert TIME[turning_points(wave, 0.05)] == pytest.approx([3.0, 5.0, 8.0])
    assert turning_points(wave, 0.6) == [int(np.argmax(wave))]
    assert turning_points(np.zeros(9), 0.1) == []


def test_one_push_begins_turns_and_ends() -> None:
    size = np.interp(TIME, [0.0, 2.0, 5.0, 6.0, 9.0, 10.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    begun, turned, ended = load_changes(TIME, size, size > 0.0)
    assert [c.release for c in (begun, turned, ended)] == [False, False, True]
    assert begun.begin < 2.0
    assert begun.end == pytest.approx(2.3, abs=0.03)
    assert 4.85 < turned.begin < 5.0
    assert turned.end == pytest.approx(6.3, abs=0.03)
    assert ended.begin == pytest.approx(8.7, abs=0.03)
    assert ended.end > 8.98
    assert turned.fraction(np.array([0.0, turned.begin, turned.end, 10.0])) == pytest.approx([0.0, 0.0, 1.0, 1.0])


def test_a_push_held_to_the_end_is_not_released_and_two_pushes_are_told_apart() -> None:
    held = np.interp(TIME, [0.0, 2.0, 5.0, 10.0], [0.0, 0.0, 1.0, 1.0])
    assert [c.release for c in load_changes(TIME, held, held > 0.0)] == [False]
    twice = np.interp(TIME, [0.0, 1.0, 2.0, 4.0, 6.0, 7.0, 9.0], [0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0])
    ends = [c.release for c in load_changes(TIME, twice, twice > 0.0)]
    assert ends == [False, False, True, False, False, True]
    assert load_changes(TIME, np.zeros(len(TIME)), np.ones(len(TIME), dtype=bool)) == []


def test_displacement_bridges_missing_tags() -> None:
    xy = np.zeros((3, 2, 2))
    xy[:, :, 0] = np.array([0.0, 1.0, 2.0])[:, None]
    xy[1, 0] = np.nan
    rest = np.zeros((2, 2))
    expected = np.array([0.0, 1.0, 2.0]) / np.sqrt(2.0)
    assert displacement(TIME[:3], xy, rest) == pytest.approx(expected)
    assert displacement(TIME[:3], xy, np.full((2, 2), np.nan)) == pytest.approx(expected)


BENCH = VirtualBench(Beam(0.15, Uniform(0.02)), PushProfile(0.4), sensor=ForceSensor(white_sd=0.004, reversal=0.12))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_the_clock_is_found_though_the_logs_error_changes_with_the_load(seed: int) -> None:
    steps = observe_virtual(virtual_recording(BENCH, seed=seed)).source.clock
    assert steps is not None
    assert abs(steps.offset - BENCH.clock.offset) < 3.0 * steps.sd < 0.4


@pytest.mark.slow
def test_no_step_is_claimed_where_the_logs_error_has_none() -> None:
    even = replace(BENCH, sensor=ForceSensor(white_sd=0.004))
    clean = observe_virtual(virtual_recording(even, seed=0)).source.clock
    assert clean is not None
    assert clean.found
    assert clean.sd < 0.02


def changes_of(dip: float) -> list[LoadChange]:
    """Of a load that grows evenly to its largest in 10 s, comes back by `dip`, grows again, and is let go."""
    time = np.arange(0.0, 30.0, 0.01)
    size = np.interp(time, [2.0, 12.0, 14.0, 16.0, 26.0], [0.0, 1.0, 1.0 - dip, 1.0, 0.0])
    return load_changes(time, size, (time >= 2.0) & (time <= 26.0))


def test_a_load_that_comes_back_by_more_than_a_twentieth_has_reversed() -> None:
    assert len(changes_of(0.04)) == 3
    assert len(changes_of(0.06)) == 5


def test_spans_of_the_changes_of_a_load() -> None:
    begin, first, second, third, end = changes_of(0.5)
    assert (begin.begin, begin.end) == pytest.approx((2.0 - 0.1, 3.0), abs=0.02)  # until a tenth of the largest
    # from 3 % of the largest before a turning point to a tenth of it behind
    assert (first.begin, first.end) == pytest.approx((12.0 - 0.3, 12.0 + 0.4), abs=0.03)
    assert (second.begin, second.end) == pytest.approx((14.0 - 0.12, 14.0 + 0.4), abs=0.03)
    assert (third.begin, third.end) == pytest.approx((16.0 - 0.12, 16.0 + 1.0), abs=0.03)
    assert (end.begin, end.end) == pytest.approx((25.0, 26.0 + 0.1), abs=0.03)
    assert [change.release for change in (begin, first, second, third, end)] == [False] * 4 + [True]
