"""Tracks of markers from a motion capture or any tracker to markers in the base's frame, as from a film.

Of tracks in space the plane of bending is fitted first. Markers on the base give the clamp's pose, also where it moves;
without them it comes from the straight beam at rest, with every marker at its place along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.camera.base import MOVED, RUNNING, running_median
from onebend.recording.camera.projection import FARTHEST, chord_fits, order_hint
from onebend.recording.camera.tag_poses import unwrap
from onebend.recording.force.contact import ContactSettings, find_contact
from onebend.recording.signals import LATEST, MAD_TO_SD, MOST_FRAMES, check_span
from onebend.recording.tables import Columns, read_columns
from onebend.recording.toml.entries import Recording
from onebend.recording.tracks.chords import check_angles, with_angles
from onebend.recording.tracks.plane_fit import best_plane, plane_remarks
from onebend.records import UNKNOWN_ANGLE_SD, Array, Markers, Remark

FARTHEST_M = 1e6  # m or rad: beyond this nothing is tracked
LEAST_SD, LEAST_ANGLE_SD = 1e-6, 1e-4  # m and rad, least noise of a tracker: it has errors besides its noise


@dataclass(frozen=True)
class Tracks:
    """Markers in the tracker's plane: base first, as recording.toml lists them."""

    time: Array  # (T,) s
    xy: Array  # (T, b + m, 2) m
    angle: Array  # (T, b + m) rad, NaN where not known
    sd: Array  # (T, b + m) m
    clamp: Array | None  # (2,) m, where recording.toml says it
    x_axis: Array | None  # (2,), the same
    remarks: tuple[Remark, ...]


def track_markers(rec: Recording, settings: ContactSettings = ContactSettings()) -> Markers:
    """Every beam marker of the recording's table, relative to the base.

    Raises:
        RecordingError: the table cannot be used.
        ObservationError: a marker is missing throughout, nothing says where the clamp is, or lengths contradict the
            beam's.
    """
    tracks = read_tracks(rec)
    base = len(rec.tags.on_base)
    shift, turn, moves = base_motion(tracks, base)
    from_base = tracks.xy[:, base:] - shift[:, None]
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    in_base = np.stack(
        [cos * from_base[..., 0] + sin * from_base[..., 1], cos * from_base[..., 1] - sin * from_base[..., 0]], axis=-1
    )
    covariance = np.zeros((*in_base.shape[:2], 3, 3))
    covariance[..., 0, 0] = covariance[..., 1, 1] = tracks.sd[:, base:] ** 2
    angle = unwrap(tracks.angle[:, base:] - turn[:, None] - np.array([tag.turn for tag in rec.tags.on_beam]))
    covariance[..., 2, 2] = _angle_sd(angle) ** 2
    covariance[~np.isfinite(in_base).all(axis=-1)] = np.nan
    raw = Markers(
        time=tracks.time,
        tag_id=np.array([tag.id for tag in rec.tags.on_beam]),
        s=np.array([tag.s for tag in rec.tags.on_beam]),
        xy=in_base,
        angle=angle,
        covariance=covariance,
        base_angle=turn,
        view=None,
        remarks=(*tracks.remarks, *moves),
    )
    origin, direction = clamp_frame(rec, tracks, raw, settings)
    cos, sin = np.cos(direction), np.sin(direction)
    back = np.array([[cos, sin], [-sin, cos]])
    xy = (in_base - origin) @ back.T
    check_scale(rec, xy)
    check_angles(xy, raw.s, angle, rec.name)
    return Markers(**{**vars(raw), "xy": xy, "angle": unwrap(angle - direction)})


def read_tracks(rec: Recording) -> Tracks:
    """The table on a grid of times and markers, in the plane of bending."""
    entry = rec.markers
    assert entry is not None
    known = ("z_m", "angle_rad", "sd_m")
    table = read_columns(entry.file, ("time_s", "id", "x_m", "y_m"), known, kind="marker table")
    time, wanted = table.get("time_s"), [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    table.refuse(~(np.abs(time) < LATEST), "time_s is empty or no time. Remove the row, or give its time.")
    table.refuse(table.get("id") != np.round(table.get("id")), "id is no whole number. Number the markers.")
    table.refuse(table.get("sd_m") <= 0.0, "sd_m must be above zero.")
    for name in ("x_m", "y_m", *known):
        table.refuse(np.abs(table.get(name)) > FARTHEST_M, f"{name} is more than {FARTHEST_M:g}. Is it in metres?")
    times, frame = np.unique(time, return_inverse=True)
    check_span(times, str(entry.file), most=MOST_FRAMES)
    grids = {name: np.full((len(times), len(wanted)), np.nan) for name in ("x_m", "y_m", *known)}
    strangers = sorted(set(table.get("id").tolist()) - set(wanted))
    for i, marker in enumerate(wanted):
        rows = np.flatnonzero(table.get("id") == marker)
        again = np.zeros(len(time), dtype=bool)
        again[np.setdiff1d(rows, rows[np.unique(frame[rows], return_index=True)[1]])] = True
        table.refuse(again, f"marker {marker} is there twice at the same time. Remove one of the two rows.")
        for name, grid in grids.items():
            grid[frame[rows], i] = table.get(name)[rows]
    remarks = [Remark("note", f"The table also holds markers that recording.toml does not name: {_ids(strangers)}.")]
    points = np.stack([grids["x_m"], grids["y_m"], grids["z_m"]], axis=-1)
    _refuse_missing(rec, table, points[..., :2], wanted)
    if "z_m" in table.numbers:
        plane = best_plane(points, entry.seen_from)
        xy, lay = plane.lay(points), plane.direction
        clamp = plane.lay(np.array(entry.clamp)) if len(entry.clamp) == 3 else None
        remarks += plane_remarks(plane, points)
    else:
        xy, lay = points[..., :2], _same
        clamp = np.array(entry.clamp) if len(entry.clamp) == 2 else None
    _check_dimensions(rec, 3 if "z_m" in table.numbers else 2)
    sd = np.where(np.isfinite(grids["sd_m"]), grids["sd_m"], entry.sd)
    return Tracks(
        time=times,
        xy=xy,
        angle=grids["angle_rad"],
        sd=np.where(np.isfinite(sd), sd, _track_sd(xy)),
        clamp=clamp,
        x_axis=lay(np.array(entry.x_axis)) if entry.x_axis else None,
        remarks=tuple(remarks[0 if strangers else 1 :]) + _gaps(xy, wanted),
    )


def base_motion(tracks: Tracks, base: int) -> tuple[Array, Array, tuple[Remark, ...]]:
    """(T, 2) m shift and (T,) rad turn of the base since the first frames, and a remark where it moves.

    One marker without an angle shows no turn. Frames without a base marker take the last known pose.
    """
    count = len(tracks.time)
    if base == 0:
        return np.zeros((count, 2)), np.zeros(count), ()
    xy, angle = tracks.xy[:, :base], tracks.angle[:, :base]
    middle = np.nanmedian(xy, axis=0)
    step = np.nan_to_num(
        np.linalg.norm(running_median(_held(xy.reshape(count, -1)), RUNNING).reshape(xy.shape) - middle, axis=-1)
    )
    if not np.any(step > MOVED * np.nanmedian(tracks.sd[:, :base], axis=0)):
        return np.broadcast_to(middle[0], (count, 2)), np.zeros(count), ()
    first = int(np.flatnonzero(np.isfinite(xy).all(axis=(1, 2)))[0]) if np.isfinite(xy).all(axis=(1, 2)).any() else 0
    turn = np.zeros(count)
    if np.isfinite(angle[:, 0]).any():
        turn = unwrap(angle[:, 0] - angle[first, 0])
    elif base > 1:
        relative, reference = xy - xy[:, :1], xy[first] - xy[first, 0]
        cross = reference[:, 0] * relative[..., 1] - reference[:, 1] * relative[..., 0]
        turn = unwrap(np.arctan2(np.sum(cross, axis=1), np.sum(relative * reference, axis=(1, 2))))
    shift, turn = _held(xy[:, 0]), _held(turn[:, None])[:, 0]
    text = f"The base moves, by up to {1000 * float(step.max()):.2g} mm and {math.degrees(float(np.ptp(turn))):.2g} deg"
    if base == 1 and not np.isfinite(angle).any():
        text += "; one marker without an angle does not show its turn. Put a second one on it"
    text += ". It was followed from frame to frame. Fix the base, and the tracker"
    return shift, turn, (Remark("warning", f"{text}.", about="base moves"),)


def clamp_frame(rec: Recording, tracks: Tracks, raw: Markers, settings: ContactSettings) -> tuple[Array, float]:
    """(2,) m and rad: the clamp's place and direction, from the first base marker and in the tracker's plane."""
    base, length = rec.tags.on_base, rec.beam.length
    start = np.nanmedian(tracks.xy[:, 0], axis=0) if base else np.zeros(2)
    origin = None if tracks.clamp is None else tracks.clamp - start
    direction = None if tracks.x_axis is None else float(np.arctan2(tracks.x_axis[1], tracks.x_axis[0]))
    if base and direction is None and np.isfinite(tracks.angle[:, 0]).any():
        direction = float(np.nanmedian(tracks.angle[:, 0] - raw.base_angle)) - base[0].turn
    where_base = base[0].s * length if base and origin is None else math.nan
    if direction is not None and base and origin is None:
        origin = -where_base * np.array([math.cos(direction), math.sin(direction)])
    if origin is not None and direction is not None:
        return origin, direction
    still = find_contact(with_angles(raw), None, settings=settings).still
    if rec.gravity is not None or not still.any():
        why = "its weight bends the beam" if rec.gravity is not None else "no frame shows the beam at rest"
        raise ObservationError(
            f"{rec.name}: {why}, so the markers along it do not show where the clamp is and points. Give clamp_m and "
            "x_axis in [markers], or a base marker with an angle."
        )
    along, points = raw.s * length, np.nanmedian(raw.xy[still], axis=0)
    if base and origin is None:
        along, points = np.append(along, where_base), np.vstack([points, np.zeros(2)])
    elif origin is not None:
        along, points = np.append(along, 0.0), np.vstack([points, origin])
    return line_frame(rec.name, along, points, direction)


def line_frame(name: str, along: Array, points: Array, direction: float | None) -> tuple[Array, float]:
    """Origin (2,) and direction of the straight line whose places `along` (p,) [m] come nearest to `points` (p, 2)."""
    known = np.isfinite(points).all(axis=1)
    along, points = along[known], points[known]
    if direction is None:
        if len(along) < 2 or np.ptp(along) <= 0.0:
            raise ObservationError(
                f"{name}: one marker does not show which way the beam points at rest. Give x_axis in [markers], or "
                "track a second marker."
            )
        pull = (along - along.mean()) @ (points - points.mean(axis=0))
        direction = float(np.arctan2(pull[1], pull[0]))
    unit = np.array([math.cos(direction), math.sin(direction)])
    return np.asarray(np.mean(points - along[:, None] * unit, axis=0)), direction


def check_scale(rec: Recording, xy: Array) -> None:
    """An error where markers are farther apart than the beam between them, or always much nearer: millimetres for
    metres, or a wrong s."""
    s = np.array([0.0, *(tag.s for tag in rec.tags.on_beam)])
    order = np.argsort(s)
    names = ["the clamp", *(f"marker {tag.id}" for tag in rec.tags.on_beam)]
    points = np.concatenate([np.zeros((len(xy), 1, 2)), xy], axis=1)[:, order]
    arcs = np.diff(s[order]) * rec.beam.length
    slack = 3 * math.sqrt(2) * rec.tags.placement_sd
    chords = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    for i, arc in enumerate(arcs):
        measured = chords[np.isfinite(chords[:, i]), i]
        if arc <= slack or not len(measured):
            continue
        farthest = float(np.percentile(measured, FARTHEST))
        if not chord_fits(farthest, arc, slack):
            raise ObservationError(
                f"{rec.name}: {names[order[i]]} and {names[order[i + 1]]} are {1000 * farthest:.4g} mm apart at most, "
                f"recording.toml puts {1000 * arc:.4g} mm of beam between them.{order_hint(xy, rec)} Are x_m and y_m "
                "in metres? Check length_m and the markers' ids and s.",
                about="unit",
            )


def _same(vector: Array) -> Array:
    return vector


def _track_sd(xy: Array) -> Array:
    """(b + m,) m: noise of a coordinate, from second differences of the tracks."""
    bends = np.abs(np.diff(xy, n=2, axis=0)) / math.sqrt(6)
    with_data = np.isfinite(bends).any(axis=(0, 2))
    sd = np.full(xy.shape[1], LEAST_SD)
    sd[with_data] = MAD_TO_SD * np.nanmedian(bends[:, with_data], axis=(0, 2))
    return np.asarray(np.maximum(sd, LEAST_SD))


def _angle_sd(angle: Array) -> Array:
    """(m,) rad: the same for angles; "unknown" where a marker has none."""
    bends = np.abs(np.diff(angle, n=2, axis=0)) / math.sqrt(6)
    sd = np.full(angle.shape[1], UNKNOWN_ANGLE_SD)
    known = np.isfinite(bends).any(axis=0)
    sd[known] = np.maximum(MAD_TO_SD * np.nanmedian(bends[:, known], axis=0), LEAST_ANGLE_SD)
    return sd


def _held(values: Array) -> Array:
    """(T, n) with gaps filled by the last known row (the first known before it)."""
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.nan_to_num(values)
    rows = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.asarray(values[np.where(rows < 0, int(np.argmax(known)), rows)])


def _refuse_missing(rec: Recording, table: Columns, xy: Array, wanted: list[int]) -> None:
    """An error where a marker of recording.toml is nowhere in the table."""
    present = np.asarray(np.isfinite(xy).all(axis=-1).any(axis=0)).tolist()
    never = [marker for marker, is_present in zip(wanted, present, strict=True) if not is_present]
    if never:
        in_table = _ids(sorted(set(table.get("id").tolist())))
        raise ObservationError(
            f"{table.path}: marker {_ids(never)} of {rec.name} has no place in any row; the table holds {in_table}. "
            "Correct the ids in recording.toml."
        )


def _check_dimensions(rec: Recording, count: int) -> None:
    """An error where clamp_m or x_axis has two numbers beside tracks in space, or three beside tracks in a plane."""
    assert rec.markers is not None
    for name, value in (("clamp_m", rec.markers.clamp), ("x_axis", rec.markers.x_axis)):
        if value and len(value) != count:
            raise ObservationError(
                f"{rec.name}: {name} in [markers] needs {count} numbers, as the table's points have."
            )


def _gaps(xy: Array, wanted: list[int]) -> tuple[Remark, ...]:
    missing = ~np.isfinite(xy).all(axis=-1)
    return tuple(
        Remark("note", f"Marker {marker} is missing in {count} of {len(xy)} frames.")
        for marker, count in zip(wanted, missing.sum(axis=0).tolist(), strict=True)
        if count > 0.05 * len(xy)
    )


def _ids(markers: list[float] | list[int]) -> str:
    return ", ".join(f"{marker:g}" for marker in markers)
