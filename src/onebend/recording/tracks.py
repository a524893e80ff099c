"""Tables of tracked markers and curves, from any tracker or by hand; signals and frequencies of swings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from onebend.errors import ObservationError, RecordingError
from onebend.recording import camera, force, outline, signals, stated, tables
from onebend.recording.entries import FrequencyEntry, GravityEntry, Recording
from onebend.records import (
    POINT_ID,
    UNKNOWN_ANGLE_SD,
    Array,
    BoolArray,
    IntArray,
    Markers,
    MeasuredFrequency,
    Observations,
    Remark,
    Source,
    of_markers,
    rotated,
)

# Curves in tables: vertices in their order from the clamp to the tip, whose places along the body nobody measured.

MOST_VERTICES = 2 * outline.POINTS  # between which the curve is bent smoothly; of more, neighbours are averaged first
FINE = 8  # places at which each point is averaged
TOO_LONG = 1.05  # of the length: a longer curve is of another body, or in another unit
FEWEST = 4  # vertices of a curve
_SAME = 1e-6  # of the length: vertices nearer to each other are one


@dataclass(frozen=True)
class CurvePoints:
    """Points of curves in T frames at the same places along the body; NaN where a curve does not reach."""

    xy: Array  # (T, n, 2) m
    angle: Array  # (T, n) rad, of the curve there
    share: Array  # (T,) vertices that each point stands for, at least one


def curve_rows(table: tables.Columns, otherwise: str = "") -> BoolArray:
    """(N,) rows that are vertices of curves, by their order; checked against those of points, which have an id. There
    must be some where recording.toml names no points, which `otherwise` would do."""
    order, number = np.isfinite(table.get("order")), np.isfinite(table.get("id"))
    table.refuse(order & number, "both id and order: a row is a point with an id, or a vertex of a curve.")
    table.refuse(~(order | number), "neither id nor order. A point has an id, a vertex of a curve its order.")
    for name in ("x_m", "y_m"):
        table.refuse(order & ~np.isfinite(table.get(name)), f"a vertex of a curve needs {name}.")
    if otherwise and not order.any():
        raise ObservationError(
            f"{table.path}: recording.toml names no point on the beam, and there is no curve here. Add {otherwise} "
            "with id and s, or a column order: vertices of the body's curve, numbered from the clamp to the tip."
        )
    return np.asarray(order)


def vertices_of(
    table: tables.Columns, drawn: BoolArray, frame: IntArray, count: int, columns: tuple[str, ...] = ("x_m", "y_m")
) -> Array:
    """(T, n, c) vertices of the curve in each of `count` frames in their order, NaN behind the last; `drawn` (N,) rows
    are vertices, of frame `frame` (N,)."""
    rows = np.flatnonzero(drawn)
    rows = rows[np.lexsort((table.get("order")[rows], frame[rows]))]
    here, order = frame[rows], table.get("order")[rows]
    twice = np.zeros(len(frame), dtype=bool)
    twice[rows[1:]] = (np.diff(here) == 0) & (np.diff(order) == 0.0)
    table.refuse(twice, "its order is there twice in one curve. Number the vertices from the clamp to the tip.")
    number = np.arange(len(rows)) - np.searchsorted(here, here)
    out = np.full((count, int(number.max(initial=-1)) + 1, len(columns)), np.nan)
    out[here, number] = np.stack([table.get(name)[rows] for name in columns], axis=1)
    return out


def stated_sd(table: tables.Columns, drawn: BoolArray, frame: IntArray, count: int, otherwise: float) -> Array:
    """(T,) m, one sd of a vertex in each of `count` frames, as sd_m says, or `otherwise`; rows as of `vertices_of`."""
    sd = np.full(count, otherwise)
    said = drawn & np.isfinite(table.get("sd_m"))
    sd[frame[said]] = table.get("sd_m")[said]
    return sd


def points_on(vertices: Array, length: float, name: str, origin: Array | None = None) -> CurvePoints:
    """Points at `outline.PLACES` of curves (T, n, 2) [m] of a body `length` m long. A curve begins at the clamp, or
    where its first vertex lies before `origin` (2,) m.

    Raises:
        ObservationError: a curve of few vertices, or longer than the body.
    """
    count = np.sum(np.isfinite(vertices).all(axis=-1), axis=1)
    if np.any((count > 0) & (count < FEWEST)):
        raise ObservationError(f"{name}: a curve of {count[(count > 0)].min()} points. Give {FEWEST} or more.")
    xy, angle = np.full((len(vertices), outline.POINTS, 2), np.nan), np.full((len(vertices), outline.POINTS), np.nan)
    for t in np.flatnonzero(count).tolist():
        xy[t], angle[t], end = _resampled(vertices[t, : count[t]], length, origin)
        if end > TOO_LONG:
            raise ObservationError(
                f"{name}: a curve is {1e3 * end * length:.4g} mm long, the body {1e3 * length:.4g} mm. Are x_m and "
                "y_m in metres, and do the vertices rise from the clamp to the tip? Check length_m.",
                about="unit",
            )
    return CurvePoints(xy, angle, np.maximum(count / outline.POINTS, 1.0))


def _resampled(vertices: Array, length: float, origin: Array | None) -> tuple[Array, Array, float]:
    """(n, 2) m and (n,) rad at the places, and s of the curve's end."""
    groups = np.array_split(vertices, min(len(vertices), MOST_VERTICES))
    middle = np.stack([group.mean(axis=0) for group in groups])
    middle = middle[np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > _SAME * length)]
    away = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1)))
    line = make_interp_spline(away, middle, k=min(3, len(away) - 1))
    fine = np.linspace(0.0, away[-1], 8 * len(away))
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line(fine), axis=0), axis=1)))
    lost = 0.5 * (len(groups[0]) - 1) / len(groups[0]) * away[1]  # from the first vertex to the first mean
    begin = lost if origin is None else float(np.linalg.norm(middle[0] - origin))
    s = (begin + way) / length
    asked = ((np.arange(FINE * outline.POINTS) + 0.5) / (FINE * outline.POINTS)).reshape(outline.POINTS, FINE)
    near = 0.5 / outline.POINTS
    inside = np.all((asked >= s[0] - near) & (asked <= s[-1] + near), axis=1)
    at = np.interp(asked, s, fine) + length * (np.minimum(asked - s[0], 0.0) + np.maximum(asked - s[-1], 0.0))
    tangent = line.derivative()(at).mean(axis=1)
    xy = np.where(inside[:, None], line(at).mean(axis=1), np.nan)
    return xy, np.arctan2(tangent[:, 1], tangent[:, 0]), float(s[-1])


def chord_angles(xy: Array, s: Array) -> Array:
    """(T, m) rad: the beam's angle at the markers, from places (T, m, 2) [m] and the clamp at the origin.

    The slope of a parabola in s through each marker and its two neighbours. The error is a few hundredths of a radian:
    small enough for clocks and rests, not for learning. NaN where a marker or a neighbour is missing.
    """
    order = np.argsort(s, kind="stable")
    places, points, _ = signals.from_clamp(s, xy, np.zeros(xy.shape[:2]))
    span = np.maximum(np.diff(places), 1e-9)
    chord = np.diff(points, axis=1)
    turn = np.arctan2(chord[..., 1], chord[..., 0])
    filled = np.where(np.isfinite(turn), turn, 0.0)
    turn = np.where(np.isfinite(turn), np.unwrap(filled, axis=1), np.nan)
    angle = np.empty_like(turn)
    share = span[:-1] / (span[:-1] + span[1:])
    angle[:, :-1] = turn[:, :-1] + share * (turn[:, 1:] - turn[:, :-1])
    before = turn[:, -2] if turn.shape[1] > 1 else np.zeros(len(turn))
    middle = 0.5 * (span[-1] + span[-2]) if len(span) > 1 else 0.5 * span[-1]
    angle[:, -1] = turn[:, -1] + 0.5 * span[-1] * (turn[:, -1] - before) / middle
    unordered = np.empty_like(angle)
    unordered[:, order] = angle
    return unordered


def with_angles(markers: Markers) -> Markers:
    """`markers` with an angle wherever the places give one; measured angles stay."""
    if np.isfinite(markers.angle[np.isfinite(markers.xy).all(axis=-1)]).all():
        return markers
    rough = chord_angles(markers.xy, markers.s)
    known = np.isfinite(markers.angle).any(axis=0)  # a marker either has angles or has none
    return replace(markers, angle=np.where(known, markers.angle, camera.unwrap(rough, from_zero=False)))


def check_angles(xy: Array, s: Array, angle: Array, name: str) -> None:
    """An error where measured angles (T, m) [rad] turn against the places (T, m, 2) [m], or are no radians."""
    share = angles_per_chord(xy, s, angle)
    if share < 0.0 or share > 4.0:  # times what the places turn by: angles beyond are no radians
        how = "the other way than" if share < 0.0 else f"{share:.2g} times as far as"
        raise ObservationError(
            f"{name}: angle_rad turns {how} the markers' places do. Angles are in radians and grow from x to y: "
            "correct the sign or the unit of angle_rad, or the order or the sign of x_m and y_m."
        )


def angles_per_chord(xy: Array, s: Array, angle: Array) -> float:
    """How far measured angles (T, m) [rad] turn per radian of the places (T, m, 2) [m]: about 1; NaN: nothing bends."""
    chords = camera.unwrap(chord_angles(xy, s), from_zero=False)
    known = np.isfinite(chords) & np.isfinite(angle)
    if not known.any():
        return float("nan")
    measured, turned = (_from_mean(np.where(known, values, np.nan)) for values in (angle, chords))
    # rad that a marker's chord must turn for its angle to be compared with it.
    if not float(np.nanmax(turned) - np.nanmin(turned)) > 0.2:
        return float("nan")
    return float(np.nansum(measured * turned) / np.nansum(turned**2))


def _from_mean(values: Array) -> Array:
    """Columns (T, m) less their means; NaN where a column has no value."""
    count = np.maximum(np.sum(np.isfinite(values), axis=0), 1)
    return np.asarray(values - np.nansum(values, axis=0) / count)


@dataclass(frozen=True)
class Plane:
    """A plane in space with two axes in it, right-handed with the normal, which points to who looks at it."""

    origin: Array  # (3,) m
    axes: Array  # (2, 3)
    normal: Array  # (3,)

    def lay(self, points: Array) -> Array:
        """(..., 2) m, points (..., 3) dropped onto the plane."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def away(self, points: Array) -> Array:
        """(...) m, distance of points (..., 3) from the plane."""
        return np.asarray((points - self.origin) @ self.normal)


def best_plane(points: Array, seen_from: Sequence[float]) -> Plane:
    """The plane in which markers at `points` (T, m, 3) [m] move, by least squares; NaN left out.

    Each marker has a height of its own over the beam. So their motion shows the plane; their mean places count little.
    The plane of points along one line is the one that is seen most nearly face on from `seen_from` (3,)."""
    known: BoolArray = np.asarray(np.isfinite(points).all(axis=-1))
    if np.sum(known) < 3:
        raise ObservationError(f"{np.sum(known)} points in space do not make a plane. Check the table's x_m, y_m, z_m.")
    tracks = [points[known[:, i], i] for i in range(points.shape[1]) if known[:, i].any()]
    middles = np.stack([np.mean(track, axis=0) for track in tracks])
    origin = np.mean(middles, axis=0)
    moves = np.concatenate([track - middle for track, middle in zip(tracks, middles, strict=True)])
    moves /= np.sqrt(len(moves))
    # Weight of the markers' mean places against their motion: heights differ by millimetres.
    spread = 0.01 * (middles - origin) / np.sqrt(len(middles))
    extent, rows = np.linalg.svd(np.concatenate([moves, spread, np.zeros((3, 3))]), full_matrices=False)[1:]
    look = np.asarray(seen_from, dtype=float)
    look = look / max(float(np.linalg.norm(look)), np.finfo(float).tiny)
    normal = rows[2]
    # Second over first principal extent: markers that hardly leave a line say nothing of their plane.
    if extent[1] < 0.02 * extent[0]:
        normal = look - (look @ rows[0]) * rows[0]
        normal = normal / max(float(np.linalg.norm(normal)), np.finfo(float).tiny)
    # Cosine between `seen_from` and the plane's normal below which it does not say which side is meant.
    if not abs(float(normal @ look)) > 0.2:
        raise ObservationError(
            f"The plane of bending (normal {np.round(normal, 2).tolist()}) is seen edge on from {list(seen_from)}, so "
            "nothing says which way round its y axis goes. Give seen_from in [markers] a direction nearer its normal."
        )
    normal = normal * np.sign(normal @ look)
    along = np.eye(3)[int(np.argmin(np.abs(normal)))]
    x = along - (along @ normal) * normal
    x = x / np.linalg.norm(x)
    return Plane(origin, np.stack([x, np.cross(normal, x)]), normal)


def plane_remarks(plane: Plane, points: Array) -> tuple[Remark, ...]:
    """How far points (T, m, 3) move out of the plane, less each marker's own height over it."""
    distance = plane.away(points)
    measured = np.isfinite(distance).any(axis=0)
    distance = distance[:, measured] - np.nanmedian(distance[:, measured], axis=0)
    rms, largest = float(np.sqrt(np.nanmean(distance**2))), float(np.nanmax(np.abs(distance)))
    flat = plane.lay(points)[:, measured]
    extent = float(np.nanmax(np.linalg.norm(flat - np.nanmean(flat, axis=(0, 1)), axis=-1)))
    text = f"The markers move out of the plane of bending by {1000 * rms:.2g} mm RMS, {1000 * largest:.2g} mm at most"
    if largest > 0.03 * extent:  # of the markers' extent: more out-of-plane motion is no planar bending
        text += ": this is no bending in one plane, and what leaves it is not seen. Push within one plane."
        return (Remark("warning", text, about="out of plane"),)
    return (Remark("note", f"{text}; only the motion in the plane is used."),)


FARTHEST_M = 1e6  # m or rad: beyond this nothing is tracked
LEAST_JUMP = 0.005  # of the beam: what is nearer to its place does no harm
LEAST_SD, LEAST_ANGLE_SD = 1e-6, 1e-4  # m and rad, least noise of a tracker: it has errors besides its noise


@dataclass(frozen=True)
class Tracks:
    """Markers in the tracker's plane: base first, as recording.toml lists them, and then the points of a curve."""

    time: Array  # (T,) s
    xy: Array  # (T, b + m, 2) m
    angle: Array  # (T, b + m) rad, NaN where not known
    sd: Array  # (T, b + m) m
    clamp: Array | None  # (2,) m, where recording.toml says it
    x_axis: Array | None  # (2,), the same
    remarks: tuple[Remark, ...]
    curve: int = 0  # how many of the m are points of a curve


def track_markers(rec: Recording) -> Markers:
    """Every beam marker of the recording's table, relative to the base."""
    tracks = _without_copies(read_tracks(rec))
    base = len(rec.tags.on_base)
    shift, turn, moves = base_motion(tracks, base)
    in_base = rotated(tracks.xy[:, base:] - shift[:, None], -turn[:, None])
    covariance = np.zeros((*in_base.shape[:2], 3, 3))
    covariance[..., 0, 0] = covariance[..., 1, 1] = tracks.sd[:, base:] ** 2
    tags, curve = rec.tags.on_beam, np.arange(tracks.curve)
    turns = np.array([*(tag.turn for tag in tags), *np.zeros(len(curve))])
    angle = camera.unwrap(tracks.angle[:, base:] - turn[:, None] - turns)
    covariance[..., 2, 2] = _noise(angle, LEAST_ANGLE_SD, UNKNOWN_ANGLE_SD) ** 2
    covariance[~np.isfinite(in_base).all(axis=-1)] = np.nan
    raw = Markers(
        time=tracks.time,
        tag_id=np.array([*(tag.id for tag in tags), *(POINT_ID + curve)]),
        s=np.array([*(tag.s for tag in tags), *outline.PLACES[curve]]),
        xy=in_base,
        angle=angle,
        covariance=covariance,
        base_angle=turn,
        view=None,
        remarks=(*tracks.remarks, *moves),
        traced=np.arange(len(turns)) >= len(tags) if len(curve) else None,
    )
    origin, direction = clamp_frame(rec, tracks, raw)
    xy = rotated(in_base - origin, np.array(-direction))
    hint = "Are x_m and y_m in metres? Check length_m and the markers' ids and s."
    camera.check_lengths(xy, rec, "the clamp", "marker", hint)
    if tags:
        check_angles(xy[:, : len(tags)], raw.s[: len(tags)], angle[:, : len(tags)], rec.name)
    turned = replace(raw, xy=xy, angle=camera.unwrap(angle - direction))
    return of_markers(turned, np.argsort(raw.s, kind="stable")) if len(curve) else turned


def read_tracks(rec: Recording) -> Tracks:
    """The table on a grid of times and markers, in the plane of bending, and points of its curves."""
    entry = rec.markers
    assert entry is not None
    known = ("z_m", "angle_rad", "sd_m")
    table = tables.read_columns(entry.file, ("time_s", "x_m", "y_m"), ("id", "order", *known), kind="marker table")
    time, wanted = table.get("time_s"), [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    table.refuse(~(np.abs(time) < signals.LATEST), "time_s is empty or no time. Remove the row, or give its time.")
    drawn = curve_rows(table, "" if rec.tags.on_beam else "[[tags.on_beam]]")
    table.refuse(~drawn & (table.get("id") != np.round(table.get("id"))), "id is no whole number. Number the markers.")
    table.refuse(table.get("sd_m") <= 0.0, "sd_m must be above zero.")
    for name in ("x_m", "y_m", *known):
        table.refuse(np.abs(table.get(name)) > FARTHEST_M, f"{name} is more than {FARTHEST_M:g}. Is it in metres?")
    times, frame = np.unique(time, return_inverse=True)
    signals.check_span(times, str(entry.file), most=signals.MOST_FRAMES)
    grids = {name: np.full((len(times), len(wanted)), np.nan) for name in ("x_m", "y_m", *known)}
    strangers = sorted(set(table.get("id")[~drawn].tolist()) - set(wanted))
    for i, marker in enumerate(wanted):
        rows = np.flatnonzero(table.get("id") == marker)
        again = np.zeros(len(time), dtype=bool)
        again[np.setdiff1d(rows, rows[np.unique(frame[rows], return_index=True)[1]])] = True
        table.refuse(again, f"marker {marker} is there twice at the same time. Remove one of the two rows.")
        for name, grid in grids.items():
            grid[frame[rows], i] = table.get(name)[rows]
    remarks = [Remark("note", f"The table also holds markers that recording.toml does not name: {_ids(strangers)}.")]
    strays = _without_strays(grids, wanted, LEAST_JUMP * rec.beam.length)
    points = np.stack([grids["x_m"], grids["y_m"], grids["z_m"]], axis=-1)
    _refuse_missing(rec, table, points[..., :2], wanted, drawn)
    vertices = vertices_of(table, drawn, frame, len(times), ("x_m", "y_m", "z_m"))
    if "z_m" in table.numbers:
        everything = np.concatenate([points, vertices], axis=1)
        plane = best_plane(everything, entry.seen_from)
        remarks += plane_remarks(plane, everything)
    else:
        points, vertices = points[..., :2], vertices[..., :2]
        plane = Plane(np.zeros(2), np.eye(2), np.zeros(2))
    _check_dimensions(rec, points.shape[-1])
    xy = plane.lay(points)
    sd = np.where(np.isfinite(grids["sd_m"]), grids["sd_m"], entry.sd)
    tracks = Tracks(
        time=times,
        xy=xy,
        angle=grids["angle_rad"],
        sd=np.where(np.isfinite(sd), sd, _noise(xy, LEAST_SD, LEAST_SD)),
        clamp=plane.lay(np.array(entry.clamp)) if entry.clamp else None,
        x_axis=plane.axes @ np.array(entry.x_axis) if entry.x_axis else None,
        remarks=(*remarks[0 if strangers else 1 :], *strays, *_gaps(xy, wanted)),
    )
    if not drawn.any():
        return tracks
    return _with_curve(rec, tracks, plane.lay(vertices), stated_sd(table, drawn, frame, len(times), entry.sd))


def _with_curve(rec: Recording, tracks: Tracks, vertices: Array, sd: Array) -> Tracks:
    """With points of the curve through the vertices (T, n, 2) m, each of which is known to `sd` (T,) m (NaN: not
    said)."""
    curve = points_on(vertices, rec.beam.length, rec.name, tracks.clamp)
    own = (sd / np.sqrt(curve.share))[:, None]
    own = np.where(np.isfinite(own), own, _noise(curve.xy, LEAST_SD, LEAST_SD))
    return replace(
        tracks,
        xy=np.concatenate([tracks.xy, curve.xy], axis=1),
        angle=np.concatenate([tracks.angle, camera.unwrap(curve.angle)], axis=1),
        sd=np.concatenate([tracks.sd, own], axis=1),
        curve=outline.POINTS,
    )


def _without_copies(tracks: Tracks) -> Tracks:
    """Without the frames that repeat all places of the frame before while the markers move."""
    change = np.abs(np.diff(tracks.xy, axis=0))
    digit = float(np.min(change, where=change > 0.0, initial=np.inf))  # rounded places stay where a marker moves slowly
    stale = signals.copies_in_motion(tracks.time, tracks.xy, 0.5 * digit, 5.0 * digit)
    if not stale.any():
        return tracks
    text = (
        f"{stale.sum()} of {len(stale)} frames ({100 * stale.mean():.2g} %) of the tracks only repeat the one before "
        "while the markers move, as where a recorder drops frames. They are left out."
    )
    kept = {name: getattr(tracks, name)[~stale] for name in ("time", "xy", "angle", "sd")}
    return replace(tracks, remarks=(*tracks.remarks, Remark("warning", text, about="film hung")), **kept)


def base_motion(tracks: Tracks, base: int) -> tuple[Array, Array, tuple[Remark, ...]]:
    """(T, 2) m shift and (T,) rad turn of the base since the first frames, and a remark where it moves.

    One marker without an angle shows no turn. Frames without a base marker take the last known pose.
    """
    count = len(tracks.time)
    if base == 0:
        return np.zeros((count, 2)), np.zeros(count), ()
    xy, angle = tracks.xy[:, :base], tracks.angle[:, :base]
    middle, smooth = np.nanmedian(xy, axis=0), signals.running_median(_held(xy.reshape(count, -1)), camera.RUNNING)
    step = np.nan_to_num(np.linalg.norm(smooth.reshape(xy.shape) - middle, axis=-1))
    if not np.any(step > camera.MOVED * np.nanmedian(tracks.sd[:, :base], axis=0)):
        return np.broadcast_to(middle[0], (count, 2)), np.zeros(count), ()
    first, turn = int(np.argmax(np.isfinite(xy).all(axis=(1, 2)))), np.zeros(count)
    if np.isfinite(angle[:, 0]).any():
        turn = camera.unwrap(angle[:, 0] - angle[first, 0])
    elif base > 1:
        relative, reference = xy - xy[:, :1], xy[first] - xy[first, 0]
        cross = reference[:, 0] * relative[..., 1] - reference[:, 1] * relative[..., 0]
        turn = camera.unwrap(np.arctan2(np.sum(cross, axis=1), np.sum(relative * reference, axis=(1, 2))))
    shift, turn = _held(xy[:, 0]), _held(turn[:, None])[:, 0]
    text = f"The base moves, by up to {1000 * float(step.max()):.2g} mm and {math.degrees(float(np.ptp(turn))):.2g} deg"
    if base == 1 and not np.isfinite(angle).any():
        text += "; one marker without an angle does not show its turn. Put a second one on it"
    text += ". It was followed from frame to frame. Fix the base, and the tracker"
    return shift, turn, (Remark("warning", f"{text}.", about="base moves"),)


def clamp_frame(rec: Recording, tracks: Tracks, raw: Markers) -> tuple[Array, float]:
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
    still = force.find_contact(with_angles(raw)).still
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


def _noise(values: Array, least: float, unknown: float) -> Array:
    """(n,) one sd of the noise of tracks (T, n, ...), from second differences; `unknown` where there are none."""
    bends = np.abs(np.diff(np.atleast_3d(values), n=2, axis=0)) / math.sqrt(6)
    known = np.isfinite(bends).any(axis=(0, 2))
    sd = np.full(values.shape[1], unknown)
    sd[known] = np.maximum(signals.MAD_TO_SD * np.nanmedian(bends[:, known], axis=(0, 2)), least)
    return sd


def _held(values: Array) -> Array:
    """(T, n) with gaps filled by the last known row (the first known before it)."""
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return np.nan_to_num(values)
    rows = np.maximum.accumulate(np.where(known, np.arange(len(values)), -1))
    return np.asarray(values[np.where(rows < 0, int(np.argmax(known)), rows)])


def _refuse_missing(rec: Recording, table: tables.Columns, xy: Array, wanted: list[int], drawn: BoolArray) -> None:
    """An error where a marker of recording.toml is nowhere in the table, whose `drawn` (N,) rows have no id."""
    present = np.asarray(np.isfinite(xy).all(axis=-1).any(axis=0)).tolist()
    if never := [marker for marker, shown in zip(wanted, present, strict=True) if not shown]:
        in_table = _ids(sorted(set(table.get("id")[~drawn].tolist())))
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


def _without_strays(grids: Mapping[str, Array], wanted: list[int], least: float) -> tuple[Remark, ...]:
    """Takes out of the grids, in place, the rows in which a tracker took something else for a marker."""
    out = []
    for i, marker in enumerate(wanted):
        known = np.flatnonzero(np.isfinite(grids["x_m"][:, i]) & np.isfinite(grids["y_m"][:, i]))
        strays = known[signals.jumps(np.column_stack([grids["x_m"][known, i], grids["y_m"][known, i]]), least)]
        for grid in grids.values():
            grid[strays, i] = np.nan
        if len(strays):
            text = f"Marker {marker} jumps away and back in {len(strays)} of {len(known)} frames: they are left out."
            out.append(Remark("note", text))
    return tuple(out)


def _gaps(xy: Array, wanted: list[int]) -> tuple[Remark, ...]:
    missing = ~np.isfinite(xy).all(axis=-1)
    return tuple(
        Remark("note", f"Marker {marker} is missing in {count} of {len(xy)} frames.")
        for marker, count in zip(wanted, missing.sum(axis=0).tolist(), strict=True)
        if count > 0.05 * len(xy)
    )


def _ids(markers: list[float] | list[int]) -> str:
    return ", ".join(f"{marker:g}" for marker in markers)


TIME = "time_s"
_POINTS = ("id", "x_m", "y_m")


@dataclass(frozen=True)
class SwingSignals:
    """C signals at N times; NaN where one is not known."""

    name: str
    time: Array  # (N,) s
    value: Array  # (N, C) each in a unit of its own


def signals_of_table(path: Path) -> SwingSignals:
    """Every column of numbers beside time_s; of a table of tracks (id, x_m, y_m) the places of each point."""
    table = tables.read_every_column(path, TIME, kind="table of a swing")
    if set(_POINTS) <= set(table.numbers):
        return _of_points(path)
    labels = tuple(name for name in table.numbers if name != TIME and np.isfinite(table.numbers[name]).any())
    if not labels:
        raise RecordingError(f"{path}: there is nothing beside {TIME}. Add a column for each signal, such as y_m.")
    return SwingSignals(path.name, table.get(TIME), np.stack([table.numbers[name] for name in labels], axis=1))


def signals_of_tracks(rec: Recording) -> SwingSignals:
    """Of the markers of a recording, or of its curve, in the tracker's plane."""
    tracks, base = read_tracks(rec), len(rec.tags.on_base)
    return signals_of_places(rec.name, tracks.time, tracks.xy[:, base:])


def signals_of_places(name: str, time: Array, xy: Array) -> SwingSignals:
    """Of points (T, m, 2) m, such as tags in a film against the base tag."""
    return SwingSignals(name, time, xy.reshape(len(time), -1))


def _of_points(path: Path) -> SwingSignals:
    table = tables.read_columns(path, (TIME, *_POINTS), kind="table of tracks")
    time, row = np.unique(table.get(TIME), return_inverse=True)
    ids, column = np.unique(table.get("id"), return_inverse=True)
    places = np.full((len(time), len(ids), 2), np.nan)
    places[row, column] = np.stack([table.get("x_m"), table.get("y_m")], axis=1)
    return signals_of_places(path.name, time, places)


def measured_frequencies(rec: Recording) -> tuple[MeasuredFrequency, ...]:
    """Undamped, with gravity in the beam's frame."""
    every = tuple(_measured(one, rec) for one in rec.frequencies)
    for one, other in permutations(every, 2):
        alike = one.tip_mass == other.tip_mass and np.allclose(one.gravity, other.gravity)
        if alike and one.mode < other.mode and one.frequency >= other.frequency:
            raise RecordingError(
                f"{rec.folder}: mode {one.mode} at {one.frequency:.4g} Hz is no slower than mode {other.mode} at "
                f"{other.frequency:.4g} Hz in the same posture. Correct hz or mode in [[frequencies]].",
                about="unit",
            )
    return every


def with_frequencies(seen: Observations, rec: Recording) -> Observations:
    """What was seen of the beam, and how fast it swings."""
    if not rec.frequencies:
        return seen
    source = replace(seen.source, remarks=(*seen.source.remarks, *_remarks(rec)))
    return replace(seen, source=source, frequencies=measured_frequencies(rec))


def frequency_observations(rec: Recording) -> Observations:
    """A recording of frequencies alone. All that it shows of the beam is the clamp in its place: nothing of k."""
    seen = Observations(
        source=Source(rec.name, remarks=rec.remarks),
        stated=replace(stated.stated_in(rec), clamp_sd=0.0, placement_sd=0.0, turn_sd=0.0),
        length=rec.beam.length,
        time=np.zeros(1),
        frame=np.zeros(1, dtype=np.int64),
        tag_id=np.array([tag.id for tag in rec.tags.on_beam], dtype=np.int64),
        marker_s=np.zeros(1),
        xy=np.zeros((1, 1, 2)),
        angle=np.zeros((1, 1)),
        covariance=np.full((1, 1, 3, 3), 1e-12) * np.eye(3),  # the clamp is where it is
        force=np.zeros((1, 2)),
        force_sd=np.zeros(2),
        push_s=np.ones(1),
        loaded=np.ones(1, dtype=bool),
        rest_xy=np.full((1, 2), np.nan),
        rest_angle=np.full(1, np.nan),
        rest_covariance=np.full((1, 3, 3), np.nan),
        gravity=np.zeros((1, 2)),
        static=True,
    )
    return with_frequencies(seen, rec)


def _measured(one: FrequencyEntry, rec: Recording) -> MeasuredFrequency:
    undamped = 1.0 / math.sqrt(1.0 - one.damping_ratio**2)
    base, x, y = _base_angle(one, rec), 0.0, 0.0
    if math.isfinite(base):
        room = rec.gravity or GravityEntry(direction=-math.pi / 2.0)
        fall = room.direction - base
        x, y = (room.magnitude * (part if abs(part) >= 1e-12 else 0.0) for part in (math.cos(fall), math.sin(fall)))
    return MeasuredFrequency(undamped * one.hz, undamped * one.sd, one.mode, (x, y), one.tip_mass)


def _base_angle(one: FrequencyEntry, rec: Recording) -> float:
    """rad; NaN where nothing says it."""
    return one.base_angle if math.isfinite(one.base_angle) or rec.gravity is None else rec.gravity.base_angle


def _remarks(rec: Recording) -> tuple[Remark, ...]:
    across = [f"{one.hz:.4g}" for one in rec.frequencies if not math.isfinite(_base_angle(one, rec))]
    if not across:
        return ()
    text = (
        f"{', '.join(across)} Hz: without base_angle_deg the beam is taken to swing across gravity, where its weight "
        "does nothing to its frequency"
    )
    return (Remark("note", text),)
