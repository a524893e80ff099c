"""Parts of the live learner against what the fit does: the load's own time, and the sizes in log k's prior."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.force_error import ANEW, RELEASED
from onebend.learning.live_sizes import OfK, Sizes
from onebend.learning.live_stages import LoadStages
from onebend.learning.roughness import Draws, Told, mixed
from onebend.learning.spline import Spline
from onebend.recording.load_stages import load_changes


def test_the_loads_own_time_is_the_whole_recordings() -> None:
    """Two pushes, one with a small give that is no reversal and one with a reversal that is."""
    way = [0.0] * 9 + [*np.linspace(0.001, 0.04, 40), *np.linspace(0.0395, 0.0385, 5), *np.linspace(0.039, 0.05, 20)]
    way += [*np.linspace(0.0495, 0.02, 30), *np.linspace(0.0205, 0.04, 25), *np.linspace(0.039, 0.001, 30)] + [0.0] * 12
    size = np.array(way)
    time, loaded = np.arange(len(size)) / 30.0, size > 0.0
    stages, seen = LoadStages(0.15, 1), np.array([True])
    for t, d, on in zip(time, size, loaded, strict=True):
        stages.see(float(t), np.array([[0.0, d]]), seen, bool(on))
    changes = load_changes(time, size, loaded)
    assert sum(one.release for one in changes) == 1
    whole = np.sum([(RELEASED if one.release else ANEW) * one.part(time) for one in changes], axis=0)
    late = time > 0.5  # the largest displacement was not known from the start
    np.testing.assert_allclose(stages.own(time)[late], whole[late], atol=0.35)
    assert np.mean(np.abs(stages.own(time) - whole)) < 0.05


def test_what_a_load_did_long_ago_is_kept() -> None:
    stages, seen, own = LoadStages(0.15, 1), np.array([True]), 0.0
    for t in range(400):
        d = 0.04 * abs(np.sin(2.0 * np.pi * t / 40.0))
        stages.see(t / 30.0, np.array([[0.0, d]]), seen, d > 0.002)
        own += stages.forgotten(np.zeros(1))[1]
    assert own + stages.own(np.array([400 / 30.0]))[0] == pytest.approx(20 * ANEW * 2 + 20 * RELEASED, rel=0.05)


def test_sizes_drawn_on_the_way_give_the_fits_log_k() -> None:
    """Against `roughness.mixed`, whose chains are many."""
    spline, rng = Spline(10), np.random.default_rng(3)
    truth = np.where(np.arange(10) < 5, 0.0, 0.4)
    rows = 15.0 * rng.normal(size=(12, 10))
    told = OfK(rows.T @ rows, rows.T @ (rows @ truth + rng.normal(size=12)))
    sizes = Sizes(spline, 0.0, 3.0, 0.1)
    for _ in range(400):
        sizes.step(told)
    means, sds = [], []
    for _ in range(20):
        for _ in range(20):
            sizes.step(told)
        mean, covariance, _ = sizes.mixed(told)
        means.append(mean)
        sds.append(np.sqrt(np.diag(covariance)))
    batch = mixed(spline, [Told(told.information, told.b)], 0.0, Draws(30, 60, 300))
    sd = np.sqrt(np.diag(batch.covariance))
    np.testing.assert_allclose(np.mean(means, axis=0), batch.mean, atol=0.2 * float(np.max(sd)))
    np.testing.assert_allclose(np.mean(sds, axis=0), sd, rtol=0.2)
