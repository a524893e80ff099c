"""The moments' likelihood of the clock: exact where the beam is, and right about its own sd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies import bench_of
from onebend.lab.virtual import VirtualRecording, virtual_recording
from onebend.recording.clock import fit_clock
from onebend.recording.clock_evidence import moments_of
from onebend.recording.clock_features import Moments, film_features, without_jumps
from onebend.recording.clock_moments import (
    CommonRows,
    ForceLogModel,
    MomentsAtRows,
    film_misfit,
    fit_jumps,
    load_change_share,
    log_covariance,
    moments_at,
    with_misfit,
)
from onebend.recording.force_noise import TimeSpans, covariance
from onebend.records import ForceNoise

PUSH_S = 0.98


def made(errors: str, seed: int) -> VirtualRecording:
    bench = bench_of("smooth", errors, seed)
    late = replace(bench.clock, declared=bench.clock.offset + 0.7, uncertainty=2.0)  # so that the data decide
    return virtual_recording(replace(bench, clock=late), seed=seed)


def exact(seed: int) -> tuple[VirtualRecording, Moments]:
    """A virtual recording with the true poses of the tags, and its moments."""
    virtual = made("white", seed)
    markers = replace(virtual.markers, xy=virtual.pose[..., :2], angle=virtual.pose[..., 2])
    moments = film_features(markers, PUSH_S).moments
    assert moments is not None
    return virtual, moments


def rows_of(virtual: VirtualRecording, moments: Moments) -> tuple[np.ndarray, MomentsAtRows]:
    time = np.arange(1.0, virtual.markers.time[-1] - 1.0, 0.1)
    return time, moments_at(moments, time, 1e-3)


@pytest.mark.parametrize("seed", [0, 3])
def test_turns_are_the_force_times_two_moments_of_the_levers(seed: int) -> None:
    virtual, moments = exact(seed)
    time, seen = rows_of(virtual, moments)
    force = virtual.bench.push.force(time)
    for i in range(seen.turn.shape[1]):
        design = np.stack([(seen.lever[:, j, i] * force).sum(axis=1) for j in range(2)], axis=1)
        weights = np.linalg.lstsq(design, seen.turn[:, i], rcond=None)[0]
        assert weights[0] > 0.0
        assert np.std(seen.turn[:, i] - design @ weights) < 1e-3 * moments.largest[i]


def test_force_told_by_the_turns_is_the_one_that_made_them() -> None:
    virtual, moments = exact(1)
    time, seen = rows_of(virtual, moments)
    compliance = np.array([0.7, 1.3, 2.0])[: len(moments.largest)]
    model = ForceLogModel(replace(moments, noise=1e-7 * moments.largest), compliance, 1.0)
    z = model.start(np.zeros(2))
    force = np.stack([np.cos(time), 1.0 + 0.3 * np.sin(time)], axis=1)
    turned = replace(seen, turn=np.einsum("cnk,nc->nk", model.turns_per_force(seen, z), force))
    told, spread = model.force_on_beam(turned, z)
    bent = np.linalg.norm(virtual.bench.push.force(time), axis=1) > 0.3 * virtual.bench.push.peak
    assert np.allclose(told[bent], force[bent], atol=1e-5)
    assert np.allclose(spread, spread.transpose(0, 2, 1))
    cost, slope, _ = film_misfit(model, turned.select(bent), z)
    assert cost < 1e-3 * len(time)
    assert np.abs(slope).max() < 1.0


@pytest.mark.parametrize(("size", "more"), [(0.0, 1.0), (1.0, 1.0), (5.0, 5.0)])
def test_turns_that_no_one_force_explains_have_so_much_more_noise(size: float, more: float) -> None:
    virtual, moments = exact(1)
    time, seen = rows_of(virtual, moments)
    model = ForceLogModel(moments, np.array([0.7, 1.3, 2.0])[: len(moments.largest)], 1.0)
    z = model.start(np.zeros(2))
    force = np.stack([np.cos(time), 1.0 + 0.3 * np.sin(time)], axis=1)
    lasting = np.repeat(np.random.default_rng(0).standard_normal((len(time) // 10 + 1, len(moments.noise))), 10, axis=0)
    turn = np.einsum("cnk,nc->nk", model.turns_per_force(seen, z), force) + size * moments.noise * lasting[: len(time)]
    film = replace(seen, turn=turn)
    found = with_misfit(CommonRows(moments, time, 0.1, force, film, model), z)
    assert found.model.moments is found.moments
    assert np.allclose(found.moments.noise / moments.noise, more, rtol=0.3)


def test_a_jump_is_found_and_no_other() -> None:
    time = np.linspace(0.0, 5.9, 60)
    rng = np.random.default_rng(2)
    noise = ForceNoise(white=0.003, coloured=0.004, tau=0.3, walk=1e-4)
    root = np.linalg.cholesky(covariance(noise, TimeSpans.at(time)))
    left = root @ rng.standard_normal((60, 2))
    left[25:] += np.array([0.2, -0.1])
    share = np.where((np.arange(60) >= 20) & (np.arange(60) < 32), 1.0 / 12.0, 0.0)
    nothing = np.zeros((60, 2, 2))
    rest = log_covariance(noise, TimeSpans.at(time), nothing, np.zeros(60))
    jumps = fit_jumps(left.ravel(), np.zeros((120, 1)), rest, 0.1**2 * share, 0.01**2 * share)
    assert int(np.argmax(jumps)) == 25
    assert np.sqrt(jumps[25]) > 0.08
    assert np.sqrt(np.delete(jumps, 25)).max() < 0.02
    assert not jumps[share == 0.0].any()


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


def test_shares_of_the_changes_of_the_load_are_whole() -> None:
    virtual, moments = exact(0)
    _, seen = rows_of(virtual, moments)
    assert np.isclose(load_change_share(seen).sum(), (seen.steps[-1] - seen.steps[0]).sum(), atol=1e-2)
    assert seen.steps.shape[1] == 3  # it begins, reverses, ends


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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_white_noise_is_matched_to_milliseconds(seed: int) -> None:
    error, sd = misses("white", range(seed, seed + 1))
    assert np.abs(error).max() < 0.012  # who knows the true force would miss by about 1 ms
    assert np.abs(error / sd).max() < 3.5
    assert sd.max() < 0.008


@pytest.mark.slow
@pytest.mark.parametrize("errors", ["white", "correlated"])
def test_claimed_sd_is_that_of_the_errors(errors: str) -> None:
    error, sd = misses(errors, range(8))
    # chi-square of 8 divided by 8: between 0.2 and 2.5 in 98 of 100 sets.
    assert 0.2 < np.mean((error / sd) ** 2) < 2.5
