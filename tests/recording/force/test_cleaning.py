"""The force log: what is refused and where, and what is left of a known force after cleaning."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.errors import RecordingError
from onebend.recording.force import choose_cutoff, clean_force, force_at, to_beam
from onebend.recording.force_log import read_force_log
from onebend.records import ForceLog, ForceNoise
from tests.recording.pushed import Pushed

COLUMNS = ("time_s", "fx_N", "fy_N")
GOOD = ["time_s,fx_N,fy_N,where"] + [f"{0.1 * i:.1f},{0.01 * i},-0.5,0.8" for i in range(20)]


def written(folder: Path, lines: list[str]) -> Path:
    path = folder / "force.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def changed(line: int, text: str) -> list[str]:
    return [text if number == line else good for number, good in enumerate(GOOD, start=1)]


def test_good_log(tmp_path: Path) -> None:
    path = written(tmp_path, ["\ufeff" + GOOD[0].replace(",", ", "), *GOOD[1:10], "", *GOOD[10:]])
    log = read_force_log(path, COLUMNS, "where")
    assert np.allclose(log.time, 0.1 * np.arange(20))
    assert np.allclose(log.force, np.stack([0.01 * np.arange(20), np.full(20, -0.5)], axis=1))
    assert log.push_s is not None
    assert np.all(log.push_s == 0.8)
    assert read_force_log(path, COLUMNS).push_s is None


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (changed(7, "0.5,1,oops,1"), ["line 7", "fy_N", "'oops'"]),
        (changed(7, "0.1,1,1,1"), ["line 7", "is before", "line 6"]),
        (GOOD[:1] + GOOD[:0:-1], ["line 3", "is before", "19 such lines"][:2]),
        (["t,fx,fy", *GOOD[1:]], ["line 1", "time_s, fx_N, fy_N", "found t, fx, fy"]),
        (GOOD[:4], ["3 rows", "at least 10"]),
        (GOOD[:1], ["no rows"]),
        ([], ["empty"]),
        (GOOD[:1] + [f"{i},0,0.0,1" for i in range(20)], ["zero", "not streaming"]),
    ],
)
def test_refused_with_the_place(tmp_path: Path, lines: list[str], words: list[str]) -> None:
    with pytest.raises(RecordingError) as caught:
        read_force_log(written(tmp_path, lines), COLUMNS)
    message = str(caught.value)
    assert "force.csv" in message
    for word in words:
        assert word in message


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is not a file"):
        read_force_log(tmp_path / "none.csv", COLUMNS)
    path = tmp_path / "force.csv"
    path.write_bytes(bytes(range(128, 256)) * 20)
    with pytest.raises(RecordingError, match="not a CSV"):
        read_force_log(path, COLUMNS)


@pytest.mark.parametrize("acts_on", ["beam", "robot"])
@pytest.mark.parametrize("rotation", [0.0, 0.5, -2.0])
def test_known_force_comes_back(rotation: float, acts_on: str) -> None:
    pushed = Pushed(drift=(0.004, -0.003))
    log = pushed.log()
    sign = 1.0 if acts_on == "beam" else -1.0
    # The log's x axis stands at `rotation` in the beam's frame: what acts along it reads (1, 0) there.
    axes = np.array([[math.cos(rotation), math.sin(rotation)], [-math.sin(rotation), math.cos(rotation)]])
    sensed = ForceLog(log.time, sign * log.force @ axes.T)
    rests = [(-np.inf, pushed.offset + 1.4), (pushed.offset + 6.6, np.inf)]
    clean = clean_force(sensed, rests, rotation=rotation, acts_on=acts_on, cutoff=2.5)  # type: ignore[arg-type]
    wrong = clean.force - pushed.true_force(log.time - pushed.offset)
    assert np.sqrt(np.mean(wrong**2)) < 0.009  # the sensor's coloured noise is 0.006
    assert clean.drift == pytest.approx(np.array(pushed.drift), abs=0.002)
    assert np.all(clean.noise_sd < 0.012)
    assert np.all(clean.noise_sd > 0.003)


def test_log_along_its_own_x_axis() -> None:
    assert np.array([[1.0, 0.0]]) @ to_beam(math.radians(30)) == pytest.approx(np.array([[math.cos(math.pi / 6), 0.5]]))


def test_one_rest_leaves_the_drift_and_says_so() -> None:
    pushed = Pushed(drift=(0.02, 0.0))
    noise = ForceNoise(white=0.001, coloured=0.006, tau=0.12, walk=0.01)
    before, after = (-np.inf, pushed.offset + 1.4), (pushed.offset + 6.6, np.inf)
    one, two = (clean_force(pushed.log(), rests, cutoff=2.5, noise=noise) for rests in ([before], [before, after]))
    assert np.isnan(one.drift).all()
    assert any("drift" in remark.text for remark in one.remarks)
    assert np.all(one.noise_sd > 1.3 * two.noise_sd)
    middle = np.abs(one.time - pushed.offset - 4.0) < 0.5
    true = pushed.true_force(one.time - pushed.offset)
    assert np.abs((one.force - true)[middle, 0].mean()) > 0.03
    assert np.abs((two.force - true)[middle, 0].mean()) < 0.015


def test_no_rest_means_unknown_noise_and_a_warning() -> None:
    clean = clean_force(Pushed().log(), [], cutoff=2.5)
    assert np.isnan(clean.noise_sd).all()
    assert np.array_equal(clean.tare, [0.0, 0.0])
    assert clean.remarks[0].level == "warning"


def test_claimed_noise_covers_the_error() -> None:
    noise = ForceNoise(white=0.001, coloured=0.006, tau=0.12, walk=1e-4)
    squares = []
    for seed in range(10):
        pushed = Pushed(seed=seed)
        rests = [(-np.inf, pushed.offset + 1.4), (pushed.offset + 6.6, np.inf)]
        clean = clean_force(pushed.log(), rests, cutoff=2.5, noise=noise)
        loaded = (clean.time > pushed.offset + 1.5) & (clean.time < pushed.offset + 6.5)
        wrong = (clean.force - pushed.true_force(clean.time - pushed.offset))[loaded]
        squares.append(np.mean((wrong / clean.noise_sd) ** 2))
    assert 0.4 < np.mean(squares) < 1.5


def test_spikes_do_not_show() -> None:
    pushed = Pushed()
    log = pushed.log()
    spiked = log.force.copy()
    rows = np.arange(100, len(log.time), 190)
    spiked[rows, 0] += 2.0
    rests = [(-np.inf, pushed.offset + 1.4)]
    plain, other = (clean_force(ForceLog(log.time, f), rests, cutoff=2.5) for f in (log.force, spiked))
    assert other.outliers >= len(rows)
    assert np.abs(other.force - plain.force).max() < 0.005


def test_gaps_stay_gaps() -> None:
    pushed = Pushed()
    log = pushed.log()
    since = log.time - pushed.offset
    kept = ~((since > 3.0) & (since < 4.0))
    torn = ForceLog(log.time[kept], log.force[kept])
    clean = clean_force(torn, [(-np.inf, pushed.offset + 1.4)], cutoff=2.5)
    found, _ = force_at(clean, pushed.offset + np.array([-5.0, 2.9, 3.1, 3.5, 3.9, 4.1, 50.0]))
    assert np.array_equal(np.isnan(found[:, 0]), [True, False, True, True, True, False, True])


def test_cutoff_is_twice_the_motion() -> None:
    assert choose_cutoff(0.7) == pytest.approx(1.4)
    assert choose_cutoff(math.nan) == math.inf


@pytest.mark.parametrize(("share", "levels"), [(0.1, []), (0.3, [False]), (0.6, [True])])
def test_a_zero_that_drifts_by_more_than_half_of_the_push_is_a_doubt(share: float, levels: list[bool]) -> None:
    pushed = Pushed()
    largest, log = float(np.abs(pushed.true_force(np.linspace(0.0, 8.0, 400))).max()), pushed.log()
    before, after = (-np.inf, pushed.offset + 1.4), (pushed.offset + 6.6, np.inf)
    slow = np.interp(log.time - pushed.offset, [1.4, 6.6], [0.0, share * largest])[:, None] * np.array([1.0, 0.0])
    clean = clean_force(replace(log, force=log.force + slow), [before, after], cutoff=2.5)
    assert [remark.doubt for remark in clean.remarks if remark.about == "drift"] == levels
