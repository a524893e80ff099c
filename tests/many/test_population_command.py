"""`onebend population` on the tables of a batch: what it reads, shows and writes, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.errors import ResultsError
from onebend.files.publish import seal, write_summary
from onebend.many.batch import BATCH_FORMAT
from onebend.many.population import TABLES as READ, read_batch
from onebend.many.population_report import TABLES
from tests.many.made_trials import Made, Truth, made

NASTY = "<b>wet</b>"
GROUPS = ("dry", NASTY)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["population", *(str(one) for one in arguments)])


def batch(folder: Path, truth: Truth = Truth(sizes=(4, 4)), **columns: list[Any]) -> Made:
    """The three tables of a batch, as `onebend batch` writes them, of a made trial; one more recording has failed."""
    one = made(truth, 1)
    trial, count = one.trial, len(one.trial.log_k)
    names = [f"stem-{i}" for i in range(count)]
    folder.mkdir()
    recordings: dict[str, list[Any]] = {
        "name": [*names, "lost"],
        "group": [*(GROUPS[trial.group_of[i]] for i in trial.object_of), "dry"],
        "plant": [*(f"plant {i}" for i in trial.object_of), "plant 0"],
        "reason": [*("" for _ in names), "force.csv is missing"],
        "doubts": ["" for _ in range(count + 1)],
        "hash": [*(f"{i:064x}" for i in range(count)), ""],
        "gain_sd": [*(0.01 for _ in names), float("nan")],
    }
    pq.write_table(pa.table(recordings | columns), folder / "recordings.parquet")
    places = np.linspace(0.0, 1.0, 101)
    k = [np.exp(np.interp(places, trial.s, row)) for row in trial.log_k]
    curves = {"name": np.repeat(names, 101), "s": np.tile(places, count), "k_N_m": np.concatenate(k)}
    known = {"identified": np.tile(places < 0.9, count)}
    pq.write_table(pa.table(curves | known), folder / "curves.parquet")
    table: dict[str, Any] = {"name": np.repeat(names, 21), "s": np.tile(trial.s, count)}
    for i, s in enumerate(trial.s):
        table |= {f"with_{s:.3g}": trial.covariance[:, :, i].ravel()}
        table |= {f"prior_with_{s:.3g}": 0.1 * trial.covariance[:, :, i].ravel()}
    pq.write_table(pa.table(table), folder / "covariances.parquet")
    sealed(folder)
    return one


def sealed(folder: Path) -> None:
    """The summary lists the tables as they are now."""
    write_summary(folder, {"format": BATCH_FORMAT})
    seal(folder, {})


def test_a_batch_is_read_as_it_was_written(tmp_path: Path) -> None:
    one = batch(tmp_path / "learned")
    found = read_batch(tmp_path / "learned", "group")
    assert found.groups == (NASTY, "dry")
    assert np.allclose(found.trial.log_k, one.trial.log_k)
    assert np.allclose(found.trial.covariance, 0.9 * one.trial.covariance)
    assert np.allclose(found.trial.alike[1], 0.1 * one.trial.covariance[:4].mean(axis=0))
    assert found.trial.group_of.tolist() == [1, 1, 1, 1, 0, 0, 0, 0]
    assert found.trial.common_sd == 0.01
    assert found.left_out == (("lost", "force.csv is missing"),)
    assert found.identified[0].tolist() == [1.0] * 18 + [0.0] * 3


def test_what_is_shown_and_written(tmp_path: Path) -> None:
    one = batch(tmp_path / "learned")
    out = tmp_path / "out"
    options = ("-o", out, "-q")
    done = run(tmp_path / "learned", *options)
    assert done.exit_code == 0, done.output
    assert "lost" in done.stdout
    ends = {f"{name}.{end}" for name in TABLES for end in ("parquet", "csv")}
    assert {path.name for path in out.iterdir()} == ends | {"report.html", "summary.json"}
    means = pq.read_table(out / "means.parquet")
    rows = np.array([name == "dry" for name in means["group"].to_pylist()])
    low, high = (means[f"k_{end}_N_m"].to_numpy()[rows] for end in ("lo", "hi"))
    assert np.mean((low < np.exp(one.means[0])) & (np.exp(one.means[0]) < high)) > 0.9
    for name in TABLES:
        whole, text = pq.read_table(out / f"{name}.parquet"), pc.read_csv(out / f"{name}.csv")
        assert whole.column_names == text.column_names
        assert whole.num_rows == text.num_rows
    page = (out / "report.html").read_text(encoding="utf-8")
    assert NASTY not in page
    assert "&lt;b&gt;wet" in page
    assert page.count("<img") == 3
    refused(run(tmp_path / "learned", *options), "--force")
    again = run(tmp_path / "learned", *options, "--force", "--json")
    assert again.exit_code == 0, again.output
    summary = json.loads(again.stdout)
    assert [one["objects"] for one in summary["groups"]] == [4, 4]
    assert summary["spread"]["repeatability"]["value"] is None


def test_pandas_reads_every_table(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    batch(tmp_path / "learned")
    assert run(tmp_path / "learned", "-o", tmp_path / "out", "-q").exit_code == 0
    for name in TABLES:
        parquet, text = pandas.read_parquet(tmp_path / "out" / f"{name}.parquet"), tmp_path / "out" / f"{name}.csv"
        assert list(pandas.read_csv(text).columns) == list(parquet.columns)


def test_objects_that_are_recorded_again_are_one(tmp_path: Path) -> None:
    batch(tmp_path / "learned", Truth(sizes=(3, 3), recordings=2))
    found = read_batch(tmp_path / "learned", "group", "plant")
    assert found.objects == tuple(f"plant {i}" for i in range(6))
    assert found.trial.object_of.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    assert found.trial.repeated


def refused(result: Result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    for word in words:
        assert word in result.stderr.replace("\n", " "), result.stderr


def test_what_cannot_be_met_is_said(tmp_path: Path) -> None:
    out = ("-o", tmp_path / "out", "-q")
    refused(run(tmp_path, *out), "holds no tables of a batch. Name the folder that `onebend batch` wrote")
    batch(tmp_path / "learned")
    refused(run(tmp_path / "learned", "--by", "colour", *out), "no column 'colour'", "plant")
    refused(run(tmp_path / "learned", "--by", "name", *out), "no group has two objects")
    assert not (tmp_path / "out").exists()
    batch(tmp_path / "mixed", plant=[*(f"plant {i % 4}" for i in range(8)), "plant 0"])
    with pytest.raises(ResultsError, match="the object 'plant 0' is in the groups"):
        read_batch(tmp_path / "mixed", "group", "plant")


def edit(folder: Path, name: str, change: Callable[[pa.Table], pa.Table]) -> None:
    pq.write_table(change(pq.read_table(folder / f"{name}.parquet")), folder / f"{name}.parquet")


def with_column(table: pa.Table, name: str, values: Any) -> pa.Table:
    return table.set_column(table.column_names.index(name), name, pa.array(values))


def doubled(folder: Path) -> None:
    for name in READ:
        edit(folder, name, lambda table: pa.concat_tables([table, table]))


def doubled_under_other_names(folder: Path) -> None:
    def again(table: pa.Table) -> pa.Table:
        names = [f"{name} again" for name in table["name"].to_pylist()]
        return pa.concat_tables([table, with_column(table, "name", names)])

    for name in READ:
        edit(folder, name, again)


def halved(folder: Path) -> None:
    edit(folder, "curves", lambda table: table.slice(0, len(table) // 2))


def negative_variances(folder: Path) -> None:
    edit(folder, "covariances", lambda table: with_column(table, "with_0.5", -table["with_0.5"].to_numpy()))


def stiffer(folder: Path) -> None:
    def ten_times(table: pa.Table) -> pa.Table:
        first = np.array(table["name"].to_pylist()) == "stem-0"
        return with_column(table, "k_N_m", np.where(first, 10.0, 1.0) * table["k_N_m"].to_numpy())

    edit(folder, "curves", ten_times)


@pytest.mark.parametrize("edited", [doubled, doubled_under_other_names, halved, negative_variances, stiffer])
def test_an_edited_table_is_refused_and_named(tmp_path: Path, edited: Callable[[Path], None]) -> None:
    batch(tmp_path / "learned")
    before = {name: (tmp_path / "learned" / f"{name}.parquet").read_bytes() for name in READ}
    edited(tmp_path / "learned")
    changed = [name for name, was in before.items() if (tmp_path / "learned" / f"{name}.parquet").read_bytes() != was]
    assert changed
    with pytest.raises(ResultsError, match=f"{sorted(changed)[0]}.parquet.* there is not as `onebend batch` wrote it"):
        read_batch(tmp_path / "learned", "group")


def test_a_recording_that_is_listed_twice_counts_once(tmp_path: Path) -> None:
    batch(tmp_path / "learned")
    doubled_under_other_names(tmp_path / "learned")
    sealed(tmp_path / "learned")
    with pytest.raises(ResultsError, match="'stem-0' and 'stem-0 again' are one recording"):
        read_batch(tmp_path / "learned", "group")


def test_a_doubted_recording_may_be_as_odd_as_it_is(tmp_path: Path) -> None:
    """It is left out, so that what its fit says of itself is not asked."""
    batch(tmp_path / "learned", doubts=["the fit did not converge", *("" for _ in range(8))])
    edit(tmp_path / "learned", "covariances", lambda table: with_column(
        table, "with_0.5", [float("nan"), *table["with_0.5"].to_pylist()[1:]]))  # fmt: skip
    sealed(tmp_path / "learned")
    assert read_batch(tmp_path / "learned", "group").left_out[0] == ("stem-0", "the fit did not converge")


def test_an_edited_summary_lists_nothing(tmp_path: Path) -> None:
    batch(tmp_path / "learned")
    summary = tmp_path / "learned" / "summary.json"
    summary.write_text(summary.read_text().replace("onebend-batch", "my-batch"))
    with pytest.raises(ResultsError, match=r"no summary.json that lists the tables.*or it was changed.*Run the same"):
        read_batch(tmp_path / "learned", "group")
