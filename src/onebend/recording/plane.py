"""The plane of the tags as a camera sees it: projection, and the fit of camera and plane to the tags' corners."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from onebend.errors import ObservationError
from onebend.recording.entries import CameraEntry
from onebend.records import Array, BoolArray, IntArray, View, rotated


def project(view: View, points: Array) -> Array:
    """Pixels (..., 2) of points (..., 2) [m] of the plane, or (..., 3) with their heights towards the camera."""
    inside = points @ np.swapaxes(view.rotation[..., : points.shape[-1]], -1, -2) + view.translation
    return _after(np.swapaxes(view.matrix[..., :2, :], -1, -2), distort(inside[..., :2] / inside[..., 2:], view.dist))


def to_plane(view: View, px: Array) -> Array:
    """Points (..., 2) [m] of the plane that are seen at pixels `px` (..., 2). NaN where no such point exists."""
    ray = undistort(_after(np.swapaxes(np.linalg.inv(view.matrix)[..., :2, :], -1, -2), px), view.dist)
    direction = _after(view.rotation, ray)  # in the plane's axes
    origin = -view.translation @ view.rotation  # the camera, in the plane's axes
    reach = -origin[..., 2:] / direction[..., 2:]
    return np.where(reach > 0, origin[..., :2] + reach * direction[..., :2], np.nan)


def _after(matrix: Array, points: Array) -> Array:
    """(..., n) from `matrix` (3, n) and points (..., 2), whose third coordinate is 1."""
    return np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ matrix


def distort(ray: Array, dist: Array) -> Array:
    """What the lens does to a normalised image point (x/z, y/z): radial k1, k2, k3 and tangential p1, p2."""
    k1, k2, p1, p2, k3 = np.moveaxis(dist, -1, 0)
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
    """The inverse of `distort`, by fixed-point iteration; NaN where it does not converge: the lens model folds over."""
    ray = distorted
    for _ in range(50):
        error = distorted - distort(ray, dist)
        # Of the normalised image, far below a thousandth of a pixel.
        if not np.nanmax(np.abs(error), initial=0.0) > 1e-10:
            return ray
        ray = ray + error
        ray = np.where(np.abs(ray) < 1e3, ray, np.nan)
    return np.where(np.abs(distorted - distort(ray, dist)).max(axis=-1, keepdims=True) <= 1e-6, ray, np.nan)


def camera_place(view: View) -> tuple[Array, float]:
    """(2,) m foot of the camera in the plane of the tags, and its distance from the plane [m]."""
    place = -view.rotation.T @ view.translation
    return np.asarray(place[:2]), float(abs(place[2]))


def lean_of(view: View, xy: Array) -> float:
    """By how much a point over the plane at `xy` (T, 2) m seems to lie beside its place, over its height: median."""
    foot, distance = camera_place(view)
    return float(np.median(np.linalg.norm(xy - foot, axis=1))) / distance


def scale_of(view: View, length: float) -> float:
    """px/m along a straight body of this length [m] in the view's frame."""
    ends = project(view, np.array([[0.0, 0.0], [length, 0.0]]))
    return float(np.linalg.norm(ends[1] - ends[0])) / length


def view_of(view: View, origin: Array, angle: float) -> View:
    """The same view, of a frame of the plane with its origin at `origin` (2,) [m] and turned by `angle`."""
    turn = Rotation.from_euler("z", angle).as_matrix()
    return replace(view, rotation=view.rotation @ turn, translation=view.rotation[:, :2] @ origin + view.translation)


# The view of the tags' plane. For a trial camera and plane every sighting is projected into the plane, and a square of
# the known size is fitted in closed form. The residuals are its corners' distances from the detected ones, px. Three
# numbers (tilt, tilt, distance) are fitted; seven without calibration (focal length, one lens term, principal point);
# and eleven for each tag, for no real tag lies exactly in the plane or is printed exactly: height, two slopes, corners.

# The plane's axes when it faces the camera: x right, y up, z towards the camera.
FACING: Array = np.diag([1.0, -1.0, -1.0])
TILTS = (0.0, 0.6)  # rad, starts of the search, in each of four directions
# Priors of the plane, and of a camera without calibration: one sd about the simplest value.
TILT_SD = 0.5  # rad; it matters only where one tag alone leaves the tilt open
PLAIN_FOCAL = 1.0  # focal length over the picture's longer side
FOCAL_SD = 0.5  # of its logarithm
LENS_SD = 0.1  # k1
CENTRE_SD = 0.02  # principal point off the picture's middle, over the longer side
# Of each tag against the plane, one sd: glued to a body by hand.
HEIGHT_SD = 2e-3  # m
SLOPE_SD = 0.03  # rad, about each of its axes
STEEPEST, MOST_OFF = 0.35, 10.0  # rad, and sd of a corner: tags that are farther off are no squares in a plane
PRINT_SD = 2e-5  # m, of a corner: an edge is rounded to the printer's dots, of 0.04 to 0.08 mm
LYING_SD: Array = np.array([HEIGHT_SD, SLOPE_SD, SLOPE_SD, *[PRINT_SD] * 8])
NORMAL_MEDIAN = 0.67449  # median of |x|, x normal with unit variance
DEGREES_OF_FREEDOM = 5  # a tag's eight coordinates less the three of its pose
# What no lens model holds distorts a tag by this share of its side, alike in a part of the picture: it does not average
# out over the sightings there. A good calibration leaves 0.1 to 0.3 px in a picture of 1000 px.
FIELD_ERROR = 5e-4
ZONES = 12  # such parts, of all that the tags move through
LEAST_NOISE, UNTOLD_NOISE, MOST_NOISE = 0.02, 0.1, 0.1  # of a corner: px, px, and in sides of a tag
FARTHEST_LOG = 50.0  # a search that goes on beyond ends in no number
OUT_OF_SIGHT = 1e3  # px, residual of a corner that a trial camera cannot see


@dataclass(frozen=True)
class PlaneModel:
    """What is unknown of plane and camera, and of tags that lie nearly in the plane.

    Two tilts [rad] and the log of the distance [m] of the plane; then, where the camera is not calibrated, the log of
    the focal length over its plain value, k1, and the principal point's shift over the longer side; then of each tag
    the eleven of `View.lying` over their sds. Without these the tags are squares in the plane.
    """

    camera: CameraEntry | None
    picture: tuple[int, int]  # px

    @property
    def count(self) -> int:
        """Unknowns of plane and camera."""
        return 3 if self.camera else 7

    def view(self, unknowns: Array) -> View:
        """Of unknowns (p,); of several at once (V, p) one whose parts broadcast against points (V, K, 4, 2)."""
        lead, ones = unknowns.shape[:-1], (1,) * (unknowns.ndim - 1)
        matrix, dist, translation = (np.zeros((*lead, *shape)) for shape in ((3, 3), (5,), (3,)))
        matrix[..., 2, 2] = 1.0
        if self.camera:
            matrix[..., [0, 1], [0, 1]] = self.camera.fx, self.camera.fy
            matrix[..., :2, 2] = self.camera.cx, self.camera.cy
            dist[..., : len(self.camera.dist)] = self.camera.dist
        else:
            long, middle = max(self.picture), 0.5 * (np.array(self.picture) - 1.0)
            matrix[..., [0, 1], [0, 1]] = PLAIN_FOCAL * long * np.exp(np.minimum(unknowns[..., 3:4], FARTHEST_LOG))
            matrix[..., :2, 2] = middle + unknowns[..., 5:7] * long
            dist[..., 0] = unknowns[..., 4]
        translation[..., 2] = np.exp(np.minimum(unknowns[..., 2], FARTHEST_LOG))
        tilts = np.concatenate([unknowns[..., :2], np.zeros((*lead, 1))], axis=-1)
        return View(
            matrix=matrix.reshape(*lead, *ones, 3, 3),
            dist=dist.reshape(*lead, *ones, *ones, 5),
            rotation=(Rotation.from_rotvec(tilts).as_matrix() @ FACING).reshape(*lead, *ones, 3, 3),
            translation=translation.reshape(*lead, *ones, *ones, 3),
            calibrated=self.camera is not None,
            corner_sd=math.nan,
            lying=unknowns[..., self.count :].reshape(*lead, -1, len(LYING_SD)) * LYING_SD,
        )


@dataclass(frozen=True)
class PlaneFit:
    """The fitted unknowns and their covariance."""

    unknowns: Array  # (p,) of `model`
    covariance: Array  # (p, p)
    model: PlaneModel

    @property
    def view(self) -> View:
        return self.model.view(self.unknowns)

    def variations(self) -> list[View]:
        """Views one standard deviation away along each principal direction of the uncertainty of camera, plane and the
        tags' heights."""
        count = self.model.count
        some = np.concatenate([np.arange(count), np.arange(count, len(self.unknowns), len(LYING_SD))])
        variance, direction = np.linalg.eigh(self.covariance[np.ix_(some, some)])
        shifts = np.zeros((len(some), len(self.unknowns)))
        shifts[:, some] = (direction * np.sqrt(np.maximum(variance, 0.0))).T
        return [self.model.view(self.unknowns + shift) for shift in shifts]


@dataclass(frozen=True)
class Sightings:
    """What plane and camera are fitted to: K sightings of tags."""

    corners: Array  # (K, 4, 2) px
    tag: IntArray  # (K,) which of the tags
    size: float  # m
    sd: float  # px, noise of the corners
    model: PlaneModel

    def every(self, step: int) -> Sightings:
        return replace(self, corners=self.corners[::step], tag=self.tag[::step])

    def with_noise(self, noise: float, side_px: float) -> Sightings:
        """With this noise [px] and what does not average out over as many sightings."""
        lasting = FIELD_ERROR * side_px * math.sqrt(len(self.corners) / ZONES)
        return replace(self, sd=math.hypot(max(noise, LEAST_NOISE), lasting))


def fit_plane(corners: Array, size: float, camera: CameraEntry | None, picture: tuple[int, int]) -> PlaneFit:
    """Camera and plane that make all sightings squares of the known size.

    The frame has its origin on the optical axis and x towards the picture's right. `corners` (T, m, 4, 2) px are in the
    order of `records.Detections`, NaN where a tag was not seen; `size` [m] is the tags' side, `camera` None without
    calibration, `picture` px.
    """
    shown = np.isfinite(corners).all(axis=(2, 3))
    seen = Sightings(corners[shown], np.nonzero(shown)[1], size, 1.0, PlaneModel(camera, picture))
    side_px = float(np.median(np.linalg.norm(np.roll(seen.corners, -1, axis=1) - seen.corners, axis=2)))
    focal = camera.fx if camera else PLAIN_FOCAL * max(picture)
    few = seen.every(max(1, len(seen.corners) // 60))
    tries = [solve(start, few) for start in starts(math.log(focal * size / side_px), camera is None)]
    found = min(tries, key=lambda fit: float(fit.cost))
    lying = np.zeros(corners.shape[1] * len(LYING_SD))
    noise = _noise(found, few, UNTOLD_NOISE)
    few = few.with_noise(noise, side_px)
    found = solve(np.append(found.x, lying), few)
    noise = min(noise, _noise(found, few, noise))
    found = solve(found.x, seen.with_noise(noise, side_px))
    normal = found.jac.T @ found.jac
    known = np.linalg.cond(normal) < 1 / np.finfo(float).eps
    fit = PlaneFit(found.x, np.linalg.inv(normal) if known else np.full_like(normal, np.nan), seen.model)
    in_front = np.isfinite(to_plane(fit.view, seen.corners)).all()
    if not known or not in_front or misshapen(fit.view).all() or noise > MOST_NOISE * side_px:
        raise ObservationError(
            "No flat plane in front of the camera explains the tags' shapes. Check size_m and [camera] in "
            "recording.toml, and that all tags lie flat in one plane.",
            about="no plane",
        )
    return fit


def _noise(found: OptimizeResult, seen: Sightings, untold: float) -> float:
    """px, noise of the corners by the median of the residuals; `untold` where too few sightings tell it."""
    count = seen.corners.size
    free = DEGREES_OF_FREEDOM * len(seen.corners) - len(found.x)
    if free < len(seen.corners):
        return untold
    return float(np.median(np.abs(found.fun[:count]))) * seen.sd * math.sqrt(count / free) / NORMAL_MEDIAN


def starts(log_distance: float, uncalibrated: bool) -> list[Array]:
    """First guesses: facing the camera, and tilted each way."""
    none, tilt = TILTS
    tilts = [(none, none), (tilt, none), (-tilt, none), (none, tilt), (none, -tilt)]
    return [np.array([a, b, log_distance, *([0.0] * 4 if uncalibrated else [])]) for a, b in tilts]


def solve(start: Array, seen: Sightings) -> OptimizeResult:
    """Robust least squares of `residuals` from `start`: of plane and camera with all tags like squares in the plane, or
    with the tags' unknowns."""
    return least_squares(
        residuals,
        start,
        jac=slopes,
        args=(seen,),
        loss="soft_l1",
        f_scale=3.0,  # sd: larger residuals have less weight (soft L1)
        x_scale="jac",
    )


def residuals(unknowns: Array, seen: Sightings) -> Array:
    """(..., R) detected corners less those of the fitted squares, and the unknowns (..., p), each over its sd."""
    view, bare = seen.model.view(unknowns), seen.model.count
    lying = np.take(lying_of(view, int(seen.tag.max()) + 1), seen.tag, axis=-2)
    xy, angle = direct = lay_square(to_plane(view, seen.corners))
    for _ in range(2):  # the closed form is of squares in the plane: corrected by what it makes of the model's corners
        again = lay_square(to_plane(view, project_tags(view, xy, angle, seen.size, lying)))
        xy, angle = xy + direct[0] - again[0], angle + direct[1] - again[1]
    residual = (seen.corners - project_tags(view, xy, angle, seen.size, lying)) / seen.sd
    residual = np.nan_to_num(residual, nan=OUT_OF_SIGHT, posinf=OUT_OF_SIGHT, neginf=-OUT_OF_SIGHT)
    wide = np.array([TILT_SD, TILT_SD, np.inf, FOCAL_SD, LENS_SD, CENTRE_SD, CENTRE_SD])[:bare]
    off = residual.reshape(*unknowns.shape[:-1], -1)
    return np.concatenate([off, unknowns[..., :bare] / wide, unknowns[..., bare:]], axis=-1)


def slopes(unknowns: Array, seen: Sightings) -> Array:
    """Jacobian of `residuals`, by differences. A tag's unknowns move its own corners alone: all tags move at once."""
    bare, own, step = seen.model.count, len(LYING_SD), math.sqrt(np.finfo(float).eps)
    of_tag = np.arange((len(unknowns) - bare) // own)
    tag = np.concatenate([np.repeat(seen.tag, 8), np.full(bare, -1), np.repeat(of_tag, own)])
    ways = np.eye(bare + own * min(len(of_tag), 1))
    ways = np.concatenate([ways[:, :bare], np.tile(ways[:, bare:], len(of_tag))], axis=1)
    before, *moved = residuals(unknowns + step * np.concatenate([np.zeros((1, len(unknowns))), ways]), seen)
    change = (np.stack(moved, axis=1) - before[:, None]) / step
    of_tags = change[:, None, bare:] * (tag[:, None] == of_tag)[..., None]
    return np.concatenate([change[:, :bare], of_tags.reshape(len(before), -1)], axis=1)


def misshapen(view: View) -> BoolArray:
    """(m,) tags that no square in the plane explains: more tilted, or with corners farther off, than they may be."""
    off = np.abs(view.lying)
    return np.asarray((off[:, 1:3].max(axis=1) > STEEPEST) | (off[:, 3:].max(axis=1) > MOST_OFF * PRINT_SD))


def lying_of(view: View, count: int) -> Array:
    """(count, 11) `View.lying` of so many tags, zero where the view has none."""
    return view.lying if view.lying.shape[-2] else np.zeros((count, len(LYING_SD)))


def project_tags(view: View, xy: Array, angle: Array, size: float, lying: Array) -> Array:
    """Pixels (..., 4, 2) of the corners of tags over `xy` (..., 2) of the plane, turned by `angle` (...).

    `lying` (..., 11) as `View.lying`; `size` m.
    """
    own = square(np.zeros(2), np.zeros(()), size) + lying[..., 3:].reshape(*lying.shape[:-1], 4, 2)
    rise = own @ lying[..., 1:3, None]
    flat = own - 0.5 * rise * lying[..., None, 1:3]  # shorter by the cosine
    corners = rotated(flat, angle[..., None]) + xy[..., None, :]
    height = np.broadcast_to(lying[..., None, :1] + rise, (*corners.shape[:-1], 1))
    return project(view, np.concatenate([corners, height], axis=-1))


def lowered(view: View, xy: Array, height: Array | float) -> Array:
    """Places (..., 2) [m] of points that are seen at `xy` (..., 2) of the plane and lie `height` (...) [m] over it."""
    foot, distance = camera_place(view)
    return np.asarray(foot + (xy - foot) * (1.0 - np.asarray(height)[..., None] / distance))


def square(xy: Array, angle: Array, size: float) -> Array:
    """Corners (..., 4, 2) [m] of tags at `xy` (..., 2) turned by `angle` (...)."""
    half = size / 2
    own = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    return rotated(own, angle[..., None]) + xy[..., None, :]


def lay_square(flat: Array) -> tuple[Array, Array]:
    """Place (..., 2) and angle (...) of the square nearest to corners `flat` (..., 4, 2), whatever its size."""
    xy = flat.mean(axis=-2)
    own = square(np.zeros(2), np.zeros(()), 1.0)
    off = flat - xy[..., None, :]
    dot = (off * own).sum(axis=(-2, -1))
    cross = (own[:, 0] * off[..., 1] - own[:, 1] * off[..., 0]).sum(axis=-1)
    return xy, np.arctan2(cross, dot)
