"""Heights, plane and lens, rolling shutter, against a camera that projects point by point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.allowances import camera as camera_unknowns, outline_height, rolling_shutter
from onebend.recording.plane import camera_place, lowered as lower
from onebend.records import Array, Observations, View
from tests.learning.allowances.allowed_bench import CAMERA, filmed
from tests.made_up import with_source

ABOVE = replace(CAMERA, rotation=np.diag([1.0, -1.0, -1.0]), calibrated=True)
CAMERAS = pytest.mark.parametrize("camera", [CAMERA, ABOVE], ids=["oblique", "above"])


def pixels(view: View, points: Array, k1: float = 0.0) -> Array:
    """(..., 2) px of points (..., 3) m, through a lens of one radial term."""
    x = points @ view.rotation.T + view.translation
    n = x[..., :2] / x[..., 2:]
    n = n * (1.0 + k1 * np.sum(n**2, axis=-1, keepdims=True))
    return np.asarray(n @ view.matrix[:2, :2].T + view.matrix[:2, 2])


def on_plane(view: View, seen: Array) -> Array:
    """(..., 2) m where the rays of pixels (..., 2) meet the plane z = 0, taking the lens to have no such term."""
    rays = (
        np.concatenate([seen, np.ones((*seen.shape[:-1], 1))], axis=-1) @ np.linalg.inv(view.matrix).T @ view.rotation
    )
    place = -view.rotation.T @ view.translation
    return np.asarray(place[:2] - rays[..., :2] * (place[2] / rays[..., 2:]))


def poses_of(made: Observations) -> Array:
    return np.concatenate([made.xy, made.angle[..., None]], axis=-1)


def seen_by(view: View, poses: Array, height: Callable[[Array], Array], k1: float = 0.0) -> Array:
    """(..., 3) poses as they seem to be, of tags at these heights [m] towards the camera at (..., 2)."""
    side = np.sign((-view.rotation.T @ view.translation)[2])

    def seem(xy: Array) -> Array:
        points = np.concatenate([xy, side * np.broadcast_to(height(xy), xy.shape[:-1])[..., None]], axis=-1)
        return on_plane(view, pixels(view, points, k1))

    ahead = 1e-4 * np.stack([np.cos(poses[..., 2]), np.sin(poses[..., 2])], axis=-1)
    onward = seem(poses[..., :2] + ahead) - seem(poses[..., :2] - ahead)
    angle = np.unwrap(np.arctan2(onward[..., 1], onward[..., 0]), axis=0)
    return np.concatenate([seem(poses[..., :2]), angle[..., None]], axis=-1)


def in_beam_frame(poses: Array, base: Array, rest: Array) -> Array:
    """Poses (..., 3) in the frame of the base tag's place `base` (3,) whose x axis lies along the tags at rest."""
    away = rest[:, :2] - base[:2]
    turn = np.arctan2(np.sum(away[:, 0] * away[:, 1]), np.sum(away[:, 0] ** 2))
    cos, sin = np.cos(turn), np.sin(turn)
    xy = (poses[..., :2] - base[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return np.concatenate([xy, (poses[..., 2] - turn)[..., None]], axis=-1)


def of_frame(view: View, made: Observations, height: Callable[[Array], Array], k1: float = 0.0) -> Array:
    """What a recording measures: poses in the beam's frame as the camera sees it."""
    rest = np.concatenate([made.rest_xy, made.rest_angle[:, None]], axis=1)
    base, there, poses = (seen_by(view, x, height, k1) for x in (np.zeros((1, 3)), rest, poses_of(made)))
    return in_beam_frame(poses, base[0], there)


def flat(xy: Array) -> Array:
    return np.zeros(xy.shape[:-1])


def test_the_camera_stands_where_it_was_put() -> None:
    foot, distance = camera_place(ABOVE)
    np.testing.assert_allclose(foot, [0.05, 0.02])
    assert distance == pytest.approx(0.45)
    np.testing.assert_allclose(on_plane(CAMERA, pixels(CAMERA, np.array([0.1, 0.03, 0.0]))), [0.1, 0.03], atol=1e-12)


@CAMERAS
def test_a_point_over_the_plane_seems_farther_from_the_cameras_foot(camera: View) -> None:
    made = replace(with_source(filmed(), view=camera), traced=np.array([True, False, True]))
    poses, h = poses_of(made), 1e-4
    free = outline_height(made, poses)
    assert free is not None
    for point in (0, 2):
        moved = seen_by(camera, poses[:, point], lambda xy: np.full(xy.shape[:-1], h)) - poses[:, point]
        np.testing.assert_allclose(h * free.basis[:, point].sum(axis=-1), moved, atol=1e-3 * np.max(np.abs(moved)))
        lowered = poses[:, point, :2] - h * (poses[:, point, :2] - camera_place(camera)[0]) / camera_place(camera)[1]
        np.testing.assert_allclose(lower(camera, poses[:, point, :2], h), lowered)
    assert np.all(free.basis[:, 1] == 0.0)


def at_rest_first(made: Observations) -> Observations:
    """The recording with its first frame at rest."""
    xy, angle = made.xy.copy(), made.angle.copy()
    xy[0], angle[0] = made.rest_xy, made.rest_angle
    return replace(made, xy=xy, angle=angle, loaded=np.arange(len(xy)) > 0)


@CAMERAS
@pytest.mark.parametrize("k1", [0.0, 1e-4])
def test_what_turns_base_and_rest_turns_the_frame(camera: View, k1: float) -> None:
    """A tilt of the plane, or a lens that bends rays otherwise: as the base tag sees it, and in the beam's frame."""
    made = at_rest_first(with_source(filmed(), view=camera))

    def height(xy: Array) -> Array:
        return flat(xy) if k1 else 1e-4 * (xy[..., 0] - 0.5 * xy[..., 1])

    poses = poses_of(made)
    base, seen = (seen_by(camera, x, height, k1) for x in (np.zeros((1, 3)), poses))
    by_base = in_beam_frame(seen, base[0], np.array([[np.cos(base[0, 2]), np.sin(base[0, 2]), 0.0]]) + base[0]) - poses
    frames = np.arange(len(poses)) % 2 == 0
    one = camera_unknowns(replace(made, by_camera=by_base[..., None]), frames, int(frames.sum()) + 1)
    assert one is not None
    moved = of_frame(camera, made, height, k1) - of_frame(camera, made, flat)
    np.testing.assert_allclose(one.basis[:-1, ..., 0], moved[frames], atol=3e-3 * np.max(np.abs(moved)))
    np.testing.assert_allclose(one.basis[-1, ..., 0], moved[0], atol=3e-3 * np.max(np.abs(moved)))
    np.testing.assert_array_equal(one.prior_sd, [1.0])


def test_without_rest_the_base_tag_gives_the_axis() -> None:
    made = replace(filmed(), rest_xy=np.full((3, 2), np.nan))
    by_base = np.random.default_rng(0).standard_normal((*made.xy.shape[:2], 3, 2))
    frames = np.ones(len(made.time), dtype=bool)
    one = camera_unknowns(replace(made, by_camera=by_base), frames, len(frames))
    assert one is not None
    np.testing.assert_allclose(one.basis, by_base)


def test_a_point_that_was_not_seen_is_not_moved() -> None:
    made = replace(filmed(), traced=np.array([False, True, True]))
    poses = poses_of(made)
    poses[3, 1], poses[4, 2, 2] = np.nan, np.nan
    free = outline_height(made, poses)
    assert free is not None
    assert np.all(np.isfinite(free.basis))
    assert np.all(free.basis[3, 1] == 0.0)
    assert outline_height(filmed(), poses) is None


@CAMERAS
def test_a_rolling_shutter_sees_every_corner_at_its_own_instant(camera: View) -> None:
    made, size, readout = filmed(40), 4e-3, 1e-3
    rate = np.array([0.02, -0.05, 0.3])  # m/s, m/s, rad/s
    start = np.stack([0.15 * made.marker_s, 0.01 * np.arange(3), 0.4 * np.arange(3)], axis=-1)
    poses = start + rate * made.time[:, None, None]
    made = with_source(replace(made, xy=poses[..., :2], angle=poses[..., 2]), view=camera)
    frames = np.arange(40) % 2 == 0
    one = rolling_shutter(made, frames, 21)
    assert one is not None
    basis = one.basis[..., 0]
    assert np.all(basis[20] == 0.0)

    def corners(pose: Array) -> Array:
        """(..., 4, 2) m of squares at poses (..., 3)."""
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        axes = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], -2)
        at = 0.5 * size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return np.asarray(pose[..., None, :2] + at @ axes)

    now = poses[frames]
    flat = corners(now)
    row = pixels(camera, np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1))[..., 1] / 720.0 - 0.5
    late = corners(now[..., None, :] + readout * row[..., None] * rate)[..., np.arange(4), np.arange(4), :]
    middle = np.mean(late, axis=-2)
    np.testing.assert_allclose(basis[:20, :, :2], (middle - now[..., :2]) / readout, rtol=0.02, atol=1e-5)
    before, after = flat - now[..., None, :2], late - middle[..., None, :]
    dot = np.sum(before * after, axis=(-1, -2))
    cross = np.sum(before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0], axis=-1)
    np.testing.assert_allclose(basis[:20, :, 2], np.arctan2(cross, dot) / readout, rtol=0.02, atol=1e-4)
