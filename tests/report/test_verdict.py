"""One verdict: the same words everywhere, one error, one thing to do next."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from onebend.cli.screens import show_run
from onebend.learning.criticism import Finding
from onebend.learning.outcome import Notice, another_beam
from onebend.learning.posterior import Posterior
from onebend.learning.run import Run
from onebend.learning.verdict import fit_notices, fitted_rms, possible
from onebend.records import MassLine, Remark, StatedSection
from onebend.report.page import cards, code_in, page
from onebend.report.sentences import worded
from onebend.report.verdict import hopeless, validation_verdict, verdict_of
from onebend.results.learned_files import summary_of
from tests import made_up


def fitted() -> Posterior:
    found = made_up.posterior()
    assert not found.doubts
    return found


def with_alarm(name: str, value: list[float] | None = None) -> Posterior:
    """A fit whose test of `name` stands out, and of nothing else."""
    found = fitted()
    critic = found.criticism

    def one(finding: Finding) -> Finding:
        odd = finding.score.suspect.name == name
        there = finding.score.value if value is None or not odd else np.array(value)
        score = replace(finding.score, log10_p=-30.0 if odd else -0.1, value=there, gain=500.0 if odd else 1.0)
        return replace(finding, score=score, sds=9.0 if odd else 0.1)

    assert any(finding.score.suspect.name == name for finding in critic.findings)
    return replace(found, criticism=replace(critic, findings=tuple(map(one, critic.findings))))


def as_poses(found: Posterior) -> Posterior:
    """The same, as if it had been learned from poses on a bench."""
    whole = tuple(replace(r, observations=replace(r.observations, static=True)) for r in found.recordings)
    return replace(found, problem=replace(found.problem, recordings=whole))


def validated(rms: float, sensor: float, likely: float = np.nan, **changes: Any) -> Run:
    found = made_up.findings(1)
    one = replace(
        found.validations[0],
        rms=np.array([0.0001, 0.0002, rms]),
        sensor_rms=np.array([1e-4, 2e-4, sensor]),
        likely_rms=np.array([1e-4, 2e-4, likely]),
    )
    return replace(found, validations=(one,), **changes)


def test_terminal_report_and_summary_say_the_same() -> None:
    found = made_up.findings(1)
    verdict = verdict_of(found)
    where = Console(file=io.StringIO(), width=300, color_system=None)
    show_run(where, found, Path("out"))
    assert isinstance(where.file, io.StringIO)
    html, shown = page(found, {}), where.file.getvalue()
    summary = summary_of(found)["verdict"]
    for words in (verdict.headline, *(words for _, words in verdict.rows)):
        assert words in shown
        assert code_in(words) in html
        assert words in summary.values()
    assert summary["error_m"] == pytest.approx(max(found.validations[0].rms))
    [card] = [card for card in cards(found) if card[0] == "verdict"]
    assert card[1:] == (verdict.grade, verdict.rests_on)


def test_a_validation_is_held_against_what_the_sensor_allows() -> None:
    motion = 1e3 * np.ptp(made_up.comparison(largest=0.2).measured[:, 2, 1][np.r_[0:10, 12:90]])
    good = verdict_of(validated(0.0033, 0.0038))
    assert "3.30 mm RMS (worst: tag 3); force noise 3.80 mm: as good" in good.use
    assert (good.error, good.error_of) == (0.0033, "validation")
    fair = verdict_of(validated(0.0020, 0.0010))
    assert f"shapes are predicted to {100 * 2.0 / motion:.1f}"[:-1] in fair.use
    bad = verdict_of(validated(0.030, 0.0010))
    assert "no good prediction" in bad.use
    assert "shows this beam" in bad.next
    unknown = verdict_of(validated(0.0020, np.nan))
    assert "noise" not in unknown.use
    assert "nan" not in unknown.use.lower()


def test_a_validation_is_held_against_the_band_and_the_place_of_the_push_too() -> None:
    as_known = verdict_of(validated(0.0020, 0.0005, 0.0018)).use
    assert "force noise 0.50 mm, with the band of k(s) and the push's place 1.80 mm: shapes are" in as_known
    assert as_known.endswith("as well as its band says")
    off = verdict_of(validated(0.0040, 0.0005, 0.0018)).use
    assert "place 1.80" in off
    assert "as well as" not in off
    assert "place" not in verdict_of(validated(0.0006, 0.0005, 0.0018)).use  # the sensor's noise is enough


def test_no_other_beam_is_suspected_where_the_band_explains_the_error() -> None:
    for likely, suspected in ((0.001, True), (0.005, False), (np.nan, True)):
        found = validated(0.008, 0.0005, likely).validations[0]
        assert bool(another_beam(found)) is suspected
        assert found.failed is (suspected and bool(np.isfinite(likely)))  # by what is likely, if that is known


def test_a_beam_that_is_identified_nowhere_is_not_said_to_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    found, known = made_up.findings(0), fitted().stiffness
    assert "hold" in verdict_of(found).headline
    vague = replace(known, covariance=100.0 * np.eye(len(known.mean)))
    monkeypatch.setattr(Posterior, "stiffness", vague)
    verdict = verdict_of(found)
    assert "identified nowhere" in verdict.headline
    assert "hold" not in verdict.headline
    assert "not identified" in verdict.known


def test_a_failed_validation_is_a_doubt_about_the_band() -> None:
    contradicted = replace(fitted(), contradicted_by=("again",))
    assert "again" in contradicted.doubts[-1]
    assert not np.any(contradicted.stiffness.band(np.linspace(0.1, 0.9, 5)).identified)


def test_what_was_not_validated_is_said_to_be_so_and_a_push_asked_for() -> None:
    found = made_up.findings(0)
    verdict = verdict_of(found)
    assert "not validated on another push" in verdict.use
    assert verdict.error == pytest.approx(max(float(np.nanmax(rms)) for rms in fitted_rms(fitted())))
    assert "second push" in verdict.next
    alone = verdict_of(made_up.findings(0, fitted=False))
    assert (alone.grade, alone.error_of) == ("no band", "as logged")
    assert "--method fit" in alone.next


def test_a_fit_that_needs_a_wrong_force_is_no_good_prediction() -> None:
    found = made_up.findings(0)
    off = replace(found.trainings[0], rms=np.array([0.001, 0.002, 0.040]))
    assert "under the force as logged by 40.00" in verdict_of(replace(found, trainings=(off,))).use


def test_what_comes_next_is_one_thing_and_the_gravest_first() -> None:
    remark = Remark("warning", "The force looks reversed. Give acts_on the other value.", doubt=True)
    found = made_up.findings(0)
    doubted = fitted()
    first = doubted.recordings[0]
    seen = made_up.with_source(first.observations, remarks=(remark,))
    doubted = replace(doubted, problem=replace(doubted.problem, recordings=(replace(first, observations=seen),)))
    verdict = verdict_of(replace(found, posterior=doubted))
    assert verdict.grade == "not to be trusted"
    assert verdict.next == "The force looks reversed. Give acts_on the other value"
    assert verdict.use.startswith("none")
    alarm = with_alarm("push place", [-0.1])
    alarmed = verdict_of(replace(found, posterior=alarm))
    assert "check at_s in [push]" in alarmed.next
    both = replace(alarm, problem=doubted.problem)  # the log's axes are wrong, which looks like another place as well
    assert verdict_of(replace(found, posterior=both)).next == verdict.next
    assert "1 stands out (push place)" in alarmed.rests_on


@pytest.mark.parametrize("name", ["push place", "force direction"])
def test_poses_have_no_place_of_a_push_and_no_log(name: str) -> None:
    pushed = with_alarm(name, [-0.1])
    assert possible(pushed).criticism.causes
    poses = as_poses(pushed)
    assert not possible(poses).criticism.causes
    verdict = verdict_of(replace(made_up.findings(0), posterior=poses))
    words = " ".join((verdict.rests_on, verdict.next, *(remark.text for remark in worded(fit_notices(poses)))))
    assert "at_s" not in words
    assert "rotation_deg" not in words
    assert "1 stands out" in verdict.rests_on  # what does not fit is said nevertheless
    assert any("no known cause explains it" in remark.text for remark in worded(fit_notices(poses)))


def test_a_test_of_which_the_data_tell_nothing_is_none() -> None:
    found = fitted()
    critic = found.criticism
    count = len(possible(found).criticism.findings)
    first, *others = critic.findings

    def blind(finding: Finding) -> Finding:
        return replace(finding, score=replace(finding.score, value=np.full_like(finding.score.value, np.nan)))

    one = replace(found, criticism=replace(critic, findings=(blind(first), *others)))
    assert verdict_of(replace(made_up.findings(0), posterior=one)).rests_on.startswith(f"{count - 1} tests")
    assert len(possible(one).criticism.able) == count - 1
    all_blind = replace(found, criticism=replace(critic, findings=tuple(map(blind, critic.findings))))
    none = replace(made_up.findings(0), posterior=all_blind)
    assert verdict_of(none).rests_on.startswith("no test")
    assert "No test is possible" in page(none, {})


def test_no_weight_is_named_that_the_beam_cannot_bear() -> None:
    light, absurd = with_alarm("weight", [0.0, 0.1]), with_alarm("weight", [0.0, 84.0])
    assert possible(light).criticism.causes
    assert not possible(absurd).criticism.causes
    heavy = made_up.with_stated(absurd.recordings[0].observations, mass=9.0, mass_line=MassLine(np.ones(1), np.ones(1)))
    borne = replace(absurd.recordings[0], observations=heavy)
    assert possible(replace(absurd, problem=replace(absurd.problem, recordings=(borne,)))).criticism.causes


def test_where_nothing_means_anything_no_value_is_shown() -> None:
    found, problem = made_up.findings(0), fitted().problem
    moved = tuple(replace(recording, measured=recording.measured + 1.0) for recording in problem.recordings)
    far = replace(found, posterior=replace(fitted(), problem=replace(problem, recordings=moved)))
    assert hopeless(far)
    verdict = verdict_of(far)
    assert "no estimate is meaningful" in verdict.known
    assert verdict.rests_on.startswith("nothing")
    where = Console(file=io.StringIO(), width=100, color_system=None)
    show_run(where, far, Path("out"))
    assert isinstance(where.file, io.StringIO)
    assert "EI / L" not in where.file.getvalue()


@pytest.mark.parametrize(("mass", "hangs"), [(0.08, False), (8.0, True)])
def test_a_beam_that_would_hang_far_down_tells_of_the_forces_unit(mass: float, hangs: bool) -> None:
    found = fitted()
    first = found.recordings[0]
    section = StatedSection("rectangle", np.array([0.0, 1.0]), np.full(2, 0.02), np.full(2, 0.03))
    stated = replace(first.observations.stated, section=section, mass=mass)
    whole = (replace(first, observations=replace(first.observations, stated=stated)), *found.recordings[1:])
    said = worded(fit_notices(replace(found, problem=replace(found.problem, recordings=whole))))
    assert [one.level for one in said if "hang down out of the plane" in one.text] == ["warning"] * hangs


def test_validations_have_one_line_and_know_the_data_that_was_learned_from() -> None:
    found = made_up.findings(2)
    assert validation_verdict(found.validations).startswith("validation on ")
    own = replace(found.validations[0], remarks=(Notice("no validation", {"recording": "rec"}),))
    assert validation_verdict([own, found.validations[1]]) == f"no validation: the beam was learned from {own.name}"
    unseen = replace(own, remarks=(), rms=np.full(3, np.nan))
    assert validation_verdict([unseen]) == ""


def test_the_verdict_names_what_no_test_sees() -> None:
    found = made_up.findings(0)
    said = verdict_of(found).given
    force = float(np.linalg.norm(found.recordings[0].force, axis=1).max())
    assert f"the log being of this push and in N (at most {force:.3g} N)" in said
    assert "the length of 150 mm" in said
    assert ("rests on", said) in verdict_of(found).rows
    hung = made_up.with_stated(replace(found.recordings[0], gravity=np.tile([-9.81, -1e-17], (90, 1))), mass=0.07)
    assert verdict_of(replace(found, recordings=(hung,))).given.endswith(
        "the mass of 70 g, gravity turned by -180 deg from the beam's direction at the clamp"
    )


def test_a_wrong_unit_is_the_next_thing_to_correct_even_where_k_is_trusted() -> None:
    found = made_up.findings(0)
    heavy = Remark("warning", "The largest force is 103 N: is the log in grams?", about="force unit")
    assert verdict_of(replace(found, remarks=(heavy,))).next == heavy.text.rstrip(".")
