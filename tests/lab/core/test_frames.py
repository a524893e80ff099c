"""Frames that the force's low-pass has bent are not learned from."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, VirtualClock, observe_virtual, virtual_recording
from onebend.learning.frames import learnable_frames, usable_frames, with_seen_tags
from onebend.learning.posterior import fit
from onebend.records import Observations
from tests.learning.bench import IDEAL
from tests.made_up import with_source

pytestmark = pytest.mark.usefixtures("no_other_places")

SOFT = Beam(0.15, Powers((0.02, 0.03)))
PEAK = force_that_bends(SOFT, 1.0, 1.75)


@cache
def pushed(fall: float, *, noise: float = 0.02) -> Observations:
    """Held for a while, then let go within `fall` [s]."""
    sensor = ForceSensor(white_sd=noise * PEAK, coloured_sd=noise * PEAK)
    push = PushProfile(PEAK, hold=1.5, fall=fall, after=1.5)
    bench = VirtualBench(beam=SOFT, push=push, sensor=sensor, fps=30.0, clock=VirtualClock(uncertainty=0.0))
    return observe_virtual(virtual_recording(bench, seed=2))


@pytest.mark.slow
def test_of_a_slow_push_every_usable_frame_is_learned_from() -> None:
    seen = pushed(2.0)
    np.testing.assert_array_equal(learnable_frames(seen), usable_frames(seen))


@pytest.mark.slow
def test_a_sudden_release_takes_the_frames_beside_it() -> None:
    seen = pushed(0.03)
    usable, learned = usable_frames(seen), learnable_frames(seen)
    left_out = seen.time[usable & ~learned]
    release = seen.time[usable][-1]
    assert seen.source.clean_force is not None
    assert 2 <= len(left_out) < 0.2 * usable.sum()
    assert np.all(left_out > release - 2.0 / seen.source.clean_force.cutoff)
    assert not learned[usable][-1]


def test_without_a_filter_or_where_little_would_be_left_all_are_used() -> None:
    seen = pushed(0.03)
    assert seen.source.clean_force is not None
    raw = with_source(seen, clean_force=replace(seen.source.clean_force, cutoff=np.inf))
    np.testing.assert_array_equal(learnable_frames(raw), usable_frames(raw))
    late = replace(seen, loaded=seen.loaded & (seen.time > seen.time[usable_frames(seen)][-1] - 0.1))
    np.testing.assert_array_equal(learnable_frames(late), usable_frames(late))
    np.testing.assert_array_equal(learnable_frames(with_source(seen, clean_force=None)), usable_frames(seen))


@pytest.mark.slow
@pytest.mark.parametrize("fall", [0.03, pytest.param(0.3, marks=pytest.mark.slow)])
def test_a_beam_that_is_let_go_is_learned_as_well_as_one_led_back(fall: float) -> None:
    found = fit([pushed(fall)], 0.03, settings=replace(IDEAL, functions=16, most_frames=120))
    s = np.linspace(0.1, 0.8, 15)
    band, true = found.band(s), SOFT.stiffness(s)
    assert np.max(np.abs(np.log(band.k / true))) < 0.1
    assert np.mean((band.low < true) & (true < band.high)) > 0.9


def test_a_tag_that_no_recording_shows_is_left_out() -> None:
    one = pushed(2.0)
    hidden = replace(one, xy=np.where(np.arange(3)[:, None] == 1, np.nan, one.xy))
    (left,) = with_seen_tags([hidden])
    assert left.tag_id.tolist() == [1, 3]
    np.testing.assert_array_equal(left.xy, one.xy[:, [0, 2]])
    np.testing.assert_array_equal(left.rest_covariance, one.rest_covariance[[0, 2]])
    both = with_seen_tags([hidden, one])  # one of them shows it
    assert [len(o.tag_id) for o in both] == [3, 3]
