"""Several recordings of a beam that is mounted anew between them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.learning.allowances import BETWEEN, BETWEEN_SD, between_recordings
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior, fit
from onebend.records import Observations
from onebend.report.confidence import mounting_words
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_source

MOUNTED = FitSettings(functions=9, allowances=frozenset({BETWEEN}))
S = np.linspace(0.1, 0.8, 15)


def recording(number: int, factor: float) -> Observations:
    """Of the beam with its k(s) times a factor."""
    stiffness = Gaussians(equidistant(3), 0.5, tuple(factor * k for k in (0.02, 0.03, 0.015)))
    made = observed(Beam(0.15, stiffness), forces(30), noise=(2e-5, 3e-4), seed=number)
    return with_source(replace(made, time=(1.0 + 0.1 * number) * made.time), name=f"number {number}")


@cache
def learned(*factors: float, settings: FitSettings = MOUNTED) -> Posterior:
    return fit([recording(i, factor) for i, factor in enumerate(factors)], settings=settings)


def test_own_levels_are_smooth_functions_of_no_correlation_over_the_beam() -> None:
    s = (np.arange(4000) + 0.5) / 4000
    basis = between_recordings(s).basis
    np.testing.assert_allclose(basis.T @ basis / len(s), np.diag([1.0, 1.0 / 3.0, 1.0 / 5.0]), atol=1e-6)


@pytest.mark.slow
def test_two_recordings_that_disagree_widen_the_band_to_hold_what_lies_between() -> None:
    apart, alike = learned(0.88, 1.14), learned(1.0, 1.0)
    blind = learned(0.88, 1.14, settings=FitSettings(functions=9, allowances=frozenset()))
    k = SOFT.stiffness(S)
    wide, narrow, without = (one.band(S) for one in (apart, alike, blind))
    assert np.all((wide.low < k) & (k < wide.high))
    assert np.median(np.log(wide.high / wide.low) / np.log(narrow.high / narrow.low)) > 3.0
    assert np.median(np.log(wide.high / wide.low) / np.log(without.high / without.low)) > 2.0
    assert apart.mountings[0] > 2.0 * alike.mountings[0]
    low, high = apart.mountings[1:]
    assert low < np.std([np.log(0.88), np.log(1.14)]) < high


@pytest.mark.slow
def test_many_recordings_tell_how_much_mountings_differ() -> None:
    factors = np.exp(0.1 * np.array([-1.3, -0.6, 0.0, 0.5, 1.4]))
    found = learned(*factors.tolist())
    likely, low, high = found.mountings
    assert low < likely < high
    assert abs(np.log(likely / np.std(np.log(factors)))) < np.log(1.6)
    levels = [found.layout.get(found.mean, BETWEEN, i)[0] for i in range(5)]
    np.testing.assert_allclose(
        np.array(levels) - np.mean(levels), np.log(factors) - np.mean(np.log(factors)), atol=0.02
    )
    band = found.band(S)
    assert np.all((band.low < SOFT.stiffness(S)) & (SOFT.stiffness(S) < band.high))


def test_one_recording_says_that_it_cannot_show_it() -> None:
    one, two = learned(1.0), learned(0.88, 1.14)
    assert np.isnan(one.mountings[0])
    assert BETWEEN not in {block.name for block in one.layout.blocks}
    assert "one recording cannot show them" in mounting_words(one)
    assert "Between the recordings k(s) differs by about" in mounting_words(two)
    assert mounting_words(learned(0.88, 1.14, settings=FitSettings(functions=9, allowances=frozenset()))) == ""
    assert np.sqrt(np.sum(BETWEEN_SD**2)) < 0.1
