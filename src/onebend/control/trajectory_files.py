"""A path as columns and as ROS 2 messages in YAML.

Forces and wrenches act on the beam, in its frame, at the actuator's place (also moments). Poses are of s = 1: x along
the tangent, z out of the plane. Times count from the path's start.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from onebend.control.path import FollowedPath
from onebend.records import Array
from onebend.text_files import to_json

FRAME = "beam_base"  # origin at the base tag, x along the undeformed beam, y to its left
JOINT = "gripper"


def wrenches(path: FollowedPath) -> dict[str, Array]:
    """(T, 3) N, N, N m of each pusher, then of the gripper."""
    out = {f"push_{i + 1}": np.pad(path.forces[:, i], ((0, 0), (0, 1))) for i in range(path.forces.shape[1])}
    return out if path.wrench is None else out | {"gripper": path.wrench}


def columns(path: FollowedPath) -> dict[str, Array]:
    """(T,) per column of `path.csv`."""
    out = {"time_s": path.time, "goal_time_s": path.goal_time}
    for i in range(path.forces.shape[1]):
        out[f"force_{i + 1}_x_N"], out[f"force_{i + 1}_y_N"] = path.forces[:, i].T
    if path.wrench is not None:
        out["gripper_x_m"], out["gripper_y_m"], out["gripper_angle_rad"] = path.poses.T
        out["gripper_force_x_N"], out["gripper_force_y_N"], out["gripper_moment_N_m"] = path.wrench.T
    out["miss_m"] = path.miss
    return out


def trajectory_message(path: FollowedPath, *, frame: str = FRAME) -> dict[str, Any]:
    """The gripper's path as trajectory_msgs/MultiDOFJointTrajectory, in plain data."""
    poses = path.poses
    rates = np.gradient(poses, path.time, axis=0) if len(path.time) > 1 else np.zeros_like(poses)
    points = [
        {
            "transforms": [
                {
                    "translation": vector(x, y, 0.0),
                    "rotation": vector(0.0, 0.0, np.sin(0.5 * angle)) | {"w": float(np.cos(0.5 * angle))},
                }
            ],
            "velocities": [{"linear": vector(vx, vy, 0.0), "angular": vector(0.0, 0.0, turning)}],
            "accelerations": [],
            "time_from_start": _time(seconds),
        }
        for seconds, (x, y, angle), (vx, vy, turning) in zip(path.time, poses, rates, strict=True)
    ]
    return {"header": header(0.0, frame), "joint_names": [JOINT], "points": points}


def wrench_messages(time: Array, wrench: Array, *, frame: str = FRAME) -> Iterator[dict[str, Any]]:
    """One geometry_msgs/WrenchStamped per sample of a wrench (T, 3), in plain data."""
    for seconds, (x, y, moment) in zip(time, wrench, strict=True):
        stamped = {"force": vector(x, y, 0.0), "torque": vector(0.0, 0.0, moment)}
        yield {"header": header(seconds, frame), "wrench": stamped}


def write_yaml(folder: Path, path: FollowedPath, *, frame: str = FRAME) -> list[str]:
    """YAML (as JSON, which is YAML too) for `ros2 topic pub`; returns file names. The trajectory is one message,
    wrenches one per sample, with `---` between."""
    texts = {} if path.wrench is None else {"gripper_trajectory.yaml": to_json(trajectory_message(path, frame=frame))}
    for name, wrench in wrenches(path).items():
        messages = (to_json(message, readable=False) for message in wrench_messages(path.time, wrench, frame=frame))
        texts[f"{name}_wrench.yaml"] = "\n---\n".join(messages)
    for name, text in texts.items():
        (folder / name).write_text(f"{text}\n", encoding="utf-8")
    return list(texts)


def vector(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": float(x), "y": float(y), "z": float(z)}


def _time(seconds: float) -> dict[str, int]:
    whole, part = divmod(round(float(seconds) * 1e9), 1_000_000_000)
    return {"sec": whole, "nanosec": part}


def header(seconds: float, frame: str) -> dict[str, Any]:
    return {"stamp": _time(seconds), "frame_id": frame}
