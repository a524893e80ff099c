"""The live learner from end to end: its answer against the batch fit, an honest band, bad tags, what it tells."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from onebend.beam.stiffness import LogSpline
from onebend.errors import LearningError
from onebend.learning.parameters import Spline
from onebend.learning.posterior import fit
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner
from onebend.live.replayed import replay
from onebend.records import Array, ForceNoise, Observations, StatedSection
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.learning.test_posterior import wrong_force
from tests.live.streamed_recording import IDEAL_LIVE, NOISE, PLAIN, S, any_beam, drawn, smooth_beam

SIZES = ForceNoise(white=0.001, coloured=0.003, tau=0.3, walk=1e-6, load=1e-9)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_live_and_batch_agree(seed: int) -> None:
    made = wrong_force(observed(SOFT, forces(120), noise=NOISE, seed=seed), seed, 0.005)
    batch = fit([made], 0.03, settings=replace(IDEAL, functions=12)).stiffness.log_at(S)
    learner = replay(made, 0.06, settings=replace(IDEAL_LIVE, functions=12))
    live = learner.stiffness.log_at(S)
    assert np.sqrt(np.mean(((live[0] - batch[0]) / batch[1]) ** 2)) < 1.0
    assert 0.7 < np.median(live[1]) / np.median(batch[1]) < 2.0  # after 120 frames the scales are still on their way
    learner.settle()
    settled = learner.stiffness.log_at(S)
    assert 0.75 < np.median(settled[1]) / np.median(batch[1]) < 1.5
    assert np.sqrt(np.mean(np.expm1(live[0] - np.log(SOFT.stiffness(S))) ** 2)) < 0.05


def squared_error(made: Observations, log_k: Array, settings: OnlineSettings) -> float:
    """Of log k at three places, in units of its band; chi-square with three degrees where the band is right."""
    places = np.array([0.15, 0.4, 0.65])
    one = replay(made, 0.03, settings=settings).stiffness
    basis = one.basis(places)
    away = basis @ one.mean - np.log(LogSpline(tuple(Spline(8).knots), tuple(log_k))(places))
    return float(away @ np.linalg.solve(basis @ one.covariance @ basis.T, away))


@pytest.mark.slow
def test_error_over_band_is_chi_square_over_seeds() -> None:
    """Sums over 5 beams, within the 99.9 % limits. The sizes are those that beams and errors are drawn with: a band
    that is averaged over all sizes that might be is right on the average over such beams (below), and too wide for
    even ones."""
    settings = replace(IDEAL_LIVE, functions=8, roughness=3.0, steps=0.1, adapt=False, marker_noise=1.0)
    settings, total, seeds = replace(settings, force=SIZES), 0.0, 5
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        log_k = smooth_beam(rng)
        total += squared_error(drawn(log_k, rng, 60, (0.003, 0.3, 0.001)), log_k, settings)
    assert chi2.ppf(0.0005, 3 * seeds) < total < chi2.ppf(0.9995, 3 * seeds)


@pytest.mark.slow
def test_so_it_is_where_all_sizes_are_drawn_and_learned() -> None:
    settings, total, seeds = replace(IDEAL_LIVE, functions=8, marker_noise=1.0), 0.0, 6
    settings = replace(settings, force=SIZES)
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        log_k = any_beam(rng)
        coloured, memory, white = np.array([0.003, 0.3, 0.001]) * np.exp([0.7, 0.9, 0.7] * rng.normal(size=3))
        total += squared_error(drawn(log_k, rng, 60, (coloured, memory, white)), log_k, settings)
    assert chi2.ppf(0.0005, 3 * seeds) < total < chi2.ppf(0.9995, 3 * seeds)


def test_outliers_are_named_and_do_not_move_the_answer() -> None:
    made = wrong_force(observed(SOFT, forces(90), noise=NOISE, seed=5), 5, 0.004)
    xy = made.xy.copy()
    wild = np.arange(20, 90, 9)
    xy[wild, wild % 3] += 0.02
    clean = replay(made, 0.03, settings=replace(IDEAL_LIVE, functions=10)).stiffness.log_at(S)
    learner = OnlineLearner(
        made.length,
        MARKERS,
        0.03,
        settings=replace(IDEAL_LIVE, functions=10),
    )
    refused = []
    for t in range(90):
        refused.append(~learner.update(made.time[t], xy[t], made.angle[t], made.covariance[t], made.force[t]).accepted)
    assert {(int(t), int(i)) for t, i in np.argwhere(refused)} >= {(int(t), int(t % 3)) for t in wild}
    dirty = replay(replace(made, xy=xy), 0.03, settings=replace(IDEAL_LIVE, functions=10)).stiffness.log_at(S)
    assert np.max(np.abs(dirty[0] - clean[0]) / clean[1]) < 0.7


def test_a_missing_tag_is_as_one_of_no_weight_and_whole_turns_do_not_matter() -> None:
    """No error comes with the load (`force_sd` zero): where the load turns, all tags tell, whatever their weight."""
    made = replace(observed(SOFT, forces(50), noise=NOISE, seed=2), force_sd=np.zeros(2))
    gone = np.random.default_rng(0).uniform(size=made.angle.shape) < 0.3
    xy, spread = made.xy.copy(), made.covariance.copy()
    xy[gone, 0] = np.nan
    spread[gone] *= 1e16
    missing = replay(replace(made, xy=xy, angle=made.angle + 2.0 * np.pi), 0.03, settings=PLAIN).stiffness
    weak = replay(replace(made, covariance=spread), 0.03, settings=PLAIN).stiffness
    np.testing.assert_allclose(missing.log_at(S), weak.log_at(S), atol=1e-7)


@pytest.mark.slow
def test_learning_goes_on_from_what_a_fit_has_found() -> None:
    made = wrong_force(observed(SOFT, forces(60), noise=NOISE, seed=6), 6, 0.004)
    found = fit([made], 0.03, settings=replace(IDEAL, functions=10)).stiffness
    learner = OnlineLearner(made.length, MARKERS, found, settings=replace(IDEAL_LIVE, functions=10))
    np.testing.assert_allclose(learner.stiffness.log_at(S)[0], found.log_at(S)[0], rtol=1e-6)
    np.testing.assert_allclose(learner.stiffness.log_at(S)[1], found.log_at(S)[1], rtol=0.15)  # less where a step lies
    again = wrong_force(observed(SOFT, forces(60), noise=NOISE, seed=7), 7, 0.004)
    more = replay(again, found, settings=replace(IDEAL_LIVE, functions=10)).stiffness
    assert np.all(more.log_at(S)[1] < 1.001 * found.log_at(S)[1])


def test_a_fit_of_more_functions_is_gone_on_from_as_it_stands() -> None:
    o = observed(SOFT, forces(30), noise=NOISE, seed=3)
    found = fit([o], 0.02, settings=IDEAL).stiffness
    learner = OnlineLearner(o.length, MARKERS, found)
    (mean, sd), (began, spread) = (one.log_at(S) for one in (found, learner.stiffness))
    known = found.band(S).identified
    assert len(found.mean) > learner.settings.functions
    np.testing.assert_allclose(began[known], mean[known], atol=0.3 * float(np.min(sd)))
    np.testing.assert_allclose(spread[known], sd[known], rtol=0.3)
    with pytest.raises(LearningError, match="fewer than the 45"):
        OnlineLearner(o.length, MARKERS, fit([o], 0.02, settings=replace(IDEAL, functions=8)).stiffness)


def test_a_fit_that_goes_with_its_section_is_gone_on_from() -> None:
    size = np.array([0.006, 0.005, 0.0055])
    section = StatedSection("circle", np.array([0.0, 0.5, 1.0]), size, size)
    o = observed(SOFT, forces(12), noise=NOISE, seed=3)
    stated = replace(o, stated=replace(o.stated, stiffness_along="section", section=section))
    found = fit([stated], settings=replace(IDEAL, functions=20)).stiffness
    learner = OnlineLearner(o.length, MARKERS, found, settings=replace(IDEAL_LIVE, functions=20))
    np.testing.assert_allclose(learner.stiffness.log_at(S)[0], found.log_at(S)[0], atol=0.02)


def test_results_speak_of_the_beam_and_of_what_else_was_learned() -> None:
    few = replace(IDEAL_LIVE, functions=8)
    learner = replay(observed(SOFT, forces(40), noise=NOISE), 0.03, gain_sd=0.1, settings=few)
    names = {n.name: n for n in learner.nuisances()}
    assert {"tag 1 along", "tag 3 turn", "clamp angle"} <= set(names)
    assert all(0.0 < n.sd <= 1.001 * n.prior_sd for n in names.values())
    assert learner.stiffness.gain_sd == 0.1
    np.testing.assert_allclose(learner.beam.stiffness(S), np.exp(learner.stiffness.log_at(S)[0]))


@pytest.mark.slow
def test_the_pages_example_runs() -> None:
    page = (Path(__file__).parents[3] / "docs" / "live.md").read_text(encoding="utf-8")
    example = re.findall(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)[1]
    names: dict[str, object] = {}
    exec(example, names)
    learner = names["learner"]
    assert isinstance(learner, OnlineLearner)
    assert learner.frames > 100
    every = set(OnlineSettings.__dataclass_fields__)
    assert every == set(re.findall(r"^\| `(\w+)` \|", page, flags=re.MULTILINE))
