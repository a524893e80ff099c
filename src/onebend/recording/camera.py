"""Corners in pixels --> pose of every beam tag in the base tag's frame, in metres and radians, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.entries import CameraEntry, Recording
from onebend.recording.lens import project as project
from onebend.recording.lens import to_plane
from onebend.recording.plane import FREEDOMS, PlaneFit, fit_plane, lay_square, square
from onebend.records import Array, BoolArray, Detections, Markers, Remark, View

CALIBRATION_FRAMES = 150  # frames that fix the camera's plane, spread evenly over the tags' travel
REFINEMENTS = 3  # Gauss-Newton steps of a tag's pose; the first is already within a hundredth of a pixel
END_CORRELATION = -0.5  # of the errors at the two ends of a straight edge
STEP = 1e-6  # m and rad, of the pose's numerical derivative
MEDIAN_CHI2 = 4.35146  # median of chi-squared with 5 degrees of freedom
WRONG = 10.0  # sd: a tag whose corners are further (RMS) from any square in the plane is not used
GRID_ERROR = 0.03  # px, one sd: shift of a whole tag that its shape does not betray (pixel grid, compression)
MOVED = 5.0  # sd: a base tag further from its middle place, after a running median, moves
RUNNING = 5  # frames of that running median


@dataclass(frozen=True)
class Poses:
    """Planar poses with their covariance; leading dimensions are free."""

    xy: Array  # (..., 2) m
    angle: Array  # (...) rad
    covariance: Array  # (..., 3, 3) of (x, y, angle)


def measure_markers(detections: Detections, recording: Recording) -> Markers:
    """Pose of every beam tag relative to the base, per frame.

    Assumes that all tags lie in one plane and that the camera stands still. A tag's pose is the square of the known
    size whose corners, seen through the lens, come nearest to the detected ones. The noise of a corner is that of the
    recording (from what no square explains), more where a tag's own corners fit worse.

    Raises
    ------
    RecordingError
        The calibration is of another picture size.
    ObservationError
        No plane explains the tags, or their distances contradict the beam's length.
    """
    tags, base = recording.tags, len(recording.tags.on_base)
    check_picture(detections, recording.camera)
    plane = fit_plane(spread(detections.corners), tags.size, recording.camera, (detections.width, detections.height))
    poses, misfit, view = measure_poses(plane.view, detections.corners, tags.size)
    wrong = misfit > WRONG * view.corner_sd
    poses = drop(poses, wrong)
    turns = np.array([tag.turn for tag in (*tags.on_base, *tags.on_beam)])
    poses = replace(poses, angle=poses.angle - turns)
    origin = base_pose(poses)
    relative = relative_to(origin, Poses(poses.xy[:, base:], poses.angle[:, base:], poses.covariance[:, base:]))
    doubt = plane_doubt(plane, detections.corners, base)
    first = int(np.flatnonzero(np.isfinite(origin.angle))[0])
    return Markers(
        time=detections.time,
        tag_id=detections.tag_id[base:],
        s=np.array([tag.s for tag in tags.on_beam]),
        xy=relative.xy,
        angle=unwrap(relative.angle),
        covariance=relative.covariance + doubt,
        base_angle=unwrap(origin.angle[:, 0] - origin.angle[first, 0]),
        view=view_of(view, origin.xy[first, 0], float(origin.angle[first, 0])),
        remarks=(*detections.remarks, *wrong_remarks(detections, wrong)),
    )


def check_picture(detections: Detections, camera: CameraEntry | None) -> None:
    """An error where the calibration belongs to another picture size."""
    if camera and (camera.width, camera.height) != (detections.width, detections.height):
        raise RecordingError(
            f"[camera] is calibrated for pictures of {camera.width} x {camera.height}, the video has "
            f"{detections.width} x {detections.height}. Calibrate at the video's size, or remove [camera]."
        )


def spread(corners: Array) -> Array:
    """Sightings (K, 4, 2) of frames spread evenly over the tags' travel, so that a long rest does not outweigh the
    push. Also a rest counts a little."""
    centre = corners.mean(axis=2)
    travel = np.nan_to_num(np.linalg.norm(np.diff(centre, axis=0), axis=-1)).sum(axis=1)
    way = np.concatenate([[0.0], np.cumsum(travel + 0.1 * travel.mean() + 1e-9)])
    frames = np.unique(np.searchsorted(way, np.linspace(0, way[-1], min(CALIBRATION_FRAMES, len(way)))))
    chosen = corners[frames].reshape(-1, 4, 2)
    return chosen[np.isfinite(chosen).all(axis=(1, 2))]


def measure_poses(view: View, corners: Array, size: float) -> tuple[Poses, Array, View]:
    """Pose of each sighting in the plane, how far its corners are from that square, and the view with their noise.

    `corners` (T, m, 4, 2) px; a sighting with a NaN stays NaN. Generalised least squares by Gauss-Newton on the eight
    coordinates of each tag. The misfit is the RMS left over, in px, comparable with the view's `corner_sd`.
    """
    xy, angle = lay_square(to_plane(view, corners))
    weight = corner_weight(corners)
    for _ in range(REFINEMENTS):
        jacobian, left = linearise(view, xy, angle, corners, size)
        step = weighted_step(jacobian, left, weight)
        xy, angle = xy + step[..., :2], angle + step[..., 2]
    jacobian, left = linearise(view, xy, angle, corners, size)
    squares = np.einsum("...i,...ij,...j->...", left, weight, left)
    sd = float(np.sqrt(np.nanmedian(squares) / MEDIAN_CHI2))
    variance = np.maximum(squares / FREEDOMS, sd**2)
    normal = np.swapaxes(jacobian, -1, -2) @ weight @ jacobian
    covariance = variance[..., None, None] * np.linalg.inv(normal) + grid_covariance(jacobian)
    poses = Poses(xy, angle, covariance)
    return poses, np.sqrt(squares / FREEDOMS), replace(view, corner_sd=sd)


def grid_covariance(jacobian: Array) -> Array:
    """Covariance (..., 3, 3) of a pose for a shift of all four corners together by `GRID_ERROR`."""
    place = jacobian[..., :2].reshape(*jacobian.shape[:-2], 4, 2, 2).mean(axis=-3)  # px per metre
    metre = np.linalg.inv(place)
    covariance = np.zeros((*jacobian.shape[:-2], 3, 3))
    covariance[..., :2, :2] = GRID_ERROR**2 * metre @ np.swapaxes(metre, -1, -2)
    return covariance


def weighted_step(jacobian: Array, left: Array, weight: Array) -> Array:
    """The generalised least-squares solution (..., 3) of `jacobian @ step = left`."""
    across = np.swapaxes(jacobian, -1, -2) @ weight
    return np.asarray(np.linalg.solve(across @ jacobian, across @ left[..., None])[..., 0])


def corner_weight(corners: Array) -> Array:
    """Inverse covariance (..., 8, 8) of the corners' errors, for errors of unit variance along each edge's normal.

    A detector puts straight lines through noisy edge points and calls their crossings corners. So an error is one of
    an edge, along its normal, and the errors at the two ends of an edge are correlated by -1/2: a line through many
    equally noisy points has the variance 4 at its ends and 1 in its middle.
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


def plane_doubt(plane: PlaneFit, corners: Array, base: int) -> Array:
    """Covariance (T, m, 3, 3) of the beam tags' poses relative to the first base tag that comes from not knowing the
    plane and, uncalibrated, the camera exactly."""

    def relative(view: View) -> Array:
        xy, angle = lay_square(to_plane(view, corners))
        none = np.zeros((*angle.shape, 3, 3))
        own = relative_to(
            Poses(xy[:, :1], angle[:, :1], none[:, :1]), Poses(xy[:, base:], angle[:, base:], none[:, base:])
        )
        return np.concatenate([own.xy, own.angle[..., None]], axis=-1)

    middle = relative(plane.view)
    shifts = [relative(view) - middle for view in plane.variations()]
    return np.asarray(sum(shift[..., :, None] * shift[..., None, :] for shift in shifts))


def linearise(view: View, xy: Array, angle: Array, corners: Array, size: float) -> tuple[Array, Array]:
    """Derivative (..., 8, 3) of the projected corners by (x, y, angle); what they miss of `corners` (..., 8), px."""

    def seen(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Array:
        flat = project(view, square(xy + np.array([dx, dy]), angle + turn, size))
        return flat.reshape(*flat.shape[:-2], 8)

    columns = [(seen(**{way: STEP}) - seen(**{way: -STEP})) / (2 * STEP) for way in ("dx", "dy", "turn")]
    return np.stack(columns, axis=-1), corners.reshape(*corners.shape[:-2], 8) - seen()


def drop(poses: Poses, wrong: BoolArray) -> Poses:
    """The poses, NaN where `wrong`."""
    return Poses(
        np.where(wrong[..., None], np.nan, poses.xy),
        np.where(wrong, np.nan, poses.angle),
        np.where(wrong[..., None, None], np.nan, poses.covariance),
    )


def base_pose(poses: Poses) -> Poses:
    """Pose (T, 1) of the base: of its first tag, its middle over all frames where it stands still.

    The uncertainty of that middle is taken as that of a single frame: the detector's error at one place of the pixel
    grid is the same in every frame and does not average out.
    """
    xy, angle, covariance = poses.xy[:, :1], poses.angle[:, :1], poses.covariance[:, :1]
    angle = unwrap(angle)
    state = np.concatenate([xy[:, 0], angle], axis=1)
    known = np.isfinite(state).all(axis=1)
    middle = np.median(state[known], axis=0)
    typical = np.median(covariance[known, 0], axis=0)
    smooth = running_median(state[known], RUNNING) - middle
    chi2 = np.einsum("ti,ij,tj->t", smooth, np.linalg.inv(typical), smooth)
    if (chi2 > MOVED**2).any():
        return Poses(xy, angle, covariance)
    frames = len(xy)
    return Poses(
        np.broadcast_to(middle[:2], (frames, 1, 2)),
        np.broadcast_to(middle[2:], (frames, 1)),
        np.broadcast_to(typical, (frames, 1, 3, 3)),
    )


def running_median(values: Array, count: int) -> Array:
    """Median over `count` rows around each row of `values` (T, n); the ends repeat."""
    padded = np.pad(values, ((count // 2, count // 2), (0, 0)), mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, count, axis=0), axis=-1))


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
    """Angles (T, ...) made continuous in time, the first one in (-pi, pi]; NaN stays and is stepped over."""
    flat = np.array(angle, dtype=float).reshape(len(angle), -1)
    for column in flat.T:
        known = np.isfinite(column)
        if known.any():
            whole = np.unwrap(column[known])
            column[known] = whole - 2 * np.pi * np.round(whole[0] / (2 * np.pi))
    return flat.reshape(angle.shape)


def view_of(view: View, origin: Array, angle: float) -> View:
    """The same view, of a frame of the plane with its origin at `origin` (2,) [m] and turned by `angle`."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return replace(
        view,
        rotation=view.rotation @ turn,
        translation=view.rotation[:, :2] @ origin + view.translation,
    )


def wrong_remarks(detections: Detections, wrong: BoolArray) -> list[Remark]:
    """A remark for each tag whose shape contradicts the plane in some frames."""
    return [
        Remark("note", f"Tag {tag} was left out in {count} frames: its shape does not fit a flat square in the plane.")
        for tag, count in zip(detections.tag_id.tolist(), wrong.sum(axis=0).tolist(), strict=True)
        if count
    ]
