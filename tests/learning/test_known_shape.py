"""A rod whose section was measured: one modulus is learned, with what the section and the material leave open."""

from __future__ import annotations

import re
import runpy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.section import modulus_band, moment_errors, one_modulus
from onebend.errors import LearningError
from onebend.learning.fit_data import following
from onebend.learning.parameters import CORRELATION, LEVEL_SD, KnownShape, Spline, known_shape, make_layout
from onebend.learning.posterior import Posterior, fit, mass_per_length, without_section_errors
from onebend.learning.static_poses import stated_notices
from onebend.learning.verdict import fit_notices
from onebend.records import Array, Observations, StatedSection
from onebend.report.sentences import worded
from tests.learning.bench import IDEAL, forces, observed
from tests.learning.known_bench import DIAMETER, LENGTH, MODULUS, S, learned, read, rod
from tests.made_up import with_stated

pytestmark = pytest.mark.usefixtures("no_other_places")

SECTION = 'stiffness_along = "section"\nsection_file = "section.csv"\n'
AT = np.linspace(0.0, 1.0, 41)
STATED = StatedSection("circle", S, DIAMETER, DIAMETER, 2e-4)


def slowly(s: Array) -> Array:
    """10 % less at the clamp, 10 % more at the tip."""
    return np.asarray(np.exp(0.1 * (2.0 * s - 1.0)))


def modulus(found: Posterior) -> tuple[float, float, float]:
    section = found.recordings[0].observations.stated.section
    one = one_modulus(found.stiffness, LENGTH, section)
    assert one is not None
    return one


def held(folder: Path, entries: str, seeds: range, *, off: float = 0.0) -> tuple[int, int, float]:
    """Of rods whose diameter is off by draws of this sd [m]: how many bands hold E, how many are criticised, and the
    mean half-width of the band."""
    inside, criticised, wide = 0, 0, []
    for seed in seeds:
        real = DIAMETER + off * np.random.default_rng(100 + seed).normal()
        found = learned(read(folder / str(seed), rod(real), entries, seed=seed))
        e, low, high = modulus(found)
        inside, criticised = inside + (low < MODULUS < high), criticised + (not found.criticism.trusted)
        wide.append(high / e - 1.0)
    return inside, criticised, float(np.mean(wide))


@pytest.mark.slow
def test_the_modulus_is_in_its_band_and_k_follows_every_corner_of_the_section(tmp_path: Path) -> None:
    beam = rod()
    found = learned(read(tmp_path / "rod", beam, SECTION))
    e, low, high = modulus(found)
    assert low < MODULUS < high
    assert high / low < 1.02
    assert found.criticism.trusted
    s = np.concatenate([AT, [0.25, 0.3, np.nextafter(0.6, 0.0), 0.6]])
    np.testing.assert_allclose(found.beam.stiffness(s) / beam.stiffness(s), e / MODULUS, rtol=5e-3)
    assert found.beam.stiffness.jumps == beam.stiffness.jumps
    band = found.band(s)
    assert band.identified.all()
    assert np.mean((band.low < beam.stiffness(s)) & (beam.stiffness(s) < band.high)) > 0.95


@pytest.mark.slow
def test_over_twenty_seeds_the_band_holds_the_modulus(tmp_path: Path) -> None:
    inside, criticised, wide = held(tmp_path, SECTION, range(20))
    assert inside >= 18
    assert criticised <= 1
    assert wide < 0.01


def test_a_wrong_section_is_criticised_where_it_counts_as_exact(tmp_path: Path) -> None:
    found = learned(read(tmp_path / "rod", rod(), SECTION, diameter=DIAMETER + 4e-4))  # 7 to 13 %
    assert not found.criticism.trusted
    assert found.criticism.causes[0].score.suspect.name == "stiffness along"
    [warning] = [one for one in worded(fit_notices(found)) if one.level == "warning" and one.about == "stiffness along"]
    assert "section_sd_m" in warning.text


@pytest.mark.slow
def test_a_wrong_section_is_covered_where_its_error_is_stated(tmp_path: Path) -> None:
    inside, criticised, wide = held(tmp_path, f"{SECTION}section_sd_m = 2e-4\n", range(3), off=2e-4)
    assert inside == 3
    assert criticised == 0
    assert wide < 4.0 * 1.96 * 2e-4 / DIAMETER.max()  # the data say which way the section is off


@pytest.mark.slow
def test_over_twenty_seeds_the_band_holds_what_the_section_is_off_by(tmp_path: Path) -> None:
    inside, criticised, _ = held(tmp_path, f"{SECTION}section_sd_m = 2e-4\n", range(20), off=2e-4)
    assert inside >= 18
    assert criticised <= 1


@cache
def slow_rod(folder: Path, entries: str) -> Posterior:
    return learned(read(folder, rod(varies=slowly), entries))


@pytest.mark.slow
def test_a_modulus_that_varies_slowly_is_found_where_that_is_stated(tmp_path: Path) -> None:
    found = slow_rod(tmp_path / "slow", f"{SECTION}modulus_varies = 0.1\n")
    section = found.recordings[0].observations.stated.section
    assert section is not None
    band = modulus_band(found.stiffness, LENGTH, section, AT)
    true = MODULUS * slowly(AT)
    assert np.mean((band.low < true) & (true < band.high)) > 0.95
    assert np.log(band.modulus[-5] / band.modulus[4]) == pytest.approx(0.2 * 0.8, abs=0.05)
    assert found.criticism.trusted
    alone = slow_rod(tmp_path / "one", SECTION)
    assert alone.criticism.causes[0].score.suspect.name == "stiffness along"


@pytest.mark.slow
def test_a_constant_section_is_an_even_beam(tmp_path: Path) -> None:
    even = np.full(len(S), 0.005)
    found = [
        learned(read(tmp_path / str(i), rod(even), entries, diameter=even))
        for i, entries in enumerate((SECTION, 'stiffness_along = "even"\n'))
    ]
    of_section, of_even = (one.band(AT) for one in found)
    for name in ("k", "low", "high"):
        np.testing.assert_allclose(getattr(of_section, name), getattr(of_even, name), rtol=1e-8)
    assert found[0].optimum.log_evidence == pytest.approx(found[1].optimum.log_evidence, abs=1e-6)


@pytest.mark.slow
def test_a_film_knows_the_section_too() -> None:
    beam = replace(rod(), length=0.5)
    film = with_stated(
        observed(beam, forces(12, most=1.0), noise=(1e-4, 2e-3)), section=STATED, stiffness_along="section"
    )
    found = fit([film], settings=replace(IDEAL, functions=12))
    _, low, high = modulus(found)
    assert low < MODULUS < high
    assert found.band(AT).identified.all()


def test_the_sections_share_is_that_of_the_exact_posterior() -> None:
    """Against every part of log k as a parameter of its own, with data on their sum."""
    o = with_stated(observed(rod(), forces(4)), section=STATED, stiffness_along="section", modulus_varies=0.1)
    layout, rng = make_layout(Spline(9), [o], [0]), np.random.default_rng(3)
    parts, variances = layout.stiffness_parts, layout.first_variances
    data, noise = rng.normal(size=(6, 9)), 0.05
    seen = data @ (parts @ (np.sqrt(variances) * rng.normal(size=len(variances)))) + noise * rng.normal(size=6)
    rows = data @ parts
    gain = (variances[:, None] * rows.T) @ np.linalg.inv((rows * variances) @ rows.T + noise**2 * np.eye(6))
    mean, covariance = gain @ seen, np.diag(variances) - gain @ rows * variances
    kept = parts.copy()
    kept[:, 1 + 9] = 0.0  # the one error of a diameter
    np.testing.assert_allclose(parts[:, 10], layout.spline.nearest(lambda s: moment_errors(STATED, s))[:, 0])
    e, spread = without_section_errors(layout, variances, parts @ mean, parts @ covariance @ parts.T)
    np.testing.assert_allclose(e, kept @ mean, atol=1e-7 * LEVEL_SD)
    np.testing.assert_allclose(spread, kept @ covariance @ kept.T, atol=1e-7)


def test_the_slow_variation_has_its_sd_and_its_length() -> None:
    slow = KnownShape(None, 0.1).slow(AT)
    expected = 0.1**2 * np.exp(-0.5 * ((AT[:, None] - AT) / CORRELATION) ** 2)
    np.testing.assert_allclose(slow @ slow.T, expected, atol=1e-6)
    assert KnownShape(None, 0.0).slow(AT).shape == (41, 0)


def test_a_mass_that_follows_k_follows_the_section(tmp_path: Path) -> None:
    entries = f'{SECTION}mass_kg = 0.01\nmass_along = "both"\n'
    found = learned(read(tmp_path / "rod", rod(), entries))
    line = following(found.recordings[0].observations, found.stiffness, 0.01)
    assert line is not None
    root = np.sqrt(found.beam.stiffness(AT))
    np.testing.assert_allclose(line(AT) / line(0.0), root / root[0], rtol=1e-12)
    fine = np.linspace(0.0, 1.0, 4001)
    assert LENGTH * float(np.trapezoid(line(fine), fine)) == pytest.approx(0.01, rel=1e-3)
    assert mass_per_length(found.recordings, found.layout, found.mean, found.stiffness)(AT).shape == AT.shape


@pytest.mark.slow
def test_a_mass_by_the_sections_area_is_that_by_the_root_of_k_of_a_round_rod(tmp_path: Path) -> None:
    found = [
        learned(read(tmp_path / along, rod(), f'{SECTION}mass_kg = 0.01\nmass_along = "{along}"\n'))
        for along in ("both", "section")
    ]
    by_root, by_area = (one.beam.mass_per_length(AT) for one in found)
    np.testing.assert_allclose(by_area, by_root, rtol=5e-3)
    assert found[1].mass is None or found[1].mass.along == "section"


def stating(**stated: object) -> Observations:
    return with_stated(observed(rod(), forces(3)), **stated)


def test_one_recording_speaks_for_all_and_two_must_not_contradict() -> None:
    silent, said = stating(), stating(stiffness_along="section", section=STATED)
    assert known_shape([silent]) is None
    found = known_shape([silent, said])
    assert found is not None
    assert found.section is STATED
    with pytest.raises(LearningError, match="differ"):
        known_shape([said, stating(stiffness_along="even")])
    with pytest.raises(LearningError, match="differ"):
        known_shape([said, stating(stiffness_along="section", section=STATED, modulus_varies=0.1)])
    with pytest.raises(LearningError, match="needs the section"):
        known_shape([stating(stiffness_along="section")])


@pytest.mark.slow
def test_what_one_of_several_benches_states_counts_though_the_fit_begins_with_others(tmp_path: Path) -> None:
    entries = ("", SECTION, "")
    benches = [read(tmp_path / str(i), rod(), each, seed=i) for i, each in enumerate(entries)]
    found = fit(benches, settings=replace(IDEAL, first_recordings=2))
    one = one_modulus(found.stiffness, LENGTH, benches[1].stated.section)
    assert one is not None
    assert one[1] < MODULUS < one[2]


def test_what_was_stated_is_said(tmp_path: Path) -> None:
    found = slow_rod(tmp_path / "slow", f"{SECTION}modulus_varies = 0.1\n")
    [remark] = worded(stated_notices([one.observations for one in found.recordings], found.stiffness))
    note = remark.text
    assert remark.level == "note"
    assert "one modulus times the section's I(s)" in note
    assert "exact, as no section_sd_m is stated" in note
    assert "10 % (sd)" in note


def test_the_example_finds_the_modulus_that_it_was_made_with(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(Path(__file__).parents[2] / "examples" / "learn_tapered_tube.py"))
    words = capsys.readouterr().out.splitlines()[0]
    e, _, low, high = (float(number) for number in re.findall(r"[0-9.]+", words))
    assert low < 24.0 < high
    assert e == pytest.approx(24.0, rel=0.02)
