"""`onebend batch` as it is typed: what it shows and writes, and what it refuses."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.many.tasks import TaskSettings, items_of, on_worker
from onebend.report.sentences import significant
from tests.many.stems import stem

pytestmark = pytest.mark.usefixtures("no_other_places")

FILES = {
    "batch.json",
    "covariances.parquet",
    "curves.parquet",
    "index.html",
    "nuisances.parquet",
    "recordings.parquet",
    "summary.json",
}


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["batch", *(str(one) for one in arguments)])


@pytest.mark.slow
def test_what_is_shown_and_written(tmp_path: Path) -> None:
    stems, out = tmp_path / "stems", tmp_path / "out"
    stem(stems / "good", seed=1)
    (stems / "bad").mkdir()
    (stems / "bad" / "recording.toml").write_text("[beam]\n")
    first = run(stems, "-o", out, "--workers", 1)
    assert first.exit_code == 0, first.output
    table = pq.read_table(out / "recordings.parquet").to_pylist()
    [good] = [row for row in table if row["name"] == "good"]
    [row] = [line.split() for line in first.stdout.splitlines() if line.split()[:1] == ["good"]]
    assert row[1:4] == [significant(good[f"k{end}_at_0.5_N_m"]) for end in ("", "_lo", "_hi")]
    assert row[4] == f"{100.0 * good['identified']:.0f}"
    assert "1 of 2 recordings learned; 0 in doubt." in first.stdout
    assert "not learned: 1" in first.stdout
    assert "[beam]" in first.stdout  # of the reason; brackets are no markup
    assert {path.name for path in out.iterdir() if not path.name.startswith(".")} == FILES
    again = run(stems, "-o", out, "--workers", 1, "--json")
    assert again.exit_code == 0
    summary = json.loads(again.stdout)
    assert (summary["recordings"], summary["learned"], summary["worked_on_now"]) == (2, 1, 0)
    assert [one["name"] for one in summary["failed"]] == ["bad"]
    assert summary["output"] == str(out)


def refused(result: Result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr


def test_what_cannot_be_met_is_said(tmp_path: Path) -> None:
    stems = tmp_path / "stems"
    refused(run(stems, "-o", tmp_path / "out"), "neither a folder nor a file")
    stems.mkdir()
    refused(run(stems, "-o", tmp_path / "out"), "holds no recording", "Name another")
    assert [path.name for path in tmp_path.iterdir()] == ["stems"]


@pytest.mark.slow
def test_a_cluster_learns_as_one_machine_does(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    stem(tmp_path / "stems" / "one", seed=1)
    assert run(tmp_path / "stems", "-o", tmp_path / "here", "--workers", 1).exit_code == 0
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        there = run(tmp_path / "stems", "-o", tmp_path / "there", "--scheduler", cluster.scheduler_address)
    assert there.exit_code == 0, there.output
    curves = [pq.read_table(tmp_path / name / "curves.parquet") for name in ("here", "there")]
    assert curves[0].equals(curves[1])


def test_what_a_cluster_cannot_do_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stem(tmp_path / "stems" / "one", seed=1)
    asked = (tmp_path / "stems", "-o", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1")
    refused(run(*asked, "--workers", 2), "Give --scheduler or --workers")
    item, settings = items_of(tmp_path / "stems", tmp_path / "out")[0], TaskSettings(tmp_path / "out", "0.0.0")
    assert "Install the same on both" in on_worker(item, settings).reason
    monkeypatch.setitem(sys.modules, "distributed", None)
    refused(run(*asked), "pip install 'onebend[batch]'")
