"""The (n, m) table, BIC, the whole of learning, and validation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, Steps, Table, Uniform
from onebend.errors import LearningError
from onebend.learning.fit_data import at_rest
from onebend.learning.frames import at_frames, usable_frames
from onebend.learning.outcome import Trial
from onebend.learning.paper import Candidate, RegressionSettings, information_criterion, pairs, regress, standing
from onebend.learning.validation import validate
from onebend.records import MassLine
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.made_up import with_stated

S = np.linspace(0.05, 0.9, 50)
# Table II of the paper: M1, M2, M3 [m] and BIC as printed.
PRINTED = [
    ((0.0012, 0.0010, 0.0022), 4.10),
    ((0.0013, 0.0011, 0.0021), 4.10),
    ((0.0012, 0.0011, 0.0021), 4.09),
    ((0.0016, 0.0014, 0.0020), 4.16),
    ((0.0010, 0.0014, 0.0021), 4.08),
    ((0.0025, 0.0023, 0.0036), 4.69),
    ((0.0059, 0.0129, 0.0228), 6.39),
]


@pytest.mark.parametrize(("rms", "printed"), PRINTED)
def test_paper_weighting_follows_the_printed_table(rms: tuple[float, float, float], printed: float) -> None:
    found = information_criterion(np.array(rms), observed=500, parameters=5, kind="paper")
    assert found == pytest.approx(printed, abs=0.03)


def test_textbook_bic_pays_for_parameters() -> None:
    rms = np.array([1e-3, 1e-3, 1e-3])
    few = information_criterion(rms, 1000, 4, "textbook")
    many = information_criterion(rms, 1000, 10, "textbook")
    assert many - few == pytest.approx(6.0 * np.log(1000))


def test_pairs_are_those_of_equation_20() -> None:
    assert pairs(RegressionSettings(method="paper", most_n=3), 3) == [(2, 2), (3, 2), (3, 3)]
    assert max(n for n, _ in pairs(RegressionSettings(method="paper"), 3)) == 6
    assert pairs(RegressionSettings(n=5, m=4), 3) == [(5, 4)]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (RegressionSettings(n=10), "2 to 9"),
        (RegressionSettings(n=3, m=5), "at least as many modes"),
        (RegressionSettings(most_n=12), "at most 9"),
    ],
)
def test_impossible_wishes_are_refused(settings: RegressionSettings, words: str) -> None:
    with pytest.raises(LearningError, match=words):
        regress(observed(SOFT, forces()), settings)


@pytest.fixture(scope="module")
def learned_soft():  # type: ignore[no-untyped-def]
    return regress(observed(SOFT, forces(), noise=(2e-5, 1e-3), seed=1))


def test_stiffness_comes_back_from_noisy_markers(learned_soft) -> None:  # type: ignore[no-untyped-def]
    np.testing.assert_allclose(learned_soft.beam.stiffness(S), SOFT.stiffness(S), rtol=0.06)
    assert learned_soft.trials[learned_soft.chosen].bic == min(t.bic for t in learned_soft.trials)


def test_table_of_many_frames_is_compared_in_a_hundred_of_them() -> None:
    """A trial's RMS there is nearly that in all frames, and the chosen beam is compared in all."""
    made = observed(SOFT, forces(300), noise=(2e-5, 1e-3), seed=3)
    result = regress(made, RegressionSettings(n=6, m=3))
    np.testing.assert_allclose(result.trials[0].rms, result.training.rms, rtol=0.2)
    assert np.all(result.trials[0].rms != result.training.rms)
    assert len(result.training.frame) == 300


@pytest.mark.slow
def test_film_of_very_many_frames_is_learned_from_a_thousand_of_them() -> None:
    long = observed(SOFT, forces(2500), noise=(2e-5, 1e-3), seed=3)
    kept = np.linspace(0, 2499, 1000).astype(int)
    few = at_frames(long, np.isin(np.arange(2500), kept))
    settings = RegressionSettings(n=5, m=3)
    assert regress(long, settings).trials[0].coefficients == pytest.approx(
        regress(few, settings).trials[0].coefficients, rel=1e-12
    )


def test_trial_that_snaps_in_a_frame_that_was_left_out_is_put_out_of_the_running() -> None:
    made = observed(SOFT, forces(300), noise=(2e-5, 1e-3), seed=3)
    force = made.force.copy()
    force[7] = 0.02 / 0.15 * np.array([5.5, -2.9])  # a beam bent to most of a turn that is pulled open snaps through
    curved = Beam(0.15, Uniform(0.02), rest_curvature=Uniform(4.0))
    trial = Trial(2, 2, np.full(2, 0.02), np.full(3, 1e-3), 1.0, 0.02, 1.0)
    found = [Candidate(trial, curved), Candidate(replace(trial, bic=2.0), SOFT)]
    chosen, training = standing(found, replace(made, force=force), at_rest(made))
    assert chosen == 1
    assert np.all(np.isfinite(training.predicted))
    assert "snaps through" in found[0].trial.why_out


def test_validation_on_another_push_is_near_the_markers_noise(learned_soft) -> None:  # type: ignore[no-untyped-def]
    other = observed(SOFT, forces(40, most=0.5), at_s=0.8, noise=(2e-5, 1e-3), seed=2)
    comparison = validate(learned_soft.beam, other)
    assert np.all(comparison.rms < 5e-4)
    assert np.all(comparison.stable)


def test_sensor_share_is_what_force_noise_does() -> None:
    """Shift every force by one sd along each axis in turn: the RMS of the two is the stated share."""
    made = observed(SOFT, forces())
    stated = validate(SOFT, made).sensor_rms
    each = [validate(SOFT, replace(made, force=made.force + made.force_sd * np.eye(2)[c])).rms for c in range(2)]
    np.testing.assert_allclose(stated, np.sqrt(each[0] ** 2 + each[1] ** 2), rtol=0.1)


def test_mounting_errors_seen_at_rest_are_taken_off() -> None:
    made = observed(SOFT, forces())
    offset, turn = np.array([[2e-4, -3e-4], [0.0, 1e-4], [-2e-4, 2e-4]]), np.array([0.02, -0.01, 0.015])
    cos, sin = np.cos(made.angle), np.sin(made.angle)
    ride = np.stack([cos * offset[:, 0] - sin * offset[:, 1], sin * offset[:, 0] + cos * offset[:, 1]], axis=-1)
    mounted = replace(
        made,
        xy=made.xy + ride,
        angle=made.angle + turn,
        rest_xy=made.rest_xy + offset,
        rest_angle=made.rest_angle + turn,
    )
    np.testing.assert_allclose(validate(SOFT, mounted).rms, 0.0, atol=1e-6)
    found = regress(mounted, RegressionSettings(n=6, m=3, width=0.5)).beam.stiffness(S)
    np.testing.assert_allclose(found, SOFT.stiffness(S), rtol=0.02)


def test_natural_curvature_is_found_at_rest() -> None:
    curved = Beam(0.15, SOFT.stiffness, rest_curvature=Uniform(0.3))
    made = with_stated(observed(curved, forces()), rest="unknown")
    result = regress(made, RegressionSettings(n=6, m=3, width=0.5))
    np.testing.assert_allclose(result.beam.rest_curvature(S), 0.3, atol=0.05)
    np.testing.assert_allclose(result.beam.stiffness(S), curved.stiffness(S), rtol=0.05)


def test_too_few_frames_say_how_many_are_needed() -> None:
    with pytest.raises(LearningError, match=r"4 loaded frames, but up to 16 parameters"):
        regress(observed(SOFT, forces(4)))


def test_force_of_the_opposite_sign_finds_no_beam() -> None:
    made = observed(SOFT, forces())
    with pytest.raises(LearningError, match="force's sign"):
        regress(replace(made, force=-made.force), RegressionSettings(most_n=4))


def test_trial_with_negative_stiffness_is_reported_not_simulated() -> None:
    """A deep step seen through few wide Gaussians: some trials go below zero and say so."""
    stepped = Beam(0.15, Steps((0.0, 0.4, 1.0), (0.03, 0.012)))
    result = regress(observed(stepped, forces(), noise=(2e-5, 2e-3)), RegressionSettings(method="paper"))
    out = [t for t in result.trials if t.why_out]
    assert out
    assert all(np.isinf(t.bic) for t in out)
    assert all(t.lowest_k > 0.0 and np.all(np.isfinite(t.rms)) for t in result.trials if not t.why_out)


def test_unloaded_and_forceless_frames_are_left_out() -> None:
    made = observed(SOFT, forces(10))
    loaded, force = made.loaded.copy(), made.force.copy()
    loaded[0], force[1, 0] = False, np.nan
    assert usable_frames(replace(made, loaded=loaded, force=force)).tolist() == [False, False] + [True] * 8


def test_weight_without_mass_is_refused() -> None:
    made = replace(observed(SOFT, forces()), gravity=np.tile([0.0, -9.81], (80, 1)))
    with pytest.raises(LearningError, match="mass_kg"):
        validate(SOFT, made)


@pytest.mark.parametrize("uneven", [False, True])
def test_weight_alone_teaches_the_stiffness(uneven: bool) -> None:
    """A base that is turned under gravity, no force at all: the weight is the load, an uneven one where it is."""
    line = MassLine(S, (0.5 + S) * 0.1 / 0.15) if uneven else None
    mass: Profile = Uniform(0.1 / 0.15) if line is None else Table(tuple(line.s.tolist()), tuple(line.value.tolist()))
    heavy = Beam(0.15, SOFT.stiffness, mass_per_length=mass)
    turns = np.linspace(-np.pi, np.pi, 60)
    gravity = 9.81 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    shape = heavy.equilibrium(np.zeros((60, 2)), gravity=gravity)
    made = observed(SOFT, np.zeros((60, 2)), xy=shape.xy(MARKERS), angle=shape.angle(MARKERS))
    hanging = with_stated(
        replace(made, gravity=gravity, push_s=np.full(60, np.nan), loaded=np.zeros(60, dtype=bool)),
        mass=0.1,
        mass_line=line,
    )
    found = regress(hanging, RegressionSettings(n=6, m=3, width=0.5)).beam
    np.testing.assert_allclose(found.mass_per_length(S), mass(S))
    np.testing.assert_allclose(found.stiffness(S), SOFT.stiffness(S), rtol=0.02)
