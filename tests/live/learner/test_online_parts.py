"""Parts of the live learner against the fit: the load's own time, and the hyperparameters of log k's prior."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import truncnorm

from onebend.learning.allowances import NO_THICKNESS
from onebend.learning.hyperparameters import SPREAD, at_nodes
from onebend.learning.linear import Solved
from onebend.learning.normal import Draws, InformationForm, drawn_chains, target_of
from onebend.learning.parameters import Spline
from onebend.live import posterior
from onebend.live.hyperparameters import OnlineSettings, StiffnessChains
from onebend.live.key_frames import LoadStages
from onebend.live.learner import OnlineLearner
from onebend.live.model import Lineariser
from onebend.live.posterior import KeyFrameModel, model_of
from onebend.recording.force_noise import ANEW, RELEASED, load_changes, own_time
from onebend.records import Array
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.live.streamed_recording import NOISE, S, shown


def test_the_loads_own_time_is_the_whole_recordings() -> None:
    """Two pushes, one with a small give that is no reversal and one with a reversal that is."""
    way = [0.0] * 9 + [*np.linspace(0.001, 0.04, 40), *np.linspace(0.0395, 0.0385, 5), *np.linspace(0.039, 0.05, 20)]
    way += [*np.linspace(0.0495, 0.02, 30), *np.linspace(0.0205, 0.04, 25), *np.linspace(0.039, 0.001, 30)] + [0.0] * 12
    size = np.array(way)
    time, loaded = np.arange(len(size)) / 30.0, size > 0.0
    stages, seen = LoadStages(0.15, 1), np.array([True])
    for t, d, on in zip(time, size, loaded, strict=True):
        stages.add_frame(float(t), np.array([[0.0, d]]), seen, bool(on))
    changes = load_changes(time, size, loaded)
    assert sum(one.release for one in changes) == 1
    whole = own_time(changes, time)
    late = time > 0.5  # the largest displacement was not known from the start
    np.testing.assert_allclose(stages.own(time)[late], whole[late], atol=0.35)
    assert np.mean(np.abs(stages.own(time) - whole)) < 0.05


def test_what_a_load_did_long_ago_is_kept() -> None:
    stages, seen = LoadStages(0.15, 1), np.array([True])
    for t in range(400):
        d = 0.04 * abs(np.sin(2.0 * np.pi * t / 40.0))
        stages.add_frame(t / 30.0, np.array([[0.0, d]]), seen, d > 0.002)
    assert stages.own(np.array([400 / 30.0]))[0] == pytest.approx(20 * ANEW * 2 + 20 * RELEASED, rel=0.05)


@pytest.mark.slow
def test_sizes_drawn_on_the_way_are_those_that_the_fit_draws() -> None:
    """The geometric means of the last draws, against those of many chains."""
    spline, rng = Spline(10), np.random.default_rng(3)
    truth = np.where(np.arange(10) < 5, 0.0, 0.4)
    rows = 15.0 * rng.normal(size=(12, 10))
    form = InformationForm(rows.T @ rows, rows.T @ (rows @ truth + rng.normal(size=12)))
    chains, parts = StiffnessChains(spline, 0.0, 3.0, 0.1), []
    for i in range(400):
        chains.step(form)
        parts += [np.log(chains.parts)] if i >= 50 else []
    draws = list(drawn_chains(target_of(spline, [form], 0.0, 30), Draws(30, 60, 300), None))
    means = np.mean([np.log(one.variance).mean(axis=0) for one in draws], axis=0)
    np.testing.assert_allclose(np.mean(parts, axis=0), means, atol=0.6)


@pytest.mark.slow
def test_sizes_of_the_force_error_by_their_evidence() -> None:
    """Its slope against differences, its nodes against those of the fit, and a step that raises it."""
    made = observed(SOFT, forces(40), noise=NOISE, seed=1)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=OnlineSettings(functions=8))
    shown(learner, made, range(40))
    learner._state.catch_up()
    solution, h = learner._state.solution, 1e-4
    evidence, sizes = solution.model.evidence, solution.hyperparameters
    cost, z = evidence.cost(sizes), evidence.place(sizes)
    slope, curvature = solution.of_sizes(evidence)
    differences = [(cost(z + h * e) - cost(z - h * e)) / (2.0 * h) for e in np.eye(len(z))]
    np.testing.assert_allclose(slope, differences, rtol=5e-3, atol=5e-3)
    of_data = curvature - np.eye(len(z))
    np.testing.assert_allclose(of_data, of_data.T, atol=1e-9)
    assert np.min(np.linalg.eigvalsh(of_data)) > -1e-9
    assert cost(evidence.place(solution.likelier(sizes, 0.05))) < cost(z)
    of_others = replace(evidence, spread=evidence.spread[: len(SPREAD)])

    def moments(nodes: Iterable[tuple[Solved, float]]) -> tuple[Array, Array]:
        every = list(nodes)
        mean = sum(w * one.mean[:8] for one, w in every)
        return np.asarray(mean), np.sqrt(np.diag(sum(w * one.of_shared[:8, :8] for one, w in every)))

    (mean, sd), (fits, wide) = moments(solution.at_nodes(len(SPREAD))), moments(at_nodes(of_others, sizes, [{}]))
    assert sum(w for _, w in solution.at_nodes(len(SPREAD))) == pytest.approx(1.0)
    np.testing.assert_allclose(mean, fits, atol=float(0.1 * np.min(wide)))
    np.testing.assert_allclose(sd, wide, rtol=0.1)


@pytest.mark.slow
def test_a_beam_that_does_not_stretch_is_not_taken_to_stretch_less_than_not_at_all() -> None:
    """Mean and variance of the section's change are those of what the frames say, cut off at its bound."""
    made = observed(SOFT, forces(40), noise=NOISE, seed=2)  # without the bound -1.2
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=OnlineSettings(functions=8))
    shown(learner, made, range(40))
    learner.settle(4)
    (block,), (site,) = learner._session.bounded, learner._state._sites
    (found,) = (one for one in learner.nuisances() if one.name == block.labels[0])
    told = 1.0 / found.sd**2 - 1.0 / site[1][0] ** 2 + 1.0 / block.prior_sd[0] ** 2
    middle = (found.value / found.sd**2 - site[0][0] / site[1][0] ** 2) / told
    cut = truncnorm((NO_THICKNESS - middle) * np.sqrt(told), np.inf, middle, 1.0 / np.sqrt(told))
    assert middle < NO_THICKNESS < found.value
    assert found.value == pytest.approx(cut.mean(), abs=0.05)
    assert found.sd == pytest.approx(cut.std(), rel=0.3)


@pytest.mark.slow
def test_reading_changes_nothing() -> None:
    made, few = observed(SOFT, forces(40), noise=NOISE, seed=1), OnlineSettings(functions=8)
    read, quiet = (OnlineLearner(made.length, MARKERS, 0.03, settings=few) for _ in range(2))
    for t in range(40):
        shown(read, made, range(t, t + 1))
        if t % 2:  # solved for already: reading has nothing to catch up with
            continue
        np.testing.assert_array_equal(read.stiffness.log_at(S), read.stiffness.log_at(S))
    shown(quiet, made, range(40))
    np.testing.assert_array_equal(read.stiffness.log_at(S), quiet.stiffness.log_at(S))


@pytest.mark.slow
def test_no_frame_costs_much_more_than_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """At most one solution a frame; none where many key frames are linearised, and it rests on one point of them all: a
    mismatch of two points would look like information."""
    counts = {"solved": 0, "linearised": 0}
    renew, model = Lineariser.renew, model_of

    def made_of(*given: Any) -> KeyFrameModel:
        counts["solved"] += 1
        assert not np.any(learner._state.keys.stale[: learner._state.keys.used])
        return model(*given)

    def renewed(self: Lineariser, keys: object, chosen: list[int], point: Array) -> set[int]:
        counts["linearised"] = len(chosen)
        return renew(self, keys, chosen, point)  # type: ignore[arg-type]

    made = observed(SOFT, forces(100), noise=NOISE, seed=2)
    learner = OnlineLearner(made.length, MARKERS, 0.06, settings=OnlineSettings(functions=8))
    monkeypatch.setattr(posterior, "model_of", made_of)
    monkeypatch.setattr(Lineariser, "renew", renewed)
    many = []
    for t in range(100):
        counts["solved"] = 0
        shown(learner, made, range(t, t + 1))
        many.append(counts["linearised"])
        assert counts["solved"] <= (1 if many[-1] <= 6 else 0)
    assert 30 <= max(many) <= 34  # all at once
    assert np.mean(np.array(many[50:]) > 6) < 0.2
