"""How far off a prediction is likely to be, against the same beam simulated with what is uncertain changed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import LogSpline, Scaled, UncertainStiffness
from onebend.learning.allowances import POSTURE_SD, SLIDE_SD
from onebend.learning.prediction import few_frames, variances
from onebend.learning.validation import solved_frames, validate
from onebend.records import Array, Observations
from tests.learning.bench import forces, observed

KNOTS = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, 4), np.ones(3)])
MEAN = np.log(np.array([0.02, 0.03, 0.025, 0.03, 0.02, 0.02]))
ROOT = 0.01 * np.array([[3, 0], [1, 2], [1, 1], [0, 1], [0, -1], [-1, 2]])  # of the covariance of log k
KNOWN = UncertainStiffness(KNOTS, MEAN, ROOT @ ROOT.T, gain_sd=0.3)
BEAM = Beam(0.15, KNOWN.profile)
PLACE_SD, DIRECTION_SD, AT = 2e-3, 0.02, 0.8
COUNT = 10  # frames


def seen() -> Observations:
    made = observed(BEAM, forces(COUNT), at_s=AT)
    return replace(made, stated=replace(made.stated, place_sd=PLACE_SD, direction_sd=DIRECTION_SD))


def tags(beam: Beam, force: Array, at_s: float = AT) -> Array:
    return beam.equilibrium(force, at_s).xy(seen().marker_s)


def mean_square(way: Array) -> Array:
    """(m,) of (T, m, 2)."""
    return np.asarray(np.mean(np.sum(way**2, axis=2), axis=0))


def parts() -> dict[str, Array]:
    made, every = seen(), np.ones(COUNT, dtype=bool)
    [solved] = solved_frames(BEAM, made, every)
    return variances(solved, made, every, KNOWN)


def test_the_band_counts_as_its_principal_changes_do() -> None:
    """Symmetric differences along the columns of the covariance's root; the common scale of the force is left out."""
    force, total = forces(COUNT), np.zeros(3)
    for column in 0.1 * ROOT.T:
        both = [Beam(0.15, LogSpline(tuple(KNOTS), tuple(MEAN + sign * column))) for sign in (1.0, -1.0)]
        total += mean_square((tags(both[0], force) - tags(both[1], force)) / 0.2)
    assert parts()["stiffness"] == pytest.approx(total, rel=1e-3)


def test_the_place_and_the_direction_of_the_push_count_by_their_tolerances() -> None:
    force, step = forces(COUNT), 0.01
    turn = BEAM.equilibrium(force, AT).angle(np.array([AT]))[:, 0]
    sd = np.hypot(PLACE_SD, SLIDE_SD * turn)  # it slides as it turns
    away = step * PLACE_SD / BEAM.length
    moved = (tags(BEAM, force, AT + away) - tags(BEAM, force, AT - away)) / (2.0 * step * PLACE_SD)
    found = parts()
    assert found["place"] == pytest.approx(mean_square(moved * sd[:, None, None]), rel=0.02)
    angle = step * DIRECTION_SD
    turned = [force @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in (angle, -angle)]
    moved = (tags(BEAM, turned[0]) - tags(BEAM, turned[1])) / (2.0 * step)
    assert found["direction"] == pytest.approx(mean_square(moved), rel=1e-3)


def test_a_validation_says_how_far_off_it_is_likely_to_be_where_the_band_is_known() -> None:
    made = seen()
    found = validate(BEAM, made, stiffness=KNOWN)
    assert found.likely_rms == pytest.approx(np.sqrt(found.sensor_rms**2 + sum(parts().values())))
    assert np.all(found.likely_rms > found.sensor_rms)
    assert np.all(np.isnan(validate(BEAM, made).likely_rms))
    exact = replace(KNOWN, covariance=np.zeros((6, 6)))
    surely = replace(made, static=True)  # a load hangs where it is said to
    assert validate(BEAM, surely, stiffness=exact).likely_rms == pytest.approx(found.sensor_rms)


def in_setup(**parts: tuple[float, float]) -> SetUp:
    """Parts of one number each with their means and sds, of a push at `AT`."""
    mean, sd = np.array(list(parts.values())).T
    sizes = {name.replace("_", " "): 1 for name in parts}
    force, places = forces(COUNT)[-1].tolist(), tuple(seen().marker_s.tolist())
    slope = np.zeros((len(mean), len(MEAN)))
    return SetUp(AT, (force[0], force[1]), places, 1e-9, sizes, mean, slope, np.diag(sd**2), np.maximum(sd, 1e-9))


@pytest.mark.slow
def test_another_push_is_validated_in_the_set_up_that_was_learned() -> None:
    turned, longer = 0.02, 0.01
    real = replace(BEAM, length=BEAM.length * np.exp(longer), clamp_angle=turned)
    made = replace(observed(real, forces(COUNT), at_s=AT), length=BEAM.length)
    made = replace(made, stated=replace(made.stated, place_sd=1e-9))
    sure = replace(KNOWN, covariance=1e-12 * np.eye(6))
    setup = in_setup(length=(longer, 1e-6), clamp=(turned, 1e-6), place=(0.003, 1e-6))
    here, alone = (validate(BEAM, made, stiffness=sure, setup=one) for one in (setup, None))
    assert np.max(here.rms) < 2e-5 < 0.1 * np.max(alone.rms)
    wide = in_setup(length=(longer, 1e-6), clamp=(turned, 1e-6), place=(0.003, 1e-6), direction=(0.0, 0.1))
    other = replace(made, stated=replace(made.stated, place_sd=PLACE_SD))
    sds = [validate(BEAM, other, stiffness=KNOWN, setup=one).likely_rms[-1] for one in (setup, wide)]
    assert sds[1] > sds[0] > here.likely_rms[-1]


def test_what_is_likely_in_a_set_up_is_the_spread_of_pushes_anew() -> None:
    """By a contact elsewhere alone: against the beam pushed there."""
    made = replace(seen(), stated=replace(seen().stated, place_sd=PLACE_SD), force_sd=np.zeros(2))
    setup = in_setup(place=(0.0, 1e-6))
    sure = replace(KNOWN, covariance=1e-12 * np.eye(6))
    found = validate(BEAM, made, stiffness=sure, setup=setup)
    away = (tags(BEAM, made.force, AT + PLACE_SD / 0.15) - tags(BEAM, made.force, AT - PLACE_SD / 0.15)) / 2.0
    assert found.likely_rms == pytest.approx(np.sqrt(mean_square(away) + 2e-10), rel=0.2)  # of 60 draws


@pytest.mark.slow
def test_the_error_with_the_posture_is_a_share_of_the_force_of_the_push_at_hand() -> None:
    """However large that of the recording was."""
    made = replace(seen(), force_sd=np.zeros(2))
    sure, zeros = replace(KNOWN, covariance=1e-12 * np.eye(6)), np.zeros((10, 10))
    part = {"sizes": {"force error": 10}, "mean": zeros[0], "slope": zeros[:, :6], "covariance": zeros}
    setups = [replace(in_setup(place=(0.0, 1e-6)), **part, prior_sd=np.full(10, sd)) for sd in (1e-6, 1.0)]
    likely = [validate(BEAM, made, stiffness=sure, setup=one).likely_rms[-1] for one in setups]
    stronger = tags(BEAM, (1.0 + POSTURE_SD) * made.force) - tags(BEAM, made.force)
    assert likely[0] == likely[1] == pytest.approx(np.sqrt(mean_square(stronger)[-1]), rel=0.6)


def test_of_poses_the_loads_are_where_they_are_said_to_be() -> None:
    poses, every = replace(seen(), static=True), np.ones(COUNT, dtype=bool)
    [solved] = solved_frames(BEAM, poses, every)
    assert set(variances(solved, poses, every, KNOWN)) == {"stiffness"}


def test_a_few_frames_stand_for_all() -> None:
    frames = np.arange(1000) % 3 > 0
    few = few_frames(frames)
    assert few.sum() == 100
    assert not np.any(few & ~frames)
    assert np.array_equal(few_frames(frames[:60]), frames[:60])


def test_shapes_near_those_of_a_like_beam_are_those_from_rest() -> None:
    made, every = seen(), np.ones(COUNT, dtype=bool)
    [other] = solved_frames(replace(BEAM, stiffness=Scaled(1.1, BEAM.stiffness)), made, every)
    [from_rest], [near] = solved_frames(BEAM, made, every), solved_frames(BEAM, made, every, other.q)
    assert near.converged.all()
    np.testing.assert_allclose(near.q, from_rest.q, atol=1e-9)
    assert np.max(np.abs(other.q - near.q)) > 1e-3
