"""Frequencies in the fit: derivatives, numbering, E and mass with their bands, and what cannot be told apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frequencies import CASES, EVEN, MASS, MIDDLE, THREE, Case, frequency, learned, recording, ruler, trials
from onebend.errors import LearningError
from onebend.learning.frequencies import (
    frequency_data,
    frequency_notices,
    postures_of,
    predicted_frequencies,
    validated_frequencies,
)
from onebend.learning.optimizer import FitSettings
from onebend.learning.parameters import Spline, make_layout
from onebend.learning.posterior import Posterior, fit
from onebend.learning.start import start_of, with_mass
from onebend.records import MassAlong, MeasuredFrequency, Observations, PointMass
from onebend.report.sentences import posture_words, worded
from tests import made_up
from tests.made_up import with_stated

G = 9.81
QUICK = FitSettings(most_frames=30, first_frames=20, allowances=frozenset())
FREQUENCIES = (
    MeasuredFrequency(9.2, 0.02, 1, (G, 0.0)),
    MeasuredFrequency(57.4, 0.1, 2, (G, 0.0)),
    MeasuredFrequency(6.9, 0.02, 1, (0.0, -G), tip_mass=0.01),
    MeasuredFrequency(9.1, 0.02, 1, (-G, 0.0)),
)


def seen(mass_along: MassAlong = "unknown", frequencies: tuple[MeasuredFrequency, ...] = FREQUENCIES) -> Observations:
    """The made-up beam, heavier, with frequencies beside its film."""
    stated = with_stated(made_up.observations(), mass=0.05, mass_along=mass_along, rest="unknown")
    return replace(stated, frequencies=frequencies)


@pytest.mark.parametrize("mass_along", ["unknown", "even", "width"])
def test_slopes_with_all_parameters_are_those_of_central_differences(mass_along: MassAlong) -> None:
    o = seen(mass_along)
    spline, rng = Spline(12), np.random.default_rng(0)
    layout = make_layout(spline, [o], [0])
    (data,) = frequency_data([o], spline)
    x = 0.05 * rng.standard_normal(layout.size)
    x[: spline.count] += np.log(0.06)
    slopes, h = predicted_frequencies(data, layout, x).slopes, 1e-5
    for _ in range(4):
        way = rng.standard_normal(layout.size)
        more, less = (predicted_frequencies(data, layout, x + sign * h * way).log for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes @ way, (more - less) / (2.0 * h), rtol=1e-5, atol=1e-7)
    stiff = layout.index["stiffness", -1].where
    assert np.all(np.abs(slopes[:, stiff].sum(axis=1) - 0.5) < 0.1)  # a stiffer beam swings with the root of k


def test_without_weight_only_the_ratio_of_k_to_mass_counts() -> None:
    o = seen("even", tuple(replace(one, gravity=(0.0, 0.0), tip_mass=0.0) for one in FREQUENCIES))
    layout = make_layout(Spline(12), [o], [0])
    (data,) = frequency_data([o], layout.spline)
    x = np.zeros(layout.size)
    slopes = predicted_frequencies(data, layout, x).slopes
    by_level = slopes[:, layout.index["stiffness", -1].where].sum(axis=1)
    np.testing.assert_allclose(by_level, 0.5, rtol=1e-10)
    np.testing.assert_allclose(slopes[:, layout.index["mass", -1].start], -0.5, rtol=1e-10)


def test_a_beam_that_its_weight_makes_buckle_has_no_frequency() -> None:
    o = seen("even")
    layout = make_layout(Spline(12), [o], [0])
    (data,) = frequency_data([o], layout.spline)
    x = np.zeros(layout.size)
    x[:12] = np.log(0.008)  # m g L / k = 9.2, more than 7.84
    assert np.isnan(predicted_frequencies(data, layout, x).log).tolist() == [False, False, False, True]


@pytest.fixture(scope="module")
def hung(tmp_path_factory: pytest.TempPathFactory) -> Posterior:
    """The ruler that hangs, stands and lies."""
    folder = tmp_path_factory.mktemp("hung") / "one"
    recording(folder, CASES[0], [frequency(ruler(), *row) for row in THREE], np.random.default_rng(1))
    return learned(folder)


def test_three_postures_and_a_weighed_mass_give_k(hung: Posterior) -> None:
    """The sd is that of the written mass, 2 %, and what 0.2 % of three frequencies leave."""
    true = ruler().stiffness(MIDDLE)
    band = hung.band(MIDDLE)
    assert np.all((band.low < true) & (true < band.high) & band.identified)
    half = 0.5 * np.log(band.high / band.low) / 1.96
    np.testing.assert_allclose(half, np.hypot(0.02, 2.0 * 2e-3 / np.sqrt(3.0)), rtol=0.15)
    assert not hung.doubts
    notes = worded(frequency_notices(hung.frequencies))
    assert [remark.level for remark in notes] == ["note"]
    assert all(f"mode 1 ({posture})" in notes[0].text for posture in ("hangs", "stands", "lies"))


def test_a_beam_learned_elsewhere_is_compared_in_its_frequencies() -> None:
    o = replace(made_up.observations(), length=ruler().length, frequencies=(replace(FREQUENCIES[0], frequency=9.243),))
    (note,) = worded(validated_frequencies(ruler(), o))
    assert "mode 1 (hangs) 9.243 Hz, the beam 9.243 Hz" in note.text


def test_a_frequency_of_another_mode_is_a_doubt(tmp_path: Path) -> None:
    case = Case("", ruler(), ((1, 0.0, 0.0), (2, 0.0, 0.0), (3, 0.0, 0.0)), EVEN)
    exact = [frequency(ruler(), *row) for row in case.rows]
    recording(tmp_path / "one", case, [*exact[:2], 1.1 * exact[2]], np.random.default_rng(0))
    posterior = learned(tmp_path / "one")
    assert "the frequencies contradict the fit" in posterior.doubts
    assert any(remark.level == "warning" for remark in worded(frequency_notices(posterior.frequencies)))


@pytest.mark.slow
def test_the_mass_is_learned_beside_k_from_poses_and_frequencies(tmp_path: Path) -> None:
    case = CASES[2]
    recording(tmp_path / "one", case, [frequency(ruler(), *row) for row in case.rows], np.random.default_rng(0))
    posterior = learned(tmp_path / "one")
    assert posterior.mass is not None
    assert posterior.mass.identified
    assert abs(posterior.mass.value - MASS) < 3.0 * posterior.mass.sd < 0.3 * MASS
    true, band = ruler().stiffness(MIDDLE), posterior.band(MIDDLE)
    assert np.all((band.low < true) & (true < band.high))


def test_frequencies_alone_of_an_unknown_mass_are_refused(tmp_path: Path) -> None:
    case = Case("", ruler(), THREE, EVEN, mass_written=False)
    recording(tmp_path / "one", case, [9.2, 9.1, 9.17], np.random.default_rng(0))
    with pytest.raises(LearningError, match=r"only the ratio k/mu .*tip_mass_kg"):
        learned(tmp_path / "one")


def test_a_film_and_a_frequency_are_fitted_together() -> None:
    """A film of a push tells k(s); an exact frequency beside it, the mass."""
    film = with_stated(made_up.observations(), mass=np.nan, mass_along="even")
    source = replace(film.source, place_seen=True)
    film = replace(film, source=source, frequencies=(MeasuredFrequency(5.0, 0.005, 1, (0.0, 0.0)),))
    (ready,) = with_mass([film])
    posterior = fit([ready], start_of([ready], None), settings=replace(QUICK, functions=8))
    assert posterior.mass is not None
    assert posterior.mass.identified
    (found,) = posterior.frequencies
    assert float(np.exp(found.log[0])) == pytest.approx(5.0, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bands_hold_the_truth_as_often_as_they_say(case: Case) -> None:
    found = trials(case, seeds=20)
    inside = np.mean([one[2] for one in found])
    assert inside >= 0.85
    z = [np.mean(one[0] / one[1]) for one in found]
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_a_mass_that_rides_elsewhere_is_not_said_to_be_at_the_tip() -> None:
    measured = MeasuredFrequency(3.0, 0.1, 1, (0.0, 0.0), 0.005)
    riding = (PointMass(0.4, 0.02),)
    (bare,), (laden,) = postures_of((replace(measured, tip_mass=0.0),), riding), postures_of((measured,), riding)
    assert posture_words(bare) == "across gravity"
    assert posture_words(laden) == "across gravity, 5 g at the tip"
