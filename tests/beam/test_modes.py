"""Curvature modes: integrals, the two bases span the same shapes, and powers are refused where they fail."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.grid import MOST_POWERS, Modes, make_grid
from onebend.errors import MechanicsError

S = np.linspace(0.0, 1.0, 23)
GRID = make_grid(order=24)


@pytest.mark.parametrize("kind", ["legendre", "powers"])
def test_angle_is_the_integral_of_curvature(kind: str) -> None:
    modes = Modes(6, kind)  # type: ignore[arg-type]
    np.testing.assert_allclose(modes.angle(S), GRID.integral_to(S) @ modes.curvature(GRID.nodes), atol=1e-14)


@pytest.mark.parametrize("n", [1, 3, MOST_POWERS])
def test_conversion_gives_the_same_curvature(n: int) -> None:
    powers, legendre = Modes(n, "powers"), Modes(n)
    theta = np.linspace(-1.0, 2.0, n)
    np.testing.assert_allclose(powers.curvature(S) @ theta, legendre.curvature(S) @ (powers.to_legendre @ theta))


def test_stiffness_matrix_is_well_conditioned_in_legendre_and_not_in_powers() -> None:
    def condition(modes: Modes) -> float:
        phi = modes.curvature(GRID.nodes)
        return float(np.linalg.cond(phi.T @ (GRID.weights[:, None] * phi)))

    assert condition(Modes(8)) < 20.0
    assert condition(Modes(8, "powers")) > 1e9


def test_too_many_powers_are_refused_with_the_cure() -> None:
    with pytest.raises(MechanicsError, match="legendre"):
        Modes(MOST_POWERS + 1, "powers")
