"""Neighbouring frames are averaged where they show the same, and nowhere else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from onebend.learning import condensed as condensing, posterior
from onebend.learning.condensed import (
    EACH_PUSH,
    averaged,
    condensed,
    mean_variance,
    second_differences,
    white_share,
    windows_of,
    worth,
)
from onebend.learning.frames import learnable_frames
from onebend.learning.posterior import fit
from onebend.records import Array, Observations
from tests.learning.bench import IDEAL, SOFT, forces, observed
from tests.made_up import with_source

NOISE = (2e-5, 1e-3)
S = np.linspace(0.1, 0.9, 33)


def pushed(count: int = 400, seed: int = 0) -> Observations:
    return observed(SOFT, forces(count), noise=NOISE, seed=seed)


def test_means_of_neighbours_give_the_posterior_of_all_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = pushed()
    settings = replace(IDEAL, functions=16)
    few = fit([seen], 0.02, settings=settings)
    monkeypatch.setattr(posterior, "condensed", lambda o: o)
    monkeypatch.setattr(condensing, "worth", lambda o: len(o.time))
    every = fit([seen], 0.02, settings=settings)
    counts = [int(np.sum(one.recordings[0].frames)) for one in (few, every)]
    assert counts[0] <= EACH_PUSH < counts[1] == len(seen.time)
    one, other = few.band(S), every.band(S)
    sd = np.log(other.high / other.low) / (2.0 * 1.96)
    assert np.all(np.abs(np.log(one.k / other.k)) < 0.3 * sd)
    np.testing.assert_allclose(np.log(one.high / one.low), np.log(other.high / other.low), rtol=0.15)


def test_the_covariance_of_a_mean_is_that_of_simulated_noise() -> None:
    rng, seen, count = np.random.default_rng(1), pushed(4000), 5
    white, slow = 2e-5, 3e-5
    lasting = np.repeat(rng.normal(size=(100, 3, 2)), 40, axis=0)
    noise = white * rng.normal(size=seen.xy.shape) + slow * lasting
    still = np.zeros_like(seen.angle)
    sd = np.array([np.hypot(white, slow), np.hypot(white, slow), 1e-3])
    angle = still + np.sqrt(1.0 / (1.0 + (slow / white) ** 2)) * 1e-3 * rng.normal(size=still.shape)
    one = replace(seen, xy=noise, angle=angle, covariance=np.tile(np.diag(sd**2), (*still.shape, 1, 1)))
    windows = list(np.arange(4000).reshape(-1, count))
    found = averaged(one, [windows])
    expected = slow**2 + white**2 / count
    np.testing.assert_allclose(np.mean(found.xy**2), expected, rtol=0.2)
    np.testing.assert_allclose(found.covariance[..., 0, 0], expected, rtol=0.05)


def test_the_mean_of_a_tag_that_was_seen_less_often_is_less_exact() -> None:
    assert np.allclose(mean_variance(np.array([1.0, 0.5, 0.0]), np.array([4.0, 4.0, 4.0])), [0.25, 0.625, 1.0])
    seen = pushed()
    hidden = replace(seen, xy=seen.xy.copy(), covariance=seen.covariance.copy())
    hidden.xy[1::2, 0] = np.nan
    hidden.covariance[1::2, 0] = np.nan
    windows = list(np.arange(400).reshape(-1, 4))
    whole, part = averaged(seen, [windows]), averaged(hidden, [windows])
    share = part.covariance[:, 0, 0, 0] / whole.covariance[:, 0, 0, 0]
    assert np.all(share > 1.5)
    np.testing.assert_allclose(part.xy[2:-2, 0], whole.xy[2:-2, 0], atol=1e-4)  # at the mean instant of all frames


def test_no_mean_is_of_more_frames_than_show_a_tag() -> None:
    seen = observed(SOFT, forces(150), noise=(1e-9, 1e-7))
    hidden = replace(seen, xy=seen.xy.copy(), angle=seen.angle.copy(), covariance=seen.covariance.copy())
    for values in (hidden.xy, hidden.angle, hidden.covariance):
        values[31:122, -1] = np.nan
    found = condensed(hidden)
    assert len(found.time) < 100
    shown = np.isfinite(found.xy[:, -1, 0])
    np.testing.assert_array_equal(shown, (found.time < seen.time[31]) | (found.time > seen.time[121]))
    true = CubicSpline(seen.time, seen.xy[:, -1])(found.time)
    force = CubicSpline(seen.time, seen.force)(found.time)
    np.testing.assert_allclose(found.force, force, atol=1e-3 * np.max(force))
    np.testing.assert_allclose(found.xy[shown, -1], true[shown], atol=1e-3 * np.ptp(true))


def test_an_outline_that_is_read_in_few_frames_counts_in_every_window() -> None:
    seen = pushed()
    rare = replace(seen, xy=seen.xy.copy(), covariance=seen.covariance.copy(), traced=np.arange(3) == 2)
    for values in (rare.xy, rare.covariance):
        values[np.arange(400) % 3 > 0, 2] = np.nan
    found = condensed(rare)
    assert len(found.time) <= EACH_PUSH
    assert np.mean(np.isfinite(found.xy[:, 2, 0])) > 0.9
    assert found.means is not None
    assert found.means.acceleration is not None
    assert np.all(np.any(found.means.acceleration[5:-5, 2] != 0.0, axis=1))


def test_third_differences_tell_the_white_share() -> None:
    seen = pushed()
    poses = np.concatenate([seen.xy, seen.angle[..., None]], axis=-1)
    np.testing.assert_allclose(white_share(seen, poses), 1.0, atol=0.2)
    quieter = replace(seen, covariance=4.0 * seen.covariance)
    np.testing.assert_allclose(white_share(quieter, poses), 0.25, atol=0.06)


def test_second_derivatives_stop_at_kinks() -> None:
    time = np.sort(np.random.default_rng(0).uniform(0.0, 1.0, 30))
    part = (time > 0.4).astype(np.int64)
    values = np.where(part[:, None] == 0, 3.0 * time[:, None] ** 2, 7.0 - time[:, None] ** 2)
    np.testing.assert_allclose(second_differences(time, values, part)[:, 0], np.where(part == 0, 6.0, -2.0))
    assert not np.any(second_differences(time, values, np.arange(30)))


def test_no_window_crosses_a_kink() -> None:
    seen = pushed()
    size = np.linalg.norm(seen.xy - seen.rest_xy, axis=(1, 2))
    turn, gap = int(np.argmax(size)), 77
    moved = replace(seen, push_s=np.where(np.arange(400) < 301, 1.0, 0.9))
    learnable = learnable_frames(moved)
    learnable[gap] = False
    windows = [window for part in windows_of(moved, learnable) for window in part]
    together = np.concatenate(windows)
    np.testing.assert_array_equal(together, np.flatnonzero(learnable))
    for window in windows:
        assert np.all(np.diff(window) == 1)
        assert len({bool(i < 301) for i in window}) == 1
        assert window[-1] < turn + 2 or window[0] >= turn - 2
        assert np.ptp(size[window]) < 0.1 * np.max(size)


def test_what_is_no_film_of_many_frames_stays_as_it_is() -> None:
    seen = pushed(400)
    assert condensed(replace(seen, static=True)).xy is seen.xy
    held = replace(seen, held=np.arange(400) == 5)
    assert condensed(held).xy is seen.xy
    short = pushed(40)
    assert condensed(short).xy is short.xy


def test_every_push_is_worth_as_many_frames() -> None:
    one, poses = pushed(400), replace(pushed(40), static=True)
    twice: dict[str, Any] = {
        name: np.concatenate([getattr(one, name)] * 2)
        for name in ("frame", "xy", "angle", "covariance", "force", "push_s", "loaded", "gravity")
    }
    again = replace(one, time=np.concatenate([one.time, one.time[-1] + one.time + 0.01]), **twice)
    assert (worth(one), worth(again), worth(poses)) == (EACH_PUSH, 2 * EACH_PUSH, 40)
    assert 0.8 * EACH_PUSH < len(condensed(one).time) <= EACH_PUSH


def test_frames_whose_force_is_not_known_are_never_learned_from() -> None:
    seen = pushed(400)
    force: Array = seen.force.copy()
    force[100:110] = np.nan
    small = condensed(with_source(replace(seen, force=force), name="gap"))
    assert np.sum(~np.isfinite(small.force[:, 0])) == 10
    assert learnable_frames(small).sum() == len(small.time) - 10
