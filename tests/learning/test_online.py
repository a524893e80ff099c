"""The live learner: its parts against slow textbook ways, its answer against the batch fit, and an honest band."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, twist
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import LogSpline
from onebend.errors import LearningError
from onebend.learning.force_process import ForceProcess, Spans, covariance, fast_variance, with_one_more
from onebend.learning.key_frames import KeyFrames, Past, empty
from onebend.learning.live_model import Inputs, linearise
from onebend.learning.live_setting import Setting, live_layout, place_at
from onebend.learning.live_solve import LiveScales, Start, gather, solve
from onebend.learning.online import OnlineLearner, OnlineSettings
from onebend.learning.parameters import Layout, Priors, clamp_sd
from onebend.learning.posterior import FitSettings, fit
from onebend.learning.replay import replay
from onebend.learning.spline import Spline
from onebend.recording.frame import MOUNTING_SD
from onebend.records import DIRECTION_SD, PLACE_SD, TURN_SD, Array, Observations
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.learning.test_posterior import wrong_force

S = np.linspace(0.05, 0.9, 60)
FINE = Resolution(order=12, widest=0.5)  # as the learner's own
NOISE = (2e-5, 1e-3)
PLAIN = OnlineSettings(functions=8, adapt=False, bulk=np.inf, gate=np.inf, marker_noise=1.0, force_load=1e-9)


def test_every_derivative_matches_differences() -> None:
    at = live_layout(
        Spline(7), 3, Priors(clock=0.02), placement_sd=5e-4, rest_unknown=True, calibrated=False, mass=0.02
    )
    setting = Setting(0.15, MARKERS, 0.02, at)
    place = place_at(setting, 0.8)
    force = np.array([[0.02, 0.2], [-0.1, 0.3]])
    given = Inputs(
        force, np.array([[0.5, -1.0], [0.2, 2.0]]), np.array([[0.0, -3.0], [1.0, 0.0]]), np.array([1e-3, 0.0])
    )
    x = 1e-3 * np.sin(np.arange(at.size))
    x[:7] = np.log(0.03) + 0.3 * np.cos(np.arange(7))
    exact = linearise(setting, place, x, given, None)
    h = 1e-5
    for i in range(at.size):
        step = h * np.eye(at.size)[i]
        ends = [linearise(setting, place, x + sign * step, given, exact.q).pose for sign in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(exact.j[..., i], difference, atol=1e-6 * max(1.0, float(np.max(abs(difference)))))
    for c in range(2):
        pushes = [force + sign * h * np.eye(2)[c] for sign in (1.0, -1.0)]
        there = [linearise(setting, place, x, replace(given, force=f), exact.q) for f in pushes]
        np.testing.assert_allclose(exact.a[..., c], (there[0].pose - there[1].pose) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(exact.by_force[..., c], (there[0].q - there[1].q) / (2.0 * h), atol=1e-4)


def test_covariance_of_averages_is_that_of_fine_samples() -> None:
    process = ForceProcess(level=0.02, walk=0.01, coloured=0.03, memory=0.4, white=0.05, load=0.04)
    begin, end, frames = np.array([1.0, 1.5, 3.0]), np.array([1.4, 2.5, 3.0]), np.array([9.0, 20.0, 1.0])
    own = np.array([0.0, 2.0, 2.5])
    spans = Spans(begin, end, frames, np.zeros(3), own)
    found = covariance(process, spans)
    samples = [b + (e - b) * (np.arange(2000) + 0.5) / 2000 for b, e in zip(begin, end, strict=True)]
    for i in range(3):
        for k in range(3):
            t, u = samples[i][:, None] - 1.0, samples[k][None] - 1.0
            kernel = 0.02**2 + 0.01**2 * np.minimum(t, u) + 0.03**2 * np.exp(-abs(t - u) / 0.4)
            kernel = kernel + 0.04**2 * (1.0 + np.exp(-abs(own[i] - own[k])))
            assert found[i, k] == pytest.approx(np.mean(kernel) + (i == k) * 0.05**2 / frames[i], rel=1e-3)
    first = Spans(*(v[:2] for v in (begin, end, frames, np.zeros(3), own)))
    with_others, alone = with_one_more(process, first, 3.0, 2.5)
    np.testing.assert_allclose([*with_others, alone], found[2], rtol=1e-9)


def tags_of(
    beam: Beam, logged: Array, farther: float, turned: float, along: Array, across: Array
) -> tuple[Array, Array]:
    """Tags (T, 3, 2) and the beam's angle under them: the log's axes turned, the push and the tags off their places."""
    axes = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    force = logged @ axes.T
    shape = equilibrium(beam, push(force, 1.0), resolution=FINE)
    for _ in range(4):  # a force beyond the tip is one at the tip and its moment
        tip = shape.angle(np.ones(1))[:, 0]
        moment = farther * (np.cos(tip) * force[:, 1] - np.sin(tip) * force[:, 0])
        shape = equilibrium(beam, push(force, 1.0) + twist(moment, 1.0), resolution=FINE)
    places = MARKERS + along / beam.length
    s = np.minimum(places, 1.0)
    angle, over = shape.angle(s), beam.length * (places - s)
    ride = [np.cos(angle) * over - np.sin(angle) * across, np.sin(angle) * over + np.cos(angle) * across]
    return shape.xy(s) + np.stack(ride, axis=-1), angle


def textbook(made: Observations, settings: OnlineSettings, at_rest: Array, v: Array) -> Array:
    """-2 log posterior as a sum of squares, written out anew: v holds all parameters, then the force errors."""
    o, noise, level = made, settings.force_noise, 0.05 * float(np.max(np.linalg.norm(made.force[made.loaded], axis=1)))
    count, spline, t = len(o.time), Spline(settings.functions), made.time - made.time[0]
    slow = max(level, noise) ** 2 + (0.3 * noise) ** 2 * np.minimum(t[:, None], t)
    fast = noise**2 * np.exp(-np.abs(t[:, None] - t) / settings.force_memory) + noise**2 * np.eye(count)
    half = np.linalg.inv(np.linalg.cholesky(slow + fast))
    of_k, p = np.linalg.cholesky(spline.precision(settings.roughness, settings.steps)).T, spline.count
    along, across, turn, clamp, origin = v[p : p + 3], v[p + 3 : p + 6], v[p + 6 : p + 9], v[p + 9], v[p + 10 : p + 12]
    farther, turned, error = v[p + 12], v[p + 13], v[p + 14 :].reshape(count, 2)
    beam = Beam(o.length, LogSpline(tuple(spline.knots), tuple(v[:p])), clamp_angle=float(clamp))
    force = np.where(at_rest[:, None], 0.0, o.force - error)
    xy, angle = tags_of(beam, force, farther, turned, along, across)
    pose = np.concatenate([xy + origin, (angle + turn)[..., None]], axis=-1)
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    tags = np.einsum("tmab,tmb->tma", np.linalg.inv(np.linalg.cholesky(o.covariance)), seen - pose).ravel()
    log = ((o.force - error)[at_rest] / (0.05 * noise)).ravel()
    last = [clamp_sd(o, settings.priors), 5e-4, 5e-4, PLACE_SD, DIRECTION_SD]
    sd = np.concatenate([np.full(6, 5e-4), np.full(3, TURN_SD), last])
    return np.concatenate([tags, log, of_k @ (v[:p] - np.log(0.03)), v[p : p + 14] / sd, (half @ error).ravel()])


def test_key_frames_that_hold_every_frame_give_the_textbook_posterior() -> None:
    """At the answer a Gauss-Newton step of the sum of squares is nothing, its inverse curvature the covariance."""
    force = np.concatenate([np.zeros((2, 2)), forces(6)])
    made = observed(SOFT, force, noise=(2e-4, 5e-3), seed=4)
    at_rest = np.all(force == 0.0, axis=1)
    logged = force + 0.004 + 0.002 * np.sin(np.arange(len(force)))[:, None]
    made = replace(
        made, force=logged, loaded=~at_rest, time=np.arange(0.0, 0.3 * len(force) - 0.1, 0.3), force_sd=np.zeros(2)
    )
    learner = replay(made, 0.03, settings=PLAIN)
    learner.settle(60)
    mean, found = learner.parameters
    v = np.concatenate([mean, learner._state.solution.e.ravel()])
    scale = np.concatenate([np.sqrt(np.diag(found)), np.full(2 * len(force), 0.01)])
    steps = 1e-4 * np.diag(scale)
    ends = [[textbook(made, PLAIN, at_rest, v + sign * step) for step in steps] for sign in (1.0, -1.0)]
    rows = (np.array(ends[0]) - np.array(ends[1])).T / 2e-4
    away = np.linalg.lstsq(rows, -textbook(made, PLAIN, at_rest, v), rcond=None)[0]
    assert np.max(np.abs(away)) < 0.01  # of a sd: a tag's way along the beam is a circle in the learner
    n = len(mean)
    spread = np.linalg.inv(rows.T @ rows)[:n, :n]
    np.testing.assert_allclose(found / np.outer(scale[:n], scale[:n]), spread, atol=5e-3)


def linear_frames(seed: int, at: Layout, count: int) -> KeyFrames:
    """Key frames of a model that is linear: random derivatives, data, information and a rest."""
    rng = np.random.default_rng(seed)
    keys = empty(count, 2, at.size, 4)
    keys.used = count
    keys.begin[:count] = keys.end[:count] = np.cumsum(rng.uniform(0.1, 0.4, count))
    keys.frames[:] = 1.0
    keys.rest[0] = True
    keys.force[:] = 0.1 * rng.normal(size=keys.force.shape)
    keys.weight[:] = rng.uniform(0.5, 1.0, keys.weight.shape)
    keys.information[:] = np.eye(3)
    keys.rows_j[:] = 30.0 * rng.normal(size=keys.rows_j.shape)
    keys.rows_a[1:] = 30.0 * rng.normal(size=keys.rows_a[1:].shape)
    keys.rows_z[:] = 30.0 * rng.normal(size=keys.rows_z.shape)
    return keys


def test_a_linear_model_gives_the_dense_posterior_and_folding_a_frame_changes_nothing() -> None:
    """Against generalised least squares with the force errors integrated out, to 1e-8."""
    at = live_layout(Spline(6), 2, Priors(), placement_sd=0.1, rest_unknown=False, calibrated=True, mass=0.0)
    keys, start = linear_frames(1, at, 7), Start(at, np.where(np.arange(at.size) < 6, 0.3, 0.0), None)
    scales, process = LiveScales(1.3, 0.02, 0.03, 0.3, 0.02, 0.0), ForceProcess(0.05, 0.02, 0.03, 0.3, 0.02)
    of_k = start.of_k(at.spline.variances(2.0, 0.2))
    never = Past(np.zeros((at.size + 2, at.size + 2)), np.zeros(at.size + 2), -np.inf)
    found = solve(gather(keys, never), start, of_k, scales, process)
    c = covariance(process, keys.spans(np.zeros(7)))
    root = np.repeat(np.sqrt(keys.weight[:7]), 3, axis=1)[..., None] / 1.3
    j, z = (root * keys.rows_j[:7]).reshape(42, -1), (root[..., 0] * keys.rows_z[:7]).ravel()
    a = np.zeros((7, 6, 7, 2))
    for i in range(7):
        a[i, :, i] = -(root * keys.rows_a[:7])[i]
    rows = np.concatenate([np.hstack([j, a.reshape(42, 14)]), np.eye(2, at.size + 14, at.size) / (0.05 * 0.02)])
    right = np.concatenate([z, keys.force[0] / (0.05 * 0.02)])
    prior = np.zeros((at.size + 14,) * 2)
    prior[: at.size, : at.size] = block_diag(of_k.information, np.diag(start.others))
    prior[at.size :, at.size :] = np.kron(np.linalg.inv(c), np.eye(2))
    dense = np.linalg.inv(rows.T @ rows + prior)
    best = dense @ (rows.T @ right + prior[:, : at.size] @ start.mean)
    np.testing.assert_allclose(found.x, best[: at.size], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found.e.ravel(), best[at.size :], rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(found.covariance(), dense[: at.size, : at.size], rtol=1e-6, atol=1e-10)
    # Where the force error is one level, a folded frame says what it said.
    level = ForceProcess(0.05, 0.0, 1e-9, 0.3, 1e-4)
    whole = solve(gather(keys, never), start, of_k, scales, level)
    never.add(*keys.quadratic(0, 1.3, 1e-4), float(keys.end[0]), 0.0, slow=0.0, fast=fast_variance(level, 0.0, 1.0))
    keys.drop(0)
    folded = solve(gather(keys, never), start, of_k, scales, level)
    np.testing.assert_allclose(folded.x, whole.x, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(folded.covariance(), whole.covariance(), rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_live_and_batch_agree(seed: int) -> None:
    made = wrong_force(observed(SOFT, forces(120), noise=NOISE, seed=seed), seed, 0.005)
    batch = fit([made], 0.03, settings=FitSettings(functions=12)).stiffness.log_at(S)
    learner = replay(made, 0.06, settings=OnlineSettings(functions=12))
    live = learner.stiffness.log_at(S)
    assert np.sqrt(np.mean(((live[0] - batch[0]) / batch[1]) ** 2)) < 1.0
    assert 0.7 < np.median(live[1]) / np.median(batch[1]) < 2.0  # after 120 frames the scales are still on their way
    learner.settle()
    settled = learner.stiffness.log_at(S)
    assert 0.75 < np.median(settled[1]) / np.median(batch[1]) < 1.5
    assert np.sqrt(np.mean(np.expm1(live[0] - np.log(SOFT.stiffness(S))) ** 2)) < 0.05


def drawn(seed: int, count: int) -> tuple[Observations, LogSpline]:
    """A push of a drawn beam whose nuisances and force error are drawn as the settings say."""
    rng, spline = np.random.default_rng(seed), Spline(8)
    rough = np.linalg.cholesky(np.linalg.inv(spline.precision(3.0, 0.1))) @ rng.normal(size=8)
    places = np.array([np.mean(spline.knots[i + 1 : i + 4]) for i in range(8)])  # coefficients there: log k = s
    line = np.polynomial.Polynomial.fit(places, rough, 1)(places)  # level and slope, of broad prior, are tamed
    log_k = LogSpline(tuple(spline.knots), tuple(np.log(0.025) + rough - line + 0.3 * rng.normal()))
    beam, force = Beam(0.15, log_k, clamp_angle=np.hypot(3e-3, MOUNTING_SD) * rng.normal()), forces(count)
    along, across, turn = 5e-4 * rng.normal(size=3), 5e-4 * rng.normal(size=3), np.deg2rad(1.5) * rng.normal(size=3)
    farther, turned = PLACE_SD * rng.normal(), DIRECTION_SD * rng.normal()
    xy, angle = tags_of(beam, force, farther, turned, along, across)
    made = observed(beam, force, xy=xy, angle=angle, noise=NOISE, seed=seed)
    coloured = np.zeros((count, 2))
    keep = np.exp(-1.0 / 30.0 / 0.3)
    for t in range(count):
        before = coloured[t - 1] * keep if t else rng.normal(size=2) * 0.003
        coloured[t] = before + (0.003 * np.sqrt(1.0 - keep**2) * rng.normal(size=2) if t else 0.0)
    error = coloured + 0.05 * 0.35 * rng.normal(size=2) + 0.001 * rng.normal(size=(count, 2))
    seen = made.xy + 5e-4 * rng.normal(size=2)
    return replace(made, xy=seen, angle=made.angle + turn, force=made.force + error, loaded=made.loaded), log_k


def test_error_over_band_is_chi_square_over_seeds() -> None:
    """Normalised errors at three places, squared and summed over 16 seeds, within the 99.9 % limits of chi-square."""
    places, total, seeds = np.array([0.15, 0.4, 0.65]), 0.0, 16
    plain = OnlineSettings(functions=8, roughness=3.0, steps=0.1, adapt=False, marker_noise=1.0)
    settings = replace(plain, force_noise=0.003, force_white=0.001, force_walk=1e-6, force_load=1e-9)
    for seed in range(seeds):
        made, truth = drawn(seed, 60)
        made = replace(made, force_sd=np.zeros(2), rest_xy=np.full((3, 2), np.nan))
        one = replay(made, 0.03, settings=settings).stiffness
        basis = one.basis(places)
        away = basis @ one.mean - np.log(truth(places))
        total += float(away @ np.linalg.solve(basis @ one.covariance @ basis.T, away))
    assert chi2.ppf(0.0005, 3 * seeds) < total < chi2.ppf(0.9995, 3 * seeds)


def many_pushes(turns: int, each: int) -> Observations:
    """Push after push, with rests between them."""
    made = observed(SOFT, np.tile(np.concatenate([np.zeros((5, 2)), forces(each)]), (turns, 1)), noise=NOISE, seed=1)
    return replace(wrong_force(made, 1, 0.004), loaded=np.any(made.force != 0.0, axis=1))


def test_memory_does_not_grow_and_the_past_is_kept() -> None:
    made, settings = many_pushes(12, 30), OnlineSettings(functions=10)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=settings)
    sizes, sds = [], []
    for t in range(len(made.time)):
        learner.update(
            made.time[t], made.xy[t], made.angle[t], made.covariance[t], made.force[t], loaded=bool(made.loaded[t])
        )
        if t + 1 in (140, 420):
            sizes.append(len(pickle.dumps(learner)))
            sds.append(float(np.median(learner.stiffness.log_at(S)[1])))
    assert learner.frames == 420
    assert sizes[1] < 1.02 * sizes[0]
    assert sds[1] < 1.2 * sds[0]  # the sizes of the force's error are learned too
    mean, sd = learner.stiffness.log_at(S)
    assert np.sqrt(np.mean(((mean - np.log(SOFT.stiffness(S))) / sd) ** 2)) < 2.5
    assert np.sqrt(np.mean(np.expm1(mean - np.log(SOFT.stiffness(S))) ** 2)) < 0.05


def test_outliers_are_named_and_do_not_move_the_answer() -> None:
    made = wrong_force(observed(SOFT, forces(90), noise=NOISE, seed=5), 5, 0.004)
    xy = made.xy.copy()
    wild = np.arange(20, 90, 9)
    xy[wild, wild % 3] += 0.02
    clean = replay(made, 0.03, settings=OnlineSettings(functions=10)).stiffness.log_at(S)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=OnlineSettings(functions=10, placement_sd=5e-4))
    refused = []
    for t in range(90):
        refused.append(~learner.update(made.time[t], xy[t], made.angle[t], made.covariance[t], made.force[t]).accepted)
    assert {(int(t), int(i)) for t, i in np.argwhere(refused)} >= {(int(t), int(t % 3)) for t in wild}
    dirty = replay(replace(made, xy=xy), 0.03, settings=OnlineSettings(functions=10)).stiffness.log_at(S)
    assert np.max(np.abs(dirty[0] - clean[0]) / clean[1]) < 0.7


def test_a_missing_tag_is_as_one_of_no_weight_and_whole_turns_do_not_matter() -> None:
    made = observed(SOFT, forces(50), noise=NOISE, seed=2)
    gone = np.random.default_rng(0).uniform(size=made.angle.shape) < 0.3
    xy, spread = made.xy.copy(), made.covariance.copy()
    xy[gone, 0] = np.nan
    spread[gone] *= 1e16
    missing = replay(replace(made, xy=xy, angle=made.angle + 2.0 * np.pi), 0.03, settings=PLAIN).stiffness
    weak = replay(replace(made, covariance=spread), 0.03, settings=PLAIN).stiffness
    np.testing.assert_allclose(missing.log_at(S)[0], weak.log_at(S)[0], atol=3e-3)  # the way there is not the same:
    np.testing.assert_allclose(missing.log_at(S)[1], weak.log_at(S)[1], rtol=1e-2)  # noise is of the tags that are seen


def test_learning_goes_on_from_what_a_fit_has_found() -> None:
    made = wrong_force(observed(SOFT, forces(60), noise=NOISE, seed=6), 6, 0.004)
    found = fit([made], 0.03, settings=FitSettings(functions=10)).stiffness
    learner = OnlineLearner(made.length, MARKERS, found, settings=OnlineSettings(functions=10))
    np.testing.assert_allclose(learner.stiffness.log_at(S)[0], found.log_at(S)[0], rtol=1e-6)
    np.testing.assert_allclose(learner.stiffness.log_at(S)[1], found.log_at(S)[1], rtol=0.15)  # less where a step lies
    again = wrong_force(observed(SOFT, forces(60), noise=NOISE, seed=7), 7, 0.004)
    more = replay(again, found, settings=OnlineSettings(functions=10)).stiffness
    assert np.all(more.log_at(S)[1] < 1.001 * found.log_at(S)[1])


def test_results_speak_of_the_beam_and_of_what_else_was_learned() -> None:
    learner = replay(observed(SOFT, forces(40), noise=NOISE), 0.03, gain_sd=0.1, settings=OnlineSettings(functions=8))
    names = {n.name: n for n in learner.nuisances()}
    assert {"tag 1 along", "tag 3 turn", "clamp angle"} <= set(names)
    assert all(0.0 < n.sd <= 1.001 * n.prior_sd for n in names.values())
    assert learner.stiffness.gain_sd == 0.1
    np.testing.assert_allclose(learner.beam.stiffness(S), np.exp(learner.stiffness.log_at(S)[0]))


FRAME = (1.0, np.zeros((3, 2)), np.zeros(3), np.tile(1e-8 * np.eye(3), (3, 1, 1)), (0.0, 0.1))


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (0, np.nan, "time"),
        (1, np.zeros((2, 2)), "xy must have shape"),
        (1, np.full((3, 2), np.inf), "infinity"),
        (3, np.zeros((3, 3, 3)), "positive definite"),
        (4, (np.nan, 0.0), "finite"),
    ],
)
def test_a_bad_frame_is_refused_and_changes_nothing(where: int, value: object, words: str) -> None:
    learner = OnlineLearner(0.15, MARKERS, 0.03)
    frame: list[object] = list(FRAME)
    frame[where] = value
    with pytest.raises(LearningError, match=words):
        learner.update(*frame)  # type: ignore[arg-type]
    assert learner.frames == 0
    learner.update(*FRAME)
    for words, changed in (("order of time", FRAME), ("in \\(0, 1\\]", (2.0, *FRAME[1:], 1.5))):
        with pytest.raises(LearningError, match=words):
            learner.update(*changed)
    with pytest.raises(LearningError, match="mass"):
        learner.update(2.0, *FRAME[1:], gravity=(0.0, -9.8))


@pytest.mark.parametrize(
    ("length", "markers", "start", "settings", "words"),
    [
        (-1.0, MARKERS, 0.03, OnlineSettings(), "length"),
        (0.15, [1.5], 0.03, OnlineSettings(), "tags"),
        (0.15, MARKERS, -0.03, OnlineSettings(), "positive"),
        (0.15, MARKERS, 0.03, OnlineSettings(force_noise=0.0), "force_noise"),
        (0.15, MARKERS, 0.03, OnlineSettings(key_frames=2), "key_frames"),
    ],
)
def test_a_learner_without_meaning_is_refused(
    length: float, markers: Array, start: float, settings: OnlineSettings, words: str
) -> None:
    with pytest.raises(LearningError, match=words):
        OnlineLearner(length, markers, start, settings=settings)


def test_the_pages_example_runs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "streaming.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, object] = {}
    exec("\n".join(blocks), names)
    learner = names["learner"]
    assert isinstance(learner, OnlineLearner)
    assert learner.frames > 100
    every = set(OnlineSettings.__dataclass_fields__)
    assert every == set(re.findall(r"^\| `(\w+)` \|", page, flags=re.MULTILINE))
