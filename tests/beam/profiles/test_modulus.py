"""Young's modulus from k(s) and a section: the one that a beam was made with, and its band against draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.section import modulus_band, second_moment
from onebend.beam.stiffness import Polyline, UncertainStiffness, Uniform, in_pieces
from onebend.errors import MechanicsError
from onebend.records import Array, StatedSection

LENGTH, MODULUS = 0.15, 0.7e6
S = np.linspace(0.0, 1.0, 13)
PLACES = np.array([0.0, 0.3, 0.7, 1.0])
THICK, WIDE = np.array([0.008, 0.012, 0.011, 0.014]), np.array([0.03, 0.028, 0.03, 0.025])
RECTANGLE = StatedSection("rectangle", PLACES, THICK, WIDE, 0.0)
CIRCLE = StatedSection("circle", PLACES, THICK, THICK, 0.0)


def table(values: Array) -> Polyline:
    return Polyline(tuple(PLACES), tuple(values))


def uncertain(gain_sd: float = 0.0) -> UncertainStiffness:
    knots = np.array([0, 0, 0, 0, 0.5, 1, 1, 1, 1], dtype=float)
    root = np.random.default_rng(1).normal(size=(5, 5))
    return UncertainStiffness(knots, np.linspace(-4.0, -3.0, 5), 1e-3 * root @ root.T, gain_sd)


@pytest.mark.parametrize("stated", [RECTANGLE, CIRCLE], ids=["rectangle", "circle"])
def test_the_modulus_of_a_known_beam_comes_back(stated: StatedSection) -> None:
    def k(s: Array) -> Array:
        h, w = table(THICK)(s), table(WIDE)(s)
        return np.asarray(MODULUS / LENGTH * (np.pi * h**4 / 64.0 if stated is CIRCLE else w * h**3 / 12.0))

    found = modulus_band(in_pieces(k, tuple(PLACES)), LENGTH, stated, S)
    np.testing.assert_allclose(found.modulus, MODULUS, rtol=1e-10)
    assert np.isnan(found.low).all()
    assert np.isnan(found.high).all()
    assert not found.identified.any()


def test_width_and_thickness_are_not_mixed_up() -> None:
    flat = StatedSection("rectangle", np.array([0.0, 1.0]), np.full(2, 0.01), np.full(2, 0.03))
    assert second_moment(flat, S)[0] == pytest.approx(0.03 * 0.01**3 / 12.0)


@pytest.mark.parametrize("sd", [0.0, 0.0003, np.nan])
@pytest.mark.parametrize("stated", [RECTANGLE, CIRCLE], ids=["rectangle", "circle"])
def test_the_band_is_the_quantiles_of_the_draws(stated: StatedSection, sd: float) -> None:
    one, rng = uncertain(0.02), np.random.default_rng(5)
    band = modulus_band(one, LENGTH, replace(stated, sd=sd), S, 0.9)
    k = np.array([profile(S) for profile in one.draw(4000, seed=3)])
    h, w = (table(size)(S) + np.nan_to_num(sd) * rng.normal(size=(4000, 1)) for size in (THICK, WIDE))
    drawn = k * LENGTH / (np.pi * h**4 / 64.0 if stated is CIRCLE else w * h**3 / 12.0)
    np.testing.assert_allclose(band.low, np.quantile(drawn, 0.05, axis=0), rtol=0.03)
    np.testing.assert_allclose(band.high, np.quantile(drawn, 0.95, axis=0), rtol=0.03)
    assert np.array_equal(band.identified, one.band(S).identified)


def test_beyond_the_measured_places_nothing_is_known() -> None:
    part = replace(RECTANGLE, s=np.array([0.2, 0.4, 0.6, 0.8]))
    band, inside = modulus_band(uncertain(), LENGTH, part, S), (S >= 0.2) & (S <= 0.8)
    for values in (band.modulus, band.low, band.high):
        assert np.array_equal(np.isfinite(values), inside)
    assert not np.any(band.identified & ~inside)
    assert np.all(band.identified[inside])


def test_what_is_no_beam_is_refused() -> None:
    with pytest.raises(MechanicsError, match="length"):
        modulus_band(Uniform(0.1), 0.0, RECTANGLE, S)
    with pytest.raises(MechanicsError, match="must be positive"):
        modulus_band(Uniform(0.1), LENGTH, replace(RECTANGLE, thickness=-THICK), S)
