"""When a contact begins and ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.loads import push
from onebend.learning.sensing.contacts import Edge
from onebend.learning.sensing.sense import Sensed, Touch, joined, sense
from onebend.records import Array
from tests.learning.bench import SOFT, observed
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off
from tests.learning.sensing.test_sense import exact


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


def told(seed: int, noise: tuple[float, float] = (8e-5, 3e-3)) -> tuple[Sensed, float, float]:
    """What is told of such a push with all that is unknown drawn, and when it begins and ends."""
    force, begin, end = pushed(seed)
    o, _ = drawn(seed, push(force, 0.9 + place_off(seed)), noise=noise)
    return sense(BEAM, o, stiffness=BAND), begin, end


def test_noise_free_shapes_give_begin_and_end_back() -> None:
    force, begin, end = pushed(1)
    o = exact(observed(SOFT, force))
    o = replace(o, covariance=1e-6 * o.covariance, rest_covariance=1e-6 * o.rest_covariance)
    (one,) = sense(SOFT, o).contacts
    assert one.begin.time == pytest.approx(begin, abs=2e-3)
    assert one.end.time == pytest.approx(end, abs=2e-3)


def test_begin_and_end_are_told_with_their_sds() -> None:
    found, begin, end = told(4)
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
def test_times_hold_the_truth() -> None:
    away = []
    for seed in range(90):
        found, begin, end = told(seed)
        (one,) = found.contacts
        away += [(one.begin.time - begin) / one.begin.sd, (one.end.time - end) / one.end.sd]
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
