"""The live learner's parts against slow textbook ways: derivatives, covariances, the posterior, folding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline
from onebend.learning.allowances import LIVE_ALLOWANCES, MaterialMemory
from onebend.learning.force_error import spanned_error
from onebend.learning.hyperparameters import SPREAD
from onebend.learning.linear import Hyperparameters, RecordingNoise
from onebend.learning.parameters import Layout, Spline, clamp_sd
from onebend.learning.prediction import Prediction, predict
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.key_frames import (
    KeyFrames,
    empty,
)
from onebend.live.model import REACHED, FrameInputs, LiveSession, frames_at, problem_of, pushed_at, session_of
from onebend.live.posterior import (
    KeyFramePosterior,
    Marginalised,
    information,
    likelihood_rows,
    model_of,
    nothing_marginalised,
    spans_of,
    with_error_change,
)
from onebend.live.replayed import replay
from onebend.recording.force_noise import TimeSpans, covariance, fast_variance, with_one_more
from onebend.records import DIRECTION_SD, SCALE_SD, TURN_SD, Array, ForceNoise, Observations
from tests.learning.bench import MARKERS, SOFT, forces, observed, prior_precision
from tests.live.streamed_recording import PLAIN, tags_of


@pytest.mark.parametrize("shares", [(0.0, 0.0, 0.0), (0.02, 0.05, 0.03)])
def test_every_derivative_matches_differences(shares: tuple[float, float, float]) -> None:
    """With every allowance that the learner has. What the beam remembers stays as at the start: of a beam that relaxes
    the curvature at rest, by which it remembers, has no exact derivative."""
    sds = {"clock": 0.02, "scale": SCALE_SD}
    session = session_of(Spline(7), MARKERS, sds, length=0.15, mass=0.02, allowances=LIVE_ALLOWANCES)
    layout, rng = session.layout, np.random.default_rng(0)
    nodes, relaxing = pushed_at(session, 0.8).problem.grid.nodes, layout.index["relaxation", -1].where
    before = np.cos(nodes[:, None] * np.array([1.0, 2.0, 3.0])) * np.array([[[0.7]], [[-0.4]]])
    force = np.array([[0.02, 0.2], [-0.1, 0.3]])
    inputs = FrameInputs(
        force,
        np.array([[0.5, -1.0], [0.2, 2.0]]),
        np.array([[0.0, -3.0], [1.0, 0.0]]),
        np.array([1e-3, 0.0]),
        rng.uniform(0.2, 0.8, (2, session.terms.count)),
        MaterialMemory(before, np.tile([0.3, 0.2, 0.1], (2, 1)), REACHED),
    )

    def at(x: Array, start: Array | None, inputs: FrameInputs = inputs) -> Prediction:
        return predict(frames_at(session, 0.8, inputs), layout, x, start)

    x = 1e-3 * np.sin(np.arange(layout.size))
    x[:7] = np.log(0.03) + 0.3 * np.cos(np.arange(7))
    x[relaxing] = shares
    exact, h = at(x, None), 1e-5
    for _ in range(8):
        begin = exact.solved.q
        exact = at(x, begin)
    assert session.columns.keys() >= LIVE_ALLOWANCES - {"outline", "light"}
    slopes, at_rest = exact.slopes, layout.index["curvature", -1].where if any(shares) else slice(0, 0)
    for i in set(range(layout.size)) - set(range(layout.size)[at_rest]):
        ends = [at(x + sign * h * np.eye(layout.size)[i], begin).pose for sign in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(slopes.j[..., i], difference, atol=2e-6 * max(1.0, float(np.max(abs(difference)))))
    for c in range(2):
        pushes = [replace(inputs, force=force + sign * h * np.eye(2)[c]) for sign in (1.0, -1.0)]
        ends = [at(x, begin, push).pose for push in pushes]
        by_force = (slopes.a @ slopes.axes)[..., c]
        np.testing.assert_allclose(by_force, (ends[0] - ends[1]) / (2.0 * h), atol=1e-6)


def test_covariance_of_averages_is_that_of_fine_samples() -> None:
    process = ForceNoise(level=0.02, walk=0.01, coloured=0.03, tau=0.4, white=0.05, load=0.04)
    begin, end, frames = np.array([1.0, 1.5, 3.0]), np.array([1.4, 2.5, 3.0]), np.array([9.0, 20.0, 1.0])
    own = np.array([0.0, 2.0, 2.5])
    spans = TimeSpans(begin, end, frames, np.zeros(3), own)
    solution = covariance(process, spans)
    samples = [b + (e - b) * (np.arange(2000) + 0.5) / 2000 for b, e in zip(begin, end, strict=True)]
    for i in range(3):
        for k in range(3):
            t, u = samples[i][:, None] - 1.0, samples[k][None] - 1.0
            kernel = 0.02**2 + 0.01**2 * np.minimum(t, u) + 0.03**2 * np.exp(-abs(t - u) / 0.4)
            kernel = kernel + 0.04**2 * (1.0 + np.exp(-abs(own[i] - own[k])))
            assert solution[i, k] == pytest.approx(np.mean(kernel) + (i == k) * 0.05**2 / frames[i], rel=1e-3)
    first = TimeSpans(*(v[:2] for v in (begin, end, frames, np.zeros(3), own)))
    with_others, alone = with_one_more(process, first, 3.0, 2.5)
    np.testing.assert_allclose([*with_others, alone], solution[2], rtol=1e-9)


def textbook(made: Observations, settings: OnlineSettings, at_rest: Array, v: Array) -> Array:
    """-2 log posterior as a sum of squares, written out anew: v holds all parameters, then the force errors."""
    o, noise, level = (
        made,
        settings.force.coloured,
        0.05 * float(np.max(np.linalg.norm(made.force[made.loaded], axis=1))),
    )
    count, spline, t = len(o.time), Spline(settings.functions), made.time - made.time[0]
    slow = max(level, noise) ** 2 + (0.3 * noise) ** 2 * np.minimum(t[:, None], t)
    fast = noise**2 * np.exp(-np.abs(t[:, None] - t) / settings.force.tau) + noise**2 * np.eye(count)
    half = np.linalg.inv(np.linalg.cholesky(slow + fast))
    smoothness, p = np.linalg.cholesky(prior_precision(spline, settings.roughness, settings.steps)).T, spline.count
    along, across, turn, clamp, origin = v[p : p + 3], v[p + 3 : p + 6], v[p + 6 : p + 9], v[p + 9], v[p + 10 : p + 12]
    farther, turned, error = v[p + 12], v[p + 13], v[p + 14 :].reshape(count, 2)
    beam = Beam(o.length, LogSpline(tuple(spline.knots), tuple(v[:p])), clamp_angle=float(clamp))
    force = np.where(at_rest[:, None], 0.0, o.force - error)
    xy, angle = tags_of(beam, force, farther, turned, along, across)
    pose = np.concatenate([xy + origin, (angle + turn)[..., None]], axis=-1)
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    tags = np.einsum("tmab,tmb->tma", np.linalg.inv(np.linalg.cholesky(o.covariance)), seen - pose).ravel()
    log = ((o.force - error)[at_rest] / (0.05 * noise)).ravel()
    last = [clamp_sd(o), 5e-4, 5e-4, o.stated.place_sd, DIRECTION_SD]
    sd = np.concatenate([np.full(6, 5e-4), np.full(3, TURN_SD), last])
    return np.concatenate([tags, log, smoothness @ (v[:p] - np.log(0.03)), v[p : p + 14] / sd, (half @ error).ravel()])


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
    mean, solution = learner.parameters
    v = np.concatenate([mean, learner._state.solution.e.ravel()])
    scale = np.concatenate([np.sqrt(np.diag(solution)), np.full(2 * len(force), 0.01)])
    steps = 1e-4 * np.diag(scale)
    ends = [[textbook(made, PLAIN, at_rest, v + sign * step) for step in steps] for sign in (1.0, -1.0)]
    rows = (np.array(ends[0]) - np.array(ends[1])).T / 2e-4
    away = np.linalg.lstsq(rows, -textbook(made, PLAIN, at_rest, v), rcond=None)[0]
    assert np.max(np.abs(away)) < 0.01  # of a sd: a tag's way along the beam is a circle in the learner
    n = len(mean)
    spread = np.linalg.inv(rows.T @ rows)[:n, :n]
    np.testing.assert_allclose(solution / np.outer(scale[:n], scale[:n]), spread, atol=5e-3)


def linear_frames(seed: int, layout: Layout, count: int) -> KeyFrames:
    """Key frames of a model that is linear: random derivatives, data, information and a rest."""
    rng = np.random.default_rng(seed)
    keys = empty(count, np.zeros(2, dtype=bool), layout.size, 4, 0)
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


def solved(session: LiveSession, keys: KeyFrames, marginalised: Marginalised, process: ForceNoise) -> KeyFramePosterior:
    """The posterior over these key frames, the tags' noise 1.3 times their covariances."""
    spline, noise = session.layout.spline, RecordingNoise(1.3, process.white)
    h = Hyperparameters(spline.variances(2.0, 0.2), 1.0, 1.0, 1.0, 1.0, (noise,))
    problem = problem_of(session, spanned_error(process, spans_of(keys, marginalised)), (0.3, None), h)
    form = information(keys, marginalised, spline.count, sizes=np.full(2, 1.3), white=process.white)
    sd = session.other_sd(1.0, 1.0)
    return model_of(form, (0.4 * sd, sd), problem, SPREAD).posterior(h)


def test_a_linear_model_gives_the_dense_posterior_and_folding_a_frame_changes_nothing() -> None:
    """Against generalised least squares with the force errors integrated out, to 1e-8."""
    sds = {"along": 0.1, "across": 0.1, "origin": 0.1, "curvature": 0.0}
    session = session_of(Spline(6), np.array([0.5, 1.0]), sds, length=0.15, mass=0.0)
    layout, never = session.layout, nothing_marginalised(session.layout.size)
    keys, n = linear_frames(1, layout, 7), layout.size
    process = ForceNoise(level=0.05, walk=0.02, coloured=0.03, tau=0.3, white=0.02, load=0.0)
    solution = solved(session, keys, never, process)
    c = covariance(process, keys.spans(np.zeros(7)))
    root = np.repeat(np.sqrt(keys.weight[:7]), 3, axis=1)[..., None] / 1.3
    j, z = (root * keys.rows_j[:7]).reshape(42, -1), (root[..., 0] * keys.rows_z[:7]).ravel()
    a = np.zeros((7, 6, 7, 2))
    for i in range(7):
        a[i, :, i] = -(root * keys.rows_a[:7])[i]
    rows = np.concatenate([np.hstack([j, a.reshape(42, 14)]), np.eye(2, n + 14, n) / (0.05 * 0.02)])
    right = np.concatenate([z, keys.force[0] / (0.05 * 0.02)])
    precision = np.zeros((n + 14,) * 2)
    of_log_k, sd = prior_precision(layout.spline, 2.0, 0.2), session.other_sd(1.0, 1.0)
    precision[:n, :n] = block_diag(of_log_k, np.diag(1.0 / sd**2))
    precision[n:, n:] = np.kron(np.linalg.inv(c), np.eye(2))
    dense = np.linalg.inv(rows.T @ rows + precision)
    before = np.concatenate([np.full(6, 0.3), 0.4 * sd, np.zeros(14)])
    best = dense @ (rows.T @ right + precision @ before)
    np.testing.assert_allclose(solution.x, best[:n], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(solution.e.ravel(), best[n:], rtol=1e-7, atol=1e-8)
    found = solution.covariance(solution.solved.pair(0)[:6, :6])
    np.testing.assert_allclose(found, dense[:n, :n], rtol=1e-6, atol=1e-10)
    order = np.concatenate([np.arange(6), np.arange(n, n + 14), np.arange(6, n)])  # log k, errors, others
    some = np.random.default_rng(0).normal(size=(4, n + 14))
    np.testing.assert_allclose(solution.spread(some), some @ dense[np.ix_(order, order)] @ some.T, rtol=1e-6)
    told = n - np.sum(dense[:n, :n] * precision[:n, :n])
    assert solution.effective_parameters == pytest.approx(told, rel=1e-6)
    # Where the force error is one level, a folded frame says what it said.
    level = ForceNoise(level=0.05, walk=0.0, coloured=1e-9, tau=0.3, white=1e-4, load=0.0)
    whole = solved(session, keys, never, level)
    never.add(
        likelihood_rows(keys, 0, np.full(2, 1.3), 1e-4),
        float(keys.end[0]),
        slow=0.0,
        fast=fast_variance(level, 0.0, 1.0),
    )
    keys.drop(0)
    folded = solved(session, keys, never, level)
    np.testing.assert_allclose(folded.x, whole.x, rtol=1e-5, atol=1e-6)
    both = [one.covariance(one.solved.pair(0)[:6, :6]) for one in (folded, whole)]
    np.testing.assert_allclose(both[0], both[1], rtol=1e-4, atol=1e-8)


def test_folding_over_and_over_leaves_what_exact_frames_say() -> None:
    """600 folds: more frames say more, and the answer is the truth (in a quadratic both are lost by then)."""
    rng, n, marginalised = np.random.default_rng(0), 12, nothing_marginalised(12)
    x, before = rng.normal(size=n), np.full(n, np.inf)
    for i in range(600):
        rows = np.zeros((9, n + 3))
        rows[:, :n], rows[:, n : n + 2] = (
            300.0 * rng.normal(size=(9, n)),
            3e4 * rng.normal(size=(9, 2)),
        )
        rows[:, -1] = rows[:, :n] @ x
        marginalised.add(rows, 0.1 * i, slow=2e-4, fast=1e-4)
        if i % 100 == 99:
            root = np.linalg.inv(marginalised.rows[:, :-1])[:n]
            sd = np.sqrt(np.sum(root**2, axis=1))
            assert np.all(sd < before)
            before = sd
    solution = np.linalg.solve(marginalised.rows[:, :-1], marginalised.rows[:, -1])
    np.testing.assert_allclose(solution, np.append(x, [0.0, 0.0]), atol=1e-11)


def test_an_error_that_is_integrated_out_says_what_the_inverse_does() -> None:
    """Against the dense covariance: e = c + d, d of known variance."""
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(20, 9))
    information, b = rows[:, :-1].T @ rows[:, :-1], rows[:, :-1].T @ rows[:, -1]
    spread = np.linalg.inv(information)
    mean = spread @ b
    spread[-2:, -2:] += 0.7 * np.eye(2)
    out = with_error_change(rows, 0.7)
    np.testing.assert_allclose(np.linalg.inv(out[:, :-1].T @ out[:, :-1]), spread, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.lstsq(out[:, :-1], out[:, -1], rcond=None)[0], mean, rtol=1e-9)
    assert with_error_change(rows, 0.0) is rows
