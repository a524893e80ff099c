"""Lenses of other models as ours: the nearest k1, k2, p1, p2 and k3 over the picture, and how far they stay from it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np

from onebend.recording.camera.lens import distort, undistort
from onebend.records import Array

Lens = Callable[[Array], Array]  # rays (..., 2) as (x / z, y / z) to where the lens shows them
DIRECTIONS, STEPS = 72, 400  # in which rays are followed from the middle to the picture's edge
WIDEST = np.deg2rad(80.0)  # from the optical axis; what is seen farther off has no place in a plane's picture


def rational(dist: Array) -> Lens:
    """OpenCV's rational model: k1, k2, p1, p2, k3, k4, k5, k6."""

    def lens(ray: Array) -> Array:
        square = np.sum(ray**2, axis=-1, keepdims=True)
        below = 1.0 + square * (dist[5] + square * (dist[6] + square * dist[7]))
        bare, k1, k2, k3 = np.zeros(5), dist[0], dist[1], dist[4]
        bare[2:4] = dist[2:4]
        above = 1.0 + square * (k1 + square * (k2 + square * k3))
        return np.asarray(distort(ray, bare) + ray * (above / below - 1.0))

    return lens


def equidistant(dist: Array) -> Lens:
    """Kannala and Brandt's fisheye model, as OpenCV and ROS write it: k1 to k4 of the angle from the optical axis."""

    def lens(ray: Array) -> Array:
        radius = np.linalg.norm(ray, axis=-1, keepdims=True)
        angle = np.arctan(radius)
        square = angle**2
        bent = angle * (1.0 + square * (dist[0] + square * (dist[1] + square * (dist[2] + square * dist[3]))))
        return np.asarray(ray * np.divide(bent, radius, out=np.ones_like(radius), where=radius > 0.0))

    return lens


def nearest_lens(lens: Lens, matrix: Array, size: tuple[int, int]) -> tuple[Array, float]:
    """k1, k2, p1, p2, k3 (5,) by least squares over a picture of `size` (width, height), and the largest error, px.

    Infinite where the lens shows no ray in a part of the picture, or ours has no inverse there.
    """
    rays, complete = rays_in_picture(lens, matrix, size)
    if not complete:
        return np.zeros(5), inf
    square = np.sum(rays**2, axis=-1, keepdims=True)
    x, y = rays[..., :1], rays[..., 1:]
    columns = [
        rays * square,
        rays * square**2,
        np.concatenate([2.0 * x * y, square + 2.0 * y**2], axis=-1),
        np.concatenate([square + 2.0 * x**2, 2.0 * x * y], axis=-1),
        rays * square**3,
    ]
    wanted = lens(rays)
    design = np.stack([column.ravel() for column in columns], axis=1)
    dist = np.linalg.lstsq(design, (wanted - rays).ravel(), rcond=None)[0]
    focal = np.diag(matrix)[:2]
    error = np.linalg.norm((distort(rays, dist) - wanted) * focal, axis=-1)
    back = np.linalg.norm((undistort(wanted, dist) - rays) * focal, axis=-1)
    worst = float(np.maximum(error, back).max())
    return dist, worst if np.isfinite(worst) else inf


def rays_in_picture(lens: Lens, matrix: Array, size: tuple[int, int]) -> tuple[Array, bool]:
    """Rays (N, 2) that the lens shows in the picture, and whether they reach its edge everywhere."""
    turn = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    rays = ways[:, None] * np.tan(np.linspace(0.0, WIDEST, STEPS))[:, None]
    shown = lens(rays)
    px = shown * np.diag(matrix)[:2] + matrix[:2, 2]
    outside = np.any((px < -0.5) | (px > np.array(size) - 0.5), axis=-1)
    rising = np.diff(np.linalg.norm(shown, axis=-1), axis=1) > 0.0
    left = np.argmax(outside, axis=1)  # the first step out of the picture
    inside = np.arange(STEPS) < left[:, None]
    complete = outside.any(axis=1) & np.all(rising | ~inside[:, :-1], axis=1)
    return rays[inside], bool(complete.all())
