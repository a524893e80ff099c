"""Files of `onebend sense`."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from onebend.control.trajectory_files import header, typed, vector
from onebend.errors import ExportError
from onebend.extras import require
from onebend.learning.sensing.forces import LEVEL
from onebend.learning.sensing.sense import Sensed
from onebend.learning.sensing.sensor import SensorCheck
from onebend.records import Array
from onebend.report.sentences import worded
from onebend.results.tables import write_csv

SENSE_FORMAT = "onebend-sense-1"
BAG = "force.mcap"


def sense_summary(model: str, found: Sensed, *, written_by: str) -> dict[str, Any]:
    """`sense --json` and `summary.json`; SI."""
    fit, peak = found.misfit, found.peak
    difference = found.against_log
    return {
        "format": SENSE_FORMAT,
        "written_by": written_by,
        "model": model,
        "recording": found.name,
        "level": LEVEL,
        "place": found.settings.place,
        "force_prior_sd_N": found.prior_sd,
        "frames": len(found.time),
        "frames_touched": int(np.sum(found.touched)),
        "contacts": [
            {
                "first_frame_s": one.first,
                "last_frame_s": one.last,
                "begin_s": one.begin.time,
                "begin_sd_s": one.begin.sd,
                "end_s": one.end.time,
                "end_sd_s": one.end.sd,
            }
            for one in found.contacts
        ],
        "peak": None if peak is None else {
            "frame": int(found.frame[peak]),
            "time_s": found.time[peak],
            "force_N": found.force[peak],
            "covariance_N2": found.covariance[peak],
            "prior_share": found.prior_share[peak],
            "place_s": found.place[peak],
            "place_sd_s": found.place_sd[peak],
        },
        "misfit": None if fit is None else {
            "chi2": fit.chi2,
            "freedom": fit.freedom,
            "ratio": fit.ratio,
            "probability": fit.probability,
            "frames": fit.frames,
        },
        "against_log_rms_N": None if difference is None else {
            "known_best": difference[0],
            "known_least": difference[1],
        },
        "moment": None if found.moment is None else {
            "prior_sd_Nm": found.moment.prior_sd,
            "peak_Nm": None if peak is None else found.moment.moment[peak],
            "peak_sd_Nm": None if peak is None else found.moment.sd[peak],
            "peak_prior_share": None if peak is None else found.moment.prior_share[peak],
        },
        "smoothed": None if found.smoothed is None else {
            "memory_s": found.smoothed.memory,
            "noise_widened": found.smoothed.widened,
        },
        "sensor": None if found.sensor is None else _sensor(found.sensor),
        "remarks": [{"level": one.level, "text": one.text} for one in worded(found.remarks)],
    }  # fmt: skip


def _sensor(check: SensorCheck) -> dict[str, Any]:
    return {
        "gain": check.gain[0],
        "gain_sd": check.gain[1],
        "direction_deg": math.degrees(check.direction[0]),
        "direction_sd_deg": math.degrees(check.direction[1]),
        "delay_s": check.delay[0],
        "delay_sd_s": check.delay[1],
        "bias_N": check.bias[0],
        "bias_sd_N": check.bias[1],
        "drift_N_per_s": check.drift[0],
        "drift_sd_N_per_s": check.drift[1],
        "noise_N": check.noise,
        "frames": check.frames,
    }


def force_columns(found: Sensed) -> dict[str, Array]:
    """(T,) each: columns of `force.csv`."""
    out = {
        "frame": found.frame,
        "time_s": found.time,
        **_forces("", found.force, found.covariance),
        "fx_prior_share": found.prior_share[:, 0],
        "fy_prior_share": found.prior_share[:, 1],
        "weak_direction_deg": np.degrees(found.weak_angle),
        "weak_sd_N": found.weak_sd,
        "strong_sd_N": found.strong_sd,
        "place_s": found.place,
        "place_sd_s": found.place_sd,
        "other_place_s": found.other_place,
        "touched": found.touched,
        "chi2": found.chi2,
    }
    if found.smoothed is not None:
        out |= _forces("smooth_", found.smoothed.force, found.smoothed.covariance)
    if (moment := found.moment) is not None:
        out |= {"moment_Nm": moment.moment, "moment_sd_Nm": moment.sd, "moment_prior_share": moment.prior_share}
        out |= {f"f{axis}_moment_covariance_N2m": moment.with_force[:, i] for i, axis in enumerate("xy")}
    return out


def _forces(name: str, force: Array, covariance: Array) -> dict[str, Array]:
    numbers = [*force.T, *np.sqrt(np.einsum("tcc->tc", covariance)).T, covariance[:, 0, 1]]
    names = ("fx_N", "fy_N", "fx_sd_N", "fy_sd_N", "fx_fy_covariance_N2")
    return {f"{name}{one}": values for one, values in zip(names, numbers, strict=True)}


def write_forces(path: Path, found: Sensed) -> None:
    """One row per frame; empty cells for unknown."""
    columns = force_columns(found)
    cells = (map("{:.4g}".format if name == "chi2" else _cell, values.tolist()) for name, values in columns.items())
    write_csv(path, tuple(columns), zip(*cells, strict=True))


def _cell(value: float) -> str:
    return f"{value:.9g}" if math.isfinite(value) else ""


def write_sensed(folder: Path, found: Sensed, *, bag: bool = False) -> None:
    """`force.csv`; with `bag` also `force.mcap`."""
    write_forces(folder / "force.csv", found)
    if bag:
        (folder / BAG).write_bytes(force_bag(found.time, found.force, found.covariance))


FORCE_TOPIC, COVARIANCE_TOPIC = "/beam/force", "/beam/force_covariance"
WRENCH, NUMBERS = "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64MultiArray"
FRAME = "beam_base"  # x along the beam at rest, from its clamp
_SECOND = 10**9  # ns
_LATEST = 2**31  # s, beyond the range of stamps


def force_bag(time: Array, force: Array, covariance: Array) -> bytes:
    """A .mcap file with `force` (T, 2) [N] at `time` (T,) [s] as geometry_msgs/WrenchStamped in `/beam/force`, and
    `covariance` (T, 2, 2) [N^2] as std_msgs/Float64MultiArray in `/beam/force_covariance`. Frames without a force
    are left out; a stamp of zero becomes 1 ns. Raises `ExportError` without a force, or if a stamp cannot hold a
    time."""
    require(("rosbags",), "ros")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    known = np.isfinite(force).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    time, force, covariance = time[known], force[known], covariance[known]
    if not len(time):
        raise ExportError("no frame has a force: there is nothing to write to a bag")
    if not (np.isfinite(time).all() and time.min() >= 0.0 and time.max() < _LATEST):
        raise ExportError(
            f"a bag's stamps run from 0 to {_LATEST} s, and the recording's times from {time.min():.6g} to "
            f"{time.max():.6g} s. Put its log's clock into that range"
        )
    store = get_typestore(Stores.LATEST)
    with tempfile.TemporaryDirectory() as folder:
        inside = Path(folder) / "force"
        with Writer(inside, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            wrenches = writer.add_connection(FORCE_TOPIC, WRENCH, typestore=store)
            covariances = writer.add_connection(COVARIANCE_TOPIC, NUMBERS, typestore=store)
            for at, of_frame, spread in zip(np.maximum(time, 1.0 / _SECOND), force, covariance, strict=True):
                for connection, data in ((wrenches, _wrench(at, of_frame)), (covariances, _matrix(spread))):
                    content = store.serialize_cdr(typed(store, connection.msgtype, data), connection.msgtype)
                    writer.write(connection, round(float(at) * _SECOND), content)
        return next(inside.glob("*.mcap")).read_bytes()


def _wrench(seconds: float, force: Array) -> dict[str, Any]:
    return {
        "header": header(seconds, FRAME),
        "wrench": {"force": vector(force[0], force[1], 0.0), "torque": vector(0.0, 0.0, 0.0)},
    }


def _matrix(covariance: Array) -> dict[str, Any]:
    sides = [("row: fx_N, fy_N", 2, 4), ("column: fx_N, fy_N", 2, 2)]
    dim = [dict(zip(("label", "size", "stride"), side, strict=True)) for side in sides]
    return {"layout": {"dim": dim, "data_offset": 0}, "data": np.ascontiguousarray(covariance, dtype=float).ravel()}
