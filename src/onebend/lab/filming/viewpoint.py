"""Where the camera stands and what it is: a pinhole with a lens, tilted against the table."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.errors import RecordingError
from onebend.recording.camera.lens import project
from onebend.recording.camera.plane import FACING
from onebend.recording.toml.source_entries import CameraEntry
from onebend.records import Array, View

MARGIN = 0.06  # of the picture's shorter side: what has to be seen stays this far from the edges
CLOSER, TRIES = 1.03, 200  # steps of the search for a distance
NEAREST = 0.05  # m


@dataclass(frozen=True)
class Camera:
    """A camera that stands still. Without a `distance` it stands as near as shows all that has to be seen."""

    width: int = 1280  # px
    height: int = 720  # px
    focal: float = 1200.0  # px
    centre: tuple[float, float] = (0.0, 0.0)  # px, of the principal point from the picture's middle
    dist: tuple[float, float, float, float, float] = (-0.06, 0.02, 0.0004, -0.0003, 0.0)  # k1 k2 p1 p2 k3
    tilt: tuple[float, float] = (0.03, 0.0)  # rad, about the picture's x and y axes
    roll: float = 0.0  # rad, counter-clockwise turn of the table in the picture
    distance: float = nan  # m

    def __post_init__(self) -> None:
        if self.width < 64 or self.height < 64 or self.width % 2 or self.height % 2:
            raise RecordingError(f"a film needs even sides of 64 px or more, got {self.width} x {self.height}")
        if not (self.focal > 0.0 and isfinite(self.focal)):
            raise RecordingError(f"a camera needs a focal length above zero, got {self.focal} px")
        if isfinite(self.distance) and not self.distance >= NEAREST:
            raise RecordingError(f"a camera stands at least {NEAREST} m away, got {self.distance} m")
        if max(abs(v) for v in self.tilt) > 1.0:
            raise RecordingError("a camera is tilted by less than a radian (57 degrees)")

    @property
    def matrix(self) -> Array:
        """(3, 3) px."""
        cx, cy = (self.width - 1) / 2 + self.centre[0], (self.height - 1) / 2 + self.centre[1]
        return np.array([[self.focal, 0.0, cx], [0.0, self.focal, cy], [0.0, 0.0, 1.0]])


def view_from(camera: Camera, points: Array) -> View:
    """How `camera` sees the table when it looks at the middle of `points` (N, 2) [m].

    Raises:
        RecordingError: not all of the points are in the picture.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    distance = camera.distance
    if isfinite(distance):
        view = looking(camera, middle, distance)
        if not all_seen(camera, view, points, 0.0):
            raise RecordingError(
                f"from {distance:.3g} m the camera does not see the whole push. Give it a larger distance, or none."
            )
        return view
    distance = NEAREST
    for _ in range(TRIES):
        view = looking(camera, middle, distance)
        if all_seen(camera, view, points, MARGIN * min(camera.width, camera.height)):
            return view
        distance *= CLOSER
    raise RecordingError("no distance shows the whole push through this lens. Give a lens with less distortion.")


def looking(camera: Camera, middle: Array, distance: float) -> View:
    """The view whose principal ray meets the table at `middle` (2,), `distance` [m] from the camera."""
    tilt = Rotation.from_euler("xy", camera.tilt).as_matrix()
    turn = Rotation.from_euler("z", camera.roll).as_matrix()
    rotation = tilt @ FACING @ turn
    return View(
        matrix=camera.matrix,
        dist=np.array(camera.dist),
        rotation=rotation,
        translation=np.array([0.0, 0.0, distance]) - rotation[:, :2] @ middle,
        calibrated=True,
        corner_sd=0.0,
    )


def all_seen(camera: Camera, view: View, points: Array, margin: float) -> bool:
    """Whether every point is in front of the camera and `margin` [px] inside the picture."""
    depth = points @ view.rotation[2, :2] + view.translation[2]
    if np.any(depth < 0.2 * view.translation[2]) or np.any(depth <= 0.0):
        return False
    px = project(view, points)
    return bool(np.all(px > margin) and np.all(px < np.array([camera.width, camera.height]) - 1 - margin))


def calibration(camera: Camera) -> CameraEntry:
    """What a perfect calibration of it says, to the digits that are written."""
    matrix = camera.matrix
    return CameraEntry(
        width=camera.width,
        height=camera.height,
        fx=round(camera.focal, 3),
        fy=round(camera.focal, 3),
        cx=round(float(matrix[0, 2]), 3),
        cy=round(float(matrix[1, 2]), 3),
        dist=tuple(round(v, 6) for v in camera.dist),
    )
