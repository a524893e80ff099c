"""What `onebend sense` leaves in a folder: the force of every frame, the picture, and a summary."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.manifest import write_summary
from onebend.learning.sensing.search import LEVEL
from onebend.learning.sensing.sensed import Sensed
from onebend.learning.sensing.sensor import SensorCheck
from onebend.records import Array
from onebend.report.figures.pictures import Pictures
from onebend.results.tables import write_csv

SENSE_FORMAT = "onebend-sense-1"
BAG = "force.mcap"
FORCE_COLUMNS = (
    "frame",
    "time_s",
    "fx_N",
    "fy_N",
    "fx_sd_N",
    "fy_sd_N",
    "fx_fy_covariance_N2",
    "fx_prior_share",
    "fy_prior_share",
    "weak_direction_deg",
    "weak_sd_N",
    "strong_sd_N",
    "place_s",
    "place_sd_s",
    "other_place_s",
    "touched",
    "chi2",
)


def sense_summary(model: str, found: Sensed, *, written_by: str) -> dict[str, Any]:
    """What `onebend sense --json` prints and `summary.json` holds (there with `files`); SI."""
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
        "contacts": [{"begin_s": one.begin, "end_s": one.end} for one in found.contacts],
        "peak": None if peak is None else {
            "frame": int(found.frame[peak]),
            "time_s": float(found.time[peak]),
            "force_N": found.force[peak].tolist(),
            "covariance_N2": found.covariance[peak].tolist(),
            "prior_share": found.prior_share[peak].tolist(),
            "place_s": _number(found.place[peak]),
            "place_sd_s": _number(found.place_sd[peak]),
        },
        "misfit": None if fit is None else {
            "chi2": fit.chi2,
            "freedom": fit.freedom,
            "ratio": _number(fit.ratio),
            "probability": _number(fit.probability),
            "frames": fit.frames,
        },
        "against_log_rms_N": None if difference is None else {
            "known_best": difference[0],
            "known_least": difference[1],
        },
        "sensor": None if found.sensor is None else _sensor(found.sensor),
        "remarks": [{"level": one.level, "text": one.text} for one in found.remarks],
    }  # fmt: skip


def _sensor(check: SensorCheck) -> dict[str, Any]:
    return {
        "gain": check.gain[0],
        "gain_sd": check.gain[1],
        "direction_deg": math.degrees(check.direction[0]),
        "direction_sd_deg": math.degrees(check.direction[1]),
        "delay_s": check.delay[0],
        "delay_sd_s": check.delay[1],
        "bias_N": check.bias[0].tolist(),
        "bias_sd_N": check.bias[1].tolist(),
        "drift_N_per_s": check.drift[0].tolist(),
        "drift_sd_N_per_s": check.drift[1].tolist(),
        "noise_N": check.noise,
        "frames": check.frames,
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_forces(path: Path, found: Sensed) -> None:
    """One row a frame; empty where a frame tells nothing."""
    sd = np.sqrt(np.einsum("tcc->tc", found.covariance))
    columns: list[Array] = [found.time, *found.force.T, *sd.T, found.covariance[:, 0, 1], *found.prior_share.T]
    columns += [np.degrees(found.weak_angle), found.weak_sd, found.strong_sd]
    columns += [found.place, found.place_sd, found.other_place]
    rows = (
        [int(frame), *(f"{x:.9g}" if math.isfinite(x) else "" for x in row), int(touched), f"{misfit:.4g}"]
        for frame, row, touched, misfit in zip(
            found.frame, np.column_stack(columns), found.touched, found.chi2, strict=True
        )
    )
    write_csv(path, FORCE_COLUMNS, rows)


def sense_writer(
    found: Sensed, pictures: Pictures, summary: Mapping[str, Any], bag: bytes | None = None
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder, with the content of `force.mcap` where there is one."""

    def write(folder: Path) -> None:
        write_forces(folder / "force.csv", found)
        pictures.write(folder)
        if bag is not None:
            (folder / BAG).write_bytes(bag)
        write_summary(folder, summary)

    return write
