"""The way down to the maximum: own forces, and trials that are brought back to a bent valley."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning import optimizer as descent, prediction
from onebend.learning.linear import (
    FitProblem,
    Hyperparameters,
    RecordingNoise,
    data_information,
    prior,
    split_off_force,
    tag_score,
)
from onebend.learning.optimizer import (
    MapEstimate,
    _Linearised,
    _moved,
    _trial,
    _with_slopes_kept,
    descend,
    estimate_at,
    rows_of,
    with_own_forces,
)
from tests.learning.inference.test_hyperparameters import evidence_of


def far_off(marker: float = 1.3, k: float = 0.06) -> tuple[FitProblem, Hyperparameters, MapEstimate]:
    """An estimate far from the maximum: an even beam of stiffness k [N m], where it is about 0.03."""
    evidence, expected = evidence_of(1)
    exact = replace(expected, noise=(RecordingNoise(marker, expected.noise[0].force),))
    x = np.zeros(evidence.problem.layout.size)
    x[:8] = np.log(k)
    return evidence.problem, exact, replace(estimate_at(evidence.problem, x), hyperparameters=exact)


def linearised(problem: FitProblem, hyperparameters: Hyperparameters, estimate: MapEstimate) -> _Linearised:
    before = prior(problem, hyperparameters)
    return _Linearised(problem, estimate, before, rows_of(estimate))


def test_each_frames_own_force_is_settled_with_all_else_held() -> None:
    problem, hyperparameters, estimate = far_off(20.0)
    here = linearised(problem, hyperparameters, estimate)
    settled = with_own_forces(estimate)
    np.testing.assert_array_equal(settled.x, estimate.x)
    assert here.cost(settled) < here.cost(estimate)
    (rows,), (now,), (noise,) = rows_of(settled), settled.predictions, hyperparameters.noise
    wanted = split_off_force(rows, rows.r, noise)[1]
    assert np.max(np.abs(wanted)) > 1e-4
    np.testing.assert_allclose(now.own, wanted, atol=0.03 * float(np.max(np.abs(wanted))))


def test_the_slope_is_that_of_the_cost() -> None:
    problem, hyperparameters, estimate = far_off()
    here = linearised(problem, hyperparameters, estimate)
    data = data_information(problem, here.rows, estimate.x, hyperparameters)
    whole = here.before.transposed_times(data.vector - data.times(estimate.x)) - here.before.whiten(estimate.x)
    np.testing.assert_allclose(here.slope, whole, rtol=1e-8, atol=1e-8 * float(np.max(np.abs(whole))))
    (rows,), (noise,) = here.rows, hyperparameters.noise
    twice = tag_score(rows, 2.0 * rows.r, noise)
    np.testing.assert_allclose(twice, 2.0 * tag_score(rows, rows.r, noise))


def test_a_trial_is_brought_back_to_its_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exact tags: a straight step along the valley that they leave misses them by many sd."""
    problem, hyperparameters, estimate = far_off(0.0005, 0.01)
    for _ in range(2):  # into the valley
        here = linearised(problem, hyperparameters, estimate)
        estimate, _ = _trial(here, 1.0, here.cost(estimate))
    here = linearised(problem, hyperparameters, estimate)
    cost = here.cost(estimate)
    _, corrected = _trial(here, 1.0, cost)
    monkeypatch.setattr(descent, "_CORRECTIONS", 0)
    _, straight = _trial(here, 1.0, cost)
    assert straight > cost
    assert corrected < 0.1 * cost


def test_many_recordings_keep_derivatives_on_the_way_and_end_with_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, hyperparameters, estimate = far_off()
    before, counts = prior(problem, hyperparameters), []
    counted, original = [0], prediction._slopes

    def slopes(now: prediction.Prediction) -> prediction.Slopes:
        counted[0] += 1
        return original(now)

    monkeypatch.setattr(prediction, "_slopes", slopes)
    found = []
    for together in (10.0, 0.99):  # one recording is then more than that
        monkeypatch.setattr(descent, "_TOGETHER", together)
        counted[0] = 0
        found.append(descend(problem, estimate, before, 60, 1e-4))
        counts.append((counted[0], found[-1].steps))
    (every, _), (some, steps) = counts
    assert some < min(every, steps)  # fewer than it takes steps
    assert all(one.converged and one.predictions[0].nearby is None for one in found)
    first, second = (before.whiten(one.x) for one in found)
    np.testing.assert_allclose(first, second, atol=5e-3)


def test_derivatives_are_kept_where_the_tags_go_as_they_say() -> None:
    problem, hyperparameters, estimate = far_off()
    estimate = with_own_forces(estimate)
    here = linearised(problem, hyperparameters, estimate)
    step = here.before.times(here.solved(1.0).solve(here.slope))
    kept = []
    for share in (1e-3, 1.0):
        tried = _moved(here, estimate, [rows.r for rows in here.rows], share * step)
        (now,) = _with_slopes_kept(here, tried).predictions
        kept.append(now.nearby is here.rows[0].whitened)
        assert now.nearby is None or now.whitened_slopes is now.nearby
        assert replace(now, nearby=None).whitened_slopes is not here.rows[0].whitened
    assert kept == [True, False]
