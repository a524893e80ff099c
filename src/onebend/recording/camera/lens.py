"""The camera's geometry: points of the tags' plane <--> pixels, with OpenCV's lens model."""

from __future__ import annotations

import numpy as np

from onebend.records import Array, View

MOST_ITERATIONS = 50
CONVERGED = 1e-10  # of the normalised image, far below a thousandth of a pixel


def project(view: View, xy: Array) -> Array:
    """Pixels (..., 2) of points `xy` (..., 2) [m] of the plane."""
    inside = xy @ view.rotation[:, :2].T + view.translation
    ray = inside[..., :2] / inside[..., 2:]
    return distort(ray, view.dist) @ view.matrix[:2, :2].T + view.matrix[:2, 2]


def to_plane(view: View, px: Array) -> Array:
    """Points (..., 2) [m] of the plane that are seen at pixels `px` (..., 2). NaN where no such point exists."""
    ray = undistort((px - view.matrix[:2, 2]) @ np.linalg.inv(view.matrix[:2, :2]).T, view.dist)
    direction = np.concatenate([ray, np.ones_like(ray[..., :1])], axis=-1) @ view.rotation  # in the plane's axes
    origin = -view.translation @ view.rotation  # the camera, in the plane's axes
    reach = -origin[2] / direction[..., 2:]
    return np.where(reach > 0, origin[:2] + reach * direction[..., :2], np.nan)


def distort(ray: Array, dist: Array) -> Array:
    """What the lens does to a normalised image point (x/z, y/z): radial k1, k2, k3 and tangential p1, p2."""
    k1, k2, p1, p2, k3 = dist
    x, y = ray[..., 0], ray[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def undistort(distorted: Array, dist: Array) -> Array:
    """The inverse of `distort`, by fixed-point iteration. NaN where it does not converge: there the lens model folds
    over and means nothing."""
    ray = distorted
    for _ in range(MOST_ITERATIONS):
        error = distorted - distort(ray, dist)
        if not np.nanmax(np.abs(error), initial=0.0) > CONVERGED:
            return ray
        ray = ray + error
        ray = np.where(np.abs(ray) < 1e3, ray, np.nan)
    return np.where(np.abs(distorted - distort(ray, dist)).max(axis=-1, keepdims=True) <= 1e-6, ray, np.nan)
