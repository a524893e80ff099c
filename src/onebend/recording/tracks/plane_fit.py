"""Tracks in space to the plane of bending: the plane by least squares, and the markers' distances from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.errors import ObservationError
from onebend.records import Array, BoolArray, Remark

BESIDE = 0.01  # weight of the markers' mean places against their motion: heights differ by millimetres
STRAIGHT = 0.02  # second over first principal extent: markers that hardly leave a line say nothing of their plane
EDGE_ON = 0.2  # cosine between `seen_from` and the plane's normal below which it does not say which side is meant
MUCH = 0.03  # of the markers' extent: more out-of-plane motion is no planar bending


@dataclass(frozen=True)
class Plane:
    """A plane in space with two axes in it, right-handed with the normal, which points to who looks at it."""

    origin: Array  # (3,) m
    axes: Array  # (2, 3)
    normal: Array  # (3,)

    def lay(self, points: Array) -> Array:
        """(..., 2) m, points (..., 3) dropped onto the plane."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def direction(self, vector: Array) -> Array:
        """(2,) a direction (3,) dropped onto the plane."""
        return np.asarray(self.axes @ vector)

    def away(self, points: Array) -> Array:
        """(...) m, distance of points (..., 3) from the plane."""
        return np.asarray((points - self.origin) @ self.normal)


def best_plane(points: Array, seen_from: Sequence[float]) -> Plane:
    """The plane in which markers at `points` (T, m, 3) [m] move, by least squares; NaN left out.

    Each marker sits at a height of its own over the beam, so their motion shows the plane, and where they lie beside
    each other counts little. `seen_from` (3,) says which side one looks from. Points along one line leave the plane
    open: then the one that is seen most nearly face on is taken.

    Raises:
        ObservationError: too few points, or the plane is seen edge on.
    """
    known: BoolArray = np.asarray(np.isfinite(points).all(axis=-1))
    if np.sum(known) < 3:
        raise ObservationError(f"{np.sum(known)} points in space do not make a plane. Check the table's x_m, y_m, z_m.")
    tracks = [points[known[:, i], i] for i in range(points.shape[1]) if known[:, i].any()]
    middles = np.stack([np.mean(track, axis=0) for track in tracks])
    origin = np.mean(middles, axis=0)
    moves = np.concatenate([track - middle for track, middle in zip(tracks, middles, strict=True)])
    moves /= np.sqrt(len(moves))
    spread = BESIDE * (middles - origin) / np.sqrt(len(middles))
    extent, rows = np.linalg.svd(np.concatenate([moves, spread, np.zeros((3, 3))]), full_matrices=False)[1:]
    look = np.asarray(seen_from, dtype=float)
    look = look / max(float(np.linalg.norm(look)), np.finfo(float).tiny)
    normal = rows[2]
    if extent[1] < STRAIGHT * extent[0]:
        normal = look - (look @ rows[0]) * rows[0]
        normal = normal / max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    if not abs(float(normal @ look)) > EDGE_ON:
        raise ObservationError(
            f"The plane of bending (normal {np.round(normal, 2).tolist()}) is seen edge on from {list(seen_from)}, so "
            "nothing says which way round its y axis goes. Give seen_from in [markers] a direction nearer its normal."
        )
    normal = normal * np.sign(normal @ look)
    along = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = along - (along @ normal) * normal
    x = x / np.linalg.norm(x)
    return Plane(origin, np.stack([x, np.cross(normal, x)]), normal)


def plane_remarks(plane: Plane, points: Array) -> tuple[Remark, ...]:
    """How far points (T, m, 3) move out of the plane: their own steady distance from it (a marker's height) is taken
    off."""
    distance = plane.away(points)
    measured = np.isfinite(distance).any(axis=0)
    distance = distance[:, measured] - np.nanmedian(distance[:, measured], axis=0)
    rms, largest = float(np.sqrt(np.nanmean(distance**2))), float(np.nanmax(np.abs(distance)))
    flat = plane.lay(points)[:, measured]
    extent = float(np.nanmax(np.linalg.norm(flat - np.nanmean(flat, axis=(0, 1)), axis=-1)))
    text = f"The markers move out of the plane of bending by {1000 * rms:.2g} mm RMS, {1000 * largest:.2g} mm at most"
    if largest > MUCH * extent:
        text += ": this is no bending in one plane, and what leaves it is not seen. Push within one plane."
        return (Remark("warning", text, about="out of plane"),)
    return (Remark("note", f"{text}; only the motion in the plane is used."),)
