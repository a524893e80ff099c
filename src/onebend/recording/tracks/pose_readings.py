"""How points of poses were read: their errors along and across the beam, gauges that were zeroed, rulers that stand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NoReturn

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording.tables import Columns
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.schema import lines_of_keys
from onebend.recording.toml.source_entries import PosesEntry
from onebend.recording.tracks.chords import chord_angles
from onebend.recording.tracks.pose_loads import PoseLoads
from onebend.records import UNKNOWN_ANGLE_SD, Array, Readings, Remark
from onebend.text_files import MOST_TOML, read_text

GUESSED_SD = 1e-3  # of the length: of a point where nobody says how exactly it was measured
ANGLE_SD = math.radians(1.0)  # of an angle read off by hand
SDS = ("sd_m", "along_sd_m", "across_sd_m")
LEVEL = 1e-9  # sine of the angle of a clamp that is level


def readings_of(rec: Recording, loads: PoseLoads, table: Columns) -> Readings:
    """How the points of the table were read.

    Raises:
        RecordingError: the pose of the zero is not there, or was read itself; rulers without their x; what rulers and
            zeroed gauges cannot read.
    """
    entry = rec.poses
    assert entry is not None
    if entry.read_at == "x":
        table.refuse(np.isfinite(table.get("along_sd_m")), "along_sd_m is of marks. A ruler that stands reads y alone.")
        table.refuse(~np.isfinite(table.get("x_m")), 'a ruler stands at its x_m (read_at = "x"): give it.')
        if math.isfinite(entry.along_sd):
            _refuse(rec, "along_sd_m", 'is of marks, and rulers stand (read_at = "x"): placement_sd_m is of their x_m.')
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
    """Points (P, m, 2) and covariances (P, m, 3, 3), in the pose of the zero too: each gauge shows 0 there, and is
    zeroed as exactly as it is read."""
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


def point_covariances(
    entry: PosesEntry, length: float, s: Array, xy: Array, angle: Array, grids: Mapping[str, Array]
) -> tuple[Array, bool]:
    """(P, m, 3, 3) of points (P, m, 2) [m] and angles (P, m) [rad], and whether somebody says them all.

    What is said of one point goes before what is said of all, and what is said of a direction before what is said of
    both. `grids`: (P, m) m of each of `SDS`.
    """
    sds = []
    for name, whole in (("along_sd_m", entry.along_sd), ("across_sd_m", entry.across_sd)):
        sd = np.where(np.isfinite(grids[name]), grids[name], grids["sd_m"])
        sds.append(np.where(np.isfinite(sd), sd, whole if math.isfinite(whole) else entry.sd))
    along, across = sds
    asked = np.isfinite(xy).any(axis=-1)
    alone = asked & ~np.isfinite(xy).all(axis=-1)  # a ruler's reading is across
    known = np.isfinite(across) & (np.isfinite(along) | alone)
    guess = GUESSED_SD * length
    along, across = (np.where(np.isfinite(sd), sd, guess) for sd in (along, across))
    turn = np.where(along == across, 0.0, _directions(xy, s, angle))
    if entry.read_at == "x":
        along, turn = across, np.zeros_like(turn)
    cos, sin = np.cos(turn), np.sin(turn)
    axes = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=-2)
    out = np.zeros((*angle.shape, 3, 3))
    sizes = np.stack([along, across], axis=-1)[..., None, :] ** 2
    out[..., :2, :2] = (axes * sizes) @ np.swapaxes(axes, -1, -2)
    out[..., 2, 2] = np.where(np.isfinite(angle), ANGLE_SD, UNKNOWN_ANGLE_SD) ** 2
    return out, bool(np.all(known[asked]))


def _directions(xy: Array, s: Array, angle: Array) -> Array:
    """(P, m) rad, of the beam at the points: as measured, else of the chords between those of which x and y are; 0
    where neither is known, so that across is y."""
    out = np.zeros(angle.shape)
    for pose, points in enumerate(xy):
        whole = np.isfinite(points).all(axis=-1)
        if whole.any():
            out[pose, whole] = chord_angles(points[whole][None], s[whole])[0]
    return np.where(np.isfinite(angle), angle, out)


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
