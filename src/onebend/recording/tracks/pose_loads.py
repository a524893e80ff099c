"""The loads of static poses: a table with one row per load, weights along gravity, forces, moments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.tables import Columns, read_columns
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.source_entries import Axes
from onebend.records import Array, BenchPoses, BoolArray, KnownLoads

WRENCH = ("fx_N", "fy_N", "moment_N_m")  # what may be unknown, all three at once
AMOUNTS = ("weight_N", "mass_kg", *WRENCH)
CAME_BY = ("turned_from_deg", "order")  # how the beam came into the pose
LARGEST = 1e6  # N, N m or kg: no beam that is bent by hand or by weights bears more
MOST_TURNED = 720.0  # degrees: two turns are more than any beam needs to come back to itself


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
    turned_from: Array  # (P,) rad, `clamp` before the base was turned into the pose; NaN where nothing says it
    order: Array  # (P,) in which the poses were come to, one from another; NaN where nothing says it

    @property
    def poses(self) -> BenchPoses:
        """The poses' names, and how the beam came into each."""
        return BenchPoses(self.names, self.clamp, self.turned_from, self.order)


def read_loads(path: Path, rec: Recording, axes: Axes) -> PoseLoads:
    """The loads of every pose that the table names; a row without a load names a pose of the bare beam.

    Raises:
        RecordingError: a load without a place, a weight or a room axis without the clamp's angle, angles that differ
            within a pose.
    """
    columns = ("s", "clamp_deg", *AMOUNTS, *CAME_BY)
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
    clamp = _clamps(table, rec, pose, len(names))
    hung = np.nan_to_num(amounts["weight_N"]) + np.nan_to_num(amounts["mass_kg"]) * _magnitude(rec)
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
    turned_from, order = _history(table, pose, clamp, held)
    return PoseLoads(names, clamp, gravity, first, push_s, others, held, turned_from, order)


def turned(vectors: Array, clamp: Array) -> Array:
    """Room vectors (..., 2) in the frame of a clamp turned by `clamp` (...) [rad]; a missing coordinate spoils only
    what depends on it."""
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
    table.refuse(
        held & (np.isfinite(table.get("weight_N")) | np.isfinite(table.get("mass_kg"))),
        "a load that is unknown and a weight: give the weight a row of its own.",
    )
    return np.asarray(held)


def _magnitude(rec: Recording) -> float:
    return rec.gravity.magnitude if rec.gravity is not None else 9.81


def _clamps(table: Columns, rec: Recording, pose: np.ndarray, count: int) -> Array:
    """(P,) rad: the table's, else recording.toml's."""
    default = rec.gravity.base_angle if rec.gravity is not None else math.nan
    stated = np.radians(_one_each(table, "clamp_deg", pose, count))
    return np.where(np.isfinite(stated), stated, default)


def _one_each(table: Columns, column: str, pose: np.ndarray, count: int) -> Array:
    """(P,) a column that says one number of each pose; NaN where it says none."""
    out, values = np.full(count, np.nan), table.get(column)
    for i in range(count):
        stated = values[(pose == i) & np.isfinite(values)]
        if len(stated):
            table.refuse((pose == i) & (np.ptp(stated) > 0.0), f"{column} differs within the pose. Give one.")
            out[i] = stated[0]
    return out


def _history(table: Columns, pose: np.ndarray, clamp: Array, held: BoolArray) -> tuple[Array, Array]:
    """(P,) rad and (P,): whence the base was turned into each pose, and in which order the poses were come to."""
    turned_from, order = (_one_each(table, column, pose, len(clamp)) for column in CAME_BY)
    far = np.abs(np.nan_to_num(turned_from)) > MOST_TURNED
    table.refuse(
        far[pose], f"turned_from_deg is beyond {MOST_TURNED:g} degrees. Give the angle that it was turned from."
    )
    turned, ordered = np.isfinite(turned_from)[pose], np.isfinite(order)[pose]
    table.refuse(turned & ordered, "both turned_from_deg and order: how the beam came into a pose is said once.")
    table.refuse(
        (turned | ordered) & held[pose], "how a beam came into a pose says nothing where an unknown load holds its end."
    )
    table.refuse(
        turned & ~np.isfinite(clamp)[pose],
        "turned_from_deg needs the clamp's angle in the pose, too. Give clamp_deg, or base_angle_deg in [gravity].",
    )
    known, count = np.unique(order[np.isfinite(order)], return_counts=True)
    table.refuse(np.isin(order[pose], known[count > 1]), "order is the same in two poses. Number them 1, 2, 3...")
    return np.radians(turned_from), order


def _shared(
    pose: np.ndarray, count: int, force: Array, moment: Array, s: Array
) -> tuple[Array, Array, KnownLoads | None]:
    """The largest force of each pose and its place, and all the rest; rows of a pose at one place are one load."""
    first, push_s = np.zeros((count, 2)), np.ones(count)
    further: list[list[tuple[Array, float]]] = [[] for _ in range(count)]
    turns: list[list[tuple[float, float]]] = [[] for _ in range(count)]
    for i in range(count):
        rows = np.flatnonzero(pose == i)
        sums = [
            (sum((force[r] for r in rows if s[r] == place), np.zeros(2)), place)
            for place in sorted({*s[rows].tolist()})
        ]
        pushes = [(f, place) for f, place in sums if np.any(f != 0.0)]
        pushes.sort(key=lambda load: -float(np.linalg.norm(load[0])))
        if pushes:
            first[i], push_s[i] = pushes[0]
        further[i] = pushes[1:]
        turns[i] = [(float(moment[r]), float(s[r])) for r in rows if moment[r] != 0.0]
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
