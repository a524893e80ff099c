"""`onebend frequencies` on the example, and the example's own learning: E of a ruler from how fast it swings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.recording.observe import observe, swing_signals
from tests.recording.toml.test_frequencies import BEAM

RULER = Path(__file__).parents[1] / "examples" / "ruler"
TRUE = (9.2430, 57.544)  # Hz, hanging: what the record was made with


def test_the_modes_of_the_example_are_found_and_can_be_pasted(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["frequencies", str(RULER / "swing.csv"), "--quiet"])
    assert said.exit_code == 0
    rows = said.stdout.partition("For recording.toml:")[2].replace("base_angle_deg =", "base_angle_deg = -90")
    (tmp_path / "recording.toml").write_text(BEAM + rows)
    first, second = observe(tmp_path).frequencies
    assert (first.mode, second.mode) == (1, 2)
    for one, true in zip((first, second), TRUE, strict=True):
        assert abs(one.frequency - true) < 3.0 * one.sd
        assert one.sd < 2e-3 * true


def test_as_json_and_in_slow_motion() -> None:
    words = ["frequencies", str(RULER / "swing.csv"), "--json", "--slowed", "2", "--from-s", "0.5", "--modes", "1"]
    found = json.loads(CliRunner().invoke(app, words).stdout)
    (mode,) = found["modes"]
    assert mode["hz"] == pytest.approx(2.0 * TRUE[0], rel=1e-3)
    assert found["from_s"] == pytest.approx(0.5, abs=0.01)


def test_tables_of_points_and_of_any_signal_are_read(tmp_path: Path) -> None:
    points, any_signal = tmp_path / "points.csv", tmp_path / "phone.csv"
    points.write_text("time_s,id,x_m,y_m\n0,1,0.1,0\n0,2,0.2,0\n0.1,2,0.2,0.01\n")
    seen = swing_signals(points)
    np.testing.assert_array_equal(seen.value, [[0.1, 0.0, 0.2, 0.0], [np.nan, np.nan, 0.2, 0.01]])
    any_signal.write_text("time_s,note,a_m_s2\n0,start,1.0\n0.1,,\n")
    np.testing.assert_array_equal(swing_signals(any_signal).value, [[1.0], [np.nan]])
    any_signal.write_text("time_s\n0\n")
    said = CliRunner().invoke(app, ["frequencies", str(any_signal), "--quiet"])
    assert said.exit_code != 0
    assert "Add a column for each signal" in " ".join(said.stderr.split())


@pytest.mark.slow
def test_the_example_gives_youngs_modulus(tmp_path: Path) -> None:
    """205 GPa, by which the measurements were made; the band holds the errors of mass and section."""
    out = tmp_path / "out"
    words = ["learn", str(RULER), "-o", str(out), "--quiet", "--json"]
    learned = CliRunner().invoke(app, words)
    assert learned.exit_code == 0
    found = json.loads(learned.stdout)
    low, high = found["stiffness"]["E_lo_Pa"][5], found["stiffness"]["E_hi_Pa"][5]
    assert low < 205e9 < high < 1.15 * low
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "Natural frequencies of the beam as fitted" in report
    assert "RMS distance of each tag" not in report
    assert "frequencies; not validated" in report


def test_frequencies_alone_validate_no_shape(tmp_path: Path) -> None:
    """Beside them the beam's own frequencies stand; no tag counts as predicted."""
    out = tmp_path / "out"
    words = ["learn", str(RULER), "-o", str(out), "--quiet", "--json", "--validate", str(RULER)]
    assert CliRunner().invoke(app, words).exit_code == 0
    said = CliRunner().invoke(app, ["validate", str(out), str(RULER), "--quiet", "--json"])
    (compared,) = json.loads(said.stdout)["validation"]
    assert compared["rms_m"] == [None]
    assert any("mode 1 (hangs) 9.2428 Hz, the beam" in remark["text"] for remark in compared["remarks"])
