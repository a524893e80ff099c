"""What `onebend shape` and `onebend path` leave in a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.control.path.follow import FollowedPath
from onebend.control.path.path_spread import PathSpread
from onebend.control.path.trajectory_files import write_bag, write_samples, write_yaml
from onebend.control.shape.shape import ShapeResult
from onebend.files.manifest import write_summary
from onebend.report.figures.pictures import Pictures
from onebend.results.tables import write_csv

SHAPE_FORMAT = "onebend-shape-1"
PATH_FORMAT = "onebend-path-1"
TARGET_ROWS = (
    "s",
    "wanted_x_m",
    "wanted_y_m",
    "wanted_angle_rad",
    "x_m",
    "y_m",
    "angle_rad",
    "sd_x_m",
    "sd_y_m",
    "sd_angle_rad",
)
SHAPE_ROWS = ("s", "x_m", "y_m", "angle_rad")


def shape_summary(model: str, result: ShapeResult, *, written_by: str) -> dict[str, Any]:
    """What `onebend shape --json` prints and `summary.json` holds (there with `files`); SI and radians."""
    actuators, spread = result.state.actuators, result.spread
    held = actuators.grip is not None
    return {
        "format": SHAPE_FORMAT,
        "written_by": written_by,
        "model": model,
        "push_s": [pusher.at_s for pusher in actuators.pushes],
        "force_N": result.forces,
        "gripper_pose": dict(zip(("x_m", "y_m", "angle_rad"), result.pose, strict=True)) if held else None,
        "gripper_wrench": result.wrench,
        "rms_m": result.rms,
        "target_error_m": result.xy_error,
        "target_error_rad": result.angle_error,
        "predicted_sd_m": None if spread is None else spread.xy,
        "predicted_sd_rad": None if spread is None else spread.angle,
        "predicted_sd_wrench": None if spread is None else spread.wrench,
        "margin": result.margin,
        "load_left": result.load_left,
        "limits": result.limits,
        "open_freedoms": result.open_freedoms,
        "converged": result.converged,
        "starts": result.starts,
        "warnings": result.warnings,
    }


def shape_writer(result: ShapeResult, pictures: Pictures, summary: Mapping[str, Any]) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder with a shape."""

    def write(folder: Path) -> None:
        targets, spread, blank = result.targets, result.spread, np.full(len(result.targets.s), np.nan)
        sd = (blank, blank, blank) if spread is None else (*spread.xy.T, spread.angle)
        here = (*result.xy(targets.s).T, result.angle(targets.s))
        _rows(folder / "targets.csv", TARGET_ROWS, (targets.s, *targets.xy.T, targets.angle, *here, *sd))
        s = np.linspace(0.0, 1.0, 201)
        _rows(folder / "shape.csv", SHAPE_ROWS, (s, *result.xy(s).T, result.angle(s)))
        pictures.write(folder)
        write_summary(folder, summary)

    return write


def path_summary(model: str, way: FollowedPath, sure: PathSpread | None, *, written_by: str) -> dict[str, Any]:
    """What `onebend path --json` prints and `summary.json` holds; the samples themselves are in `path.csv`."""
    return {
        "format": PATH_FORMAT,
        "written_by": written_by,
        "model": model,
        "push_s": [pusher.at_s for pusher in way.actuators.pushes],
        "grip": way.actuators.grip is not None,
        "samples": len(way.time),
        "duration_s": float(way.time[-1]),
        "stretch": way.stretch,
        "largest_force_N": [float(f) for f in np.max(np.linalg.norm(way.forces, axis=2), axis=0)],
        "worst_miss_m": float(np.max(way.miss)),
        "least_margin": float(np.min(way.margin)),
        "least_margin_at_goal_time_s": float(way.margin_time[np.argmin(way.margin)]),
        "predicted_sd_m": None if sure is None else {"time_s": sure.time, "rms": sure.rms},
        "warnings": way.warnings,
    }


def path_writer(
    way: FollowedPath, pictures: Pictures, summary: Mapping[str, Any], *, frame: str, bag: bool
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder with a path: CSV, ROS 2 YAML, a picture; with `bag` a ROS 2 bag as well."""

    def write(folder: Path) -> None:
        write_samples(folder / "path.csv", way)
        write_yaml(folder, way, frame=frame)
        if bag:
            write_bag(folder / "bag", way, frame=frame)
        pictures.write(folder)
        write_summary(folder, summary)

    return write


def _rows(file: Path, names: tuple[str, ...], columns: tuple[Any, ...]) -> None:
    """A CSV; blank where a number is not known."""
    rows = np.stack(columns, axis=1)
    write_csv(file, names, ([f"{value:.9g}" if np.isfinite(value) else "" for value in row] for row in rows))
