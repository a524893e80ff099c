"""Accelerations that the tags show, and the force that the beam's mass then needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Uniform
from onebend.learning.allowances import inertial_force, tag_accelerations, unknown_mass
from onebend.learning.frames import at_frames
from onebend.records import Observations, PointMass
from tests.learning.allowances.allowed_bench import fit_course
from tests.learning.bench import SOFT, observed
from tests.made_up import with_stated

FRAMES, MASS = 30, 0.02
PULL = np.array([0.4, -3.0])  # m/s^2, of the tip
INNER = slice(3, -3)  # frames with a whole window


def falling(last: float = 1.0) -> Observations:
    """Tags at 1/3, 2/3 and `last`, accelerated in proportion to their place."""
    o = with_stated(observed(SOFT, np.zeros((FRAMES, 2))), mass=MASS)
    o = replace(o, marker_s=np.array([1.0 / 3.0, 2.0 / 3.0, last]))
    t = o.time[:, None, None]
    return replace(o, xy=0.1 + 0.3 * t + 0.5 * t**2 * o.marker_s[:, None] * PULL)


def test_accelerations_of_parabolas_are_exact() -> None:
    o = falling()
    found = tag_accelerations(o)
    assert found is not None
    expected = np.broadcast_to(o.marker_s[:, None] * PULL, found[INNER].shape)
    np.testing.assert_allclose(found[INNER], expected, rtol=1e-6, atol=1e-9)


def test_a_hidden_frame_is_bridged_a_hidden_tag_follows_its_neighbour_and_a_short_film_tells_nothing() -> None:
    o = falling()
    xy = o.xy.copy()
    xy[10, 1] = np.nan
    found = tag_accelerations(replace(o, xy=xy))
    assert found is not None
    np.testing.assert_allclose(found[20, 1], 2.0 / 3.0 * PULL, rtol=1e-6)
    long = o.xy.copy()
    long[FRAMES // 3 : 2 * FRAMES // 3, 2] = np.nan
    found = tag_accelerations(replace(o, xy=long))
    assert found is not None
    np.testing.assert_allclose(found[INNER, 2], np.broadcast_to(PULL, found[INNER, 2].shape), rtol=0.02)
    assert np.all(np.abs(found[:, 2]) <= 1.01 * np.abs(PULL))  # nor does the film end with a blow
    few = replace(o, time=o.time[:13], xy=o.xy[:13])
    assert tag_accelerations(few) is None


def test_what_rides_on_the_beam_is_accelerated_too() -> None:
    """Half a gram between two tags, on every node before it; nothing in the frame at rest."""
    o, count = falling(), FRAMES + 1
    problem = make_problem(Beam(o.length, Uniform(1.0)), push(np.zeros((count, 2)), np.full(count, 0.5)))
    force = inertial_force(o, np.ones(FRAMES, dtype=bool), problem, Uniform(0.0), count, (PointMass(0.5, 5e-4),))
    before = problem.grid.nodes < 0.5
    expected = -5e-4 * 0.5 * PULL * before[:, None]
    np.testing.assert_allclose(
        force[INNER][: FRAMES - 6], np.broadcast_to(expected, (FRAMES - 6, *expected.shape)), rtol=1e-6, atol=1e-9
    )
    assert np.all(force[-1] == 0.0)


@pytest.mark.parametrize("last", [1.0, 0.8])
def test_the_force_beyond_a_place_is_that_of_the_mass_beyond_it(last: float) -> None:
    o, count = falling(last), FRAMES + 1
    line = Uniform(MASS / o.length)
    beam = Beam(o.length, Uniform(1.0))
    problem = make_problem(beam, push(np.zeros((count, 2)), np.ones(count)))
    force = inertial_force(o, np.ones(FRAMES, dtype=bool), problem, line, count)
    s = problem.grid.nodes
    inside = 0.5 * (last**2 - np.minimum(s, last) ** 2)  # int of the acceleration over the tip's
    beyond = last * (1.0 - np.maximum(s, last))
    expected = -MASS * (inside + beyond)[:, None] * PULL
    np.testing.assert_allclose(force[15], expected, atol=2e-3 * np.max(np.abs(expected)))
    assert np.all(force[-1] == 0.0)


def test_a_mass_that_nobody_states_is_an_unknown() -> None:
    stated, frames = falling(), np.ones(FRAMES, dtype=bool)
    assert unknown_mass(fit_course(stated)) is None
    unstated = fit_course(with_stated(stated, mass=np.nan))
    one = unknown_mass(unstated)
    assert one is not None
    assert unstated.film is not None
    known = inertial_force(stated, frames, unstated.film.problem, Uniform(MASS / stated.length), FRAMES + 1)
    np.testing.assert_allclose(MASS * one.basis[..., 0], known, atol=1e-15)
    few = np.arange(FRAMES) < 13
    assert unknown_mass(fit_course(with_stated(at_frames(stated, few), mass=np.nan))) is None  # no accelerations
