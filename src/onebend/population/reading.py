"""The results of a batch as a trial: which recordings are of which object and group, and log k(s) with covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from onebend.errors import ResultsError
from onebend.population.objects import PopulationTrial
from onebend.records import Array
from onebend.text_files import quoted

TABLES = ("recordings", "curves", "covariances")
FEWEST = 2  # objects of at least one group, for any spread within groups
OURS = ("reason", "grade", "doubts", "warnings", "outlier", "hash", "path", "finished")


@dataclass(frozen=True)
class Named:
    """A trial with the names of what is in it."""

    trial: PopulationTrial
    recordings: tuple[str, ...]  # R
    objects: tuple[str, ...]  # O
    groups: tuple[str, ...]  # G
    identified: Array  # (G, S) share of the recordings whose data tell k there
    left_out: tuple[tuple[str, str], ...]  # recordings that are not in it, with the reason


def read_batch(folder: Path, by: str, same: str | None = None) -> Named:
    """The recordings that were learned and are not in doubt as a whole.

    Args:
        by: column of recordings.parquet that names the group.
        same: column that names the object; None: every recording is of an object of its own.

    Raises:
        ResultsError: the folder is not of a batch, a column is not there, an object stands in two groups, or there are
            too few objects.
    """
    tables = {name: _table(folder, name) for name in TABLES}
    rows = tables["recordings"].to_pylist()
    used, left_out = _used(rows, [_column(folder, rows, one) for one in (by, same) if one is not None])
    groups_of = {_text(row[same]) if same else row["name"]: _text(row[by]) for row in used}
    for row in used:
        name = _text(row[same]) if same else row["name"]
        if groups_of[name] != _text(row[by]):
            raise ResultsError(
                f"{folder}: the object {quoted(name)} is in the groups {quoted(groups_of[name])} and "
                f"{quoted(_text(row[by]))}. Name its recordings apart, or choose another --by"
            )
    objects, groups = tuple(groups_of), tuple(sorted(set(groups_of.values())))
    if len(objects) < len(groups) + FEWEST - 1:
        raise ResultsError(
            f"{folder}: {len(objects)} objects in {len(groups)} groups tell nothing of the spread within groups. "
            "Give some group two objects or more, or choose another --by"
        )
    s, log_k, covariance, prior, identified = _curves(folder, tables, [row["name"] for row in used])
    number, place = ({name: i for i, name in enumerate(names)} for names in (objects, groups))
    object_of = np.array([number[_text(row[same]) if same else row["name"]] for row in used])
    group_of = np.array([place[one] for one in groups_of.values()])
    common = max((float(row["gain_sd"]) for row in used), default=0.0)
    alike, shares = (
        np.array([one[group_of[object_of] == i].mean(axis=0) for i in range(len(groups))])
        for one in (prior, identified)
    )
    trial = PopulationTrial(s, log_k, _not_negative(covariance - prior), object_of, group_of, alike, common)
    return Named(trial, tuple(row["name"] for row in used), objects, groups, shares, left_out)


def _not_negative(matrices: Array) -> Array:
    """The matrices with eigenvalues below zero at zero: rounding, and what else the parts of a covariance share."""
    values, vectors = np.linalg.eigh(0.5 * (matrices + np.swapaxes(matrices, -1, -2)))
    return np.asarray((vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def _table(folder: Path, name: str) -> pa.Table:
    path = folder / f"{name}.parquet"
    try:
        return pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise ResultsError(
            f"{path}: no table of a batch ({type(error).__name__}). Name what onebend batch wrote, or run it again"
        ) from error


def _column(folder: Path, rows: Sequence[Mapping[str, Any]], name: str) -> str:
    known = [one for one in (rows[0] if rows else ()) if one not in OURS]
    if name not in known:
        raise ResultsError(
            f"{folder}: the recordings have no column {quoted(name)}. There are {', '.join(known)}; the columns of the "
            "batch's list are among them"
        )
    return name


def _used(
    rows: Sequence[Mapping[str, Any]], needed: Sequence[str]
) -> tuple[list[Mapping[str, Any]], tuple[tuple[str, str], ...]]:
    used, out = [], []
    for row in rows:
        empty = [name for name in needed if not _text(row[name]) and len({_text(one[name]) for one in rows}) > 1]
        why = row["reason"] or row["doubts"] or (f"no {empty[0]} is stated" if empty else "")
        if why:
            out.append((str(row["name"]), str(why)))
        else:
            used.append(row)
    return used, tuple(out)


def _text(cell: Any) -> str:
    """A group's or object's name; a number as people write it."""
    if isinstance(cell, float):
        return "" if np.isnan(cell) else f"{cell:g}"
    return "" if cell is None else str(cell)


def _curves(folder: Path, tables: Mapping[str, pa.Table], names: Sequence[str]) -> tuple[Array, ...]:
    table = tables["covariances"]
    columns = [name for name in table.column_names if name.startswith("with_")]
    count = len(columns)
    order = {name: i for i, name in enumerate(dict.fromkeys(table["name"].to_pylist()))}
    lacking = [name for name in names if name not in order]
    if lacking or not names or len(table) != count * len(order):
        raise ResultsError(f"{folder}: the tables do not belong together. Run `onebend batch` again")
    rows = [order[name] for name in names]
    covariance, prior = (
        np.stack([table[f"{head}{name}"].to_numpy() for name in columns], axis=1).reshape(-1, count, count)[rows]
        for head in ("", "prior_")
    )
    s = table["s"].to_numpy()[:count]
    curves = tables["curves"]
    places = curves["s"].to_numpy().reshape(len(order), -1)[0]
    at = [int(np.argmin(np.abs(places - one))) for one in s]
    log_k = np.log(curves["k_N_m"].to_numpy()).reshape(len(order), -1)[rows][:, at]
    identified = np.array(curves["identified"].to_pylist(), dtype=float).reshape(len(order), -1)[rows][:, at]
    return np.asarray(s), log_k, covariance, prior, identified
