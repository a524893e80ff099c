"""Random beams: positive, within their range, the same for the same seed; and forces that bend them as asked."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Steps, Uniform
from onebend.lab.designs import LARGEST_RATIO, Kind, force_that_bends, random_stiffness

S = np.linspace(0.0, 1.0, 801)


@pytest.mark.parametrize("kind", ["smooth", "stepped", "joint"])
def test_drawn_stiffness_is_positive_and_repeats(kind: Kind) -> None:
    for seed in range(40):
        k = np.asarray(random_stiffness(kind, np.random.default_rng(seed))(S))
        assert np.all(np.isfinite(k))
        assert np.min(k) > 1e-3
        np.testing.assert_array_equal(k, random_stiffness(kind, np.random.default_rng(seed))(S))


def test_smooth_beams_fill_their_range() -> None:
    drawn = (np.asarray(random_stiffness("smooth", np.random.default_rng(seed))(S)) for seed in range(200))
    ratios = np.array([k.max() / k.min() for k in drawn])
    assert np.max(ratios) < 1.001 * LARGEST_RATIO
    assert np.max(ratios) > 0.9 * LARGEST_RATIO
    assert np.min(ratios) < 1.1


def test_stepped_beams_jump_once_or_twice() -> None:
    drawn = [random_stiffness("stepped", np.random.default_rng(seed)) for seed in range(60)]
    assert all(isinstance(one, Steps) for one in drawn)
    assert {len(one.jumps) for one in drawn} == {1, 2}


def test_a_joint_is_narrow_and_soft() -> None:
    near = 120  # places: 0.15 of the beam
    for seed in range(20):
        log_k = np.log(np.asarray(random_stiffness("joint", np.random.default_rng(seed))(S)))
        dip = log_k[near:-near] - 0.5 * (log_k[2 * near :] + log_k[: -2 * near])
        assert np.min(dip) < np.log(0.75)


@pytest.mark.parametrize("at_s", [1.0, 0.6])
def test_the_force_found_bends_by_the_angle_asked(at_s: float) -> None:
    beam = Beam(0.15, random_stiffness("stepped", np.random.default_rng(4)))
    size = force_that_bends(beam, 1.0, 1.7, at_s)
    shape = beam.equilibrium(size * np.array([np.cos(1.7), np.sin(1.7)]), at_s)
    assert float(shape.angle(at_s)) == pytest.approx(1.0, abs=0.01)


def test_a_pull_along_the_beam_never_bends_it() -> None:
    assert np.isfinite(force_that_bends(Beam(0.15, Uniform(0.02)), 1.0, 0.0))
