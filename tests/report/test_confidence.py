"""The words on where k(s) is known agree with the band."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.stiffness import UncertainStiffness
from onebend.report import figures as curves
from onebend.report.confidence import (
    identified_ranges,
    identified_words,
    load_error_words,
    unidentified_words,
)
from onebend.report.page import band_card, page
from onebend.report.sentences import say, significant
from onebend.report.style import png_of
from tests import made_up

KNOTS = np.array([0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0])  # piecewise linear: the sd at a knot is its coefficient's


def uncertain(*sd: float, gain_sd: float = 0.0) -> UncertainStiffness:
    return UncertainStiffness(KNOTS, np.log(np.full(5, 0.03)), np.diag(np.square(sd)), gain_sd, degree=1)


@pytest.mark.parametrize(
    ("sd", "starts"),
    [
        ((0.01, 0.01, 0.01, 0.01, 0.01), []),
        ((0.01, 0.01, 0.01, 0.01, 1.0), ["Beyond s = 0.8"]),
        ((1.0, 0.01, 0.01, 0.01, 1.0), ["Nearer to the clamp than s = 0.2", "Beyond s = 0.8"]),
        ((0.201, 0.01, 0.01, 0.01, 0.01), ["Nearer to the clamp than s = 0.01"]),
        ((0.01, 0.01, 1.0, 0.01, 0.01), ["Between s = 0.3"]),
        ((1.0, 1.0, 1.0, 1.0, 1.0), ["k(s) is not identified at any place"]),
    ],
)
def test_every_blind_stretch_is_named_and_no_other(sd: tuple[float, ...], starts: list[str]) -> None:
    one = uncertain(*sd)
    words = unidentified_words(one)
    assert len(words) == len(starts)
    assert all(text.startswith(start) for text, start in zip(words, starts, strict=True)), words
    s = np.linspace(0.0, 1.0, 401)
    inside = np.zeros(401, dtype=bool)
    for low, high in identified_ranges(one):
        inside |= (s >= low - 1e-9) & (s <= high + 1e-9)
    np.testing.assert_array_equal(inside, one.band(s).identified)
    png_of(curves.stiffness(made_up.BEAM, uncertain=one))
    assert ("not identified" in band_card(one)[1]) == (sd[2] == sd[0] == 1.0)


def test_the_card_has_the_width_of_the_band_that_is_drawn() -> None:
    """Also where the band is narrower than a normal's of its sd."""
    s = np.linspace(0.0, 1.0, 51)
    one = replace(uncertain(*[0.05] * 5), shape=np.full((3, 41), 0.8))
    band = one.band(s)
    percent = 100.0 * float(np.median(band.high / band.k) - 1.0)
    assert band_card(one)[1] == f"± {significant(percent, 2)} %"
    assert percent == pytest.approx(100.0 * np.expm1(0.8 * np.log1p(0.081)), rel=0.02)


def test_the_gain_is_in_the_card_and_said_apart() -> None:
    assert band_card(uncertain(*[0.05] * 5, gain_sd=0.0))[1] == "± 8.1 %"  # 1.96 x 0.05 x sqrt(10) / 4
    assert band_card(uncertain(*[1e-6] * 5, gain_sd=0.05))[1] == "± 10 %"
    assert "known to 5 %" in say("gain", sd=0.05)
    assert "assumed to be exact" in say("gain exact")
    assert "weight" in say("scale by weight")


@pytest.mark.slow
def test_nothing_counts_as_identified_where_k_is_in_doubt() -> None:
    one = replace(uncertain(*[0.01] * 5), doubts=("the fit did not converge",))
    assert not one.band(np.linspace(0.0, 1.0, 11)).identified.any()
    assert identified_ranges(one) == []
    assert band_card(one) == ("k(s) is known to", "NOT TO BE TRUSTED", "the fit did not converge")
    (words,) = unidentified_words(one)
    assert "NOT TO BE TRUSTED: the fit did not converge" in words
    png_of(curves.stiffness(made_up.BEAM, uncertain=one))


def test_an_error_that_comes_with_the_load_is_said_where_it_counts() -> None:
    assert load_error_words((0.01, 0.02)) == []
    (words,) = load_error_words((0.2, 0.25))
    assert "0.2 N" in words
    assert "25 %" in words


def test_nuisances_are_shown_in_the_units_of_a_bench() -> None:
    found = made_up.findings(0)
    assert found.posterior is not None
    clock = next(n for n in found.posterior.nuisances() if n.name == "made-up: clock offset")
    told = re.compile(r">([^<]*) \[([^<]*)\]</td><td>[^<]*</td><td>([^<]*)</td><td>[^<]*</td><td>([^<]*) %<")
    rows = {name: more for name, *more in told.findall(page(found, {}))}
    assert rows["tag 1 along"][:2] == ["mm", "0.50"]
    assert rows["made-up: clamp angle"][:2] == ["deg", "0.35"]
    assert float(rows["made-up: clock offset"][1]) == pytest.approx(1e3 * clock.prior_sd, rel=0.01)
    assert rows["made-up: clock offset"][0] == "ms"
    assert all(0.0 <= float(share) <= 100.0 for _, _, share in rows.values())


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ([(0.0, 0.9)], "0.00 to 0.90"),
        ([(0.0, 0.28), (0.29, 0.4), (0.41, 0.9)], "0.00 to 0.90 (but for 2 % of it)"),
        ([(0.0, 0.4), (0.5, 0.9)], "0.00 to 0.40, 0.50 to 0.90"),
        ([(0.0, 0.4), (0.5, 0.505)], "0.00 to 0.40"),
        ([(0.5, 0.505)], "0.50 to 0.51"),
    ],
)
def test_narrow_gaps_are_counted_and_not_named(ranges: list[tuple[float, float]], words: str) -> None:
    assert identified_words(ranges) == words
