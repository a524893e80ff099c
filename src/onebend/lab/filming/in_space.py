"""Polygons that stand out of the table's plane, pixels of them, and rows of a picture that are exposed one by one."""

from __future__ import annotations

import numpy as np

from onebend.recording.camera.lens import distort, project
from onebend.records import Array, View


def placed_in_space(loops: Array, pose: Array) -> Array:
    """Polygons (..., corners, 2) [m] of a flat thing at `pose` (6,): x, y, angle, z, and its face's tilts.

    Tilts [rad]: about its own x axis, then upwards along it. (..., corners, 3); still (..., corners, 2) in the plane.
    """
    x, y, turn, height, roll, slope = pose.tolist()
    cos, sin = np.cos(turn), np.sin(turn)
    into_room = np.array([[cos, sin], [-sin, cos]])
    if height == 0.0 and roll == 0.0 and slope == 0.0:
        return np.asarray(loops @ into_room + pose[:2])
    u, v = loops[..., 0], loops[..., 1]
    up = v * np.sin(roll)
    along = u * np.cos(slope) - up * np.sin(slope)
    flat = np.stack([along, v * np.cos(roll)], axis=-1) @ into_room + np.array([x, y])
    z = height + u * np.sin(slope) + up * np.cos(slope)
    return np.concatenate([flat, z[..., None]], axis=-1)


def lifted(xy: Array, z: Array) -> Array:
    """(..., 3) m, points (..., 2) at heights (...,); as they are where all lie in the plane."""
    return np.concatenate([xy, z[..., None]], axis=-1) if np.any(z) else xy


def pixels(view: View, points: Array) -> Array:
    """Pixels (..., 2) of points (..., 2) in the plane or (..., 3) in space [m]."""
    if points.shape[-1] == 2:
        return project(view, points)
    inside = points @ view.rotation.T + view.translation
    ray = inside[..., :2] / inside[..., 2:]
    return np.asarray(distort(ray, view.dist) @ view.matrix[:2, :2].T + view.matrix[:2, 2])


def rolled(first: Array, last: Array, rows: int) -> Array:
    """Pixels (..., 2) of what is seen at `first` as the first of the rows is exposed, and at `last` as the last one is.

    Things move evenly from one to the other: v = v0 + (v1 - v0) v / rows.
    """
    moved = last - first
    share = np.clip(first[..., 1] / (rows - moved[..., 1]), 0.0, 1.0)
    return np.asarray(first + share[..., None] * moved)
