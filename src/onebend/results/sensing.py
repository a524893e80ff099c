"""Files of `onebend sense`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.publish import headed
from onebend.learning.sensing.forces import LEVEL
from onebend.learning.sensing.sense import Sensed
from onebend.learning.sensing.sensor import SensorCheck
from onebend.records import Array
from onebend.report.sentences import worded
from onebend.results.tables import write_columns

SENSE_FORMAT = "onebend-sense-1"


def sense_summary(model: str, found: Sensed) -> dict[str, Any]:
    """`sense --json` and `summary.json`; SI."""
    fit, peak = found.misfit, found.peak
    difference = found.against_log
    return headed(SENSE_FORMAT, model=model) | {
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
        "sensor": None if found.sensor is None else _sensor(found.sensor),
        "remarks": [{"level": one.level, "text": one.text} for one in worded(found.remarks)],
    }  # fmt: skip


def _sensor(check: SensorCheck) -> dict[str, Any]:
    said: dict[str, Any] = {}
    units = {"gain": "", "direction": "_deg", "delay": "_s", "bias": "_N", "drift": "_N_per_s"}
    for name, unit in units.items():
        values = getattr(check, name)
        values = map(math.degrees, values) if unit == "_deg" else values
        said |= dict(zip((f"{name}{unit}", f"{name}_sd{unit}"), values, strict=True))
    return said | {"noise_N": check.noise, "frames": check.frames}


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
    if (moment := found.moment) is not None:
        out |= {"moment_Nm": moment.moment, "moment_sd_Nm": moment.sd, "moment_prior_share": moment.prior_share}
        out |= {f"f{axis}_moment_covariance_N2m": moment.with_force[:, i] for i, axis in enumerate("xy")}
    return out


def _forces(name: str, force: Array, covariance: Array) -> dict[str, Array]:
    numbers = [*force.T, *np.sqrt(np.einsum("tcc->tc", covariance)).T, covariance[:, 0, 1]]
    names = ("fx_N", "fy_N", "fx_sd_N", "fy_sd_N", "fx_fy_covariance_N2")
    return {f"{name}{one}": values for one, values in zip(names, numbers, strict=True)}


def write_forces(folder: Path, found: Sensed) -> None:
    """`force.csv`: one row per frame; empty cells for unknown."""
    write_columns(folder / "force.csv", force_columns(found))
