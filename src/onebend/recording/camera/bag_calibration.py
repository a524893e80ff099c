"""[camera] from a bag: the camera's calibration as its driver published it."""

from __future__ import annotations

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.bags.camera_topic import CameraInfo, bag_camera, picture_size
from onebend.recording.camera.lens_models import equidistant, nearest_lens, rational
from onebend.recording.toml.schema import Mistakes
from onebend.recording.toml.source_entries import CameraEntry, CameraInfoEntry, VideoEntry
from onebend.records import Array, Remark
from onebend.text_files import quoted

NEAR_ENOUGH = 0.1  # px: a lens of another model that ours meets so nearly is taken as ours
RECTIFIED = "image_rect"  # how the name of a topic of rectified pictures begins
POLYNOMIAL, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", ("equidistant", "fisheye")
OTHERWISE = "Calibrate with `onebend calibrate`, or remove camera_info: then the camera is inferred from the tags."


def known_camera(
    camera: CameraEntry | CameraInfoEntry | None, video: VideoEntry | None, mistakes: Mistakes
) -> tuple[CameraEntry | None, tuple[Remark, ...]]:
    """The camera of `recording.toml`, from the film's bag where it names a topic of it; what is wrong goes to
    `mistakes`."""
    if not isinstance(camera, CameraInfoEntry):
        return camera, ()
    if mistakes.found:
        return None, ()
    try:
        return camera_in_bag(camera, video)
    except RecordingError as wrong:
        mistakes.add(("camera", "camera_info"), str(wrong))
        return None, ()


def camera_in_bag(entry: CameraInfoEntry, video: VideoEntry | None) -> tuple[CameraEntry, tuple[Remark, ...]]:
    """The calibration that `entry` names, for the pictures of `video`, and what is to be said of it.

    Raises:
        RecordingError: the film is in no bag, the camera is not calibrated, its lens has no place in our model, or the
            calibration is of pictures of another size.
    """
    if video is None or not video.topic:
        raise RecordingError(
            "[camera] camera_info names a topic, and the film is in no bag. Write width, height, fx, fy, cx, cy, dist."
        )
    info = bag_camera(video, entry.topic)
    rectified = video.topic.removesuffix("/compressed").rpartition("/")[2].startswith(RECTIFIED)
    matrix = checked_matrix(info, video, info.rectified if rectified else info.matrix)
    if rectified:
        dist, words = np.zeros(5), f"{video.topic} is taken as rectified: its matrix P, and no lens"
    else:
        dist, words = lens_of(info, video)
    matrix, changed = of_part(info, matrix)
    width, height = (info.part[0] // info.binning[0], info.part[1] // info.binning[1])
    shown = picture_size(video)
    if shown != (width, height):
        raise RecordingError(
            f"[camera] camera_info: {info.topic} is of pictures of {width} x {height}, {video.topic} of {video.file} "
            f"has {shown[0]} x {shown[1]}. Record the picture that was calibrated. {OTHERWISE}"
        )
    remark = Remark("note", f"The camera is that of {info.topic}: {words}{changed}.")
    (fx, fy), (cx, cy) = np.diag(matrix)[:2].tolist(), matrix[:2, 2].tolist()
    return CameraEntry(width, height, fx, fy, cx, cy, tuple(dist.tolist()), entry.scale_sd), (remark,)


def checked_matrix(info: CameraInfo, video: VideoEntry, matrix: Array) -> Array:
    """The matrix, if it is one of a camera."""
    place = f"[camera] camera_info: {info.topic} of {video.file}"
    if not matrix[0, 0] > 0.0 or not matrix[1, 1] > 0.0 or info.width < 1 or info.height < 1:
        raise RecordingError(f"{place} is not calibrated: its focal length or size is zero. {OTHERWISE}")
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise RecordingError(f"{place} has oblique axes (K[1] = {matrix[0, 1]:g}), which are not modelled. {OTHERWISE}")
    return matrix


def lens_of(info: CameraInfo, video: VideoEntry) -> tuple[Array, str]:
    """k1, k2, p1, p2, k3, and words on where they come from."""
    place, count = f"[camera] camera_info: {info.topic} of {video.file}", len(info.lens)
    if info.model in (POLYNOMIAL, "") and count == 0:
        return np.zeros(5), "it says nothing of a lens, and none is assumed"
    counts = {POLYNOMIAL: (4, 5), RATIONAL: (8,)} | dict.fromkeys(FISHEYE, (4,))
    if info.model not in counts:
        raise RecordingError(
            f"{place}: the lens model {quoted(info.model)} is not known; {', '.join(counts)} are. {OTHERWISE}"
        )
    if count not in counts[info.model]:
        wanted = " or ".join(map(str, counts[info.model]))
        raise RecordingError(f"{place}: D has {count} numbers; {info.model} has {wanted}. {OTHERWISE}")
    if info.model == POLYNOMIAL:
        return np.append(info.lens, 0.0)[:5], f"lens {info.model}"
    if info.model == RATIONAL and not info.lens[5:].any():
        return info.lens[:5], f"lens {info.model}, without k4 to k6"
    lens = rational(info.lens) if info.model == RATIONAL else equidistant(info.lens)
    dist, worst = nearest_lens(lens, info.matrix, (info.width, info.height))
    if not worst <= NEAR_ENOUGH:
        how = f"miss it by up to {worst:.2g} px" if np.isfinite(worst) else "cannot follow it to the picture's edges"
        raise RecordingError(
            f"{place}: its lens is {info.model}, and k1, k2, p1, p2, k3 {how}. Record rectified pictures (image_rect), "
            f"or take a lens that bends less. {OTHERWISE}"
        )
    return dist, f"lens {info.model} as k1, k2, p1, p2, k3, which meet it to {worst:.2g} px"


def of_part(info: CameraInfo, matrix: Array) -> tuple[Array, str]:
    """The matrix for the part of the sensor that was recorded and its binning, and words on both."""
    bins, corner = np.array(info.binning, dtype=float), np.array(info.corner, dtype=float)
    made = matrix.copy()
    made[:2, 2] = (matrix[:2, 2] - corner + 0.5) / bins - 0.5
    made[[0, 1], [0, 1]] = np.diag(matrix)[:2] / bins
    words = ""
    if info.part != (info.width, info.height) or corner.any():
        words += f"; the part of {info.part[0]} x {info.part[1]} px from {info.corner[0]}, {info.corner[1]} on"
    if info.binning != (1, 1):
        words += f"; {info.binning[0]} x {info.binning[1]} pixels binned"
    return made, words
