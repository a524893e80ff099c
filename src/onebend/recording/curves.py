"""Curves in tables: vertices in their order from the clamp to the tip, whose places along the body nobody measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from onebend.errors import ObservationError
from onebend.recording.outline import POINTS
from onebend.recording.tables import Columns
from onebend.records import Array, BoolArray, IntArray

MOST_VERTICES = 2 * POINTS  # between which the curve is bent smoothly; of more, neighbours are averaged first
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


def curve_rows(table: Columns, otherwise: str = "") -> BoolArray:
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
    table: Columns, drawn: BoolArray, frame: IntArray, count: int, columns: tuple[str, ...] = ("x_m", "y_m")
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


def stated_sd(table: Columns, drawn: BoolArray, frame: IntArray, count: int, otherwise: float) -> Array:
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
    xy, angle = np.full((len(vertices), POINTS, 2), np.nan), np.full((len(vertices), POINTS), np.nan)
    for t in np.flatnonzero(count).tolist():
        xy[t], angle[t], end = _resampled(vertices[t, : count[t]], length, origin)
        if end > TOO_LONG:
            raise ObservationError(
                f"{name}: a curve is {1e3 * end * length:.4g} mm long, the body {1e3 * length:.4g} mm. Are x_m and "
                "y_m in metres, and do the vertices rise from the clamp to the tip? Check length_m.",
                about="unit",
            )
    return CurvePoints(xy, angle, np.maximum(count / POINTS, 1.0))


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
    asked = ((np.arange(FINE * POINTS) + 0.5) / (FINE * POINTS)).reshape(POINTS, FINE)
    near = 0.5 / POINTS
    inside = np.all((asked >= s[0] - near) & (asked <= s[-1] + near), axis=1)
    at = np.interp(asked, s, fine) + length * (np.minimum(asked - s[0], 0.0) + np.maximum(asked - s[-1], 0.0))
    tangent = line.derivative()(at).mean(axis=1)
    xy = np.where(inside[:, None], line(at).mean(axis=1), np.nan)
    return xy, np.arctan2(tangent[:, 1], tangent[:, 0]), float(s[-1])
