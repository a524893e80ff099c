"""Contradictions between recording and description: their sizes decide whether k(s) is trusted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.learning.attribution import TRUSTED, Contradiction, doubt_of
from onebend.learning.posterior import Posterior, fit
from onebend.records import Observations, Remark, StatedSection
from tests.learning.bench import SOFT, forces, observed

NOISE = (1e-4, 2e-3)
S = np.linspace(0.1, 0.9, 9)


def recorded() -> Observations:
    return observed(SOFT, forces(), noise=NOISE)


def turned(one: Observations, degrees: float) -> Observations:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return replace(one, force=one.force @ np.array([[c, s], [-s, c]]))


def smaller(one: Observations, factor: float) -> Observations:
    return replace(one, xy=factor * one.xy, rest_xy=factor * one.rest_xy)


def with_section(one: Observations, size: float) -> Observations:
    places, sizes = np.array([0.0, 1.0]), np.full(2, size)
    section = StatedSection("rectangle", places, sizes, sizes, sd=0.01 * size)
    return replace(one, stated=replace(one.stated, section=section))


def remarked(one: Observations, share: float) -> Observations:
    return replace(one, source=replace(one.source, remarks=(Remark("warning", "axes", about="axes", share=share),)))


@cache
def fitted(case: str) -> Posterior:
    one = recorded()
    changed = {
        "as it is": one,
        "turned": turned(one, 15.0),
        "small": smaller(one, 0.88),
        "thin": with_section(one, 1e-4),
        "axes": remarked(one, 0.5),
    }
    return fit([changed[case]])


def sizes(posterior: Posterior) -> dict[str, float]:
    return {one.name: one.sds for one in posterior.contradictions}


def test_a_sound_recording_contradicts_nothing() -> None:
    posterior = fitted("as it is")
    assert doubt_of(posterior.contradictions) == ""
    assert posterior.grade != "not to be trusted"
    assert max(sizes(posterior).values(), default=0.0) < 1.0


@pytest.mark.slow
def test_a_turned_log_stays_usable_because_k_is_right() -> None:
    posterior = fitted("turned")
    band = posterior.band(S)
    assert np.mean((band.low <= SOFT.stiffness(S)) & (SOFT.stiffness(S) <= band.high)) > 0.75
    assert posterior.criticism.causes[0].score.suspect.name == "force direction"
    assert posterior.grade != "not to be trusted"


@pytest.mark.parametrize(
    ("case", "name"),
    [
        ("small", "the tags' places at rest"),
        ("thin", "Young's modulus"),
        ("axes", "the axes of the force"),
    ],
)
def test_a_large_contradiction_costs_the_trust_and_is_named(case: str, name: str) -> None:
    posterior = fitted(case)
    assert name in {one.name for one in posterior.contradictions}
    assert posterior.grade == "not to be trusted"
    assert name in " ".join(posterior.doubts)
    assert not posterior.band(S).identified.any()


def test_the_size_of_lengths_is_their_relative_error() -> None:
    found = next(one for one in fitted("small").contradictions if one.about == "tag places")
    assert found.shift == pytest.approx(0.12, rel=0.02)


@pytest.mark.slow
def test_a_log_that_does_not_follow_the_bending_is_as_large_as_its_misses() -> None:
    """Without the slow error that the fit takes off it, a log that is late predicts other shapes."""
    late = replace(recorded(), force=np.roll(forces(), 4, axis=0))
    assert sizes(fit([late])).get("the force log", np.inf) > 3.0 * sizes(fitted("as it is"))["the force log"]


def test_contradictions_add_up_in_squares() -> None:
    one = Contradiction("one", 0.1, 0.75 * TRUSTED, "")
    other = Contradiction("other", 0.1, 0.70 * TRUSTED, "")
    assert doubt_of([one]) == doubt_of([other]) == doubt_of([]) == ""
    assert "on one and other: k(s) could be off by 15 % (2.1 sd)" in doubt_of([one, other])
