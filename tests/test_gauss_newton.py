"""The most probable values of a few unknowns, in many problems at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from onebend.gauss_newton import DampedSteps, Look, MostProbable, Outlook, most_probable
from onebend.records import Array, BoolArray, IntArray


def found(look: Look, x: Array, mean: Array, sd: Array, search: DampedSteps = DampedSteps()) -> MostProbable:
    nothing = np.zeros((len(x), 0))
    return most_probable(look, look(np.arange(len(x)), x, nothing), x, mean, sd, search)


def everywhere(rows: IntArray) -> BoolArray:
    return np.ones(len(rows), dtype=bool)


@pytest.mark.parametrize("rows", [2, 7])
def test_a_linear_problem_gives_the_textbook_posterior(rows: int) -> None:
    """With fewer data than unknowns too."""
    rng = np.random.default_rng(0)
    a, y, mean, sd = rng.normal(size=(5, rows, 3)), rng.normal(size=(5, rows)), np.array([1.0, 0.0, -2.0]), np.ones(3)
    sd = np.array([0.5, 2.0, 1e3])

    def look(chosen: IntArray, x: Array, near: Array) -> Outlook:
        return Outlook(y[chosen] - (a[chosen] @ x[..., None])[..., 0], a[chosen].copy(), everywhere(chosen), near)

    best = found(look, np.zeros((5, 3)), mean, sd, DampedSteps(last=1e-9))
    precision = np.swapaxes(a, 1, 2) @ a + np.diag(sd**-2)
    right = np.swapaxes(a, 1, 2) @ y[..., None] + (mean / sd**2)[:, None]
    np.testing.assert_allclose(best.x, np.linalg.solve(precision, right)[..., 0], rtol=1e-6)
    covariance = best.root @ np.swapaxes(best.root, 1, 2)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-7)
    np.testing.assert_allclose(best.by_residual(best.root), covariance @ np.swapaxes(a, 1, 2), rtol=1e-7, atol=1e-12)
    assert best.settled.all()


def rosenbrock(x: Array) -> tuple[Array, Array]:
    value = np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=1)
    slopes = np.zeros((len(x), 2, 2))
    slopes[:, 0, 0], slopes[:, 0, 1], slopes[:, 1, 0] = -20.0 * x[:, 0], 10.0, -1.0
    return value, slopes


def test_a_curved_valley_is_followed_to_the_minimum_that_scipy_finds() -> None:
    """Each of the problems with its own damping."""
    starts, sd = np.array([[-1.2, 1.0], [3.0, -2.0], [0.0, 0.0]]), np.array([2.0, 3.0])

    def look(chosen: IntArray, x: Array, near: Array) -> Outlook:
        value, slopes = rosenbrock(x)
        return Outlook(-value, slopes, everywhere(chosen), near)

    best = found(look, starts, np.zeros(2), sd, DampedSteps(steps=200, last=1e-9))
    exact = least_squares(lambda x: np.append(rosenbrock(x[None])[0][0], x / sd), starts[0], xtol=1e-14, ftol=1e-14).x
    np.testing.assert_allclose(best.x, np.tile(exact, (3, 1)), atol=1e-7)


def test_no_step_goes_where_a_problem_has_no_solution_and_one_without_any_stays() -> None:
    """log x = 3, seen where x < 10 alone."""

    def look(_: IntArray, x: Array, near: Array) -> Outlook:
        stands = np.asarray((x[:, 0] > 0.0) & (x[:, 0] < 10.0))
        safe = np.where(stands[:, None], x, 1.0)
        return Outlook(100.0 * (3.0 - np.log(safe)), 100.0 / safe[..., None], stands, near)

    best = found(look, np.array([[1.0], [-5.0]]), np.zeros(1), np.full(1, 1e3))
    assert 9.0 < best.x[0, 0] < 10.0
    assert best.x[1, 0] == -5.0
    assert np.isinf(best.objective[1])


def test_a_step_is_no_longer_than_it_may_be_and_ends_inside() -> None:
    trials: list[float] = []

    def look(chosen: IntArray, x: Array, near: Array) -> Outlook:
        trials.append(float(x[0, 0]))
        return Outlook(10.0 * (5.0 - x), np.full((1, 1, 1), 10.0), everywhere(chosen), near)

    search = DampedSteps(longest=np.array([0.5]), inside=lambda x: np.minimum(x, 2.0))
    best = found(look, np.zeros((1, 1)), np.zeros(1), np.full(1, 1e3), search)
    assert np.max(np.abs(np.diff(trials))) <= 0.5 + 1e-12
    assert best.x[0, 0] == 2.0
