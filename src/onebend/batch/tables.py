"""The tables of a batch as Parquet: a row a recording, a row a place of a curve, a row a nuisance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from onebend.batch.outcome import BatchOutcome
from onebend.batch.record import EVERY, PLACES, Record
from onebend.errors import RecordingError
from onebend.escaping import is_number
from onebend.text_files import quoted

LENGTH = "length_m"  # of the list, states the beam's; the table has it as it was learned with
AT = (0, 25, 50, 75, 100)  # of PLACES: where the table of recordings has k


def recordings_table(outcome: BatchOutcome) -> pa.Table:
    """A row a recording: its name, group and the list's own columns; k at five places with its band; the verdict.

    Raises:
        RecordingError: a column of the list has the name of one of ours.
    """
    ours = _columns(outcome)
    labels = _labels(outcome)
    both = [name for name in labels if name in ours]
    if both:
        raise RecordingError(f"the list's column {quoted(both[0])} is one of the results'. Rename it.")
    first = {name: ours.pop(name) for name in ("name", "group")}
    return pa.table(first | labels | ours)


def curves_table(outcome: BatchOutcome) -> pa.Table:
    """A row a recording and place: `name, s, k_N_m, k_lo_N_m, k_hi_N_m, identified`, at 101 places."""
    there = [(item.name, one) for item, one in zip(outcome.items, outcome.records, strict=True) if one.k is not None]

    def joined(name: str, kind: type) -> np.ndarray:
        return np.concatenate([np.zeros(0, kind), *(getattr(one, name) for _, one in there)]).astype(kind)

    return pa.table(
        {
            "name": pa.array([name for name, _ in there for _ in PLACES], pa.string()),
            "s": np.tile(PLACES, len(there)),
            "k_N_m": joined("k", float),
            "k_lo_N_m": joined("low", float),
            "k_hi_N_m": joined("high", float),
            "identified": joined("identified", bool),
        }
    )


def covariances_table(outcome: BatchOutcome) -> pa.Table:
    """A row a recording and place: `name, s`, and the covariance of log k there with that at each of 21 places,
    `with_0` to `with_1`, and the part of it that comes from the prior, `prior_with_0` to `prior_with_1`; what the force
    sensor's scale does to all of k is apart (`gain_sd`).
    """
    there = [(item.name, one) for item, one in zip(outcome.items, outcome.records, strict=True) if one.k is not None]
    places = PLACES[::EVERY]
    columns: dict[str, Any] = {
        "name": pa.array([name for name, _ in there for _ in places], pa.string()),
        "s": np.tile(places, len(there)),
    }
    for head, field in (("with", "covariance"), ("prior_with", "prior_part")):
        rows = np.concatenate([np.zeros((0, len(places))), *(getattr(one, field) for _, one in there)])
        columns |= {f"{head}_{s:.3g}": rows[:, i] for i, s in enumerate(places)}
    return pa.table(columns)


def nuisances_table(outcome: BatchOutcome) -> pa.Table:
    """A row a recording and nuisance: `name, nuisance, unit, value, sd, prior_sd`."""
    rows = [
        (item.name, *values)
        for item, one in zip(outcome.items, outcome.records, strict=True)
        for values in one.nuisances
    ]
    columns = list(zip(*rows, strict=True)) if rows else [()] * 6
    kinds = (pa.string(), pa.string(), pa.string(), pa.float64(), pa.float64(), pa.float64())
    names = ("name", "nuisance", "unit", "value", "sd", "prior_sd")
    return pa.table({name: pa.array(values, kind) for name, values, kind in zip(names, columns, kinds, strict=True)})


def _columns(outcome: BatchOutcome) -> dict[str, Any]:
    records, text = outcome.records, pa.string()
    found: dict[str, Any] = {
        "name": pa.array([item.name for item in outcome.items], text),
        "group": pa.array([item.group for item in outcome.items], text),
        "reason": pa.array([one.reason for one in records], text),
        "grade": pa.array([one.grade for one in records], text),
        "doubts": pa.array(["; ".join(one.doubts) for one in records], text),
        "warnings": pa.array(["; ".join(one.warnings) for one in records], text),
        LENGTH: np.array([one.length for one in records]),
    }
    for i in AT:
        for name, field in (("k", "k"), ("k_lo", "low"), ("k_hi", "high")):
            found[f"{name}_at_{PLACES[i]:g}_N_m"] = np.array([_at(one, field, i) for one in records])
    return found | {
        "identified": np.array([np.nan if one.identified is None else one.identified.mean() for one in records]),
        "gain_sd": np.array([one.gain_sd for one in records]),
        "error_m": np.array([one.error for one in records]),
        "level_z": outcome.scores.level,
        "shape_z": outcome.scores.shape,
        "outlier": pa.array(outcome.scores.reasons, text),
        "frames": np.array([one.frames for one in records], dtype=np.int64),
        "seconds": np.array([one.seconds for one in records]),
        "finished": pa.array([one.finished for one in records], text),
        "hash": pa.array([one.hash for one in records], text),
        "path": pa.array([str(item.folder) for item in outcome.items], text),
    }


def _at(record: Record, field: str, i: int) -> float:
    curve = getattr(record, field)
    return float("nan") if curve is None else float(curve[i])


def _labels(outcome: BatchOutcome) -> dict[str, pa.Array]:
    """The list's own columns: numbers where every cell is one or empty, else text."""
    rows: Sequence[Mapping[str, str]] = [dict(item.labels) for item in outcome.items]
    names = rows[0] if rows else ()
    return {name: _column([row.get(name, "") for row in rows]) for name in names if name != LENGTH}


def _column(cells: Sequence[str]) -> pa.Array:
    filled = [cell for cell in cells if cell]
    if filled and all(is_number(cell) for cell in filled):
        return pa.array([float(cell) if cell else float("nan") for cell in cells], pa.float64())
    return pa.array(cells, pa.string())
