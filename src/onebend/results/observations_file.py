"""`observations.parquet`: what a recording said, so that it can be learned from again without its video.

One row a frame, one column a quantity, units in the names. What is not a table (length, rests, clock, view) stands as
JSON in the file's metadata under `onebend`; so does the force log behind its filter, with as many rows as the filter
leaves it something to say.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from onebend.errors import ResultsError
from onebend.records import (
    CURVATURE_SD,
    DIRECTION_SD,
    PLACE_SD,
    TURN_SD,
    Array,
    CleanForce,
    ClockOffset,
    ForceNoise,
    KnownLoads,
    MassLine,
    Observations,
    Remark,
    View,
)

FILE_NAME = "observations.parquet"
_KEY = b"onebend"
_VERSION = 1
_ROWS_A_PERIOD = 50  # of the cut-off: straight lines between them miss 0.2 % of what the filter passes
_VECTORS = ("tag_id", "marker_s", "force_sd", "rest_xy", "rest_angle", "rest_covariance")
_SCALARS = (
    *("name", "length", "mass", "placement_sd", "rest", "gain_sd", "static", "sd_known", "mass_sd", "clamp_sd"),
    *(
        "place_sd",
        "direction_sd",
        "turn_sd",
        "curvature_sd",
        "scale_sd",
        "load_error_sd",
        "mass_along",
        "stiffness_along",
    ),
)
_LATER: dict[str, Any] = {  # what files of earlier versions lack
    "gain_sd": 0.0,
    "clean_force": None,
    "static": False,
    "sd_known": True,
    "mass_sd": math.nan,
    "clamp_sd": math.nan,
    "place_sd": PLACE_SD,
    "direction_sd": DIRECTION_SD,
    "turn_sd": TURN_SD,
    "curvature_sd": CURVATURE_SD,
    "scale_sd": math.nan,
    "load_error_sd": math.nan,
    "known": None,
    "mass_line": None,
    "mass_along": "unknown",
    "stiffness_along": "unknown",
}


def save_observations(path: Path, observations: Observations) -> None:
    """Write everything; of the force log every row that a straight line between its neighbours would miss."""
    o = observations
    columns: dict[str, Any] = {
        "time_s": o.time,
        "frame": o.frame,
        "force_x_N": o.force[:, 0],
        "force_y_N": o.force[:, 1],
        "push_s": o.push_s,
        "loaded": o.loaded,
        "gravity_x_m_s2": o.gravity[:, 0],
        "gravity_y_m_s2": o.gravity[:, 1],
    }
    if o.held is not None:
        columns["held"] = o.held
    for i, tag in enumerate(o.tag_id):
        columns[f"tag_{tag}_x_m"] = o.xy[:, i, 0]
        columns[f"tag_{tag}_y_m"] = o.xy[:, i, 1]
        columns[f"tag_{tag}_angle_rad"] = o.angle[:, i]
        nine = np.ascontiguousarray(o.covariance[:, i]).reshape(-1)
        columns[f"tag_{tag}_covariance"] = pa.FixedSizeListArray.from_arrays(pa.array(nine), 9)
    table = pa.table(columns).replace_schema_metadata({_KEY: json.dumps(_rest_of(o)).encode()})
    pq.write_table(table, path, compression="zstd")


def load_observations(path: Path | str) -> Observations:
    """What `save_observations` wrote (a file, or the results folder that holds it).

    Raises `ResultsError` where the file is missing, damaged, or was not written by onebend.
    """
    file = Path(path)
    if file.is_dir():
        file = file / FILE_NAME
    if not file.is_file():
        raise ResultsError(f"{file}: no such file. Give a {FILE_NAME} or a folder that `onebend learn` wrote")
    try:
        table = pq.read_table(file)
        rest = _LATER | json.loads(table.schema.metadata[_KEY])
        if rest["version"] != _VERSION:
            raise ResultsError(f"{file}: version {rest['version']!r}, but this onebend reads version {_VERSION}")
        return _observations(table, rest)
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise ResultsError(
            f"{file}: damaged, or not written by onebend ({error!r}). Learn the recording again to have it anew"
        ) from error


def _rest_of(o: Observations) -> dict[str, Any]:
    """All that has no row a frame. Python's JSON keeps NaN and infinity, and floats to the last bit."""
    rest: dict[str, Any] = {name: getattr(o, name) for name in _SCALARS}
    rest |= {name: getattr(o, name).tolist() for name in _VECTORS}
    view = None if o.view is None else {k: np.asarray(v).tolist() for k, v in vars(o.view).items()}
    return rest | {
        "version": _VERSION,
        "clock": None if o.clock is None else asdict(o.clock),
        "clean_force": None if o.clean_force is None else _force_of(o.clean_force),
        "view": view,
        "known": _listed(o.known),
        "mass_line": _listed(o.mass_line),
        "video": None if o.video is None else str(o.video),
        "video_topic": o.video_topic,
        "remarks": [[r.level, r.text, *([True] if r.doubt else [])] for r in o.remarks],
    }


def _observations(table: pa.Table, rest: dict[str, Any]) -> Observations:
    def column(name: str) -> Array:
        return np.asarray(table[name].to_numpy(), dtype=float)

    def per_tag(ending: str) -> Array:
        return np.stack([column(f"tag_{tag}_{ending}") for tag in rest["tag_id"]], axis=1)

    covariance = [
        np.asarray(table[f"tag_{tag}_covariance"].combine_chunks().flatten(), dtype=float).reshape(-1, 3, 3)
        for tag in rest["tag_id"]
    ]
    vectors: dict[str, Any] = {name: np.asarray(rest[name], dtype=float) for name in _VECTORS if name != "tag_id"}
    return Observations(
        **{name: rest[name] for name in _SCALARS},
        **vectors,
        tag_id=np.asarray(rest["tag_id"], dtype=np.int64),
        time=column("time_s"),
        frame=np.asarray(table["frame"].to_numpy(), dtype=np.int64),
        xy=np.stack([per_tag("x_m"), per_tag("y_m")], axis=-1),
        angle=per_tag("angle_rad"),
        covariance=np.stack(covariance, axis=1),
        force=np.stack([column("force_x_N"), column("force_y_N")], axis=-1),
        push_s=column("push_s"),
        loaded=np.asarray(table["loaded"].to_numpy(), dtype=bool),
        gravity=np.stack([column("gravity_x_m_s2"), column("gravity_y_m_s2")], axis=-1),
        clock=None if rest["clock"] is None else ClockOffset(**rest["clock"]),
        clean_force=_clean_force(rest["clean_force"]),
        view=_view(rest["view"]),
        held=np.asarray(table["held"].to_numpy(), dtype=bool) if "held" in table.column_names else None,
        known=None if rest["known"] is None else _known(rest["known"], table.num_rows),
        mass_line=None if rest["mass_line"] is None else MassLine(*map(np.asarray, rest["mass_line"].values())),
        video=None if rest["video"] is None else Path(rest["video"]),
        video_topic=rest.get("video_topic", ""),
        remarks=tuple(Remark(*parts) for parts in rest["remarks"]),
    )


def _listed(record: KnownLoads | MassLine | None) -> dict[str, Any] | None:
    return None if record is None else {name: value.tolist() for name, value in vars(record).items()}


def _known(data: dict[str, Any], count: int) -> KnownLoads:
    """Arrays keep their shape, which a list of no loads does not show."""
    array = {name: np.asarray(data[name], dtype=float).reshape(count, -1) for name in data}
    return KnownLoads(**{**array, "force": array["force"].reshape(count, -1, 2)})


def _force_of(clean: CleanForce) -> dict[str, Any]:
    step = float(np.median(np.diff(clean.time)))
    every = max(int(1.0 / (_ROWS_A_PERIOD * clean.cutoff * step)), 1) if np.isfinite(clean.cutoff) else 1
    rows = np.unique(np.append(np.arange(0, len(clean.time), every), len(clean.time) - 1))
    return {
        "time": clean.time[rows].tolist(),
        "force": clean.force[rows].tolist(),
        "push_s": None if clean.push_s is None else clean.push_s[rows].tolist(),
        "noise_sd": clean.noise_sd.tolist(),
        "tare": clean.tare.tolist(),
        "drift": clean.drift.tolist(),
        "zero_time": clean.zero_time.tolist(),
        "zero": clean.zero.tolist(),
        "cutoff": clean.cutoff,
        "outliers": clean.outliers,
        "noise": None if clean.noise is None else asdict(clean.noise),
        "remarks": [[remark.level, remark.text] for remark in clean.remarks],
    }


def _clean_force(data: dict[str, Any] | None) -> CleanForce | None:
    if data is None:
        return None
    arrays = {name: np.asarray(data[name], dtype=float) for name in ("time", "force", "noise_sd", "tare", "drift")}
    return CleanForce(
        **arrays,
        push_s=None if data["push_s"] is None else np.asarray(data["push_s"], dtype=float),
        zero_time=np.asarray(data.get("zero_time", []), dtype=float),
        zero=np.asarray(data.get("zero", []), dtype=float).reshape(-1, 2),
        cutoff=float(data["cutoff"]),
        outliers=int(data["outliers"]),
        noise=None if data["noise"] is None else ForceNoise(**data["noise"]),
        remarks=tuple(Remark(level, text) for level, text in data["remarks"]),
    )


def _view(data: dict[str, Any] | None) -> View | None:
    if data is None:
        return None
    arrays = {name: np.asarray(data[name], dtype=float) for name in ("matrix", "dist", "rotation", "translation")}
    return View(**arrays, calibrated=bool(data["calibrated"]), corner_sd=float(data["corner_sd"]))
