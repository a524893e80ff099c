"""Tables of static poses to observations: loads that are known, no clock; points may be missing in any pose."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.stated import stated_in
from onebend.recording.tables import read_columns
from onebend.recording.toml.entries import Recording
from onebend.recording.tracks.chords import chord_angles
from onebend.recording.tracks.pose_loads import PoseLoads, read_loads, turned
from onebend.recording.tracks.pose_readings import (
    SDS,
    check_rulers,
    point_covariances,
    reading_remarks,
    readings_of,
    with_zero,
)
from onebend.records import Array, Observations, Readings, Remark, Source, View

NEAR = 0.02  # of the arc length: if every point is nearer to the clamp than this, the unit is wrong
FEWEST_HELD = 3  # points of a pose whose end is held by an unknown load
FAR = 1.05  # of the arc length: a point's distance from the clamp cannot be larger


@dataclass(frozen=True)
class PosePoints:
    """Where the points were, in the beam's frame; NaN where not measured."""

    xy: Array  # (P, m, 2) m
    angle: Array  # (P, m) rad
    covariance: Array  # (P, m, 3, 3)
    sd_known: bool
    clamp_sd: float  # rad
    readings: Readings = field(default_factory=Readings)
    view: View | None = None
    remarks: tuple[Remark, ...] = ()


def pose_observations(rec: Recording) -> Observations:
    """Observations from a table of poses and a table of loads.

    Raises:
        RecordingError: a table cannot be used.
        ObservationError: no point of any loaded pose, or a point farther from the clamp than the beam reaches.
    """
    assert rec.poses is not None
    loads = read_loads(rec.poses.loads, rec, rec.poses.axes)
    return static(rec, loads, read_points(rec, loads), rec.poses.load_sd)


def static(rec: Recording, loads: PoseLoads, points: PosePoints, load_sd: float) -> Observations:
    """Poses and loads as observations; every pose is a frame, also one of the bare beam."""
    check_reach(rec, loads, points)
    _check_held(rec, loads, points)
    count, m = points.angle.shape
    marker_s = np.array([tag.s for tag in rec.tags.on_beam])
    turns = np.round((points.angle - chord_angles(points.xy, marker_s)) / (2.0 * np.pi))  # read without full turns
    nothing = not (np.any(loads.force) or np.any(loads.gravity) or loads.others is not None or np.any(loads.held))
    if nothing or not np.isfinite(points.xy).any():
        raise ObservationError(f"{rec.name}: no pose has both a load and a point. Add them to the two tables.")
    return Observations(
        source=Source(rec.name, view=points.view, remarks=(*rec.remarks, *points.remarks)),
        stated=replace(stated_in(rec), clamp_sd=points.clamp_sd),
        length=rec.beam.length,
        time=np.arange(count, dtype=float),
        frame=np.arange(count, dtype=np.int64),
        tag_id=np.array([tag.id for tag in rec.tags.on_beam], dtype=np.int64),
        marker_s=marker_s,
        xy=points.xy,
        angle=points.angle - 2.0 * np.pi * np.nan_to_num(turns),
        covariance=points.covariance,
        force=loads.force,
        force_sd=np.full(2, load_sd),
        push_s=loads.push_s,
        loaded=np.ones(count, dtype=bool),
        rest_xy=np.full((m, 2), np.nan),
        rest_angle=np.full(m, np.nan),
        rest_covariance=np.full((m, 3, 3), np.nan),
        gravity=loads.gravity,
        readings=points.readings,
        static=True,
        sd_known=points.sd_known,
        known_loads=loads.others,
        held=loads.held if np.any(loads.held) else None,
        poses=loads.poses,
    )


def read_points(rec: Recording, loads: PoseLoads) -> PosePoints:
    """The table of points, on a grid of poses and points, in the beam's frame."""
    entry = rec.poses
    assert entry is not None
    known = ("x_m", "angle_deg", *SDS)
    table = read_columns(entry.file, ("id", "y_m"), known, labels=("pose",), kind="table of poses", strict=True)
    ids = [tag.id for tag in rec.tags.on_beam]
    strange = np.array([name not in loads.names for name in table.labels["pose"]])
    table.refuse(strange, f"the pose is not in {entry.loads.name}. Name it there, without a load if it has none.")
    table.refuse(~np.isin(table.get("id"), ids), f"id is none of the points in recording.toml ({ids}).")
    for name in SDS:
        table.refuse(table.get(name) <= 0.0, f"{name} must be above zero.")
    readings = readings_of(rec, loads, table)
    cells = [
        (loads.names.index(name), ids.index(int(i)))
        for name, i in zip(table.labels["pose"], table.get("id"), strict=True)
    ]
    table.refuse(
        np.array([cells.index(cell) < k for k, cell in enumerate(cells)]), "the point is there twice in its pose."
    )
    room, shape = entry.axes == "room", (len(loads.names), len(ids))
    if room and not np.isfinite(loads.clamp).all():
        raise ObservationError(
            f'{rec.name}: axes = "room" needs the clamp\'s angle. Give base_angle_deg in [gravity], or clamp_deg with '
            "the loads."
        )
    grids = {name: np.full(shape, np.nan) for name in ("x_m", "y_m", "angle_deg", *SDS)}
    for name, grid in grids.items():
        grid[tuple(np.array(cells).T)] = table.get(name)
    given = np.stack([grids["x_m"], grids["y_m"]], axis=-1)
    xy = turned(given, loads.clamp[:, None]) if room else given
    unusable = np.isfinite(given).any(axis=-1) & ~np.isfinite(xy).any(axis=-1)
    if unusable.any():
        raise ObservationError(
            f"{rec.name}: pose {loads.names[int(np.argwhere(unusable)[0, 0])]} gives one coordinate in the room's axes "
            'of a clamp that is neither level nor upright. Measure both, or in the beam\'s axes (axes = "beam").'
        )
    angle = np.radians(grids["angle_deg"]) - (loads.clamp[:, None] if room else 0.0)
    s = np.array([tag.s for tag in rec.tags.on_beam])
    covariance, sd_known = point_covariances(entry, rec.beam.length, s, xy, angle, grids)
    xy, covariance = with_zero(readings, xy, covariance)
    remarks = reading_remarks(loads, readings)
    remarks += () if sd_known else (Remark("note", "How exactly the points were measured is estimated from the fit."),)
    return PosePoints(xy, angle, covariance, sd_known, entry.clamp_sd, readings, remarks=remarks)


def _check_held(rec: Recording, loads: PoseLoads, points: PosePoints) -> None:
    """An error where a pose with a held end has too few points."""
    complete = np.sum(np.isfinite(points.xy).all(axis=2), axis=1)
    poor = loads.held & (complete < FEWEST_HELD)
    if poor.any():
        raise ObservationError(
            f"{rec.name}: pose {loads.names[int(np.argmax(poor))]} has {int(complete[np.argmax(poor)])} points with "
            f"both coordinates. Where an unknown force and moment hold the end, give {FEWEST_HELD} or more: they say "
            "which way the beam goes."
        )


def check_reach(rec: Recording, loads: PoseLoads, points: PosePoints) -> None:
    """An error where a point is farther from the clamp than the beam up to it is long: millimetres for metres.

    A deflection alone may be as small as it likes, and what counts from a bent pose may go twice as far.
    """
    if points.readings.at == "x":
        return check_rulers(rec, loads, points.xy)
    distance = np.linalg.norm(np.nan_to_num(points.xy), axis=-1)
    if points.readings.bare >= 0:
        distance = 0.5 * distance
    relative = distance / np.array([max(tag.s, 1e-9) * rec.beam.length for tag in rec.tags.on_beam])
    whole = np.isfinite(points.xy).all(axis=-1)
    if points.readings.bare < 0 and np.any(distance[whole] > 0.0) and np.max(relative) < NEAR:
        raise ObservationError(
            f"{rec.name}: every point is within {100 * np.max(relative):.2g} % of the beam's length of the clamp. Is "
            f"length_m = {rec.beam.length:g} in metres, as x_m and y_m are?",
            about="unit",
        )
    sd = np.sqrt(np.trace(points.covariance[..., :2, :2], axis1=-2, axis2=-1))
    reach = FAR * np.array([tag.s for tag in rec.tags.on_beam]) * rec.beam.length + 3 * rec.tags.placement_sd + 3 * sd
    if np.any(distance > reach):
        pose, i = np.argwhere(distance > reach)[0].tolist()
        raise ObservationError(
            f"{rec.name}: in pose {loads.names[pose]} point {rec.tags.on_beam[i].id} is {1000 * distance[pose, i]:.4g} "
            f"mm from the clamp, and only {1000 * rec.tags.on_beam[i].s * rec.beam.length:.4g} mm of beam lead there. "
            "Are x_m and y_m in metres, and from the clamp? Check length_m and the points' s.",
            about="unit",
        )
