"""The beam's frame: x along the beam with nothing on it, not along the base tag, which may be mounted turned."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from onebend.errors import ObservationError
from onebend.recording.clock import ROUGHLY, reach_of
from onebend.recording.entries import GravityEntry
from onebend.recording.signals import LATEST
from onebend.recording.tables import read_columns
from onebend.records import Array, BoolArray, ClockOffset, Markers, Remark, left_of, rotated, unit

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

    The covariance is that of one frame over the number of frames, plus the scatter of the means of five blocks, which
    holds slow changes (light, vibration). Constant errors are in neither."""
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
    """Angle of the undeformed beam against the base tag, rad, by least squares of a line through the origin.

    A residual has the variance of the marker's place and of the placement tolerance. The prior is 0, sd `MOUNTING_SD`.
    """
    known = np.isfinite(rest.xy).all(axis=1)
    turn = 0.0
    for _ in range(5):
        along = unit(turn)
        across = left_of(along)
        variance = np.einsum("i,mij,j->m", across, rest.covariance[known, :2, :2], across) + placement_sd**2
        weight = 1 / np.maximum(variance, 1e-12)
        x, y = rest.xy[known] @ along, rest.xy[known] @ across
        pull = float(np.sum(weight * x * y)) - turn / MOUNTING_SD**2
        turn += pull / (float(np.sum(weight * x**2)) + 1 / MOUNTING_SD**2)
    return turn


def turned(markers: Markers, turn: float) -> Markers:
    """`markers` seen from a frame turned by `turn` [rad] counter-clockwise against the base tag's."""
    back, view = Rotation.from_euler("z", -turn).as_matrix(), markers.view
    return replace(
        markers,
        xy=rotated(markers.xy, -turn),
        angle=markers.angle - turn,
        covariance=back @ markers.covariance @ back.T,
        by_camera=None if markers.by_camera is None else back @ markers.by_camera,
        view=None if view is None else replace(view, rotation=view.rotation @ back.T),
    )


def to_beam_frame(
    markers: Markers, still: BoolArray, placement_sd: float, gravity: Array
) -> tuple[Markers, RestShape, tuple[Remark, ...]]:
    """Markers and rest shape in the beam's frame; `gravity` (T, 2) [m/s^2] in the base tag's, zero across the plane.

    Where weight bends the beam, the undeformed beam is never seen. The base tag's frame is kept then, and the rest
    shape is NaN. A beam that hangs straight down counts as undeformed."""
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


@dataclass(frozen=True)
class BaseLog:
    """The angle of the base, on the force log's clock."""

    time: Array  # (N,) s
    angle: Array  # (N,) rad, the beam's x axis in the room


def read_base_log(path: Path) -> BaseLog:
    """The base's angle from a table with the columns time_s and base_deg."""
    table = read_columns(path, ("time_s", "base_deg"), kind="table of the base's angle")
    time, degrees = table.get("time_s"), table.get("base_deg")
    table.refuse(~((np.abs(time) < LATEST) & (np.abs(degrees) < 1e6)), "not two numbers. Correct or remove the line.")
    table.refuse(np.diff(time, prepend=-np.inf) <= 0.0, "the time does not rise. Sort the file.")
    table.refuse(np.full(len(time), len(time) < 2), "at least 2 rows are needed. Give base_angle_deg instead.")
    return BaseLog(time, np.unwrap(np.radians(degrees)))


def base_clock(markers: Markers, log: BaseLog, stated: float, uncertainty: float) -> ClockOffset:
    """The offset at which the base tag's angle in the film fits the logged angle (least squares, one constant free).

    `sd` counts the residuals as correlated over a second, as from a log that is sampled sparsely.
    """
    if not math.isfinite(stated) or not math.isfinite(uncertainty):
        stated = float(log.time[0] - markers.time[0]) if not math.isfinite(stated) else stated
        uncertainty = float(np.ptp(log.time))
    unsettled = ClockOffset(offset=stated, sd=uncertainty, stated=stated, found=False)
    if np.ptp(markers.base_angle) < math.radians(1.0):
        return unsettled
    measured = np.isfinite(markers.base_angle)
    time, angle = markers.time[measured], markers.base_angle[measured]

    def misfit(offset: float) -> float:
        log_time = time + offset
        inside = (log_time >= log.time[0]) & (log_time <= log.time[-1])
        if inside.sum() < 0.5 * len(log_time):
            return math.inf
        return float(np.var(np.interp(log_time[inside], log.time, log.angle) - angle[inside]))

    farthest, centre = reach_of(uncertainty), stated
    for reach, width in ((farthest, 0.02), (0.05, 0.002)):
        tries = np.arange(centre - reach, centre + reach + width / 2, width)
        cost = np.array([misfit(trial) for trial in tries])
        best = int(np.argmin(cost))
        centre = float(tries[best])
    if not math.isfinite(cost[best]) or cost[best] > 0.05 * float(np.var(angle)):
        return unsettled
    around = slice(max(best - 10, 0), best + 11)
    curve = float(np.polyfit(tries[around] - centre, cost[around], 2)[0])
    independent = max(float(np.ptp(time)), 2.0)
    sd = max(math.sqrt(cost[best] / (independent * curve)) if curve > 0 else uncertainty, width)
    if uncertainty < ROUGHLY and (sd > 0.5 * uncertainty or abs(centre - stated) > farthest):
        return unsettled  # what is written is known better
    return ClockOffset(offset=centre, sd=sd, stated=stated, found=True)


def gravity_in_frame(entry: GravityEntry | None, log: BaseLog | None, markers: Markers, time: Array) -> Array:
    """(T, 2) m/s^2 along and across the beam's x axis, at `time` of the base log; zeros across the plane.

    A base whose angle is written as a constant but turns in the film is followed by its tag."""
    if entry is None:
        return np.zeros((len(time), 2))
    base = np.interp(time, log.time, log.angle) if log is not None else entry.base_angle + markers.base_angle
    angle = entry.direction - base
    return np.asarray(entry.magnitude * unit(angle))


def check_overlap(markers: Markers, log_time: Array, offset: float, what: str) -> None:
    """Raise where no frame lies inside the log."""
    film = markers.time[[0, -1]] + offset
    if film[1] < log_time[0] or film[0] > log_time[-1]:
        # Times the film's length: a longer log is probably in another unit.
        long = log_time[-1] - log_time[0] > 100.0 * (film[1] - film[0])
        hint = ' Its times look like milliseconds: write time_unit = "ms" in [force].' if long else ""
        raise ObservationError(
            f"The film ({film[0]:.1f} to {film[1]:.1f} s on the log's clock) and the {what} ({log_time[0]:.1f} to "
            f"{log_time[-1]:.1f} s) do not overlap. Check start_s in recording.toml, and that the log "
            f"belongs to this film.{hint}",
            about="no overlap",
        )
