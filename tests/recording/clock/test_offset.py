"""The offset between two clocks: right within what is claimed, and not claimed where the data are silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.recording import clock_features
from onebend.recording.clock import fit_clock
from onebend.recording.clock_evidence import (
    LinearModel,
    compared_rows,
    evidence_ratios,
    fit_noise,
    laid_over,
    log_evidence,
    noise_factor,
)
from onebend.recording.clock_features import GaplessMarkers, film_features, levers, turning_spans
from onebend.recording.force_noise import TimeSpans, covariance
from onebend.recording.signals import from_clamp
from onebend.records import ForceNoise
from tests.recording.pushed import Pushed, force_at, table


def turned(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@pytest.mark.parametrize(
    ("pushed", "said", "push_s"),
    [
        (Pushed(), 249.0, None),
        (Pushed(), 249.0, 1.0),
        pytest.param(Pushed(fps=25.0, seed=1), 252.1, 1.0, marks=pytest.mark.slow),
        (Pushed(fps=60.0, seed=2), 250.3, None),
        (Pushed(rate=100.0, bias=(3.0, -2.0), seed=3), 251.0, None),
        pytest.param(Pushed(rise=1.0, seed=4), 248.5, 1.0, marks=pytest.mark.slow),
        (Pushed(before=6.0, after=5.0, seed=5), 253.5, None),  # said is off by more than its uncertainty
    ],
)
def test_found_within_its_sd(pushed: Pushed, said: float, push_s: float | None) -> None:
    found = fit_clock(pushed.markers(jitter=0.5), pushed.log(), said, 2.0, push_s=push_s).clock
    assert found.found
    assert found.stated == said
    assert found.sd < 0.05
    assert abs(found.offset - pushed.offset) < min(3.5 * found.sd, 0.05)


@pytest.mark.slow
def test_claimed_sd_covers() -> None:
    misses = []
    for seed in range(8):
        pushed = Pushed(seed=10 + seed)
        found = fit_clock(pushed.markers(), pushed.log(), 250.0, 2.0).clock
        misses.append((found.offset - pushed.offset) / found.sd)
    # chi-square of 8: between 2.0 and 20 in 98 of 100 sets; the noise's sizes are estimated too, hence a little more.
    assert 1.0 < np.sum(np.square(misses)) < 28.0


@pytest.mark.slow
@pytest.mark.parametrize("turn", [np.pi, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.5, -2.0))])
def test_sign_and_axes_of_the_log_do_not_matter_to_polynomials(turn: float) -> None:
    pushed = Pushed(seed=20)
    log = pushed.log()
    plain = fit_clock(pushed.markers(), log, 250.0, 2.0).clock
    other = fit_clock(pushed.markers(), replace(log, force=log.force @ turned(turn).T), 250.0, 2.0).clock
    assert abs(other.offset - plain.offset) < 0.5 * plain.sd


@pytest.mark.slow
def test_sign_does_not_matter_to_levers() -> None:
    pushed = Pushed(seed=20)
    log = pushed.log()
    plain = fit_clock(pushed.markers(), log, 250.0, 2.0, push_s=1.0).clock
    other = fit_clock(pushed.markers(), replace(log, force=-log.force), 250.0, 2.0, push_s=1.0).clock
    assert abs(other.offset - plain.offset) < 0.5 * plain.sd


@pytest.mark.slow
def test_dropouts_and_hidden_tags_are_survived() -> None:
    pushed = Pushed(seed=21)
    log, markers = pushed.log(), pushed.markers()
    since = log.time - pushed.offset
    kept = ~((since > 2.3) & (since < 2.8))
    xy, angle = markers.xy.copy(), markers.angle.copy()
    hidden = (markers.time > 4.8) & (markers.time < 5.8)
    xy[hidden, 2], angle[hidden, 2] = np.nan, np.nan
    xy[40, 0], angle[40, 0] = np.nan, np.nan
    torn = replace(log, time=log.time[kept], force=log.force[kept])
    found = fit_clock(replace(markers, xy=xy, angle=angle), torn, 249.0, 2.0).clock
    assert found.found
    assert abs(found.offset - pushed.offset) < min(3.5 * found.sd, 0.06)


@pytest.mark.slow
@pytest.mark.parametrize("thinned", [8, 40])
def test_a_slow_log_has_no_bias(thinned: int) -> None:
    pushed = Pushed(white=0.002, coloured=0.001, seed=26)
    log = pushed.log()
    thin = replace(log, time=log.time[::thinned], force=log.force[::thinned])
    found = fit_clock(pushed.markers(), thin, 250.0, 2.0).clock
    assert abs(found.offset - pushed.offset) < min(3.5 * found.sd, 0.015)


def test_no_motion_and_no_force_find_nothing() -> None:
    pushed = Pushed(seed=22)
    markers, log = pushed.markers(), pushed.log()
    shiver = 1e-5 * np.random.default_rng(1).standard_normal(markers.xy.shape)
    still = replace(markers, xy=np.repeat(markers.xy[:1], len(markers.time), axis=0) + shiver)
    for seen, written in ((still, log), (markers, replace(log, force=np.zeros_like(log.force)))):
        fit = fit_clock(seen, written, 249.0, 2.0)
        assert not fit.clock.found
        assert fit.clock.offset == 249.0
        assert fit.clock.sd > 0.5
        assert fit.remarks


def test_force_without_relation_is_not_matched_closely() -> None:
    pushed = Pushed(seed=23)
    log = pushed.log()
    noise = 0.3 * np.random.default_rng(0).standard_normal(log.force.shape)
    found = fit_clock(pushed.markers(), replace(log, force=noise), 249.0, 2.0).clock
    assert not found.found or found.sd > 0.2


def test_without_a_said_time_the_whole_overlap_is_searched() -> None:
    pushed = Pushed(before=5.0, after=3.0, seed=24)
    found = fit_clock(pushed.markers(), pushed.log(), np.nan, np.inf).clock
    assert found.found
    assert abs(found.offset - pushed.offset) < min(3.5 * found.sd, 0.05)


def test_push_in_one_direction_claims_less() -> None:
    both = Pushed(seed=25, film=8.0)
    one = replace(both, film=4.2, after=0.2)
    sds = [fit_clock(each.markers(), each.log(), 250.0, 2.0).clock.sd for each in (both, one)]
    assert sds[1] > 1.3 * sds[0]


def test_evidence_is_that_of_a_normal_distribution() -> None:
    rng = np.random.default_rng(3)
    time = np.sort(rng.uniform(0.0, 4.0, 12))
    own, pairs, values = rng.standard_normal((12, 2)), rng.standard_normal((12, 2, 3)), rng.standard_normal((12, 2))
    noise = ForceNoise(white=0.4, coloured=0.7, tau=0.5, walk=0.3)
    whole = np.kron(np.eye(2), covariance(noise, TimeSpans.at(time)))
    x = np.hstack([np.kron(np.eye(2), own), pairs.transpose(1, 0, 2).reshape(24, 3)])
    whole = whole + x @ x.T
    y = values.T.reshape(24)
    direct = -0.5 * (y @ np.linalg.solve(whole, y)) - 0.5 * np.linalg.slogdet(whole)[1]
    model = LinearModel(np.hstack([own, pairs.reshape(12, 6)]), 2, values)
    assert np.isclose(log_evidence(noise_factor(noise, time), model), direct, rtol=1e-9)


@pytest.mark.parametrize("white", [1e-3, 1.0])
def test_banded_covariance_is_the_dense_one(white: float) -> None:
    """Of many rows, unevenly spaced, with a second walk that stands still at times."""
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.01, 0.2, 200))
    walked = np.cumsum(np.maximum(rng.standard_normal(200), 0.0))
    noise = ForceNoise(white=white, coloured=0.7, tau=0.5, walk=0.3)
    columns = rng.standard_normal((200, 5))
    dense = covariance(noise, TimeSpans.at(time)) + np.minimum(walked[:, None], walked) - walked[0]
    direct = columns.T @ np.linalg.solve(dense, columns)
    factor = noise_factor(noise, time, walked)
    np.testing.assert_allclose(factor.inner(columns), direct, rtol=1e-8, atol=1e-9 * np.abs(direct).max())
    assert factor.log_root == pytest.approx(0.5 * np.linalg.slogdet(dense)[1], rel=1e-10)


@pytest.mark.slow
def test_film_of_very_many_frames_is_thinned_and_tells_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    pushed = Pushed(seed=25, film=8.0)
    markers = pushed.markers()
    whole = fit_clock(markers, pushed.log(), 250.0, 2.0).clock
    monkeypatch.setattr(clock_features, "MOST_FRAMES", len(markers.time) // 2 + 1)
    fewer = fit_clock(markers, pushed.log(), 250.0, 2.0).clock
    for clock in (whole, fewer):
        assert clock.offset == pytest.approx(pushed.offset, abs=2.5 * clock.sd)
    assert fewer.sd == pytest.approx(whole.sd, rel=0.5)


def test_noise_is_recovered() -> None:
    pushed = Pushed(film=25.0, white=0.01, coloured=0.02, tau=0.3, rate=15.0)
    log = pushed.log()
    values = log.force - pushed.true_force(log.time - pushed.offset)
    model = LinearModel(np.ones((len(log.time), 1)), 1, values)
    found = fit_noise(log.time, model, ForceNoise(0.02, 0.01, 0.2, 0.01))
    assert found.white == pytest.approx(0.01, rel=0.3)
    assert found.coloured == pytest.approx(0.02, rel=0.4)
    assert found.tau == pytest.approx(0.3, rel=0.6)


def test_two_noises_are_compared_over_the_same_model_without_the_film() -> None:
    pushed = Pushed(seed=3)
    film, log = film_features(pushed.markers(), None), pushed.log()
    rows = compared_rows(film, log, (pushed.offset, pushed.offset))
    assert rows is not None
    laid = laid_over(film.tracks[0], rows, np.array([pushed.offset]))
    assert laid[0] is not None
    small, large = (ForceNoise(white=w, coloured=w, tau=0.3, walk=0.1 * w) for w in (0.001, 0.1))
    ratios = [evidence_ratios(laid, rows, noise)[0] for noise in (small, large)]
    alone = [log_evidence(noise_factor(noise, rows.time[laid[0].use]), laid[0].model) for noise in (small, large)]
    assert ratios[0] - ratios[1] == pytest.approx(alone[0] - alone[1], abs=1e-6)


def test_filtered_share_of_the_coloured_noise() -> None:
    noise = ForceNoise(white=1.0, coloured=0.1, tau=0.2, walk=0.0)
    assert noise.passed(np.inf) == pytest.approx(0.1)
    assert noise.passed(1 / (2 * np.pi * 0.2)) == pytest.approx(0.1 / np.sqrt(2))  # half the power below the corner


def test_levers_hold_the_true_force() -> None:
    part, xy, angle = table()
    places, seen = from_clamp(np.array([1 / 3, 2 / 3, 1.0]), xy, angle), np.ones(len(xy), dtype=bool)
    features = levers(turning_spans(GaplessMarkers(np.arange(len(xy)) / 30.0, *places, seen, 0.0, 0.0), 1.0))
    force = force_at(part)
    flat = features.reshape(-1, features.shape[-1])
    told = flat @ np.linalg.lstsq(flat, force.reshape(-1), rcond=None)[0]
    # Three stiffnesses and where they sit explain both components of every force to a few per cent.
    assert np.sqrt(np.mean((told - force.reshape(-1)) ** 2)) < 0.03 * np.abs(force).max()
