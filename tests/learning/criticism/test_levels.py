"""Which findings count, what is named, and how far the band would have to be widened."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from onebend.learning.criticism import Criticism, Finding, Kind, LinearisedFit, Score, Suspect, _finding, _pull
from onebend.learning.normal import JointCovariance


def found(
    name: str, log10_p: float, *, kind: Kind = "mechanics", gain: float = 40.0, sds: float = 2.0, noise: float = 1.0
) -> Finding:
    score = Score(Suspect(kind, name), np.ones(1), np.ones(1), gain, log10_p, 1e-3, np.zeros(8), noise)
    return Finding(score, 0.1, sds)


def test_one_false_alarm_in_two_thousand_recordings() -> None:
    assert Criticism((found("stretch", -4.9),)).trusted
    assert not Criticism((found("stretch", -5.1),)).trusted
    # about 45 tests of each recording
    assert 45 * 10.0**-5 < 1 / 2000


def test_what_a_person_writes_down_is_doubted_sooner() -> None:
    assert Criticism((found("push place", -2.4),)).trusted
    assert not Criticism((found("push place", -2.6),)).trusted
    assert not Criticism((found("force direction", -2.6),)).trusted
    assert Criticism((found("stretch", -2.6),)).trusted


def test_a_change_of_less_than_half_an_sd_of_log_k_is_no_alarm() -> None:
    assert Criticism((found("stretch", -9.0, sds=0.45),)).trusted
    assert not Criticism((found("stretch", -9.0, sds=0.55),)).trusted
    assert not Criticism((found("stretch", -9.0, sds=0.3, noise=4.0),)).trusted  # the misfit made the band wide


def test_causes_that_explain_about_as_much_are_named_with_the_best() -> None:
    def causes(best: float, other: float) -> list[str]:
        both = (found("stretch", -9.0, gain=other), found("shear", -8.0, gain=best))
        return [f.score.suspect.name for f in Criticism(both).causes]

    assert causes(40.0, 31.0) == ["shear", "stretch"]
    assert causes(40.0, 29.0) == ["shear"]
    assert causes(400.0, 330.0) == ["shear", "stretch"]
    assert causes(400.0, 310.0) == ["shear"]


def test_trends_are_symptoms_and_no_causes() -> None:
    criticism = Criticism((found("x", -9.0, kind="trend", gain=99.0), found("shear", -8.0)))
    assert [f.score.suspect.name for f in criticism.causes] == ["shear"]
    assert [f.score.suspect.name for f in criticism.symptoms] == ["x"]


def test_a_wider_band_holds_the_best_causes_shift() -> None:
    assert Criticism((found("shear", -8.0, sds=2.0),)).widening == pytest.approx(np.sqrt(5.0))
    assert Criticism((found("shear", -1.0),)).widening == 1.0
    assert np.isnan(Criticism((found("x", -9.0, kind="trend"),)).widening)


@pytest.mark.parametrize(("left", "judged"), [(0.5, True), (0.93, True), (0.97, False)])
def test_a_pull_is_judged_by_what_the_data_removed_of_the_prior(left: float, judged: bool) -> None:
    """`x' (prior - posterior covariance)^-1 x`, where the data left this share of the prior's variance."""
    x, sd = 0.03, 0.01
    fit = SimpleNamespace(
        optimum=SimpleNamespace(x=np.array([5.0, x])),
        covariance=JointCovariance(1, (np.array([[0.04, 1e-4], [1e-4, left * sd**2]]),), (slice(0, 1), slice(1, 2))),
        problem=SimpleNamespace(layout=SimpleNamespace(spline=SimpleNamespace(count=1))),
    )
    site = np.zeros(1), np.array([sd])
    score = _pull(cast(LinearisedFit, fit), Suspect("prior", "clamp"), np.array([1]), np.array([sd]), site, "rad")
    if not judged:
        assert score.gain == 0.0
        assert np.isnan(score.value[0])
        return
    assert score.gain == pytest.approx(x**2 / (sd**2 * (1.0 - left)))
    assert score.value[0] == pytest.approx(x / (1.0 - left))  # where the data alone put it
    assert score.shift[0] == pytest.approx(1e-4 * x / (sd**2 * (1.0 - left)))


def test_a_pull_is_judged_by_the_stated_tolerance_whatever_normal_prior_the_fit_has() -> None:
    stated, measured, noise = 0.01, 0.03, 0.004
    scores = []
    for middle, sd in ((0.0, stated), (0.002, 0.003), (0.0, 0.016)):
        variance = 1.0 / (sd**-2 + noise**-2)
        x = variance * (middle / sd**2 + measured / noise**2)
        fit = SimpleNamespace(
            optimum=SimpleNamespace(x=np.array([5.0, x])),
            covariance=JointCovariance(1, (np.diag([0.04, variance]),), (slice(0, 1), slice(1, 2))),
            problem=SimpleNamespace(layout=SimpleNamespace(spline=SimpleNamespace(count=1))),
        )
        site = np.array([middle]), np.array([sd])
        own = np.array([1]), np.array([stated])
        scores.append(_pull(cast(LinearisedFit, fit), Suspect("prior", "clamp"), *own, site, "rad"))
    for one in scores:
        assert one.value[0] == pytest.approx(measured)
        assert one.gain == pytest.approx(measured**2 / (stated**2 + noise**2))


def test_a_shift_is_measured_in_sds_where_it_is_largest_in_them() -> None:
    finding = _finding(found("shear", -8.0).score, np.array([0.1, -0.3, 0.2]), np.array([0.02, 0.1, 0.1]))
    assert finding.shift == pytest.approx(0.3)
    assert finding.sds == pytest.approx(5.0)
