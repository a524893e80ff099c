"""Recordings in, tables out; stopped, it goes on."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from onebend.errors import ResultsError
from onebend.files.publish import changed_files, read_summary
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.filming import marker_recording
from onebend.learning.optimizer import FitSettings
from onebend.many import tasks as running
from onebend.many.batch import BatchOutcome, run_batch, summary_of, write_batch
from onebend.many.tasks import EVERY, PLACES, RECORDS, read_record, record_path, write_record
from onebend.pipeline import Run, learn
from onebend.progress import Silent
from onebend.results.model import load_model
from tests.many.stems import BEAM, K, bench, stem

NASTY = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def stems(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two stems, and a recording whose force log is missing."""
    folder = tmp_path_factory.mktemp("stems")
    stem(folder / "dry" / "one", seed=1)
    stem(folder / "wet" / "two", scale=0.5, seed=2)
    stem(folder / "wet" / NASTY, seed=3)
    (folder / "wet" / NASTY / "force.csv").unlink()
    return folder


def learn_quickly(recording: Any, **more: Any) -> Run:
    """As an ideal beam, with few functions."""
    return learn(recording, **(more | {"fitting": FitSettings(functions=12, allowances=frozenset())}))


@pytest.fixture(scope="module", autouse=True)
def _quickly_and_in_this_process(no_other_places: None) -> Iterator[None]:  # noqa: ARG001
    """The start of processes and the fit are not what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(running, "available_cores", lambda: 1)
        patch.setattr(running, "learn", learn_quickly)
        yield


@pytest.fixture(scope="module")
def done(stems: Path, tmp_path_factory: pytest.TempPathFactory) -> BatchOutcome:
    outcome = run_batch(stems, tmp_path_factory.mktemp("out") / "results")
    write_batch(outcome, summary_of(outcome))
    return outcome


@pytest.mark.slow
def test_every_recording_is_a_row_as_learn_finds_it(stems: Path, done: BatchOutcome) -> None:
    table = {row["name"]: row for row in pq.read_table(done.out / "recordings.parquet").to_pylist()}
    assert set(table) == {"dry/one", "wet/two", f"wet/{NASTY}"}
    assert [table[name]["group"] for name in ("dry/one", "wet/two")] == ["dry", "wet"]
    alone = learn_quickly(stems / "dry" / "one")
    curves = pq.read_table(done.out / "curves.parquet").to_pylist()
    k = np.array([row["k_N_m"] for row in curves if row["name"] == "dry/one"])
    assert alone.posterior is not None
    assert np.array_equal(k, alone.posterior.stiffness.band(PLACES).k)
    assert table["dry/one"]["k_at_0.5_N_m"] == k[50]
    rows = [row for row in pq.read_table(done.out / "covariances.parquet").to_pylist() if row["name"] == "dry/one"]
    covariance = np.array([[row[f"with_{s:.3g}"] for s in PLACES[::EVERY]] for row in rows])
    sd = np.sqrt(covariance.diagonal() + table["dry/one"]["gain_sd"] ** 2)
    band = np.array([(row["k_lo_N_m"], row["k_hi_N_m"]) for row in curves if row["name"] == "dry/one"])
    assert np.allclose(np.log(band[::EVERY, 1] / band[::EVERY, 0]), 2.0 * 1.959964 * sd, rtol=1e-5)
    for name, scale in (("dry/one", 1.0), ("wet/two", 0.5)):
        row = table[name]
        assert row["k_lo_at_0.5_N_m"] < scale * np.mean(K) < row["k_hi_at_0.5_N_m"]
        assert row["grade"]
        assert row["seconds"] > 0.0
    assert {row["name"] for row in pq.read_table(done.out / "nuisances.parquet").to_pylist()} == {"dry/one", "wet/two"}


def test_the_priors_part_is_a_part_of_the_covariance(done: BatchOutcome) -> None:
    learned = [one for one in done.records if one.covariance is not None and one.prior_part is not None]
    assert len(learned) == 2
    for one in learned:
        assert one.covariance is not None
        assert one.prior_part is not None
        share = one.prior_part.diagonal() / one.covariance.diagonal()
        assert np.all((share > 0.0) & (share <= 1.0)), share.round(3)
        values = np.linalg.eigvalsh(one.covariance - one.prior_part)
        assert values.min() > -0.1 * np.linalg.eigvalsh(one.covariance).max()


def test_the_tables_are_listed_by_their_checksums(done: BatchOutcome) -> None:
    summary = read_summary(done.out)
    assert summary is not None
    assert set(summary["files"]) > {"recordings.parquet", "curves.parquet", "covariances.parquet", "index.html"}
    assert changed_files(done.out) == []


@pytest.mark.slow
def test_in_doubt_is_what_learn_doubts(tmp_path: Path) -> None:
    """A push that is written far from its place, and one that tells nothing, though nothing contradicts it."""
    toml = stem(tmp_path / "stems" / "elsewhere", seed=4) / "recording.toml"
    toml.write_text(
        toml.read_text().replace("at_s = 1\n", "at_s = 0.6\n").replace("at_sd_m = 0.0025", "at_sd_m = 5e-4")
    )
    weak = PushProfile(0.05, before=0.8, rise=1.0, hold=0.2, fall=1.0, after=0.8)
    noisy = replace(bench(BEAM), push=weak, sensor=ForceSensor(rate=100.0, white_sd=0.05))
    marker_recording(noisy, tmp_path / "stems" / "vague", seed=5)
    stem(tmp_path / "stems" / "well", seed=6)
    outcome = run_batch(tmp_path / "stems", tmp_path / "out", folders=True)
    verdicts = {name: read_summary(tmp_path / "out" / "recordings" / name) for name in ("elsewhere", "vague", "well")}
    doubted = {name for name, one in verdicts.items() if one is not None and one["verdict"]["docs"]}
    assert doubted == {"elsewhere", "vague"}
    assert {name for name, _ in outcome.in_doubt} == doubted
    write_batch(outcome, summary_of(outcome))
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert text.index("not to be trusted</td>") < text.index("<polyline")
    for name in verdicts:
        assert f'<a href="recordings/{name}/report.html">{name}</a>' in text


def test_what_fails_is_a_row_with_its_reason(done: BatchOutcome) -> None:
    [(item, why)] = done.failed
    assert item.name == f"wet/{NASTY}"
    assert "force.csv" in why
    row = next(row for row in pq.read_table(done.out / "recordings.parquet").to_pylist() if row["reason"])
    assert np.isnan(row["k_at_0.5_N_m"])


def test_names_on_the_page_are_text(done: BatchOutcome) -> None:
    text = (done.out / "index.html").read_text(encoding="utf-8")
    assert NASTY not in text
    assert "&lt;img src=x" in text
    assert text.count("<polyline") == 2
    assert "http" not in text.replace("http-equiv", "")


@pytest.mark.slow
def test_nothing_is_done_twice_but_what_changed(stems: Path, done: BatchOutcome) -> None:
    before = {path: path.stat().st_mtime_ns for path in (done.out / RECORDS).iterdir()}
    again = run_batch(stems, done.out)
    assert again.learned_now == 0
    assert {path: path.stat().st_mtime_ns for path in (done.out / RECORDS).iterdir()} == before
    record_path(done.out, done.records[0].hash).write_text("{ half of it")
    assert run_batch(stems, done.out).learned_now == 1


@pytest.mark.slow
def test_a_changed_file_is_learned_anew(stems: Path, done: BatchOutcome, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(stems / "dry", copy)
    assert run_batch(copy, done.out).learned_now == 0  # the same content under another path
    toml = copy / "one" / "recording.toml"
    toml.write_text(toml.read_text().replace("placement_sd_m = 0.0005", "placement_sd_m = 0.001"))
    assert run_batch(copy, done.out).learned_now == 1


@pytest.mark.slow
def test_a_row_states_what_recording_toml_does_not(stems: Path, done: BatchOutcome, tmp_path: Path) -> None:
    rows = f"path,name,group,treatment,day,length_m\n{stems}/dry/one,b,g,dry,3,0.151\n"
    (tmp_path / "list.csv").write_text(rows)
    outcome = run_batch(tmp_path / "list.csv", tmp_path / "out", folders=True)
    write_batch(outcome, summary_of(outcome))
    (found,) = pq.read_table(tmp_path / "out" / "recordings.parquet").to_pylist()
    (unstated,) = (
        row for row in pq.read_table(done.out / "recordings.parquet").to_pylist() if row["name"] == "dry/one"
    )
    assert (unstated["length_m"], found["length_m"]) == (0.15, 0.151)
    assert (found["treatment"], found["day"]) == ("dry", 3.0)
    assert unstated["hash"] != found["hash"]
    model = load_model(tmp_path / "out" / "recordings" / "b")
    assert model.length == 0.151
    assert model.stiffness(0.5) == pytest.approx(found["k_at_0.5_N_m"], rel=1e-9)
    assert run_batch(tmp_path / "list.csv", tmp_path / "out", folders=True).learned_now == 0
    shutil.rmtree(tmp_path / "out" / "recordings" / "b")
    assert run_batch(tmp_path / "list.csv", tmp_path / "out", folders=True).learned_now == 1


@pytest.mark.slow
def test_a_record_that_was_edited_is_made_anew(stems: Path, done: BatchOutcome) -> None:
    path = record_path(done.out, done.records[0].hash)
    assert read_record(done.out, done.records[0].hash) is not None
    path.write_text(path.read_text().replace("holds", "holds well"))
    assert read_record(done.out, done.records[0].hash) is None
    assert run_batch(stems, done.out).learned_now == 1


@pytest.mark.slow
def test_a_name_that_is_no_utf_8_is_a_row_like_others(stems: Path, tmp_path: Path) -> None:
    folder = tmp_path / "stems"
    shutil.copytree(stems / "dry" / "one", folder / "good")
    bad = folder / os.fsdecode(b"bad\xff")
    try:
        bad.mkdir()
    except OSError:
        pytest.skip("this file system has no such names")
    (bad / "recording.toml").write_text("[beam]\n")
    outcome = run_batch(folder, tmp_path / "out", folders=True)
    write_batch(outcome, summary_of(outcome))
    rows = {row["name"]: row for row in pq.read_table(tmp_path / "out" / "recordings.parquet").to_pylist()}
    assert set(rows) == {"good", r"bad\udcff"}
    assert np.isfinite(rows["good"]["k_at_0.5_N_m"])
    assert rows[r"bad\udcff"]["reason"]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_in_the_place_of_a_record_does_not_hang(stems: Path, tmp_path: Path) -> None:
    hashed = run_batch(stems / "dry", tmp_path / "out").records[0].hash
    record_path(tmp_path / "out", hashed).unlink()
    os.mkfifo(record_path(tmp_path / "out", hashed))
    with within(300.0):
        [(item, why)] = run_batch(stems / "dry", tmp_path / "out").failed
    assert item.name == "one"
    assert "no plain file" in why


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """What hangs ends in an error."""

    def end(*_: object) -> None:
        raise TimeoutError("it hangs")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class Interrupted(Silent):
    """The person loses patience after the first recording."""

    def advance(self, count: int = 1) -> None:  # noqa: ARG002
        raise KeyboardInterrupt


@pytest.mark.slow
def test_stopped_it_keeps_what_is_done(stems: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt) as stopped:
        run_batch(stems / "wet", tmp_path / "out", progress=Interrupted())
    assert "of 2 recordings are done" in stopped.value.__notes__[0]
    assert list((tmp_path / "out" / RECORDS).glob("*.json"))
    assert run_batch(stems / "wet", tmp_path / "out").learned_now < 2


def test_other_files_are_left_alone(stems: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(ResultsError, match="not of a batch"):
        run_batch(stems, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_record_comes_back_as_it_was(done: BatchOutcome, tmp_path: Path) -> None:
    for record in done.records:
        write_record(tmp_path, replace(record, error=np.nan))
        back = read_record(tmp_path, record.hash)
        assert back is not None
        assert np.isnan(back.error)
        for name, value in vars(record).items():
            if name != "error":
                np.testing.assert_equal(getattr(back, name), value, err_msg=name)
