"""What the live learner allows for: the course of a push frame by frame, memory, and what it learns of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.errors import LearningError
from onebend.learning.allowances import (
    EFFECTS,
    KNOWN_SD,
    LIVE_ALLOWANCES,
    OF_ONE,
    PATCH_SD,
    POSTURE_SD,
    allowances_of,
    lags,
    reached_part,
)
from onebend.learning.fit_data import fit_data
from onebend.learning.frames import at_frames
from onebend.learning.parameters import Spline, make_layout
from onebend.learning.posterior import fit
from onebend.learning.prediction import predict
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.key_frames import CourseSoFar, FrameTerms, course_of_frame, course_scale
from onebend.live.learner import OnlineLearner
from onebend.live.model import pushed_at
from onebend.live.replayed import live_frames, replay, settings_for
from onebend.records import Array, Observations
from tests.learning.allowances.allowed_bench import PUSH_S, TAGS, course, filmed
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.learning.test_outline_fit import traced
from tests.live.streamed_recording import IDEAL_LIVE, NOISE, S
from tests.made_up import with_stated

SPLINE = Spline(12)
THICK, SHARES = 3.0, (0.1, 0.0, 0.0)  # of the section, over that of the usual thickness; shares that relax
FEW = OnlineSettings(functions=12)


ONE = course_of_frame(TAGS, 0.15, 0.01, thick=False)
OF_FRAMES = FrameTerms(
    tuple(a for a in allowances_of(ONE, LIVE_ALLOWANCES) if a.enters in ("force", "place", "clamp", "poses"))
)


def test_the_course_so_far_is_that_of_the_recording() -> None:
    """On the way out, where no one can tell that it is not all; displacements are over the length."""
    made, seen, so_far = filmed(), np.ones(3, dtype=bool), CourseSoFar(ONE, OF_FRAMES)
    run, largest = course(), 0.2
    so_far.rest(made.rest_angle, seen)
    terms = [
        so_far.terms(
            made.angle[t] + 2.0 * np.pi,
            seen,
            made.force[t],
            PUSH_S,
            bend=largest * float(run.bend[t]),
            back=bool(run.back[t]),
        )
        for t in range(20)
    ]
    whole = replace(run, bend=largest * run.bend, film=None)
    for one in OF_FRAMES.with_terms(np.array(terms)):
        expected = EFFECTS[one.name].allowance(whole)
        assert expected is not None
        np.testing.assert_allclose(one.basis, expected.basis[:20], atol=1e-12, err_msg=one.name)


def test_a_tag_that_is_not_seen_keeps_its_turn() -> None:
    both, pair = np.array([True, True]), course_of_frame(np.array([0.5, 1.0]), 0.15, 0.01, thick=False)
    so_far = CourseSoFar(pair, FrameTerms(allowances_of(pair, frozenset({"slide", "clamp gives"}))))

    def turns(angle: list[float], visible: list[bool]) -> list[float]:
        return list(so_far.terms(np.array(angle), np.array(visible), np.ones(2), 1.0, bend=0.1, back=False))

    so_far.rest(np.zeros(2), both)
    assert turns([0.1, 0.4], [True, True]) == pytest.approx([0.1, 0.4])
    assert turns([0.2, 0.0], [True, False]) == pytest.approx([0.2, 0.4])
    assert so_far.rest(np.zeros(2), both).tolist() == [0.0, 0.0]


def test_priors_are_those_of_the_fit_and_follow_the_largest_force_and_displacement() -> None:
    made = with_stated(filmed(), tag_size=0.01)
    seen = fit_data(made, 0, np.ones(20, dtype=bool), SPLINE, LIVE_ALLOWANCES)
    fits = {a.name: a for a in seen.allowances}
    largest, bend = float(np.max(np.linalg.norm(made.force, axis=1))), 0.3
    for one in allowances_of(ONE, LIVE_ALLOWANCES):
        scale = course_scale(one, largest, bend)
        if "discrepancy" in one.name:  # of functions that are less, and worth as much
            of_tag = one.prior_sd[:2] * scale[:2] * np.array([bend, 0.5 * bend])
            whole = fits[one.name].prior_sd[:5] * np.array([1.0, 1.0, 0.5, 0.5, 1.0])
            assert np.linalg.norm(of_tag) == pytest.approx(np.linalg.norm(whole))
            continue
        if one.name == "posture":  # likewise, on each axis
            of_axis = one.prior_sd[:2] * scale[:2] * np.array([bend, bend**2])
            assert np.linalg.norm(of_axis) == pytest.approx(POSTURE_SD * largest)
            continue
        np.testing.assert_allclose(one.prior_sd * scale, fits[one.name].prior_sd)
        assert (one.labels, one.unit, one.enters) == (fits[one.name].labels, fits[one.name].unit, fits[one.name].enters)


def soft_and_relaxing(count: int, noise: tuple[float, float]) -> tuple[Observations, Array]:
    """A push of a beam that stretches, shears and relaxes, by the fit's model, and its log k at `S`."""
    made, frames = observed(SOFT, forces(count), noise=noise, seed=3), np.ones(count, dtype=bool)
    one = fit_data(made, 0, frames, SPLINE, frozenset({"section", "relaxation"}))
    layout = make_layout(SPLINE, [made], [len(one.error.knots)], [one.allowances])
    x, s = np.zeros(layout.size), np.linspace(0.0, 1.0, 200)
    log_k = np.linalg.lstsq(SPLINE.basis(s), np.log(SOFT.stiffness(s)), rcond=None)[0]
    x[layout.index["stiffness", -1].where] = log_k
    x[layout.index["section", -1].where] = THICK
    x[layout.index["relaxation", -1].where] = SHARES
    ideal = SOFT.equilibrium(made.force)
    away = predict(one, layout, x, None).pose[:count] - np.concatenate(
        [ideal.xy(MARKERS), ideal.angle(MARKERS)[..., None]], axis=-1
    )
    return replace(made, xy=made.xy + away[..., :2], angle=made.angle + away[..., 2]), SPLINE.basis(S) @ log_k


@pytest.mark.slow
def test_stretch_shear_and_relaxation_are_learned_and_the_band_holds() -> None:
    made, log_k = soft_and_relaxing(120, NOISE)
    learner = replay(made, 0.03, settings=FEW)
    mean, sd = learner.stiffness.log_at(S)
    assert np.sqrt(np.mean(((mean - log_k) / sd) ** 2)) < 1.0
    assert np.sqrt(np.mean((mean - log_k) ** 2)) < 0.06
    found = {n.name: n for n in learner.nuisances()}
    section, share = found["change of section thickness squared"], found["share that relaxes within 1 s"]
    assert abs(section.value - THICK) < 2.0 * section.sd
    assert section.sd < 0.3 * section.prior_sd
    assert abs(share.value - SHARES[0]) < 2.0 * share.sd
    assert share.sd < 0.9 * share.prior_sd
    ideal = replay(made, 0.03, settings=replace(IDEAL_LIVE, functions=12)).stiffness.log_at(S)
    assert np.sqrt(np.mean(((ideal[0] - log_k) / ideal[1]) ** 2)) > 2.0


@pytest.mark.slow
def test_of_an_outline_only_what_is_across_it_counts() -> None:
    """Points that lie farther along the body than written tell the same; no effect of a tag is allowed for."""
    straight, slipped = (replay(traced(off), 0.03, settings=FEW) for off in (0.0, 3e-4))
    np.testing.assert_allclose(slipped.stiffness.log_at(S)[0], straight.stiffness.log_at(S)[0], atol=0.02)
    assert np.sqrt(np.mean((straight.stiffness.log_at(S)[0] - np.log(SOFT.stiffness(S))) ** 2)) < 0.08
    names = {one.name for one in straight.nuisances()}
    assert {"edges lie off in y", "outline error grows0"} <= names
    assert not any("tag" in name for name in names)
    assert straight.hyperparameters.marker >= 1.0


def test_a_point_that_is_far_across_the_outline_is_left_out() -> None:
    made = traced()
    learner = replay(at_frames(made, np.arange(len(made.time)) < 30), 0.03, settings=FEW)
    along = np.stack([np.cos(made.angle[30]), np.sin(made.angle[30])], axis=-1)
    across = along[:, ::-1] * np.array([-1.0, 1.0])
    far = made.xy[30] + 2e-3 * np.where(np.arange(len(along))[:, None] == 9, across, along)
    frame = replace(live_frames(at_frames(made, np.arange(len(made.time)) == 30))[0], xy=far)
    assert np.flatnonzero(~learner.update(**vars(frame)).accepted).tolist() == [9]


def test_what_the_beam_remembers_is_that_of_all_frames_in_turn() -> None:
    """With a key frame for each frame, against the fit's matrices; and so is the secant stiffness of the push."""
    made, _ = soft_and_relaxing(40, (0.0, 0.0))
    made = replace(made, time=np.arange(40) / 10.0)
    learner = replay(made, 0.03, settings=replace(FEW, key_frames=60, adapt=False))
    learner.settle(12)
    state = learner._state
    keys, x = state.keys, state.point
    data = pushed_at(learner._session, 1.0)
    rest = data.rest_on_nodes @ learner._session.layout.get(x, "curvature")
    nodes, weights = len(rest), data.problem.weights
    bent = keys.q[:40, :nodes] - rest
    every = lags(made.time) @ bent
    np.testing.assert_allclose(keys.lags[:40, :nodes], np.moveaxis(every, 0, -1), atol=2e-3 * float(np.max(every)))
    reached = [reached_part(one, bent, weights) for one in every]
    np.testing.assert_allclose(state._lineariser._reached(keys, x), reached, atol=2e-3)


@pytest.mark.slow
def test_averages_and_marginalised_frames_keep_the_memory() -> None:
    made, _ = soft_and_relaxing(120, (0.0, 0.0))
    twice = replace(made, time=np.arange(120) / 30.0)
    whole, few = (replay(twice, 0.03, settings=replace(FEW, key_frames=keys, adapt=False)) for keys in (300, 8))
    for one in (whole, few):
        one.settle(3)
    last = [one._state.keys.lags[one._state.keys.used - 1] for one in (whole, few)]
    np.testing.assert_allclose(last[1], last[0], atol=0.05 * float(np.max(np.abs(last[0]))))


def test_a_fits_stiffness_has_what_is_under_the_tags_in_it() -> None:
    made = observed(SOFT, forces(40), noise=NOISE, seed=6)
    found = fit([made], 0.03, settings=replace(IDEAL, functions=12)).stiffness
    learner = OnlineLearner(made.length, MARKERS, found, settings=FEW)
    assert "patches" not in learner._session.columns
    assert "patches" not in learner.left_out
    np.testing.assert_allclose(learner.stiffness.log_at(S)[0], found.log_at(S)[0], rtol=1e-6)


def test_the_band_holds_what_stiffens_the_beam_under_the_tags() -> None:
    without = OnlineSettings(allowances=LIVE_ALLOWANCES - {"patches"})
    both = [OnlineLearner(0.15, MARKERS, 0.03, settings=one).stiffness for one in (OnlineSettings(), without)]
    more = np.subtract(*(one.log_at(np.array([MARKERS[1], 0.5]))[1] ** 2 for one in both))
    np.testing.assert_allclose(more, [PATCH_SD**2, 0.0], atol=0.02)


def test_a_push_near_the_clamp_is_learned_from() -> None:
    beam, push_s = Beam(0.15, Uniform(0.02)), 0.3
    made = observed(beam, 3.0 * forces(40), at_s=push_s, noise=NOISE)
    band = replay(made, 0.05, settings=FEW).stiffness.band(np.array([0.1, 0.2]))
    assert np.all((band.low < 0.02) & (band.high > 0.02))


def test_thickness_and_size_of_the_tags_come_from_the_recording() -> None:
    made = with_stated(observed(SOFT, forces(10)), thickness=0.011, tag_size=0.012)
    assert (settings_for(made).thickness, settings_for(made).tag_size) == (0.011, 0.012)
    assert settings_for(observed(SOFT, forces(10))).thickness is None
    learner = replay(made, 0.03, settings=FEW)
    known = next(n for n in learner.nuisances() if n.name == "change of section thickness squared")
    assert known.prior_sd == KNOWN_SD


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        (OnlineSettings(thickness=-0.01), "thickness"),
        (OnlineSettings(tag_size=np.inf), "tag_size"),
        (OnlineSettings(allowances=frozenset({"section", "camera"})), "no allowance for: camera"),
    ],
)
def test_what_makes_no_sense_is_refused(settings: OnlineSettings, word: str) -> None:
    with pytest.raises(LearningError, match=word):
        OnlineLearner(0.15, MARKERS, 0.03, settings=settings)


def test_it_says_what_it_does_not_allow_for() -> None:
    learner = OnlineLearner(0.15, MARKERS, 0.03, settings=FEW)
    assert learner.left_out == (
        "camera",
        "gravity direction",
        "hysteresis",
        "inertia",
        "lag",
        "light",
        "outline",
        "outline height",
        "rolling shutter",
        "rub",
    )
    ideal = OnlineLearner(0.15, MARKERS, 0.03, settings=replace(IDEAL_LIVE, functions=12))
    assert set(ideal.left_out) == OF_ONE
