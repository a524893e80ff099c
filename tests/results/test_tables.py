"""The tables on disk say what the records say, and observations come back whole."""

from __future__ import annotations

import csv
import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.beam.section import modulus_band
from onebend.files.publish import seal, write_summary
from onebend.records import StatedSection
from onebend.results.learned_files import summary_of, validation_summary
from onebend.results.tables import write_markers, write_nuisances, write_selection, write_stiffness, write_validation
from onebend.text_files import plain
from tests import made_up
from tests.made_up import with_source


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_stiffness_has_201_rows_and_no_invented_band(tmp_path: Path) -> None:
    write_stiffness(tmp_path / "k.csv", made_up.BEAM, None)
    table = rows(tmp_path / "k.csv")
    assert len(table) == 201
    s = np.array([float(row["s"]) for row in table])
    k = np.array([float(row["k_N_m"]) for row in table])
    np.testing.assert_allclose(s, np.linspace(0, 1, 201), atol=1e-12)
    np.testing.assert_allclose(k, made_up.BEAM.stiffness(s), rtol=1e-8)
    assert {(row["k_lo_N_m"], row["k_hi_N_m"], row["identified"]) for row in table} == {("nan", "nan", "unknown")}


def test_stiffness_with_a_band_says_where_it_is_identified(tmp_path: Path) -> None:
    fit = made_up.posterior()
    write_stiffness(tmp_path / "k.csv", fit.beam, fit.stiffness)
    table = rows(tmp_path / "k.csv")
    band = fit.band(np.linspace(0, 1, 201))
    for name, values in (("k_N_m", band.k), ("k_lo_N_m", band.low), ("k_hi_N_m", band.high)):
        np.testing.assert_allclose([float(row[name]) for row in table], values, rtol=1e-8)
    assert [row["identified"] for row in table] == ["yes" if known else "no" for known in band.identified]


SECTION = StatedSection("rectangle", np.array([0.0, 0.9]), np.full(2, 0.012), np.full(2, 0.03), 1e-4)


def test_the_modulus_stands_beside_k_where_the_section_is_known(tmp_path: Path) -> None:
    fit = made_up.posterior()
    s = np.linspace(0.0, 1.0, 201)
    expected = modulus_band(fit.stiffness, made_up.LENGTH, SECTION, s)
    write_stiffness(tmp_path / "k.csv", fit.beam, fit.stiffness, SECTION)
    table = rows(tmp_path / "k.csv")
    for name, values in (("E_Pa", expected.modulus), ("E_lo_Pa", expected.low), ("E_hi_Pa", expected.high)):
        np.testing.assert_allclose([float(row[name]) for row in table], values, rtol=1e-8)
    assert (table[-1]["E_Pa"], table[-1]["k_N_m"] != "nan") == ("nan", True)
    write_stiffness(tmp_path / "k.csv", made_up.BEAM, None, SECTION)
    assert {row["E_lo_Pa"] for row in rows(tmp_path / "k.csv")} == {"nan"}


def test_the_summary_has_the_modulus_where_the_section_is_known() -> None:
    made = made_up.findings(0)
    known = replace(made, recordings=tuple(made_up.with_stated(one, section=SECTION) for one in made.recordings))
    found = plain(summary_of(known))["stiffness"]
    expected = modulus_band(made_up.posterior().stiffness, made_up.LENGTH, SECTION, np.linspace(0.0, 1.0, 11))
    np.testing.assert_allclose(found["E_lo_Pa"][:-1], expected.low[:-1])
    assert found["E_Pa"][-1] is None
    assert found["section"] == {
        "shape": "rectangle",
        "s": [0.0, 0.9],
        "in_plane_m": [0.012, 0.012],
        "across_m": [0.03, 0.03],
        "sd_m": 1e-4,
    }
    alone = plain(summary_of(replace(known, posterior=None, beam=made_up.BEAM)))["stiffness"]
    assert "E_Pa" in alone
    assert "E_lo_Pa" not in alone
    nothing = plain(summary_of(made))["stiffness"]
    assert not {"E_Pa", "section"} & set(nothing)


def test_a_fit_that_is_in_doubt_identifies_nothing_in_any_file(tmp_path: Path) -> None:
    fit = made_up.posterior()
    lost = replace(fit, optimum=replace(fit.optimum, converged=False))
    assert fit.band(np.linspace(0, 1, 11)).identified.any()
    write_stiffness(tmp_path / "k.csv", lost.beam, lost.stiffness)
    assert {row["identified"] for row in rows(tmp_path / "k.csv")} == {"no"}
    summary = plain(summary_of(replace(made_up.findings(0), posterior=lost)))
    assert summary["fit"]["trusted"] is False
    assert summary["fit"]["doubts"] == ["the fit did not converge"]
    assert summary["fit"]["identified"] == []
    assert not any(summary["stiffness"]["identified"])


def test_nuisances_come_with_their_unit_and_both_sds(tmp_path: Path) -> None:
    fit = made_up.posterior()
    write_nuisances(tmp_path / "n.csv", fit.nuisances())
    table = {row["name"]: row for row in rows(tmp_path / "n.csv")}
    for one in fit.nuisances():
        row = table[one.name]
        assert row["unit"] == one.unit
        found = [float(row[name]) for name in ("value", "sd", "prior_sd")]
        np.testing.assert_allclose(found, [one.value, one.sd, one.prior_sd], rtol=1e-8)


def test_selection_marks_the_chosen_row_and_says_why_others_are_out(tmp_path: Path) -> None:
    learned = made_up.learned()
    write_selection(tmp_path / "selection.csv", learned)
    table = rows(tmp_path / "selection.csv")
    assert [(row["n"], row["m"], row["chosen"]) for row in table] == [
        ("2", "2", "no"),
        ("4", "3", "yes"),
        ("5", "5", "no"),
    ]
    assert table[2]["why_out"] == "k(s) is not positive"
    assert (table[2]["bic"], table[2]["rms_3_m"]) == ("inf", "nan")
    assert [float(value) for value in table[1]["coefficients_N_m"].split(";")] == list(made_up.GAUSSIANS.coefficients)
    assert float(table[1]["rms_1_m"]) == pytest.approx(learned.training.rms[0], rel=1e-8)


def test_markers_give_the_rms_again(tmp_path: Path) -> None:
    one = replace(made_up.comparison("epoch"), time=1.7e9 + np.arange(made_up.FRAMES) / 30)
    write_markers(tmp_path / "markers.csv", [made_up.comparison(), one])
    table = [row for row in rows(tmp_path / "markers.csv") if row["recording"] == "epoch"]
    assert len(table) == made_up.FRAMES * 3
    assert float(table[3]["time_s"]) == pytest.approx(1.7e9 + 1 / 30, abs=1e-5)
    for i, tag in enumerate(one.tag_id):
        square = [
            float(row["residual_x_m"]) ** 2 + float(row["residual_y_m"]) ** 2
            for row in table
            if row["tag"] == str(tag) and row["x_m"] != "nan"
        ]
        assert np.sqrt(np.mean(square)) == pytest.approx(one.rms[i], rel=1e-6)


def test_validation_table_keeps_the_unknown_unknown(tmp_path: Path) -> None:
    write_validation(tmp_path / "v.csv", [made_up.comparison("a"), made_up.comparison("b", error_m=0.002)])
    table = rows(tmp_path / "v.csv")
    assert [(row["recording"], row["tag"]) for row in table] == [(name, tag) for name in "ab" for tag in "123"]
    assert table[2]["sensor_rms_m"] == "nan"
    assert float(table[3]["rms_m"]) == pytest.approx(2 * float(table[0]["rms_m"]))


def test_summary_is_strict_json_with_null_for_the_unknown(tmp_path: Path) -> None:
    summary = summary_of(made_up.findings())
    (tmp_path / "model.json").write_text("{}")
    write_summary(tmp_path, summary)
    seal(tmp_path, {"pictures_failed": {}})
    read = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert read["files"] == {"model.json": hashlib.sha256(b"{}").hexdigest(), "summary.json": None}
    chosen = read["regression"]["chosen"]
    assert (chosen["n"], chosen["m"]) == (4, 3)
    assert read["training"][0]["sensor_rms_m"] == [0.0001, 0.0004, None]
    assert read["observed"][0]["force"]["drift_N_s"] == [0.001, None]
    fit, band = read["fit"], made_up.posterior().band(np.linspace(0, 1, 11))
    assert read["method"] == "fit"
    np.testing.assert_allclose(read["stiffness"]["k_lo_N_m"], band.low)
    assert read["stiffness"]["identified"] == band.identified.tolist()
    assert fit["converged"] is True
    assert {"name", "unit", "value", "sd", "prior_sd"} == set(fit["nuisances"][0])
    assert len(fit["hyperparameters"]["noise"]) == 1
    assert not {"chains", "part_variances"} & set(fit["hyperparameters"])
    assert read["validation"][1]["recording"] == "other-2"
    assert read["remarks"][0]["level"] == "warning"
    texts = [(remark["recording"], remark["text"]) for remark in read["remarks"]]
    assert len(texts) == len(set(texts))


def test_summary_without_force_or_clock() -> None:
    found = made_up.findings(0)
    seen = with_source(found.recordings[0], clean_force=None, clock=None)
    summary = summary_of(replace(found, recordings=(seen,), posterior=None))
    assert summary["observed"][0]["force"] is None
    assert summary["observed"][0]["clock"] is None
    assert (summary["method"], summary["fit"]) == ("regression", None)
    assert validation_summary("m", ())["validation"] == []


def test_plain_leaves_no_array_and_no_infinity() -> None:
    value = plain({"a": np.array([1.0, np.nan]), "b": (np.int64(3), float("inf"), "text", None, True)})
    assert value == {"a": [1.0, None], "b": [3, None, "text", None, True]}
