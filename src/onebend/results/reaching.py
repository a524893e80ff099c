"""What `onebend reach` leaves in a folder: the path of forces, the picture, and a summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.control.reach.reach import Reach
from onebend.control.reach.uncertainty import SURE, PredictedError
from onebend.files.manifest import write_summary
from onebend.report.figures.pictures import Pictures
from onebend.results.tables import write_csv

REACH_FORMAT = "onebend-reach-1"
PATH_COLUMNS = ("step", "force_x_N", "force_y_N", "moment_N_m", "point_x_m", "point_y_m")


def reach_summary(model: str, result: Reach, error: PredictedError | None, *, written_by: str) -> dict[str, Any]:
    """What `onebend reach --json` prints and `summary.json` holds (there with `files`); SI and radians."""
    nearest = result.nearest
    return {
        "format": REACH_FORMAT,
        "written_by": written_by,
        "model": model,
        "method": result.settings.method,
        "push_s": result.push_s,
        "point_s": result.point_s,
        "goal_m": result.goal[:2].tolist(),
        "goal_angle_rad": float(result.goal[2]) if len(result.goal) == 3 else None,
        "converged": result.converged,
        "reason": result.reason,
        "force_N": result.force.tolist(),
        "force_size_N": float(np.hypot(*result.force)),
        "moment_N_m": result.moment,
        "reached_m": result.reached[:2].tolist(),
        "reached_angle_rad": float(result.reached[2]),
        "error_m": result.error,
        "stable": result.stable,
        "iterations": result.iterations,
        "nearest": None if nearest is None else {
            "point_m": nearest.point.tolist(),
            "force_N": nearest.force.tolist(),
            "distance_m": nearest.distance,
        },
        "predicted_error": None if error is None else {
            "mean_m": error.mean.tolist(),
            "share_lost": error.lost,
            "covariance_m2": error.covariance.tolist(),
            "ellipse_level": SURE,
            "ellipse_semi_axes_m": error.ellipse(SURE).semi_axes.tolist(),
            "ellipse_angle_rad": error.ellipse(SURE).angle,
        },
    }  # fmt: skip


def write_path(path: Path, result: Reach) -> None:
    """One row a step from rest: the load, and where it holds the point; each an equilibrium on one branch."""
    pairs = zip(result.path, result.path_points, strict=True)
    rows = ([step, *(f"{value:.9g}" for value in (*load, *point))] for step, (load, point) in enumerate(pairs))
    write_csv(path, PATH_COLUMNS, rows)


def reach_writer(result: Reach, pictures: Pictures, summary: Mapping[str, Any]) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder."""

    def write(folder: Path) -> None:
        write_path(folder / "path.csv", result)
        pictures.write(folder)
        write_summary(folder, summary)

    return write
