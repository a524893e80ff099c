"""Angles from the places of neighbouring markers, for trackers that give points only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.errors import ObservationError
from onebend.records import Array, Markers

MOST_TURN = 4.0  # times what the places turn by: angles beyond are no radians
BENT = 0.2  # rad that a marker's chord must turn for its angle to be compared with it


def chord_angles(xy: Array, s: Array) -> Array:
    """(T, m) rad: the beam's angle at the markers, from places (T, m, 2) [m] and the clamp at the origin.

    The slope of a parabola in s through each marker and its two neighbours; at the tip the angle of the last chord is
    extrapolated. Good to a few hundredths of a radian: enough for clocks and rests, not for learning. NaN where a
    marker or a neighbour is missing.
    """
    order = np.argsort(s, kind="stable")
    places = np.concatenate([[0.0], s[order]])
    points = np.concatenate([np.zeros((len(xy), 1, 2)), xy[:, order]], axis=1)
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
    return replace(markers, angle=np.where(known, markers.angle, _continuous(rough)))


def check_angles(xy: Array, s: Array, angle: Array, name: str) -> None:
    """Refuse measured angles (T, m) [rad] of a recording that turn against the places (T, m, 2) [m], or are no radians.

    Raises:
        ObservationError: they do.
    """
    share = angles_per_chord(xy, s, angle)
    if share < 0.0 or share > MOST_TURN:
        how = "the other way than" if share < 0.0 else f"{share:.2g} times as far as"
        raise ObservationError(
            f"{name}: angle_rad turns {how} the markers' places do. Angles are in radians and grow from x to y: "
            "correct the sign or the unit of angle_rad, or the order or the sign of x_m and y_m."
        )


def angles_per_chord(xy: Array, s: Array, angle: Array) -> float:
    """How far measured angles (T, m) [rad] turn for each radian that the places (T, m, 2) [m] turn: about 1; NaN where
    nothing bends, or no angle is measured."""
    chords = _continuous(chord_angles(xy, s))
    known = np.isfinite(chords) & np.isfinite(angle)
    if not known.any():
        return float("nan")
    measured, turned = (_from_mean(np.where(known, values, np.nan)) for values in (angle, chords))
    if not float(np.nanmax(turned) - np.nanmin(turned)) > BENT:
        return float("nan")
    return float(np.nansum(measured * turned) / np.nansum(turned**2))


def _from_mean(values: Array) -> Array:
    """Columns (T, m) less their means; NaN where a column has no value."""
    count = np.maximum(np.sum(np.isfinite(values), axis=0), 1)
    return np.asarray(values - np.nansum(values, axis=0) / count)


def _continuous(angle: Array) -> Array:
    """Columns without jumps by whole turns; NaN is stepped over."""
    continuous = angle.copy()
    for column in continuous.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return continuous
