"""What users and sensors really write: it is read, or refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from onebend.recording.force_log import read_force_log

COLUMNS = ("time_s", "fx_N", "fy_N")
GOOD = ["time_s,fx_N,fy_N"] + [f"{0.1 * i:.1f},{0.01 * i},-0.5" for i in range(40)]


def log_file(folder: Path, lines: list[str]) -> Path:
    path = folder / "force.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_rows_without_numbers_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = [*GOOD]
    lines[7], lines[9], lines[11] = "0.6,nan,1", "0.8,,", "1.0,inf,1"
    lines[-1] = "3.9,0.3"  # cut in the middle of a row
    log = read_force_log(log_file(tmp_path, lines), COLUMNS)
    left = np.delete(np.arange(40), [6, 8, 10, 39])
    assert np.allclose(log.time, 0.1 * left)
    assert np.allclose(log.force[:, 0], 0.01 * left)
    assert [(one.level, one.text[:8]) for one in log.remarks] == [("note", "4 of 40 ")]


def test_rows_of_one_time_become_their_mean(tmp_path: Path) -> None:
    stamps = [f"{i // 2},{i},{-i}" for i in range(40)]  # a clock of whole seconds
    log = read_force_log(log_file(tmp_path, [GOOD[0], *stamps]), COLUMNS)
    assert np.array_equal(log.time, np.arange(20.0))
    assert np.array_equal(log.force[:, 0], 2.0 * np.arange(20) + 0.5)
    assert [one.level for one in log.remarks] == ["warning"]
    assert "20 of 40" in log.remarks[0].text
