"""The clock over virtual recordings: right about its own sd, and not led astray by single wrong poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies import bench_of
from onebend.lab.virtual import VirtualRecording, virtual_recording
from onebend.recording.clock import fit_clock
from onebend.recording.clock_evidence import moments_of
from onebend.recording.clock_features import without_jumps

PUSH_S = 0.98


def made(errors: str, seed: int) -> VirtualRecording:
    bench = bench_of("smooth", errors, seed)
    late = replace(bench.clock, declared=bench.clock.offset + 0.7, uncertainty=2.0)  # so that the data decide
    return virtual_recording(replace(bench, clock=late), seed=seed)


def test_single_wrong_poses_are_left_out_and_no_others() -> None:
    markers = made("white", 2).markers
    angle = markers.angle.copy()
    angle[40, 1] += 0.1
    left = without_jumps(replace(markers, angle=angle))
    assert np.argwhere(np.isnan(left.angle)).tolist() == [[40, 1]]


def test_moments_of_a_normal_distribution_on_uneven_points() -> None:
    offset = np.union1d(np.linspace(-1.0, 1.0, 21), np.linspace(-0.2, 0.4, 61))
    mean, sd = moments_of(offset, -0.5 * ((offset - 0.1) / 0.05) ** 2)
    assert np.isclose(mean, 0.1, atol=1e-3)
    assert np.isclose(sd, 0.05, rtol=0.02)


def misses(errors: str, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """s and sd, errors of the clock."""
    error, sd = [], []
    for seed in seeds:
        virtual = made(errors, seed)
        clock = virtual.bench.clock
        found = fit_clock(virtual.markers, virtual.log, clock.declared, clock.uncertainty, push_s=PUSH_S).clock
        assert found.found
        error.append(found.offset - clock.offset - virtual.bench.sensor.lag)
        sd.append(found.sd)
    return np.array(error), np.array(sd)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_white_noise_is_matched_to_hundredths_of_a_second(seed: int) -> None:
    """The fit of k(s), which knows how the beam bends, does the rest: its offset is off by a millisecond."""
    error, sd = misses("white", range(seed, seed + 1))
    assert np.abs(error).max() < 0.06
    assert np.abs(error / sd).max() < 3.5
    assert sd.max() < 0.035


@pytest.mark.slow
@pytest.mark.parametrize("errors", ["white", "correlated"])
def test_claimed_sd_is_that_of_the_errors(errors: str) -> None:
    error, sd = misses(errors, range(8))
    # chi-square of 8 divided by 8: between 0.2 and 2.5 in 98 of 100 sets.
    assert 0.2 < np.mean((error / sd) ** 2) < 2.5
