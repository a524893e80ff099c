"""`observations.parquet`: observations for learning without the video. One row per frame, one column per quantity;
other fields and the thinned force log as JSON in the metadata under `onebend`."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from onebend.errors import ResultsError
from onebend.files.publish import SUMMARY, is_listed_otherwise
from onebend.record_data import fields_from, to_data
from onebend.records import Array, CleanForce, Observations

FILE_NAME = "observations.parquet"
_KEY = b"onebend"
_VERSION = 6
_ROWS_A_PERIOD = 50  # of the cut-off: linear interpolation is then accurate to 0.2 %
# Fields with one row per frame.
_COLUMNS = {
    "time": ("time_s",),
    "frame": ("frame",),
    "force": ("force_x_N", "force_y_N"),
    "push_s": ("push_s",),
    "loaded": ("loaded",),
    "gravity": ("gravity_x_m_s2", "gravity_y_m_s2"),
}
_TAG_COLUMNS = {"xy": ("x_m", "y_m"), "angle": ("angle_rad",)}  # per tag, after `tag_ID_`
_COVARIANCE = "covariance"  # (3, 3) per tag, nine values per row


def save_observations(path: Path, observations: Observations) -> None:
    """The force log without rows that linear interpolation reproduces."""
    o = observations
    clean = o.source.clean_force
    if clean is not None:
        o = replace(o, source=replace(o.source, clean_force=_thinned(clean)))
    columns: dict[str, Any] = {}
    for field, names in _COLUMNS.items():
        columns |= _components(getattr(o, field), names)
    for i, tag in enumerate(o.tag_id):
        for field, endings in _TAG_COLUMNS.items():
            columns |= _components(getattr(o, field)[:, i], tuple(f"tag_{tag}_{ending}" for ending in endings))
        nine = np.ascontiguousarray(o.covariance[:, i]).reshape(-1)
        columns[f"tag_{tag}_{_COVARIANCE}"] = pa.FixedSizeListArray.from_arrays(pa.array(nine), 9)
    metadata = {"version": _VERSION, "fields": to_data(o, leave_out=_tabled())}
    table = pa.table(columns).replace_schema_metadata({_KEY: json.dumps(metadata).encode()})
    pq.write_table(table, path, compression="zstd")


def load_observations(path: Path | str) -> Observations:
    """From a file or results folder. Warns if the summary lists another checksum. Raises `ResultsError` if it is
    missing, damaged, of another version, or not by onebend."""
    file = Path(path)
    if file.is_dir():
        file = file / FILE_NAME
    if not file.is_file():
        raise ResultsError(f"{file}: no such file. Give a {FILE_NAME} or a folder that `onebend learn` wrote")
    if is_listed_otherwise(file):
        words = f"is not the file that the run of this folder wrote ({SUMMARY} lists another checksum)"
        warnings.warn(f"{file}: {words}", UserWarning, stacklevel=2)
    try:
        table = pq.read_table(file)
        metadata = json.loads(table.schema.metadata[_KEY])
        if metadata["version"] != _VERSION:
            raise ResultsError(
                f"{file}: version {metadata['version']!r}, but this onebend reads version {_VERSION}. Learn the "
                "recording again to have it anew"
            )
        return _observations(table, metadata["fields"])
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ResultsError(
            f"{file}: damaged, or not written by onebend ({error!r}). Learn the recording again to have it anew"
        ) from error


def observations_beside(model: Path) -> tuple[Observations, ...]:
    """The observations behind `model`, as far as they lie beside it."""
    found = []
    for path in sorted((model if model.is_dir() else model.parent).glob("observations*.parquet")):
        try:
            found.append(load_observations(path))
        except ResultsError:
            continue  # damaged: not listed
    return tuple(found)


def _tabled() -> set[str]:
    return {*_COLUMNS, *_TAG_COLUMNS, _COVARIANCE}


def _components(values: Array, names: tuple[str, ...]) -> dict[str, Array]:
    """Columns of a (T,) or (T, components) array."""
    return dict(zip(names, values.reshape(len(values), len(names)).T, strict=True))


def _observations(table: pa.Table, data: dict[str, Any]) -> Observations:
    given = fields_from(Observations, data, leave_out=_tabled())

    def joined(names: tuple[str, ...]) -> Array:
        parts = [np.array(table[name].to_numpy()) for name in names]
        return parts[0] if len(parts) == 1 else np.stack(parts, axis=-1)

    def per_tag(endings: tuple[str, ...]) -> Array:
        return np.stack([joined(tuple(f"tag_{tag}_{ending}" for ending in endings)) for tag in given["tag_id"]], axis=1)

    covariance = [
        np.array(table[f"tag_{tag}_{_COVARIANCE}"].combine_chunks().flatten()).reshape(-1, 3, 3)
        for tag in given["tag_id"]
    ]
    given |= {field: joined(names) for field, names in _COLUMNS.items()}
    given |= {field: per_tag(endings) for field, endings in _TAG_COLUMNS.items()}
    given[_COVARIANCE] = np.stack(covariance, axis=1)
    return Observations(**given)


def _thinned(clean: CleanForce) -> CleanForce:
    """As many rows as the filter's bandwidth needs."""
    step = float(np.median(np.diff(clean.time)))
    every = max(int(1.0 / (_ROWS_A_PERIOD * clean.cutoff * step)), 1) if np.isfinite(clean.cutoff) else 1
    rows = np.unique(np.append(np.arange(0, len(clean.time), every), len(clean.time) - 1))
    push_s = None if clean.push_s is None else clean.push_s[rows]
    return replace(clean, time=clean.time[rows], force=clean.force[rows], push_s=push_s)
