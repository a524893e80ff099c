"""The files of a batch and its summary; each is written whole or not at all."""

from __future__ import annotations

from typing import Any

from onebend.batch.outcome import BatchOutcome
from onebend.batch.page import page
from onebend.batch.run import BATCH_FORMAT
from onebend.batch.tables import covariances_table, curves_table, nuisances_table, recordings_table
from onebend.files.arrow import as_parquet
from onebend.files.single_file import write_file
from onebend.strict_json import to_json

SUMMARY = "summary.json"


def summary_of(outcome: BatchOutcome, *, written_by: str) -> dict[str, Any]:
    """What `--json` prints and `summary.json` holds."""
    return {
        "format": BATCH_FORMAT,
        "written_by": written_by,
        "recordings": len(outcome.items),
        "learned": sum(one.k is not None for one in outcome.records),
        "worked_on_now": outcome.learned_now,
        "failed": [{"name": item.name, "reason": why} for item, why in outcome.failed],
        "in_doubt": [item.name for item, one in zip(outcome.items, outcome.records, strict=True) if one.doubts],
        "outliers": [{"name": item.name, "reason": why} for item, why in outcome.outliers],
    }


def write_batch(outcome: BatchOutcome, summary: dict[str, Any], *, version: str) -> None:
    """Tables, page and summary into the results folder, in place of earlier ones.

    Raises:
        RecordingError: a column of the list has the name of one of the results'.
        ResultsError: a file cannot be written.
    """
    made: dict[str, str | bytes] = {
        "recordings.parquet": as_parquet(recordings_table(outcome)),
        "curves.parquet": as_parquet(curves_table(outcome)),
        "covariances.parquet": as_parquet(covariances_table(outcome)),
        "nuisances.parquet": as_parquet(nuisances_table(outcome)),
        "index.html": page(outcome, version=version),
        SUMMARY: to_json(summary) + "\n",
    }
    for name, content in made.items():
        write_file(outcome.out / name, content, overwrite=True)
