"""Curvature modes: integrals, the two bases span the same shapes, and powers are refused where they fail."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.grid import MOST_POWERS, Modes, make_grid, powers_to_legendre
from onebend.errors import MechanicsError
from onebend.records import Array

S = np.linspace(0.0, 1.0, 23)
GRID = make_grid(order=24)


def test_angle_is_the_integral_of_curvature() -> None:
    modes = Modes(6)
    np.testing.assert_allclose(modes.angle(S), GRID.integral_to(S) @ modes.curvature(GRID.nodes), atol=1e-14)


@pytest.mark.parametrize("n", [1, 3, MOST_POWERS])
def test_conversion_gives_the_same_curvature(n: int) -> None:
    theta = np.linspace(-1.0, 2.0, n)
    by_powers = S[:, None] ** np.arange(n) @ theta
    np.testing.assert_allclose(by_powers, Modes(n).curvature(S) @ (powers_to_legendre(n) @ theta))


def test_stiffness_matrix_is_well_conditioned_in_legendre_and_not_in_powers() -> None:
    def condition(phi: Array) -> float:
        return float(np.linalg.cond(phi.T @ (GRID.weights[:, None] * phi)))

    assert condition(Modes(8).curvature(GRID.nodes)) < 20.0
    assert condition(GRID.nodes[:, None] ** np.arange(8)) > 1e9


def test_too_many_powers_are_refused_with_the_cure() -> None:
    with pytest.raises(MechanicsError, match="Legendre"):
        powers_to_legendre(MOST_POWERS + 1)
