"""When the optimizer's rounds and steps end, and what they lower."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from onebend.learning import linear, optimizer
from onebend.learning.linear import (
    FitProblem,
    Hyperparameters,
    RecordingNoise,
    data_information,
    prior,
    residual_rows,
    residuals,
    solved,
)
from onebend.learning.optimizer import (
    MapEstimate,
    OptimizerSettings,
    _at_mean_stiffness,
    _coarse,
    _misfit,
    carried_over,
    descend,
    estimate_at,
    find_maximum,
    first_problem,
)
from onebend.learning.parameters import Layout, Spline
from onebend.progress import Silent
from onebend.records import Array
from tests.learning.bench import IDEAL, SOFT, observed
from tests.learning.inference.test_hyperparameters import evidence_of

SETTINGS = OptimizerSettings(rounds=20)


class Rounds:
    """The optimizer's rounds, with the noise that each of them finds written down beforehand."""

    def __init__(self, patch: pytest.MonkeyPatch, noise: list[tuple[float, ...]]) -> None:
        self.tolerances: list[float] = []
        self.noise = iter(noise)
        first = Hyperparameters(np.ones(1), 1.0, 1.0, 1.0, 1.0, tuple(RecordingNoise(9.0, 0.1) for _ in noise[0]))
        self.problem = FitProblem((), Layout(Spline(8), (), 0), 0.0, first)
        patch.setattr(linear, "prior", lambda *_: None)
        patch.setattr(optimizer, "_coarse", lambda problem, _: problem.expected)
        patch.setattr(optimizer, "descend", self.descend)
        patch.setattr(optimizer, "_new_hyperparameters", self.new_hyperparameters)

    def descend(self, _: FitProblem, estimate: MapEstimate, *rest: object) -> MapEstimate:
        tolerance = rest[-1]
        assert isinstance(tolerance, float)
        self.tolerances.append(tolerance)
        return estimate

    def new_hyperparameters(self, problem: FitProblem, _: MapEstimate) -> Hyperparameters:
        return replace(problem.expected, noise=tuple(RecordingNoise(one, 0.1) for one in next(self.noise)))

    def run(self) -> list[float]:
        """Tolerances of the rounds."""
        find_maximum(self.problem, MapEstimate(np.zeros(0), self.problem.expected, ()), SETTINGS, Silent())
        return self.tolerances


def markers(*changes: float) -> list[float]:
    """Noise that begins at 2 and changes by these in its log."""
    return [float(noise) for noise in 2.0 * np.exp(np.cumsum([0.0, *changes]))]


def test_rounds_go_on_until_the_noise_is_steady(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = Rounds(monkeypatch, [(one,) for one in markers(-0.6, -0.3, 0.15, -0.05, 0.0)])
    # two coarse rounds, one more that finds the first noise, four until it is steady, and the last
    assert rounds.run() == [SETTINGS.on_the_way] * 7 + [SETTINGS.tolerance]


def test_the_noise_of_every_recording_has_to_be_steady(monkeypatch: pytest.MonkeyPatch) -> None:
    quiet, wild = markers(0.0, 0.0, 0.0, 0.0), markers(0.3, -0.3, 0.05, 0.0)
    assert len(Rounds(monkeypatch, list(zip(quiet, wild, strict=True))).run()) == 7


def test_noise_that_never_settles_does_not_keep_the_rounds_going(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = Rounds(monkeypatch, [(one,) for one in markers(*[0.5] * 20)])
    assert rounds.run() == [SETTINGS.on_the_way] * 19 + [SETTINGS.tolerance]


def test_residuals_and_own_forces_count_by_their_densities() -> None:
    rng = np.random.default_rng(0)
    (r, other), (own, none) = rng.standard_normal((2, 5, 9)), 0.02 * rng.standard_normal((2, 5, 2))
    noise = RecordingNoise(1.7, 0.03)

    def log_density(residual: Array, force: Array) -> float:
        return float(np.sum(norm(scale=1.7).logpdf(residual)) + np.sum(norm(scale=0.03).logpdf(force)))

    difference = _misfit(r, own, noise) - _misfit(other, none, noise)
    assert difference == pytest.approx(-2.0 * (log_density(r, own) - log_density(other, none)), rel=1e-9)


def test_a_search_ends_where_a_step_further_gains_next_to_nothing() -> None:
    evidence, expected = evidence_of(1)
    problem = evidence.problem
    start = np.zeros(problem.layout.size)
    start[:8] = np.log(0.04)
    before = prior(problem, expected)
    settled = descend(problem, estimate_at(problem, start), before, 60, 0.02)
    assert settled.converged
    assert settled.steps < 15
    rows = [residual_rows(settled.predictions[0], expected.noise[0])]
    data = data_information(problem, rows, settled.x, expected)
    step = before.whiten(solved(data, before).mean) - before.whiten(settled.x)
    moved = before.times(step)
    gain = step @ step + moved @ data.times(moved)
    assert gain < 0.02**2


def test_the_answer_is_at_the_mean_of_log_k_with_all_else_refitted() -> None:
    evidence, expected = evidence_of(1)
    problem = evidence.problem
    start = np.zeros(problem.layout.size)
    start[:8] = np.log(0.02)
    settled = descend(problem, estimate_at(problem, start), prior(problem, expected), 60, 0.02)
    wanted = settled.x[:8] + 0.05 * np.cos(np.arange(8))
    x, predictions = _at_mean_stiffness(problem, settled, wanted, evidence.posterior(expected).covariance)
    np.testing.assert_allclose(x[:8], wanted, atol=1e-4)
    assert np.max(np.abs(x[8:] - settled.x[8:])) > 1e-6
    np.testing.assert_array_equal(predictions[0].x, x)


def test_all_frames_stay_in_the_equilibria_that_a_few_of_them_have_found() -> None:
    """Beyond the buckling load there are two. From rest a slight force to the right leads to that on the right."""
    load = np.linspace(3.5, 4.5, 30) * 0.02 / SOFT.length
    made = observed(SOFT, np.stack([-load, -1e-3 * load], axis=1), noise=(1e-5, 1e-3))
    (few, x), (whole, start) = (first_problem([made], 0.02, replace(IDEAL, first_frames=n)) for n in (6, 30))

    def tips(estimate: MapEstimate) -> list[bool]:
        return [bool(left) for left in estimate.predictions[0].pose[: len(load), -1, 1] > 0.0]

    on_the_right = estimate_at(few, x)
    assert not any(tips(on_the_right) + tips(estimate_at(whole, start)))
    on_the_left = estimate_at(few, x, [-on_the_right.predictions[0].solved.q])
    on_the_left = replace(on_the_left, hyperparameters=few.expected)
    assert all(tips(on_the_left)[:6])
    assert all(tips(carried_over(few, on_the_left, whole, [0])))


def test_far_from_the_maximum_the_tags_noise_is_that_of_their_residuals() -> None:
    evidence, expected = evidence_of(1)
    problem = evidence.problem
    far = np.zeros(problem.layout.size)
    far[:8] = np.log(0.04)
    now = estimate_at(problem, far).predictions
    noise = _coarse(problem, now).noise[0]
    assert noise.marker == pytest.approx(np.sqrt(np.mean(residuals(now[0]) ** 2)))
    assert noise.force == expected.noise[0].force
    exact = replace(now[0], pose=now[0].data.measured)
    assert _coarse(problem, (exact,)).noise[0].marker == 1.5
