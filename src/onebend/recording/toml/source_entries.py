# ruff: noqa: RUF009  (key() returns a dataclass field, which is what a default may be)
"""What shows the beam, in `recording.toml`: a film and its camera, or tracked markers, bench poses, photos."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from onebend.recording.toml.schema import flag, key, number, one_of, several, text, whole

LONGEST_DOUBT = 1e5  # s: whose start is known to a day is not known
Axes = Literal["beam", "room"]
Damaged = Literal["refuse", "keep"]


def message_definitions() -> Any:
    """The key `definitions`, where the file may be a bag."""
    says = "a folder with .msg files, for a bag without them"
    return key("definitions", text, says, example='"msgs"', default=None)


def damaged_bag() -> Any:
    """The key `damaged`, where the file may be a bag."""
    says = 'whether a damaged bag is refused ("refuse") or used up to the damage ("keep")'
    return key("damaged", one_of("refuse", "keep"), says, example='"refuse"', default="refuse")


def load_sd() -> Any:
    """The key `load_sd_N`, where loads are weighed."""
    says = "how exactly the loads are known (one sd), N"
    return key("load_sd_N", number(least=0), says, example="0.001", default=0.0)


def clamp_sd(default: float) -> Any:
    """The key `clamp_sd_deg`, kept in rad, where nothing shows the clamp's direction but the pose itself."""
    says = "how exactly the clamp's angle is known (one sd), degrees"
    return key("clamp_sd_deg", number(least=0, scale=math.pi / 180), says, example="1.0", default=default)


def clamp_turn_sd() -> Any:
    """The key `clamp_sd_deg`, kept in rad, where the beam is seen at rest; NaN: as usual."""
    says = "how far the clamp may be turned against the beam at rest (one standard deviation), degrees; 0: not at all"
    return key("clamp_sd_deg", number(least=0, scale=math.pi / 180), says, example="0.17", default=math.nan)


def scale_sd() -> Any:
    """The key `scale_sd`; NaN: as usual."""
    says = "how far off lengths in the picture may be (one standard deviation, 0.003 = 0.3 %); 0: exact"
    return key("scale_sd", number(least=0), says, example="0.003", default=math.nan)


@dataclass(frozen=True)
class CameraEntry:
    """[camera]: a pinhole camera with OpenCV's lens model, as calibrated."""

    width: int = key("width", whole(least=1), "the picture's width in the calibration, px", example="1280")
    height: int = key("height", whole(least=1), "the picture's height in the calibration, px", example="720")
    fx: float = key("fx", number(least=10), "the focal length along x, px", example="1200.0")
    fy: float = key("fy", number(least=10), "the focal length along y, px", example="1200.0")
    cx: float = key("cx", number(), "the principal point's x, px (pixel centres at whole numbers)", example="639.5")
    cy: float = key("cy", number(), "the principal point's y, px (pixel centres at whole numbers)", example="359.5")
    dist: tuple[float, ...] = key(
        "dist",
        several(number(), 4, 5),
        "the lens: k1, k2, p1, p2 and, if known, k3, as OpenCV calibrates it",
        example="[0.0, 0.0, 0.0, 0.0]",
    )
    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class UncalibratedEntry:
    """[camera] where it says of the pictures' scale alone, and holds no calibration."""

    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class CameraInfoEntry:
    """[camera] where the film's bag holds the calibration."""

    topic: str = key(
        "camera_info",
        text,
        "instead of all these but scale_sd: the topic of the calibration in the bag of [video]",
        example='"/camera/camera_info"',
        default="",
    )
    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class VideoEntry:
    """[video]: the film and its clock."""

    file: Path = key("file", text, "the video file or a bag, relative to this folder", example='"video.mp4"')
    fps: float = key(
        "fps", number(above=0), "the frame rate, only checked against the file's own", example="30", default=math.nan
    )
    frame_times: Path | Literal["container"] = key(
        "frame_times",
        text,
        '"container" for the times in the video file, or a CSV file with a column time_s, one row a frame',
        example='"container"',
        default="container",
    )
    topic: str = key("topic", text, "the image topic, where file is a bag", example='"/camera/image_raw"', default="")
    definitions: Path | None = message_definitions()
    damaged: Damaged = damaged_bag()
    start: float = key(
        "start_s", number(), "the time of the first frame on the force log's clock, s", example="0.0", default=math.nan
    )
    start_uncertainty: float = key(
        "start_uncertainty_s",
        number(least=0, most=LONGEST_DOUBT),
        "how far off start_s may be (its largest error), s; 0: exact, nothing is looked for",
        example="2.0",
        default=2.0,
    )  # s; infinity where start_s is not given
    clamp_sd: float = clamp_turn_sd()  # rad


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
        number(least=0, most=LONGEST_DOUBT),
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
    clamp_sd: float = clamp_turn_sd()  # rad


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
        "a table with columns pose, s and any of weight_N, mass_kg, fx_N, fy_N, moment_N_m, clamp_deg, "
        "turned_from_deg, order; one row a load",
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
    along_sd: float = key(
        "along_sd_m",
        number(above=0),
        "the same along the beam, where it is not sd_m",
        example="0.002",
        default=math.nan,
    )
    across_sd: float = key(
        "across_sd_m",
        number(above=0),
        "the same across the beam, where it is not sd_m",
        example="0.0005",
        default=math.nan,
    )
    error_length: float = key(
        "error_length_m",
        number(least=0),
        "the way along the beam over which the points' errors are alike (half of their correlation is left), m; 0: "
        "each point has its own",
        example="0.1",
        default=0.0,
    )
    read_at: Literal["mark", "x"] = key(
        "read_at",
        one_of("mark", "x"),
        'where y_m is read: at the "mark" on the beam, wherever it goes, or "x": a ruler or gauge stands at x_m, and '
        "the beam slides along beneath it",
        example='"x"',
        default="mark",
    )
    relative_to: str = key(
        "relative_to",
        text,
        "the pose in which the gauges were zeroed, by its name in the table of loads: all readings count from there",
        example='"bare"',
        default="",
    )
    load_sd: float = load_sd()
    clamp_sd: float = clamp_sd(math.radians(0.2))  # rad


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
    load_sd: float = load_sd()
    clamp_sd: float = clamp_sd(math.nan)  # rad
