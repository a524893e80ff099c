"""The plan: what it predicts against the fit that comes true, what it ranks, what it leaves out, and its words."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from onebend.beam.stiffness import UncertainStiffness, half_width_words
from onebend.errors import LearningError
from onebend.learning.allowances import WIDTHS
from onebend.learning.design import PLACES, Limits, Plan, PlanSettings, after_push, plan
from onebend.learning.instruments import Instruments, PlannedPush, instruments_of, push_of
from onebend.learning.linear import log_k_map
from onebend.learning.posterior import Posterior, fit
from onebend.records import Array, Observations
from onebend.report.sentences import direction_words, words
from onebend.results.learned_files import plan_summary
from tests.learning.bench import IDEAL, SOFT, observed
from tests.made_up import with_source

NOISE = (2e-5, 1e-3)
FUNCTIONS = replace(IDEAL, functions=10)
MIDDLE = PlannedPush(0.6, 1.9, 0.5)
TIP = PlannedPush(1.0, 1.9, 0.25)


def ramp(push: PlannedPush, seed: int, count: int = 60) -> Observations:
    """A push that grows evenly, its force log wandering a little."""
    unit = np.array([np.cos(push.direction), np.sin(push.direction)])
    force = push.largest * ((np.arange(count) + 0.5) / count)[:, None] * unit
    made = observed(SOFT, force, at_s=push.at_s, noise=NOISE, seed=seed)
    walk = np.cumsum(np.random.default_rng(seed).normal(size=force.shape), axis=0)
    walk *= 0.003 / np.std(walk)
    return with_source(replace(made, force=force + walk, force_sd=np.full(2, 0.003)), name=f"push {seed}")


@pytest.fixture(scope="module")
def middle() -> Posterior:
    return fit([ramp(MIDDLE, 1)], 0.02, settings=FUNCTIONS)


@pytest.fixture(scope="module")
def next_pushes(middle: Posterior) -> Plan:
    return plan(middle.stiffness, middle.beam, instruments_of(middle))


def test_the_bench_holds_what_the_fit_knows_of_tags_and_stiffness_together(middle: Posterior) -> None:
    made, at = instruments_of(middle), middle.layout
    rows = np.concatenate([np.arange(at.size)[at.index[name, -1].where] for name in ("along", "across", "turn")])
    joint, p, f = made.joint(middle.stiffness.covariance), at.spline.count, at.spline.finer.count
    np.testing.assert_allclose(joint[:f, :f], middle.stiffness.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(joint[f:, f:], middle.covariance.pairs[0][np.ix_(rows, rows)], rtol=1e-6, atol=1e-12)
    across = middle.covariance.pairs[0][rows, :p] @ at.spline.on_finer.T
    np.testing.assert_allclose(joint[f:, :f], across, rtol=1e-4, atol=1e-6 * np.abs(across).max())
    assert made.pushes[0].at_s == 0.6
    assert made.pushes[0].direction == pytest.approx(1.9, abs=0.05)
    assert made.frames == 60


@pytest.mark.slow
def test_what_stiffens_the_beam_under_its_tags_is_planned_with() -> None:
    one = fit([ramp(MIDDLE, 1)], 0.02, settings=replace(FUNCTIONS, allowances=frozenset({"patches"})))
    joint, f = instruments_of(one).joint(one.stiffness.covariance), one.layout.spline.finer.count
    shared = (one.layout.index[name, -1].where for name in ("along", "across", "turn"))
    tags = np.concatenate([np.arange(where.start, where.stop) for where in shared])
    index, onto = log_k_map(one.problem)
    assert len(index) == one.layout.spline.count + len(WIDTHS)
    across = one.covariance.pairs[0][np.ix_(tags, index)] @ onto.T
    np.testing.assert_allclose(joint[f:, :f], across, rtol=1e-4, atol=1e-6 * np.abs(across).max())


def test_a_fit_without_a_force_log_tells_no_instruments(middle: Posterior) -> None:
    recording = middle.recordings[0]
    blind = replace(recording, error=replace(recording.error, knots=np.zeros(0)))
    with pytest.raises(LearningError, match="no recording has a force log"):
        instruments_of(replace(middle, problem=replace(middle.problem, recordings=(blind,))))


def test_the_push_of_a_recording_without_load_is_none() -> None:
    made = ramp(TIP, 1)
    assert push_of(replace(made, loaded=np.zeros(60, dtype=bool))).largest == 0.0


def test_the_predicted_band_comes_true() -> None:
    first, second = ramp(TIP, 1), ramp(MIDDLE, 2)
    tip = fit([first], 0.02, settings=FUNCTIONS)
    predicted = after_push(tip.stiffness, tip.beam, instruments_of(tip), MIDDLE).log_at(PLACES)[1]
    both = fit([first, second], 0.02, settings=FUNCTIONS).stiffness.log_at(PLACES)[1]
    assert np.mean(tip.stiffness.log_at(PLACES)[1]) > 1.4 * np.mean(both)
    assert np.mean(predicted) == pytest.approx(np.mean(both), rel=0.25)


def test_no_push_leaves_a_wider_band_anywhere(middle: Posterior) -> None:
    before = middle.stiffness
    for push in (TIP, MIDDLE, PlannedPush(0.3, -1.0, 0.5)):
        after = after_push(before, middle.beam, instruments_of(middle), push)
        assert np.all(after.log_at(PLACES)[1] <= before.log_at(PLACES)[1] * (1.0 + 1e-9))


def test_a_beam_not_pushed_at_its_tip_is_to_be_pushed_there(next_pushes: Plan) -> None:
    assert next_pushes.before.identified_to == pytest.approx(0.6, abs=0.12)
    first = next_pushes.pair[0]
    assert first.push.at_s >= 0.9
    assert not first.needs
    assert first.after.identified > next_pushes.before.identified + 0.2


def test_what_costs_nothing_comes_first_and_another_sensor_last(next_pushes: Plan) -> None:
    cost = [2 if one.better_sensor else 1 if one.added_tag else 0 for one in next_pushes.proposals]
    assert cost == sorted(cost)
    assert set(cost) == {0, 1, 2}
    for each in range(3):
        left = [one.after.mean_width for one, its in zip(next_pushes.proposals, cost, strict=True) if its == each]
        assert left == sorted(left)
    assert not next_pushes.proposals[0].needs


def test_proposals_are_of_every_kind(next_pushes: Plan) -> None:
    assert len(next_pushes.proposals) == 8
    assert all(one.after.mean_width < next_pushes.before.mean_width for one in next_pushes.proposals)
    assert any(one.repeats for one in next_pushes.proposals)
    assert any(one.added_tag is not None for one in next_pushes.proposals)
    assert any(one.better_sensor == 5.0 for one in next_pushes.proposals)
    assert any(not one.needs and not one.repeats for one in next_pushes.proposals)


def test_a_repetition_is_worth_less_than_a_new_place(next_pushes: Plan) -> None:
    again = next(one for one in next_pushes.proposals if one.repeats and not one.needs)
    assert again.push == bench_push(next_pushes)
    assert again.after.mean_width > 2.0 * next_pushes.pair[0].after.mean_width


def bench_push(made: Plan) -> PlannedPush:
    return next(one.push for one in made.proposals if one.repeats)


def test_the_second_of_two_pushes_gains_less_than_the_first(next_pushes: Plan) -> None:
    first, second = next_pushes.pair
    assert second.before == first.after
    gains = [one.before.mean_width - one.after.mean_width for one in (first, second)]
    assert 0.0 < gains[1] < gains[0]


@pytest.mark.slow
def test_limits_hold(middle: Posterior) -> None:
    turn = float(np.deg2rad(25.0))
    limits = Limits(force=0.2, tip_turn=turn)
    made = plan(middle.stiffness, middle.beam, instruments_of(middle), PlanSettings(limits=limits))
    for one in made.proposals:
        if not one.repeats:
            assert one.push.largest <= 0.2
            assert abs(one.tip_turns) <= turn + 1e-9


def test_pushes_that_slip_off_are_left_out_and_said(middle: Posterior) -> None:
    settings = PlanSettings(directions_deg=(90.0, 180.0, 0.0), at_s=(0.6, 1.0))
    made = plan(middle.stiffness, middle.beam, instruments_of(middle), settings)
    assert all(abs(np.sin(one.push.direction)) > 0.5 for one in made.proposals)
    assert made.left_out == (
        "4 pushes at s = 0.6 to 1 in directions [0, 180] deg left out: "
        "the force does not press the beam there, the tool slips off.",
    )


def test_pushes_that_buckle_the_beam_are_left_out_and_said(middle: Posterior) -> None:
    settings = PlanSettings(directions_deg=(90.0, 180.0), at_s=(1.0,), limits=Limits(slant=np.pi))
    made = plan(middle.stiffness, middle.beam, instruments_of(middle), settings)
    assert "1 push at s = 1 in directions [180] deg left out: the beam buckles or snaps through." in made.left_out


@pytest.mark.slow
def test_a_common_gain_stays_but_for_another_sensor(middle: Posterior) -> None:
    known, made = replace(middle.stiffness, gain_sd=0.1), replace(instruments_of(middle), gain_sd=0.1)
    found = plan(known, middle.beam, made)
    floor = 2.0 * 1.959964 * 0.1
    for one in found.proposals:
        if one.better_sensor is None:
            assert one.after.mean_width > floor
    assert min(one.after.mean_width for one in found.proposals if one.better_sensor) < floor


def test_a_bench_of_another_fit_is_refused(middle: Posterior) -> None:
    known = middle.stiffness
    other = UncertainStiffness(np.array([0, 0, 0, 0, 1, 1, 1, 1.0]), np.full(4, -4.0), np.eye(4))
    with pytest.raises(LearningError, match="does not belong"):
        plan(other, middle.beam, instruments_of(middle))
    with pytest.raises(LearningError, match="no push is possible"):
        plan(known, middle.beam, replace(instruments_of(middle), pushes=()), PlanSettings(directions_deg=(0.0,)))


def test_a_bench_comes_back_from_what_it_writes(middle: Posterior) -> None:
    made = instruments_of(middle)
    again = Instruments.from_dict(json.loads(json.dumps(made.as_dict(), allow_nan=False)))
    assert again.as_dict() == made.as_dict()
    assert again.pushes == made.pushes
    assert again.force == made.force


@pytest.mark.parametrize(
    "change",
    [
        {"tag_sd": [[1.0]]},
        {"tag_sd": [[0.0, 1.0, 1.0]] * 3},
        {"frames": float("nan")},
        {"frames": 0},
        {"force": {"level": 1.0}},
        {"force": None},
        {"pushes": [3]},
        {"shared": ["along"]},
        {"shared_slope": "x"},
        {"colour": 1},
    ],
)
def test_a_damaged_bench_is_refused(middle: Posterior, change: dict[str, Any]) -> None:
    with pytest.raises(LearningError, match="bench"):
        Instruments.from_dict({**instruments_of(middle).as_dict(), **change})


@pytest.mark.parametrize(
    ("degrees", "words"),
    [
        (90.0, "up"),
        (-90.0, "down"),
        (60.0, "up and 30 deg out"),
        (120.0, "up and 30 deg back"),
        (-120.0, "down and 30 deg back"),
        (240.0, "down and 30 deg back"),
    ],
)
def test_directions_in_words(degrees: float, words: str) -> None:
    assert direction_words(np.deg2rad(degrees)) == words


def test_widths_in_words() -> None:
    assert half_width_words(np.log(1.074)) == "± 7.4 %"
    assert half_width_words(np.log(1.25)) == "± 25 %"
    assert half_width_words(np.log(4.0)) == "a factor of 4"
    assert half_width_words(np.inf) == "a factor of inf"


def test_a_proposal_in_one_line(next_pushes: Plan) -> None:
    for one in next_pushes.proposals:
        text = words(one.notice)
        assert text.startswith(f"{'once more: ' if one.repeats else ''}push at s = {one.push.at_s:.2f}, ")
        assert "->" in text
        assert (f", with {words(one.needs)}: k(s)" in text) if one.needs else (", with" not in text)
    assert plan_summary("model", next_pushes)["proposals"][-1]["text"] == text


def test_everything_in_the_plan_is_finite(next_pushes: Plan) -> None:
    json.dumps(plan_summary("model", next_pushes), allow_nan=False)
    sd: list[Array] = [next_pushes.sd, *(one.sd for one in next_pushes.proposals)]
    assert all(np.all(np.isfinite(one)) and len(one) == len(PLACES) for one in sd)
