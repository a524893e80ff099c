"""What `onebend sense` leaves in a folder: the force of every frame, the picture, and a summary."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.manifest import write_summary
from onebend.learning.sensing.search import LEVEL
from onebend.learning.sensing.sensed import Sensed, Touch
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
SMOOTH_COLUMNS = ("smooth_fx_N", "smooth_fy_N", "smooth_fx_sd_N", "smooth_fy_sd_N", "smooth_fx_fy_covariance_N2")
MOMENT_COLUMNS = (
    "moment_Nm",
    "moment_sd_Nm",
    "moment_prior_share",
    "fx_moment_covariance_N2m",
    "fy_moment_covariance_N2m",
)
SECOND_COLUMNS = (
    "second_fx_N",
    "second_fy_N",
    "second_fx_sd_N",
    "second_fy_sd_N",
    "second_fx_fy_covariance_N2",
    "second_fx_prior_share",
    "second_fy_prior_share",
    "second_touched",
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
        "contacts": [_contact(one) for one in found.contacts],
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
        "moment": None if found.moment is None else {
            "prior_sd_Nm": found.moment.prior_sd,
            "peak_Nm": None if peak is None else _number(found.moment.moment[peak]),
            "peak_sd_Nm": None if peak is None else _number(found.moment.sd[peak]),
            "peak_prior_share": None if peak is None else _number(found.moment.prior_share[peak]),
        },
        "two_contacts": None if found.two is None else _two(found),
        "smoothed": None if found.smoothed is None else {
            "memory_s": _number(found.smoothed.memory),
            "noise_widened": found.smoothed.widened,
        },
        "sensor": None if found.sensor is None else _sensor(found.sensor),
        "remarks": [{"level": one.level, "text": one.text} for one in found.remarks],
    }  # fmt: skip


def _two(found: Sensed) -> dict[str, Any]:
    two, second = found.two, found.second
    assert two is not None
    return {
        "log_evidence_against_one": two.evidence,
        "told": second is not None,
        "likeliest_places_s": list(two.places),
        "place_sds_s": list(two.place_sds),
        "other_places_s": [list(pair) for pair in two.others],
        "second_place_s": None if second is None else _number(second.place),
        "frames_second_touched": None if second is None else int(np.sum(second.touched)),
    }


def _contact(one: Touch) -> dict[str, Any]:
    return {
        "first_frame_s": one.first,
        "last_frame_s": one.last,
        "begin_s": _number(one.begin.time),
        "begin_sd_s": _number(one.begin.sd),
        "end_s": _number(one.end.time),
        "end_sd_s": _number(one.end.sd),
    }


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


def force_columns(found: Sensed) -> tuple[str, ...]:
    """Of `force.csv`: those of every recording, and those that were asked for."""
    asked = (
        (SMOOTH_COLUMNS, found.smoothed is not None),
        (MOMENT_COLUMNS, found.moment is not None),
        (SECOND_COLUMNS, found.second is not None),
    )
    return sum((names for names, there in asked if there), FORCE_COLUMNS)


def write_forces(path: Path, found: Sensed) -> None:
    """One row a frame; empty where a frame tells nothing."""
    columns: list[Array] = [found.time, *_forces(found.force, found.covariance), *found.prior_share.T]
    columns += [np.degrees(found.weak_angle), found.weak_sd, found.strong_sd]
    columns += [found.place, found.place_sd, found.other_place]
    more: list[Array] = []
    if found.smoothed is not None:
        more += _forces(found.smoothed.force, found.smoothed.covariance)
    if found.moment is not None:
        moment = found.moment
        more += [moment.moment, moment.sd, moment.prior_share, *moment.with_force.T]
    if found.second is not None:
        second = found.second
        more += [*_forces(second.force, second.covariance), *second.prior_share.T, second.touched.astype(float)]
    added = np.column_stack(more) if more else np.zeros((len(found.time), 0))
    rows = (
        [int(frame), *map(_cell, row), int(touched), f"{misfit:.4g}", *map(_cell, extra)]
        for frame, row, touched, misfit, extra in zip(
            found.frame, np.column_stack(columns), found.touched, found.chi2, added, strict=True
        )
    )
    write_csv(path, force_columns(found), rows)


def _forces(force: Array, covariance: Array) -> list[Array]:
    """Both components, their sds and their covariance."""
    return [*force.T, *np.sqrt(np.einsum("tcc->tc", covariance)).T, covariance[:, 0, 1]]


def _cell(value: float) -> str:
    return f"{value:.9g}" if math.isfinite(value) else ""


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
