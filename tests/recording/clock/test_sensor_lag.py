"""A slow force sensor: found by what the log does beside the tags, and undone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.recording.clock import fit_clock
from onebend.recording.clock_evidence import QUICK, compared_rows, lag_evidence
from onebend.recording.clock_features import FORGOTTEN, GaplessMarkers, film_features, lagging, lasting
from onebend.recording.force import without_lag
from onebend.recording.signals import low_pass, step
from onebend.records import BoolArray, ForceLog, Markers
from tests.recording.pushed import Pushed

PUSHED = Pushed()


def behind(log: ForceLog, tau: float) -> ForceLog:
    """The log of a sensor with a first-order lag `tau` [s], which was at rest before."""
    part, force = 1.0 - np.exp(-step(log.time) / tau), log.force.copy()
    force[0] = log.force[:50].mean(axis=0)
    for i in range(1, len(force)):
        force[i] = force[i - 1] + part * (log.force[i] - force[i - 1])
    return replace(log, force=force)


def found(log: ForceLog, push_s: float | None = 1.0) -> float | None:
    return fit_clock(PUSHED.markers(), log, 249.4, 2.0, push_s=push_s).lag


@pytest.mark.parametrize("push_s", [None, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_slow_sensor_is_found_and_a_quick_one_is_not(push_s: float | None) -> None:
    lag = found(behind(PUSHED.log(), 0.8), push_s)
    assert lag == pytest.approx(0.8, rel=0.2)
    assert found(PUSHED.log(), push_s) is None


@pytest.mark.slow
def test_a_delay_is_no_lag() -> None:
    log = PUSHED.log()
    assert found(replace(log, time=log.time + 0.8)) is None


def test_a_lag_that_hardly_differs_has_hardly_any_evidence() -> None:
    """For or against it: both fits are held against the same rows, whatever noise each of them finds."""
    log = PUSHED.log()
    noise = 0.13 * np.random.default_rng(2).standard_normal(log.force.shape)
    noisy = replace(log, force=log.force + behind(replace(log, force=noise), 0.12).force)
    film = film_features(PUSHED.markers(), None)
    rows = compared_rows(film, noisy, (PUSHED.offset - 4.1, PUSHED.offset + 0.1))
    assert rows is not None
    assert abs(lag_evidence(film.tracks[0], rows, PUSHED.offset, 1.25 * QUICK[-1])) < 3.0


def test_a_lag_is_undone() -> None:
    log = PUSHED.log()
    smooth = low_pass(log.time, log.force, 2.0, longest_gap=0.1)
    slow = behind(log, 0.8)
    undone = without_lag(slow, 0.8, 2.0).force
    inner = slice(100, -100)
    size = float(np.ptp(smooth[:, 0]))
    assert np.abs(slow.force - smooth)[inner].max() > 0.3 * size
    assert np.abs(undone - smooth)[inner].max() < 0.1 * size


def passed_over() -> Markers:
    """The tags of the push, which something hides for about half a second each, one after the other."""
    markers = PUSHED.markers()
    xy, angle = markers.xy.copy(), markers.angle.copy()
    for tag, (first, last) in enumerate([(3.0, 3.4), (3.5, 4.0), (4.1, 4.6)]):
        hidden = (markers.time > first) & (markers.time < last)
        xy[hidden, tag], angle[hidden, tag] = np.nan, np.nan
    return replace(markers, xy=xy, angle=angle)


def test_what_passes_over_the_tags_costs_frames_and_no_tag() -> None:
    markers = passed_over()
    used, covered = lasting(markers)
    assert used.all()
    np.testing.assert_array_equal(covered, np.isfinite(markers.xy).all(axis=(1, 2)))
    half = replace(markers, xy=np.where(markers.time[:, None, None] > 4.0, np.nan, markers.xy))
    half.xy[:, :2] = PUSHED.markers().xy[:, :2]
    assert lasting(half)[0].tolist() == [True, True, False]


def test_what_a_filter_remembers_of_a_gap_is_not_known() -> None:
    markers = passed_over()
    gap: BoolArray = np.asarray(np.isfinite(markers.xy).all(axis=(1, 2)))
    seen = GaplessMarkers(markers.time, np.zeros(1), markers.xy, markers.angle, gap, 0.0, 0.0)
    track, tau = seen.track(markers.time[:, None, None]), 0.5
    slow = lagging(track, tau)
    after = slow.time[~slow.covered].max() - markers.time[~gap].max()
    assert after == pytest.approx(-tau * np.log(FORGOTTEN), rel=0.2)
    assert np.all(slow.covered[slow.time < 3.0])
    assert np.all(slow.covered[slow.time > 7.0])
