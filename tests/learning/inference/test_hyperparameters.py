"""The evidence for the sizes of the force's error, all else integrated out first, against that of the whole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from onebend.learning.fit_data import fit_data
from onebend.learning.hyperparameters import CHOSEN, Evidence, expected_recording_noise, new_noise
from onebend.learning.linear import (
    FitProblem,
    Hyperparameters,
    RecordingNoise,
    ResidualRows,
    beside_tags,
    data_information,
    residual_rows,
    unweighted_rows,
)
from onebend.learning.parameters import RHO, TAU, Spline, make_layout
from onebend.learning.prediction import Slopes, predict
from onebend.records import Array
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_source

LEVEL = float(np.log(0.02))


def evidence_of(count: int) -> tuple[Evidence, Hyperparameters]:
    """The evidence of `count` recordings of one beam, whose force logs have errors of their own; 0: of one without any
    force."""
    spline, strength = Spline(8), forces(12) * (count > 0)
    made = observed(SOFT, strength, noise=(2e-5, 1e-3))
    stretched = [replace(made, time=(1.0 + 0.2 * i) * made.time) for i in range(max(count, 1))]
    observations = [with_source(o, name=str(i)) for i, o in enumerate(stretched)]
    data = tuple(fit_data(o, i, np.ones(len(o.time), dtype=bool), spline) for i, o in enumerate(observations))
    layout = make_layout(spline, observations, [len(d.error.knots) for d in data])
    x = np.concatenate([LEVEL + 0.3 * np.cos(np.arange(8)), 1e-3 * np.sin(np.arange(layout.size - 8))])
    noise = tuple(RecordingNoise(1.3, 0.003 * (i + 1)) for i in range(len(data)))
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, noise)
    problem = FitProblem(data, layout, LEVEL, expected)
    rows = [residual_rows(predict(d, layout, x, None), n) for d, n in zip(data, noise, strict=True)]
    return Evidence(problem, data_information(problem, rows, x, expected)), expected


@pytest.mark.parametrize("count", [0, 1, 2])
def test_what_is_integrated_out_once_leaves_the_evidence_as_it_is(count: int) -> None:
    evidence, expected = evidence_of(count)
    blocks = evidence.problem.layout.blocks
    assert sum(b.name == "force" and b.start >= 0 for b in blocks) == count
    cost = evidence.cost(expected)
    for z in np.random.default_rng(count).standard_normal((6, 4)):
        whole = 0.5 * float(z @ z) - evidence.posterior(evidence.hyperparameters_at(expected, z)).log_evidence
        assert cost(z) == pytest.approx(whole, rel=1e-8, abs=1e-5)


def test_sizes_of_the_force_error_are_known_to_factors_of_two_to_three() -> None:
    evidence, expected = evidence_of(1)
    sizes = evidence.hyperparameters_at(expected, np.ones(4))
    factors = [getattr(sizes, name) / getattr(expected, name) for name in CHOSEN]
    np.testing.assert_allclose(factors, [2.0, 2.5, 3.0, 3.3, 1.0], rtol=0.05)
    np.testing.assert_allclose(evidence.place(sizes), 1.0)
    far = evidence.hyperparameters_at(expected, np.full(4, 9.0))
    np.testing.assert_allclose(evidence.place(far), 4.0)


def test_before_any_residual_half_the_coloured_force_error_is_each_frames_own() -> None:
    recording = evidence_of(1)[0].problem.recordings[0]
    assert expected_recording_noise(recording) == RecordingNoise(1.5, 0.5 * recording.error.size)


@pytest.mark.parametrize("known", [False, True])
def test_the_noise_of_a_few_points_is_partly_a_guess(known: bool) -> None:
    recording = evidence_of(1)[0].problem.recordings[0]
    static = replace(recording.observations, static=True, sd_known=known)
    r = np.full((4, 9), 0.5)
    slopes = Slopes(np.zeros((4, 9, 0)), np.zeros((4, 9, 2)), np.eye(2), np.zeros((4, 0)))
    rows = ResidualRows(r, slopes, np.ones_like(r), np.ones_like(r))
    noise = new_noise(replace(recording, observations=static), rows, RecordingNoise(1.0, 0.01), 6.0)
    exact = np.sqrt((36 * 0.25 + 3.0) / (30.0 + 3.0))  # a guess of 1 counts for three numbers
    assert noise.marker == pytest.approx(1.0 if known else exact, rel=1e-9)
    assert noise.force == pytest.approx(0.005)


def test_the_effect_of_a_frames_own_force_is_part_of_its_residuals() -> None:
    problem = evidence_of(1)[0].problem
    recording, x = problem.recordings[0], np.zeros(problem.layout.size)
    x[:8] = LEVEL
    own = 1e-4 * np.stack([np.ones(len(recording.force)), -np.ones(len(recording.force))], axis=1)
    with_own, without = (unweighted_rows(predict(recording, problem.layout, x, None, f)) for f in (own, 0.0 * own))
    effect = np.max(np.abs(without.a @ own[..., None]))
    np.testing.assert_allclose(with_own.r, without.r, atol=0.02 * effect)


def test_rows_by_force_are_the_rows_without_the_parameters() -> None:
    problem, noise = evidence_of(1)[0].problem, RecordingNoise(1.3, 0.004)
    x = np.zeros(problem.layout.size)
    x[:8] = LEVEL
    now = predict(problem.recordings[0], problem.layout, x, None)
    found, every = residual_rows(now, noise, now.whitened_by_force), residual_rows(now, noise)
    assert found.slopes.j.shape[-1] == found.slopes.weights.shape[-1] == 0
    np.testing.assert_allclose(found.a, every.a, atol=1e-10 * np.max(np.abs(every.a)))
    np.testing.assert_allclose(found.r, every.r, rtol=1e-8, atol=1e-10)


def test_the_log_in_the_rests_shows_the_slow_error_but_for_what_the_knots_cannot_follow() -> None:
    problem = evidence_of(1)[0].problem
    recording, rng = problem.recordings[0], np.random.default_rng(0)
    knots = len(recording.error.knots)
    weights, values = rng.random((6, knots)), 0.01 * rng.standard_normal((6, 2))
    error = replace(recording.error, rest_weights=weights, rest_values=values)
    rests = replace(problem, recordings=(replace(recording, error=error),))
    where = problem.layout.index["force", 0].where

    def minus_two_log(x: Array) -> float:
        slow = weights @ x[where].reshape(-1, 2)
        return -2.0 * float(np.sum(norm(scale=error.rest_sd).logpdf(values - slow)))

    one, other = 0.01 * rng.standard_normal((2, problem.layout.size))
    here = beside_tags(rests, 0, one)
    told = here.information(one)
    form = [x @ told.matrix @ x - 2.0 * told.vector @ x for x in (one, other)]
    assert form[0] - form[1] == pytest.approx(minus_two_log(one) - minus_two_log(other), rel=1e-9)
    squares = [float(np.sum(beside_tags(rests, 0, x).r ** 2)) for x in (one, other)]
    assert squares[0] - squares[1] == pytest.approx(form[0] - form[1], rel=1e-9)
    slope = told.vector - told.matrix @ one
    np.testing.assert_allclose(here.j.T @ here.r, slope, rtol=1e-9, atol=1e-12 * np.max(np.abs(slope)))
    whole = told.constant + 2.0 * told.log_noise + values.size * np.log(2.0 * np.pi)
    assert whole == pytest.approx(minus_two_log(np.zeros_like(one)), rel=1e-9)
