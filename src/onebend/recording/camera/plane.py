"""The camera's view of the plane of the tags, fitted to the tags: squares of one known size in one plane.

For a trial camera and plane every sighting is projected into the plane, and a square of the known size is fitted to it
in closed form. The residuals are the distances between the corners of this square and the detected ones, in pixels.
The poses of the tags are no unknowns of the search: three numbers (tilt, tilt, distance) are fitted where the camera
is calibrated, seven where focal length, one lens term and the principal point (2) must be inferred too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from onebend.errors import ObservationError
from onebend.recording.camera.lens import project, to_plane
from onebend.recording.toml.source_entries import CameraEntry
from onebend.records import Array, View

FACING: Array = np.diag(
    [1.0, -1.0, -1.0]
)  # the plane's axes when it faces the camera: x right, y up, z towards the camera
TILTS = (0.0, 0.6)  # rad, starts of the search, in each of four directions
ENOUGH_TO_START = 60  # sightings, evenly chosen, with which the starts are improved
SURE = 3.0  # sd: larger residuals have less weight (soft L1)
# Priors of the plane, and of a camera without calibration: one sd about the simplest value.
TILT_SD = 0.5  # rad; it matters only where one tag alone leaves the tilt open
PLAIN_FOCAL = 1.0  # focal length over the picture's longer side
FOCAL_SD = 0.5  # of its logarithm
LENS_SD = 0.1  # k1
CENTRE_SD = 0.02  # principal point off the picture's middle, over the longer side
NORMAL_MEDIAN = 0.67449  # median of |x|, x normal with unit variance
DEGREES_OF_FREEDOM = 5  # a tag's eight coordinates less the three of its pose
LEAST_NOISE, MOST_NOISE = 1e-6, 0.1  # of a corner: px, and in sides of a tag
OUT_OF_SIGHT = 1e3  # px, residual of a corner that a trial camera cannot see


@dataclass(frozen=True)
class PlaneFit:
    """The fitted unknowns and their covariance."""

    unknowns: Array  # (3,) or (7,), see `view_from`
    covariance: Array  # of the unknowns
    camera: CameraEntry | None
    picture: tuple[int, int]

    @property
    def view(self) -> View:
        return view_from(self.unknowns, self.camera, self.picture)

    def variations(self) -> list[View]:
        """Views one standard deviation away along each principal direction of the unknowns' uncertainty."""
        variance, direction = np.linalg.eigh(self.covariance)
        shifts = direction * np.sqrt(np.maximum(variance, 0.0))
        return [view_from(self.unknowns + shift, self.camera, self.picture) for shift in shifts.T]


def fit_plane(corners: Array, size: float, camera: CameraEntry | None, picture: tuple[int, int]) -> PlaneFit:
    """Camera and plane that make all sightings squares of the known size.

    The plane's frame has its origin on the optical axis and x towards the picture's right.

    Args:
        corners: (K, 4, 2) px, in the order of `records.Detections`, from any frames; all finite.
        size: m, side of the tags.
        camera: the calibration, or None.
        picture: px, width and height.

    Raises:
        ObservationError: no camera in front of the plane explains the sightings.
    """
    side_px = float(np.median(np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)))
    focal = camera.fx if camera else PLAIN_FOCAL * max(picture)
    few = corners[:: max(1, len(corners) // ENOUGH_TO_START)]
    tries = [
        solve(start, few, size, camera, picture, sd=1.0)
        for start in starts(math.log(focal * size / side_px), camera is None)
    ]
    best = min(tries, key=lambda fit: float(fit.cost))
    rough = float(np.median(np.abs(best.fun[: few.size]))) / NORMAL_MEDIAN * math.sqrt(8 / DEGREES_OF_FREEDOM)
    sd = max(rough, LEAST_NOISE)
    final = solve(solve(best.x, few, size, camera, picture, sd=sd).x, corners, size, camera, picture, sd=sd)
    normal = final.jac.T @ final.jac
    known = np.linalg.cond(normal) < 1 / np.finfo(float).eps
    fit = PlaneFit(final.x, np.linalg.inv(normal) if known else np.full_like(normal, np.nan), camera, picture)
    if not known or not np.isfinite(to_plane(fit.view, corners)).all() or rough > MOST_NOISE * side_px:
        raise ObservationError(
            "No flat plane in front of the camera explains the tags' shapes. Check size_m and [camera] in "
            "recording.toml, and that all tags lie flat in one plane.",
            about="no plane",
        )
    return fit


def starts(log_distance: float, uncalibrated: bool) -> list[Array]:
    """First guesses: facing the camera, and tilted each way."""
    none, tilt = TILTS
    tilts = [(none, none), (tilt, none), (-tilt, none), (none, tilt), (none, -tilt)]
    return [np.array([a, b, log_distance, *([0.0] * 4 if uncalibrated else [])]) for a, b in tilts]


def solve(
    start: Array, corners: Array, size: float, camera: CameraEntry | None, picture: tuple[int, int], *, sd: float
) -> OptimizeResult:
    """Robust least squares of `residuals` from `start`; `sd` is the corners' noise, px."""
    return least_squares(
        lambda unknowns: residuals(unknowns, corners, size, camera, picture, sd=sd),
        start,
        loss="soft_l1",
        f_scale=SURE,
        x_scale="jac",
    )


def residuals(
    unknowns: Array, corners: Array, size: float, camera: CameraEntry | None, picture: tuple[int, int], *, sd: float
) -> Array:
    """Detected corners less those of the fitted squares, and the unknowns, each divided by its sd."""
    view = view_from(unknowns, camera, picture)
    flat = to_plane(view, corners)
    xy, angle = lay_square(flat)
    residual = (corners - project(view, square(xy, angle, size))) / sd
    residual = np.nan_to_num(residual, nan=OUT_OF_SIGHT, posinf=OUT_OF_SIGHT, neginf=-OUT_OF_SIGHT)
    wide = np.array([TILT_SD, TILT_SD, np.inf, FOCAL_SD, LENS_SD, CENTRE_SD, CENTRE_SD])
    return np.concatenate([residual.ravel(), unknowns / wide[: len(unknowns)]])


def view_from(unknowns: Array, camera: CameraEntry | None, picture: tuple[int, int]) -> View:
    """The unknowns as a view: two tilts [rad], log distance [log m]; then, where the camera is not calibrated, log of
    the focal length over its plain value, k1, and the principal point's shift over the longer side."""
    tilt_x, tilt_y, log_distance = unknowns[:3]
    if camera:
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        dist = np.array([*camera.dist, 0.0][:5])
    else:
        log_focal, k1, shift_x, shift_y = unknowns[3:]
        long, (width, height) = max(picture), picture
        focal = PLAIN_FOCAL * long * math.exp(log_focal)
        centre = (width - 1) / 2 + shift_x * long, (height - 1) / 2 + shift_y * long
        matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        dist = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    return View(
        matrix=matrix,
        dist=dist,
        rotation=Rotation.from_rotvec([tilt_x, tilt_y, 0.0]).as_matrix() @ FACING,
        translation=np.array([0.0, 0.0, math.exp(log_distance)]),
        calibrated=camera is not None,
        corner_sd=math.nan,
    )


def square(xy: Array, angle: Array, size: float) -> Array:
    """Corners (..., 4, 2) [m] of tags at `xy` (..., 2) turned by `angle` (...)."""
    half = size / 2
    own = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    turned = np.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1]], axis=-1)
    return turned + xy[..., None, :]


def lay_square(flat: Array) -> tuple[Array, Array]:
    """Place (..., 2) and angle (...) of the square nearest to corners `flat` (..., 4, 2), whatever its size."""
    xy = flat.mean(axis=-2)
    own = square(np.zeros(2), np.zeros(()), 1.0)
    off = flat - xy[..., None, :]
    dot = (off * own).sum(axis=(-2, -1))
    cross = (own[:, 0] * off[..., 1] - own[:, 1] * off[..., 0]).sum(axis=-1)
    return xy, np.arctan2(cross, dot)
