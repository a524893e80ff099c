"""Frame by frame: the same force as in the whole recording, where each frame stands alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.sensing.forces import estimate
from onebend.learning.sensing.sense import LiveForce, OnlineSense, SenseSettings, bench_of, priors_of
from onebend.records import Observations
from tests.learning.bench import SOFT, forces, observed

KNOWN, SOUGHT = SenseSettings(), SenseSettings(place="unknown")


def followed(o: Observations, settings: SenseSettings) -> list[LiveForce]:
    """Every frame, one after the other."""
    live = OnlineSense(SOFT, o, settings=settings)
    return [live.add(*frame) for frame in zip(o.time, o.xy, o.angle, o.covariance, strict=True)]


def test_live_frames_are_as_those_of_a_recording_each_by_itself() -> None:
    o = observed(SOFT, forces(12), noise=(3e-5, 1e-3))
    frames = np.arange(12)
    bench = bench_of(SOFT, o, None, None, KNOWN)
    alone = estimate(bench, frames, o.push_s, priors_of(SOFT, KNOWN), seek_place=False)
    for t, one in enumerate(followed(o, KNOWN)):
        away = one.force - bench.axes @ alone.force[t]
        assert away @ np.linalg.solve(one.covariance, away) < 0.2
        np.testing.assert_allclose(one.covariance, bench.axes @ alone.covariance[t] @ bench.axes.T, rtol=0.3, atol=1e-6)
        assert one.touched


def test_a_place_that_is_sought_is_followed() -> None:
    o = observed(SOFT, forces(10), at_s=0.72, noise=(2e-5, 1e-3))
    found = followed(o, SOUGHT)
    strong = [one for one in found if np.hypot(*one.force) > 0.1]
    assert len(strong) > 3
    assert all(abs(one.place - 0.72) < max(3.0 * one.place_sd, 0.01) for one in strong)


def test_the_grids_of_single_frames_that_are_kept_are_bounded_and_serve_again() -> None:
    o = observed(SOFT, forces(2), noise=(2e-5, 1e-3))
    bench, one = bench_of(SOFT, o, None, None, KNOWN), np.array([0])
    for place in np.linspace(0.3, 0.9, 200):
        last = bench.at(one, np.array([place]))
    assert len(bench.memory.made) < 50
    assert bench.at(one, np.array([0.9])).problem is last.problem


def test_a_frame_that_shows_nothing_tells_nothing_and_the_next_one_does() -> None:
    o = observed(SOFT, forces(4), noise=(3e-5, 1e-3))
    xy = o.xy.copy()
    xy[1] = np.nan
    found = followed(replace(o, xy=xy), KNOWN)
    assert np.isnan(found[1].force).all()
    assert not found[1].touched
    assert found[2].touched


def test_a_beam_left_alone_is_not_touched() -> None:
    found = followed(observed(SOFT, np.zeros((3, 2)), noise=(2e-5, 1e-3)), KNOWN)
    assert not any(one.touched for one in found)
    assert found[-1].covariance[0, 0] == pytest.approx(priors_of(SOFT, KNOWN)[0] ** 2, rel=0.1)


def test_a_shape_that_no_force_explains_tells_none_and_the_next_frame_does() -> None:
    """The tip alone is a third of the beam away."""
    o = observed(SOFT, forces(4), noise=(3e-5, 1e-3))
    xy = o.xy.copy()
    xy[1, 2] += [0.0, 0.05]
    found = followed(replace(o, xy=xy), KNOWN)
    assert np.isnan(found[1].force).all()
    assert found[1].chi2 > 20.0 * 9
    assert not found[1].touched
    assert found[2].touched
