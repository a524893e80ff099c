"""The most probable values of a few unknowns, in many problems at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from onebend.gauss_newton import Linearise, Linearised, MostProbable, SearchLimits, most_probable
from onebend.records import Array, BoolArray, IntArray


def found(
    linearise: Linearise, x: Array, mean: Array, sd: Array, search: SearchLimits = SearchLimits()
) -> MostProbable:
    nothing = np.zeros((len(x), 0))
    return most_probable(linearise, linearise(np.arange(len(x)), x, nothing), x, mean, sd, search)


def everywhere(rows: IntArray) -> BoolArray:
    return np.ones(len(rows), dtype=bool)


@pytest.mark.parametrize("rows", [2, 7])
def test_a_linear_problem_gives_the_textbook_posterior(rows: int) -> None:
    """With fewer data than unknowns too."""
    rng = np.random.default_rng(0)
    a, y, mean, sd = rng.normal(size=(5, rows, 3)), rng.normal(size=(5, rows)), np.array([1.0, 0.0, -2.0]), np.ones(3)
    sd = np.array([0.5, 2.0, 1e3])

    def linearise(chosen: IntArray, x: Array, warm: Array) -> Linearised:
        return Linearised(y[chosen] - (a[chosen] @ x[..., None])[..., 0], a[chosen].copy(), everywhere(chosen), warm)

    best = found(linearise, np.zeros((5, 3)), mean, sd, SearchLimits(tolerance=1e-9))
    precision = np.swapaxes(a, 1, 2) @ a + np.diag(sd**-2)
    right = np.swapaxes(a, 1, 2) @ y[..., None] + (mean / sd**2)[:, None]
    np.testing.assert_allclose(best.x, np.linalg.solve(precision, right)[..., 0], rtol=1e-6)
    covariance = best.root @ np.swapaxes(best.root, 1, 2)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-7)
    np.testing.assert_allclose(best.by_residual(best.root), covariance @ np.swapaxes(a, 1, 2), rtol=1e-7, atol=1e-12)
    assert best.converged.all()


def rosenbrock(x: Array) -> tuple[Array, Array]:
    value = np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=1)
    slopes = np.zeros((len(x), 2, 2))
    slopes[:, 0, 0], slopes[:, 0, 1], slopes[:, 1, 0] = -20.0 * x[:, 0], 10.0, -1.0
    return value, slopes


def test_a_curved_valley_is_followed_to_the_minimum_that_scipy_finds() -> None:
    """Each of the problems with its own damping."""
    starts, sd = np.array([[-1.2, 1.0], [3.0, -2.0], [0.0, 0.0]]), np.array([2.0, 3.0])

    def linearise(chosen: IntArray, x: Array, warm: Array) -> Linearised:
        value, slopes = rosenbrock(x)
        return Linearised(-value, slopes, everywhere(chosen), warm)

    best = found(linearise, starts, np.zeros(2), sd, SearchLimits(steps=200, tolerance=1e-9))
    exact = least_squares(lambda x: np.append(rosenbrock(x[None])[0][0], x / sd), starts[0], xtol=1e-14, ftol=1e-14).x
    np.testing.assert_allclose(best.x, np.tile(exact, (3, 1)), atol=1e-7)


def test_no_step_goes_where_a_problem_has_no_solution_and_one_without_any_stays() -> None:
    """log x = 3, seen where x < 10 alone."""

    def linearise(_: IntArray, x: Array, warm: Array) -> Linearised:
        feasible = np.asarray((x[:, 0] > 0.0) & (x[:, 0] < 10.0))
        safe = np.where(feasible[:, None], x, 1.0)
        return Linearised(100.0 * (3.0 - np.log(safe)), 100.0 / safe[..., None], feasible, warm)

    best = found(linearise, np.array([[1.0], [-5.0]]), np.zeros(1), np.full(1, 1e3))
    assert 9.0 < best.x[0, 0] < 10.0
    assert best.x[1, 0] == -5.0
    assert np.isinf(best.objective[1])


def test_a_step_is_no_longer_than_it_may_be_and_ends_inside() -> None:
    trials: list[float] = []

    def linearise(chosen: IntArray, x: Array, warm: Array) -> Linearised:
        trials.append(float(x[0, 0]))
        return Linearised(10.0 * (5.0 - x), np.full((1, 1, 1), 10.0), everywhere(chosen), warm)

    search = SearchLimits(longest=np.array([0.5]), within=(-np.inf, 2.0))
    best = found(linearise, np.zeros((1, 1)), np.zeros(1), np.full(1, 1e3), search)
    assert np.max(np.abs(np.diff(trials))) <= 0.5 + 1e-12
    assert best.x[0, 0] == 2.0


def test_unknowns_at_a_bound_stay_there_and_the_others_are_found_in_few_steps() -> None:
    rng = np.random.default_rng(1)
    a, bound, looks = rng.normal(size=(6, 2)), np.array([1.0, np.inf]), [0]
    y = a @ np.array([3.0, -1.0])

    def linearise(chosen: IntArray, x: Array, warm: Array) -> Linearised:
        looks[0] += 1
        return Linearised(y - x @ a.T, a[None].copy(), everywhere(chosen), warm)

    best = found(linearise, np.zeros((1, 2)), np.zeros(2), np.full(2, 1e3), SearchLimits(within=(-bound, bound)))
    other = np.linalg.lstsq(a[:, 1:], y - a[:, 0], rcond=None)[0]
    np.testing.assert_allclose(best.x[0], [1.0, other[0]], rtol=1e-6)
    assert best.converged[0]
    assert looks[0] <= 4
