"""Clamp, rest curvature, picture scale and clock before the data: as stated, held by 0, and by whom they are stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.learning.fit_data import at_rest
from onebend.learning.optimizer import first_problem
from onebend.learning.parameters import Block, Spline, clamp_sd, make_layout
from onebend.learning.posterior import Nuisance, Posterior, fit
from onebend.learning.verdict import fit_notices
from onebend.live.model import session_of
from onebend.live.replayed import replay, settings_for
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import CLAMP_SD, CURVATURE_SD, SCALE_SD, ClockOffset, Observations, View
from onebend.report.sentences import worded
from onebend.results.observations_file import load_observations, save_observations
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.made_up import with_source, with_stated

SPLINE = Spline(8)
VIEW = View(np.eye(3), np.zeros(5), np.eye(3), np.ones(3), calibrated=False, corner_sd=0.1)
NAMES = {"clamp": "clamp angle", "curvature": "q0 mean", "scale": "camera scale", "clock": "clock offset"}


@cache
def made() -> Observations:
    """Seen by a camera that is not calibrated, of a beam that may be curved, on a clock of its own."""
    plain = observed(SOFT, forces(30), noise=(2e-5, 1e-3))
    return with_source(with_stated(plain, rest="unknown"), view=VIEW, clock=ClockOffset(250.0, 0.01, 250.2, True))


def stated(name: str, sd: float) -> Observations:
    """`made` with one sd of a nuisance."""
    clock = made().source.clock
    assert clock is not None
    if name == "clock":
        return with_source(made(), clock=replace(clock, sd=sd))
    return with_stated(made(), **{f"{name}_sd": sd})


def block(one: Observations, name: str) -> Block:
    return make_layout(SPLINE, [one], [0]).index[name, -1 if name == "curvature" else 0]


@cache
def learned(name: str, sd: float) -> Posterior:
    return fit([stated(name, sd)], 0.02, settings=replace(IDEAL, functions=8))


def reported(posterior: Posterior, name: str) -> list[Nuisance]:
    return [one for one in posterior.nuisances() if one.name.endswith(NAMES[name])]


def test_what_nobody_states_is_as_usual() -> None:
    assert block(made(), "clamp").prior_sd[0] == np.hypot(CLAMP_SD, MOUNTING_SD)
    assert np.all(block(made(), "curvature").prior_sd == CURVATURE_SD)
    assert block(made(), "scale").prior_sd[0] == SCALE_SD
    assert block(made(), "clock").prior_sd[0] == 0.02
    assert block(with_source(made(), view=replace(VIEW, calibrated=True)), "scale").start < 0
    assert block(with_stated(made(), rest="straight"), "curvature").start < 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_zero_holds_a_nuisance_and_the_fit_reports_none(name: str) -> None:
    held = learned(name, 0.0)
    at = held.layout.index[name, -1 if name == "curvature" else 0]
    assert at.start < 0
    assert np.all(at.prior_sd == 0.0)
    assert np.all(held.layout.get(held.mean, name, at.recording) == 0.0)
    assert reported(held, name) == []
    others = [other for other in NAMES if other != name]
    assert [len(reported(held, other)) for other in others] == [1, 1, 1]
    assert np.all(np.isfinite(held.band(np.linspace(0.1, 0.9, 9)).high))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "narrow", "wide"), [("clamp", 0.04, 0.4), ("curvature", 0.05, 0.5),
                                                      ("scale", 0.001, 0.1), ("clock", 0.001, 0.5)])  # fmt: skip
def test_a_wider_prior_is_reported_and_leaves_more_open(name: str, narrow: float, wide: float) -> None:
    ((small,), (large,)) = (reported(learned(name, sd), name) for sd in (narrow, wide))
    assert large.prior_sd > 3.0 * small.prior_sd
    assert large.sd > small.sd
    assert 0.0 < small.sd < 1.001 * small.prior_sd
    if name == "clamp":
        assert small.prior_sd == np.hypot(narrow, MOUNTING_SD)
    elif name != "clock":
        assert (small.prior_sd, large.prior_sd) == (narrow, wide)


def test_what_is_asked_of_the_fit_wins_over_the_recording() -> None:
    for written in (0.0, 0.3):
        for asked, sd in ((0.02, np.hypot(0.02, MOUNTING_SD)), (0.0, 0.0)):
            settings = replace(IDEAL, functions=8, clamp_sd=asked)
            problem, _ = first_problem([stated("clamp", written)], 0.02, settings)
            assert problem.layout.index["clamp", 0].prior_sd[0] == sd
    pose = with_stated(replace(made(), static=True), clamp_sd=0.01)
    assert clamp_sd(pose) == 0.01
    assert clamp_sd(with_stated(pose, clamp_sd=0.2)) == 0.2


def test_a_calibrated_camera_may_still_be_doubted() -> None:
    seen = with_source(made(), view=replace(VIEW, calibrated=True))
    assert block(with_stated(seen, scale_sd=0.01), "scale").prior_sd[0] == 0.01
    assert block(with_stated(with_source(made(), view=None), scale_sd=0.01), "scale").start < 0


def test_a_curvature_of_none_is_a_straight_beam() -> None:
    bent = with_stated(replace(made(), rest_xy=made().rest_xy + np.array([0.0, 2e-3])), curvature_sd=0.0)
    straight = with_stated(bent, rest="straight")
    assert np.all(at_rest(bent).theta0 == 0.0)
    assert np.all(at_rest(with_stated(bent, curvature_sd=0.1)).theta0 != 0.0)
    np.testing.assert_array_equal(at_rest(bent).offset, at_rest(straight).offset)
    assert clamp_sd(bent) == clamp_sd(straight)


def test_of_two_recordings_of_a_beam_the_one_that_may_be_curved_counts() -> None:
    pair = [with_stated(made(), rest="straight"), stated("curvature", 0.4)]
    assert make_layout(SPLINE, pair, [0, 0]).index["curvature", -1].prior_sd[0] == 0.4


def test_a_stated_clamp_wider_than_usual_is_warned_of() -> None:
    assert [one for one in worded(fit_notices(learned("clamp", 0.0))) if "left free" in one.text] == []
    (told,) = [one for one in worded(fit_notices(learned("clamp", 0.4))) if "left free" in one.text]
    assert told.level == "warning"
    assert "usual: 2 deg" in told.text


@pytest.mark.slow
def test_the_live_learner_has_what_is_stated() -> None:
    for name in NAMES:
        held, free = (settings_for(stated(name, sd)) for sd in (0.0, 0.3))
        for settings, wide in ((held, False), (free, True)):
            at = session_of(SPLINE, MARKERS, settings.sds, length=0.15, mass=0.0).layout
            one = at.index[name, -1 if name == "curvature" else 0]
            assert (one.start >= 0) == wide
            assert one.prior_sd[0] == block(stated(name, 0.3 if wide else 0.0), name).prior_sd[0]
    learner = replay(stated("curvature", 0.0), 0.03)
    assert not [one for one in learner.nuisances() if one.name.startswith("q0")]


def test_what_is_stated_is_kept_with_the_results(tmp_path: Path) -> None:
    one = with_stated(made(), clamp_sd=0.02, curvature_sd=0.4, scale_sd=0.05)
    save_observations(tmp_path / "observations.parquet", one)
    again = load_observations(tmp_path)
    assert (again.stated.clamp_sd, again.stated.curvature_sd, again.stated.scale_sd) == (0.02, 0.4, 0.05)
