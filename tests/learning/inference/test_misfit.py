"""What counts as a miss: distances against the tags' noise and their motion."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from onebend.errors import LearningError
from onebend.learning.fit_data import fit_data
from onebend.learning.linear import FitProblem
from onebend.learning.optimizer import MapEstimate, Miss, first_problem, misses, refuse_lost_force
from onebend.learning.parameters import Spline, make_layout
from onebend.learning.prediction import Prediction, predict
from onebend.records import Array, Remark
from tests.learning.bench import IDEAL, SOFT, forces, observed
from tests.made_up import with_stated

SD = 1e-4  # m, of each coordinate of a tag


@pytest.fixture(scope="module")
def exact() -> Prediction:
    """A fit that sits on the tags."""
    made = observed(SOFT, forces(10), noise=(SD, 1e-3))
    spline = Spline(8)
    data = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline)
    layout = make_layout(spline, [made], [len(data.error.knots)])
    x = np.zeros(layout.size)
    x[: spline.count] = np.log(0.02)
    now = predict(data, layout, x, None)
    return replace(now, pose=data.measured)


def missed(exact: Prediction, by: float, motion: float | None = None) -> Miss | None:
    """What is said of a fit that is `by` [m] off its middle tag in every frame; the tag moves by `motion` [m]."""
    data, off = exact.data, np.zeros_like(exact.pose)
    off[:, 1, 1] = by
    if motion is not None:
        measured = data.measured.copy()
        measured[:, 1, :2] = data.measured[0, 1, :2]
        measured[0, 1, 0] += motion
        data = replace(data, measured=measured)
    now = replace(exact, data=data, pose=data.measured + off)
    found = misses([data], [now])
    return found[0] if found else None


def motion_of(exact: Prediction) -> Array:
    """(m,) m."""
    return np.asarray(np.linalg.norm(np.ptp(exact.data.measured[..., :2], axis=0), axis=1))


@pytest.mark.parametrize(("times", "is_miss"), [(1.0, False), (2.5, False), (3.5, True), (10.0, True)])
def test_a_miss_of_a_few_times_the_tags_noise_is_none(exact: Prediction, times: float, is_miss: bool) -> None:
    noise = np.sqrt(2.0) * SD  # of both coordinates
    miss = missed(exact, times * noise, motion=noise)
    assert (miss is not None) == is_miss
    if miss is not None:
        assert miss.tag == "tag 2"
        assert miss.rms == pytest.approx(times * noise)
        assert miss.motion == pytest.approx(noise)


@pytest.mark.parametrize(("share", "is_miss"), [(0.045, False), (0.055, True)])
def test_a_miss_is_a_twentieth_of_the_tags_motion(exact: Prediction, share: float, is_miss: bool) -> None:
    motion = float(motion_of(exact)[1])
    assert share * motion > 5.0 * SD
    assert (missed(exact, share * motion) is not None) == is_miss


def test_a_fit_is_hopeless_by_the_motion_of_all_tags_together(exact: Prediction) -> None:
    motion = float(np.linalg.norm(motion_of(exact)))
    few, many = missed(exact, 0.18 * motion), missed(exact, 0.22 * motion)
    assert few is not None
    assert many is not None
    assert few.share == pytest.approx(0.18, rel=1e-6)
    assert not few.hopeless
    assert many.hopeless


def test_a_fit_on_the_tags_misses_none(exact: Prediction) -> None:
    assert misses([exact.data], [exact]) == ()


def fit_with_error(share: float, zero: float = 0.0) -> tuple[FitProblem, MapEstimate]:
    """A fit that takes this share of the log for its error, beside a zero [N] that is off."""
    problem, x = first_problem([observed(SOFT, forces(60))], 0.02, IDEAL)
    [recording] = problem.recordings
    on = np.any(recording.force != 0.0, axis=1)
    wanted = share * recording.force[on] + zero
    values = np.linalg.lstsq(recording.error_weights[on], wanted, rcond=None)[0]
    x[problem.layout.index["force", 0].where] = values.ravel()
    return problem, MapEstimate(x, problem.expected, ())


def test_a_log_with_more_error_than_force_is_refused_with_both_sizes() -> None:
    problem, estimate = fit_with_error(0.75)
    with pytest.raises(LearningError, match="made: the error of the force log changes by") as refused:
        refuse_lost_force(problem, estimate)
    error, force = (float(n) for n in re.findall(r"by ([\d.]+) N", str(refused.value)))
    assert error / force == pytest.approx(3.0, rel=0.1)
    assert "Check that this log is of this push, then start_s and the frame rate" in str(refused.value)
    assert "push harder, or take a force sensor" in str(refused.value)


def test_what_the_recording_was_warned_of_is_the_advice_where_the_force_is_lost() -> None:
    problem, estimate = fit_with_error(3.0)
    [data] = problem.recordings
    warned = Remark("warning", "The film starts +3.01 s from start_s.", about="clock")
    source = replace(data.observations.source, remarks=(warned,))
    data = replace(data, observations=replace(data.observations, source=source))
    with pytest.raises(LearningError, match=r"The film starts \+3.01 s from start_s.") as refused:
        refuse_lost_force(replace(problem, recordings=(data,)), estimate)
    assert "push harder" not in str(refused.value)


@pytest.mark.parametrize(("slope", "first"), [(0.0, "Check that this log"), (-3.0, "Gravity pulls elsewhere")])
def test_where_weight_bends_the_beam_gravity_may_be_wrong_and_is_named_first_where_it_pulls_as_no_beam_does(
    slope: float, first: str
) -> None:
    made = with_stated(observed(SOFT, forces(60)), mass=0.05)
    problem, x = first_problem([replace(made, gravity=np.tile([0.0, -9.81], (60, 1)))], 0.2, IDEAL)
    [data] = problem.recordings
    on = np.any(data.force != 0.0, axis=1)
    lost = np.linalg.lstsq(data.error_weights[on], 0.75 * data.force[on], rcond=None)[0]
    x[problem.layout.index["force", 0].where] = lost.ravel()
    x[problem.layout.index["mass", -1].start + 1] = slope
    with pytest.raises(LearningError, match="direction_deg, base_angle_deg and mass_kg") as refused:
        refuse_lost_force(problem, MapEstimate(x, problem.expected, ()))
    text = str(refused.value)
    assert "Check that this log" in text
    assert text.split("not k(s). ")[1].startswith(first)


@pytest.mark.parametrize(("share", "zero"), [(0.0, 0.0), (0.4, 0.0), (-0.5, 0.0), (0.1, 5.0)])
def test_a_smaller_error_and_a_zero_that_is_off_are_not(share: float, zero: float) -> None:
    refuse_lost_force(*fit_with_error(share, zero))


def test_a_log_with_more_error_than_force_is_not_refused_beside_one_that_tells() -> None:
    problem, estimate = fit_with_error(0.75)
    [lost] = problem.recordings
    told = replace(lost, error_weights=np.zeros_like(lost.error_weights))
    refuse_lost_force(replace(problem, recordings=(lost, told)), estimate)
