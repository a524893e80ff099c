"""Parquet tables that are small on the disk and huge in memory: refused from what they say of themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.attack.family import Case, Harm, params, withstood
from tests.attack.victim import Victim

FEW, MANY = 2, 1_000_000


def table(make: Callable[[], dict[str, Any]], times: int = 1) -> Harm:
    """The tracks as a Parquet table of these columns, written `times` times into one file."""

    def harm(folder: Path) -> None:
        columns = pa.table(make())
        with pq.ParquetWriter(folder / "markers.parquet", columns.schema, compression="zstd") as writer:
            for _ in range(times):
                writer.write_table(columns)
        file = folder / "recording.toml"
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace('"markers.csv"', '"markers.parquet"'), encoding="utf-8")

    return harm


def columns(count: int, **others: Any) -> dict[str, Any]:
    return {name: np.zeros(count) for name in ("time_s", "id", "x_m", "y_m")} | others


def words(text: str, count: int) -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int32)), pa.array([text]))


CASES = [
    Case("a long word in every row", table(lambda: columns(MANY, id=words("9" * 20_000, MANY))), "1000 characters"),
    Case("one word of 500 MB", table(lambda: columns(FEW, x_m=["9" * 500_000_000, "1"])), "at most 400 are read"),
    Case("a list of ten million", table(lambda: columns(1, x_m=[np.zeros(10_000_000)])), "holds lists"),
    Case("a billion rows", table(lambda: columns(10 * MANY), 100), "1000000000 rows of 4 columns are more than"),
    Case("columns by the thousand", table(lambda: {f"c{i}": np.zeros(1) for i in range(5000)}), "no column"),
    Case("no rows", table(lambda: columns(0)), "has no rows"),
    Case("numbers without end", table(lambda: columns(FEW, x_m=np.array([0.0, np.inf]))), "row 2: x_m is infinite"),
    Case("text where a number belongs", table(lambda: columns(FEW, x_m=["0.1", "wide"])), "x_m is 'wide'"),
]
QUICK = {"a long word in every row", "a list of ten million", "numbers without end", "text where a number belongs"}


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_parquet_table(victim: Victim, tracks: Path, case: Case) -> None:
    case.harm(tracks)
    withstood(victim.attack(["check", "rec"], tracks.parent), case)
