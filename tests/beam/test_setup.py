"""A learned beam in the set-up of its recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.setup import PARTS, SetUp
from onebend.beam.stiffness import LogSpline, UncertainStiffness
from onebend.control.goals import tags
from onebend.control.reach import ReachSettings, predicted_error, reach, reach_in_setup
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array

KNOTS = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, 6), np.ones(3)])
MEAN = np.log(0.03) + np.linspace(-0.3, 0.4, 8)
KNOWN = UncertainStiffness(KNOTS, MEAN, 0.05**2 * np.eye(8))
BEAM = Beam(0.2, LogSpline(tuple(KNOTS.tolist()), tuple(MEAN.tolist())))
SIZES = {"length": 1, "along": 2, "across": 2, "turn": 2, "clamp": 1, "clamp gives": 1, "origin": 2, "place": 1,
         "slide": 1, "direction": 1, "force error": 10, "gain": 1}  # fmt: skip
FORCE = np.array([[0.1, 0.2], [-0.1, 0.35], [0.0, 0.5]])


def setup(**values: float | list[float]) -> SetUp:
    """Zero but for these parts, all known to a hundredth of the sds before."""
    n = sum(SIZES.values())
    sd = np.concatenate([np.full(size, 1e-3 if PARTS[name][0] == "m" else 0.01) for name, size in SIZES.items()])
    out = SetUp(1.0, (0.0, 0.5), (0.5, 1.0), 0.016, SIZES, np.zeros(n), np.zeros((n, 8)), np.diag(1e-4 * sd**2), sd)
    mean = out.mean.copy()
    for name, value in values.items():
        mean[out.columns[name.replace("_", " ")]] = value
    return replace(out, mean=mean)


def tips(one: SetUp, force: Array = FORCE) -> Array:
    return one.bent(BEAM, KNOWN, force).solved.xy(np.array([1.0]))[:, 0]


def test_a_setup_without_faults_is_the_beam() -> None:
    plain = replace(setup(), thickness=1e-9)
    here = plain.bent(BEAM, KNOWN, FORCE)
    exact = equilibrium(BEAM, push(FORCE, 1.0))
    np.testing.assert_allclose(here.solved.xy(np.array([0.5, 1.0])), exact.xy(np.array([0.5, 1.0])), atol=1e-8)
    np.testing.assert_allclose(here.tags()[..., :2], exact.xy(np.array([0.5, 1.0])), atol=1e-8)


def test_a_force_error_is_a_polynomial_in_the_displacement_of_the_pushed_place() -> None:
    error = np.array([0.03, -0.02, 0.01, 0.04, -0.05, -0.01, 0.02, 0.03, -0.04, 0.05])  # N: x, y, x^2, x y, y^2 each
    bent = setup(force_error=error.tolist()).bent(BEAM, KNOWN, FORCE)
    x, y = (bent.solved.xy(np.array([1.0]))[:, 0] / BEAM.length - [1.0, 0.0]).T
    terms = np.stack([x, y, x * x, x * y, y * y], axis=1)
    np.testing.assert_allclose(bent.acting - FORCE, terms @ error.reshape(2, 5).T, rtol=0.02, atol=1e-4)


def test_a_material_is_as_soft_as_it_was_under_the_largest_force() -> None:
    """Of a share of 0.2, half had relaxed over the push and all of it under the largest force."""
    plain = setup()
    columns = plain.columns["gain"]  # its number is taken for the share that relaxes
    sizes = {**{name: n for name, n in SIZES.items() if name != "gain"}, "relaxation": 1}
    mean = plain.mean.copy()
    mean[columns] = 0.2
    one = replace(plain, sizes=sizes, mean=mean, times=(1.0,), reached=(0.5,), reached_at_largest=(1.0,))
    softer = replace(KNOWN, mean=MEAN + np.log(0.8 / 0.9))
    np.testing.assert_allclose(tips(one), plain.bent(BEAM, softer, FORCE).xy(np.array([1.0]))[:, 0], atol=1e-5)


def test_a_push_off_its_place_is_a_force_and_a_moment() -> None:
    """Without bending beyond it, a force off by d acts as at d farther along the tangent."""
    off = 0.004
    moved, there = replace(setup(place=-off), thickness=1e-9), 1.0 - off / BEAM.length
    exact = equilibrium(BEAM, push(FORCE, there)).xy(np.array([0.5]))
    np.testing.assert_allclose(moved.bent(BEAM, KNOWN, FORCE).solved.xy(np.array([0.5])), exact, atol=1e-4)


@pytest.mark.parametrize(
    ("part", "value"), [("direction", 0.05), ("gain", 0.04), ("force_error", [0.02, -0.01, *[0.0] * 8])]
)
def test_what_the_sensor_shows_bends_the_beam_as_the_force_on_it(part: str, value: float | list[float]) -> None:
    one = setup(**{part: value})
    bent = setup().bent(BEAM, KNOWN, FORCE)
    shown = one.logged(FORCE, bent.moved)
    assert np.max(np.abs(shown - FORCE)) > 1e-3
    np.testing.assert_allclose(tips(one, shown), tips(setup()), atol=2e-5)  # four passes


def test_new_parts_have_their_priors_again() -> None:
    old = setup(place=0.002, direction=0.03, clamp=0.01, length=0.004)
    new = old.renewed(["tool"])
    column = old.columns["place"].start
    assert new.mean[column] == 0.0
    assert new.covariance[column, column] == old.prior_sd[column] ** 2
    for name in ("direction", "clamp", "length"):
        assert new.mean[new.columns[name]] == old.mean[old.columns[name]]
    every = old.renewed(["tool", "sensor", "mounting"])
    assert {name for name in ("direction", "clamp", "place") if np.any(every.mean[every.columns[name]])} == set()
    with pytest.raises(MechanicsError, match="new may be of"):
        old.renewed(["camera"])  # type: ignore[list-item]


def test_draws_follow_log_k() -> None:
    one = setup()
    slope = one.slope.copy()
    slope[one.columns["place"], 3] = 0.01
    coefficients, numbers = replace(one, slope=slope).draw(KNOWN, 4000, seed=1)
    place = numbers[:, one.columns["place"]][:, 0]
    assert np.corrcoef(place, coefficients[:, 3])[0, 1] > 0.99
    np.testing.assert_allclose(np.std(coefficients, axis=0), 0.05, rtol=0.06)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.floats(-0.003, 0.003), st.floats(0.0, 0.01), st.floats(-0.02, 0.02), st.floats(-0.004, 0.004))
def test_the_ideal_beam_goes_where_the_set_up_goes(place: float, gives: float, clamp: float, length: float) -> None:
    one = setup(place=place, clamp_gives=gives, clamp=clamp, length=length)
    ideal, _ = one.ideal(BEAM, KNOWN)
    there = equilibrium(ideal, push(FORCE, 1.0)).xy(np.array([1.0]))[:, 0]
    assert np.max(np.linalg.norm(there - tips(one), axis=1)) < 2e-4


@pytest.mark.slow
def test_the_band_of_the_ideal_beam_is_as_wide_as_places_spread_in_the_set_up() -> None:
    sure, wide = setup(), setup()
    column = wide.columns["place"].start
    covariance = wide.covariance.copy()
    covariance[column, column] = 0.005**2
    wide = replace(wide, covariance=covariance)
    sds = []
    for one in (sure, wide):
        ideal, known = one.ideal(BEAM, KNOWN)
        there = reach(ideal, tips(one)[2])
        sds.append(predicted_error(ideal, known, there, draws=0).ellipse().semi_axes[0])
        drawn = reach_in_setup(BEAM, KNOWN, one, tips(one)[2]).predicted.ellipse().semi_axes[0]
        assert sds[-1] == pytest.approx(drawn, rel=0.25)
    assert sds[1] > 1.1 * sds[0]


def test_a_goal_is_met_in_the_set_up() -> None:
    one = setup(
        place=0.003, clamp_gives=0.01, direction=0.02, force_error=[0.02, -0.01, 0.01, *[0.0] * 7], origin=[1e-3, 0.0]
    )
    goal = tips(one, np.array([[0.05, 0.4]]))[0] + one.origin
    found = reach_in_setup(BEAM, KNOWN, one, goal)
    np.testing.assert_allclose(tips(one, found.force[None])[0] + one.origin, goal, atol=1e-6)
    np.testing.assert_allclose(found.force, (0.05, 0.4), atol=1e-3)
    alone = reach(BEAM, goal)
    assert np.linalg.norm(tips(one, alone.force[None])[0] + one.origin - goal) > 1e-3
    assert found.predicted.holds(goal)
    new = reach_in_setup(BEAM, KNOWN, one, goal, new=("tool", "sensor"))
    assert new.predicted.ellipse().semi_axes[0] > 1.5 * found.predicted.ellipse().semi_axes[0]
    np.testing.assert_array_equal(found.path[0], 0.0)
    with pytest.raises(ControlError, match="cannot be put on"):
        reach_in_setup(BEAM, KNOWN, one, (0.3, 0.0))
    with pytest.raises(ControlError, match=r"it needs 0\.4\d* N, and 0\.1 N are allowed"):
        reach_in_setup(BEAM, KNOWN, one, goal, settings=ReachSettings(max_force=0.1))


def of_unknown_length() -> SetUp:
    """Known to 1 mm."""
    sure = setup()
    covariance = sure.covariance.copy()
    column = sure.columns["length"].start
    covariance[column, column] = 0.005**2
    return replace(sure, covariance=covariance)


@pytest.mark.slow
def test_a_goal_within_the_error_of_the_length_takes_no_great_force() -> None:
    sure, force = setup(), np.array([[0.0, 0.1]])
    goal = tips(sure, force)[0] + [5e-4, 0.0]
    found = reach_in_setup(BEAM, KNOWN, of_unknown_length(), goal)
    assert not found.converged
    assert "no force meets the goal" in found.reason
    assert found.predicted.holds(goal)
    assert found.error < 6e-4
    assert abs(found.reached[1] - goal[1]) < 3e-4  # what the beam can do, it does
    np.testing.assert_allclose(found.force, force[0], atol=0.1)
    with pytest.raises(ControlError, match=r"no force in this set-up.*it was learned from .*Take a goal nearer"):
        reach_in_setup(BEAM, KNOWN, sure, goal)


@pytest.mark.slow
def test_a_goal_that_noise_of_the_force_explains_takes_none_either() -> None:
    drifting, goal = replace(of_unknown_length(), force_sd=0.01), tips(setup(), np.array([[0.0, 0.1]]))[0] + [5e-4, 0]
    error = reach_in_setup(BEAM, KNOWN, drifting, goal)
    assert error.error < 0.01 * BEAM.length
    assert error.predicted.ellipse().semi_axes[0] > 0.02 * BEAM.length
    with pytest.raises(ControlError):  # the place says nothing of the goal
        reach_in_setup(BEAM, KNOWN, replace(drifting, force_sd=0.2), goal)


def test_a_push_elsewhere_is_a_new_contact_on_the_beam() -> None:
    old = setup(place=0.002, slide=0.001)
    new = old.renewed(push_s=0.8, length=BEAM.length)
    column, sd = old.columns["place"].start, old.prior_sd[old.columns["place"]][0]
    assert new.push_s == 0.8
    assert new.mean[column] == pytest.approx(0.0, abs=1e-12)
    assert new.mean[old.columns["slide"]] == old.mean[old.columns["slide"]]
    tip = old.renewed(["contact"], length=BEAM.length)  # half a normal density: nothing acts beyond the tip
    assert tip.mean[column] == pytest.approx(-np.sqrt(2.0 / np.pi) * sd)
    assert tip.covariance[column, column] == pytest.approx((1.0 - 2.0 / np.pi) * sd**2)


def test_a_set_up_survives_json_and_refuses_what_is_none() -> None:
    one = setup(place=0.002)
    again = SetUp.from_dict(one.as_dict())
    np.testing.assert_array_equal(again.mean, one.mean)
    np.testing.assert_array_equal(again.covariance, one.covariance)
    assert (again.sizes, again.force, again.tags) == (one.sizes, one.force, one.tags)
    for broken in ({"mean": [0.0]}, {"sizes": {"camera": 1}}, {"thickness": float("nan")}, {"slope": None}):
        with pytest.raises(MechanicsError):
            SetUp.from_dict({**one.as_dict(), **broken})


def test_where_only_a_gripper_holds_the_sensor_shows_no_push() -> None:
    bent = equilibrium(BEAM, push(FORCE, 1.0))
    assert setup().shown(bent.problem, bent, np.zeros((len(FORCE), 0, 2))).shape == (3, 0, 2)


TAGGED: dict[str, float | list[float]] = {"along": [6e-4, -5e-4], "across": [-4e-4, 7e-4], "turn": [0.02, 0.03]}


def tagged(**values: float | list[float]) -> SetUp:
    """Tags 4 and 7 beside their stated places, in a set-up with errors of every kind."""
    faults: dict[str, float | list[float]] = {
        "clamp_gives": 0.01,
        "direction": 0.02,
        "place": -2e-3,
        "origin": [1e-3, -5e-4],
        "length": 0.003,
    }
    return replace(setup(**{**TAGGED, **faults, **values}), tag_ids=(4, 7))


@pytest.mark.slow
def test_the_centre_of_a_tag_is_put_on_a_goal_and_its_error_is_said() -> None:
    one, force = tagged(), np.array([[0.05, 0.4]])
    there = one.bent(BEAM, KNOWN, force)
    goals = {4: there.tags()[0, 0, :2], 7: there.tags()[0, 1, :2], None: there.xy(np.ones(1))[0, 0]}
    covariances = {}
    for number, goal in goals.items():
        found = reach_in_setup(BEAM, KNOWN, one, goal, tag=number)
        covariances[number] = found.predicted.covariance
        np.testing.assert_allclose(found.force, force[0], atol=1e-4)
        np.testing.assert_allclose(found.reached[:2], goal, atol=1e-6)
        np.testing.assert_allclose(found.predicted.point, goal, atol=1e-6)
    assert np.linalg.norm(goals[7] - goals[None]) > 5e-4
    covariance = one.covariance.copy()
    covariance[one.columns["across"].start + 1, one.columns["across"].start + 1] = 1e-3**2
    loose = replace(one, covariance=covariance)
    for number, goal in goals.items():  # that of the tag counts, and for no other point
        more = reach_in_setup(BEAM, KNOWN, loose, goal, tag=number).predicted.covariance - covariances[number]
        assert np.trace(more) == pytest.approx(1e-3**2 if number == 7 else 0.0, rel=0.2, abs=1e-12)
    with pytest.raises(MechanicsError, match="had no tag 5; it had 4, 7"):
        reach_in_setup(BEAM, KNOWN, one, goals[7], tag=5)
    with pytest.raises(ControlError, match=r"^tag 7, at s = 1: "):
        reach_in_setup(BEAM, KNOWN, one, (0.5, 0.0), tag=7)
    with pytest.raises(MechanicsError, match="names none"):
        setup().tag_at(-1)


@pytest.mark.slow
def test_the_ideal_beam_puts_a_tag_where_the_set_up_puts_it() -> None:
    one = tagged()
    there = one.bent(BEAM, KNOWN, FORCE)
    for number in (4, 7):
        wanted = tags(one, number, (0.0, 0.0))
        ideal, _ = one.ideal(BEAM, KNOWN, points=wanted.s, tags=wanted.tag)
        on_beam = equilibrium(ideal, push(there.acting, 1.0))
        off = wanted.places(on_beam)[:, 0] - there.tags()[:, one.tag_at(number), :2]
        assert np.max(np.linalg.norm(off, axis=1)) < 1e-4
        assert np.max(np.linalg.norm(off + on_beam.xy(wanted.s)[:, 0] - wanted.places(on_beam)[:, 0], axis=1)) > 4e-4


@pytest.mark.slow
def test_the_band_of_the_ideal_beam_holds_the_error_of_a_tag() -> None:
    one = tagged()
    covariance = one.covariance.copy()
    covariance[one.columns["across"].start + 1, one.columns["across"].start + 1] = 1e-3**2
    one = replace(one, covariance=covariance)
    sds = []
    for number in (-1, 7):
        _, known = one.ideal(BEAM, KNOWN, tags=number)
        sds.append(np.sqrt(np.trace(known.covariance)))
    assert sds[1] > 1.1 * sds[0]
