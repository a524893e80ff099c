"""Static poses to observations: loads that are known, no clock; points may be missing in any pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording.entries import Axes, PosesEntry, Recording
from onebend.recording.force_log import refuse_other_unit, size_remarks
from onebend.recording.outline import PLACES, POINTS
from onebend.recording.schema import lines_of_keys
from onebend.recording.stated import stated_in
from onebend.recording.tables import Columns, read_columns
from onebend.recording.tracks import chord_angles, curve_rows, points_on, stated_sd, vertices_of
from onebend.records import (
    POINT_ID,
    UNKNOWN_ANGLE_SD,
    Array,
    BoolArray,
    IntArray,
    KnownLoads,
    Observations,
    Readings,
    Remark,
    Source,
    View,
)
from onebend.text_files import MOST_TOML, read_text

WRENCH = ("fx_N", "fy_N", "moment_N_m")  # what may be unknown, all three at once
AMOUNTS = ("weight_N", "mass_kg", *WRENCH)
LARGEST = 1e6  # N, N m or kg: no beam that is bent by hand or by weights bears more


@dataclass(frozen=True)
class PoseLoads:
    """The clamp, gravity and the loads of P poses, in the order of the table."""

    names: tuple[str, ...]
    clamp: Array  # (P,) rad, the beam's x axis in the room; NaN where nothing says it
    gravity: Array  # (P, 2) m/s^2 in the beam's frame; zeros where the beam's weight acts across the plane
    force: Array  # (P, 2) N, the first force of each pose, beam's frame
    push_s: Array  # (P,) where it acts; the tip where there is none
    others: KnownLoads | None  # further forces, and moments
    held: BoolArray  # (P,) the end s = 1 is held, nobody knows with what force and moment


def read_loads(path: Path, rec: Recording, axes: Axes) -> PoseLoads:
    """The loads of every pose that the table names; a row without a load names a pose of the bare beam."""
    columns = ("s", "clamp_deg", *AMOUNTS)
    table = read_columns(path, (), columns, labels=("pose",), kind="table of loads", unknown=WRENCH, strict=True)
    held_rows = _held(table)
    amounts = {name: np.where(held_rows, np.nan, table.get(name)) for name in AMOUNTS}
    too_much = np.any([np.abs(np.nan_to_num(values)) > LARGEST for values in amounts.values()], axis=0)
    table.refuse(too_much, f"a load of more than {LARGEST:g} is none. Check its unit.")
    table.refuse(np.nan_to_num(amounts["mass_kg"]) < 0.0, "mass_kg is negative. A pull upwards is a weight_N below 0.")
    loaded = np.any([np.nan_to_num(values) != 0.0 for values in amounts.values()], axis=0)
    s = table.get("s")
    table.refuse(loaded & ~((s >= 0.0) & (s <= 1.0)), "a load needs its place: s between 0 at the clamp and 1.")
    table.refuse(np.isfinite(amounts["weight_N"]) & np.isfinite(amounts["mass_kg"]), "both weight_N and mass_kg.")
    names = tuple(dict.fromkeys(table.labels["pose"]))
    pose = np.array([names.index(name) for name in table.labels["pose"]])
    clamp = np.radians(_one_each(table, "clamp_deg", pose, len(names)))
    clamp = np.where(np.isfinite(clamp), clamp, rec.gravity.base_angle if rec.gravity is not None else math.nan)
    magnitude = rec.gravity.magnitude if rec.gravity is not None else 9.81
    hung = np.nan_to_num(amounts["weight_N"]) + np.nan_to_num(amounts["mass_kg"]) * magnitude
    table.refuse(
        ((hung != 0.0) | (loaded & (axes == "room"))) & ~np.isfinite(clamp[pose]),
        "a weight, or a force in the room's axes, needs the clamp's angle. Give clamp_deg in the table, or "
        "base_angle_deg in [gravity].",
    )
    given = np.stack([np.nan_to_num(amounts["fx_N"]), np.nan_to_num(amounts["fy_N"])], axis=1)
    force = turned(given, clamp[pose]) if axes == "room" else given
    down = np.full(len(pose), rec.gravity.direction if rec.gravity else -math.pi / 2) - np.nan_to_num(clamp[pose])
    force = force + hung[:, None] * np.stack([np.cos(down), np.sin(down)], axis=1)
    moment = np.nan_to_num(amounts["moment_N_m"])
    gravity = np.zeros((len(names), 2))
    if rec.gravity is not None:
        fall = rec.gravity.direction - clamp
        if not np.isfinite(fall).all():
            pose_name = names[int(np.argmax(~np.isfinite(fall)))]
            raise RecordingError(
                f"{path}: nothing says how the clamp is turned in pose {pose_name}. Give clamp_deg there, or "
                "base_angle_deg in [gravity] for all poses."
            )
        gravity = rec.gravity.magnitude * np.stack([np.cos(fall), np.sin(fall)], axis=1)
    first, push_s, others = _shared(pose, len(names), force, moment, s)
    held = np.array([bool(np.any(held_rows[pose == i])) for i in range(len(names))])
    return PoseLoads(names, clamp, gravity, first, push_s, others, held)


def turned(vectors: Array, clamp: Array) -> Array:
    """Room vectors (..., 2) in the frame of a clamp turned by `clamp` (...) [rad]; NaN spoils only what depends on
    it."""
    cos, sin = np.cos(np.nan_to_num(clamp)), np.sin(np.nan_to_num(clamp))
    cos, sin = (np.where(np.abs(part) < 1e-9, 0.0, part) for part in (cos, sin))

    def times(share: Array, value: Array) -> Array:
        return np.where(share == 0.0, 0.0, share * value)

    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([times(cos, x) + times(sin, y), times(cos, y) - times(sin, x)], axis=-1)


def _held(table: Columns) -> BoolArray:
    """(N,) rows of an end that is held with an unknown force and moment."""
    unknown = np.isinf(np.stack([table.get(name) for name in WRENCH]))
    table.refuse(
        np.any(unknown, axis=0) & ~np.all(unknown, axis=0),
        f"a held end has an unknown force and moment: write unknown for all of {', '.join(WRENCH)}, or numbers.",
    )
    held = np.all(unknown, axis=0)
    table.refuse(held & (table.get("s") != 1.0), "only the end can be held with an unknown load: give s = 1 there.")
    weighed = np.isfinite(table.get("weight_N")) | np.isfinite(table.get("mass_kg"))
    table.refuse(held & weighed, "a load that is unknown and a weight: give the weight a row of its own.")
    return np.asarray(held)


def _one_each(table: Columns, column: str, pose: np.ndarray, count: int) -> Array:
    """(P,) a column that says one number of each pose; NaN where it says none."""
    out, values = np.full(count, np.nan), table.get(column)
    for i in range(count):
        stated = values[(pose == i) & np.isfinite(values)]
        if len(stated):
            table.refuse((pose == i) & (np.ptp(stated) > 0.0), f"{column} differs within the pose. Give one.")
            out[i] = stated[0]
    return out


def _shared(
    pose: np.ndarray, count: int, force: Array, moment: Array, s: Array
) -> tuple[Array, Array, KnownLoads | None]:
    """The largest force of each pose and its place, and all the rest; rows of a pose at one place are one load."""
    first, push_s = np.zeros((count, 2)), np.ones(count)
    further: list[list[tuple[Array, float]]] = []
    turns: list[list[tuple[float, float]]] = []
    for i in range(count):
        rows = np.flatnonzero(pose == i)
        sums = [(np.sum(force[rows[s[rows] == place]], axis=0), place) for place in sorted({*s[rows].tolist()})]
        pushes = [(f, place) for f, place in sums if np.any(f != 0.0)]
        pushes.sort(key=lambda load: -float(np.linalg.norm(load[0])))
        if pushes:
            first[i], push_s[i] = pushes[0]
        further.append(pushes[1:])
        turns.append([(float(moment[r]), float(s[r])) for r in rows if moment[r] != 0.0])
    a, b = max(map(len, further)), max(map(len, turns))
    if a == 0 and b == 0:
        return first, push_s, None
    others = KnownLoads(np.zeros((count, a, 2)), np.ones((count, a)), np.zeros((count, b)), np.ones((count, b)))
    for i in range(count):
        for j, (f, place) in enumerate(further[i]):
            others.force[i, j], others.force_s[i, j] = f, place
        for j, (m, place) in enumerate(turns[i]):
            others.moment[i, j], others.moment_s[i, j] = m, place
    return first, push_s, others


GUESSED_SD = 1e-3  # of the length: of a point where nobody says how exactly it was measured
ANGLE_SD = math.radians(1.0)  # of an angle read off by hand
LEVEL = 1e-9  # sine of the angle of a clamp that is level


def readings_of(rec: Recording, loads: PoseLoads, table: Columns) -> Readings:
    """How the points of the table were read."""
    entry = rec.poses
    assert entry is not None
    if entry.read_at == "x":
        table.refuse(~np.isfinite(table.get("x_m")), 'a ruler stands at its x_m (read_at = "x"): give it.')
        if entry.axes == "room" and np.any(np.abs(np.sin(np.nan_to_num(loads.clamp))) > LEVEL):
            _refuse(rec, "read_at", "in the room's axes needs a level clamp. Measure in the beam's (axes = \"beam\").")
    bare = -1
    if entry.relative_to:
        if entry.relative_to not in loads.names:
            known = ", ".join(loads.names[:8])
            _refuse(rec, "relative_to", f"names no pose of {entry.loads.name}. It has {known}. Add a row for it there.")
        bare = loads.names.index(entry.relative_to)
        zero = np.array([name == entry.relative_to for name in table.labels["pose"]])
        table.refuse(zero, f"the gauges were zeroed in pose {entry.relative_to} (relative_to): take the row out.")
        table.refuse(np.isfinite(table.get("angle_deg")), "an angle has no zero (relative_to). Take it out.")
        if entry.axes == "room" and np.ptp(np.nan_to_num(loads.clamp)) > LEVEL:
            _refuse(rec, "relative_to", "needs a clamp that stays as it is (clamp_deg): gauges do not turn with it.")
        if entry.read_at == "x":
            _refuse_moved(table)
    if np.any(loads.held) and (bare >= 0 or entry.read_at == "x"):
        name = "relative_to" if bare >= 0 else "read_at"
        _refuse(rec, name, "needs a free end: where an unknown load holds it, the points say where the beam is.")
    return Readings(entry.read_at, bare, entry.error_length)


def reading_remarks(loads: PoseLoads, readings: Readings) -> tuple[Remark, ...]:
    """Notes on what the points count from, where that is not the clamp, and on what stands still."""
    notes = []
    if readings.bare >= 0:
        notes.append(f"The readings count from pose {loads.names[readings.bare]}, where each is 0.")
    if readings.at == "x":
        notes.append("The points are rulers that stand at their x_m: y is of what passes there.")
    return tuple(Remark("note", text) for text in notes)


def with_zero(readings: Readings, xy: Array, covariance: Array) -> tuple[Array, Array]:
    """Points (P, m, 2) and covariances (P, m, 3, 3) with the pose of the zero, where each gauge shows 0."""
    if readings.bare < 0:
        return xy, covariance
    seen = np.isfinite(xy)
    zero = np.where(np.any(seen, axis=0), 0.0, np.nan)
    if readings.at == "x":  # a ruler stands where it stands
        zero[:, 0] = np.nanmax(np.where(np.any(seen, axis=0), xy, -np.inf), axis=0)[:, 0]
        zero[~np.isfinite(zero[:, 0])] = np.nan
    xy, covariance = xy.copy(), covariance.copy()
    xy[readings.bare] = zero
    for i in range(xy.shape[1]):
        rows = np.any(seen[:, i], axis=1)
        if rows.any():
            covariance[readings.bare, i] = np.median(covariance[rows, i], axis=0)
    return xy, covariance


def point_covariances(entry: PosesEntry, length: float, xy: Array, angle: Array, sd: Array) -> tuple[Array, bool]:
    """(P, m, 3, 3) of points (P, m, 2) [m] and angles (P, m) [rad], and whether all sds are stated. What the table says
    of a point, `sd` (P, m) m, goes before what recording.toml says of all."""
    sd = np.where(np.isfinite(sd), sd, entry.sd)
    out = np.zeros((*angle.shape, 3, 3))
    out[..., [0, 1], [0, 1]] = np.where(np.isfinite(sd), sd, GUESSED_SD * length)[..., None] ** 2
    out[..., 2, 2] = np.where(np.isfinite(angle), ANGLE_SD, UNKNOWN_ANGLE_SD) ** 2
    return out, bool(np.isfinite(sd[np.isfinite(xy).any(axis=-1)]).all())


def check_rulers(rec: Recording, loads: PoseLoads, xy: Array) -> None:
    """Raises `ObservationError` where a ruler stands where no part of the beam can be."""
    wrong = (xy[..., 0] <= 0.0) | (xy[..., 0] > rec.beam.length)
    if np.any(wrong):
        pose, i = np.argwhere(wrong)[0].tolist()
        raise ObservationError(
            f"{rec.name}: in pose {loads.names[pose]} the ruler of point {rec.tags.on_beam[i].id} stands at x = "
            f"{1000 * xy[pose, i, 0]:.4g} mm, where no beam of {1000 * rec.beam.length:.4g} mm passes. Is x_m in "
            "metres, and from the clamp?",
            about="unit",
        )


def _refuse_moved(table: Columns) -> None:
    """Raises `RecordingError` where a gauge that was zeroed stands elsewhere in another pose."""
    ids, x = table.get("id"), table.get("x_m")
    first = np.array([x[int(np.argmax(ids == i))] for i in ids])
    table.refuse(np.abs(x - first) > LEVEL, "the gauge was zeroed at another x_m (relative_to): zero it anew.")


def _refuse(rec: Recording, name: str, text: str) -> NoReturn:
    """Raises `RecordingError` at the line of a key of [poses]."""
    path = rec.folder / "recording.toml"
    line = lines_of_keys(read_text(path, RecordingError, most=MOST_TOML)).get(("poses", name), 1)
    raise RecordingError(f"{path}:{line}: {name} {text}")


FEWEST_HELD = 3  # points of a pose whose end is held by an unknown load


@dataclass(frozen=True)
class PosePoints:
    """Where the points were, in the beam's frame; NaN where not measured."""

    tag_id: IntArray  # (m,)
    s: Array  # (m,)
    xy: Array  # (P, m, 2) m
    angle: Array  # (P, m) rad
    covariance: Array  # (P, m, 3, 3)
    sd_known: bool
    clamp_sd: float  # rad
    readings: Readings = field(default_factory=Readings)
    view: View | None = None
    remarks: tuple[Remark, ...] = ()
    traced: BoolArray | None = None  # (m,) as `Observations.traced`


def pose_observations(rec: Recording) -> Observations:
    """Observations from a table of poses and a table of loads."""
    assert rec.poses is not None
    loads = read_loads(rec.poses.loads, rec, rec.poses.axes)
    return static(rec, loads, read_points(rec, loads), rec.poses.load_sd)


def static(rec: Recording, loads: PoseLoads, points: PosePoints, load_sd: float) -> Observations:
    """Poses and loads as observations; every pose is a frame, also one of the bare beam."""
    check_reach(rec, loads, points)
    _check_held(rec, loads, points)
    refuse_other_unit(loads.force, rec.beam.mass, rec.name, "loads")
    units = size_remarks(loads.force, rec.beam.mass, "loads")
    count, m = points.angle.shape
    turns = np.round((points.angle - chord_angles(points.xy, points.s)) / (2.0 * np.pi))  # read without full turns
    nothing = not (np.any(loads.force) or np.any(loads.gravity) or loads.others is not None or np.any(loads.held))
    if nothing or not np.isfinite(points.xy).any():
        raise ObservationError(f"{rec.name}: no pose has both a load and a point. Add them to the two tables.")
    return Observations(
        source=Source(rec.name, view=points.view, remarks=(*rec.remarks, *units, *points.remarks)),
        stated=replace(stated_in(rec), clamp_sd=points.clamp_sd),
        length=rec.beam.length,
        time=np.arange(count, dtype=float),
        frame=np.arange(count, dtype=np.int64),
        tag_id=points.tag_id,
        marker_s=points.s,
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
        pose_names=loads.names,
        traced=points.traced,
    )


def read_points(rec: Recording, loads: PoseLoads) -> PosePoints:
    """The table of points, on a grid of poses and points, in the beam's frame; and points of its curves."""
    entry = rec.poses
    assert entry is not None
    known = ("id", "order", "x_m", "angle_deg", "sd_m")
    table = read_columns(entry.file, ("y_m",), known, labels=("pose",), kind="table of poses", strict=True)
    ids = [tag.id for tag in rec.tags.on_beam]
    strange = np.array([name not in loads.names for name in table.labels["pose"]])
    table.refuse(strange, f"the pose is not in {entry.loads.name}. Name it there, without a load if it has none.")
    drawn = curve_rows(table, "" if ids else "[[points]]")
    table.refuse(~drawn & ~np.isin(table.get("id"), ids), f"id is none of the points in recording.toml ({ids}).")
    table.refuse(table.get("sd_m") <= 0.0, "sd_m must be above zero.")
    readings = readings_of(rec, loads, table)
    pose = np.array([loads.names.index(name) for name in table.labels["pose"]])
    rows = np.flatnonzero(~drawn)
    cells = [(int(pose[row]), ids.index(int(table.get("id")[row]))) for row in rows]
    twice = np.zeros(len(pose), dtype=bool)
    twice[rows] = [cells.index(cell) < k for k, cell in enumerate(cells)]
    table.refuse(twice, "the point is there twice in its pose.")
    room, shape = entry.axes == "room", (len(loads.names), len(ids))
    if room and not np.isfinite(loads.clamp).all():
        raise ObservationError(
            f'{rec.name}: axes = "room" needs the clamp\'s angle. Give base_angle_deg in [gravity], or clamp_deg with '
            "the loads."
        )
    grids = {name: np.full(shape, np.nan) for name in ("x_m", "y_m", "angle_deg", "sd_m")}
    for name, grid in grids.items():
        grid[tuple(np.array(cells, dtype=int).reshape(-1, 2).T)] = table.get(name)[rows]
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
    covariance, sd_known = point_covariances(entry, rec.beam.length, xy, angle, grids["sd_m"])
    xy, covariance = with_zero(readings, xy, covariance)
    remarks = reading_remarks(loads, readings)
    remarks += () if sd_known else (Remark("note", "How exactly the points were measured is estimated from the fit."),)
    number = np.array(ids, dtype=np.int64)
    points = PosePoints(number, s, xy, angle, covariance, sd_known, entry.clamp_sd, readings, remarks=remarks)
    return _with_curves(rec, loads, points, table, drawn, pose) if drawn.any() else points


ERROR_LENGTH = 0.2  # of the length: over which the errors of a curve are alike, where nobody says it


def _with_curves(
    rec: Recording, loads: PoseLoads, points: PosePoints, table: Columns, drawn: BoolArray, pose: IntArray
) -> PosePoints:
    """With points of the curves in the table, whose `drawn` (N,) rows are vertices, each row of a `pose` (N,)."""
    entry = rec.poses
    assert entry is not None
    for name, wrong in (("read_at", points.readings.at == "x"), ("relative_to", points.readings.bare >= 0)):
        if wrong:
            _refuse(rec, name, "is of points, and the table holds a curve (order). Measure the curve from the clamp.")
    vertices = vertices_of(table, drawn, pose, len(loads.names))
    if entry.axes == "room":
        vertices = turned(vertices, loads.clamp[:, None])
    curve = points_on(vertices, rec.beam.length, rec.name)
    sd = stated_sd(table, drawn, pose, len(loads.names), entry.sd)
    known = bool(np.isfinite(sd[np.unique(pose[drawn])]).all())
    variance = np.where(np.isfinite(sd), sd, GUESSED_SD * rec.beam.length)[:, None, None, None] ** 2
    return replace(
        points,
        tag_id=np.append(points.tag_id, POINT_ID + np.arange(POINTS)),
        s=np.append(points.s, PLACES),
        xy=np.concatenate([points.xy, curve.xy], axis=1),
        angle=np.concatenate([points.angle, curve.angle], axis=1),
        covariance=np.concatenate([points.covariance, variance * np.ones((1, POINTS, 1, 1)) * np.eye(3)], axis=1),
        sd_known=points.sd_known and known,
        readings=replace(points.readings, error_length=entry.error_length or ERROR_LENGTH * rec.beam.length),
        traced=np.arange(len(points.s) + POINTS) >= len(points.s),
    )


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

    A deflection alone may be small. A reading that counts from a bent pose may be twice as large.
    """
    if points.readings.at == "x":
        return check_rulers(rec, loads, points.xy)
    distance = np.linalg.norm(np.nan_to_num(points.xy), axis=-1) * (0.5 if points.readings.bare >= 0 else 1.0)
    arc = points.s * rec.beam.length
    relative = distance / np.maximum(arc, 1e-9 * rec.beam.length)
    whole = np.isfinite(points.xy).all(axis=-1)
    # Of the arc length: if every point is nearer to the clamp than this, the unit is wrong.
    if points.readings.bare < 0 and np.any(distance[whole] > 0.0) and np.max(relative) < 0.02:
        raise ObservationError(
            f"{rec.name}: every point is within {100 * np.max(relative):.2g} % of the beam's length of the clamp. Is "
            f"length_m = {rec.beam.length:g} in metres, as x_m and y_m are?",
            about="unit",
        )
    sd = np.sqrt(np.trace(points.covariance[..., :2, :2], axis1=-2, axis2=-1))
    # Of the arc length: a point's distance from the clamp cannot be larger.
    reach = 1.05 * arc + 3 * rec.tags.placement_sd + 3 * sd
    if np.any(distance > reach):
        pose, i = np.argwhere(distance > reach)[0].tolist()
        raise ObservationError(
            f"{rec.name}: in pose {loads.names[pose]} point {points.tag_id[i]} is {1000 * distance[pose, i]:.4g} "
            f"mm from the clamp, and only {1000 * arc[i]:.4g} mm of beam lead there. "
            "Are x_m and y_m in metres, and from the clamp? Check length_m and the points' s.",
            about="unit",
        )
