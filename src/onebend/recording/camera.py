"""From corners in pixels to poses of the tags in metres and radians, with covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording import plane as planes
from onebend.recording.entries import CameraEntry, Recording, TagEntry, TagsEntry
from onebend.recording.signals import from_clamp, running_median
from onebend.records import POINT_ID, Array, BoolArray, Detections, Markers, OutlineTrack, Remark, View, rotated

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
    view: View, corners: Array, size: float, *, noise: float | None = None, refinements: int = 3
) -> tuple[Poses, Array, View]:
    """Pose of each sighting in the plane, its misfit (RMS residual, px), and the view with the corners' noise.

    The noise is that of the residuals, or `noise` [px, one sd]. Generalised least squares by Gauss-Newton on the eight
    coordinates of each tag; `corners` (T, m, 4, 2) px, NaN stays NaN."""
    xy, angle = planes.lay_square(planes.to_plane(view, corners))
    lying = planes.lying_of(view, corners.shape[-3])
    weight = corner_weight(corners)
    for _ in range(refinements):
        jacobian, residual = linearise(view, xy, angle, corners, size, lying)
        step = weighted_step(jacobian, residual, weight)
        xy, angle = xy + step[..., :2], angle + step[..., 2]
    jacobian, residual = linearise(view, xy, angle, corners, size, lying)
    squares = np.einsum("...i,...ij,...j->...", residual, weight, residual)
    sd = float(np.sqrt(np.nanmedian(squares) / MEDIAN_CHI2)) if noise is None else noise
    variance = np.maximum(squares / planes.DEGREES_OF_FREEDOM, sd**2)
    normal = np.swapaxes(jacobian, -1, -2) @ weight @ jacobian
    covariance = variance[..., None, None] * np.linalg.inv(normal) + grid_covariance(jacobian)
    poses = Poses(xy, angle, covariance)
    return poses, np.sqrt(squares / planes.DEGREES_OF_FREEDOM), replace(view, corner_sd=sd)


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

    The corners are crossings of lines fitted to noisy edge points. A line through many equally noisy points has the
    variance 4 at its ends and 1 in its middle, so the errors at the two ends have the correlation -1/2."""
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


def linearise(view: View, xy: Array, angle: Array, corners: Array, size: float, lying: Array) -> tuple[Array, Array]:
    """Jacobian (..., 8, 3) of the projected corners by (x, y, angle), and the residual (..., 8) of `corners`, px."""

    def projected(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> Array:
        seen = planes.project_tags(view, xy + np.array([dx, dy]), angle + turn, size, lying)
        return seen.reshape(*seen.shape[:-2], 8)

    columns = [(projected(**{name: STEP}) - projected(**{name: -STEP})) / (2 * STEP) for name in ("dx", "dy", "turn")]
    return np.stack(columns, axis=-1), corners.reshape(*corners.shape[:-2], 8) - projected()


def drop(poses: Poses, wrong: BoolArray) -> Poses:
    """The poses, NaN where `wrong`."""
    xy, angle, covariance = poses.xy.copy(), poses.angle.copy(), poses.covariance.copy()
    xy[wrong], angle[wrong], covariance[wrong] = np.nan, np.nan, np.nan
    return Poses(xy, angle, covariance)


def relative_to(origin: Poses, poses: Poses) -> Poses:
    """`poses` (T, m) in the frame of `origin` (T, 1), with the uncertainty of both."""
    xy = rotated(poses.xy - origin.xy, -origin.angle)
    cos, sin = np.broadcast_arrays(np.cos(origin.angle), np.sin(origin.angle), xy[..., 0])[:2]
    turn = np.zeros((*xy.shape[:-1], 3, 3))
    turn[..., 0, 0], turn[..., 0, 1], turn[..., 1, 0], turn[..., 1, 1], turn[..., 2, 2] = cos, sin, -sin, cos, 1.0
    back = -turn
    back[..., 0, 2], back[..., 1, 2] = xy[..., 1], -xy[..., 0]
    covariance = turn @ poses.covariance @ np.swapaxes(turn, -1, -2)
    covariance += back @ origin.covariance @ np.swapaxes(back, -1, -2)
    return Poses(xy, poses.angle - origin.angle, covariance)


def unwrap(angle: Array, *, from_zero: bool = True) -> Array:
    """Angles (T, ...) made continuous in time, the first one in (-pi, pi] if `from_zero`; NaN stays and is skipped."""
    flat = np.array(angle, dtype=float).reshape(len(angle), -1)
    for column in flat.T:
        known = np.isfinite(column)
        if known.any():
            continuous = np.unwrap(column[known])
            column[known] = continuous - from_zero * 2 * np.pi * np.round(continuous[0] / (2 * np.pi))
    return flat.reshape(angle.shape)


MOVED = 5.0  # sd: a base that is farther from its median pose, after a running median, moves
RUNNING = 5  # frames of that running median


def base_pose(poses: Poses, tags: Sequence[TagEntry], length: float) -> tuple[Poses, bool]:
    """Pose (T, 1) of the beam's frame, from the poses (T, b) of the base's tags, and whether it moves.

    The first tag lies at its own s on the x axis. A base that stands still has the median pose of all frames, and no
    covariance: its error is the same in every frame, as that of the mounting. Place and angle are judged apart, because
    a camera that shakes shifts the picture, and an angle that is followed carries its noise out to the tip."""
    pose = together(poses, [tag.s * length for tag in tags])
    state = np.concatenate([pose.xy[:, 0], pose.angle], axis=1)
    known = np.isfinite(state).all(axis=1)
    middle, typical = np.median(state[known], axis=0), np.median(pose.covariance[known, 0], axis=0)
    turns = _moves(state[known, 2:], middle[2:], typical[2:, 2:])
    if turns:
        return pose, True
    shifts = _moves(state[known, :2], middle[:2], typical[:2, :2])
    # sd: places that scatter by more show a camera that shakes.
    shakes = bool(np.any(np.std(state[known, :2], axis=0) > 2.0 * np.sqrt(np.diag(typical)[:2])))
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
    moved = poses.xy + rotated(np.median(difference.xy[both, 0], axis=0), poses.angle)
    return Poses(moved, poses.angle + float(np.median(difference.angle[both, 0])), poses.covariance)


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


FIRST = 5  # frames that tell how far apart tags are before they can have moved
FARTHEST = 99.0  # percentile of the distances that counts as the largest


def measure_markers(detections: Detections, description: Recording) -> Markers:
    """Pose of every beam tag relative to the base, per frame; raises as `measure_tags`."""
    return measure_tags(detections, description).markers()


@dataclass(frozen=True)
class MeasuredTags:
    """The tags of a recording in their plane."""

    detections: Detections
    description: Recording
    plane: planes.PlaneFit
    view: View  # with the corners' noise
    origin: Poses  # (T, 1) of the base
    relative: Poses  # (T, m) of the beam's tags to it
    remarks: tuple[Remark, ...]

    def markers(self, outline: OutlineTrack | None = None) -> Markers:
        """The beam's tags, and points of the body's `outline` in the same frames, which lie as high as the tags beside
        them; markers rise in s then."""
        detections, tags, relative, origin = self.detections, self.description.tags, self.relative, self.origin
        first = int(np.flatnonzero(np.isfinite(origin.angle))[0])
        s, tag_id, traced = np.array([tag.s for tag in tags.on_beam]), detections.tag_id[len(tags.on_base) :], None
        if outline is not None:
            height = height_along(self.view, tags, outline.s)
            points = relative_to(origin, points_in_plane(self.view, outline, height))
            pairs = zip(vars(relative).values(), vars(points).values(), strict=True)
            relative = Poses(*(np.concatenate(both, axis=1) for both in pairs))
            traced = np.arange(len(s) + len(outline.s)) >= len(s)
            tag_id = np.concatenate([tag_id, POINT_ID + np.rint(1e3 * outline.s).astype(int)])
            s = np.concatenate([s, outline.s])
        order = np.arange(len(s)) if traced is None else np.argsort(s, kind="stable")
        return Markers(
            time=detections.time,
            tag_id=tag_id[order],
            s=s[order],
            xy=relative.xy[:, order],
            angle=unwrap(relative.angle)[:, order],
            covariance=relative.covariance[:, order],
            base_angle=unwrap(origin.angle[:, 0] - origin.angle[first, 0]),
            view=planes.view_of(self.view, origin.xy[first, 0], float(origin.angle[first, 0])),
            remarks=(*self.remarks, *(() if outline is None else outline.remarks)),
            by_camera=by_camera(self.plane, detections.corners, tags, outline)[:, order],
            traced=None if traced is None else traced[order],
            width=None if outline is None else outline.width,
        )


def measure_tags(detections: Detections, description: Recording) -> MeasuredTags:
    """The tags' plane, and the pose of each of them in it, per frame.

    Tags lie near one plane, each at a height and a tilt of its own, and the camera stands still. A tag's pose is that
    of the square whose projected corners are nearest to the detected ones. The corners' noise comes from the residuals
    of the whole recording.

    Raises:
        RecordingError: the calibration is of another picture size.
        ObservationError: no plane explains the tags, or their distances contradict the beam's length.
    """
    tags, base = description.tags, len(description.tags.on_base)
    check_picture(detections, description.camera)
    plane = planes.fit_plane(
        spread(detections.corners), tags.size, description.camera, (detections.width, detections.height)
    )
    poses, misfit, view = measure_poses(plane.view, detections.corners, tags.size)
    # sd: a tag whose corners are further (RMS) from any square in the plane is not used.
    # px, least noise of the corners for that test.
    wrong = (misfit > 10.0 * max(view.corner_sd, 0.02)) | (planes.misshapen(view) & np.isfinite(misfit))
    poses = drop(poses, wrong)
    poses = replace(poses, angle=poses.angle - np.array([tag.turn for tag in (*tags.on_base, *tags.on_beam)]))
    if not np.isfinite(poses.angle[:, :base]).any():
        raise ObservationError(
            f"{description.name}: the base tag's shape fits no flat square of size_m in the plane of the other tags. "
            "Check that all tags have the same size and lie flat in one plane.",
            about="no plane",
        )
    origin, moving = base_pose(part(poses, slice(base)), tags.on_base, description.beam.length)
    relative = relative_to(origin, part(poses, slice(base, None)))
    check_lengths(relative.xy, description)
    moved = motion_remarks(origin, moving, description.gravity is not None)
    remarks = (*detections.remarks, *wrong_remarks(detections, wrong), *moved)
    return MeasuredTags(detections, description, plane, view, origin, relative, remarks)


def height_along(view: View, tags: TagsEntry, s: Array) -> Array:
    """(n,) m over the plane, at places `s` (n,) of the body: as high as the tags beside; without tags on it in the
    plane."""
    on_beam = sorted(zip((tag.s for tag in tags.on_beam), view.lying[len(tags.on_base) :, 0].tolist(), strict=True))
    return np.interp(s, *np.transpose(on_beam)) if on_beam else np.zeros(len(s))


def points_in_plane(view: View, outline: OutlineTrack, height: Array | float = 0.0) -> Poses:
    """The outline's points (T, n), without a place where they were not seen: alike in all directions, as only what is
    across the curve counts. Their angle is the curve's, no measurement of its own. `height` (n,) m over the plane."""
    along = outline.ahead - outline.px
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1) / length
    seen_at = (outline.px, outline.ahead, outline.px + across)
    xy, ahead, beside = (planes.lowered(view, planes.to_plane(view, px), height) for px in seen_at)
    sd = outline.sd * np.linalg.norm(beside - xy, axis=-1)
    turn = sd / np.linalg.norm(ahead - xy, axis=-1)
    covariance = np.stack([sd, sd, turn], axis=-1)[..., None] ** 2 * np.eye(3)
    seen = np.isfinite(outline.sd)[..., None]
    return Poses(np.where(seen, xy, np.nan), np.arctan2(*np.moveaxis(ahead - xy, -1, 0)[::-1]), covariance)


def check_picture(detections: Detections, camera: CameraEntry | None) -> None:
    """An error where the calibration belongs to another picture size."""
    if camera and (camera.width, camera.height) != (detections.width, detections.height):
        raise RecordingError(
            f"[camera] is calibrated for pictures of {camera.width} x {camera.height}, the video has "
            f"{detections.width} x {detections.height}. Calibrate at the video's size, or remove [camera]."
        )


def spread(corners: Array) -> Array:
    """Sightings (T, m, 4, 2) of frames spread evenly over the tags' travel, in which a rest has a small weight."""
    centre = corners.mean(axis=2)
    travel = np.nan_to_num(np.linalg.norm(np.diff(centre, axis=0), axis=-1)).sum(axis=1)
    # Of the mean travel per frame: a frame without travel counts as this.
    travelled = np.concatenate([[0.0], np.cumsum(travel + 0.1 * travel.sum() / len(centre) + 1e-9)])
    frames = np.unique(
        # Frames for the fit of the plane, spread evenly over the tags' travel.
        np.searchsorted(travelled, np.linspace(0, travelled[-1], min(150, len(travelled))))
    )
    return corners[frames]


def by_camera(plane: planes.PlaneFit, corners: Array, tags: TagsEntry, outline: OutlineTrack | None = None) -> Array:
    """(T, m, 3, n) m, m, rad: how the poses of the beam's tags, and then of the outline's points, relative to the first
    base tag move with one sd of each of the n unknowns of the plane, the tags' heights and, without a calibration, the
    camera. A hidden base counts as where it was seen nearest in time; zero for tags that were not seen."""
    base = len(tags.on_base)
    first, shown = lasting_base(corners[:, :base])
    corners, which = np.concatenate([shown, corners[:, base:]], axis=1), [first, *range(base, corners.shape[1])]

    def relative(view: View) -> Array:
        xy, angle = planes.lay_square(planes.to_plane(view, corners))
        xy = planes.lowered(view, xy, view.lying[which, 0])
        if outline is not None:
            points = points_in_plane(view, outline, height_along(view, tags, outline.s))
            xy, angle = np.concatenate([xy, points.xy], axis=1), np.concatenate([angle, points.angle], axis=1)
        none = np.zeros((*angle.shape, 3, 3))
        own = relative_to(Poses(xy[:, :1], angle[:, :1], none[:, :1]), Poses(xy[:, 1:], angle[:, 1:], none[:, 1:]))
        return np.concatenate([own.xy, own.angle[..., None]], axis=-1)

    middle = relative(plane.view)
    shifts = np.stack([relative(view) - middle for view in plane.variations()], axis=-1)
    shifts[:, :, 2] = np.angle(np.exp(1j * shifts[:, :, 2]))
    return np.nan_to_num(shifts)


def lasting_base(corners: Array) -> tuple[int, Array]:
    """The first base tag that is ever seen, and its corners (T, 1, 4, 2) in every frame, from those of all
    (T, b, 4, 2)."""
    visible = np.asarray(np.isfinite(corners).all(axis=(2, 3)))
    tag = int(np.argmax(visible.any(axis=0)))
    shown = np.flatnonzero(visible[:, tag])
    frames = np.arange(len(corners))
    after = np.clip(np.searchsorted(shown, frames), 0, len(shown) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(shown[before] - frames) < np.abs(shown[after] - frames), shown[before], shown[after])
    return tag, np.asarray(corners[nearest, tag : tag + 1])


def check_lengths(xy: Array, rec: Recording, base: str = "the base", kind: str = "tag", hint: str = "") -> None:
    """An error where neighbours (T, m, 2) [m], in the base's frame, are farther apart than the beam between them, or
    always much nearer. `hint`: what else may be wrong than the tags' size."""
    places = [(0.0, base, np.zeros((len(xy), 2)))]
    places += [(tag.s, f"{kind} {tag.id}", xy[:, i]) for i, tag in enumerate(rec.tags.on_beam)]
    places.sort(key=lambda place: place[0])
    ratios, worst, loose = [], "", ""
    slack = 3 * np.sqrt(2) * rec.tags.placement_sd
    for (s, name, position), (next_s, next_name, next_position) in pairwise(places):
        distance, arc = np.linalg.norm(next_position - position, axis=1), (next_s - s) * rec.beam.length
        distance = distance[np.isfinite(distance)]
        if not len(distance) or arc == 0.0:
            continue
        farthest, first = float(np.percentile(distance, FARTHEST)), float(np.median(distance[:FIRST]))
        ratios.append(farthest / arc)
        # Of the arc: a chord is never longer, and 0.6 of it only where the beam turns by 200 degrees.
        if not worst and not 0.6 * arc - slack <= farthest <= 1.05 * arc + slack:
            worst = (
                f"{name} and {next_name} are {1000 * farthest:.4g} mm apart at most, recording.toml puts "
                f"{1000 * arc:.4g} mm of beam between them."
            )
            if abs(first - arc) <= 0.05 * arc + slack < farthest - arc:
                loose = f"At first it is {1000 * first:.4g} mm: one slid or came off. Glue it, and record anew."
    if not worst:
        return
    order, size, ratio = order_hint(xy, rec), 1000 * rec.tags.size, float(np.median(ratios))
    other = not order and abs(ratio - 1.0) > 0.02  # one size that is nearly right explains nothing
    fits = f"size_m (now {size:g} mm; about {size / ratio:.3g} mm would fit), " if other else ""
    remedy = loose or hint or f"Correct {fits}length_m (now {1000 * rec.beam.length:g} mm) or the tags' s."
    about = "loose" if loose else "unit" if hint else "tag places"
    raise ObservationError(f"{rec.name}: {worst}{'' if loose else order} {remedy}", about=about)


def order_hint(xy: Array, rec: Recording) -> str:
    """The order in which the beam's tags (T, m, 2) [m] stand, where it is not that of their s: a sentence, or ""."""
    tags = rec.tags.on_beam
    if not np.isfinite(xy).all(axis=-1).any(axis=0).all():
        return ""
    reach = np.nanpercentile(np.linalg.norm(xy, axis=-1), FARTHEST, axis=0)
    stand = [tags[i].id for i in np.argsort(reach, kind="stable")]
    written = [tag.id for tag in sorted(tags, key=lambda tag: tag.s)]
    if stand == written:
        return ""
    said = ", ".join(map(str, stand))
    return f" From the base on they stand in the order {said}, by their s in the order {', '.join(map(str, written))}."


def wrong_remarks(detections: Detections, wrong: BoolArray) -> list[Remark]:
    """A remark for each tag whose shape contradicts the plane in some frames."""
    return [
        Remark("note", f"Tag {tag} was left out in {count} frames: its shape does not fit a flat square in the plane.")
        for tag, count in zip(detections.tag_id.tolist(), wrong.sum(axis=0).tolist(), strict=True)
        if count
    ]


NEAREST = 0.05  # of the beam: the chord of tags nearer to each other gives no direction


def with_checked_turns(markers: Markers, rec: Recording) -> Markers:
    """The same markers. An error where a tag points across the beam, or backwards, in most frames, by the chords to its
    neighbours."""
    order = np.argsort(markers.s, kind="stable")
    order = order[markers.s[order] > NEAREST]
    ids = [rec.tags.on_base[0].id, *markers.tag_id[order].tolist()]
    s, places, tag_angle = from_clamp(markers.s[order], markers.xy[:, order], markers.angle[:, order])
    complete = np.isfinite(places).all(axis=(1, 2))
    if not complete.any() or len(s) < 2 or np.any(np.diff(s) < NEAREST):
        return markers
    off = np.angle(np.exp(1j * (tag_angle[complete] - directions(places[complete]))))
    # Between a tag and the beam there: bending does not make that in most frames.
    wrong = np.median(np.cos(off), axis=0) < np.cos(np.deg2rad(60.0))
    if not wrong.any():
        return markers
    written = {tag.id: tag.turn for tag in (*rec.tags.on_base, *rec.tags.on_beam)}
    wrong_tags = []
    for i in np.flatnonzero(wrong):
        quarter = 90 * round(float(np.rad2deg(np.angle(np.mean(np.exp(1j * off[:, i]))))) / 90)
        fits = 180 - (180 - round(float(np.rad2deg(written[ids[i]]))) - quarter) % 360
        wrong_tags.append(f"tag {ids[i]} (turn_deg = {np.rad2deg(written[ids[i]]):.4g}; {fits} would fit)")
    raise ObservationError(
        f"{rec.name}: seen from the line of the tags these are turned otherwise than recording.toml says: "
        f"{', '.join(wrong_tags)}. Correct turn_deg in [tags]: a tag's right-hand side against the beam's direction.",
        about="tag places",
    )


def directions(places: Array) -> Array:
    """(T, n) rad, of the line through places (T, n, 2): from the chords beside each, straight on at the ends."""
    chord = np.diff(places, axis=1)
    angle = np.unwrap(np.arctan2(chord[..., 1], chord[..., 0]), axis=1)
    bend = np.diff(angle, axis=1) if angle.shape[1] > 1 else np.zeros((len(angle), 1))
    first, last = angle[:, :1] - 0.5 * bend[:, :1], angle[:, -1:] + 0.5 * bend[:, -1:]
    return np.concatenate([first, 0.5 * (angle[:, 1:] + angle[:, :-1]), last], axis=1)
