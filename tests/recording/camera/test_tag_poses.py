"""Covariance of a tag's pose: what the pixel grid leaves open, and what its corners' noise does."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.recording.camera import measure_poses
from onebend.recording.plane import project, square
from tests.made_up import overhead_view

SIZE, GRID = 0.012, 0.03  # m; px, one sd of a shift of a whole tag
VIEW = overhead_view()
SCALE = float(VIEW.matrix[0, 0] / VIEW.translation[2])  # px per metre


def test_a_tag_read_without_noise_is_known_to_the_pixel_grid() -> None:
    xy = np.array([[[0.01, 0.02], [0.08, 0.01]]])
    corners = project(VIEW, square(xy, np.array([[0.1, -0.4]]), SIZE))
    poses, misfit, view = measure_poses(VIEW, corners, SIZE)
    np.testing.assert_allclose(poses.xy, xy, atol=1e-9)
    assert view.corner_sd < 1e-4
    assert np.max(misfit) < 1e-4
    expected = np.tile((GRID / SCALE) ** 2 * np.eye(2), (1, 2, 1, 1))
    np.testing.assert_allclose(poses.covariance[..., :2, :2], expected, atol=0.03 * (GRID / SCALE) ** 2)


def test_noise_of_the_edges_is_found_and_adds_to_that() -> None:
    rng, frames, sd = np.random.default_rng(0), 600, 0.2
    xy = np.tile([0.03, 0.01], (frames, 1, 1))
    corners = project(VIEW, square(xy, np.zeros((frames, 1)), SIZE))
    middle, slope = (
        1.0,
        np.sqrt(3.0),
    )  # px per sd: of a line through many points, in its middle and from there to an end
    for start, end in ((0, 1), (1, 2), (2, 3), (3, 0)):
        along = corners[..., end, :] - corners[..., start, :]
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        m, s = 0.5 * sd * rng.standard_normal((2, frames, 1, 1))
        corners[..., start, :] += (middle * m - slope * s) * normal
        corners[..., end, :] += (middle * m + slope * s) * normal
    poses, _, view = measure_poses(VIEW, corners, SIZE)
    assert view.corner_sd == pytest.approx(sd, rel=0.06)
    scatter = np.var(poses.xy[:, 0], axis=0) + (GRID / SCALE) ** 2
    typical = np.median(np.diagonal(poses.covariance[:, 0, :2, :2], axis1=1, axis2=2), axis=0)
    np.testing.assert_allclose(typical, scatter, rtol=0.25)
