"""The force over time: smoothed where asked for, and when a contact begins and ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from onebend.beam.loads import push
from onebend.learning.endings import Edge
from onebend.learning.sensing.contacts import _backward, _filtered
from onebend.learning.sensing.forces import TOUCH, FrameForces
from onebend.learning.sensing.sense import Sensed, SenseSettings, Touch, joined, sense
from onebend.records import Array
from tests.learning.bench import SOFT, observed
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off
from tests.learning.sensing.test_sense import exact

SMOOTH = SenseSettings(smooth=True)


def pushed(seed: int, count: int = 60) -> tuple[Array, float, float]:
    """(T, 2) N of a push that begins smoothly, with a kink or at once; and when it begins and ends."""
    rng, time = np.random.default_rng([seed, 9]), np.arange(count) / 30.0
    begin, end = rng.uniform(0.4, 0.6), rng.uniform(1.4, 1.6)
    way = np.clip((time - begin) / (end - begin), 0.0, 1.0)
    on = (way > 0.0) & (way < 1.0)
    shape = (np.sin(np.pi * way) ** 2, np.sin(np.pi * way), 0.7 + 0.3 * np.sin(6.0 * time))[seed % 3]
    turn = rng.uniform(0.9, 2.2) + 0.3 * np.sin(2.0 * time)
    size = rng.uniform(0.1, 0.3) * shape * on
    return size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1), begin, end


def told(seed: int, noise: tuple[float, float] = (8e-5, 3e-3)) -> tuple[Sensed, Array, float, float]:
    """What is told of such a push with all that is unknown drawn, and the true force."""
    force, begin, end = pushed(seed)
    o, axes = drawn(seed, push(force, 0.9 + place_off(seed)), noise=noise)
    return sense(BEAM, o, stiffness=BAND, settings=SMOOTH), force @ axes.T, begin, end


def test_a_smooth_process_is_as_normal_densities_say() -> None:
    rng, count, memory = np.random.default_rng(0), 12, 0.4
    time = np.sort(rng.uniform(0.0, 1.0, count))
    weigh, common = rng.normal(size=(count, 2, 2)), rng.normal(size=(count, 2, 3))
    read = FrameForces(time, weigh, rng.normal(size=(count, 2)), common, 1.0)
    _, evidence = _filtered(read, 0.7, np.array([2.0, memory]))
    force, covariance = _backward(_filtered(read, 0.7, np.array([memory]))[0])
    lag = np.sqrt(5.0) * np.abs(time[:, None] - time) / memory
    prior = np.kron(0.7**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag), np.eye(2))
    rows = block_diag(*weigh)
    own = np.linalg.inv(np.linalg.inv(prior) + rows.T @ rows)
    by_shared = own @ rows.T @ common.reshape(-1, 3)
    whole = own + by_shared @ by_shared.T
    np.testing.assert_allclose(force.ravel(), own @ rows.T @ read.told.ravel(), atol=1e-9)
    for t in range(count):
        here = slice(2 * t, 2 * t + 2)
        np.testing.assert_allclose(covariance[t], whole[here, here], atol=1e-9)
    seen = rows @ prior @ rows.T + np.eye(2 * count)
    expected = read.told.ravel() @ np.linalg.solve(seen, read.told.ravel()) + np.linalg.slogdet(seen)[1]
    assert -2.0 * evidence[1] == pytest.approx(expected, rel=1e-9)


def test_noise_free_shapes_give_a_smooth_force_and_its_begin_back() -> None:
    force, begin, end = pushed(1)
    o = exact(observed(SOFT, force))
    o = replace(o, covariance=1e-6 * o.covariance, rest_covariance=1e-6 * o.rest_covariance)
    found = sense(SOFT, o, settings=SMOOTH)
    assert found.smoothed is not None
    strong = np.hypot(*force.T) > 0.05
    np.testing.assert_allclose(found.smoothed.force[strong], force[strong], atol=1e-6)
    (one,) = found.contacts
    assert one.begin.time == pytest.approx(begin, abs=2e-3)
    assert one.end.time == pytest.approx(end, abs=2e-3)


def test_a_smooth_force_is_surer_than_that_of_each_frame_but_for_what_all_share() -> None:
    found, true, begin, end = told(4)
    assert found.smoothed is not None
    inside = np.hypot(*true.T) > 0.03
    alone, smooth = (np.linalg.eigvalsh(c[inside]) for c in (found.covariance, found.smoothed.covariance))
    assert np.median(smooth[:, 1]) < 0.5 * np.median(alone[:, 1])
    by_gain = BAND.gain_sd * np.abs(true[inside])  # k's common scale is the force's
    assert np.all(np.sqrt(np.einsum("tcc->tc", found.smoothed.covariance)[inside]) > 0.9 * by_gain)
    (one,) = found.contacts
    assert abs(one.begin.time - begin) < 4.0 * one.begin.sd < 0.1
    assert abs(one.end.time - end) < 4.0 * one.end.sd < 0.1


def test_a_contact_from_before_the_film_has_no_begin() -> None:
    force = pushed(1)[0][30:]
    o, _ = drawn(1, push(force, 0.9))
    (one,) = sense(BEAM, o, stiffness=BAND).contacts
    assert np.isnan(one.begin.time)
    assert np.isinf(one.begin.sd)
    assert one.end.sd < 0.05


@pytest.mark.slow
def test_smooth_regions_and_times_hold_the_truth() -> None:
    hits, away = [], []
    for seed in range(90):
        found, true, begin, end = told(seed)
        assert found.smoothed is not None
        inside = np.hypot(*true.T) > 0.0
        error = (found.smoothed.force - true)[inside]
        inner = np.linalg.inv(found.smoothed.covariance[inside])
        hits.append(np.mean(np.einsum("tc,tcd,td->t", error, inner, error) < TOUCH))
        assert len(found.contacts) == 1
        one = found.contacts[0]
        away += [(one.begin.time - begin) / one.begin.sd, (one.end.time - end) / one.end.sd]
    assert 0.91 < np.mean(hits) < 0.985  # 90 runs tell it to 0.02
    assert 0.88 < np.mean(np.abs(away) < 1.96) <= 1.0


def test_contacts_that_overlap_are_one() -> None:
    unknown = Edge(np.nan, np.inf)
    first, second = Touch(1.0, 2.0, Edge(0.9, 0.01), Edge(2.2, 0.01)), Touch(2.3, 3.0, Edge(2.1, 0.01), unknown)
    assert joined([first, second]) == (Touch(1.0, 3.0, first.begin, unknown),)
    apart = replace(second, begin=Edge(2.25, 0.01))
    assert joined([first, apart]) == (first, apart)


def test_the_largest_force_is_one_that_is_sure() -> None:
    o = exact(observed(SOFT, np.outer(np.linspace(0.05, 0.2, 12), [0.0, 1.0])))
    found = sense(SOFT, o)
    assert found.peak == 11
    force, covariance = found.force.copy(), found.covariance.copy()
    force[5], covariance[5] = (3.0, 0.1), np.diag([4.0, 1e-4])  # of the direction that no shape shows
    assert replace(found, force=force, covariance=covariance).peak == 11
