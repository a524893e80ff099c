"""The base's pose from the tags on it: one place where it stands still, one a frame where it moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.recording.camera.tag_poses import Poses, relative_to, unwrap
from onebend.recording.toml.entries import TagEntry
from onebend.records import Array, Remark

MOVED = 5.0  # sd: a base that is farther from its median pose, after a running median, moves
RUNNING = 5  # frames of that running median
SHAKES = 2.0  # sd: places that scatter by more show a camera that shakes


def base_pose(poses: Poses, tags: Sequence[TagEntry], length: float) -> tuple[Poses, bool]:
    """Pose (T, 1) of the beam's frame, from the poses (T, b) of the base's tags, and whether it moves.

    The first tag defines the frame: it lies at its own s on the x axis. A base that stands still has the median pose of
    all frames. The error that is left in it is the same in every frame: it moves and turns the beam's whole frame, as
    the mounting does, and is no noise of the tags, so that its covariance is zero. Place and angle are judged apart: a
    camera that shakes or drifts on its tripod shifts the picture, and an angle that is followed without need would
    carry its noise out to the tip.
    """
    pose = together(poses, [tag.s * length for tag in tags])
    state = np.concatenate([pose.xy[:, 0], pose.angle], axis=1)
    known = np.isfinite(state).all(axis=1)
    middle, typical = np.median(state[known], axis=0), np.median(pose.covariance[known, 0], axis=0)
    turns = _moves(state[known, 2:], middle[2:], typical[2:, 2:])
    if turns:
        return pose, True
    shifts = _moves(state[known, :2], middle[:2], typical[:2, :2])
    shakes = bool(np.any(np.std(state[known, :2], axis=0) > SHAKES * np.sqrt(np.diag(typical)[:2])))
    frames, covariance, xy = len(state), np.zeros((3, 3)), np.broadcast_to(middle[:2], (len(state), 2))
    if frames == 1:  # a picture alone: other pictures have other errors
        covariance = typical
    elif shifts or shakes:
        xy, covariance[:2, :2] = np.where(known[:, None], state[:, :2], np.nan), typical[:2, :2]
    every = np.broadcast_to(covariance, (frames, 1, 3, 3))
    return Poses(xy[:, None], np.broadcast_to(middle[2:], (frames, 1)), every), shifts


def _moves(state: Array, middle: Array, covariance: Array) -> bool:
    """Whether places or angles (T, n) leave their median (n,) by more than their covariance (n, n) explains."""
    deviation = running_median(state, RUNNING) - middle
    chi2 = np.einsum("ti,ij,tj->t", deviation, np.linalg.inv(covariance), deviation)
    return bool((chi2 > MOVED**2).any())


def together(poses: Poses, places: Sequence[float]) -> Poses:
    """The base's pose (T, 1) from all its tags, `places` [m] on its x axis.

    Other tags are related to the first by their measured relative pose, not by their stated place.
    """
    first = behind(column(poses, 0), places[0])
    others = [behind(column(poses, i), s) for i, s in enumerate(places) if i > 0]
    return average([first, *(aligned(other, first) for other in others)])


def column(poses: Poses, i: int) -> Poses:
    """The poses (T, 1) of one tag, its angle continuous in time."""
    return Poses(poses.xy[:, i : i + 1], unwrap(poses.angle[:, i : i + 1]), poses.covariance[:, i : i + 1])


def behind(pose: Poses, along: float) -> Poses:
    """Pose (T, 1) of a frame on whose x axis the given pose sits at `along` [m]."""
    cos, sin = np.cos(pose.angle), np.sin(pose.angle)
    jacobian = np.broadcast_to(np.eye(3), (*pose.angle.shape, 3, 3)).copy()
    jacobian[..., 0, 2], jacobian[..., 1, 2] = along * sin, -along * cos
    covariance = jacobian @ pose.covariance @ np.swapaxes(jacobian, -1, -2)
    return Poses(pose.xy - along * np.stack([cos, sin], axis=-1), pose.angle, covariance)


def aligned(poses: Poses, first: Poses) -> Poses:
    """`poses` moved by the constant pose that, in the frames that show both, brings it onto `first`."""
    difference = relative_to(poses, first)
    both = np.isfinite(difference.angle[:, 0])
    if not both.any():
        return poses  # never seen together: its stated place is used
    x, y = np.median(difference.xy[both, 0], axis=0)
    turn = float(np.median(difference.angle[both, 0]))
    cos, sin = np.cos(poses.angle), np.sin(poses.angle)
    moved = poses.xy + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return Poses(moved, poses.angle + turn, poses.covariance)


def average(poses: Sequence[Poses]) -> Poses:
    """Mean of several poses (T, 1) of one thing, weighted by their covariances; NaN only where all are."""
    if len(poses) == 1:
        return poses[0]
    weights, sums = np.zeros((len(poses[0].angle), 1, 3, 3)), np.zeros((len(poses[0].angle), 1, 3))
    for pose in poses:
        state = np.concatenate([pose.xy, pose.angle[..., None]], axis=-1)
        known = np.isfinite(state).all(axis=-1)
        weight = np.linalg.inv(np.where(known[..., None, None], pose.covariance, np.eye(3))) * known[..., None, None]
        weights += weight
        sums += (weight @ np.where(known[..., None], state, 0.0)[..., None])[..., 0]
    none = np.asarray(~weights.any(axis=(-1, -2)))
    covariance = np.where(none[..., None, None], np.nan, np.linalg.inv(weights + none[..., None, None] * np.eye(3)))
    state = (covariance @ sums[..., None])[..., 0]
    return Poses(state[..., :2], state[..., 2], covariance)


def running_median(values: Array, count: int) -> Array:
    """Median over `count` rows around each row of `values` (T, n); the ends repeat."""
    padded = np.pad(values, ((count // 2, count // 2), (0, 0)), mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, count, axis=0), axis=-1))


def motion_remarks(pose: Poses, moving: bool, expected: bool) -> list[Remark]:
    """A remark where the base moves and nothing in recording.toml says that it should."""
    if not moving or expected:
        return []
    distance = 1000 * float(np.nanmax(np.linalg.norm(pose.xy - np.nanmedian(pose.xy, axis=0), axis=-1)))
    turn = float(np.degrees(np.nanmax(pose.angle) - np.nanmin(pose.angle)))
    return [
        Remark(
            "warning",
            f"The base moves in the picture, by up to {distance:.2f} mm and {turn:.2f} deg: clamp or camera was not "
            "still. It was followed from frame to frame. Fix both.",
            about="base moves",
        )
    ]
