"""The paper's regression: its printed equations, in-family recovery, and what weights do under noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.grid import Modes, make_grid, powers_to_legendre
from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, Powers, Profile, equidistant
from onebend.learning.paper import (
    _ROUNDING,
    _residual_whitening,
    assemble,
    basis,
    literal,
    profile,
    solve_states,
    weighted,
)
from onebend.records import MassLine
from tests.learning.bench import SOFT, forces, in_family, observed
from tests.made_up import with_stated

S = np.linspace(0.05, 0.9, 50)


@pytest.mark.parametrize(
    ("family", "stiffness"),
    [
        ("gaussians", SOFT.stiffness),
        ("powers", Powers((0.02, 0.03, -0.02))),
        ("gaussians", Gaussians(equidistant(5), 0.25, (0.02, 0.004, 0.03, 0.001, 0.01))),
    ],
)
@pytest.mark.parametrize("method", ["literal", "weighted"])
def test_in_family_stiffness_comes_back_from_noise_free_data(family: str, stiffness: Profile, method: str) -> None:
    n, m = 6, len(stiffness.coefficients)  # type: ignore[attr-defined]
    made = in_family(Beam(0.15, stiffness), forces(), n)
    rows = assemble(made, solve_states(made, n))
    use = np.ones(len(made.time), dtype=bool)
    pi, sigma = basis(family, m, getattr(stiffness, "width", None))  # type: ignore[arg-type]
    if method == "literal":
        gamma, _ = literal(rows, use, pi)
    else:
        gamma, _ = weighted(rows, use, pi, force_sd=made.force_sd)
    found = profile(family, gamma, sigma)  # type: ignore[arg-type]
    np.testing.assert_allclose(found(S), stiffness(S), rtol=1e-6)


def test_literal_rows_are_the_papers_equation_14() -> None:
    """`sum_w gamma_w sum_i theta_i / (i + j + w + 1) = (J^T F)_j` with powers of s, summed out by hand."""
    n, m = 4, 3
    made = in_family(SOFT, forces(12), n)
    states = solve_states(made, n)
    theta = np.linalg.solve(powers_to_legendre(n), states.theta.T).T
    i, j, w = np.arange(n)[:, None, None], np.arange(n)[None, :, None], np.arange(m)[None, None, :]
    x = np.einsum("ti,ijw->tjw", theta, 1.0 / (i + j + w + 1.0)).reshape(-1, m)
    grid = make_grid(order=40)
    a = grid.nodes[:, None] ** np.arange(1, n + 1) / np.arange(1, n + 1)
    alpha = theta @ a.T
    across = -np.sin(alpha) * made.force[:, :1] + np.cos(alpha) * made.force[:, 1:]
    y = (made.length * (across * grid.weights) @ a).ravel()
    expected = np.linalg.lstsq(x, y, rcond=None)[0]
    pi, _ = basis("powers", m, None)
    gamma, _ = literal(assemble(made, states), np.ones(12, dtype=bool), pi)
    np.testing.assert_allclose(gamma, expected, rtol=1e-8)


def test_weight_of_the_beam_enters_the_load() -> None:
    """In-family data under gravity: regression with the weight's share is exact, without it is not."""
    heavy = Beam(0.15, SOFT.stiffness)
    made = in_family(heavy, forces(), 5)
    weighed = with_stated(replace(made, gravity=np.tile([0.0, -9.81], (len(made.time), 1))), mass=0.05)
    rows, plain = assemble(weighed, solve_states(weighed, 5)), assemble(made, solve_states(made, 5))
    grid, phi = make_grid(order=40), Modes(5)
    alpha = rows.states.theta @ phi.angle(grid.nodes).T
    down = -0.05 * 9.81 * (1.0 - grid.nodes) * np.cos(alpha)
    expected = 0.15 * (down * grid.weights) @ phi.angle(grid.nodes)
    np.testing.assert_allclose(rows.load - plain.load, expected, atol=1e-12)


def test_an_uneven_mass_loads_the_beam_where_it_is() -> None:
    """Three times as heavy at the tip as at the clamp; with an even mass the rows are wrong."""
    s = np.linspace(0.0, 1.0, 201)
    line = MassLine(s, (0.5 + s) * 0.05 / 0.15)  # kg/m, 0.05 kg in all
    made = in_family(Beam(0.15, SOFT.stiffness), forces(), 5)
    even = with_stated(replace(made, gravity=np.tile([0.0, -9.81], (len(made.time), 1))), mass=0.05)
    uneven = with_stated(even, mass_line=line)
    grid, phi, plain = make_grid(order=40), Modes(5), assemble(made, solve_states(made, 5))
    rows, of_even = assemble(uneven, solve_states(uneven, 5)), assemble(even, solve_states(even, 5))
    beyond = 0.05 * (1.0 - 0.5 * grid.nodes - 0.5 * grid.nodes**2)  # kg, of (0.5 + s) from s to 1
    alpha = rows.states.theta @ phi.angle(grid.nodes).T
    expected = 0.15 * (-9.81 * beyond * np.cos(alpha) * grid.weights) @ phi.angle(grid.nodes)
    np.testing.assert_allclose(rows.load - plain.load, expected, atol=1e-10)
    assert np.max(np.abs(of_even.load - rows.load)) > 0.1 * np.max(np.abs(expected))


@pytest.mark.parametrize("lowest", [1e-3, 1e-13])
def test_whitening_is_that_of_the_spectrum_where_it_is_known(lowest: float) -> None:
    random = np.random.default_rng(2)
    turned = np.linalg.qr(random.normal(size=(5, 6, 6)))[0]
    spectrum = np.geomspace(lowest, 1.0, 6)
    whiten = _residual_whitening((turned * spectrum) @ np.swapaxes(turned, 1, 2))
    expected = (turned / np.maximum(spectrum, _ROUNDING)) @ np.swapaxes(turned, 1, 2)
    assert np.swapaxes(whiten, 1, 2) @ whiten == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_whitening_of_a_matrix_without_an_inverse_is_bounded() -> None:
    whiten = _residual_whitening(np.stack([np.ones((3, 3)), np.eye(3)]))
    assert whiten[1] @ whiten[1].T == pytest.approx(np.eye(3))
    assert np.abs(whiten[0]).max() < 1.01 / np.sqrt(_ROUNDING)


def test_weights_beat_the_literal_rows_under_noise() -> None:
    """Over ten seeds, markers of 0.02 mm and 0.1 deg: the median error falls by far more than half."""
    n, m = 6, 4
    pi, sigma = basis("gaussians", m, None)
    errors: dict[str, list[float]] = {"literal": [], "weighted": []}
    for seed in range(10):
        made = observed(SOFT, forces(), noise=(2e-5, 2e-3), seed=seed)
        rows, use = assemble(made, solve_states(made, n)), np.ones(len(made.time), dtype=bool)
        for name, gamma in (
            ("literal", literal(rows, use, pi)[0]),
            ("weighted", weighted(rows, use, pi, force_sd=made.force_sd)[0]),
        ):
            ratio = profile("gaussians", gamma, sigma)(S) / SOFT.stiffness(S) - 1.0
            errors[name].append(float(np.sqrt(np.mean(ratio**2))))
    assert np.median(errors["weighted"]) < 0.5 * np.median(errors["literal"])
    assert np.median(errors["weighted"]) < 0.05
