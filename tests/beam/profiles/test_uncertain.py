"""The uncertain stiffness: its band against draws, its common scale, and what it writes."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import MechanicsError

KNOTS = np.array([0, 0, 0, 0, 0.5, 1, 1, 1, 1], dtype=float)
S = np.linspace(0.0, 1.0, 11)


def made(gain_sd: float = 0.0) -> UncertainStiffness:
    root = np.random.default_rng(1).normal(size=(5, 5))
    return UncertainStiffness(KNOTS, np.linspace(-4.0, -3.0, 5), 0.01 * root @ root.T, gain_sd)


@pytest.mark.parametrize("gain_sd", [0.0, 0.3])
def test_band_is_the_quantiles_of_the_draws(gain_sd: float) -> None:
    one = made(gain_sd)
    drawn = np.array([k(S) for k in one.draw(20_000, seed=3)])
    band = one.band(S, 0.8)
    np.testing.assert_allclose(band.low, np.quantile(drawn, 0.1, axis=0), rtol=0.02)
    np.testing.assert_allclose(band.high, np.quantile(drawn, 0.9, axis=0), rtol=0.02)
    np.testing.assert_allclose(band.k, one.profile(S), rtol=1e-12)


def test_a_seed_gives_the_same_draws_whatever_eigenvectors_the_machine_finds() -> None:
    alike = 0.05 * np.eye(5) + 0.03  # four equal eigenvalues: any four vectors of a space are right
    one = UncertainStiffness(KNOTS, np.zeros(5), alike @ alike)
    expected = np.random.default_rng(7).standard_normal((3, 5)) @ alike
    drawn = np.array([k.coefficients for k in one.draw(3, seed=7)])
    np.testing.assert_allclose(drawn, expected, atol=1e-12)


def test_the_common_scale_widens_the_band_but_hides_nothing() -> None:
    assert np.array_equal(made(0.3).band(S).identified, made().band(S).identified)
    assert np.all(made(0.3).band(S).high > made().band(S).high)


def test_it_comes_back_from_what_it_writes() -> None:
    one, again = made(0.1), UncertainStiffness.from_dict(made(0.1).as_dict())
    assert np.array_equal(one.covariance, again.covariance)
    assert again.profile == one.profile
    assert again.gain_sd == one.gain_sd


def test_sizes_that_do_not_fit_are_refused() -> None:
    data = made().as_dict()
    with pytest.raises(MechanicsError, match="covariance"):
        UncertainStiffness.from_dict({**data, "covariance": [[1.0]]})
    with pytest.raises(MechanicsError, match="finite"):
        UncertainStiffness.from_dict({**data, "gain_sd": float("nan")})
