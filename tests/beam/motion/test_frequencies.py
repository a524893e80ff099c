"""Natural frequencies under gravity against closed forms, perturbation theory and finite differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from onebend.beam.dynamics import Actions, body_of_nodes
from onebend.beam.grid import make_grid
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Steps, Table, Uniform
from onebend.beam.vibration import Vibration, frequency_slopes, natural_frequencies, settle, shear_share, vibration_of
from onebend.errors import MechanicsError
from onebend.records import Array, PointMass
from tests.beam.slender import swinging_frequencies

UNIT = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0))
UNEVEN = Beam(
    0.3, Powers((0.05, 0.03, -0.04)), rest_curvature=Powers((0.2, -0.3)), mass_per_length=Powers((0.2, 0.1, -0.15))
)


def roots(ratio: float, count: int) -> Array:
    """b of a cantilever with a point mass of `ratio` times its own at the tip:
    1 + cos b cosh b + ratio b (cos b sinh b - sin b cosh b) = 0, divided by cosh b."""

    def equation(b: float) -> float:
        return float(np.cos(b) + 1.0 / np.cosh(b) + ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b)))

    grid = np.linspace(1e-3, np.pi * (count + 1), 4001).tolist()
    found = [brentq(equation, a, b, xtol=1e-14) for a, b in pairwise(grid) if equation(a) * equation(b) < 0.0]
    return np.array(found[:count])


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0, 20.0])
def test_a_cantilever_with_and_without_a_mass_at_its_tip_has_the_roots_of_its_equation(ratio: float) -> None:
    exact = roots(ratio, 5) ** 2 / (2.0 * np.pi)
    found = natural_frequencies(UNIT, points=[PointMass(1.0, ratio)] if ratio else [], count=5)
    np.testing.assert_allclose(found, exact, rtol=1e-9)


def test_units_a_steel_ruler_of_300_mm() -> None:
    """E = 210 GPa, 1 mm thick, 30 mm wide, 7850 kg/m^3: f1 = 1.8751^2 / (2 pi L^2) sqrt(E I / mu) = 9.28 Hz."""
    length, stiff, mu = 0.3, 210e9 * 0.03 * 0.001**3 / 12.0, 7850.0 * 0.03 * 0.001
    ruler = Beam(length, Uniform(stiff / length), mass_per_length=Uniform(mu))
    expected = 1.8751040687**2 / (2.0 * np.pi * length**2) * np.sqrt(stiff / mu)
    assert natural_frequencies(ruler)[0] == pytest.approx(expected, rel=1e-8)
    assert expected == pytest.approx(9.28, abs=0.01)


def test_hanging_raises_and_standing_lowers_to_first_order_as_rayleigh_says() -> None:
    """omega^2 = omega0^2 + g int w'^2 (1 - s) ds / int w^2 ds with the exact mode w of the beam without weight."""
    s, weights = np.polynomial.legendre.leggauss(60)
    s, weights = 0.5 * (s + 1.0), 0.5 * weights
    for i, b in enumerate(roots(0.0, 3)):
        c = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
        w = np.cosh(b * s) - np.cos(b * s) - c * (np.sinh(b * s) - np.sin(b * s))
        slope = b * (np.sinh(b * s) + np.sin(b * s) - c * (np.cosh(b * s) - np.cos(b * s)))
        expected = weights @ (slope**2 * (1.0 - s)) / (weights @ w**2)
        up, down = ((2 * np.pi * natural_frequencies(UNIT, gravity=(sign * 1e-3, 0.0))[i]) ** 2 for sign in (1.0, -1.0))
        assert (up - down) / 2e-3 == pytest.approx(expected, rel=1e-5)


def test_a_standing_beam_comes_to_rest_where_its_weight_makes_it_buckle() -> None:
    """Greenhill: g mu L^3 / (E I) = 7.8373; near it omega^2 falls to zero linearly."""
    loads = np.array([7.6, 7.75, 7.83])
    squared = [natural_frequencies(UNIT, gravity=(-load, 0.0))[0] ** 2 for load in loads]
    slope, level = np.polyfit(loads, squared, 1)
    assert -level / slope == pytest.approx(7.8373, abs=2e-3)
    with pytest.raises(MechanicsError, match="not stable"):
        natural_frequencies(UNIT, gravity=(-7.85, 0.0))


@pytest.mark.parametrize("turn", [0.0, 1.2, np.pi / 2.0, np.pi])
def test_any_posture_against_finite_differences_of_second_order(turn: float) -> None:
    """A chain of rigid bars (another theory of motion) converges to the same frequencies, sag and weight included."""
    gravity = 0.5 * np.array([np.cos(turn), -np.sin(turn)]) * 9.81
    beam = replace(UNEVEN, rest_curvature=Powers((0.2,)))
    coarse, fine = (swinging_frequencies(beam, gravity, bars, [(0.02, 1.0)], 2) for bars in (100, 200))
    limit = fine + (fine - coarse) / 3.0
    found = natural_frequencies(beam, gravity=gravity, points=[PointMass(1.0, 0.02)], count=2)
    np.testing.assert_allclose(found, limit, rtol=1e-5)


def test_a_beam_in_pieces_with_a_mass_in_between_converges() -> None:
    beam = Beam(1.0, Steps((0.0, 0.4, 1.0), (1.0, 0.3)), mass_per_length=Steps((0.0, 0.4, 1.0), (2.0, 1.0)))
    points = [(0.3, 0.7)]
    coarse, fine = (swinging_frequencies(beam, np.zeros(2), bars, points, 3) for bars in (200, 400))
    found = natural_frequencies(beam, points=[PointMass(0.7, 0.3)])
    np.testing.assert_allclose(found, fine + (fine - coarse) / 3.0, rtol=2e-4)


@pytest.mark.parametrize("gravity", [(0.0, 0.0), (9.81, 0.0), (-3.0, 0.0), (2.0, -9.81)])
def test_slopes_are_those_of_central_differences(gravity: tuple[float, float]) -> None:
    """With log k, mass, rest curvature and length, the change of the shape at rest included."""
    g, grid, h = np.array(gravity), make_grid(order=12, widest=0.25), 1e-4
    nodes = grid.nodes
    wave = np.exp(-(((nodes - 0.6) / 0.2) ** 2))
    start = {
        "log_length": np.log([UNEVEN.length]),
        "log_k": np.log(UNEVEN.stiffness(nodes)),
        "mass_per_length": UNEVEN.mass_per_length(nodes),
        "rest_curvature": UNEVEN.rest_curvature(nodes),
    }

    def vibrations(change: dict[str, Array]) -> Vibration:
        of = {name: value + change.get(name, 0.0) for name, value in start.items()}
        shorter = np.exp(start["log_length"] - of["log_length"])  # of the same mass
        on = body_of_nodes(
            grid,
            float(np.exp(of["log_length"][0])),
            np.exp(of["log_k"]),
            shorter * of["mass_per_length"],
            of["rest_curvature"],
            points=[PointMass(1.0, 0.01)],
        )
        return vibration_of(on, settle(on, Actions(gravity=g)), Actions(gravity=g), count=3)

    slopes = frequency_slopes(vibrations({}), g, (0, 1, 2))
    for name in start:
        way = np.ones(1) if name == "log_length" else wave
        more, less = (np.log(vibrations({name: sign * h * way}).frequency) for sign in (1.0, -1.0))
        mine = getattr(slopes, name).reshape(3, -1) @ way
        np.testing.assert_allclose(mine, (more - less) / (2.0 * h), rtol=2e-5, atol=1e-7, err_msg=name)


@pytest.mark.parametrize("slender", [0.02, 0.1])
def test_shear_and_rotary_inertia_lower_the_frequencies_as_timoshenko_says(slender: float) -> None:
    """The roots of his beam's determinant; what is left is of second order in what they lower."""
    iota, weak = slender**2 / 12.0, slender**2 / 12.0 * 3.1  # rho I / (mu L^2), EI / (kGA L^2)

    def determinant(hz: float) -> float:
        square = (2.0 * np.pi * hz) ** 2
        rates = np.array(
            [[0.0, 1.0, 0.0, weak], [0.0, 0.0, 1.0, 0.0], [0.0, -iota * square, 0.0, -1.0], [-square, 0, 0, 0]]
        )
        return float(np.linalg.det(expm(rates)[2:, 2:]))

    grid, k = make_grid(order=12, widest=0.25), np.ones(48)
    on = body_of_nodes(grid, 1.0, k, k, np.zeros(48), rotary_inertia=iota)
    found = vibration_of(on, settle(on), count=3)
    lowered = found.frequency / np.sqrt(1.0 + shear_share(found, weak * k, (0, 1, 2)))
    plain = natural_frequencies(UNIT)
    for mine, free in zip(lowered, plain, strict=True):
        exact = brentq(determinant, 0.7 * free, 1.05 * free)
        assert mine == pytest.approx(exact, rel=0.1 * (1.0 - exact / free) + 1e-9)
        assert exact < 0.9999 * free


def test_what_cannot_swing_is_refused() -> None:
    with pytest.raises(MechanicsError, match="mass"):
        natural_frequencies(Beam(1.0, Uniform(1.0)))
    with pytest.raises(MechanicsError, match="modes"):
        natural_frequencies(UNIT, count=0)
    with pytest.raises(MechanicsError, match="point mass"):
        natural_frequencies(UNIT, points=[PointMass(1.2, 1.0)])
    with pytest.raises(MechanicsError, match="thickness"):
        natural_frequencies(replace(UNIT, thickness=0.01))


def test_a_mass_as_a_table_is_taken() -> None:
    heavy = replace(UNIT, mass_per_length=Table((0.0, 1.0), (1.0, 1.0)))
    np.testing.assert_allclose(natural_frequencies(heavy), natural_frequencies(UNIT), rtol=1e-12)
