"""Corners in pixels to the pose of every beam tag in the base tag's frame, in metres and radians, with covariance."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording.camera.base import base_pose, motion_remarks
from onebend.recording.camera.lens import to_plane
from onebend.recording.camera.plane import PlaneFit, fit_plane, lay_square
from onebend.recording.camera.tag_poses import Poses, drop, measure_poses, part, relative_to, unwrap
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.source_entries import CameraEntry
from onebend.records import Array, BoolArray, Detections, Markers, Remark, View

CALIBRATION_FRAMES = 150  # frames for the fit of the plane, spread evenly over the tags' travel
RESTING = 0.1  # of the mean travel per frame: a frame without travel counts as this
WRONG = 10.0  # sd: a tag whose corners are further (RMS) from any square in the plane is not used
LEAST_SD = 0.02  # px, least noise of the corners for that test
TOO_LONG, TOO_SHORT = 1.05, 0.6  # of the arc between two tags: their largest distance lies between these
FARTHEST = 99.0  # percentile of the distances that counts as the largest


def measure_markers(detections: Detections, recording: Recording) -> Markers:
    """Pose of every beam tag relative to the base, per frame.

    Assumes that all tags lie in one plane and that the camera stands still. A tag's pose is that of the square of the
    known size whose projected corners are nearest to the detected ones. The noise of a corner comes from the residuals
    of the whole recording; it is larger where a tag's own residuals are.

    Raises:
        RecordingError: the calibration is of another picture size.
        ObservationError: no plane explains the tags, or their distances contradict the beam's length.
    """
    tags, base = recording.tags, len(recording.tags.on_base)
    check_picture(detections, recording.camera)
    plane = fit_plane(spread(detections.corners), tags.size, recording.camera, (detections.width, detections.height))
    poses, misfit, view = measure_poses(plane.view, detections.corners, tags.size)
    wrong = misfit > WRONG * max(view.corner_sd, LEAST_SD)
    poses = drop(poses, wrong)
    poses = replace(poses, angle=poses.angle - np.array([tag.turn for tag in (*tags.on_base, *tags.on_beam)]))
    if not np.isfinite(poses.angle[:, :base]).any():
        raise ObservationError(
            f"{recording.name}: the base tag's shape fits no flat square of size_m in the plane of the other tags. "
            "Check that all tags have the same size and lie flat in one plane.",
            about="no plane",
        )
    origin, moving = base_pose(part(poses, slice(base)), tags.on_base, recording.beam.length)
    relative = relative_to(origin, part(poses, slice(base, None)))
    check_lengths(relative.xy, recording)
    first = int(np.flatnonzero(np.isfinite(origin.angle))[0])
    return Markers(
        time=detections.time,
        tag_id=detections.tag_id[base:],
        s=np.array([tag.s for tag in tags.on_beam]),
        xy=relative.xy,
        angle=unwrap(relative.angle),
        covariance=relative.covariance,
        base_angle=unwrap(origin.angle[:, 0] - origin.angle[first, 0]),
        view=view_of(view, origin.xy[first, 0], float(origin.angle[first, 0])),
        remarks=(
            *detections.remarks,
            *wrong_remarks(detections, wrong),
            *motion_remarks(origin, moving, recording.gravity is not None),
        ),
        by_camera=by_camera(plane, detections.corners, base),
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
    push; a rest has a small weight."""
    centre = corners.mean(axis=2)
    travel = np.nan_to_num(np.linalg.norm(np.diff(centre, axis=0), axis=-1)).sum(axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(travel + RESTING * travel.sum() / len(centre) + 1e-9)])
    frames = np.unique(
        np.searchsorted(travelled, np.linspace(0, travelled[-1], min(CALIBRATION_FRAMES, len(travelled))))
    )
    chosen = corners[frames].reshape(-1, 4, 2)
    return chosen[np.isfinite(chosen).all(axis=(1, 2))]


def by_camera(plane: PlaneFit, corners: Array, base: int) -> Array:
    """(T, m, 3, n) m, m, rad: how the beam tags' poses relative to the first base tag move with one sd of each of the n
    unknowns of the plane and, without a calibration, of the camera. A hidden base counts as where it was seen nearest
    in time; zero for tags that were not seen."""
    corners = np.concatenate([lasting_base(corners[:, :base]), corners[:, base:]], axis=1)

    def relative(view: View) -> Array:
        xy, angle = lay_square(to_plane(view, corners))
        none = np.zeros((*angle.shape, 3, 3))
        own = relative_to(Poses(xy[:, :1], angle[:, :1], none[:, :1]), Poses(xy[:, 1:], angle[:, 1:], none[:, 1:]))
        return np.concatenate([own.xy, own.angle[..., None]], axis=-1)

    middle = relative(plane.view)
    shifts = np.stack([relative(view) - middle for view in plane.variations()], axis=-1)
    shifts[:, :, 2] = np.angle(np.exp(1j * shifts[:, :, 2]))
    return np.nan_to_num(shifts)


def lasting_base(corners: Array) -> Array:
    """(T, 1, 4, 2) corners of the first base tag that is ever seen, in every frame, from those of all (T, b, 4, 2)."""
    visible = np.asarray(np.isfinite(corners).all(axis=(2, 3)))
    tag = int(np.argmax(visible.any(axis=0)))
    shown = np.flatnonzero(visible[:, tag])
    frames = np.arange(len(corners))
    after = np.clip(np.searchsorted(shown, frames), 0, len(shown) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(shown[before] - frames) < np.abs(shown[after] - frames), shown[before], shown[after])
    return np.asarray(corners[nearest, tag : tag + 1])


def chord_fits(farthest: float, arc: float, slack: float) -> bool:
    """Whether `farthest` [m] can be the largest distance of two places on a beam with `arc` [m] between them.

    A chord is never longer than its arc, and it is 0.6 of it only where the beam turns by 200 degrees in between.
    """
    return TOO_SHORT * arc - slack <= farthest <= TOO_LONG * arc + slack


def check_lengths(xy: Array, recording: Recording) -> None:
    """An error where neighbouring tags are farther apart than the beam between them, or always much nearer.

    `xy` (T, m, 2) m in the base's frame.
    """
    tags, length = recording.tags, recording.beam.length
    places = [(0.0, "the base", np.zeros((len(xy), 2)))]
    places += [(tag.s, f"tag {tag.id}", xy[:, i]) for i, tag in enumerate(tags.on_beam)]
    places.sort(key=lambda place: place[0])
    ratios, worst = [], ""
    for (s, name, position), (next_s, next_name, next_position) in pairwise(places):
        distance = np.linalg.norm(next_position - position, axis=1)
        arc, slack = (next_s - s) * length, 3 * np.sqrt(2) * tags.placement_sd
        if not np.isfinite(distance).any() or arc == 0.0:
            continue
        farthest = float(np.nanpercentile(distance, FARTHEST))
        ratios.append(farthest / arc)
        if not worst and not chord_fits(farthest, arc, slack):
            worst = (
                f"{name} and {next_name} are {1000 * farthest:.3g} mm apart at most, recording.toml puts "
                f"{1000 * arc:.3g} mm of beam between them"
            )
    if worst:
        fitting = 1000 * tags.size / float(np.median(ratios))
        raise ObservationError(
            f"{recording.name}: {worst}.{order_hint(xy, recording)} Correct size_m (now {1000 * tags.size:g} mm; about "
            f"{fitting:.3g} mm would fit), length_m (now {1000 * length:g} mm) or the tags' s.",
            about="tag places",
        )


def order_hint(xy: Array, recording: Recording) -> str:
    """The order in which the beam's tags (T, m, 2) [m] stand, where it is not that of their s: a sentence, or ""."""
    tags = recording.tags.on_beam
    if not np.isfinite(xy).all(axis=-1).any(axis=0).all():
        return ""
    reach = np.nanpercentile(np.linalg.norm(xy, axis=-1), FARTHEST, axis=0)
    stand = [tags[i].id for i in np.argsort(reach, kind="stable")]
    written = [tag.id for tag in sorted(tags, key=lambda tag: tag.s)]
    if stand == written:
        return ""
    said = ", ".join(map(str, stand))
    return f" From the base on they stand in the order {said}, by their s in the order {', '.join(map(str, written))}."


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
