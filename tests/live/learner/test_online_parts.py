"""Parts of the live learner against the fit: the load's own time, and the hyperparameters of log k's prior."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.normal import Draws, InformationForm, stiffness_mixture
from onebend.learning.parameters import Spline
from onebend.live import learner as smoother
from onebend.live.hyperparameters import OnlineSettings, StiffnessChains
from onebend.live.key_frames import LoadStages
from onebend.live.learner import OnlineLearner
from onebend.live.model import Lineariser
from onebend.live.posterior import KeyFramePosterior, KeyFrameSums, LiveHyperparameters, LivePrior, solve
from onebend.recording.force_noise import ANEW, RELEASED, load_changes, own_time
from onebend.records import Array, ForceNoise
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


def test_sizes_drawn_on_the_way_give_the_fits_log_k() -> None:
    """Against `stiffness_mixture`, whose chains are many."""
    spline, rng = Spline(10), np.random.default_rng(3)
    truth = np.where(np.arange(10) < 5, 0.0, 0.4)
    rows = 15.0 * rng.normal(size=(12, 10))
    form = InformationForm(rows.T @ rows, rows.T @ (rows @ truth + rng.normal(size=12)))
    chains = StiffnessChains(spline, 0.0, 3.0, 0.1)
    for _ in range(200):
        chains.step(form)
    means, sds = [], []
    for _ in range(20):
        for _ in range(5):
            chains.step(form)
        mean, covariance, _ = chains.mixed(form)
        means.append(mean)
        sds.append(np.sqrt(np.diag(covariance)))
    batch = stiffness_mixture(spline, [form], 0.0, Draws(30, 60, 300))
    sd = np.sqrt(np.diag(batch.covariance))
    np.testing.assert_allclose(np.mean(means, axis=0), batch.mean, atol=0.2 * float(np.max(sd)))
    np.testing.assert_allclose(np.mean(sds, axis=0), sd, rtol=0.2)


@pytest.mark.parametrize("rows", [0, 3, 20])
def test_the_directions_that_are_told_of_are_all_that_is_told(rows: int) -> None:
    """As many rows as the information has directions give it back, and its right side."""
    spline, rng = Spline(10), np.random.default_rng(rows)
    seen, level = 5.0 * rng.normal(size=(rows, 10)), -3.0
    form = InformationForm(seen.T @ seen, seen.T @ rng.normal(size=rows))
    on_log_k, values = StiffnessChains(spline, level, 3.0, 0.1)._rows(form)
    assert len(values) == min(max(rows, 1), 10)
    np.testing.assert_allclose(on_log_k.T @ on_log_k, form.matrix, atol=1e-9)
    right = form.vector - form.matrix @ np.full(10, level)
    np.testing.assert_allclose(on_log_k.T @ values, right, atol=1e-8)


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


def test_no_frame_costs_much_more_than_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """At most one solution a frame; none where many key frames are linearised, and those are never more than ten."""
    counts = {"solved": 0, "linearised": 0}
    renew = Lineariser.renew

    def solved(
        sums: KeyFrameSums,
        prior: LivePrior,
        stiffness_prior: InformationForm,
        hyperparameters: LiveHyperparameters,
        process: ForceNoise,
    ) -> KeyFramePosterior:
        counts["solved"] += 1
        return solve(sums, prior, stiffness_prior, hyperparameters, process)

    def renewed(self: Lineariser, keys: object, chosen: list[int], point: Array) -> set[int]:
        counts["linearised"] = len(chosen)
        return renew(self, keys, chosen, point)  # type: ignore[arg-type]

    monkeypatch.setattr(smoother, "solve", solved)
    monkeypatch.setattr(Lineariser, "renew", renewed)
    made = observed(SOFT, forces(100), noise=NOISE, seed=2)
    learner = OnlineLearner(made.length, MARKERS, 0.06, settings=OnlineSettings(functions=8))
    many = []
    for t in range(100):
        counts["solved"] = 0
        shown(learner, made, range(t, t + 1))
        many.append(counts["linearised"])
        assert counts["solved"] <= (1 if many[-1] <= 6 else 0)
    assert 6 < max(many) <= 10
