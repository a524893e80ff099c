"""The force log as a file, on its own clock and in its own axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from onebend.records import Array, ForceLog


def in_log_axes(force: Array, rotation: float, acts_on: str) -> Array:
    """(N, 2) N in the axes of a log whose x axis is turned by `rotation` [rad] against the beam's; the reaction where
    it `acts_on` the "robot"."""
    cos, sin = np.cos(rotation), np.sin(rotation)
    sign = -1.0 if acts_on == "robot" else 1.0
    return np.asarray(sign * force @ np.array([[cos, -sin], [sin, cos]]))


def write_log(path: Path, log: ForceLog) -> None:
    """`time_s, fx_N, fy_N`, to 0.1 ms and 0.01 mN."""
    rows = np.column_stack([log.time, log.force])
    np.savetxt(path, rows, fmt=("%.4f", "%.5f", "%.5f"), delimiter=",", header="time_s,fx_N,fy_N", comments="")
