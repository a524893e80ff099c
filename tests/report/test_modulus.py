"""Young's modulus on the screen and in the report: beside k, in a unit that reads well, and only where it is known."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from onebend.beam.section import modulus_band, one_modulus, relative_moment
from onebend.cli.screens import show_model, show_run
from onebend.learning.run import Run
from onebend.records import StatedSection
from onebend.report.confidence import (
    MeasuredBeam,
    measured_beam,
    modulus_range,
    modulus_rows,
    modulus_words,
    one_modulus_words,
)
from onebend.report.page import page
from onebend.report.sentences import significant
from onebend.results.model import StoredModel
from tests import made_up

BAR = StatedSection("rectangle", np.array([0.0, 1.0]), np.full(2, 0.004), np.full(2, 0.03))
S = np.linspace(0.0, 1.0, 11)


def findings(section: StatedSection | None, *, fitted: bool = True) -> Run:
    made = made_up.findings(0, fitted=fitted)
    return replace(made, recordings=tuple(made_up.with_stated(one, section=section) for one in made.recordings))


def measured(section: StatedSection | None, *, fitted: bool = True) -> MeasuredBeam:
    return measured_beam(findings(section, fitted=fitted))


def screen(section: StatedSection | None, *, fitted: bool = True) -> str:
    console = Console(file=io.StringIO(), width=110, color_system=None)
    show_run(console, findings(section, fitted=fitted), Path("out"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_rows_are_the_band_in_one_unit() -> None:
    rows = modulus_rows(measured(BAR), S)
    assert rows is not None
    band = modulus_band(made_up.posterior().stiffness, made_up.LENGTH, BAR, S)
    assert rows.unit == "MPa"
    for cells, values in ((rows.values, band.modulus), (rows.low, band.low), (rows.high, band.high)):
        assert list(cells) == [significant(value / 1e6) for value in values]


def test_the_screen_has_the_modulus_below_k() -> None:
    text = screen(BAR)
    rows = modulus_rows(measured(BAR), S)
    assert rows is not None
    table = next(line for line in text.splitlines() if line.lstrip().startswith("E [MPa]"))
    assert [cell.strip("()") for cell in table.split()[2:]] == list(rows.values)
    assert "width_m 4 mm in the plane of bending, thickness_m 30 mm across it, taken as" in " ".join(text.split())
    assert modulus_range(measured(BAR)).replace("\u00a0", " ") in text.replace("\u00a0", " ")


@pytest.mark.parametrize("fitted", [True, False])
def test_of_an_unknown_section_nothing_is_shown(fitted: bool) -> None:
    text = screen(None, fitted=fitted) + page(findings(None, fitted=fitted), {})
    assert "Young" not in text
    assert "E [" not in text
    assert modulus_rows(measured(None), S) is None
    assert modulus_words(measured(None)) == []


def test_the_report_has_it_in_card_table_and_words() -> None:
    html = page(findings(replace(BAR, sd=1e-4)), {})
    rows = modulus_rows(measured(replace(BAR, sd=1e-4)), S)
    assert rows is not None
    assert "E [MPa]" in html
    for cell in (*rows.values, *rows.low, *rows.high):
        assert f">{cell}</td>" in html
    assert "known to 0.10 mm (sd)" in html
    assert "<span>Young&#39;s modulus E(s)</span>" in html


def test_the_regression_has_a_modulus_without_a_band() -> None:
    rows = modulus_rows(measured(BAR, fitted=False), S)
    assert rows is not None
    assert (rows.low, rows.high) == ((), ())
    assert "Young's modulus" in screen(BAR, fitted=False)
    assert "E [MPa]" in page(findings(BAR, fitted=False), {})


def test_a_section_that_is_known_nowhere_near_gives_no_range() -> None:
    part = replace(BAR, s=np.array([0.2, 0.4]))
    low, high = (float(cell.split()[0]) for cell in modulus_range(measured(part)).split("…"))
    band = modulus_band(made_up.posterior().stiffness, made_up.LENGTH, BAR, np.linspace(0.2, 0.4, 41))
    assert low == pytest.approx(band.modulus.min() / 1e6, rel=5e-3)
    assert high == pytest.approx(band.modulus.max() / 1e6, rel=5e-3)


def test_a_stored_beam_shows_it_too() -> None:
    fit = made_up.posterior()
    for uncertain in (fit.stiffness, None):
        console = Console(file=io.StringIO(), width=80, color_system=None)
        show_model(console, StoredModel(fit.beam, None, uncertain, section=BAR))
        assert isinstance(console.file, io.StringIO)
        text = " ".join(console.file.getvalue().split())
        assert "Young's modulus E = k L / I" in text
        assert ("E [MPa]" in text) == (uncertain is not None)
        console = Console(file=io.StringIO(), width=80, color_system=None)
        show_model(console, StoredModel(fit.beam, None, uncertain))
        assert isinstance(console.file, io.StringIO)
        assert "Young" not in console.file.getvalue()


def test_a_beam_that_goes_with_its_section_has_one_modulus_first() -> None:
    plain = made_up.posterior().stiffness
    shape = relative_moment(BAR)
    uncertain = replace(plain, offset=shape, nominal=replace(plain, offset=shape, shape=None))
    one = MeasuredBeam(made_up.BEAM, uncertain, BAR)
    found = one_modulus(uncertain, made_up.LENGTH, BAR)
    assert found is not None
    words = one_modulus_words(one).replace("\u00a0", " ")
    e, low, high = (significant(value / 1e6) for value in found)
    assert words == f"{e} MPa ({low} to {high})"
    [sentence] = modulus_words(one)
    assert words in sentence.replace("\u00a0", " ")
    assert one_modulus_words(measured(BAR)) == ""
