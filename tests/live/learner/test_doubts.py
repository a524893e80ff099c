"""What the live learner cannot rely on it says, and what makes no sense it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.errors import LearningError
from onebend.live import residuals
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.key_frames import KeyFrames, checked_frame
from onebend.live.learner import OnlineLearner
from onebend.live.posterior import KeyFrameModel, KeyFramePosterior
from onebend.live.replayed import live_frames, settings_for
from onebend.records import Array
from onebend.report.sentences import say
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.learning.test_outline_fit import beside_tags
from tests.live.streamed_recording import NOISE, S, shown

FEW = OnlineSettings(functions=8)
FAILED, TOO_SOFT = say("live: failed"), say("live: too soft")


def test_a_failed_solution_is_said_as_long_as_it_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    made = observed(SOFT, forces(60), noise=NOISE, seed=3)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    assert not any(one.doubts for one in shown(learner, made, range(41))[30:])
    before = learner.stiffness
    assert np.any(before.band(S).identified)

    def fails(*_: object) -> KeyFramePosterior:
        raise np.linalg.LinAlgError("not positive definite")

    really = KeyFrameModel.posterior
    monkeypatch.setattr(KeyFrameModel, "posterior", fails)
    updates = shown(learner, made, range(41, 46))
    learner.settle()
    assert all(FAILED in one.doubts and one.solved for one in updates[1:])
    assert FAILED in learner.doubts
    lasting = learner.stiffness
    (mean, sd), (began, _) = lasting.log_at(S), before.log_at(S)
    assert np.max(np.abs(mean - began) / sd) < 0.3  # the sizes in log k's prior were drawn once more
    assert FAILED in lasting.doubts
    assert not np.any(lasting.band(S).identified)
    monkeypatch.setattr(KeyFrameModel, "posterior", really)
    assert shown(learner, made, range(46, 47))[0].doubts == ()  # the next frame tries again
    shown(learner, made, range(47, 60))
    whole = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    shown(whole, made, range(60))
    apart = (learner.stiffness.log_at(S)[0] - whole.stiffness.log_at(S)[0]) / whole.stiffness.log_at(S)[1]
    assert np.max(np.abs(apart)) < 0.5
    assert np.any(learner.stiffness.band(S).identified)


def test_a_beam_that_stands_where_the_estimate_would_not_is_stiffened_until_it_does() -> None:
    """A straight beam under an axial force below its buckling load `pi^2 k / (4 L)`, and above the estimate's."""
    stiff, soft = 0.02, 0.005
    force = -(np.pi**2) / (4.0 * 0.15) * 0.5 * (stiff + soft)
    made = observed(Beam(0.15, Uniform(stiff)), np.tile([force, 0.0], (20, 1)), noise=NOISE, seed=2)
    learner = OnlineLearner(0.15, MARKERS, soft, settings=FEW)
    first = shown(learner, made, range(1))[0]
    assert (first.solved, first.doubts, learner.frames) == (False, (TOO_SOFT,), 0)
    assert not np.any(learner.stiffness.band(S).identified)
    rest = shown(learner, made, range(1, 20))
    assert rest[-1].solved
    assert TOO_SOFT not in rest[-1].doubts
    assert learner.frames > 10


def test_a_key_frame_that_the_estimate_cannot_carry_is_said_and_taken_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    made = observed(SOFT, forces(24), noise=NOISE, seed=2)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    assert shown(learner, made, range(24))[-1].doubts == ()
    linear = learner._state._lineariser
    really = linear.renew

    def without_third(keys: KeyFrames, chosen: list[int], point: Array) -> set[int]:
        return really(keys, [k for k in chosen if k != 2], point)

    monkeypatch.setattr(linear, "renew", without_third)
    learner.settle(1)
    assert learner.doubts == ("1 of 24 key frames have no equilibrium at the estimate",)
    assert not np.any(learner.stiffness.band(S).identified)
    monkeypatch.undo()
    learner.settle(1)
    assert not learner.doubts


@pytest.mark.slow
def test_tags_that_the_estimate_misses_are_said() -> None:
    """A start forty times too soft in the middle of an almost axial push: another shape that explains it badly."""
    size = np.linalg.norm(forces(60), axis=1)
    made = observed(SOFT, size[:, None] * np.array([np.cos(3.0), np.sin(3.0)]), noise=NOISE, seed=2)
    lost = OnlineLearner(made.length, MARKERS, 5e-4, settings=FEW)
    shown(lost, made, range(20, 60))
    assert any("misses tag" in words for words in lost.doubts)
    assert not np.any(lost.stiffness.band(S).identified)
    near = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    assert shown(near, made, range(20, 60))[-1].doubts == ()
    assert np.any(near.stiffness.band(S).identified)


@pytest.mark.parametrize(("first", "times"), [(0, 0.03), (25, 0.03), (25, 0.1), (0, 30.0), (25, 30.0)])
def test_begun_far_off_it_ends_near_the_truth_and_is_not_wrong_before_without_a_word(first: int, times: float) -> None:
    """From the rest, and in the middle of a push; root mean squares over the beam."""
    made, log_k = beside_tags(), np.log(SOFT.stiffness(S))
    start, settings = times * np.exp(np.mean(log_k)), settings_for(made)
    learner = OnlineLearner(made.length, made.marker_s, start, traced=made.traced, settings=settings)
    for number, frame in enumerate(live_frames(made)[first:]):
        learner.update(**vars(frame))
        if number % 3 == 0:
            mean, sd = learner.stiffness.log_at(S)
            assert learner.doubts or np.sqrt(np.mean(((mean - log_k) / sd) ** 2)) < 2.5
    assert np.sqrt(np.mean((learner.stiffness.log_at(S)[0] - log_k) ** 2)) < 0.1


def test_an_estimate_whose_error_drowns_the_noise_of_the_tags_is_no_singular_equation() -> None:
    made = observed(SOFT, forces(20), noise=NOISE, seed=3)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    shown(learner, made, range(20))
    state, keys = learner._state, learner._state.keys
    seen = made.xy[-1], made.angle[-1], made.covariance[-1], made.force[-1], 1.0, True, np.zeros(2)
    frame = checked_frame(keys.traced, 1.0, *seen)
    keys.linear[keys.used - 1] = 0.0
    keys.j[keys.used - 1, :, :, 0] = 1e9  # all coordinates of a tag are off alike, and by far
    nothing = np.zeros(len(state.solution.e)), 0.0
    _, distance = residuals.surprise(keys, frame, state.solution, state.x, state.sizes, nothing)
    assert np.isfinite(distance).all()


@pytest.mark.slow
def test_a_fit_in_doubt_stays_so() -> None:
    made = observed(SOFT, forces(40), noise=NOISE)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=FEW)
    shown(learner, made, range(40))
    assert learner.doubts == ()
    doubted = replace(learner.stiffness, doubts=("the fit did not converge",))
    after = OnlineLearner(made.length, MARKERS, doubted, settings=FEW)
    assert shown(after, made, range(1))[0].doubts == ("the fit did not converge",)
    assert not np.any(after.stiffness.band(S).identified)


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
        (0.15, MARKERS, 0.03, OnlineSettings(force=replace(FEW.force, coloured=0.0)), "force"),
        (0.15, MARKERS, 0.03, OnlineSettings(key_frames=2), "key_frames"),
        (0.15, MARKERS, 0.03, OnlineSettings(force=replace(FEW.force, load=-0.01)), "force"),
    ],
)
def test_a_learner_without_meaning_is_refused(
    length: float, markers: Array, start: float, settings: OnlineSettings, words: str
) -> None:
    with pytest.raises(LearningError, match=words):
        OnlineLearner(length, markers, start, settings=settings)
