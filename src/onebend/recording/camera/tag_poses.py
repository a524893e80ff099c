"""Pose of every sighting of a tag in the tags' plane, with its covariance; functions of planar poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.camera.lens import project, to_plane
from onebend.recording.camera.plane import DEGREES_OF_FREEDOM, lay_square, square
from onebend.records import Array, BoolArray, View

REFINEMENTS = 3  # Gauss-Newton steps of a tag's pose; the first is already within a hundredth of a pixel
END_CORRELATION = -0.5  # of the errors at the two ends of a straight edge
STEP = 1e-6  # m and rad, of the pose's numerical derivative
MEDIAN_CHI2 = 4.35146  # median of chi-squared with 5 degrees of freedom
GRID_ERROR = 0.03  # px, one sd: shift of a whole tag that leaves its shape as it is (pixel grid, compression)


@dataclass(frozen=True)
class Poses:
    """Planar poses with their covariance; leading dimensions are free."""

    xy: Array  # (..., 2) m
    angle: Array  # (...) rad
    covariance: Array  # (..., 3, 3) of (x, y, angle)


def part(poses: Poses, tags: slice) -> Poses:
    """Some of the tags (T, m) of `poses`."""
    return Poses(poses.xy[:, tags], poses.angle[:, tags], poses.covariance[:, tags])


def measure_poses(
    view: View, corners: Array, size: float, *, noise: float | None = None, refinements: int = REFINEMENTS
) -> tuple[Poses, Array, View]:
    """Pose of each sighting in the plane, how far its corners are from that square, and the view with their noise.

    The noise is that of the residuals, or `noise` [px, one sd] where it is known from other frames.

    `corners` (T, m, 4, 2) px; a sighting with a NaN stays NaN. Generalised least squares by Gauss-Newton on the eight
    coordinates of each tag. The misfit is the RMS residual, px, comparable with the view's `corner_sd`.
    """
    xy, angle = lay_square(to_plane(view, corners))
    weight = corner_weight(corners)
    for _ in range(refinements):
        jacobian, residual = linearise(view, xy, angle, corners, size)
        step = weighted_step(jacobian, residual, weight)
        xy, angle = xy + step[..., :2], angle + step[..., 2]
    jacobian, residual = linearise(view, xy, angle, corners, size)
    squares = np.einsum("...i,...ij,...j->...", residual, weight, residual)
    sd = float(np.sqrt(np.nanmedian(squares) / MEDIAN_CHI2)) if noise is None else noise
    variance = np.maximum(squares / DEGREES_OF_FREEDOM, sd**2)
    normal = np.swapaxes(jacobian, -1, -2) @ weight @ jacobian
    covariance = variance[..., None, None] * np.linalg.inv(normal) + grid_covariance(jacobian)
    poses = Poses(xy, angle, covariance)
    return poses, np.sqrt(squares / DEGREES_OF_FREEDOM), replace(view, corner_sd=sd)


def grid_covariance(jacobian: Array) -> Array:
    """Covariance (..., 3, 3) of a pose for a shift of all four corners together by `GRID_ERROR`."""
    place = jacobian[..., :2].reshape(*jacobian.shape[:-2], 4, 2, 2).mean(axis=-3)  # px per metre
    metre = np.linalg.inv(place)
    covariance = np.zeros((*jacobian.shape[:-2], 3, 3))
    covariance[..., :2, :2] = GRID_ERROR**2 * metre @ np.swapaxes(metre, -1, -2)
    return covariance


def weighted_step(jacobian: Array, residual: Array, weight: Array) -> Array:
    """The generalised least-squares solution (..., 3) of `jacobian @ step = left`."""
    across = np.swapaxes(jacobian, -1, -2) @ weight
    return np.asarray(np.linalg.solve(across @ jacobian, across @ residual[..., None])[..., 0])


def corner_weight(corners: Array) -> Array:
    """Inverse covariance (..., 8, 8) of the corners' errors, for errors of unit variance along each edge's normal.

    A detector fits straight lines to noisy edge points; the corners are their crossings. So the errors are those of
    edges, along their normals, and the errors at the two ends of an edge have the correlation -1/2: a line through
    many equally noisy points has the variance 4 at its ends and 1 in its middle.
    """
    covariance = np.zeros((*corners.shape[:-2], 8, 8))
    for start, end in ((0, 1), (1, 2), (2, 3), (3, 0)):
        along = corners[..., end, :] - corners[..., start, :]
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        outer = normal[..., :, None] * normal[..., None, :]
        a, b = slice(2 * start, 2 * start + 2), slice(2 * end, 2 * end + 2)
        covariance[..., a, a] += outer
        covariance[..., b, b] += outer
        covariance[..., a, b] += END_CORRELATION * outer
        covariance[..., b, a] += END_CORRELATION * outer
    return np.asarray(np.linalg.inv(covariance))


def linearise(view: View, xy: Array, angle: Array, corners: Array, size: float) -> tuple[Array, Array]:
    """Jacobian (..., 8, 3) of the projected corners by (x, y, angle), and the residual (..., 8) of `corners`, px."""

    def projected(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Array:
        flat = project(view, square(xy + np.array([dx, dy]), angle + turn, size))
        return flat.reshape(*flat.shape[:-2], 8)

    columns = [(projected(**{name: STEP}) - projected(**{name: -STEP})) / (2 * STEP) for name in ("dx", "dy", "turn")]
    return np.stack(columns, axis=-1), corners.reshape(*corners.shape[:-2], 8) - projected()


def drop(poses: Poses, wrong: BoolArray) -> Poses:
    """The poses, NaN where `wrong`."""
    return Poses(
        np.where(wrong[..., None], np.nan, poses.xy),
        np.where(wrong, np.nan, poses.angle),
        np.where(wrong[..., None, None], np.nan, poses.covariance),
    )


def relative_to(origin: Poses, poses: Poses) -> Poses:
    """`poses` (T, m) in the frame of `origin` (T, 1), with the uncertainty of both."""
    cos, sin = np.cos(origin.angle), np.sin(origin.angle)
    off = poses.xy - origin.xy
    x, y = cos * off[..., 0] + sin * off[..., 1], -sin * off[..., 0] + cos * off[..., 1]
    zero, one = np.zeros_like(x), np.ones_like(x)
    turn = np.stack([cos + zero, sin + zero, zero, -sin + zero, cos + zero, zero, zero, zero, one], axis=-1)
    back = np.stack([-cos + zero, -sin + zero, y, sin + zero, -cos + zero, -x, zero, zero, -one], axis=-1)
    turn, back = turn.reshape(*x.shape, 3, 3), back.reshape(*x.shape, 3, 3)
    covariance = turn @ poses.covariance @ np.swapaxes(turn, -1, -2)
    covariance += back @ origin.covariance @ np.swapaxes(back, -1, -2)
    return Poses(np.stack([x, y], axis=-1), poses.angle - origin.angle, covariance)


def unwrap(angle: Array) -> Array:
    """Angles (T, ...) made continuous in time, the first one in (-pi, pi]; NaN stays NaN and is skipped."""
    flat = np.array(angle, dtype=float).reshape(len(angle), -1)
    for column in flat.T:
        known = np.isfinite(column)
        if known.any():
            continuous = np.unwrap(column[known])
            column[known] = continuous - 2 * np.pi * np.round(continuous[0] / (2 * np.pi))
    return flat.reshape(angle.shape)
