"""Whether there is a material with the modulus that comes out, and what to check where there is none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.learning.optimizer import FitSettings
from onebend.learning.outcome import modulus_along, modulus_notices, stated_section
from onebend.pipeline import learn
from onebend.records import Observations, StatedSection
from onebend.report.overview import overview
from onebend.report.sentences import modulus_unit, worded
from tests import made_up

pytestmark = pytest.mark.usefixtures("no_other_places")

WEIGHTS = Path(__file__).parents[2] / "examples" / "hung-weights"
ENDS, S = np.array([0.0, 1.0]), np.linspace(0.0, 1.0, 11)
BAR = StatedSection("rectangle", ENDS, np.full(2, 0.012), np.full(2, 0.03))


def seen(section: StatedSection | None, name: str = "made-up") -> Observations:
    return made_up.with_stated(made_up.observations(name), section=section)


def told(section: StatedSection | None, *, scale: float = 1.0, doubts: tuple[str, ...] = ()) -> list[str]:
    """What is said of k(s) times `scale`."""
    fit = made_up.posterior()
    one = replace(fit.stiffness, mean=fit.stiffness.mean + np.log(scale), doubts=doubts)
    return [remark.text for remark in worded(modulus_notices(fit.beam, one, [seen(section)]))]


def test_without_a_section_nothing_is_said() -> None:
    fit = made_up.posterior()
    assert stated_section([seen(None)]) is None
    assert modulus_along(fit.beam, fit.stiffness, None, S) is None
    assert told(None, scale=1e20) == []


def test_the_modulus_is_k_over_the_stated_section() -> None:
    fit = made_up.posterior()
    found = modulus_along(fit.beam, fit.stiffness, stated_section([seen(None), seen(BAR)]), S)
    assert found is not None
    second = 0.03 * 0.012**3 / 12.0
    np.testing.assert_allclose(found.modulus, fit.beam.stiffness(S) * made_up.LENGTH / second, rtol=1e-9)
    np.testing.assert_allclose(found.high / found.modulus, fit.band(S).high / fit.band(S).k, rtol=1e-9)
    assert told(BAR) == []


def test_sizes_in_millimetres_are_found_out() -> None:
    (text,) = told(replace(BAR, thickness=1e3 * BAR.thickness, width=1e3 * BAR.width))
    assert "No material is that soft" in text
    assert (
        "Check width_m 12 m in the plane of bending, thickness_m 30 m across it (width_m counts with its third" in text
    )
    assert "forces are in N" in text


def test_a_round_beam_has_its_diameter_named() -> None:
    wire = StatedSection("circle", ENDS, np.array([1e-5, 2e-5]), np.array([1e-5, 2e-5]))
    (text,) = told(wire)
    assert "No material is that stiff" in text
    assert "Check diameter_m 0.01 to 0.02 mm (the size counts with its fourth power)" in text


@pytest.mark.parametrize(("scale", "word"), [(1e-4, "soft"), (1e7, "stiff")])
def test_forces_in_another_unit_are_found_out(scale: float, word: str) -> None:
    (text,) = told(BAR, scale=scale)
    assert f"No material is that {word}" in text


def test_of_a_k_that_is_in_doubt_nothing_more_is_said() -> None:
    assert told(BAR, scale=1e7, doubts=("the fit did not converge",)) == []


def test_the_regression_alone_is_looked_at_too() -> None:
    wrong = replace(BAR, thickness=1e3 * BAR.thickness)
    assert modulus_notices(made_up.BEAM, None, [seen(BAR)]) == ()
    assert len(modulus_notices(made_up.BEAM, None, [seen(wrong)])) == 1


def test_recordings_that_state_different_sections_are_told() -> None:
    fit = made_up.posterior()
    several = [seen(None), seen(BAR, "a"), seen(replace(BAR, width=0.9 * BAR.width), "b")]
    (remark,) = worded(modulus_notices(fit.beam, fit.stiffness, several))
    assert remark.level == "warning"
    assert "different sections" in remark.text
    assert "that of a." in remark.text
    assert modulus_notices(fit.beam, fit.stiffness, [seen(BAR, "a"), seen(BAR, "b")]) == ()


def test_the_unit_goes_by_the_size() -> None:
    sizes = [5e2, 7e5, 2e6, 2.1e11, 3e13]
    assert [modulus_unit(np.array([size, np.nan]))[1] for size in sizes] == ["kPa", "kPa", "MPa", "GPa", "GPa"]
    assert modulus_unit(np.array([np.nan]))[1] == "kPa"


@pytest.mark.parametrize(("size", "known"), [("0.006", True), pytest.param("6", False, marks=pytest.mark.slow)])
def test_a_run_has_the_modulus_and_says_where_there_is_no_such_material(tmp_path: Path, size: str, known: bool) -> None:
    """A rod of 6 mm, and one that was written in millimetres, of a mass that is not known."""
    for file in WEIGHTS.iterdir():
        (tmp_path / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    text = (WEIGHTS / "recording.toml").read_text(encoding="utf-8")
    text = text if known else text.replace("mass_kg = 0.045\n", "")  # which would be refused with such a section
    (tmp_path / "recording.toml").write_text(text.replace("[beam]", f"[beam]\ndiameter_m = {size}"), encoding="utf-8")
    run = learn(tmp_path / "recording.toml", fitting=FitSettings(functions=6, most_frames=10))
    found = run.modulus(S)
    assert found is not None
    assert run.posterior is not None
    second = np.pi * float(size) ** 4 / 64.0
    np.testing.assert_allclose(found.modulus, run.beam.stiffness(S) * run.beam.length / second, rtol=1e-9)
    np.testing.assert_allclose(found.low, run.posterior.band(S).low * run.beam.length / second, rtol=1e-9)
    said = [one.text for one in run.remarks if "Young's modulus" in one.text]
    assert len(said) == (0 if known else 1)
    assert known or "diameter_m 6 m" in said[0]
    rows = dict(overview(tmp_path).rows)
    assert rows["section"] == ("diameter_m 6 mm" if known else "diameter_m 6 m")
