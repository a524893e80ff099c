"""Files of `onebend reach`, `shape`, `path` and `loop`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from onebend.control.loop import Controller, Margins
from onebend.control.loop_simulation import SETTLED, LoopTrial
from onebend.control.path import FollowedPath, PathSpread
from onebend.control.reach import SURE, PredictedError, Reach, ReachInSetUp
from onebend.control.shape import ShapeResult
from onebend.control.trajectory_files import columns, write_yaml
from onebend.files.publish import headed
from onebend.results.tables import write_columns, write_csv

REACH_FORMAT = "onebend-reach-1"
PATH_COLUMNS = ("step", "force_x_N", "force_y_N", "moment_N_m", "point_x_m", "point_y_m")


def reach_summary(model: str, result: Reach | ReachInSetUp, error: PredictedError | None) -> dict[str, Any]:
    """`reach --json` and `summary.json`; SI and radians."""
    nearest = result.nearest
    return headed(REACH_FORMAT, model=model) | {
        "method": result.settings.method,
        "push_s": result.push_s,
        "point_s": result.point_s,
        "tag": result.tag,
        "goal_m": result.goal[:2].tolist(),
        "goal_angle_rad": float(result.goal[2]) if len(result.goal) == 3 else None,
        "converged": result.converged,
        "reason": result.reason,
        "force_N": result.force.tolist(),
        "force_size_N": float(np.hypot(*result.force)),
        "force_on_beam_N": result.on_beam.tolist(),
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


def write_reach(folder: Path, result: Reach | ReachInSetUp) -> None:
    """`path.csv`: load and point from rest, on one branch."""
    columns = (np.arange(len(result.path)), *result.path.T, *result.path_points.T)
    write_columns(folder / "path.csv", dict(zip(PATH_COLUMNS, columns, strict=True)))


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


def shape_summary(model: str, result: ShapeResult) -> dict[str, Any]:
    """`shape --json` and `summary.json`; SI and radians."""
    actuators, spread = result.state.actuators, result.spread
    held = actuators.grip is not None
    return headed(SHAPE_FORMAT, model=model) | {
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


def write_shape(folder: Path, result: ShapeResult) -> None:
    targets, spread, blank = result.targets, result.spread, np.full(len(result.targets.s), np.nan)
    sd = (blank, blank, blank) if spread is None else (*spread.xy.T, spread.angle)
    here = (*targets.places(result.state.solved)[0].T, result.angle(targets.s))
    columns = (targets.s, *targets.xy.T, targets.angle, *here, *sd)
    write_columns(folder / "targets.csv", dict(zip(TARGET_ROWS, columns, strict=True)))
    s = np.linspace(0.0, 1.0, 201)
    columns = (s, *result.xy(s).T, result.angle(s))
    write_columns(folder / "shape.csv", dict(zip(SHAPE_ROWS, columns, strict=True)))


def path_summary(model: str, way: FollowedPath, sure: PathSpread | None) -> dict[str, Any]:
    """`path --json` and `summary.json`."""
    return headed(PATH_FORMAT, model=model) | {
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


def write_path(folder: Path, way: FollowedPath, *, frame: str) -> None:
    """CSV and ROS 2 YAML."""
    write_columns(folder / "path.csv", columns(way))
    write_yaml(folder, way, frame=frame)


LOOP_FORMAT = "onebend-loop-1"
LOOP_COLUMNS = ("k_factor", "time_s", "x_m", "y_m", "asked_x_N", "asked_y_N", "force_x_N", "force_y_N", "error_m")


def loop_summary(model: str, control: Controller, known: Margins, trials: tuple[LoopTrial, ...]) -> dict[str, Any]:
    """`loop --json` and `summary.json`; SI; null is infinite."""
    timing = control.settings.timing
    return headed(LOOP_FORMAT, model=model) | {
        "push_s": control.push_s,
        "point_s": control.point_s,
        "goal_m": control.goal.tolist(),
        "feedforward_N": control.reference.ends.tolist(),
        "rise_s": control.reference.rise,
        "fps": timing.fps,
        "delay_s": timing.delay,
        "rate_per_s": control.gains.rate,
        "corner_rad_per_s": control.gains.corner,
        "margins": margins_data(known),
        "trials": [
            {
                "k_factor": trial.beam.factor,
                "drawn": trial.beam.drawn,
                "stands": trial.run is not None,
                "steady_m": trial.steady,
                "settled_s": trial.settled(SETTLED),
            }
            for trial in trials
        ],
    }


def margins_data(known: Margins) -> dict[str, float]:
    """None is infinite in JSON."""
    return {"gain": known.gain, "phase_rad": known.phase, "delay_s": known.delay, "softest": known.softest}


def write_loop(folder: Path, trials: tuple[LoopTrial, ...]) -> None:
    """`loop.csv`, one row per time of every simulation."""
    rows = (
        (trial.beam.factor, time, *trial.run.xy[i], *trial.run.asked[i], *trial.run.force[i], trial.run.error[i])
        for trial in trials
        if trial.run is not None
        for i, time in enumerate(trial.run.time)
    )
    write_csv(folder / "loop.csv", LOOP_COLUMNS, ([f"{value:.7g}" for value in row] for row in rows))
