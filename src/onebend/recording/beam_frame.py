"""The beam's frame: x along the beam with nothing on it, not along the base tag, which may be mounted turned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from onebend.records import Array, BoolArray, Markers, Remark

MOUNTING_SD = math.radians(2.0)  # of the base tag against the beam, put on by hand
BLOCKS = 5  # of the rest; the scatter of their means is part of its covariance


@dataclass(frozen=True)
class RestShape:
    """The markers' mean pose over the frames at rest; NaN for a marker not seen then."""

    xy: Array  # (m, 2) m
    angle: Array  # (m,) rad
    covariance: Array  # (m, 3, 3)


def rest_shape(markers: Markers, still: BoolArray) -> RestShape:
    """Robust mean of the poses over the frames `still`.

    The covariance is that of one frame over the number of frames, plus the scatter of the means of five blocks. The
    second part holds slow changes (light, vibration), which do not average out. Constant errors are in neither.
    """
    poses = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1)[still]
    m = len(markers.tag_id)
    turns: BoolArray = np.asarray(np.isfinite(markers.angle).any(axis=0))  # a marker of a tracker may have no angle
    measured = np.isfinite(markers.xy[still]).all(axis=-1) & (np.isfinite(markers.angle[still]) | ~turns)
    mean = np.full((m, 3), np.nan)
    covariance = np.full((m, 3, 3), np.nan)
    for i in range(m):
        parts = slice(0, 3 if turns[i] else 2)
        tag_poses = poses[measured[:, i], i, parts]
        if not len(tag_poses):
            continue
        mean[i, parts] = np.median(tag_poses, axis=0)
        covariance[i] = markers.covariance[still][measured[:, i], i].mean(axis=0) / len(tag_poses)
        if len(tag_poses) >= 3 * BLOCKS:
            blocks = np.stack([np.median(part, axis=0) for part in np.array_split(tag_poses, BLOCKS)])
            covariance[i][parts, parts] += np.diag(blocks.var(axis=0, ddof=1) / BLOCKS)
    return RestShape(mean[:, :2], mean[:, 2], covariance)


def beam_turn(rest: RestShape, placement_sd: float) -> float:
    """Angle of the undeformed beam against the base tag, rad.

    Least squares of a line through the origin, by Gauss-Newton. The residual of a marker has the variance of its place
    and of the placement tolerance. The prior: the angle is 0 with the sd `MOUNTING_SD`.
    """
    known = np.isfinite(rest.xy).all(axis=1)
    turn = 0.0
    for _ in range(5):
        across = np.array([-math.sin(turn), math.cos(turn)])
        along = np.array([math.cos(turn), math.sin(turn)])
        variance = np.einsum("i,mij,j->m", across, rest.covariance[known, :2, :2], across) + placement_sd**2
        weight = 1 / np.maximum(variance, 1e-12)
        x, y = rest.xy[known] @ along, rest.xy[known] @ across
        pull = float(np.sum(weight * x * y)) - turn / MOUNTING_SD**2
        turn += pull / (float(np.sum(weight * x**2)) + 1 / MOUNTING_SD**2)
    return turn


def turned(markers: Markers, turn: float) -> Markers:
    """`markers` seen from a frame turned by `turn` [rad] counter-clockwise against the base tag's."""
    cos, sin = math.cos(turn), math.sin(turn)
    back = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    view = markers.view
    return replace(
        markers,
        xy=markers.xy @ back[:2, :2].T,
        angle=markers.angle - turn,
        covariance=back @ markers.covariance @ back.T,
        by_camera=None if markers.by_camera is None else back @ markers.by_camera,
        view=None if view is None else replace(view, rotation=view.rotation @ back.T),
    )


def to_beam_frame(
    markers: Markers, still: BoolArray, placement_sd: float, gravity: Array
) -> tuple[Markers, RestShape, tuple[Remark, ...]]:
    """Markers and rest shape in the beam's frame.

    `gravity` (T, 2) [m/s^2] is in the base tag's frame, zero where it acts across the plane. Where weight bends the
    beam (gravity in the plane and not along the beam) the undeformed beam is never seen: the base tag's frame is kept
    and the rest shape is unknown (NaN). A beam that hangs straight down counts as undeformed.
    """
    m = len(markers.tag_id)
    unknown = RestShape(np.full((m, 2), np.nan), np.full(m, np.nan), np.full((m, 3, 3), np.nan))
    size = np.linalg.norm(gravity, axis=1)
    hangs = gravity[:, 0] > math.cos(math.radians(5.0)) * size
    weighed = size > 0
    if np.any(weighed[still] & ~hangs[still]) or (not still.any() and weighed.any()):
        text = "Weight bends the beam in every frame: x is taken along the base tag, and the rest shape is unknown."
        return markers, unknown, (Remark("note", text),)
    if not still.any():
        text = "No frame shows the beam at rest: x is taken along the base tag, and the rest shape is unknown. Record "
        text += "three still seconds before the push."
        return markers, unknown, (Remark("warning", text, about="no rest"),)
    turn = beam_turn(rest_shape(markers, still), placement_sd)
    markers = turned(markers, turn)
    remarks = []
    if abs(turn) > math.radians(0.5):
        text = f"The base tag is turned by {math.degrees(-turn):.1f} deg against the beam at rest; x is along the beam."
        remarks.append(Remark("note", text))
    if weighed.any():
        remarks.append(Remark("note", "The beam hangs at rest: its weight is taken not to bend it then."))
    return markers, rest_shape(markers, still), tuple(remarks)
