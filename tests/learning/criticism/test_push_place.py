"""A place of the push that is written wrongly: the evidence finds it, and the band holds what cannot be told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.learning.criticism.criticism import ALARM
from onebend.learning.criticism.place_evidence import at_written, log_ratio, moved, under
from onebend.learning.criticism.push_place import (
    ACCUSED,
    FAR,
    INNERMOST,
    MISTAKEN,
    _weights,
    doubtful,
    moved_off,
    search_place,
    with_places,
)
from onebend.learning.posterior import Posterior, fit
from onebend.learning.verdict import fit_remarks
from tests.learning.bench import IDEAL, SOFT, forces, observed

NOISE = (2e-5, 1e-3)
SETTINGS = replace(IDEAL, functions=16)


@cache
def fitted(acts: float, said: float) -> Posterior:
    """SOFT, pushed at `acts`."""
    seen = observed(SOFT, forces(40), at_s=acts, noise=NOISE)
    return fit([replace(seen, push_s=np.full(40, said))], 0.02, settings=SETTINGS)


def test_a_push_that_acts_elsewhere_is_accused_with_its_place() -> None:
    one = fitted(0.75, 1.0)
    assert one.place is not None
    assert one.place.accused
    assert 0.65 <= one.place.range[0] <= 0.85
    assert any("push" in words for words in one.doubts)
    remark = next(r for r in fit_remarks(one) if r.about == "push place")
    assert "not at 1" in remark.text
    assert "correct at_s in [push]" in remark.text


def test_a_right_place_is_neither_accused_nor_widened() -> None:
    one = fitted(1.0, 1.0)
    assert not any("at_s" in words for words in one.doubts)
    search = search_place(one.problem, one.optimum, SETTINGS)  # were it asked for
    assert search is not None
    assert not search.accused
    assert np.max(search.gain) < 0.5 * ACCUSED
    wider = with_places(one.optimum, search).covariance.of_shared
    assert np.all(np.diag(wider)[:16] < 1.2 * np.diag(one.optimum.covariance.of_shared)[:16])


def test_a_quiet_fit_is_asked_beside_its_push_alone() -> None:
    one = fitted(1.0, 1.0)
    assert search_place(one.problem, one.optimum, SETTINGS, thorough=False) is None
    critic = one.criticism
    quiet = [replace(f, score=replace(f.score, log10_p=-0.5)) for f in critic.findings]
    assert not doubtful(replace(critic, findings=tuple(quiet)))
    place = next(i for i, f in enumerate(quiet) if f.score.suspect.name == "push place")
    quiet[place] = replace(quiet[place], score=replace(quiet[place].score, log10_p=-1.5))
    assert doubtful(replace(critic, findings=tuple(quiet)))


def test_the_second_moment_of_the_places_stands_in_the_band() -> None:
    one = fitted(0.75, 1.0)
    assert one.place is not None
    search = replace(one.place, weight=np.full(len(one.place.s), 0.1))
    before = one.optimum.covariance.pairs[0]
    after = with_places(one.optimum, search).covariance.pairs[0]
    expected = before + sum(0.1 * np.outer(d, d) for d in search.away)
    assert np.allclose(after, expected)
    where = one.layout.index["place", 0].where.start
    moved = search.away[:, where] / one.recordings[0].observations.length
    assert np.allclose(moved, search.s - 1.0, atol=0.02)


def test_where_nothing_tells_the_places_keep_their_weights() -> None:
    s = np.array([0.4, 0.6, 0.8, 1.0])
    weight = _weights(s, np.zeros(4), 0.9)
    assert np.all(weight > 0.0)
    share = np.sum(weight) / MISTAKEN  # but for what stands for the written place itself
    assert 0.85 < share <= 1.0
    far = _weights(s, np.array([-20.0, -20.0, 7.0, -20.0]), 0.9)
    assert far[2] > 0.9
    assert np.sum(far) < 1.0


def test_a_push_that_acts_farther_out_is_accused_by_the_same_level() -> None:
    one = fitted(1.0, 0.7)  # the k(s) found there is one that no step leads away from
    search = search_place(one.problem, one.optimum, SETTINGS)
    assert search is not None
    assert search.accused
    assert search.s[np.argmax(search.gain)] > 0.9


def test_a_right_place_inside_gains_nothing_on_either_side() -> None:
    one = fitted(0.75, 0.75)
    search = search_place(one.problem, one.optimum, SETTINGS)
    assert search is not None
    assert np.any(search.s > 0.75)
    assert np.any(search.s < 0.75)
    assert np.max(search.gain) < 0.25 * ACCUSED


def test_places_are_compared_under_one_noise() -> None:
    one = fitted(0.75, 0.75)
    here = at_written(one.problem, one.optimum, 0.75, SETTINGS)
    assert here is not None
    there = moved(here, 0.85, SETTINGS)
    assert there is not None
    assert there.estimate.hyperparameters.noise == here.estimate.hyperparameters.noise
    [noise] = here.estimate.hyperparameters.noise
    quieter = replace(here.estimate.hyperparameters, noise=(replace(noise, marker=0.9 * noise.marker),))
    here_again, there_again = under(here, quieter), under(there, quieter)
    assert here_again is not None
    assert there_again is not None
    gain, gain_again = there.log_evidence - here.log_evidence, there_again.log_evidence - here_again.log_evidence
    assert abs(gain_again - gain) < 0.3 * abs(gain) + 0.5
    # under noises that differ by a tenth the same fit would lose more than half the level
    assert here_again.log_evidence - here.log_evidence < -0.5 * ACCUSED


def test_a_place_is_accused_where_other_tests_would_speak() -> None:
    assert np.isclose(np.exp(-ACCUSED), 10.0**ALARM)


def test_where_the_film_shows_the_tool_no_other_place_is_asked() -> None:
    one = fitted(0.75, 1.0)
    [seen] = one.recordings
    o = seen.observations
    shown = replace(seen, observations=replace(o, source=replace(o.source, place_seen=True)))
    assert search_place(replace(one.problem, recordings=(shown,)), one.optimum, SETTINGS) is None


def test_moments_of_pushes_at_two_places() -> None:
    s = np.linspace(0.0, INNERMOST, 5)
    assert np.allclose(np.exp(log_ratio(s, 1.0, 0.7)), (0.7 - s) / (1.0 - s))
    assert np.allclose(np.exp(log_ratio(s, 0.7, 1.0)), (1.0 - s) / (0.7 - s))
    assert np.all(np.isfinite(log_ratio(np.linspace(0.0, 1.0, 50), 1.0, 0.7)))


def test_a_fit_that_takes_the_push_away_from_its_written_place_is_in_doubt() -> None:
    right = fitted(1.0, 1.0)
    where = right.layout.index["place", 0]
    for sds, expected in ((-0.9 * FAR, False), (-1.1 * FAR, True)):
        x = right.mean.copy()
        x[where.where] = sds * where.prior_sd
        one = replace(right, optimum=replace(right.optimum, x=x), place=None)
        assert moved_off(one.layout, one.mean) == pytest.approx(abs(sds))
        assert ("the push hardly acts where at_s says" in one.doubts) is expected
        assert any("correct at_s" in r.text and r.about == "push place" for r in fit_remarks(one)) is expected
