# ruff: noqa: RUF009  (key() returns a dataclass field, which is what a default may be)
"""What stands in `recording.toml` in place of a film: tracked markers, bench poses, photos."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from onebend.recording.schema import flag, key, number, one_of, several, text

Axes = Literal["beam", "room"]


@dataclass(frozen=True)
class MarkersEntry:
    """[markers]: where a tracker saw the markers, and its clock."""

    file: Path = key(
        "file",
        text,
        "a CSV or Parquet table with columns time_s, id, x_m, y_m and, where known, z_m, angle_rad, sd_m",
        example='"markers.csv"',
    )
    start: float = key(
        "start_s",
        number(),
        "what to add to the tracker's time to get the force log's, s",
        example="0.0",
        default=math.nan,
    )
    start_uncertainty: float = key(
        "start_uncertainty_s",
        number(least=0),
        "how far off start_s may be (its largest error), s; 0: one clock for both",
        example="0.0",
        default=2.0,
    )  # s; infinity where start_s is not given
    sd: float = key(
        "sd_m",
        number(above=0),
        "the noise of a coordinate (one sd) where the table has no column sd_m, m; else taken from the tracks",
        example="0.0001",
        default=math.nan,
    )
    clamp: tuple[float, ...] = key(
        "clamp_m",
        several(number(), 2, 3),
        "the clamp's place in the tracker's axes, m; else from the base markers or the beam at rest",
        example="[0.0, 0.0]",
        default=(),
    )
    x_axis: tuple[float, ...] = key(
        "x_axis",
        several(number(), 2, 3),
        "the beam's direction at the clamp in the tracker's axes; else from the base markers' angle or the rest",
        example="[1.0, 0.0]",
        default=(),
    )
    seen_from: tuple[float, ...] = key(
        "seen_from",
        several(number(), 3),
        "from which side one looks at the plane of bending, in the tracker's axes (3-D tracks)",
        example="[0.0, 0.0, 1.0]",
        default=(0.0, 0.0, 1.0),
    )


@dataclass(frozen=True)
class PosesEntry:
    """[poses]: static poses measured by hand, and what loaded the beam in each."""

    file: Path = key(
        "file",
        text,
        "a CSV or Parquet table with columns pose, id, y_m and, where known, x_m, angle_deg, sd_m; one row a point",
        example='"poses.csv"',
    )
    loads: Path = key(
        "loads",
        text,
        "a table with columns pose, s and any of weight_N, mass_kg, fx_N, fy_N, moment_N_m, clamp_deg; one row a load",
        example='"loads.csv"',
    )
    axes: Axes = key(
        "axes",
        one_of("beam", "room"),
        'the axes of points and forces: "beam" (x along it at the clamp) or "room" (x horizontal, y up); both from '
        "the clamp",
        example='"room"',
        default="beam",
    )
    sd: float = key(
        "sd_m",
        number(above=0),
        "how exactly a point was measured (one sd), m; else estimated from the fit",
        example="0.001",
        default=math.nan,
    )
    load_sd: float = key(
        "load_sd_N", number(least=0), "how exactly the loads are known (one sd), N", example="0.001", default=0.0
    )
    clamp_sd: float = key(
        "clamp_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how exactly the clamp's angle is known (one sd), degrees",
        example="1.0",
        default=math.radians(0.2),
    )  # rad


@dataclass(frozen=True)
class PhotosEntry:
    """[photos]: stills of the tags, one a static pose, and what loaded the beam in each."""

    folder: Path = key("folder", text, "the folder with the pictures, relative to this one", example='"photos"')
    loads: Path = key(
        "loads",
        text,
        "a table as for [poses], whose column pose holds the pictures' file names",
        example='"loads.csv"',
    )
    axes: Axes = key(
        "axes",
        one_of("beam", "room"),
        'the axes of the forces: "beam" (x along it at the clamp) or "room" (x horizontal, y up)',
        example='"room"',
        default="beam",
    )
    camera_moves: bool = key(
        "camera_moves", flag, "whether the camera was moved between the pictures", example="false", default=False
    )
    load_sd: float = key(
        "load_sd_N", number(least=0), "how exactly the loads are known (one sd), N", example="0.001", default=0.0
    )
    clamp_sd: float = key(
        "clamp_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how exactly the clamp's angle is known (one sd), degrees",
        example="1.0",
        default=math.nan,
    )  # rad
